"""Regions of like colour, and what a draw takes for one material."""

import numpy as np

from pipeline.posterior.split_gibbs.regions import group, texel_regions
from pipeline.posterior.split_gibbs.setup import EXPLAINED
from tests.seeds import numpy_rng


def test_regions_follow_the_base_colour_and_not_its_shade():
    """Three paints, each in light and shadow by a fifth, are three regions, on points and on
    texels.
    """
    rng = numpy_rng(3)
    paints = np.array([[0.6, 0.1, 0.1], [0.1, 0.5, 0.2], [0.4, 0.4, 0.5]])
    which = rng.integers(3, size=400)
    label, centers = group(paints[which] * rng.uniform(0.8, 1.2, (400, 1)))
    assert label.max() == 2 and all(len(np.unique(label[which == k])) == 1 for k in range(3))
    texture = np.repeat(np.repeat(paints[None, [0, 1, 2, 2]], 16, 1), 64, 0).astype(np.float32)
    found = texel_regions(texture, centers, 32)
    expected = [label[which == k][0] for k in (0, 1, 2)]
    assert [np.median(found[:, a:b]) for a, b in ((0, 7), (9, 15), (17, 32))] == expected


def test_draws_differ_in_what_they_take_for_one_material():
    """The share of the spread that regions explain is drawn: four paints, two of them alike, are
    from two to four regions, never split oddly.
    """
    rng = numpy_rng(5)
    paints = np.array([[0.6, 0.1, 0.1], [0.5, 0.14, 0.1], [0.1, 0.5, 0.2], [0.15, 0.15, 0.6]])
    which = np.arange(400) % 4
    colours = paints[which] * rng.uniform(0.95, 1.05, (400, 1))
    found = [group(colours, rng.uniform(*EXPLAINED), k)[0] for k in range(20)]
    counts = {label.max() + 1 for label in found}
    assert len(counts) > 1 and counts <= {2, 3, 4}
    assert group(colours, EXPLAINED[0])[0].max() < group(colours, EXPLAINED[1])[0].max()
    for label in found:
        if label.max() + 1 <= 3:
            assert all(len(np.unique(label[which == k])) == 1 for k in range(4))
