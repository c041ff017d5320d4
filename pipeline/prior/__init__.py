"""Priors over natural light, as the samplers use them (making them: prior/training)."""
