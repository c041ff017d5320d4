"""Observations: random pixels over all views in one table, with where each one's ray meets the
mesh.

Arrays of observations.npz, n pixels: view (n,) index into `views`; pixel (n, 2) column and row; rgb
(n, 3) linear radiance; clipped (n,) whether a channel is saturated (then rgb is only a lower
bound); uv (n, 2) texture coordinates of the primary hit, v up; cosine (n,) between its normal and
the ray. `views` lists the views in use, `held_out` those kept for scoring.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from pipeline.base.config import Observe
from pipeline.base.errors import InputError
from pipeline.base.images import read_exr, read_png
from pipeline.base.progress import progress
from pipeline.base.runtime import mitsuba_rays
from pipeline.geometry.cameras import Rig, View, load_cameras


def hold_out(rig: Rig, share: float, seed: int) -> list[str]:
    """Names kept for scoring: the scene's own test views, else a random share (at least one from 8
    views on).
    """
    test = [v.name for v in rig.views if v.split == "test"]
    names = [v.name for v in rig.fit_views()]
    if test or share == 0:
        return test
    count = max(round(share * len(names)), 1 if len(names) >= 8 else 0)
    return sorted(np.random.default_rng(seed).choice(names, count, replace=False).tolist())


def inner_mask(mask: np.ndarray, erode: float) -> np.ndarray:
    """The mask without a rim of `erode` pixels, where photos mix object and background."""
    return (
        cv2.distanceTransform(np.pad(mask.astype(np.uint8), 1), cv2.DIST_L2, 5)[1:-1, 1:-1] > erode
    )


class Tracer:
    """Primary hits of a mesh."""

    def __init__(self, mesh: Path):
        from pipeline.base.runtime import mitsuba as mi

        self.scene = mi.load_dict(
            {
                "type": "scene",
                "obj": {"type": "ply", "filename": str(mesh), "flip_tex_coords": False},
            }
        )

    def hit(self, o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rays (n, 3) -> uv (n, 2) with v up, cosine of incidence (n,), and which rays hit (n,)."""
        si = self.scene.ray_intersect(mitsuba_rays(o, d))
        cosine = np.abs((np.array(si.n).T.reshape(-1, 3) * d).sum(-1))
        return np.array(si.uv).T.reshape(-1, 2), cosine, np.array(si.is_valid()).astype(bool)


def make_observations(poses: Path, masks: Path, mesh: Path, out: Path, settings: Observe) -> dict:
    """Draw `settings.pixels` pixels evenly over the masked pixels of all fit views; write
    observations.npz.
    """
    rig = load_cameras(poses / "cameras.json")
    held = hold_out(rig, settings.held_out, settings.seed)
    views = [v for v in rig.fit_views() if v.name not in held]
    candidates = [
        np.argwhere(inner_mask(read_png(masks / "masks" / f"{v.name}.png") > 127, settings.erode))
        for v in views
    ]
    total = sum(len(c) for c in candidates)
    if total < 100:
        raise InputError(
            "the masks leave fewer than 100 pixels",
            masks,
            "check masks/overlay.jpg; lower observe.erode",
        )
    rng, tracer = np.random.default_rng(settings.seed), Tracer(mesh)
    columns = {"view": [], "pixel": [], "rgb": [], "clipped": [], "uv": [], "cosine": []}
    missed = 0
    for k, (view, all_of_it) in enumerate(zip(progress(views, "observations"), candidates)):
        count = min(len(all_of_it), round(settings.pixels * len(all_of_it) / total))
        rows, cols = all_of_it[np.sort(rng.choice(len(all_of_it), count, replace=False))].T
        uv, cosine, hit = tracer.hit(*view.rays(np.stack([cols + 0.5, rows + 0.5], -1)))
        rows, cols, uv, cosine, missed = (
            rows[hit],
            cols[hit],
            uv[hit],
            cosine[hit],
            missed + (~hit).sum(),
        )
        rgb = read_exr(poses / view.image)[rows, cols]
        for name, value in (
            ("view", np.full(len(rows), k, np.uint16)),
            ("pixel", np.stack([cols, rows], -1).astype(np.uint16)),
            ("rgb", rgb.astype(np.float32)),
            ("clipped", rgb.max(-1) >= 0.98 * view.clip_level),
            ("uv", uv.astype(np.float32)),
            ("cosine", cosine.astype(np.float32)),
        ):
            columns[name].append(value)
    table = {name: np.concatenate(parts) for name, parts in columns.items()}
    if not len(table["view"]):
        raise InputError(
            "no masked pixel's ray meets the mesh",
            mesh,
            "check that mesh and cameras share one frame",
        )
    np.savez(
        out / "observations.npz",
        **table,
        views=np.array([v.name for v in views]),
        held_out=np.array(held),
    )
    return {
        "pixels": len(table["view"]),
        "views": len(views),
        "held_out": held,
        "missed_share": float(missed / (missed + len(table["view"]))),
        "clipped_share": float(table["clipped"].mean()),
    }


class Observations:
    """The table in memory, with jittered camera rays for any subset."""

    def __init__(self, folder: Path, cameras: Path):
        data = np.load(Path(folder) / "observations.npz")
        self.view, self.pixel, self.rgb = data["view"].astype(int), data["pixel"], data["rgb"]
        self.clipped, self.uv, self.cosine = data["clipped"], data["uv"], data["cosine"]
        self.rig = load_cameras(cameras)
        by_name = {v.name: v for v in self.rig.views}
        self.views: list[View] = [by_name[n] for n in data["views"]]
        self.held_out: list[View] = [by_name[n] for n in data["held_out"]]
        self.origin = np.stack([v.position for v in self.views])
        self.turn = np.stack([v.world_to_camera[:3, :3] for v in self.views])
        self.lens = np.array([[v.fx, v.fy, v.cx, v.cy] for v in self.views])

    def __len__(self) -> int:
        return len(self.view)

    def rays(self, index: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """One ray through a random point of each pixel of `index` (any shape (...,)): o, d (...,
        3).
        """
        return self._rays_at(index, rng.random(index.shape + (2,)))

    def centre_rays(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The ray through the centre of each pixel of `index` (any shape (...,)): o, d (..., 3)."""
        return self._rays_at(index, 0.5)

    def _rays_at(self, index: np.ndarray, offset) -> tuple[np.ndarray, np.ndarray]:
        k, at = self.view[index], self.pixel[index] + offset
        fx, fy, cx, cy = np.moveaxis(self.lens[k], -1, 0)
        d = np.stack([(at[..., 0] - cx) / fx, (at[..., 1] - cy) / fy, np.ones(index.shape)], -1)
        d /= np.linalg.norm(d, axis=-1, keepdims=True)
        return self.origin[k], np.einsum("...i,...ij->...j", d, self.turn[k])
