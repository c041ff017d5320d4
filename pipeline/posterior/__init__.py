"""The posterior over light and materials: point estimate, samplers, refinement."""
