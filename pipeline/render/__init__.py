"""The forward model: light, renderer, observed pixels, the transport operator, scores."""
