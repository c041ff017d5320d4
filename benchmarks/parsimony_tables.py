"""Tables of the rows of benchmarks.parsimony: what the choose stage saves, what it costs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.markdown import pipe_table
from benchmarks.tables.committed import title

LIMITS = {"numbers": 0.25, "cpu_seconds": 0.6}  # largest shares of the fixed preset's
LOSSES = {"held_out": 0.1, "relight": 0.2, "coverage": 0.02}  # most that may be lost: dB, share
LEVEL = "80%"  # intervals whose coverage is compared


def amount(variant: dict, key: str) -> float:
    """A figure of LIMITS. Where nothing is chosen, the choose stage's start counts for nothing."""
    idle = key == "cpu_seconds" and not variant["settings"]
    return variant[key] - (variant["cpu_seconds_by_stage"]["choose"] if idle else 0)


def share(row: dict, key: str) -> float:
    """Of the fixed preset's."""
    return amount(row["chosen"], key) / amount(row["fixed"], key)


def relight(variant: dict) -> float | None:
    """dB of sample 0 under other lights, None where the truth is not known."""
    return variant["truth"]["relight_psnr"] if "truth" in variant else None


def coverage(variant: dict) -> float | None:
    """Mean over the kinds of unknowns of how many true values lie in intervals of LEVEL."""
    held = variant.get("coverage")
    return None if held is None else float(np.mean([kind[LEVEL] for kind in held.values()]))


SCORES: dict[str, Callable[[dict], float | None]] = {
    "held_out": lambda variant: variant["held_out_psnr"],
    "relight": relight,
    "coverage": coverage,
}


def lost(row: dict, score: str) -> float | None:
    """The fixed preset's score less the chosen model's; None where there is no such score."""
    fixed, chosen = (SCORES[score](row[variant]) for variant in ("fixed", "chosen"))
    return None if fixed is None or chosen is None else fixed - chosen


def standard_error(values: np.ndarray) -> float:
    """Of the mean over scenes, which differ; 0 for one."""
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0


def without_suite(name: str) -> str:
    """A scene's name without its suite's."""
    return name.removeprefix("w_").removeprefix("s_")


def summary(rows: list[dict]) -> str:
    """Mean with its standard error over scenes, worst and limit of every figure."""
    body = []
    for key, limit in LIMITS.items():
        values = np.array([share(row, key) for row in rows])
        name = {"numbers": "numbers in the asset", "cpu_seconds": "processor seconds"}[key]
        kept = int((values <= limit).sum())
        cells = [f"{100 * v:.0f} %" for v in (values.mean(), np.median(values), values.max())]
        cells[0] += f" ± {100 * standard_error(values):.0f}"
        body.append([name, *cells, f"{100 * limit:.0f} %", f"{kept} of {len(values)}"])

    for score, limit in LOSSES.items():
        found = [value for row in rows if (value := lost(row, score)) is not None]
        if not found:
            continue
        values = np.array(found)
        name = {"held_out": "held-out dB lost", "relight": "relit dB lost"}.get(
            score, f"coverage of {LEVEL} intervals lost"
        )
        digits = 3 if score == "coverage" else 2
        cells = [f"{v:+.{digits}f}" for v in (values.mean(), np.median(values), values.max())]
        cells[0] += f" ± {standard_error(values):.{digits}f}"
        body.append([name, *cells, f"{limit}", f"{int((values <= limit).sum())} of {len(values)}"])
    return pipe_table(["", "mean", "median", "worst", "limit", "scenes within"], body)


def chosen_words(row: dict) -> list[str]:
    """Cells: sides of the textures, path vertices, rows of the light, and gloss of sample 0: its
    bodies' rungs; of rows from before there were any, what roughness and metallic became.
    """
    settings = row["chosen"]["settings"]
    sides = settings.get("refine", {})
    gloss = row["chosen"]["gloss"] or {}
    rungs = sorted({body["chosen"] for body in gloss.get("bodies", [])})
    maps = [f"{n}: {gloss[n]['chosen']}" for n in ("roughness", "metallic") if n in gloss]
    return [
        f"{sides.get('texture', 'kept')} / {sides.get('gloss_texture', 'kept')}",
        str(settings.get("render", {}).get("max_depth", "kept")),
        str(settings.get("sample", {}).get("light", "kept")),
        ", ".join(rungs or maps) or "kept",
    ]


def coverage_by_scene(rows: list[dict]) -> str:
    """Share of true values that intervals of LEVEL hold, with the choose stage, by kind of unknown;
    rows of several draws.
    """
    kinds = {"light": "light", "relit": "relit pixels", "albedo": "base colour"}
    shares = [[row["chosen"]["coverage"][kind][LEVEL] for kind in kinds] for row in rows]
    body = [
        [title(without_suite(row["set"])), *(f"{v:.2f}" for v in line)]
        for row, line in zip(rows, shares)
    ]
    body.append(["mean", *(f"{v:.2f}" for v in np.mean(shares, axis=0))])
    return pipe_table(["scene", *kinds.values()], body)


def by_scene(rows: list[dict]) -> str:
    """A line for every scene; a figure beyond its limit in bold."""

    def cell(value: float | None, limit: float, text: str) -> str:
        return "" if value is None else f"**{text}**" if value > limit else text

    body = []
    for row in rows:
        line = [f"{title(without_suite(row['set']))}, {row['preset']}"]
        line += chosen_words(row)
        for key, limit in LIMITS.items():
            line.append(cell(share(row, key), limit, f"{100 * share(row, key):.0f} %"))
        for score, limit in LOSSES.items():
            value = lost(row, score)
            digits = 3 if score == "coverage" else 2
            text = "" if value is None else f"{value:+.{digits}f}"
            line.append(cell(value, limit, text))
        body.append(line)
    head = ["scene, preset", "texels: colour / gloss", "max_depth", "light rows", "gloss"]
    head += ["numbers", "CPU s", "held-out dB lost", "relit dB lost", "coverage lost"]
    return pipe_table(head, body)
