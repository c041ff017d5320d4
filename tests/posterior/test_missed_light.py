"""Light in details that are finer than the cells of interpolated shading."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.posterior import missed_light
from pipeline.posterior.map_pixels import MapPixels
from pipeline.posterior.missed_light import paths_for, single_paths, with_missed_light
from pipeline.posterior.shading import Shading, split_picture
from pipeline.posterior.textures import gather, seen_texels
from tests.seeds import numpy_rng

PATHS = 3000  # for a texel: much more than its surroundings count as


@pytest.fixture(scope="module")
def matt(toy):
    """The toy's truth without gloss."""
    return replace(toy[1], roughness=np.ones_like(toy[1].roughness))


@pytest.fixture(scope="module")
def shading(problem, matt):
    """D and S of all pixels, by 64 paths."""
    everywhere = np.arange(len(problem.observations))
    scaled, rest = split_picture(problem, matt, everywhere, 64, numpy_rng(3))
    return Shading(scaled, rest, gather(matt.metallic, problem.observations.uv))


def with_metal(problem, shading: Shading, metallic: np.ndarray) -> Shading:
    """Of a map of metallic (t, t)."""
    return replace(shading, metallic=gather(metallic, problem.observations.uv))


def on_map(problem, side: int = 32) -> MapPixels:
    return MapPixels(problem.observations, side)


def by_texel(problem, values: np.ndarray) -> np.ndarray:
    """Mean of (n, 3) over the pixels nearest to each of 32 x 32 texels, and no others."""
    texel = (problem.observations.uv * 32).astype(int).clip(0, 31) @ [1, 32]
    count = np.bincount(texel)
    return (np.bincount(texel, values.mean(1)) / np.maximum(count, 1))[count > 3]


def test_what_all_photos_miss_is_put_right(problem, matt, shading):
    """D is too bright by a quarter in stripes of two texels and too dark between them, in every
    photo, as interpolation makes it where stripes are narrower than its cells.
    """
    stripes = np.where(np.arange(32) % 4 < 2, 1.25, 0.75).astype(np.float32)
    wrong = gather(np.broadcast_to(stripes, (32, 32)), problem.observations.uv)
    smooth = replace(shading, scaled=shading.scaled * wrong)
    found = with_missed_light(problem, on_map(problem), matt, smooth, PATHS, numpy_rng(0))

    true = by_texel(problem, shading.scaled)
    error = lambda of: np.abs(by_texel(problem, of.scaled) / true - 1).mean()
    assert error(smooth) > 0.15 and error(found) < 0.5 * error(smooth)
    assert (found.rest == shading.rest).all()


def test_few_paths_add_little_noise(problem, matt, shading):
    """One path a texel says next to nothing of one texel; the right D stays right."""
    found = with_missed_light(problem, on_map(problem), matt, shading, 1, numpy_rng(0))
    assert np.abs(found.scaled / shading.scaled - 1).mean() < 0.05


def test_a_metals_shading_is_left_as_it_is(problem, matt, shading):
    half = np.zeros((32, 32), np.float32)
    half[:, 16:] = 1
    both = replace(matt, metallic=half)
    of_both = with_metal(problem, shading, half)
    found = with_missed_light(problem, on_map(problem), both, of_both, 15, numpy_rng(0))
    metal = of_both.metallic[:, 0] == 1
    assert np.allclose(found.scaled[metal], shading.scaled[metal], rtol=1e-5)
    assert not np.allclose(found.scaled[~metal], shading.scaled[~metal], rtol=1e-3)


@pytest.mark.parametrize("paths", [5, 2.5, 0.25])
def test_paths_are_shared_out_among_all_pixels(problem, matt, monkeypatch, paths):
    """In pieces too; and the sums are those of the pictures."""
    monkeypatch.setattr(missed_light, "CHUNK", 1000)
    pixels = np.arange(0, len(problem.observations), 2)
    total, made = single_paths(problem, matt, pixels, round(paths * len(pixels)), numpy_rng(0))
    assert made.sum() == round(paths * len(pixels))
    assert np.ptp(made[pixels]) == (paths != 5) and made[1::2].sum() == 0
    assert (total[made[:, 0] == 0] == 0).all()
    photo = problem.observations.rgb  # of the same texture under the same light, with some gloss
    assert total.sum() / (made * photo).sum() == pytest.approx(1, abs=0.2)


def test_paths_are_for_texels_that_are_seen_and_no_more_than_for_pixels(problem):
    pixels = np.arange(0, len(problem.observations), 2)
    seen = int(seen_texels(problem.observations.uv[pixels], 32).sum())
    assert paths_for(on_map(problem), pixels, 24) == 24 * seen
    assert paths_for(on_map(problem, 1024), pixels, 24) == 24 * len(pixels)
    assert paths_for(on_map(problem), pixels, 0) == 0


def test_a_metal_takes_no_paths(problem, matt, shading, monkeypatch):
    """They would tell nothing of it. A half that is metal takes none, the other its share."""
    asked = []
    paths = missed_light.single_paths
    noted = lambda *args: asked.append(args[2]) or paths(*args)
    monkeypatch.setattr(missed_light, "single_paths", noted)

    def missed(metal):
        x, of_metal = replace(matt, metallic=metal), with_metal(problem, shading, metal)
        return with_missed_light(problem, on_map(problem), x, of_metal, 1, numpy_rng(0)), of_metal

    metal = np.ones((32, 32), np.float32)
    found, before = missed(metal)
    assert found is before and not asked
    metal[:, :16] = 0
    missed(metal)
    (pixels,) = asked
    assert 0 < len(pixels) < len(problem.observations)
    assert (gather(metal, problem.observations.uv[pixels]) < 1).all()


def test_what_a_highlight_is_wrong_by_is_not_light_on_the_surface(problem, matt, shading):
    """Highlights are half as bright as they are, where they are nine tenths of the light."""
    color = gather(matt.base_color, problem.observations.uv)
    glossy = replace(shading, rest=9 * color * shading.scaled)
    paths = np.repeat(1000, len(glossy.rest))[:, None].astype(np.float32)
    radiance = paths * (color * glossy.scaled + 2 * glossy.rest)
    wrong = lambda *_: (radiance, paths)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(missed_light, "single_paths", wrong)
        half = np.arange(len(paths)) % 2 == 0  # the other half of each texel's pixels is matt
        glossy.rest[half], radiance[half] = 0, (paths * color * glossy.scaled)[half]
        found = with_missed_light(problem, on_map(problem), matt, glossy, 1, numpy_rng(0))
    assert np.abs(found.scaled / glossy.scaled - 1).mean() < 0.2
