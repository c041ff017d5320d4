"""Cameras, meshes and voxel grids: no photos, no light."""
