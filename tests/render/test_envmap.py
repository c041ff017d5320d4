import drjit as dr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.base.errors import InputError
from pipeline.base.runtime import mitsuba as mi
from pipeline.render.envmap import (
    check_lat_long,
    directions,
    mitsuba_gradient,
    resample_area,
    solid_angles,
    to_mitsuba,
    uv_from_direction,
    yaw_roll,
)
from tests.seeds import numpy_rng


def test_directions_and_uv_are_inverse():
    u = (np.arange(32) + 0.5) / 32
    v = (np.arange(16) + 0.5) / 16
    expected = np.stack(np.meshgrid(u, v), -1)
    assert np.allclose(uv_from_direction(directions(16, 32)), expected, atol=1e-9)


def test_row_zero_is_up_and_middle_column_looks_along_z():
    centres = directions(64, 128)
    assert centres[0, :, 1].min() > 0.99
    x, _, z = centres[32, 63:65].mean(0)
    assert np.allclose([x / abs(z), z / abs(z)], [0, 1], atol=0.05)


def test_solid_angles_sum_to_the_sphere():
    assert np.isclose(solid_angles(13, 26).sum(), 4 * np.pi, rtol=1e-12)


@settings(max_examples=15, deadline=None)
@given(
    st.integers(0, 47), st.integers(0, 95), st.sampled_from([(8, 16), (12, 24), (7, 14), (32, 64)])
)
def test_resampling_keeps_the_flux_of_a_sun(row, column, size):
    env = np.full((48, 96, 3), 0.3, np.float32)
    env[row, column] = 5000
    small = resample_area(env, *size)
    flux = lambda e: (e * solid_angles(*e.shape[:2])[..., None]).sum()
    assert np.isclose(flux(small), flux(env), rtol=1e-4)


def test_mitsuba_sees_each_pixel_where_directions_says():
    """A lookup in Mitsuba's envmap along our direction returns our pixel, at the seam too."""
    rng = numpy_rng(0)
    env = rng.uniform(0.1, 1, (8, 16, 3)).astype(np.float32)
    emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(to_mitsuba(env)[:, 1:-1])})
    d = directions(8, 16).reshape(-1, 3)
    si = dr.zeros(mi.SurfaceInteraction3f, len(d))
    si.wi = -mi.Vector3f(np.ascontiguousarray(d.T, np.float32))
    seen = np.array(emitter.eval(si)).T.reshape(8, 16, 3)
    assert np.allclose(seen, env, rtol=1e-3, atol=1e-4)


def test_border_columns_come_from_the_other_side():
    """The fourth defect of the published code: its wrap column repeats the last column instead of
    the first.
    """
    env = numpy_rng(1).random((4, 8, 3)).astype(np.float32)
    data = to_mitsuba(env)
    assert (data[1::2, 0] == env[:, -1]).all() and (data[1::2, -1] == env[:, 0]).all()
    parameters = mi.traverse(mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(data[:, 1:-1])}))
    assert np.allclose(np.array(parameters["data"]), data, rtol=1e-5)


def test_gradient_is_the_adjoint():
    rng = numpy_rng(5)
    env = rng.random((4, 8, 3))
    gradient = rng.random((9, 10, 3))
    gradient[:, [0, -1]] = 0  # Mitsuba leaves no gradient in the border columns
    assert np.isclose((to_mitsuba(env) * gradient).sum(), (env * mitsuba_gradient(gradient)).sum())


def test_gradient_is_mitsubas_derivative_at_the_seam_too():
    """Back-propagated through Mitsuba's lookup, then `mitsuba_gradient`: equals central differences
    in the map.
    """
    rng = numpy_rng(7)
    env = rng.uniform(0.1, 1, (4, 8, 3)).astype(np.float32)
    looked = rng.normal(size=(400, 3))
    looked = looked / np.linalg.norm(looked, axis=1, keepdims=True)
    weights = rng.normal(size=(3, 400)).astype(np.float32)
    emitter = mi.load_dict({"type": "envmap", "bitmap": mi.Bitmap(to_mitsuba(env)[:, 1:-1])})
    parameters = mi.traverse(emitter)
    si = dr.zeros(mi.SurfaceInteraction3f, len(looked))
    si.wi = -mi.Vector3f(np.ascontiguousarray(looked.T, np.float32))

    def weighted_sum(data):
        parameters["data"] = data
        parameters.update()
        seen = emitter.eval(si)
        return dr.sum(sum(seen[c] * mi.Float(weights[c]) for c in range(3)))

    data = mi.TensorXf(to_mitsuba(env))
    dr.enable_grad(data)
    dr.backward(weighted_sum(data))
    found = mitsuba_gradient(np.array(dr.grad(data)))

    value = lambda radiance: float(
        np.array(weighted_sum(mi.TensorXf(to_mitsuba(radiance)))).ravel()[0]
    )
    for at in [(1, 0, 0), (2, 7, 1), (0, 3, 2), (3, 0, 0), (1, 4, 1)]:
        step = np.zeros_like(env)
        step[at] = 0.05
        expected = (value(env + step) - value(env - step)) / 0.1
        assert np.isclose(found[at], expected, rtol=1e-3, atol=1e-3)


def test_roll_is_inverted_by_its_opposite():
    env = numpy_rng(2).random((4, 8, 3))
    assert (yaw_roll(yaw_roll(env, 5), -5) == env).all()


@pytest.mark.parametrize(
    "env, fact",
    [
        (np.ones((8, 8, 3)), "2:1"),
        (np.ones((8, 16)), "three channels"),
        (np.full((8, 16, 3), np.nan), "NaN"),
        (-np.ones((8, 16, 3)), "negative"),
    ],
)
def test_unusable_maps_are_named(env, fact):
    with pytest.raises(InputError, match=fact):
        check_lat_long(env, "somewhere.exr")
