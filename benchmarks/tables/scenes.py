"""Whole chains on scenes: time, memory, held-out views, and the evidence of what stands around."""

from __future__ import annotations

import numpy as np

from benchmarks.markdown import number, pipe_table
from benchmarks.tables.committed import rows_of, source

SURROUNDINGS = [
    ("held-out dB", "held_out_psnr", 2),
    ("held-out dB, dome alone", "alone_psnr", 2),
    ("light dB", "light_psnr", 1),
    ("sky dB", "sky_psnr", 1),
    ("relit dB", "relit_psnr", 1),
    ("radiance over truth", "radiance_over_truth", 2),
    ("ground: radii", "ground_extent", 1),
    ("background: share of sphere", "background_share_of_sphere", 3),
]


def garden_draws() -> str:
    """Held-out views of garden by method."""
    body = [
        [
            f"`{row['method']}`",
            str(row["samples"]),
            number(row.get("seconds")),
            number(row["held_out_psnr"], 2),
            number(row.get("held_out_psnr_of_mean"), 2),
        ]
        for row in rows_of("garden_draws")
    ]
    head = ["method", "draws", "s a draw", "held-out dB, a draw", "held-out dB, mean picture"]
    return pipe_table(head, body) + source("garden_draws")


def garden_stages() -> str:
    """Seconds of every stage."""
    rows = rows_of("garden_stages")
    table = pipe_table([r["stage"] for r in rows], [[number(r["seconds"], 0) for r in rows]])
    return table + source("garden_stages")


def scenes() -> str:
    """Whole chains on scene folders."""
    stages = ("poses", "masks", "mesh", "fit", "sample", "refine")
    body = []
    for row in rows_of("scenes"):
        share = row["stereo_share"]
        mesh = row["mesh"] + (f", {number(share, 2)}" if share is not None else "")
        body.append(
            [row["scene"], row["photos"], row["masks"], mesh, number(row["held_out_psnr"])]
            + [number(row["seconds"][stage], 0) for stage in stages]
            + [number(row["sum_of_stage_seconds"], 0), number(row["peak_gib"], 2)]
        )
    head = ["scene", "photos", "masks", "mesh, stereo share", "PSNR dB"]
    head += [f"{stage} s" for stage in stages] + ["all stages s", "peak GiB"]
    return pipe_table(head, body) + source("scenes")


def surroundings() -> str:
    """What the photos show around the object as evidence, each part on and off."""
    body = [
        [row["scene"], row["variant"]]
        + [number(row.get(key), digits) for _, key, digits in SURROUNDINGS]
        for row in rows_of("surroundings")
    ]
    head = ["scene", "evidence", *(heading for heading, *_ in SURROUNDINGS)]
    return pipe_table(head, body) + source("surroundings")


def light_tint() -> str:
    """How far draws' lights are off in tint, with and without what is around; a draw each."""
    rows, variants = rows_of("light_tint"), ("neither", "tint")
    off = {
        name: [np.subtract(row[name]["tints"], row["true"]) for row in rows] for name in variants
    }
    each = lambda values: ", ".join(number(value, 2) for value in values)
    body = []
    for k, row in enumerate(rows):
        middle = np.subtract(row["tint"]["middle"], row["true"])
        body.append(
            [row["scene"].removesuffix("_table"), number(row["true"][0], 2)]
            + [number(row["tint"]["around"][0], 2), each(middle)]
            + [each(off[name][k][:, axis]) for axis in (0, 1) for name in variants]
            + [each(row[name]["held_out_psnr"]) for name in variants]
        )
    rms = lambda name, axis: number(float(np.sqrt((np.array(off[name])[..., axis] ** 2).mean())), 2)
    mean = lambda name: number(float(np.mean([row[name]["held_out_psnr"] for row in rows])), 2)
    middles = [np.subtract(row["tint"]["middle"], row["true"]) for row in rows]
    body.append(
        ["root mean square; mean dB", "", "", each(np.sqrt(np.mean(np.square(middles), 0)))]
        + [rms(name, axis) for axis in (0, 1) for name in variants]
        + [mean(name) for name in variants]
    )
    two = lambda what: [f"{what}, by the object alone", f"{what}, by what is around"]
    head = ["thing", "true, warm", "around it, warm", "middle of what is around: warm, green"]
    head += two("warm") + two("green") + two("held-out dB")
    return pipe_table(head, body) + source("light_tint")


TABLES = {
    make.__name__: make for make in (garden_draws, garden_stages, scenes, surroundings, light_tint)
}
