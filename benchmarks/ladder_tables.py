"""Tables of the rows of benchmarks.ladder: what the ladder of gloss and metal is worth."""

from __future__ import annotations

import numpy as np

from benchmarks.markdown import number, pipe_table
from benchmarks.tables.committed import title

# of the true scores: heading, name, digits
TRUE = [
    ("novel-view dB", "novel_view_psnr", 1),
    ("relit dB", "relight_psnr", 1),
    ("relit dB, aligned", "relight_psnr_channel", 1),
    ("albedo MSE", "albedo_mse", 4),
    ("albedo MSE, aligned", "albedo_mse_channel", 4),
    ("roughness MSE", "roughness_mse", 3),
    ("metallic MSE", "metallic_mse", 3),
]


def pair(row: dict, key: str, digits: int) -> str:
    """Before | after of a figure."""
    return " \\| ".join(number(row[gloss][key], digits) for gloss in ("maps", "tested"))


def rungs(row: dict) -> str:
    """The rungs of a sample's bodies and their shares of the judged pixels, largest first."""
    shares: dict[str, float] = {}
    for name, share in row["tested"]["rungs"]:
        shares[name] = shares.get(name, 0.0) + share
    largest = sorted(shares.items(), key=lambda item: -item[1])
    return ", ".join(f"{name} {number(share, 2)}" for name, share in largest if share > 0.005)


def photos(rows: list[dict]) -> str:
    """Samples of real photos and of garden, beside the plain textured mesh."""
    body = []
    for row in rows:
        lit = {gloss: row[gloss]["held_out_psnr"] for gloss in ("maps", "tested")}
        unlit = row["unlit"]["robust"]
        body.append(
            [
                row["set"],
                str(row["sample"]),
                number(unlit, 2),
                number(lit["maps"], 2),
                number(lit["tested"], 2),
                f"{lit['tested'] - unlit:+.2f}",
                number(row["tested"]["held_out_standard_error"], 2),
                pair(row, "metal_share", 2),
                rungs(row),
                pair(row, "cpu_seconds", 0),
            ]
        )
    head = ["scene", "sample", "unlit dB", "lit dB, as drawn", "lit dB, tested", "less unlit"]
    head += ["standard error", "metal, share of pixels", "rungs", "processor s"]
    return pipe_table(head, body)


def truths(rows: list[dict]) -> str:
    """Samples whose truth is known, as drawn | tested, and the means over all of them."""
    body = []
    for row in rows:
        cells = [title(row["set"].removeprefix("w_")), str(row["sample"])]
        cells.append(pair(row, "held_out_psnr", 1))
        true = {gloss: row[gloss]["truth"] for gloss in ("maps", "tested")}
        cells += [pair(true, key, digits) for _, key, digits in TRUE]
        body.append([*cells, rungs(row)])

    mean = lambda values: float(np.mean(values))
    of_all = {
        gloss: {key: mean([row[gloss]["truth"][key] for row in rows]) for _, key, _ in TRUE}
        | {"held_out_psnr": mean([row[gloss]["held_out_psnr"] for row in rows])}
        for gloss in ("maps", "tested")
    }
    cells = [f"**mean of {len(rows)}**", "", pair(of_all, "held_out_psnr", 1)]
    body.append([*cells, *(pair(of_all, key, digits) for _, key, digits in TRUE), ""])
    head = ["scene", "sample", "held-out dB", *(title for title, _, _ in TRUE), "rungs"]
    return pipe_table(head, body)


def worst(rows: list[dict]) -> str:
    """One sentence: how many samples gain, and the largest loss."""
    gains = [
        row["tested"]["truth"]["relight_psnr"] - row["maps"]["truth"]["relight_psnr"]
        for row in rows
    ]
    least = int(np.argmin(gains))
    name = title(rows[least]["set"].removeprefix("w_"))
    return (
        f"Relit, {sum(gain > 0 for gain in gains)} of {len(gains)} samples gain; the mean gain is "
        f"{np.mean(gains):+.2f} dB, the largest loss {-min(gains):.2f} dB ({name}).\n"
    )
