"""Posterior over light and materials. SAMPLERS: name -> function(problem, prior, start, settings, seed) -> Explanation, facts."""

from .dpi import dpi_paper
from .ours import split_gibbs

SAMPLERS = {"dpi_paper": dpi_paper, "split_gibbs": split_gibbs}
