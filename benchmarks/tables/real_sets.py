"""Assets from real photos beside the plain textured mesh."""

from __future__ import annotations

import numpy as np

from benchmarks.markdown import number, pipe_table
from benchmarks.tables import committed
from benchmarks.tables.committed import by_scene, nested, source

# Columns of the real sets: heading, keys in a row, digits.
REAL_SETS: list[tuple[str, tuple[str, ...], int]] = [
    ("unlit dB", ("unlit_psnr",), 2),
    ("lit dB", ("lit_psnr",), 2),
    ("lit over unlit dB", ("gain",), 2),
    ("charts", ("charts",), 0),
    ("utilisation", ("utilisation",), 2),
    ("mesh s", ("mesh_seconds",), 0),
    ("mesh, processor s", ("cpu_seconds", "mesh"), 0),
    ("around the thing, warm", ("around_warm",), 2),
]
# And of every sample: heading, its key, digits.
OF_SAMPLES = {
    "lit dB, a sample each": ("psnr", 2),
    "share of metal": ("metallic_share_above_half", 2),
    "median roughness": ("roughness_median", 2),
    "light, warm": ("light_warm", 2),
}
# Of an atlas: heading, its key, digits.
PACKED = {
    "charts": ("charts", 0),
    "share of the page": ("utilisation", 2),
    "unlit dB": ("unlit_psnr", 2),
}
REAL_TRUTH: list[tuple[str, tuple[str, ...], int]] = [
    ("F-score at 1 %", ("truth", "f1_at_1_percent_of_size"), 3),
    ("at .5 %", ("truth", "f1_at_half_percent"), 3),
    ("Chamfer, % of the diagonal", ("truth", "chamfer_percent_of_diagonal"), 3),
    ("normals: median degrees", ("truth", "normal_error_median_degrees"), 1),
    ("mean", ("truth", "normal_error_mean_degrees"), 1),
    ("below 10 degrees", ("truth", "normal_error_below_10_degrees"), 2),
]


def real_set_rows() -> list[tuple[str, str, dict]]:
    """(set, "before" or "now", row) of every set: rows of the version whose masks, surface and
    textures saw the held-out photos and whose gloss was kept as drawn, and of the present one.
    """
    found = {"before": by_scene("real_sets_before")}
    if (committed.RESULTS / "real_sets.json").exists():
        found["now"] = by_scene("real_sets")
    scenes = dict.fromkeys(scene for rows in found.values() for scene in rows)
    return [
        (scene, when, rows[scene])
        for scene in scenes
        for when, rows in found.items()
        if scene in rows
    ]


def real_set_source() -> str:
    """The lines below a table of the real sets."""
    now = source("real_sets") if (committed.RESULTS / "real_sets.json").exists() else ""
    return source("real_sets_before") + now


def real_sets() -> str:
    """Relightable assets from real photos beside the plain textured mesh."""
    columns = len(REAL_SETS) + len(OF_SAMPLES)
    body = []
    for scene, when, row in real_set_rows():
        if "failed" in row:
            body.append([scene, when, row["failed"]] + [""] * (columns - 1))
            continue
        cells = [number(nested(row, *keys), digits) for _, keys, digits in REAL_SETS]
        for key, digits in OF_SAMPLES.values():
            known = [sample[key] for sample in row["samples"] if key in sample]
            cells.append(", ".join(number(value, digits) for value in known))
        body.append([scene, when, *cells])
    means = []
    times = list(dict.fromkeys(when for _, when, _ in real_set_rows()))
    good = [(scene, when) for scene, when, row in real_set_rows() if "failed" not in row]
    in_all = {scene for scene, _ in good if all((scene, when) in good for when in times)}
    for when in times:
        rows = [row for scene, w, row in real_set_rows() if w == when and scene in in_all]
        cells = [
            number(float(np.mean([nested(row, *k) for row in rows])), d)
            for _, k, d in REAL_SETS[:3]
        ]
        means.append([f"mean of {len(rows)}", when, *cells] + [""] * (columns - len(cells)))
    head = ["set", "", *(heading for heading, *_ in REAL_SETS)]
    head += list(OF_SAMPLES)
    return pipe_table(head, body + means) + real_set_source()


def real_sets_truth() -> str:
    """Errors of surfaces and normals of the sets whose truth is known."""
    body = []
    for scene, when, row in real_set_rows():
        if row.get("truth"):
            cells = [number(nested(row, *keys), digits) for _, keys, digits in REAL_TRUTH]
            body.append([scene, when, *cells])
    return pipe_table(["set", "", *(heading for heading, *_ in REAL_TRUTH)], body)


def atlas_photos() -> str:
    """What the packer of an atlas costs held-out photos, on one mesh."""
    body = []
    for row in committed.rows_of("atlas_photos"):
        figures = [number(row[key], digits) for key, digits in PACKED.values()]
        lit = ", ".join(number(sample["psnr"], 2) for sample in row["samples"])
        body.append([row["scene"], row["packed_by"], *figures, lit])
    head = ["scene", "packed by", *PACKED, "lit dB, a sample each"]
    return pipe_table(head, body) + source("atlas_photos")


def view_dependence() -> str:
    """What any function of the reflected direction explains beyond the plain textured mesh."""
    body = []
    for row in committed.rows_of("view_dependence"):
        lit = ", ".join(number(psnr, 2) for psnr in row["lit_psnr"])
        free = row["free"]
        gain = number(row["free_psnr"] - row["unlit_psnr"], 2)
        figures = [number(row["unlit_psnr"], 2), number(row["free_psnr"], 2), gain, lit]
        chosen = [number(free[key], 0) for key in ("lobes", "groups")]
        body.append([row["scene"], *figures, *chosen, number(1 - free["left"], 2)])
    head = ["set", "unlit dB", "with a free highlight dB", "gain dB", "lit dB, a sample each"]
    head += ["directions", "groups of colours", "share explained of what photos left out show"]
    return pipe_table(head, body) + source("view_dependence")


def viewer() -> str:
    """What UsdPreviewSurface and Blender show of the samples, by the numbers that assets carry, and
    UsdPreviewSurface by others.
    """
    in_blender = {row["scene"]: row for row in committed.rows_of("blender")}
    listed = lambda values: ", ".join(number(value, 2) for value in values)
    body = []
    for row in committed.rows_of("viewer"):
        shown = [*row["samples"], row["mean"]]
        own, exported, unchanged = (
            listed(one[key] for one in shown) for key in ("renderer", "exported", "unchanged")
        )
        blender = in_blender[row["scene"]]
        variants = [*(f"sample_{k}" for k in range(len(row["samples"]))), "mean"]
        pictures = [listed(blender[v][key] for v in variants) for key in ("psnr", "level")]
        clipped = max(one["clipped"] for one in shown)
        body.append([row["scene"], own, exported, *pictures, unchanged, f"{clipped:.1%}"])
    head = ["set", "renderer's model dB: samples, mean", "UsdPreviewSurface, as exported dB"]
    head += ["Blender, as exported dB", "level in Blender"]
    head += [
        "UsdPreviewSurface by the renderer's numbers dB",
        "base colours too bright for it, at most",
    ]
    return pipe_table(head, body) + source("viewer") + source("blender")


TABLES = {
    make.__name__: make
    for make in (real_sets, real_sets_truth, view_dependence, viewer, atlas_photos)
}
