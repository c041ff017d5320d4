"""The report's pictures as encoded bytes."""

from __future__ import annotations

import base64
import io
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from pipeline.base.config import Scene
from pipeline.base.images import in_rows, linear_to_srgb, read_exr, read_png, to_srgb8
from pipeline.geometry.cameras import Rig, View
from pipeline.geometry.surface import Surface
from pipeline.render.envmap import directions, mean_radiance, resample_area
from pipeline.render.metrics import psnr, render_pixels, render_twice
from pipeline.render.renderer import NO_HIGHLIGHT, Explanation, Renderer
from pipeline.render.samples import Spread
from pipeline.render.surface_texels import SurfaceTexels
from pipeline.render.surroundings import Ground, Surroundings

HEAT = cv2.COLORMAP_INFERNO
PAGE = 384  # texels a side that the page shows of a map
BESIDE = np.array([58, 64, 76], np.uint8)  # what lies beside the charts: no map has that colour
UNSEEN = np.uint8(128)  # and of those whose spread says nothing


def data_address(picture: bytes) -> str:
    """A PNG or JPEG as a data: address."""
    kind = "png" if picture.startswith(b"\x89PNG") else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(picture).decode()}"


def encode(pixels: np.ndarray, kind: str = "JPEG", quality: int = 88) -> bytes:
    """uint8 picture as JPEG or PNG bytes; quality: of a JPEG."""
    buffer = io.BytesIO()
    options = {"quality": quality} if kind == "JPEG" else {}
    Image.fromarray(np.ascontiguousarray(pixels, np.uint8)).save(buffer, kind, **options)
    return buffer.getvalue()


def heat(values: np.ndarray, top: float) -> np.ndarray:
    """Scalar map (h, w) in [0, top] as colours."""
    index = (np.clip(values / top, 0, 1) * 255).astype(np.uint8)
    return cv2.cvtColor(cv2.applyColorMap(index, HEAT), cv2.COLOR_BGR2RGB)


def shrink(texture: np.ndarray) -> np.ndarray:
    """A texture at the size that the page shows."""
    return cv2.resize(texture, (PAGE, PAGE), interpolation=cv2.INTER_AREA)


def on_surface(picture: np.ndarray, texels: SurfaceTexels) -> np.ndarray:
    """A map's picture (t, t) or (t, t, 3), uint8, in colour without what lies beside the charts."""
    color = picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=-1)
    return np.where(texels.surface[..., None], color, BESIDE)


def where_seen(picture: np.ndarray, texels: SurfaceTexels) -> np.ndarray:
    """A spread's picture (t, t, 3), uint8, only of what photos show of the surface."""
    return on_surface(np.where(texels.seen[..., None], picture, UNSEEN), texels)


def range_words(values: np.ndarray) -> str:
    """What a map's picture cannot say: the one value that it has, or that white stands for 1."""
    low, high = values.min(), values.max()
    return f"{low:.2f} everywhere" if high - low < 0.005 else "white = 1"


def roughness_words(x: Explanation) -> str:
    """As `range_words`, and whether there is a highlight that it is the roughness of."""
    if x.ior == NO_HIGHLIGHT:
        return "of no effect: no highlight"
    return range_words(x.roughness)


def normal_map(work: Path) -> bytes | None:
    """The surface's normal map as it is exported, or None where it has none."""
    normals = Surface.of(work / "atlas" / "mesh_uv.ply").normals
    if normals is None:
        return None
    return encode((shrink(normals) * 255).astype(np.uint8))


def spread_pictures(spread: Spread, texels: SurfaceTexels) -> dict[str, bytes]:
    """Of every map's standard deviation over samples, and of the log light's."""
    texels = texels.resized(PAGE)
    shown = lambda of, top: encode(where_seen(heat(shrink(of), top), texels))
    light = cv2.resize(spread.light.mean(-1), (512, 256), interpolation=cv2.INTER_NEAREST)
    return {
        "base colour (0 to 0.2, sRGB)": shown(spread.color.mean(-1), 0.2),
        "roughness (0 to 0.3)": shown(spread.roughness, 0.3),
        "metallic (0 to 0.3)": shown(spread.metallic, 0.3),
        "light (log radiance, 0 to 2)": encode(heat(light, 2.0)),
    }


def contact_sheet(work: Path, rig: Rig, height: int = 150, limit: int = 18) -> bytes:
    """At most `limit` of the photos, as JPEG."""
    tiles = []
    for v in rig.views[:: max(1, -(-len(rig.views) // limit))]:
        photo = to_srgb8(read_exr(work / "poses" / v.image))
        size = (round(v.width * height / v.height), height)
        tiles.append(cv2.resize(photo, size, interpolation=cv2.INTER_AREA))
    return encode(in_rows(tiles))


def show_light(light: np.ndarray, exposure: float, width: int = 512) -> np.ndarray:
    """A light (h, 2h, 3) at this exposure as a picture (width / 2, width, 3) uint8."""
    big = cv2.resize(light, (width, width // 2), interpolation=cv2.INTER_NEAREST)
    return to_srgb8(big * exposure)


def evening_light(height: int) -> np.ndarray:
    """A light that no photo was taken under: low warm sun, blue sky, dark ground. Mean radiance 1,
    lat-long (h, 2h, 3).
    """
    d = directions(4 * height, 8 * height)
    sun = np.array([0.75, 0.35, 0.56]) / np.linalg.norm([0.75, 0.35, 0.56])
    sky = np.where(d[..., 1:2] > 0, np.array([0.35, 0.5, 0.9]), np.array([0.10, 0.08, 0.06]))
    disc = np.exp((d @ sun - 1) / np.radians(5) ** 2)[..., None]
    light = sky + 60 * disc * np.array([1.0, 0.62, 0.3])
    light = resample_area(light.astype(np.float32), height, 2 * height)
    return light / mean_radiance(light).mean()


class Painter:
    """Renders samples from one view, beside its photo and under another light."""

    def __init__(self, work: Path, view: View, scene: Scene, texels: SurfaceTexels):
        self.work = work
        self.texels = texels.resized(PAGE)
        self.scene = scene
        self.view = view.scaled(min(1.0, scene.report.relight_size * 2 / view.width))

        size = (self.view.width, self.view.height)
        photo = read_exr(work / "poses" / view.image)
        mask = read_png(work / "mesh" / "masks" / f"{view.name}.png")
        self.photo = cv2.resize(photo, size, interpolation=cv2.INTER_AREA)
        self.mask = cv2.resize(mask, size, interpolation=cv2.INTER_AREA) > 250
        self.box = self._crop()
        self.shown = np.zeros_like(self.mask)
        self.shown[self.box] = True
        self.renderers: dict = {}
        with np.load(work / "observe" / "observations.npz") as arrays:
            self.ground = Surroundings.of(arrays).ground

    def _crop(self) -> tuple[slice, slice]:
        """The part of the picture that holds the object, with a margin."""
        shown = self.mask if self.mask.any() else np.ones_like(self.mask)
        rows, columns = np.where(shown)
        margin = 12
        return np.s_[
            max(rows.min() - margin, 0) : rows.max() + margin,
            max(columns.min() - margin, 0) : columns.max() + margin,
        ]

    def renderer(self, x: Explanation, ground: Ground | None = None) -> Renderer:
        """The renderer for textures and lights of the size that `x` has, on the ground or alone."""
        sizes = (x.base_color.shape[0], x.light.shape[0])
        key = (*sizes, ground is not None)
        if key not in self.renderers:
            mesh = self.work / "atlas" / "mesh_uv.ply"
            depth = self.scene.render.max_depth
            self.renderers[key] = Renderer(mesh, *sizes, depth, ground)
        return self.renderers[key]

    def photo_jpeg(self) -> bytes:
        """The photo, cropped to the object."""
        return encode(to_srgb8(self.photo)[self.box])

    def sample(self, x: Explanation) -> dict:
        """All pictures of one sample as bytes, its PSNR in this view, and the object's pixels under
        another light of mean radiance 1, (n, 3); all samples' are of the same paths.
        """
        spp = self.scene.report.spp
        halves = render_twice(self.renderer(x, self.ground), x, self.view, self.shown, spp)
        picture = halves.mean(0)
        error = np.abs(linear_to_srgb(picture) - linear_to_srgb(self.photo)).mean(-1) * self.mask

        brightness = float(mean_radiance(x.light).mean())
        evening = evening_light(x.light.shape[0]) * brightness
        relit = replace(x, light=evening)
        other = render_pixels(self.renderer(x), relit, self.view, self.shown, spp)

        chart = lambda shown: encode(on_surface(shown, self.texels))
        grey = lambda m: chart((shrink(np.clip(m, 0, 1)) * 255).astype(np.uint8))
        return {
            "lights": [encode(show_light(x.light, e / brightness)) for e in (0.08, 0.4, 2.0)],
            "base_color": chart(to_srgb8(shrink(x.base_color))),
            "roughness": grey(x.roughness),
            "metallic": grey(x.metallic),
            "roughness_says": roughness_words(x),
            "metallic_says": range_words(x.metallic),
            "render": encode(to_srgb8(picture)[self.box]),
            "error": encode(heat(error, 0.25)[self.box]),
            "relight": encode(to_srgb8(other)[self.box]),
            "relit": other[self.mask] / brightness,
            "psnr": psnr(halves[0], self.photo, self.mask, halves[1]),
            "mean_radiance": brightness,
        }
