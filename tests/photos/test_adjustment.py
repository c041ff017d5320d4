"""The last adjustment of cameras, on made-up models whose features are off by known errors."""

import numpy as np
import pycolmap
import pytest

from pipeline.photos.adjustment import adjust
from tests.photos.test_structure import aligned
from tests.seeds import numpy_rng

FIRM, WILD = 0.3, 4.0  # pixels: what most features are off by, and what one in eight are


def made(seed: int, off: bool) -> pycolmap.Reconstruction:
    """Ten cameras, 150 points that all of them see; its features off by errors, or where they are
    seen.
    """
    pycolmap.set_random_seed(seed)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_frames_per_rig, options.num_points3D = 1, 10, 150
    model = pycolmap.synthesize_dataset(options)
    rng = numpy_rng(seed)
    for image in model.images.values() if off else ():
        for point in image.points2D:
            spread = WILD if rng.random() < 0.125 else FIRM
            point.xy = point.xy + rng.normal(scale=spread, size=2)
    return model


def contradiction(model: pycolmap.Reconstruction, true: pycolmap.Reconstruction) -> float:
    """Root of the mean squared distance of the cameras from the true ones, as a share of their
    distance from the middle, after the best similarity.
    """
    centers = [
        np.stack([m.image(k).projection_center() for k in sorted(m.reg_image_ids())])
        for m in (model, true)
    ]
    found, known = centers
    scale, turn, shift = aligned(found, known)
    off = scale * found @ turn.T + shift - known
    return float(np.sqrt((off**2).sum() / ((known - known.mean(0)) ** 2).sum()))


@pytest.mark.parametrize("seed", range(3))
def test_loose_matches_hardly_move_the_cameras(seed):
    true = made(seed, False)
    squares, robust = made(seed, True), made(seed, True)
    plain = pycolmap.BundleAdjustmentOptions()
    plain.print_summary = False
    pycolmap.bundle_adjustment(squares, plain)
    adjust(robust, 1)
    assert contradiction(robust, true) < 0.7 * contradiction(squares, true)


def test_errors_of_points_are_those_of_the_adjusted_cameras():
    model = made(5, True)
    adjust(model, 1)
    before = model.compute_mean_reprojection_error()
    model.update_point_3d_errors()
    assert model.compute_mean_reprojection_error() == pytest.approx(before, rel=1e-9)


def test_a_model_without_errors_stays():
    model, true = made(7, False), made(7, False)
    adjust(model, 1)
    assert contradiction(model, true) < 1e-6
