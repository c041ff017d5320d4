"""The linear operator against the path tracer, and the likelihood against dense linear algebra."""

from copy import copy
from types import SimpleNamespace

import drjit as dr
import numpy as np
import pytest
import torch
from scipy import integrate, stats

from pipeline.base.runtime import mitsuba as mi
from pipeline.geometry.cameras import Rig, View, save_cameras
from pipeline.posterior.problem import ALBEDO_MAX, SHADE
from pipeline.posterior.split_gibbs.likelihood import (
    BETWEEN,
    LEVELS,
    NU,
    Lobes,
    Photos,
    Theta,
    channel_effect,
    contrast,
    design_effect,
    mix,
)
from pipeline.render.observe import Observations, Tracer
from pipeline.render.renderer import Explanation, Renderer
from pipeline.render.transport import LOBES, Rows, Transport, bilinear, choose_rows, lobe
from tests.conftest import look_at, save_surface

MATERIALS = [
    (0.15, 0.0, 0.5),
    (0.7, 0.0, 0.8),
    (0.25, 1.0, 0.7),
    (0.5, 0.4, 0.3),
]  # roughness, metallic, base colour


def seen(mesh, radius, height, folder) -> Observations:
    """What a ring of 8 cameras sees of a mesh around the origin."""
    views, columns, tracer = [], {"view": [], "pixel": [], "cosine": []}, Tracer(mesh)
    for k in range(8):
        a = 2 * np.pi * k / 8
        views.append(
            View(
                f"v{k}",
                "",
                48,
                48,
                70,
                70,
                24,
                24,
                look_at([radius * np.sin(a), height, radius * np.cos(a)]),
            )
        )
    save_cameras(folder / "cameras.json", Rig(views, np.zeros(3), 0.8, "transforms.json"))
    for k, v in enumerate(views):
        rows, cols = np.mgrid[0:48, 0:48].reshape(2, -1)
        _, cosine, hit = tracer.hit(*v.rays(np.stack([cols + 0.5, rows + 0.5], -1)))
        columns["view"].append(np.full(hit.sum(), k))
        columns["pixel"].append(np.stack([cols, rows], -1)[hit])
        columns["cosine"].append(cosine[hit])
    table = {n: np.concatenate(c) for n, c in columns.items()}
    n = len(table["view"])
    np.savez(
        folder / "observations.npz",
        **table,
        rgb=np.zeros((n, 3), np.float32),
        clipped=np.zeros(n, bool),
        uv=np.zeros((n, 2), np.float32),
        views=np.array([v.name for v in views]),
        held_out=np.array([], str),
    )
    return Observations(folder, folder / "cameras.json")


def uniform(light, roughness, metallic, base_color) -> Explanation:
    """One material all over, textures of side 32."""
    constant = lambda v, *shape: np.full((32, 32) + shape, v, np.float32)
    return Explanation(light, constant(base_color, 3), constant(roughness), constant(metallic))


def traced(renderer, observations, rows, spp) -> np.ndarray:
    """Radiance (n, 3) of the rows' rays by the path tracer."""
    o, d = observations.centre_rays(np.tile(rows.observation, spp))
    return renderer.radiance(o, d, 0).reshape(spp, -1, 3).mean(0)


@pytest.fixture(scope="module")
def scene(ball, tmp_path_factory):
    """Renderer, observations of the ball by a ring of cameras under a light with a lamp, and that
    light.
    """
    light = np.random.default_rng(1).uniform(0.2, 1.0, (8, 16, 3)).astype(np.float32)
    light[2, 5] = 12
    return (
        Renderer(ball / "mesh_uv.ply", 32, 8, 4),
        seen(ball / "mesh_uv.ply", 3, 1.2, tmp_path_factory.mktemp("seen")),
        light,
    )


@pytest.fixture(scope="module")
def bowl(tmp_path_factory):
    """A thick bowl that is open upwards, seen from above: renderer, observations."""
    folder, axis = tmp_path_factory.mktemp("bowl"), np.linspace(-0.7, 0.7, 44)
    grid = np.meshgrid(axis, axis, axis, indexing="ij")
    radius = np.sqrt(sum(g**2 for g in grid))
    save_surface(folder, np.maximum(np.maximum(radius - 0.6, 0.42 - radius), grid[1] - 0.1), axis)
    return Renderer(folder / "mesh_uv.ply", 32, 8, 6), seen(
        folder / "mesh_uv.ply", 1.2, 2.4, folder
    )


@pytest.fixture(scope="module")
def transport(scene, ball):
    renderer, observations, _ = scene
    rows = choose_rows(observations, renderer.scene, 40, 3, 0)
    return Transport(renderer.scene, ball / "mesh_uv.ply", observations, rows, 8, 20, 0)


def test_lobes_make_the_principled_bsdf():
    """f = (1 - m)(a A + S) + m (a M1 + (1 - a) M0) to rounding."""
    rng, n = np.random.default_rng(0), 2000
    wi, wo = rng.normal(size=(2, 3, n))
    wi, wo = (w / np.linalg.norm(w, axis=0) for w in (wi, wo))
    wi[2], wo[2] = abs(wi[2]), abs(wo[2])
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi, out = mi.Vector3f(wi.astype(np.float32)), mi.Vector3f(wo.astype(np.float32))
    value = lambda m, a, r: np.array(lobe(m, a, r).eval(mi.BSDFContext(), si, out)[0])
    for r, m, a in MATERIALS:
        black = value(0.0, 0.0, r)
        parts = np.stack(
            [value(0.0, 1.0, r) - black, black, value(1.0, 1.0, r), value(1.0, 0.0, r)]
        )
        U, W = mix(parts, m)
        np.testing.assert_allclose(a * U + W, value(m, a, r), rtol=2e-3, atol=2e-5)
    assert len(LOBES) == 4


def test_rows_are_grouped_by_point_one_pixel_per_view(scene, transport):
    rows, observations = transport.rows, scene[1]
    assert (np.diff(rows.point) >= 0).all() and len(rows.starts) == 40
    spread = [np.ptp(transport.position[rows.point == p], axis=0).max() for p in range(40)]
    assert max(spread) < 0.15  # pixels are about .04 wide at the ball
    members = np.split(rows.patch.indices, rows.patch.indptr[1:-1])
    assert np.allclose(rows.patch.sum(1), 1) and np.mean([len(m) for m in members]) > 4
    assert all(
        (observations.view[m] == observations.view[centre]).all() and centre in m
        for m, centre in zip(members, rows.observation)
    )
    for p in range(40):
        seen = observations.view[rows.observation[rows.point == p]]
        assert 1 <= len(seen) <= 3 and len(set(seen)) == len(seen)


def test_bilinear_weights_reproduce_a_smooth_light():
    from pipeline.render.envmap import directions

    d = directions(8, 16).reshape(-1, 3)
    index, weight = bilinear(d, 8)
    values = np.random.default_rng(0).normal(size=128)
    np.testing.assert_allclose((values[index] * weight).sum(1), values, atol=1e-6)  # pixel centres
    assert np.allclose(bilinear(np.random.default_rng(1).normal(size=(50, 3)), 8)[1].sum(1), 1)


@pytest.mark.parametrize("r,m,a", MATERIALS)
def test_operator_equals_path_tracer(scene, transport, r, m, a):
    """A convex ball has direct light only; differences are Monte-Carlo error of both."""
    renderer, observations, light = scene
    F, off = transport.at(r, 1)
    U, W = mix(F @ light.reshape(-1, 3), m)
    renderer.set(uniform(light, r, m, a))
    truth = traced(renderer, observations, transport.rows, 512)
    assert abs((a * U + W).mean() / truth.mean() - 1) < 0.02
    assert np.abs(a * U + W - truth).mean() / truth.mean() < 0.06
    assert off[0].nnz < 0.01 * len(truth) * len(transport.d)  # next to no light off itself


def test_a_lamp_in_one_pixel_is_as_bright_as_it_is(scene, ball):
    """One jittered direction per cell must not change what a light pixel gives: chalk under lamps
    of one pixel, the light as fine as the grid.
    """
    _, observations, _ = scene
    renderer = Renderer(ball / "mesh_uv.ply", 32, 32, 2)
    rows = choose_rows(observations, renderer.scene, 40, 3, 0)
    transport = Transport(renderer.scene, ball / "mesh_uv.ply", observations, rows, 32, 20, 0)
    U, W = mix(transport.at(1.0, 1)[0], 0.0)
    error = []
    for lamp in np.random.default_rng(3).integers(6 * 64, 16 * 64, 8):
        light = np.full((32, 64, 3), 1e-3, np.float32)
        light.reshape(-1, 3)[lamp] = 100
        renderer.set(uniform(light, 1.0, 0.0, 0.5))
        truth = traced(renderer, observations, rows, 1024)[:, 0]
        error.append((0.5 * U + W)[:, lamp].mean() * 100 / truth.mean() - 1)
    assert np.abs(error).mean() < 0.03


@pytest.mark.parametrize(
    "level,m,a", [(8, 0.0, 0.9), (14, 0.5, 0.9), (24, 0.0, 0.3), (24, 0.5, 0.9), (24, 1.0, 0.9)]
)
def test_light_off_the_object_equals_the_path_tracers(bowl, level, m, a):
    """A bowl lights itself: up to a third of what is seen. A rough metal gives off much less than
    its base colour says.
    """
    renderer, observations = bowl
    light = np.random.default_rng(1).uniform(0.2, 1.0, (8, 16, 3)).astype(np.float32)
    rows = choose_rows(observations, renderer.scene, 80, 3, 0)
    transport = Transport(renderer.scene, renderer.mesh, observations, rows, 8, 40, 0)
    n = len(rows.point)
    lobes = Lobes(transport, 0.1, 0, swallowed=1.0)  # two of the metals are rougher than there are
    photos = Photos(
        transport,
        lobes,
        np.ones((n, 3)),
        np.zeros(n, bool),
        np.zeros(80, int),
        renderer.max_depth - 1,
    )
    photos.set(Theta(np.full((1, 3), a), np.array([0.01]), np.array([level]), np.array([m])))
    U, W = photos.predict(light.reshape(-1, 3))
    renderer.set(uniform(light, photos.lobes.levels[level], m, a))
    truth = traced(renderer, observations, rows, 512)
    assert abs((a * U + W).mean() / truth.mean() - 1) < 0.03


def test_lobes_between_the_traced_ones(scene, transport):
    """Highlights of interpolated lobes against traced ones: nearer than either neighbour."""
    light, lobes = scene[2].reshape(-1, 3), Lobes(transport, 0.2, 0)
    highlights = lambda F: np.asarray(F)[1:3] @ light
    for level in (6, 10, 18):
        truth = highlights(transport.at(lobes.levels[level], 5)[0])
        error = lambda F, truth=truth: np.sqrt(((highlights(F) / truth - 1) ** 2).mean())
        beside = [error(lobes.direct[level // BETWEEN + k]) for k in (0, 1)]
        assert error(lobes.at(level)) < 0.1 and error(lobes.at(level)) < 0.7 * min(beside)
    assert np.allclose(lobes.levels[::BETWEEN], LEVELS[2:]) and len(lobes.levels) == 5 * BETWEEN + 1
    nodes = np.random.default_rng(0).random((len(transport.node_position), 3))
    np.testing.assert_allclose(
        lobes.apply(light, nodes)[6],
        lobes.at(6).numpy() @ light
        + [0.5 * (a @ nodes + b @ nodes) for a, b in zip(lobes.off[1], lobes.off[2])],
        rtol=1e-4,
    )


def test_metals_are_no_rougher_than_their_lobe_keeps_light(transport):
    """All of METALLIC up to roughness .65, where a white metal reflects .75; at 1, with .38, no
    more than .35; a point's offset leads no further.
    """
    lobes = Lobes(transport, 0.2, 0)
    most = dict(zip(lobes.levels, lobes.most_metallic))
    assert (
        most[0.25] == most[0.65] == 1
        and most[1.0] == 0.35
        and (np.diff(lobes.most_metallic) <= 0).all()
    )
    photos = SimpleNamespace(
        region=np.zeros(2, int), offset=np.array([[0, 0], [0, 9]]), lobes=lobes
    )
    rough = Theta(
        np.full((1, 3), 0.5), np.array([0.1]), np.array([len(most) - 1]), np.array([0.05])
    )
    np.testing.assert_allclose(Photos.point_materials(photos, rough)[1], [0.05, 0.35])


def test_light_between_parts_adds_up():
    """Two facing nodes that each see half the light: the series of bounces against the closed
    form.
    """
    t = object.__new__(Transport)
    t.node_point, t.sees = np.array([0, 1]), np.array([[0.5], [0.5]])
    t.between = np.array([[0.0, 0.5], [0.5, 0.0]])
    B = t.exitant(np.ones((1, 3)), np.full((2, 3), 0.6), 60)
    np.testing.assert_allclose(B, 0.3 / (1 - 0.3), atol=1e-9)
    np.testing.assert_allclose(t.exitant(np.ones((1, 3)), np.full((2, 3), 0.6), 1), 0.3)


@pytest.fixture(scope="module")
def photos(transport):
    rng = np.random.default_rng(2)
    lobes = Lobes(transport, 0.2, 0)
    n = len(transport.rows.point)
    out = Photos(
        transport,
        lobes,
        rng.uniform(0.1, 1.0, (n, 3)),
        np.zeros(n, bool),
        rng.integers(0, 2, 40),
        1,
    )
    out.eta, out.kappa, out.weight, out.share = (
        0.2,
        1.7,
        rng.uniform(0.5, 2, n),
        rng.uniform(0.3, 2, 40),
    )
    out.ceiling = ALBEDO_MAX / rng.uniform(1, 1.6, (40, 3))
    out.set(
        Theta(
            rng.uniform(0.2, 0.7, (2, 3)),
            np.array([0.1, 0.5]),
            np.array([6, 16]),
            np.array([0.0, 0.8]),
        )
    )
    return out


def dense_value(photos, light) -> float:
    """log of the integral of N(a; mu, v) on [0, ceiling] times N(y; a U + W, D kappa / share) over
    a, without the noise's constants.
    """
    (U, W), total = photos.predict(light), 0.0
    for p in range(len(photos.region)):
        k, r = photos.rows.point == p, photos.region[p]
        for c in range(3):
            mu, a = photos.theta.mu[r, c], np.linspace(0, photos.ceiling[p, c], 8001)
            prior = stats.norm(mu, photos.theta.tau[r] * mu)
            D = (
                photos.kappa
                / photos.share[p]
                * (photos.eta * (photos.observed[k, c] + SHADE)) ** 2
                / photos.weight[k]
            )
            e = photos.observed[k, c] - a[:, None] * U[k, c] - W[k, c]
            log = (
                -0.5 * (e**2 / D).sum(1) + prior.logpdf(a) - np.log(prior.cdf(a[-1]) - prior.cdf(0))
            )
            total += log.max() + np.log(np.trapezoid(np.exp(log - log.max()), a))
    return total


def test_colour_is_integrated_out_exactly(photos, scene):
    light = scene[2].reshape(-1, 3).astype(float)
    assert (
        abs(photos.value(light) - dense_value(photos, light))
        < 1e-6 * abs(photos.value(light)) + 1e-6
    )


def test_contrast_is_that_of_the_brightest_tenth(transport, scene):
    """Pixels of a patch that are all alike, and a fifth of them three times as bright."""
    rows, rgb = transport.rows, np.full((len(scene[1]), 3), 0.2)
    np.testing.assert_allclose(contrast(rows, rgb), 1)
    rgb[np.random.default_rng(0).random(len(rgb)) < 0.2] = 0.6  # mean .28
    assert 1.7 < np.median(contrast(rows, rgb)) < 2.6


def test_whitened_rows_have_the_likelihoods_curvature(photos, scene):
    """Without spread of colour the likelihood is quadratic in the light, and -|y - T L|^2 / 2 is
    all of it.
    """
    flat = photos.theta.copy()
    flat.tau[:] = 1e-6
    kept, _ = photos.theta, photos.set(flat)
    light, other = (
        scene[2].reshape(-1, 3).astype(float),
        np.random.default_rng(5).uniform(0.1, 2, (128, 3)),
    )
    T, r, _ = photos.whitened(light)
    square = lambda L: (
        -0.5
        * float(
            (r - torch.einsum("cnm,cm->cn", T, torch.from_numpy((L - light).T.astype(np.float32))))
            .square()
            .sum()
        )
    )
    assert abs(
        (square(light) - square(other)) - (photos.value(light) - photos.value(other))
    ) < 1e-3 * abs(photos.value(other))
    photos.set(kept)


def test_saturated_rows_are_lower_bounds(photos, scene):
    """Colours known: under a light too dark they count like any row; under one so bright that they
    are explained they say nothing, nor does their slope.
    """
    light, kept, theta = scene[2].reshape(-1, 3).astype(float), photos.theta, photos.theta.copy()
    theta.tau[:] = 1e-6
    photos.set(theta)
    plain = {
        factor: (photos.value(factor * light), photos.residual(factor * light))
        for factor in (1e-3, 1e3)
    }
    photos.clipped = np.arange(len(photos.observed)) % 3 == 0
    assert np.isclose(photos.value(1e-3 * light), plain[1e-3][0]) and torch.allclose(
        photos.residual(1e-3 * light), plain[1e-3][1]
    )
    assert (photos.residual(1e3 * light)[:, photos.clipped] == 0).all() and (
        photos.residual(1e3 * light)[:, ~photos.clipped] != 0
    ).all()
    before, ones = photos.value(1e3 * light), torch.ones(3, len(photos.observed))
    slope = photos.adjoint(1e3 * light, ones)[0]
    only = photos.adjoint(1e3 * light, ones * torch.from_numpy(~photos.clipped))[0]
    assert torch.allclose(slope, only)
    weight, photos.weight = (
        photos.weight,
        np.where(photos.clipped, photos.weight * 2, photos.weight),
    )
    assert not np.isclose(photos.value(1e-3 * light), plain[1e-3][0])
    assert abs(photos.value(1e3 * light) - before) < 1e-3 * abs(before)  # the determinant alone
    photos.clipped, photos.weight = np.zeros(len(weight), bool), weight
    photos.set(kept)


def uniform_p(values: np.ndarray) -> float:
    """p-value of Kolmogorov and Smirnov's test that values are uniform on [0, 1]."""
    return float(stats.kstest(np.ravel(values), "uniform").pvalue)


def test_colours_are_drawn_from_their_conditional(photos, scene):
    """Every point's colour through the cumulated density of N(a; mu, v) N(y; a U + W, D kappa) on
    [0, ceiling], summed over a grid: uniform over all points and draws.
    """
    rng, (U, W) = np.random.default_rng(0), photos.predict(scene[2].reshape(-1, 3).astype(float))
    draws = np.stack([photos.draw_colour(U, W, photos.theta, rng) for _ in range(100)])
    assert draws.min() >= 0 and (draws <= photos.ceiling).all()
    uniform = np.empty_like(draws)
    for p, c in np.ndindex(draws.shape[1:]):
        k, r = photos.rows.point == p, photos.region[p]
        a = np.linspace(0, photos.ceiling[p, c], 4001)
        mu, observed = photos.theta.mu[r, c], photos.observed[k, c]
        D = photos.kappa * (photos.eta * (observed + SHADE)) ** 2 / photos.weight[k]
        e = observed - a[:, None] * U[k, c] - W[k, c]
        log = -0.5 * ((e**2 / D).sum(1) + ((a - mu) / (photos.theta.tau[r] * mu)) ** 2)
        below = integrate.cumulative_trapezoid(np.exp(log - log.max()), a, initial=0)
        uniform[:, p, c] = np.interp(draws[:, p, c], a, below / below[-1])
    assert uniform_p(uniform) > 0.01


def drawn_noise(relative, free, clipped, eta: float, kappa: float, rng) -> tuple:
    """eta and lambda (n,) after a draw, for squared relative residuals (n, 3), of which `free` are
    those of explained saturated rows.
    """
    photos = SimpleNamespace(
        misfit=lambda *_: (np.where(free, 0, relative), free), clipped=clipped, eta=eta, kappa=kappa
    )
    Photos.draw_noise(photos, None, None, None, rng)
    return photos.eta, photos.weight


@pytest.mark.parametrize("kappa", [1.0, 2.5])
def test_noise_is_drawn_from_its_conditionals(kappa):
    """lambda_i ~ Gamma((NU + channels that count) / 2, (NU + sum of their squares / eta^2) / 2),
    then eta^2 of the rows that are not saturated ~ inverse gamma, its prior's shape 1 and scale
    1e-4: both through their distribution functions, uniform over 4000 draws.
    """
    rng, eta = np.random.default_rng(0), 0.02
    relative = eta**2 * rng.chisquare(1, size=(5, 3))
    clipped = np.arange(5) >= 3
    free = clipped[:, None] & np.array([False, True, True])  # explained in two channels
    free[4] = True
    draws = [drawn_noise(relative, free, clipped, eta, kappa, rng) for _ in range(4000)]
    etas, weights = (np.array(column) for column in zip(*draws))

    counted = np.where(free, 0, relative)
    shape, rate = (NU + (~free).sum(1)) / 2, (NU + counted.sum(1) / eta**2) / 2
    uniform = stats.gamma.cdf(weights, shape, scale=1 / rate)
    assert min(uniform_p(row) for row in uniform.T) > 0.01 / 5

    square = (weights[:, :3] * relative[:3].sum(1)).sum(1) / kappa
    law = stats.invgamma(9 / (2 * kappa) + 1, scale=square / 2 + 1e-4)
    assert uniform_p(law.cdf(etas**2)) > 0.01


def test_drawn_colours_and_noise_recover_the_truth(photos, scene):
    """Rows made from known colours and Student's t noise: the truth lies among the draws of colours
    and noise in turn, as far from their mean as they spread.
    """
    rng, light = np.random.default_rng(0), scene[2].reshape(-1, 3).astype(float)
    photos, (U, W) = copy(photos), photos.predict(light)
    spread = photos.theta.tau[photos.region, None]
    truth = photos.theta.mu[photos.region] * (1 + spread * rng.normal(size=(40, 3)))
    truth = np.clip(truth, 0.02, 0.9 * photos.ceiling)
    clean = truth[photos.rows.point] * U + W
    weight = rng.gamma(NU / 2, 2 / NU, size=(len(clean), 1))
    error = 0.05 * rng.normal(size=clean.shape) / np.sqrt(weight)
    photos.observed = (clean + SHADE * error) / (1 - error)

    photos.kappa, photos.weight, photos.eta = 1.0, np.ones(len(clean)), 0.3
    colours, etas = [], []
    for _ in range(120):
        colours.append(photos.draw_colour(U, W, photos.theta, rng))
        photos.draw_noise(U, W, colours[-1], rng)
        etas.append(photos.eta)
    colours, etas = np.array(colours[20:]), np.array(etas[20:])
    assert 0.85 < ((truth - colours.mean(0)) / colours.std(0)).std() < 1.15
    assert np.median(np.abs(colours.mean(0) / truth - 1)) < 0.06
    assert abs(etas.mean() - 0.05) < 3 * etas.std() and etas.std() < 0.1 * etas.mean()


def test_design_effect_sees_correlation():
    """Independent residuals count fully; residuals shared by neighbours count once."""
    rng = np.random.default_rng(0)
    position = np.concatenate([rng.uniform(0, 1, (400, 2)), np.zeros((400, 1))], 1)
    rows, view = Rows(np.arange(400), np.arange(400)), np.zeros(400, int)
    alone = design_effect(rows, position, view, rng.normal(size=400))
    smooth = np.sin(7 * position[:, 0]) + np.cos(5 * position[:, 1])
    assert alone < 1.5 and design_effect(rows, position, view, smooth) > 8
    white = rng.normal(size=(3000, 3))
    assert channel_effect(white) < 1.1 and channel_effect(white[:, :1] + 0.1 * white) > 2.8
