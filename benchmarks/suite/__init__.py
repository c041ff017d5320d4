"""The procedural suite: objects, materials and lights with known truth, made by code alone."""
