"""How the draws' spread follows what the photos can tell: against roughness, against the number of
views, behind a mask.

python -m benchmarks.spread --draws 6 --lights 3 --out spread.json --chart spread.png

A sphere of known material under a light drawn from the prior, seen from evenly spread cameras, 3 %
noise (as in Figs. 9 to 11 of the paper). `split_gibbs`' turns draw the light and the base colour;
roughness and metallic are known. Spread: standard deviation between draws of log luminance over
blocks of 22.5 degrees less its mean, averaged over solid angle; beside it the same for draws of the
prior alone, which is what nothing seen would give.

`roughness`: metal from nearly a mirror to rough, from all sides, then a white dielectric of
roughness 1 (nearly Lambert's). `views`: metal of roughness VIEWED from 1 to 32 sides. `masked`: a
mirror of which one half only is seen, from one side; the light's blocks are split by whether the
seen half reflects them.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import torch

from benchmarks.geometry import even
from pipeline.base.config import Sample
from pipeline.base.files import write_json
from pipeline.base.images import luminance, write_png
from pipeline.base.progress import progress
from pipeline.base.runtime import import_open3d, set_threads
from pipeline.base.runtime import mitsuba as mi
from pipeline.geometry.mesh_io import Mesh, save_mesh, unit
from pipeline.posterior.problem import SHADE
from pipeline.posterior.random_numbers import generators
from pipeline.posterior.split_gibbs.light_codes import COMPONENTS, Decoder, Modes, ModeUnknowns
from pipeline.posterior.split_gibbs.light_moves import (
    gaussian_light,
    noise_gain,
    photo_light,
    prior_light,
    scale_of_one,
    smooth_light,
    split,
    to_modes,
    widths,
)
from pipeline.posterior.split_gibbs.likelihood import Mixer, RowLikelihood
from pipeline.posterior.split_gibbs.lobes import TRACED, LobeTable
from pipeline.posterior.split_gibbs.row_model import RowData
from pipeline.posterior.split_gibbs.sampler import (
    FIRST,
    FIRST_SWEEPS,
    KIND_SWEEPS,
    LAST,
    SMOOTH,
)
from pipeline.posterior.split_gibbs.state import (
    Noise,
    Randomness,
    RegionMaterials,
    State,
    run,
)
from pipeline.prior.gaussian import translated
from pipeline.prior.load import load_prior
from pipeline.prior.sampling import draw
from pipeline.render.envmap import directions, resample_area, solid_angles
from pipeline.render.rows import STEEP, Rows
from pipeline.render.transport import Transport

POINTS = 300
ERROR = 0.03
COLOR = 0.8
VIEWED = 0.35
Y_UP = [1, 2, 0]  # the lattice begins at the last axis
VIEWS = (1, 2, 4, 8, 16, 32)
BLOCKS = 8  # rows of the light over which luminance is averaged
WEIGHT = solid_angles(BLOCKS, 2 * BLOCKS).reshape(-1)


class Sphere:
    """Rays that see points of the unit sphere from `cameras` (v, 3), as the operator asks for them;
    `seen` limits the points.
    """

    def __init__(self, cameras: np.ndarray, seen=lambda p: np.ones(len(p), bool)):
        points = even(POINTS)[:, Y_UP]
        points = points[seen(points)]
        d = points[:, None] - cameras
        d /= np.linalg.norm(d, axis=-1, keepdims=True)
        point, view = np.nonzero((-d * points[:, None]).sum(-1) > STEEP)
        self.o, self.d, self.normal = cameras[view], d[point, view], points[point]
        self.rows = Rows(np.arange(len(point)), np.unique(point, return_inverse=True)[1])

    def centre_rays(self, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self.o[index], self.d[index]


def ball(folder: Path) -> tuple[object, Path]:
    """Mitsuba scene and file of a finely meshed unit sphere."""
    o3d = import_open3d()
    sphere, path = o3d.geometry.TriangleMesh.create_sphere(1.0, 80), folder / "ball.ply"
    vertices = np.asarray(sphere.vertices)
    save_mesh(path, Mesh(vertices, np.asarray(sphere.triangles), unit(vertices)))
    return mi.load_dict({"type": "scene", "obj": {"type": "ply", "filename": str(path)}}), path


def photographed(
    sphere: Sphere, roughness: float, metallic: float, light: np.ndarray, size: int, rng
) -> tuple[RowData, State]:
    """Rows of the sphere under `light` (h, 2h, 3), and a state of its true material; the operator
    has `size` rows.
    """
    with tempfile.TemporaryDirectory() as folder:
        scene, path = ball(Path(folder))
        transport = Transport(scene, path, sphere, sphere.rows, size, 0, 0)
    # of metals at any roughness, as the paper's
    lobes = LobeTable.trace(transport, roughness, 0, swallowed=1.0)
    n, points = len(sphere.rows.point), sphere.rows.point.max() + 1
    data = RowData.plain(transport, lobes, np.ones((n, 3)), np.zeros(points, int), 1)
    materials = RegionMaterials(
        color=np.full((1, 3), COLOR),
        spread=np.full(1, 1e-3),
        roughness=np.zeros(1, int),
        metallic=np.full(1, metallic),
    )
    state = State(
        code=torch.zeros(3, 0),
        log_scale=0.0,
        materials=materials,
        offsets=np.zeros((3, points), int),
        noise=Noise(ERROR, np.ones(n)),
        color_step=np.zeros(1),
        spread_step=np.zeros(1),
    )
    U, W = RowLikelihood.of(Mixer(data), state).predict(
        resample_area(light, size, 2 * size).reshape(-1, 3)
    )
    clean = COLOR * U + W
    noisy = clean + ERROR * (clean + SHADE) * rng.normal(size=clean.shape)
    return replace(data, observed=noisy), state


def blocks(light: np.ndarray) -> np.ndarray:
    """Log luminance of the light's blocks less its mean (BLOCKS * 2 BLOCKS,): an unknown base
    colour leaves the brightness open.
    """
    out = np.log(luminance(resample_area(light, BLOCKS, 2 * BLOCKS))).reshape(-1)
    return out - np.average(out, weights=WEIGHT)


def drawn(data: RowData, state: State, prior, settings: Sample, seed: int) -> np.ndarray:
    """Blocks of one posterior light: the sampler's light kernels, materials and noise known."""
    rng = Randomness(*generators(seed))
    mixer, gaussian = Mixer(data), load_prior(settings.start_prior)
    decoder = Decoder.onto(gaussian, data.light_rows)
    modes = Modes(gaussian, gaussian, COMPONENTS, data.light_rows)
    unknowns = ModeUnknowns.seen(modes, gaussian.flat_mean)
    state = replace(state, coefficients=torch.zeros(1, COMPONENTS))
    for _ in range(KIND_SWEEPS + FIRST_SWEEPS):
        state = run(
            rng,
            state,
            gaussian_light(mixer, decoder, unknowns),
            scale_of_one(gaussian),
            to_modes(unknowns),
        )
    code = state.code.reshape(1, 3, gaussian.height, gaussian.width)
    state = replace(state, code=translated(code, gaussian, prior).reshape(3, -1))

    decoder = Decoder.onto(prior, data.light_rows)
    modes = Modes(gaussian, prior, COMPONENTS, data.light_rows)
    for sigma in map(float, np.geomspace(SMOOTH, FIRST, settings.smooth)):
        light = smooth_light(mixer, decoder, modes, sigma, settings.label)
        state = run(rng, state, light, scale_of_one(prior))

    rhos = widths(settings.levels, FIRST, LAST, settings.stay)
    state = run(rng, state, split(float(rhos[0])))
    for rho in map(float, rhos):
        gained = Decoder.onto(prior, data.light_rows, noise_gain(prior.log_spread, rho))
        state = run(
            rng,
            state,
            photo_light(mixer, gained, rho),
            prior_light(prior, rho, settings.label),
            scale_of_one(prior),
        )
    return blocks(decoder.map(state.prior_code, 0.0))


def posterior(data: RowData, state: State, prior, settings: Sample, draws: int) -> np.ndarray:
    """Blocks of `draws` posterior lights (draws, BLOCKS * 2 BLOCKS)."""
    with torch.no_grad():
        return np.array([drawn(data, state, prior, settings, seed) for seed in range(draws)])


def facing(p: np.ndarray) -> np.ndarray:
    """The half that `masked` sees."""
    return p[:, 0] > 0.1


CASES = (
    [("roughness", r, 1.0, 16) for r in TRACED[::2] + TRACED[-1:]]
    + [("roughness Lambert", 1.0, 0.0, 16)]
    + [("views", VIEWED, 1.0, v) for v in VIEWS]
    + [("masked", TRACED[0], 1.0, 1)]
)


def measure(job: tuple) -> dict:
    """One case under one light: spread of the draws and error of their mean; spread for `masked`
    where seen and unseen.
    """
    (kind, roughness, metallic, views), k, draws, name = job
    set_threads(1)
    settings, prior = Sample(prior=name), load_prior(name)
    light = prior.decode(draw(prior, k + 1, 30, 11)[k:])[0].numpy().transpose(1, 2, 0)
    cameras = 5 * even(views)[:, Y_UP] if kind != "masked" else 5 * np.array([[0.0, 0.0, 1.0]])
    sphere = Sphere(cameras, facing) if kind == "masked" else Sphere(cameras)
    data, state = photographed(
        sphere, roughness, metallic, light, settings.light, np.random.default_rng([k, 5])
    )
    drawn, true = posterior(data, state, prior, settings, draws), blocks(light)
    spread, error = drawn.std(0, ddof=1), np.abs(drawn.mean(0) - true)
    out = {
        "kind": kind,
        "roughness": roughness,
        "metallic": metallic,
        "views": views,
        "light": k,
        "rows": len(data.observed),
        "spread": float(np.average(spread, weights=WEIGHT)),
        "error": float(np.average(error, weights=WEIGHT)),
    }
    if kind == "masked":
        mirrored = sphere.d - 2 * (sphere.d * sphere.normal).sum(1, keepdims=True) * sphere.normal
        d = directions(BLOCKS, 2 * BLOCKS).reshape(-1, 3)
        seen = (d @ mirrored.T).max(1) > np.cos(np.radians(12))
        out["spread"], out["spread_unseen"] = (
            float(np.average(spread[s], weights=WEIGHT[s])) for s in (seen, ~seen)
        )
        out["seen_share"] = float(np.average(seen, weights=WEIGHT))
    return out


def prior_spread(name: str, count: int) -> float:
    """The same figure for draws of the prior alone."""
    prior = load_prior(name)
    maps = prior.decode(draw(prior, count, 30, 12)).numpy().transpose(0, 2, 3, 1)
    return float(np.average(np.std([blocks(m) for m in maps], axis=0, ddof=1), weights=WEIGHT))


def table(rows: list[dict]) -> list[dict]:
    """Mean and standard error over lights per case."""
    out = []
    for case in CASES:
        mine = [r for r in rows if (r["kind"], r["roughness"], r["metallic"], r["views"]) == case]
        line = dict(zip(("kind", "roughness", "metallic", "views"), case))
        for key in ("spread", "spread_unseen", "error"):
            values = [r[key] for r in mine if key in r]
            if values:
                line[key] = [
                    float(np.mean(values)),
                    float(np.std(values, ddof=1) / len(values) ** 0.5) if len(values) > 1 else None,
                ]
        out.append(line)
    return out


def chart(lines: list[dict], top: float, path: Path) -> None:
    """Two panels, spread against roughness and against views, as a PNG of 900 x 400."""
    image = np.full((400, 900, 3), 255, np.uint8)
    write = lambda text, at: cv2.putText(
        image, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.45, (40, 40, 40), 1, cv2.LINE_AA
    )
    for left, kind, key, title in (
        (60, "roughness", "roughness", "roughness (last: Lambert)"),
        (510, "views", "views", "views"),
    ):
        mine = [line for line in lines if line["kind"].split()[0] == kind]
        at = [
            (left + int(340 * k / (len(mine) - 1)), 350 - int(300 * line["spread"][0] / top))
            for k, line in enumerate(mine)
        ]
        cv2.polylines(image, [np.array(at)], False, (180, 90, 20), 2, cv2.LINE_AA)
        for (x, y), line in zip(at, mine):
            bar = int(300 * (line["spread"][1] or 0) / top)
            cv2.line(image, (x, y - bar), (x, y + bar), (180, 90, 20), 1)
            write(f"{line[key]:g}" if line["kind"] == kind else "L", (x - 8, 372))
        cv2.rectangle(image, (left, 50), (left + 340, 350), (120, 120, 120), 1)
        write(f"spread against {title}; top: prior alone, {top:.2f}", (left, 30))
    write_png(path, image)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=6)
    parser.add_argument("--lights", type=int, default=3)
    parser.add_argument("--prior", default="prior_small")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path)
    parser.add_argument("--chart", type=Path)
    args = parser.parse_args()
    jobs = [(case, k, args.draws, args.prior) for case in CASES for k in range(args.lights)]
    with ProcessPoolExecutor(args.workers) as pool:
        rows = list(progress(pool.map(measure, jobs), "cases", len(jobs)))
    lines, top = table(rows), prior_spread(args.prior, 48)
    result = {
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "prior": args.prior,
        "prior_alone": top,
        "table": lines,
        "rows": rows,
    }
    print(json.dumps({"prior_alone": top, "table": lines}, indent=1))
    if args.out:
        write_json(args.out, result)
    if args.chart:
        chart(lines, top, args.chart)


if __name__ == "__main__":
    main()
