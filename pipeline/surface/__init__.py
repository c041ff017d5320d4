"""From masks and photos to a mesh with one texture atlas."""
