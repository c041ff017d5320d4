"""Observations: random pixels over all views in one table, with where each one's ray meets the
mesh.

Arrays of observations.npz, n pixels: view (n,) index into `views`; pixel (n, 2) column and row; rgb
(n, 3) linear radiance; clipped (n, 3) whether it is saturated (then rgb is only a lower
bound); uv (n, 2) texture coordinates of the primary hit, v up; cosine (n,) between its normal and
the ray. `views` lists the views in use, `held_out` those kept for scoring. What they show around
the object, where it is asked for, lies beside them (surroundings.py).
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

from pipeline.base.config import Observe, Poses
from pipeline.base.errors import InputError
from pipeline.base.images import read_exr, read_png
from pipeline.base.progress import progress
from pipeline.base.runtime import mitsuba_rays
from pipeline.geometry.cameras import Rig, View, load_cameras
from pipeline.photos.saturation import saturated
from pipeline.render.camera_rays import rays_into
from pipeline.render.observe_surroundings import find_surroundings
from pipeline.render.surface_photometry import (
    ENOUGH_PIXELS,
    WITHOUT_POINTS,
    surface_photometry,
)
from pipeline.render.surroundings import Surroundings

FEWEST_PIXELS = 100
DEFAULT_POSES = Poses()
SUBPIXELS = 4  # points along a pixel's side that maps are averaged over
PLACES = 20  # pieces along a side of the map that pixels are ordered by


def inner_mask(mask: np.ndarray, erode: float) -> np.ndarray:
    """The mask without a rim of `erode` pixels, where photos mix object and background."""
    framed = np.pad(mask.astype(np.uint8), 1)  # the picture's border counts as background
    to_background = cv2.distanceTransform(framed, cv2.DIST_L2, 5)
    return to_background[1:-1, 1:-1] > erode


class Tracer:
    """Primary hits of a mesh, turned into the world by `to_world` (4, 4)."""

    def __init__(self, mesh: Path, to_world: np.ndarray | None = None):
        from pipeline.base.runtime import mitsuba as mi

        surface = {"type": "ply", "filename": str(mesh), "flip_tex_coords": False}
        if to_world is not None:
            surface["to_world"] = mi.ScalarTransform4f(to_world.tolist())
        try:
            self.scene = mi.load_dict({"type": "scene", "obj": surface})
        except RuntimeError as error:
            raise InputError(
                f"not a readable mesh ({error})", mesh, "delete its folder and run the stage again"
            ) from error

    def hit(
        self, origins: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rays (n, 3) -> uv (n, 2) with v up, cosine of incidence (n,), and which rays hit (n,)."""
        if not len(origins):  # a view without the object; Dr.Jit ends the process over no rays
            return np.zeros((0, 2)), np.zeros(0), np.zeros(0, bool)
        si = self.scene.ray_intersect(mitsuba_rays(origins, directions))
        normal = np.array(si.n).T.reshape(-1, 3)
        cosine = np.abs((normal * directions).sum(-1))
        return np.array(si.uv).T.reshape(-1, 2), cosine, np.array(si.is_valid()).astype(bool)

    def pixel_means(self, view: View, values: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        """Mean (h, w, c) of values(uv (n, 2)) -> (n, c) over SUBPIXELS^2 points of every pixel, of
        those that show the mesh; zero where none does.
        """
        total: np.ndarray | float = 0.0
        count = np.zeros(view.width * view.height)
        share = (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS - 0.5
        for offset in np.stack(np.meshgrid(share, share), -1).reshape(-1, 2):
            uv, _, hit = self.hit(*view.rays(view.pixel_centers().reshape(-1, 2) + offset))
            total = total + values(uv) * hit[:, None]
            count += hit
        means = np.asarray(total) / np.maximum(count, 1)[:, None]
        return means.reshape(view.height, view.width, -1)


def object_pixels(views: list[View], masks: Path, erode: float) -> list[np.ndarray]:
    """Row and column (k, 2) of the pixels inside each view's mask.

    Raises InputError if all views together have next to none.
    """
    inside = []
    for view in views:
        mask = read_png(masks / "masks" / f"{view.name}.png") > 127
        inside.append(np.argwhere(inner_mask(mask, erode)))

    if sum(len(pixels) for pixels in inside) < FEWEST_PIXELS:
        raise InputError(
            f"the masks leave fewer than {FEWEST_PIXELS} pixels",
            masks,
            "check masks/overlay.jpg; lower observe.erode",
        )
    return inside


def observe_view(
    view: View,
    number: int,
    photo: np.ndarray,
    clipped: np.ndarray,
    pixels: np.ndarray,
    tracer: Tracer,
) -> dict[str, np.ndarray]:
    """The table's columns for `pixels` (k, 2), row and column, of one view; without those whose ray
    passes the mesh by. photo, and clipped, where it is saturated: (h, w, 3).
    """
    rows, columns = pixels.T
    centres = np.stack([columns + 0.5, rows + 0.5], -1)
    uv, cosine, hit = tracer.hit(*view.rays(centres))

    rows = rows[hit]
    columns = columns[hit]
    return {
        "view": np.full(len(rows), number, np.uint16),
        "pixel": np.stack([columns, rows], -1).astype(np.uint16),
        "rgb": photo[rows, columns].astype(np.float32),
        "clipped": clipped[rows, columns],
        "uv": uv[hit].astype(np.float32),
        "cosine": cosine[hit].astype(np.float32),
    }


def observe_views(
    views: list[View], poses: Path, masks: Path, mesh: Path, settings: Observe
) -> tuple[dict[str, np.ndarray], int]:
    """The table over all `views`, and how many pixels were drawn for it. Every masked pixel has the
    same chance, and the same ones are drawn in every run.

    Raises InputError where no pixel is left.
    """
    inside = object_pixels(views, masks, settings.erode)
    total = sum(len(pixels) for pixels in inside)
    rng = np.random.default_rng(0)
    tracer = Tracer(mesh)
    parts = []
    drawn = 0

    for number, view in enumerate(progress(views, "observations")):
        pixels = inside[number]
        count = min(len(pixels), round(settings.pixels * len(pixels) / total))
        chosen = pixels[np.sort(rng.choice(len(pixels), count, replace=False))]
        photo = read_exr(poses / view.image)
        clipped = saturated(poses, view, photo)
        parts.append(observe_view(view, number, photo, clipped, chosen, tracer))
        drawn += count

    table = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    if not len(table["view"]):
        raise InputError(
            "no masked pixel's ray meets the mesh",
            mesh,
            "check that mesh and cameras share one frame",
        )
    return table, drawn


def make_observations(
    poses: Path,
    masks: Path,
    mesh: Path,
    out: Path,
    settings: Observe,
    photometry: Poses = DEFAULT_POSES,
) -> dict:
    """Draw `settings.pixels` pixels evenly over the masked pixels of all fit views; write
    observations.npz and return its facts. photometry: whether exposures are matched, and what to do
    where the light moves with the camera, if the cameras came without matched points.

    Raises InputError where masks, mesh and cameras leave nothing to observe, or where the light
    moves with the camera and is to be refused.
    """
    rig = load_cameras(poses / "cameras.json")
    held_out = [view.name for view in rig.test_views()]
    views = rig.fit_views()

    table, drawn = observe_views(views, poses, masks, mesh, settings)
    names = [view.name for view in views] + held_out
    stops, light = exposures(rig, names, poses, masks, mesh, settings, photometry)
    left = dict(zip(names, stops))
    table["rgb"] = table["rgb"] / 2 ** stops[table["view"]].astype(np.float32)
    around, facts = find_surroundings(rig, views, poses, masks, mesh, settings, left)
    np.savez(
        out / "observations.npz",
        view=table["view"],
        pixel=table["pixel"],
        rgb=table["rgb"],
        clipped=table["clipped"],
        uv=table["uv"],
        cosine=table["cosine"],
        views=np.array([view.name for view in views]),
        held_out=np.array(held_out),
        stops=stops,
        **around.arrays(),
    )

    count = len(table["view"])
    return {
        "pixels": count,
        "views": len(views),
        "held_out": held_out,
        "missed_share": float((drawn - count) / drawn),
        "clipped_share": float(table["clipped"].any(1).mean()),
        **light,
        **facts,
    }


def exposures(
    rig: Rig,
    names: list[str],
    poses: Path,
    masks: Path,
    mesh: Path,
    settings: Observe,
    photometry: Poses,
) -> tuple[np.ndarray, dict]:
    """log2 gains (n, 3) that the photos of the views `names` are to be divided by, and facts. 0
    where the poses stage has done so.
    """
    if rig.source != WITHOUT_POINTS:
        return np.zeros((len(names), 3)), {}
    by_name = {view.name: view for view in rig.views}
    views = [by_name[name] for name in names]
    fewer = settings.model_copy(update={"pixels": min(settings.pixels, ENOUGH_PIXELS)})
    table, _ = observe_views(views, poses, masks, mesh, fewer)
    return surface_photometry(table, views, rig, str(poses), photometry)


def by_place(uv: np.ndarray) -> np.ndarray:
    """An order of pixels at texture coordinates uv (n, 2) in which those of one part of the surface
    follow each other, whatever photo they are of: by square pieces of the map.

    Their rays leave the surface alike and read the same texels: in this order paths take three
    quarters of the time.
    """
    column, row = np.clip((PLACES * uv).astype(np.int16), 0, PLACES - 1).T
    return np.argsort(row * np.int16(PLACES) + column, kind="stable")


class Observations:
    """The table in memory, with jittered camera rays for any subset. stops: log2 gains (3,) that
    are divided out, by the view's name. Raises InputError where there is no table.
    """

    def __init__(self, folder: Path, cameras: Path):
        table = Path(folder) / "observations.npz"
        if not table.exists():
            raise InputError("there are no observations", table, "run the observe stage first")
        data = np.load(table)
        order = by_place(data["uv"])
        self.view = data["view"][order].astype(int)
        self.pixel = data["pixel"][order]
        self.rgb = data["rgb"][order]
        self.clipped = data["clipped"][order]
        self.uv = data["uv"][order]
        self.cosine = data["cosine"][order]
        self.surroundings = Surroundings.of(data)

        self.rig = load_cameras(cameras)
        by_name = {view.name: view for view in self.rig.views}
        self.views: list[View] = [by_name[name] for name in data["views"]]
        self.held_out: list[View] = [by_name[name] for name in data["held_out"]]
        names = [*data["views"].tolist(), *data["held_out"].tolist()]
        # an earlier version's table has none: it divided nothing out
        stops = data["stops"] if "stops" in data else np.zeros((len(names), 3))
        self.stops = dict(zip(names, stops))

        # in single precision, as rays are traced: there are millions of them
        single = lambda values: np.array(values, np.float32)
        self.origin = single([view.position for view in self.views])
        self.turn = single([view.world_to_camera[:3, :3] for view in self.views])
        self.lens = single([[view.fx, view.fy, view.cx, view.cy] for view in self.views])

    def __len__(self) -> int:
        return len(self.view)

    def with_pixels(self, index: np.ndarray) -> Observations:
        """The table's rows `index` only, of the same views."""
        some = copy.copy(self)
        for name in ("view", "pixel", "rgb", "clipped", "uv", "cosine"):
            setattr(some, name, getattr(some, name)[index])
        return some

    def rays(self, index: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """One ray through a random point of each pixel of `index` (any shape (...,)): origins,
        directions (..., 3), world frame.
        """
        return self._rays_at(index, rng.random((index.size, 2)))

    def centre_rays(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The ray through the centre of each pixel of `index` (any shape (...,)): origins,
        directions (..., 3), world frame.
        """
        return self._rays_at(index, np.full((1, 2), 0.5))

    def _rays_at(self, index: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rays through the pixels' corners of least column and row, plus `offset` (n, 2) or (1, 2),
        n the size of `index`.
        """
        flat = index.ravel()
        pixel, offset = self.pixel[flat], np.broadcast_to(offset, (len(flat), 2))
        rays = np.empty((2, len(flat), 3), np.float32)
        rays_into(self.view[flat], pixel, offset, self.origin, self.turn, self.lens, rays)
        return rays[0].reshape(*index.shape, 3), rays[1].reshape(*index.shape, 3)
