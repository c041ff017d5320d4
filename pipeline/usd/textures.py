"""Files of one sample's light and maps. A map of one value needs none: a number in the material
does for it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from pipeline.base.images import linear_to_srgb, write_exr, write_png
from pipeline.render.renderer import Explanation

STEP = 1 / 255  # between neighbouring values of an 8-bit texture


def constant_of(image: np.ndarray) -> float | None:
    """The one value in [0, 1] of a map (t, t), to what 8 bits can tell, else None. Half a step off
    at most, as a texture would be.
    """
    low, high = float(image.min()), float(image.max())
    if high - low > STEP:
        return None
    return float(np.clip(0.5 * (low + high), 0, 1))


@dataclass
class Asset:
    """One sample's light and maps: file names relative to exports/, or the one value of roughness
    or metallic where these do not vary; and its index of refraction. normal: all samples' map, or
    None where the surface has none.
    """

    base_color: str
    roughness: str | float
    metallic: str | float
    light: str
    normal: str | None = None
    ior: float = field(kw_only=True)

    def below(self, folder: str) -> Asset:
        """The same with file names relative to exports/<folder>/."""
        shorter = lambda value: value[len(folder) + 1 :] if isinstance(value, str) else value
        names = ("base_color", "roughness", "metallic", "light", "normal")
        return Asset(*(shorter(getattr(self, name)) for name in names), ior=self.ior)


def write_gloss(image: np.ndarray, folder: Path, name: str) -> str | float:
    """The one value of a map (t, t), or the name in `folder` of an 8-bit raw PNG that holds it."""
    value = constant_of(image)
    if value is not None:
        return value
    write_png(folder / f"{name}.png", np.round(np.clip(image, 0, 1) * 255))
    return f"{name}.png"


def write_textures(x: Explanation, folder: Path, relative: str, normal: str | None = None) -> Asset:
    """8-bit PNG maps (base colour sRGB, others raw; none for one value) and a float EXR light. x:
    with the numbers of a UsdPreviewSurface (preview_surface.py); `normal`: the normal map's file
    name, which all samples share.
    """
    folder.mkdir(parents=True)
    write_png(folder / "base_color.png", np.round(linear_to_srgb(x.base_color) * 255))
    write_exr(folder / "light.exr", x.light)

    def placed(image: np.ndarray, name: str) -> str | float:
        written = write_gloss(image, folder, name)
        return f"{relative}/{written}" if isinstance(written, str) else written

    return Asset(
        base_color=f"{relative}/base_color.png",
        roughness=placed(x.roughness, "roughness"),
        metallic=placed(x.metallic, "metallic"),
        light=f"{relative}/light.exr",
        ior=x.ior,
        normal=normal,
    )
