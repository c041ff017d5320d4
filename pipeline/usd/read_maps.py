"""Maps of a UsdPreviewSurface material: each input is a texture or a constant.

All maps come out square, of one size, linear Rec.709 or raw, row 0 = v 1.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pxr import Ar, Sdf, UsdShade

from pipeline.base.errors import InputError
from pipeline.base.images import read_exr, srgb_to_linear
from pipeline.render.renderer import GLASS, ior_of

LARGEST = 2048  # side of a map in texels; larger ones are averaged down
SMALLEST = 16  # side of constants
# Values of UsdPreviewSurface where nothing is authored (its specification, version 2.6).
DEFAULTS = {"diffuseColor": (0.18, 0.18, 0.18), "roughness": (0.5,), "metallic": (0.0,)}
# Inputs that the renderer has not, and the value at which each does nothing.
LEFT_OUT = {"opacity": 1.0, "clearcoat": 0.0, "emissiveColor": 0.0, "displacement": 0.0}
LARGEST_IOR = ior_of(0.08)  # that the renderer's material can have
IDENTITY = {"rotation": 0.0, "scale": 1.0, "translation": 0.0}  # of UsdTransform2d


@dataclass
class Maps:
    """base_color (t, t, 3), roughness and metallic (t, t), normal (t, t, 3) or None; textured:
    whether any of them is a texture; ior: index of refraction.
    """

    base_color: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    normal: np.ndarray | None
    textured: bool
    ior: float = GLASS


def read_maps(material: UsdShade.Material | None, path: Path, notes: list[str]) -> Maps:
    """Maps of a material; UsdPreviewSurface's defaults where there is none. `notes` gets what was
    assumed. Raises InputError for a surface of another kind or a texture that cannot be read.
    """
    surface = None
    if material is not None:
        surface = material.ComputeSurfaceSource()[0]
        if not surface or surface.GetIdAttr().Get() != "UsdPreviewSurface":
            raise InputError(
                "the material has no UsdPreviewSurface",
                f"{path}: {material.GetPath()}",
                "export with USD Preview Surface materials",
            )
        if (
            surface.GetInput("useSpecularWorkflow")
            and surface.GetInput("useSpecularWorkflow").Get()
        ):
            raise InputError(
                "the material has the specular workflow",
                f"{path}: {material.GetPath()}",
                "export base colour, roughness and metallic",
            )
    else:
        notes.append("a mesh has no material: UsdPreviewSurface's defaults")

    notes += [f"{name} is left out" for name in left_out(surface)]
    found = {name: read_input(surface, name, path, notes) for name in DEFAULTS}
    normal = read_input(surface, "normal", path, notes) if _connected(surface, "normal") else None
    sizes = [max(v.shape[:2]) for v in [*found.values(), normal] if v is not None]
    side = min(max(*sizes, SMALLEST), LARGEST)
    square = {name: resized(values, side) for name, values in found.items()}
    return Maps(
        square["diffuseColor"],
        square["roughness"][..., 0],
        square["metallic"][..., 0],
        None if normal is None else resized(0.5 * normal + 0.5, side),
        max(sizes) > 1,
        read_ior(surface, notes),
    )


def read_ior(surface: Any, notes: list[str]) -> float:
    """The surface's constant index of refraction; GLASS, its default, where there is none, and
    where it is one that the renderer has not, of which a note is made.
    """
    given = surface.GetInput("ior") if surface else None
    if not given or not does_something(given, GLASS):
        return GLASS
    value = given.Get()
    if given.HasConnectedSource() or not 1 <= value <= LARGEST_IOR:
        notes.append(f"ior is left out: only a number from 1 to {LARGEST_IOR:.2f} is read")
        return GLASS
    return float(value)


def does_something(given: Any, idle: float) -> bool:
    """Whether a shader's input is driven, or has another value than `idle`."""
    if not given:
        return False
    value = given.Get()
    return given.HasConnectedSource() or (value is not None and not np.allclose(value, idle))


def left_out(surface: Any) -> list[str]:
    """Inputs of the surface that do something and are not read."""
    if not surface:
        return []
    return [name for name, idle in LEFT_OUT.items() if does_something(surface.GetInput(name), idle)]


def resized(values: np.ndarray, side: int) -> np.ndarray:
    """Values (h, w, c) as (side, side, c), area down, linear up."""
    down = side < max(values.shape[:2])
    how = cv2.INTER_AREA if down else cv2.INTER_LINEAR
    out = cv2.resize(values.astype(np.float32), (side, side), interpolation=how)
    return out.reshape(side, side, -1)


def _connected(surface: Any, name: str) -> bool:
    return bool(surface and surface.GetInput(name) and surface.GetInput(name).HasConnectedSource())


def read_input(surface: Any, name: str, path: Path, notes: list[str]) -> np.ndarray:
    """Values (h, w, c) of an input: of its texture, its constant, or its default."""
    given = surface.GetInput(name) if surface else None
    if not given:
        if surface:
            notes.append(f"{name} is not authored: its default {DEFAULTS[name]}")
        return np.array(DEFAULTS[name]).reshape(1, 1, -1)

    sources = given.GetValueProducingAttributes()
    if not sources:
        return np.array(DEFAULTS[name]).reshape(1, 1, -1)
    shader = UsdShade.Shader(sources[0].GetPrim())
    if shader and shader.GetIdAttr().Get() == "UsdUVTexture":
        return read_texture(shader, sources[0].GetName().split(":")[-1], name, path)
    constant = sources[0].Get()
    if constant is None:
        raise InputError(
            f"{name} is driven by something that is neither a texture nor a constant",
            f"{path}: {surface.GetPath()}",
            "bake it into a texture",
        )
    return np.array(constant, float).reshape(1, 1, -1)


def read_texture(shader: Any, output: str, name: str, path: Path) -> np.ndarray:
    """What output r, g, b, a or rgb of a UsdUVTexture gives, (h, w, 1 or 3): scale x value + bias.
    Raises InputError where its file is missing or unreadable.
    """
    value = lambda key, default: (
        default
        if not shader.GetInput(key) or shader.GetInput(key).Get() is None
        else shader.GetInput(key).Get()
    )
    check_coordinates(shader, path)
    file = value("file", Sdf.AssetPath(""))
    pixels, linear = read_pixels(file, path)
    space = value("sourceColorSpace", "auto")
    three = pixels.shape[2] >= 3
    encoded = space == "sRGB" or (space == "auto" and not linear and three and name != "normal")
    if encoded:
        pixels = np.concatenate([srgb_to_linear(pixels[..., :3]), pixels[..., 3:]], -1)

    scale = np.array(value("scale", (1, 1, 1, 1)), float)
    bias = np.array(value("bias", (0, 0, 0, 0)), float)
    if pixels.shape[2] < 3:
        pixels = np.repeat(pixels[..., :1], 3, -1)
    if pixels.shape[2] < 4:
        pixels = np.concatenate([pixels, np.ones_like(pixels[..., :1])], -1)
    pixels = pixels * scale + bias
    if output == "rgb":
        return pixels[..., :3]
    channel = "rgba".index(output)
    return pixels[..., channel : channel + 1]


def check_coordinates(shader: Any, path: Path) -> None:
    """Raises InputError where a texture's coordinates are not the mesh's own but moved, turned or
    scaled ones.
    """
    given = shader.GetInput("st")
    sources = given.GetValueProducingAttributes() if given else []
    node = UsdShade.Shader(sources[0].GetPrim()) if sources else None
    if not node or node.GetIdAttr().Get() != "UsdTransform2d":
        return
    if any(does_something(node.GetInput(name), idle) for name, idle in IDENTITY.items()):
        raise InputError(
            "a texture is moved, turned or scaled by a UsdTransform2d",
            f"{path}: {shader.GetPath()}",
            "apply it to the texture coordinates, or bake the texture into one atlas",
        )


def asset_bytes(file: Sdf.AssetPath, path: Path) -> bytes:
    """Content of a file that the stage names, inside of a .usdz too. Raises InputError."""
    if not file.resolvedPath:
        raise InputError(
            f"the file {file.path or '(none)'} that it names is missing",
            path,
            "put it back, or export again",
        )
    return Ar.GetResolver().OpenAsset(Ar.ResolvedPath(file.resolvedPath)).GetBuffer()


def read_pixels(file: Sdf.AssetPath, path: Path) -> tuple[np.ndarray, bool]:
    """Values (h, w, c) float, 8 and 16 bits as [0, 1], and whether they are linear by their
    format.
    """
    if Path(file.path).suffix.lower() == ".exr":
        return np.atleast_3d(read_radiance(file, path)), True
    raw = np.frombuffer(asset_bytes(file, path), np.uint8)
    values = cv2.imdecode(raw, cv2.IMREAD_UNCHANGED)
    if values is None:
        raise InputError("not a readable picture", file.path, "export it as PNG, JPEG or EXR")
    linear = values.dtype == np.float32
    full = 1.0 if linear else {1: 255.0, 2: 65535.0}[values.dtype.itemsize]
    values = np.atleast_3d(values.astype(np.float32) / full)
    if values.shape[2] >= 3:
        values = np.concatenate([values[..., 2::-1], values[..., 3:]], -1)  # from BGR
    return values, linear


def read_radiance(file: Sdf.AssetPath, path: Path) -> np.ndarray:
    """Radiance of an .exr, .hdr or picture that the stage names, (h, w, 3) or, grey, (h, w)."""
    if Path(file.path).suffix.lower() != ".exr":
        pixels, linear = read_pixels(file, path)
        colors = np.repeat(pixels, 3, -1)[..., :3] if pixels.shape[2] < 3 else pixels[..., :3]
        return colors if linear else srgb_to_linear(colors)
    if not file.resolvedPath:
        asset_bytes(file, path)  # raises
    if Path(file.resolvedPath).exists():
        return read_exr(file.resolvedPath)

    # inside of a package, and OpenEXR reads files only
    with tempfile.NamedTemporaryFile(suffix=".exr") as copy:
        copy.write(asset_bytes(file, path))
        copy.flush()
        return read_exr(copy.name)


def tiled(maps: list[Maps], notes: list[str]) -> tuple[Maps, np.ndarray | None]:
    """All materials' maps as tiles of one square, row by row from above, and their normal map. They
    get one index of refraction; `notes` gets it if it was not all of theirs.
    """
    if len(maps) == 1:
        return maps[0], maps[0].normal
    across = int(np.ceil(np.sqrt(len(maps))))
    side = min(max(len(m.roughness) for m in maps), LARGEST // across)
    flat = np.broadcast_to(np.array([0.5, 0.5, 1.0]), (side, side, 3))

    def joined(parts: list[np.ndarray]) -> np.ndarray:
        parts = parts + [parts[0]] * (across**2 - len(parts))
        rows = [np.concatenate(parts[k : k + across], 1) for k in range(0, len(parts), across)]
        return np.concatenate(rows).astype(np.float32)

    of = lambda name: joined([resized(np.atleast_3d(getattr(m, name)), side) for m in maps])
    normal = None
    if any(m.normal is not None for m in maps):
        normal = joined([flat if m.normal is None else resized(m.normal, side) for m in maps])
    ior = maps[0].ior
    if any(m.ior != ior for m in maps):
        notes.append(f"the materials' ior differ: all are given {ior:.2f}, the first one's")
    whole = Maps(
        of("base_color"), of("roughness")[..., 0], of("metallic")[..., 0], normal, True, ior
    )
    return whole, normal
