"""Whole chains on scenes: time, memory, held-out views, and the evidence of what stands around."""

from __future__ import annotations

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


TABLES = {make.__name__: make for make in (garden_draws, garden_stages, scenes, surroundings)}
