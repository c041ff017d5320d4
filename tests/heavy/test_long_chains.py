"""A thousand iterations on a scene made to break them: black texels, grazing views, faces without
area, a light that is black in places.

`pytest -m heavy`, some ten minutes. Finite results, memory that stays, and no new kernels after the
warm-up.
"""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import drjit as dr
import numpy as np
import pytest

from pipeline.base.config import Fit, Observe, Sample
from pipeline.base.images import write_exr, write_png
from pipeline.base.runtime import set_threads
from pipeline.geometry.cameras import Rig, View, save_cameras
from pipeline.geometry.mesh_io import Mesh, load_mesh, save_mesh
from pipeline.posterior.fit import fit
from pipeline.posterior.problem import Problem
from pipeline.posterior.samplers import SAMPLERS
from pipeline.prior.load import load_prior
from pipeline.render.metrics import render_view
from pipeline.render.observe import Observations, make_observations
from pipeline.render.renderer import Explanation, Renderer
from tests.conftest import look_at

pytestmark = pytest.mark.heavy
LONG = Sample(
    steps=1000,
    pixels=200,
    spp=2,
    texture=32,
    smooth=5,
    levels=990,
    stay=5,
    points=60,
    views=4,
    light=16,
    region_steps=10,
    search_points=25,
    search_sweeps=1,
)


@pytest.fixture(scope="module")
def hostile(ball, tmp_path_factory) -> tuple[Problem, Explanation]:
    """The problem and its fit."""
    folder = tmp_path_factory.mktemp("hostile")
    mesh = load_mesh(ball / "mesh_uv.ply")
    flat = np.array([[0, 0, 1], [5, 5, 5], [7, 8, 8]])  # two corners or all three are the same
    save_mesh(
        folder / "mesh_uv.ply",
        Mesh(mesh.vertices, np.concatenate([mesh.faces, flat]), mesh.normals, mesh.uv),
    )
    color = np.full((32, 32, 3), 0.6, np.float32)
    color[8:20], color[:, ::8] = 0.0, [0.9, 0.0, 0.0]
    light = np.random.default_rng(0).gamma(0.3, 2.0, (32, 64, 3)).astype(np.float32)
    light[20:], light[4, 9] = 0.0, 3000.0
    truth = Explanation(
        light, color, np.full((32, 32), 0.3, np.float32), np.zeros((32, 32), np.float32)
    )
    renderer, views = Renderer(folder / "mesh_uv.ply", 32, 32, 3), []
    for k in range(9):
        a, near = 2 * np.pi * k / 9, k % 3 == 0
        eye = np.array([np.sin(a), 0.3, np.cos(a)]) * (0.56 if near else 2.5)
        side = np.array([np.cos(a), 0, -np.sin(a)])
        pose = look_at(
            eye, eye + side - 0.6 * eye if near else (0, 0, 0)
        )  # every third camera looks along the surface
        views.append(View(f"v{k}", f"images/v{k}.exr", 40, 40, 60, 60, 20, 20, pose))
        picture = render_view(renderer, truth, views[-1], 32)
        write_exr(folder / views[-1].image, picture)
        seen = render_view(
            renderer,
            Explanation(np.ones_like(light), color * 0 + 0.5, truth.roughness, truth.metallic),
            views[-1],
            8,
        )
        write_png(folder / "masks" / f"v{k}.png", (seen.max(-1) > 0.2) * np.uint8(255))
    save_cameras(folder / "cameras.json", Rig(views, np.zeros(3), 0.6, "transforms.json"))
    make_observations(folder, folder, folder / "mesh_uv.ply", folder, Observe(pixels=4000))
    problem = Problem(Observations(folder, folder / "cameras.json"), renderer, 0.1)
    assert (problem.observations.cosine < 0.15).any()
    return problem, fit(problem, Fit(steps=40, pixels=1000, texture=32))[0]


class Memory(threading.Thread):
    """Resident megabytes of this process, twice a second until `stop`."""

    def __init__(self):
        super().__init__(daemon=True)
        self.seen, self.over = [], threading.Event()

    def run(self):
        page = os.sysconf("SC_PAGE_SIZE") / 2**20
        while not self.over.wait(0.5):
            self.seen.append(int(Path("/proc/self/statm").read_text().split()[1]) * page)

    def growth(self) -> float:
        """Megabytes between the second fifth (200 to 400 of 1000 iterations) and the last."""
        self.over.set()
        self.join()
        n = len(self.seen)
        return float(np.median(self.seen[-n // 5 :]) - np.median(self.seen[n // 5 : 2 * n // 5]))


@pytest.mark.parametrize("name", ["split_gibbs", "dpi_paper"])
def test_a_thousand_iterations_stay_finite_and_in_memory(hostile, name):
    problem, start = hostile
    set_threads(1)
    memory, began = Memory(), time.monotonic()
    memory.start()
    x, facts = SAMPLERS[name](problem, load_prior("prior_small"), start, LONG, 0)
    growth = memory.growth()
    set_threads(2)
    for field in ("light", "base_color", "roughness", "metallic"):
        assert np.isfinite(getattr(x, field)).all(), field
    assert x.light.min() >= 0 and 0 <= x.base_color.min() and x.base_color.max() <= 1
    print(
        f"{name}: {time.monotonic() - began:.0f} s, memory grew by {growth:.1f} MB "
        f"at {memory.seen[-1]:.0f} MB"
    )
    assert growth < 30


def test_no_new_kernels_after_the_warm_up(hostile):
    """Every kernel of the second half of a run has been compiled in the first."""
    problem, start = hostile
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        SAMPLERS["dpi_paper"](
            problem, load_prior("prior_small"), start, LONG.model_copy(update={"steps": 40}), 0
        )
        compiled = list(dr.kernel_history([dr.KernelType.JIT]))
    half = len(compiled) // 2
    hashes = [k["hash"] for k in compiled]
    assert len(hashes) > 100 and set(hashes[half:]) <= set(hashes[:half])
    print(f"{len(set(hashes))} kernels in {len(hashes)} launches")
