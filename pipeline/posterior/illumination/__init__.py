"""Priors of the light that earlier work used, as samplers: penalties on an optimum, and a basis."""
