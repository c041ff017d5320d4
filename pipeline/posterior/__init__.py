"""Posterior over light and materials. SAMPLERS: name -> function(problem, prior, start, settings, seed) -> Explanation, facts."""

from .dpi import dpi_paper

SAMPLERS = {"dpi_paper": dpi_paper}
