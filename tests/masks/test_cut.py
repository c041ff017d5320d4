"""Masks along edges: which loose parts stay."""

import numpy as np

from pipeline.masks.cut import LEAST_PART, tidy


def test_a_loose_part_stays_where_the_evidence_is_for_it():
    """A large part stays, and a small one that the photos' log-odds are for; one that they are
    against goes, and so does one of few pixels whatever its odds; a small hole is filled.
    """
    mask = np.zeros((100, 100), bool)
    mask[40:100] = True
    mask[60, 60] = False  # a hole
    backed, unbacked, tiny = np.s_[5:15, 5:15], np.s_[5:15, 40:50], np.s_[5:10, 80:85]
    assert mask[tiny].size < LEAST_PART < mask[backed].size
    odds = np.full(mask.shape, -1.0)
    for part, value in ((backed, 3.0), (unbacked, 0.5), (tiny, 3.0)):
        mask[part] = True
        odds[part] = value

    out = tidy(mask, odds)
    assert out[10, 10] and not out[unbacked].any() and not out[tiny].any()
    assert out[40:].all()
