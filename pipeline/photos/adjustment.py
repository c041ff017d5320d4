"""Cameras at which no loose match pulls: bundle adjustment with a robust loss.

Incremental mapping ends with cameras of least squares, over all matches within four pixels. But
matches err by tenths of a pixel, or by whole ones where two corners look alike, and squares weigh
the second kind most.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pycolmap

# pixels of the matched pictures, from which on errors count as loose. Cameras of nine things on a
# table (benchmarks.tabletop) are off by .25 % of the thing's size in the mean as mapping leaves
# them, by .19 % at 1 and at .5
LOOSE = 1.0


def adjust(model: pycolmap.Reconstruction, threads: int) -> None:
    """Move a model's cameras and points to where the sum over matches of log(1 + (e / LOOSE)^2) is
    least, e being the distance in pixels from a feature to its point (the loss of Cauchy and
    Lorentz: Triggs et al., Bundle Adjustment, a Modern Synthesis, 1999, section 3).
    """
    import pycolmap

    everything = pycolmap.BundleAdjustmentConfig()
    for number in model.reg_image_ids():
        everything.add_image(number)
    everything.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)

    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = LOOSE
    options.ceres.solver_options.num_threads = threads
    pycolmap.create_default_bundle_adjuster(options, everything, model).solve()
    model.update_point_3d_errors()
