"""Posterior over light and materials. SAMPLERS: name -> function(problem, prior, start, settings, seed) -> Explanation, facts."""

from .baselines import dpi_code, point_estimate, sds
from .dpi import dpi_paper
from .ours import gaussian, split_gibbs

SAMPLERS = {"split_gibbs": split_gibbs, "gaussian": gaussian, "dpi_paper": dpi_paper, "dpi_code": dpi_code, "sds": sds,
            "map": point_estimate}
