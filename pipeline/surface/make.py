"""Surface of the object; `make_mesh` runs the whole stage: the hull or, where photos ask for it,
hull and depth maps fused and moved to where photos agree best; then decimated as far as photos
cannot tell.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pipeline.base.config import Mesh as MeshSettings
from pipeline.base.images import luminance, perceived, read_exr, read_png, write_png
from pipeline.geometry.cameras import Rig, load_cameras
from pipeline.geometry.mesh_io import Mesh, normal_wobble, save_mesh
from pipeline.masks.facts import MaskFacts
from pipeline.surface.bake import DENSE
from pipeline.surface.clean import facts
from pipeline.surface.face_count import as_few_faces
from pipeline.surface.facts import SurfaceFacts
from pipeline.surface.fusion import build_surface
from pipeline.surface.given import given_mesh
from pipeline.surface.preview import Silhouette, shaded
from pipeline.surface.silhouettes import silhouettes_of

# radians: the part of the normals' median error that is wider than a triangle, so that it does not
# wobble from vertex to vertex. Wobble | error against the truth: garden .08 | .10, nerf_lego
# .13 | .16, a rendered avocado .03 | .09; a toy car .06 | .28, for on its gloss depth is wrong
WIDE_ERROR = 0.1


def grey_photos(rig: Rig, poses: Path) -> list[np.ndarray]:
    """All photos as grey (h, w) float32, sRGB-encoded, white 1: matching sees what eyes see, and
    above white what short exposures show.
    """
    return [luminance(perceived(read_exr(poses / v.image))).astype(np.float32) for v in rig.views]


def reconstructed(
    rig: Rig, poses: Path, masks_folder: Path, settings: MeshSettings, threads: int
) -> tuple[Mesh, dict]:
    """The surface from masks and photos before decimation, and facts about how it was made."""
    known = MaskFacts.load(masks_folder)
    rig = rig.about(np.array(known.center), known.radius)
    masks = {v.name: read_png(masks_folder / "masks" / f"{v.name}.png") > 127 for v in rig.views}
    seen = silhouettes_of(rig, masks, known.carving, known.all_given)
    images = grey_photos(rig, poses)
    dense, grid, how = build_surface(seen, images, settings, threads)
    return dense, how | {"cell": grid.cell, "warnings": warnings_of(rig, masks)}


def make_mesh(
    poses: Path, masks_folder: Path, scene: Path, out: Path, settings: MeshSettings, threads: int
) -> dict:
    """Write mesh.ply, surface.json (`SurfaceFacts`), preview.png and masks/ into `out`, and where
    the mesh was not given dense.ply, the surface before decimation; returns metrics and what was
    decided. The normals' error is 0 for a given mesh: its wobble is meant.
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
        dense, how = reconstructed(rig.training(), poses, masks_folder, settings, threads)
        save_mesh(out / DENSE, dense)
        views = rig.training().views
        richest, mesh, chosen = as_few_faces(dense, settings.faces, views, settings.face_error)
        # by the richest, whatever was chosen: triangles that are wider wobble more
        error = float(np.hypot(normal_wobble(richest), WIDE_ERROR))
        metrics = how | facts(mesh) | {"triangles": chosen, "normal_error": error}
    save_mesh(out / "mesh.ply", mesh)
    SurfaceFacts(metrics["normal_error"]).save(out)
    write_png(out / "preview.png", shaded(mesh))
    kept = {v.name for v in rig.fit_views()}
    if metrics["method"] == "fused":
        kept = set(MaskFacts.load(masks_folder).given)
    metrics["mask_share_without_surface"] = surface_masks(
        rig.training(), masks_folder / "masks", mesh, out / "masks", kept
    )
    scoring_masks(rig, poses / "masks", mesh, out / "masks")
    return metrics


def surface_masks(rig: Rig, masks: Path, mesh: Mesh, out: Path, kept: set[str]) -> float:
    """Write each view's final mask; returns the share of the masks' pixels that the surface does
    not cover.

    Automatic masks may hold ground that depth has told from the object, or miss a part that all
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


def scoring_masks(rig: Rig, given: Path, mesh: Mesh, out: Path) -> None:
    """Write the mask of each view that is kept for scoring: the user's, where `given` has one, else
    the surface's silhouette.
    """
    covered_in = Silhouette(mesh)
    for v in rig.test_views():
        file = given / f"{v.name}.png"
        mask = read_png(file) > 127 if file.exists() else covered_in(v)
        write_png(out / f"{v.name}.png", mask * np.uint8(255))


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
