"""One small scene for all tests of the posterior: photos of a ball, its problem and its fit."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.base.config import Fit, Observe
from pipeline.base.images import write_exr, write_png
from pipeline.geometry.cameras import Rig, View, save_cameras
from pipeline.photos.held_out import hold_out
from pipeline.posterior.fit import fit
from pipeline.posterior.problem import Problem
from pipeline.prior.training.procedural import outdoor
from pipeline.prior.value_code import scale_of
from pipeline.render.envmap import solid_angles
from pipeline.render.observe import Observations, make_observations
from pipeline.render.renderer import Explanation, Renderer
from tests.conftest import look_at
from tests.render.pictures import render_view
from tests.seeds import numpy_rng, seeded

SKY = 9


def overcast(rng: np.random.Generator) -> np.ndarray:
    """The first of the generator's skies (32, 64, 3) of which no pixel sends a hundredth of all
    light: with two paths for a photo's pixel, one that meets a sun would be all of a step's loss.
    """
    while True:
        light = outdoor(rng, 32, 64).astype(np.float32)
        sent = light.sum(-1) * solid_angles(32, 64)
        if sent.max() < 0.01 * sent.sum():
            return light


@pytest.fixture(scope="session")
def toy(ball, tmp_path_factory):
    """Photos of the ball with a two-coloured texture under an overcast sky: (folder, truth)."""
    folder = tmp_path_factory.mktemp("toy")
    light = overcast(numpy_rng(SKY))
    color = np.full((32, 32, 3), 0.5, np.float32)
    color[:, ::4] = [0.6, 0.15, 0.1]
    truth = Explanation(
        light / scale_of(light) * 0.5,
        color,
        np.full((32, 32), 0.4, np.float32),
        np.zeros((32, 32), np.float32),
    )
    renderer, views = Renderer(ball / "mesh_uv.ply", 32, 32, 3), []
    for k in range(9):
        a = 2 * np.pi * k / 9
        eye = 2.5 * np.array([np.sin(a) * 0.9, 0.35 if k % 2 else -0.1, np.cos(a) * 0.9])
        view = View(f"v{k}", f"images/v{k}.exr", 40, 40, 70, 70, 20, 20, look_at(eye))
        picture = render_view(renderer, truth, view, 64, seeded(k))
        write_exr(folder / view.image, picture)
        write_png(folder / "masks" / f"v{k}.png", (picture.max(-1) > 0) * np.uint8(255))
        views.append(view)
    marked = hold_out([{"name": v.name, "split": "fit"} for v in views], Observe())
    views = [replace(v, split=p["split"]) for v, p in zip(views, marked)]
    save_cameras(folder / "cameras.json", Rig(views, np.zeros(3), 0.6, "transforms.json"))
    make_observations(folder, folder, ball / "mesh_uv.ply", folder, Observe(pixels=4000))
    return folder, truth


@pytest.fixture(scope="session")
def problem(toy, ball):
    """The problem of these photos; tests may set its renderer, and change nothing else of it."""
    return Problem(
        Observations(toy[0], toy[0] / "cameras.json"),
        Renderer(ball / "mesh_uv.ply", 32, 32, 3),
        0.1,
    )


@pytest.fixture(scope="session")
def start(problem):
    """Its fit: (explanation, facts)."""
    return fit(problem, Fit(steps=40, pixels=1000, texture=32), seeded(0))
