"""What the page's viewer (viewer.js) draws: the mesh, and of the samples' mean and of every sample
the maps and the prefiltered light, as JSON.

It shades as a rasteriser does, by the split sum (posterior/illumination/split_sum.py), so that a
browser can turn asset and light in the hand: nothing shadows or lights anything else. The pictures
of the page are path traced.
"""

from __future__ import annotations

import base64
from collections.abc import Iterable
from itertools import islice

import cv2
import numpy as np
import torch

from pipeline.base.images import to_srgb8
from pipeline.geometry.mesh_io import Mesh
from pipeline.posterior.illumination.split_sum import ROUGHNESS, facet_albedo, filtered
from pipeline.render.envmap import resample_area
from pipeline.render.renderer import Explanation, head_on
from pipeline.report.pictures import data_address, encode, evening_light

ROWS = 24  # of a light: a mirror shows it blurred by a few degrees
SIDE = 768  # texels along a base colour, at most
QUALITY = 80  # of its JPEG
# what a page can hold: 4 MiB of mesh; samples of .3 MiB each
MOST_TRIANGLES, MOST_SHOWN = 200_000, 12


def viewer_data(
    mesh: Mesh, named: Iterable[tuple[str, Explanation]], toward: np.ndarray, white: float
) -> dict | None:
    """All that viewer.js needs; None for a mesh of more than MOST_TRIANGLES. named: what there is
    to choose from, of which the first MOST_SHOWN are taken, and how it is called; toward (3,): from
    the object's middle to where it is looked from first; white: mean radiance of the light that all
    are shown under beside their own.
    """
    if len(mesh.faces) > MOST_TRIANGLES:
        return None
    shown = [drawn(name, x) for name, x in islice(named, MOST_SHOWN)]
    other = white * evening_light(ROWS)
    return {
        "mesh": packed_mesh(mesh),
        "toward": [float(x) for x in toward],
        "rows": ROWS,
        "levels": len(ROUGHNESS),
        "roughest": float(ROUGHNESS[-1]),
        "smoothest": float(ROUGHNESS[0]),
        "albedo": packed(facet_albedo().permute(1, 2, 0).numpy().astype(np.float16)),
        "cosines": facet_albedo().shape[2],
        "other": light_levels(other),
        "shown": shown,
    }


def drawn(name: str, x: Explanation) -> dict:
    """One explanation under its own light: pictures of its maps as addresses, roughness and
    metallic being red and green of one; `head_on`, what a dielectric reflects head-on.
    """
    side = min(SIDE, len(x.base_color))
    color = cv2.resize(x.base_color, (side, side), interpolation=cv2.INTER_AREA)
    gloss = np.stack([x.roughness, x.metallic, np.zeros_like(x.metallic)], -1)
    return {
        "name": name,
        "color": data_address(encode(to_srgb8(color), quality=QUALITY)),
        "gloss": data_address(encode(np.round(255 * gloss.clip(0, 1)), "PNG")),
        "head_on": float(head_on(x.ior)),
        "light": light_levels(resample_area(x.light, ROWS, 2 * ROWS)),
    }


def light_levels(light: np.ndarray) -> str:
    """A light (ROWS, 2 ROWS, 3) as facets of every roughness show it, and its irradiance: half
    floats (levels + 1, ROWS, 2 ROWS, 4), the fourth being 1.
    """
    found = filtered(torch.from_numpy(np.ascontiguousarray(light, np.float32)))
    rgba = np.concatenate([found.numpy(), np.ones((*found.shape[:2], 1), np.float32)], -1)
    return packed(np.minimum(rgba, np.finfo(np.float16).max).astype(np.float16))


def packed_mesh(mesh: Mesh) -> dict:
    """Vertices as 16-bit shares of their box (`low`, `size`), normals in bytes, 16-bit uv with v
    down, and triangles.
    """
    low, size = mesh.vertices.min(0), np.maximum(np.ptp(mesh.vertices, axis=0), 1e-12)
    assert mesh.uv is not None  # of the atlas
    whole = lambda x: np.round(65535 * np.clip(x, 0, 1)).astype(np.uint16)
    return {
        "low": low.tolist(),
        "size": size.tolist(),
        "position": packed(whole((mesh.vertices - low) / size)),
        "normal": packed(np.round(127 * mesh.normals).astype(np.int8)),
        "uv": packed(whole(mesh.uv * [1, -1] + [0, 1])),
        "triangle": packed(mesh.faces.astype(np.uint32)),
    }


def packed(values: np.ndarray) -> str:
    """The bytes of an array, little-endian, in base64."""
    little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
    return base64.b64encode(little.tobytes()).decode()
