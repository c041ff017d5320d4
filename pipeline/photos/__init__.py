"""From photos to linear light and cameras."""
