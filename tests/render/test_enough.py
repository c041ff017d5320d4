"""How many samples `samples: auto` asks for."""

import numpy as np
import pytest

from pipeline.base.enough import FIRST
from pipeline.base.images import srgb_to_linear
from pipeline.render.enough import judged
from pipeline.render.renderer import Explanation
from pipeline.render.samples import KNOWN_TO, Samples
from pipeline.render.surface_texels import SurfaceTexels


def samples(folder, deviation, count=FIRST):
    """That many samples of one colour each, sRGB, of exactly that standard deviation."""
    offsets = np.linspace(-1, 1, count)
    colors = 0.5 + deviation * offsets / offsets.std(ddof=1)
    everywhere = np.ones((4, 4), bool)
    for k, color in enumerate(colors):
        base = np.full((4, 4, 3), srgb_to_linear(np.float32(color)), np.float32)
        flat = np.full((4, 4), 0.5, np.float32)
        Explanation(np.ones((4, 8, 3), np.float32), base, flat, 0 * flat).save(folder / str(k))
        SurfaceTexels(everywhere, everywhere).save(folder / str(k))
    return Samples([folder / str(k) for k in range(count)])


@pytest.mark.parametrize(
    "times, most, asked",
    [
        (0.5, 12, FIRST),  # they agree
        (1.9, 12, 4),  # 1.9^2 = 3.6 make the mean known
        (3.0, 12, 2 * FIRST),  # nine, but so few cannot tell
        (3.0, 5, 5),
    ],
)
def test_as_many_as_make_their_mean_known(tmp_path, times, most, asked):
    found = judged(samples(tmp_path, times * KNOWN_TO), most)
    assert found["samples"] == asked and found["drawn"] == FIRST
    assert found["spread"] == pytest.approx(times * KNOWN_TO, rel=1e-3)


def test_never_fewer_than_there_are(tmp_path):
    assert judged(samples(tmp_path, 5 * KNOWN_TO, 6), 4)["samples"] == 6
