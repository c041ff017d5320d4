"""Small rendered scenes on a table: balls of painted cells, their cameras and their true masks."""

import numpy as np
import pytest

from pipeline.base.images import write_exr
from pipeline.geometry.cameras import Rig, save_cameras
from tests.seeds import numpy_rng

GROUND = -0.45
PAINTS = {
    "warm": [[0.5, 0.12, 0.05], [0.05, 0.1, 0.5], [0.1, 0.4, 0.05]],
    "cold": [[0.3, 0.3, 0.6], [0.05, 0.3, 0.3], [0.5, 0.5, 0.5]],
}


def _first_hit(o, d, center, radius):
    """Distance to a ball along rays (h, w, 3), infinite where they miss it."""
    away = o - center
    b = (away * d).sum(-1)
    disc = b**2 - (away**2).sum(-1) + radius**2
    return np.where(disc > 0, -b - np.sqrt(np.maximum(disc, 0)), np.inf)


def picture(view, balls, ground):
    """Linear photo (h, w, 3) of balls (centre, radius, paints) on a table with the texture
    `ground`, and each ball's visible pixels.
    """
    u, w = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    o, d = view.rays(np.stack([u, w], -1))
    nearest = (GROUND - o[..., 1]) / np.minimum(d[..., 1], -1e-3)
    p = o + nearest[..., None] * d
    column, row = ((p[..., [0, 2]] * 16) % len(ground)).astype(int).transpose(2, 0, 1)
    image = ground[row, column]

    which = np.full(nearest.shape, -1)
    for k, (center, radius, paints) in enumerate(balls):
        t = _first_hit(o, d, np.array(center), radius)
        front = t < nearest
        q = o + np.where(front, t, 0)[..., None] * d - center
        paint = np.array(paints)[np.floor(q * 9).astype(int).sum(-1) % len(paints)]
        image = np.where(front[..., None], paint, image)
        nearest = np.where(front, t, nearest)
        which = np.where(front, k, which)
    return image, [which == k for k in range(len(balls))]


@pytest.fixture
def make_table(tmp_path, ring):
    """make(balls, blank=False, gain=1) -> folder like the poses stage's, Rig, true masks of every
    ball.
    """

    def make(balls, radius=0.6, blank=False, gain=1.0):
        rng = numpy_rng(0)
        ground = np.repeat(rng.uniform(0.25, 0.75, (64, 64, 1)), 3, -1)
        if blank:
            ground = np.full((64, 64, 3), 0.6)
        views = [v for e in (28, 60) for v in ring(14, 160, 3.0, e) if v.position[1] > 0]
        truth = [{} for _ in balls]
        for k, v in enumerate(views):
            v.name, v.image = f"p{k}", f"images/p{k}.exr"
            image, seen = picture(v, balls, ground)
            write_exr(tmp_path / v.image, gain * image)
            for masks, mask in zip(truth, seen):
                masks[v.name] = mask
        plane = {"normal": [0, 1, 0], "offset": GROUND}
        rig = Rig(views, np.zeros(3), radius, "sfm", {"plane": plane})
        save_cameras(tmp_path / "cameras.json", rig)
        return tmp_path, rig, truth

    return make
