"""A thousand iterations of every sampler and optimiser on a scene made to break them: black texels,
grazing views, faces without area, a light that is black in places; and starts at the ends of what
maps and lights may hold.

`pytest -m heavy`, some forty minutes. Finite results, a data term that does not rise again, memory
that stays, and no new kernels after the warm-up.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import drjit as dr
import numpy as np
import pytest

from pipeline.base.config import Fit, Observe, Refine, Sample
from pipeline.base.images import write_exr, write_png
from pipeline.base.progress import Bar
from pipeline.base.runtime import set_threads
from pipeline.geometry.cameras import Rig, View, save_cameras
from pipeline.geometry.mesh_io import Mesh, load_mesh, save_mesh
from pipeline.photos.held_out import hold_out
from pipeline.posterior.fit import fit
from pipeline.posterior.illumination.split_sum import SplitSum
from pipeline.posterior.problem import Problem, renderer_seed
from pipeline.posterior.refine import refine, units
from pipeline.posterior.samplers import SAMPLERS
from pipeline.prior.load import load_prior
from pipeline.render.observe import Observations, make_observations
from pipeline.render.renderer import Explanation, Renderer
from tests.conftest import look_at
from tests.render.pictures import render_view
from tests.seeds import numpy_rng

pytestmark = pytest.mark.heavy
LONG = Sample(
    steps=1000,
    pixels=2000,
    spp=4,
    texture=32,
    smooth=5,
    levels=990,
    stay=5,
    points=60,
    views=4,
    light=16,
    region_steps=10,
    start_points=25,
)
# factor of the data term: medians over a fifth of the steps differ by some hundredths between seeds
LATE_RISE = 1.15
# on this scene the data term of these does rise (docs/stability.md, "Endurance"): the published
# samplers with their own rates and weights, which return where they end
RISES_LATE = ("dpi_paper", "dpi_code", "sds")
NIGHT = 1e-4  # radiance: a fit of black photos begins at thrice that


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
    light = numpy_rng(0).gamma(0.3, 2.0, (32, 64, 3)).astype(np.float32)
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
    marked = hold_out([{"name": v.name, "split": "fit"} for v in views], Observe())
    views = [replace(v, split=p["split"]) for v, p in zip(views, marked)]
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


def assert_in_bounds(x: Explanation) -> None:
    for field in ("light", "base_color", "roughness", "metallic"):
        assert np.isfinite(getattr(x, field)).all(), field
    assert x.light.min() >= 0
    for field in ("base_color", "roughness", "metallic"):
        assert getattr(x, field).min() >= 0 and getattr(x, field).max() <= 1, field


def in_memory(run: Callable[[], Explanation], name: str) -> Explanation:
    """Its result, from one thread: finite, and resident memory that stays."""
    set_threads(1)
    memory, began = Memory(), time.monotonic()
    memory.start()
    x = run()
    growth = memory.growth()
    set_threads(2)
    assert_in_bounds(x)
    print(
        f"{name}: {time.monotonic() - began:.0f} s, memory grew by {growth:.1f} MB "
        f"at {memory.seen[-1]:.0f} MB"
    )
    assert growth < 30
    return x


class DataTerm:
    """The data term at every gradient that is taken, and the problem that took it: some samplers
    shade otherwise than the problem they are given.
    """

    def __init__(self):
        self.losses: list[float] = []
        self.problem: Problem | None = None

    def medians(self) -> list[float]:
        """Of every fifth of the steps: a step's is that of a few pixels."""
        fifths = [float(np.median(part)) for part in np.array_split(self.losses, 5)]
        print("medians of the data term:", *(f"{m:.4f}" for m in fifths))
        return fifths

    def at(self, x: Explanation, pixels: int, spp: int) -> float:
        """Median over as many steps as a fifth has, all at `x`."""
        fifth, rng = len(self.losses) // 5, numpy_rng(1)
        for _ in range(fifth):
            batch = self.problem.batch(pixels, spp, rng)
            self.problem.gradient(x, batch, renderer_seed(rng))
        here = float(np.median(self.losses[-fifth:]))
        print(f"of what is returned: {here:.4f}")
        return here


@pytest.fixture
def data_term(monkeypatch) -> DataTerm:
    seen = DataTerm()

    def note(kind: type[Problem]) -> None:
        gradient = kind.gradient

        def noted(self, *arguments):
            result = gradient(self, *arguments)
            seen.losses.append(result.loss)
            seen.problem = self
            return result

        monkeypatch.setattr(kind, "gradient", noted)

    note(Problem)
    note(SplitSum)
    return seen


@pytest.mark.parametrize("name", sorted(set(SAMPLERS) - {"map", "gaussian"}))
def test_a_thousand_iterations_stay_finite_and_in_memory(hostile, data_term, name):
    """`map` has no iterations, `gaussian` a fixed handful of sweeps. What is returned explains the
    photos as well as the best fifth of the steps did."""
    problem, start = hostile
    prior = load_prior("prior_small")
    x = in_memory(lambda: SAMPLERS[name](problem, prior, start, LONG, 0)[0], name)
    if name != "split_gibbs":  # whose rows come from the operator, not from gradients
        assert len(data_term.losses) >= 1000
        fifths = data_term.medians()
        if name not in RISES_LATE:
            assert data_term.at(x, LONG.pixels, LONG.spp) <= LATE_RISE * min(fifths)


def test_a_thousand_steps_of_the_fit_and_of_the_refinement(hostile, data_term):
    problem, start = hostile
    fitted = Fit(steps=1000, pixels=400, texture=32)
    x = in_memory(lambda: fit(problem, fitted)[0], "fit")
    fifths = data_term.medians()
    assert data_term.at(x, fitted.pixels, fitted.spp) <= LATE_RISE * min(fifths)

    data_term.losses.clear()
    refined = Refine(steps=1000, pixels=400, spp=2, texture=32)
    run = lambda: refine(problem, start, refined, 0, Bar("refine", units(refined)))[0]
    in_memory(run, "refine")
    *before, last = data_term.medians()
    assert last <= LATE_RISE * min(before)


def at_a_bound(start: Explanation, which: str) -> Explanation:
    """The fit with one of its parts at the end of what it may hold."""
    ends = {
        "mirror": {"roughness": 0.0, "metallic": 1.0},
        "chalk": {"roughness": 1.0, "metallic": 0.0},
        "black": {"base_color": 0.0},
        "white": {"base_color": 1.0},
    }
    if which in ends:
        return replace(
            start,
            **{k: np.full_like(getattr(start, k), value) for k, value in ends[which].items()},
        )
    light = np.zeros_like(start.light)
    if which == "lamp":
        light[len(light) // 4, len(light) // 2] = 1e6
    else:
        light[:] = NIGHT
    return replace(start, light=light)


@pytest.mark.parametrize("name", sorted(SAMPLERS))
@pytest.mark.parametrize("which", ["mirror", "chalk", "black", "white", "lamp", "night"])
def test_samplers_begin_at_any_bound(hostile, which, name):
    """Roughness and metallic at their bounds, black, white, one pixel of 1e6, next to no light."""
    problem, start = hostile
    short = LONG.model_copy(update={"steps": 12, "smooth": 2, "levels": 4, "stay": 1})
    first = at_a_bound(start, which)
    assert_in_bounds(SAMPLERS[name](problem, load_prior("prior_small"), first, short, 0)[0])


@pytest.mark.parametrize("rate", [1e-9, 1.0])
def test_the_ends_of_the_learning_rate(hostile, rate):
    """Next to none moves nothing, and the greatest that may be configured stays finite."""
    problem, start = hostile
    settings = Fit(steps=60, pixels=400, texture=32, learning_rate=rate)
    x = fit(problem, settings)[0]
    assert_in_bounds(x)
    if rate < 1:
        assert np.ptp(x.light) <= 1e-4 * x.light.max() and np.ptp(x.roughness) <= 1e-4


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
