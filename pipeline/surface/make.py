"""Surface of the object; `make_mesh` runs the whole stage.

SURFACE_METHODS: name -> function(grid, hull field, depth maps) -> field. hull: soft visual hull.
fused: hull carved further by stereo where views agree. Both end in marching cubes, always closed.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from pipeline.base.config import Mesh as MeshSettings
from pipeline.base.errors import InputError
from pipeline.base.files import json_entry, read_json
from pipeline.base.images import linear_to_srgb, luminance, read_exr, read_png, write_png
from pipeline.geometry.cameras import Rig, load_cameras
from pipeline.geometry.mesh_io import Mesh, load_mesh, normal_wobble, save_mesh
from pipeline.geometry.voxels import Grid
from pipeline.masks.agreement import hull_points
from pipeline.surface.clean import facts, simplify, to_mesh
from pipeline.surface.facts import SurfaceFacts
from pipeline.surface.field import hull_of, projections, stacked, stereo_field
from pipeline.surface.preview import Silhouette, shaded
from pipeline.surface.stereo import Depth, stereo

TRUNCATION = 4.0  # cells


def fuse(grid: Grid, hull: np.ndarray, depths: list[Depth]) -> np.ndarray:
    """The smaller of hull and stereo, where the agreeing views of all depth maps sum to 3 or more.
    A cell is emptied by 2 or more views that look through it, if they are over half of that sum.
    """
    h, w = depths[0].depth.shape
    behind, weight, free = stereo_field(
        grid.low.astype(np.float32),
        np.float32(grid.cell),
        grid.shape,
        projections([d.view for d in depths], w, h),
        stacked([d.depth for d in depths]),
        stacked([d.agreeing for d in depths]),
        np.float32(TRUNCATION * grid.cell),
    )
    out = np.where(weight >= 3, np.minimum(hull, behind), hull)
    return np.where((free >= 2) & (free > 0.5 * weight), np.minimum(out, -0.5), out)


SURFACE_METHODS = {"hull": lambda grid, hull, depths: hull, "fused": fuse}


def given_mesh(scene: Path, rig: Rig) -> Mesh | None:
    """The scene's own mesh in the library frame, or None."""
    path = next((scene / n for n in ("mesh.ply", "mesh.obj") if (scene / n).exists()), None)
    if path is None:
        return None
    if rig.source == "sfm":
        raise InputError(
            "a mesh is given, but no cameras: the two cannot be brought together",
            path,
            "add transforms.json or sparse/0 in the mesh's frame, or remove the mesh",
        )

    mesh = load_mesh(path)
    world = np.array(rig.facts["world"])
    linear = world[:3, :3]
    turn = linear / np.cbrt(np.linalg.det(linear))
    vertices = mesh.vertices @ linear.T + world[:3, 3]
    return Mesh(vertices, mesh.faces, mesh.normals @ turn.T, mesh.uv)


def coarse_hull(rig: Rig, masks: dict) -> tuple[np.ndarray, float]:
    """Points (n, 3) that fill the masks' common volume, and a margin within which it is known.

    InputError naming the worst views when there is no common volume.
    """
    points, cell = hull_points(rig, masks, 72, 0.15)
    if len(points):
        return points, 2.5 * cell

    area = {n: float(m.mean()) for n, m in masks.items()}
    worst = sorted(area, key=area.__getitem__)[:3]
    raise InputError(
        f"the masks have no volume in common; smallest masks: {', '.join(worst)}",
        "masks",
        "look at masks/overlay.jpg and correct those masks in the scene's folder masks/",
    )


def build_field(
    rig: Rig,
    poses: Path,
    masks: dict,
    confidence: dict,
    settings: MeshSettings,
    given: bool,
    threads: int,
) -> tuple[np.ndarray, Grid, dict]:
    """Field and grid by the chosen method, and the facts behind the choice."""
    points, margin = coarse_hull(rig, masks)
    low = points.min(0) - margin
    high = points.max(0) + margin
    plane = rig.facts.get("plane")
    if plane is not None:
        low[1] = max(low[1], plane["offset"] - 0.02 * (high[1] - low[1]))
    grid = Grid.over(low, high, settings.grid)

    carving = [v for v in rig.views if confidence[v.name]["carve"]]
    if len(carving) < 3:
        raise InputError(
            "fewer than 3 masks agree with each other",
            "masks",
            "correct the masks in the scene's folder masks/",
        )

    truncation = TRUNCATION * grid.cell
    tolerance = 0.04 if given else 0.08
    hull = hull_of(grid, carving, [masks[v.name] for v in carving], truncation, tolerance)

    depths: list[Depth] = []
    share = None
    if settings.method != "hull":
        depths, share = _stereo_of(rig, poses, masks, settings, points, margin, threads)
    method, why = _choose(settings, share)
    field = SURFACE_METHODS[method](grid, hull, depths)

    # nothing of the object lies below the ground; a thin slab of ground would stick to it
    if plane is not None:
        y = grid.low[1] + (np.arange(grid.shape[1]) + 0.5) * grid.cell
        above = (y - plane["offset"] - 1.5 * grid.cell) / truncation
        field = np.minimum(field, above[None, :, None])
    return field, grid, {"method": method, "why": why, "stereo_share": share}


def _stereo_of(
    rig: Rig,
    poses: Path,
    masks: dict,
    settings: MeshSettings,
    points: np.ndarray,
    margin: float,
    threads: int,
) -> tuple[list[Depth], float]:
    """Depth maps of all photos at `stereo_scale`, and the share of mask pixels that have depth."""
    views = [v.scaled(settings.stereo_scale) for v in rig.views]
    images = []
    small = []
    for full, view in zip(rig.views, views):
        size = (view.width, view.height)
        grey = (luminance(linear_to_srgb(read_exr(poses / full.image))) * 255).astype(np.uint8)
        images.append(cv2.resize(grey, size, interpolation=cv2.INTER_AREA))
        mask = masks[full.name].astype(np.uint8)
        small.append(cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST) > 0)
    return stereo(views, images, small, points, margin, threads)


def _choose(settings: MeshSettings, share: float | None) -> tuple[str, str]:
    """A key of SURFACE_METHODS, and why it was chosen. `share`: of mask pixels with depth."""
    if settings.method != "auto":
        return settings.method, "asked for"

    assert share is not None  # only the hull does without stereo
    trusted = share >= settings.min_agreement
    why = (
        f"{100 * share:.0f} % of mask pixels have depth that views agree on; "
        f"{'at least' if trusted else 'less than'} {100 * settings.min_agreement:.0f} % "
        "are needed to trust stereo"
    )
    return ("fused" if trusted else "hull"), why


def make_mesh(
    poses: Path, masks_folder: Path, scene: Path, out: Path, settings: MeshSettings, threads: int
) -> dict:
    """Write mesh.ply, surface.json (`SurfaceFacts`), preview.png and masks/ into `out`; returns
    metrics and what was decided. The normals' error is 0 for a given mesh: its wobble is meant.
    """
    rig = load_cameras(poses / "cameras.json")
    mesh = given_mesh(scene, rig)
    if mesh is not None:
        metrics = {
            "method": "given",
            "why": "the scene folder has a mesh",
            "normal_error": 0.0,
        } | facts(mesh)
    else:
        masks = {
            v.name: read_png(masks_folder / "masks" / f"{v.name}.png") > 127 for v in rig.views
        }
        given = json_entry(masks_folder / "masks.json", "method") == "given"
        field, grid, metrics = build_field(
            rig, poses, masks, read_json(masks_folder / "confidence.json"), settings, given, threads
        )
        mesh, more = simplify(to_mesh(field, grid), settings.faces)
        metrics |= more | {
            "cell": grid.cell,
            "normal_error": normal_wobble(mesh),
            "warnings": warnings_of(rig, masks),
        }
    save_mesh(out / "mesh.ply", mesh)
    SurfaceFacts(metrics["normal_error"]).save(out)
    write_png(out / "preview.png", shaded(mesh))
    kept = {v.name for v in rig.views}
    if metrics["method"] == "fused":
        kept = set(json_entry(masks_folder / "masks.json", "given"))
    metrics["mask_share_without_surface"] = surface_masks(
        rig, masks_folder / "masks", mesh, out / "masks", kept
    )
    return metrics


def surface_masks(rig: Rig, masks: Path, mesh: Mesh, out: Path, kept: set[str]) -> float:
    """Write each view's final mask; returns the share of the masks' pixels that the surface does
    not cover.

    Automatic masks may hold ground that stereo has told from the object, or miss a part that all
    other views show: the fused surface knows better, and its silhouette is the final mask. The
    masks of the views in `kept` stay as they are: those that were given, and all where they alone
    made the surface.
    """
    out.mkdir()
    covered_in = Silhouette(mesh)
    missed = 0
    total = 0

    for v in rig.views:
        mask = read_png(masks / f"{v.name}.png") > 127
        covered = covered_in(v)
        missed += (mask & ~covered).sum()
        total += mask.sum()
        write_png(out / f"{v.name}.png", (mask if v.name in kept else covered) * np.uint8(255))
    return float(missed / max(total, 1))


def warnings_of(rig: Rig, masks: dict) -> list[str]:
    """What makes a hull untrustworthy: views from one side only, objects cut off by the frame."""
    out = []

    x, _, z = np.stack([v.position - rig.center for v in rig.views]).T
    azimuth = np.sort(np.arctan2(x, z))
    round_trip = np.concatenate([azimuth, azimuth[:1] + 2 * np.pi])
    gap = np.degrees(np.max(np.diff(round_trip)))
    if gap > 120:
        out.append(f"no photo over {gap:.0f} degrees around the object: its far side is guessed")

    at_edge = lambda m: m[0].any() or m[-1].any() or m[:, 0].any() or m[:, -1].any()
    cut_off = sum(at_edge(m) for m in masks.values())
    if cut_off > 0.3 * len(masks):
        out.append(f"the object touches the frame in {cut_off} of {len(masks)} photos")
    return out
