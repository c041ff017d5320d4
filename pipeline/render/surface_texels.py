"""Which texels of a sample's maps lie on the surface, and which of those photos show.

The others' colours only join on to those (pipeline/posterior/unseen_colors.py), in every sample in
the same way: that samples agree there says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from pipeline.base.errors import InputError
from pipeline.base.images import read_png, write_png
from pipeline.geometry.mesh_io import Mesh
from pipeline.surface.raster import rasterize

FILE = "seen.png"
UNSEEN, SEEN = 128, 255  # grey of the surface in that file; what is not surface is black


@dataclass(frozen=True)
class SurfaceTexels:
    """Of a map (t, t): `surface`, texels within a triangle of the atlas, and `seen`, those of them
    that a photo shows, both bool.
    """

    surface: np.ndarray
    seen: np.ndarray

    @classmethod
    def of(cls, mesh: Mesh, shown: np.ndarray) -> SurfaceTexels:
        """shown (t, t), bool: texels next to a pixel, on the surface or beside its charts."""
        assert mesh.uv is not None
        surface = rasterize(mesh.uv, mesh.faces, len(shown)) > 0
        return cls(surface, surface & shown)

    @property
    def unseen_share(self) -> float:
        """Of the surface's texels, those that no photo shows."""
        return 1 - float(self.seen.sum()) / max(int(self.surface.sum()), 1)

    def resized(self, size: int) -> SurfaceTexels:
        """Of a map (size, size): where most of what a texel covers is."""

        def most(of: np.ndarray) -> np.ndarray:
            share = cv2.resize(of.astype(np.float32), (size, size), interpolation=cv2.INTER_AREA)
            return share > 0.5

        surface = most(self.surface)
        return SurfaceTexels(surface, surface & most(self.seen))

    def save(self, folder: Path) -> None:
        """As a grey picture into a refined sample's folder."""
        grey = np.where(self.seen, SEEN, np.where(self.surface, UNSEEN, 0)).astype(np.uint8)
        write_png(folder / FILE, grey)

    @classmethod
    def load(cls, folder: Path) -> SurfaceTexels:
        """What `save` wrote. Raises InputError where there is none."""
        if not (folder / FILE).exists():
            cure = "it was refined by an earlier version: refine it anew"
            raise InputError("it is not known which texels photos show", folder / FILE, cure)
        grey = read_png(folder / FILE)
        return cls(grey >= UNSEEN, grey == SEEN)
