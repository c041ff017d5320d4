"""Make the example `garden`: photographs of a still life (glazed pot with a bronze band, stone,
log) on a wooden table.

python examples/make_garden.py --out examples/garden

Everything is procedural: geometry, textures and light come from this file, the pictures from
Mitsuba. Frame: Y-up, metres, table top at y = 0. The photos are camera-like: fixed exposure, photon
and read noise, 8-bit sRGB JPEG with EXIF. `truth/` holds what a reconstruction may be scored
against, and is never read by the pipeline.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))
from pipeline.base.images import linear_to_srgb, write_exr
from pipeline.base.progress import progress
from pipeline.base.runtime import mitsuba as mi
from pipeline.render.envmap import directions, solid_angles

WIDTH = 960
HEIGHT = 640
FOCAL_35 = 38.0  # focal length in millimetres on 35 mm film
DISTANCE = 0.93  # of the cameras from AIM, in metres
AIM = np.array([0.03, 0.085, 0.0])
RINGS = ((14, 16), (33, 16), (56, 12))  # elevation in degrees, number of photos


@dataclass
class Part:
    """A textured mesh: uv with v up, maps with row 0 at v = 1; base colour is linear."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray
    base_color: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray


# ---------------------------------------------------------------- procedural textures


def noise(rng, size, smooth, octaves=5, anisotropy=1.0) -> np.ndarray:
    """Tileable fractal noise (size, size), zero mean, unit variance; `smooth` = coarsest blur in
    texels.
    """
    out = np.zeros((size, size))
    for k in range(octaves):
        s = max(smooth / 2**k, 0.4)
        layer = gaussian_filter(rng.normal(size=(size, size)), (s, s * anisotropy), mode="wrap")
        out += layer / layer.std() * 0.62**k
    return out / out.std()


def mix(a, b, t) -> np.ndarray:
    """Blend colours by a map t in [0, 1]."""
    return np.asarray(a) * (1 - t[..., None]) + np.asarray(b) * t[..., None]


def step(x, at, width) -> np.ndarray:
    return 1 / (1 + np.exp(-np.clip((x - at) / width, -40, 40)))


def table_maps(rng, size=3072):
    """Weathered planks with grain, knots, moss spots and fallen leaves."""
    y, x = np.mgrid[0:size, 0:size] / size
    plank = np.floor(x * 16).astype(int)
    tone = rng.uniform(0.6, 1.35, 17)[plank]
    grain = noise(rng, size, 6, 4, 1.0)
    grain = gaussian_filter(grain, (25, 0.6), mode="wrap")
    grain = grain / grain.std() + 0.6 * noise(rng, size, 40, 6)
    color = mix([0.10, 0.065, 0.04], [0.34, 0.26, 0.18], step(grain, 0, 0.8)) * tone[..., None]
    gap = step(np.abs((x * 16) % 1 - 0.5), 0.488, 0.003)
    color = mix(color, [0.02, 0.016, 0.012], gap)
    color = mix(color, [0.10, 0.15, 0.04], step(noise(rng, size, 60, 7), 1.5, 0.15))  # moss
    color = mix(color, [0.5, 0.48, 0.42], step(noise(rng, size, 5, 3), 2.3, 0.1) * 0.8)  # lichen
    for _ in range(420):
        cx, cy, a = rng.uniform(0, 1, 3) * [1, 1, 2 * np.pi]
        length = rng.uniform(0.004, 0.016)
        box = np.s_[
            max(int((cy - 0.02) * size), 0) : int((cy + 0.02) * size),
            max(int((cx - 0.02) * size), 0) : int((cx + 0.02) * size),
        ]
        u = (x[box] - cx) * np.cos(a) + (y[box] - cy) * np.sin(a)
        v = -(x[box] - cx) * np.sin(a) + (y[box] - cy) * np.cos(a)
        leaf = (np.abs(v) < 0.35 * length * np.clip(1 - (u / length) ** 2, 0, 1)) * (
            1 - 0.5 * (np.abs(v) < 0.02 * length)
        )
        hue = np.array(
            [[0.45, 0.22, 0.04], [0.35, 0.3, 0.05], [0.3, 0.09, 0.03], [0.12, 0.2, 0.03]]
        )[rng.integers(4)]
        color[box] = mix(color[box], hue * rng.uniform(0.7, 1.3), leaf)
    return np.clip(color, 0.01, 0.9), np.clip(0.75 + 0.06 * grain, 0.5, 1), np.zeros((size, size))


def lawn_maps(rng, size=1024):
    blades = noise(rng, size, 24, 7)
    color = mix([0.03, 0.07, 0.015], [0.16, 0.24, 0.06], step(blades, 0, 0.7))
    color = mix(color, [0.4, 0.38, 0.1], step(noise(rng, size, 3, 2), 2.7, 0.05))
    return color, np.full((size, size), 0.95), np.zeros((size, size))


def hedge_maps(rng, size=1024):
    leaves = noise(rng, size, 14, 6)
    color = mix([0.008, 0.02, 0.006], [0.10, 0.17, 0.04], step(leaves, 0.1, 0.6))
    color = mix(color, [0.5, 0.18, 0.25], step(noise(rng, size, 5, 2), 2.6, 0.05))
    return color, np.full((size, size), 0.9), np.zeros((size, size))


def pot_maps(rng, size=2048):
    """Painted glaze over height v and angle u; the profile's arc length sets what is band, rim and
    soil.
    """
    v, u = np.mgrid[0:size, 0:size] / size
    v = 1 - v
    mottle = noise(rng, size, 30, 7)
    fine = noise(rng, size, 3, 3)
    blue = [0.03, 0.07, 0.27]
    rust = [0.42, 0.10, 0.03]
    teal = [0.03, 0.25, 0.22]

    color = mix([0.55, 0.50, 0.38], [0.66, 0.62, 0.5], step(mottle, 0, 0.5))
    zig = np.abs((u * 14) % 1 - 0.5) * 2
    color = mix(color, blue, step(0.028 - np.abs(v - 0.36 - 0.05 * zig), 0, 0.0015))
    color = mix(color, teal, step(0.012 - np.abs(v - 0.30 - 0.05 * zig), 0, 0.0015))
    petals = np.hypot(((u * 9) % 1 - 0.5) * 0.9, (v - 0.545) * 7)
    angle = np.arctan2((v - 0.545) * 7, ((u * 9) % 1 - 0.5) * 0.9)
    color = mix(
        color, rust, step(0.33 + 0.1 * np.cos(5 * angle + 6 * np.floor(u * 9)) - petals, 0, 0.01)
    )
    color = mix(color, [0.75, 0.55, 0.1], step(0.1 - petals, 0, 0.01))
    color = mix(color, blue, step(0.011 - np.abs(v - 0.64), 0, 0.001))
    dots = np.hypot(((u * 40) % 1 - 0.5), ((v - 0.66) * 60))
    color = mix(color, teal, step(0.3 - dots, 0, 0.03))
    color = color * np.exp(0.10 * mottle + 0.05 * fine)[..., None]
    chips = step(noise(rng, size, 7, 4), 2.1, 0.1) * 0.8
    color = mix(color, [0.16, 0.10, 0.06], chips)
    rough = np.clip(0.26 + 0.03 * mottle, 0.15, 0.5)

    band = step(v, 0.165, 0.001) * step(-v, -0.255, 0.001)
    patina = step(noise(rng, size, 20, 6), 0.9, 0.3)
    bronze = (
        mix([0.58, 0.36, 0.16], [0.22, 0.24, 0.15], 0.7 * patina) * np.exp(0.08 * fine)[..., None]
    )
    color = mix(color, bronze, band)
    rough = rough * (1 - band) + band * np.clip(0.32 + 0.25 * patina, 0, 1)
    metallic = band * (1 - 0.6 * patina)

    soil = step(v, 0.835, 0.002)
    earth = mix([0.03, 0.02, 0.012], [0.13, 0.09, 0.055], step(noise(rng, size, 12, 6), 0, 0.6))
    earth = mix(earth, [0.45, 0.43, 0.4], step(noise(rng, size, 5, 2), 1.8, 0.1))
    color = mix(color, earth, soil)
    rough = rough * (1 - soil) + 0.92 * soil
    metallic = metallic * (1 - soil)
    return np.clip(color, 0.01, 0.9), rough, metallic


def stone_maps(rng, size=1024):
    base = mix([0.13, 0.125, 0.12], [0.34, 0.32, 0.29], step(noise(rng, size, 60, 7), 0, 0.8))
    base = mix(base, [0.55, 0.53, 0.5], step(noise(rng, size, 3, 3), 1.6, 0.15))
    base = mix(base, [0.03, 0.03, 0.03], step(noise(rng, size, 3, 3), 1.8, 0.15))
    base = mix(base, [0.4, 0.36, 0.1], step(noise(rng, size, 40, 6), 1.4, 0.1))  # lichen
    return base, np.full((size, size), 0.9), np.zeros((size, size))


def log_maps(rng, size=1024):
    """Bark along v in [0.2, 0.8], cut faces with rings outside."""
    v, u = np.mgrid[0:size, 0:size] / size
    v = 1 - v
    fissures = gaussian_filter(noise(rng, size, 12, 5), (9, 0.8), mode="wrap")
    bark = mix([0.035, 0.024, 0.017], [0.22, 0.16, 0.11], step(fissures / fissures.std(), 0, 0.5))
    bark = mix(bark, [0.2, 0.28, 0.12], step(noise(rng, size, 30, 7), 1.3, 0.15))
    radius = np.where(v < 0.5, v / 0.2, (1 - v) / 0.2)
    rings = 0.5 + 0.5 * np.sin(60 * radius + 1.5 * noise(rng, size, 80, 3))
    cut = (
        mix([0.24, 0.15, 0.07], [0.52, 0.38, 0.22], rings)
        * np.exp(0.08 * noise(rng, size, 3, 2))[..., None]
    )
    inside = step(np.abs(v - 0.5), 0.302, 0.002)
    return np.clip(mix(bark, cut, inside), 0.01, 0.9), 0.78 - 0.15 * inside, np.zeros((size, size))


# ---------------------------------------------------------------- geometry


def grid_faces(n: int, m: int) -> np.ndarray:
    """Two triangles per cell of an (n + 1) x (m + 1) vertex grid, counter-clockwise seen along -(du
    x dv).
    """
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a = (i * (m + 1) + j).ravel()
    b, c, d = a + 1, a + m + 1, a + m + 2
    return np.concatenate([np.stack([a, c, d], 1), np.stack([a, d, b], 1)])


def sheet(n: int, m: int):
    """Parameters u along columns, v along rows, both (n + 1, m + 1)."""
    return np.meshgrid(np.linspace(0, 1, m + 1), np.linspace(0, 1, n + 1))


def pot(rng) -> Part:
    """Surface of revolution; soil 18 mm below the rim keeps the concavity shallow."""
    profile = np.array(
        [
            (0, 0),
            (0.062, 0),
            (0.068, 0.004),
            (0.078, 0.03),
            (0.086, 0.043),
            (0.0905, 0.044),
            (0.093, 0.062),
            (0.0935, 0.068),
            (0.0905, 0.069),
            (0.1, 0.10),
            (0.104, 0.13),
            (0.101, 0.155),
            (0.096, 0.172),
            (0.104, 0.180),
            (0.107, 0.187),
            (0.102, 0.191),
            (0.093, 0.189),
            (0.09, 0.174),
            (0, 0.172),
        ]
    )
    arc = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))])
    u, v = sheet(300, 256)
    r = np.interp(v, arc / arc[-1], profile[:, 0])
    y = np.interp(v, arc / arc[-1], profile[:, 1])
    bumps = noise(rng, 512, 14, 4)[(v * 511).astype(int), ((u % 1) * 511).astype(int)]
    y = y + np.where(
        v > 0.84, 0.0022 * bumps * np.clip((v - 0.84) * 30, 0, 1) * np.clip((1 - v) * 30, 0, 1), 0
    )
    a = 2 * np.pi * u
    p = np.stack([r * np.sin(a), y, r * np.cos(a)], -1).reshape(-1, 3)
    return Part(
        "pot", p, grid_faces(300, 256)[:, ::-1], np.stack([u, v], -1).reshape(-1, 2), *pot_maps(rng)
    )


def displace(rng, u, v, smooth, octaves) -> np.ndarray:
    field = noise(rng, 512, smooth, octaves)
    return map_coordinates(field, [v * 511, (u % 1) * 512], order=1, mode="grid-wrap")


def stone(rng) -> Part:
    u, v = sheet(128, 256)
    a, b = 2 * np.pi * u, np.pi * (v - 0.5)
    edge = np.clip(np.cos(b) * 4, 0, 1)
    r = 0.072 * (
        1 + edge * (0.10 * displace(rng, u, v, 70, 3) + 0.025 * displace(rng, u, v, 14, 4))
    )
    p = np.stack(
        [1.25 * r * np.cos(b) * np.sin(a), 0.85 * r * np.sin(b), r * np.cos(b) * np.cos(a)], -1
    )
    p[..., 1] = np.maximum(p[..., 1] + 0.045, 0.0)
    p += [0.135, 0, 0.062]
    return Part(
        "stone",
        p.reshape(-1, 3),
        grid_faces(128, 256)[:, ::-1],
        np.stack([u, v], -1).reshape(-1, 2),
        *stone_maps(rng),
    )


def log(rng) -> Part:
    u, v = sheet(200, 192)
    bark = np.abs(v - 0.5) <= 0.3
    radial = np.where(v < 0.2, v / 0.2, np.where(v > 0.8, (1 - v) / 0.2, 1.0))
    r = (
        0.046
        * radial
        * (
            1
            + np.where(bark, 0.035, 0) * displace(rng, u, v, 10, 4)
            + 0.05 * np.sin(2 * np.pi * u + 1)
        )
    )
    along = (np.clip((v - 0.2) / 0.6, 0, 1) - 0.5) * 0.19
    a = 2 * np.pi * u
    p = np.stack([along, r * np.sin(a), r * np.cos(a)], -1)
    turn = np.radians(35)
    p = p @ np.array([[np.cos(turn), 0, -np.sin(turn)], [0, 1, 0], [np.sin(turn), 0, np.cos(turn)]])
    p = p + [0.075, 0.047, -0.128]
    p[..., 1] = np.maximum(p[..., 1], 0.0)
    return Part(
        "log",
        p.reshape(-1, 3),
        grid_faces(200, 192),
        np.stack([u, v], -1).reshape(-1, 2),
        *log_maps(rng),
    )


def plane(name, half, y, maps, repeat=1) -> Part:
    p = np.array([[-half, y, half], [half, y, half], [half, y, -half], [-half, y, -half]], float)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float) * repeat
    return Part(name, p, np.array([[0, 1, 2], [0, 2, 3]]), uv, *maps)


def hedge(rng, maps) -> Part:
    u, v = sheet(60, 720)
    a = 2 * np.pi * u
    r = 5.2 + 0.18 * displace(rng, u * 3, v * 0.22, 10, 4)
    y = -0.75 + v * (2.3 + 0.25 * displace(rng, u, 0 * v, 30, 3))
    p = np.stack([r * np.sin(a), y, r * np.cos(a)], -1).reshape(-1, 3)
    return Part(
        "hedge", p, grid_faces(60, 720), np.stack([u * 16, v * 1.2], -1).reshape(-1, 2), *maps
    )


def build_parts(seed: int) -> list[Part]:
    """Object parts first (pot, stone, log), then table, lawn, hedge."""
    rng = np.random.default_rng(seed)
    return [
        pot(rng),
        stone(rng),
        log(rng),
        plane("table", 1.2, 0.0, table_maps(rng)),
        plane("lawn", 9, -0.75, lawn_maps(rng), 6),
        hedge(rng, hedge_maps(rng)),
    ]


# ---------------------------------------------------------------- light


def sky(
    rng, h=128, sun_elevation=42.0, sun_azimuth=130.0, sun_share=0.55, tint=(1.0, 0.9, 0.75)
) -> np.ndarray:
    """Hazy sky with a widened sun (Gaussian, 3 degrees) that gives `sun_share` of the horizontal
    irradiance.
    """
    d = directions(h, 2 * h)
    e, a = np.radians([sun_elevation, sun_azimuth])
    s = np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])
    up = np.clip(d[..., 1], 0, 1)
    field = mix([0.85, 0.92, 1.0], [0.25, 0.45, 0.95], up**0.5)
    clouds = step(
        gaussian_filter(rng.normal(size=(h, 2 * h)), h / 16, mode=("nearest", "wrap")) * h / 8,
        0.4,
        0.35,
    )
    field = mix(field, [1.1, 1.08, 1.05], clouds)
    field = field * (1 + 1.5 * np.exp((d @ s - 1) * 12))[..., None]
    field = np.where(d[..., 1:2] < 0, 0.12 * np.array([0.5, 0.6, 0.3]), field)
    weight = solid_angles(h, 2 * h)[..., None]
    base = (field * np.maximum(d[..., 1:2], 0) * weight).sum((0, 1)).mean()
    disc = np.exp((d @ s - 1) / np.radians(3.0) ** 2)[..., None] * np.array(tint)
    flux = (disc * np.maximum(d[..., 1:2], 0) * weight).sum((0, 1)).mean()
    return (field + disc * base / flux * sun_share / (1 - sun_share)).astype(np.float32)


# ---------------------------------------------------------------- cameras and rendering


def cameras(seed: int, views: int) -> list[np.ndarray]:
    """Camera-to-world matrices (OpenGL axes), hand-held jitter in place and aim. views: 0 for as
    many as RINGS says; with more than these the rings are filled, with fewer some are left out.
    """
    rng, out = np.random.default_rng(seed), []
    filled = max(views / sum(count for _, count in RINGS), 1)
    for ring, (elevation, count) in enumerate(RINGS):
        count = int(np.ceil(filled * count))
        for k in range(count):
            a = 2 * np.pi * (k + 0.37 * ring) / count + rng.normal(0, 0.04)
            e = np.radians(elevation + rng.normal(0, 1.5))
            eye = AIM + DISTANCE * rng.normal(1, 0.03) * np.array(
                [np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)]
            )
            z = eye - (AIM + rng.normal(0, 0.006, 3))
            z /= np.linalg.norm(z)
            x = np.cross([np.sin(rng.normal(0, 0.02)), 1, 0], z)
            x /= np.linalg.norm(x)
            m = np.eye(4)
            m[:3] = np.stack([x, np.cross(z, x), z, eye], 1)
            out.append(m)
    kept = np.linspace(0, len(out) - 1, views or len(out)).round().astype(int)
    return [out[k] for k in kept]


def sensor(c2w: np.ndarray, width=WIDTH, height=HEIGHT):
    to_world = c2w @ np.diag([-1.0, 1, -1, 1])  # Mitsuba looks along +z with x to the left
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": float(np.degrees(2 * np.arctan(18 / FOCAL_35))),
            "fov_axis": "x",
            "to_world": mi.ScalarTransform4f(to_world),
            "near_clip": 0.01,
            "sampler": {"type": "independent"},
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
            },
        }
    )


def to_mesh(part: Part, with_material=True):
    bsdf = None
    if with_material:
        texture = lambda x: {
            "type": "bitmap",
            "raw": True,
            "data": mi.TensorXf(np.atleast_3d(x).astype(np.float32)),
        }
        bsdf = mi.load_dict(
            {
                "type": "twosided",
                "b": {
                    "type": "principled",
                    "specular": 0.5,
                    "base_color": texture(part.base_color),
                    "roughness": texture(part.roughness),
                    "metallic": texture(part.metallic),
                },
            }
        )
    properties = mi.Properties()
    if bsdf is not None:
        properties["bsdf"] = bsdf
    mesh = mi.Mesh(
        part.name,
        len(part.vertices),
        len(part.faces),
        has_vertex_texcoords=True,
        has_vertex_normals=True,
        props=properties,
    )
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = part.vertices.astype(np.float32).ravel()
    parameters["faces"] = part.faces.astype(np.uint32).ravel()
    parameters["vertex_texcoords"] = (
        np.stack([part.uv[:, 0], 1 - part.uv[:, 1]], 1).astype(np.float32).ravel()
    )
    parameters.update()
    return mesh


def build_scene(parts: list[Part], env: np.ndarray | None):
    scene = {"type": "scene"} | {p.name: to_mesh(p) for p in parts}
    if env is not None:
        scene["light"] = {"type": "envmap", "bitmap": mi.Bitmap(env)}
    return mi.load_dict(scene)


def photograph(linear: np.ndarray, rng) -> Image.Image:
    """Photon noise (12000 electrons at full scale), read noise, 8-bit sRGB."""
    electrons = 12000
    noisy = rng.poisson(np.clip(linear, 0, 1.2) * electrons) / electrons + rng.normal(
        0, 0.0012, linear.shape
    )
    return Image.fromarray((linear_to_srgb(noisy) * 255 + 0.5).astype(np.uint8))


def exif() -> Image.Exif:
    """What the rendered camera says of itself."""
    tags = Image.Exif()
    tags[0x010F] = "Heliograph"  # make
    tags[0x0110] = "Rendered camera"  # model

    ifd = tags.get_ifd(0x8769)
    ifd[0x829A] = 1 / 125  # exposure time in seconds
    ifd[0x829D] = 8.0  # f-number
    ifd[0x8827] = 100  # ISO
    ifd[0x920A] = FOCAL_35
    ifd[0xA405] = int(FOCAL_35)  # on 35 mm film
    return tags


def find_exposure(scene, poses) -> float:
    """Expose like a photographer: 1.5 % of the scene near clipping. The factor belongs to the light
    and the photos.
    """
    integrator = mi.load_dict({"type": "path", "max_depth": 4})
    probe = [
        np.array(mi.render(scene, sensor=sensor(m, 192, 128), integrator=integrator, spp=32))
        for m in poses[::9]
    ]
    return float(0.88 / np.percentile(np.stack(probe).max(-1), 98.5))


def render_photos(scene, poses, exposure: float, out: Path, spp: int, seed: int) -> None:
    """Write images/garden_###.jpg."""
    integrator = mi.load_dict({"type": "path", "max_depth": 4})
    rng = np.random.default_rng(seed)
    for k, m in enumerate(progress(poses, "photos")):
        camera = sensor(m)
        rendered = mi.render(scene, sensor=camera, integrator=integrator, spp=spp, seed=seed + k)
        photo = photograph(np.array(rendered) * exposure, rng)
        photo.save(out / "images" / f"garden_{k:03d}.jpg", quality=87, exif=exif())


def lookup(part: Part, name: str, uv: np.ndarray) -> np.ndarray:
    image = np.atleast_3d(getattr(part, name))
    h, w = image.shape[:2]
    return image[
        np.clip(((1 - uv[:, 1]) * h).astype(int), 0, h - 1),
        np.clip((uv[:, 0] * w).astype(int), 0, w - 1),
    ]


def shape_numbers(scene) -> dict[str, int]:
    """Part name -> its number in the AOV `shape_index`: Dr.Jit's registry number, not the place in
    the scene.
    """
    import drjit as dr  # after pipeline, which has pointed it at its LLVM

    return {s.id(): int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(s))[0]) for s in scene.shapes()}


def trace_object(objects, everything, view, seed=0):
    """One sample per pixel: AOVs of the object alone, and where nothing else (the table) stands
    before it.
    """
    aov = mi.load_dict({"type": "aov", "aovs": "shape:shape_index,uv:uv,depth:depth"})
    hit = np.array(mi.render(everything, sensor=view, integrator=aov, spp=1, seed=seed))
    alone = np.array(mi.render(objects, sensor=view, integrator=aov, spp=1, seed=seed))
    return alone, (alone[..., -1] > 0) & (np.abs(alone[..., -1] - hit[..., -1]) < 1e-3)


def material_maps(parts, objects, everything, view, seen, passes=16) -> dict[str, np.ndarray]:
    """What the visible surface is made of: the mean over `passes` samples in each pixel of `seen`,
    zero elsewhere.
    """
    total = {
        "base_color": np.zeros(seen.shape + (3,)),
        "roughness": np.zeros(seen.shape + (1,)),
        "metallic": np.zeros(seen.shape + (1,)),
    }
    count = np.zeros(seen.shape + (1,))
    numbers = shape_numbers(objects)
    for seed in range(passes):  # seed 0 also made `seen`, hence count > 0 there
        alone, visible = trace_object(objects, everything, view, seed)
        for part in parts:
            here = visible & (np.round(alone[..., 0]).astype(int) == numbers[part.name])
            uv = np.stack([alone[here][:, 1], 1 - alone[here][:, 2]], 1)
            for name in total:
                total[name][here] += lookup(part, name, uv)
            count[here] += 1
    if not (count[seen] > 0).all():
        raise RuntimeError(
            "a pixel shows the object but none of its parts: shape indices do not match the parts"
        )
    mean = {k: np.where(seen[..., None], v / np.maximum(count, 1), 0) for k, v in total.items()}
    return {k: v.squeeze().astype(np.float32) for k, v in mean.items()}


def render_truth(parts, env, poses, out: Path, spp: int) -> None:
    """Masks of every fourth view; maps at half size for four views, and the same views under
    another light.
    """
    objects = build_scene(parts[:3], None)
    everything = build_scene(parts, None)
    full = build_scene(parts, env)
    integrator = mi.load_dict({"type": "path", "max_depth": 4})
    for k in progress(range(0, len(poses), 4), "masks"):
        _, mask = trace_object(objects, everything, sensor(poses[k]))
        Image.fromarray(mask).save(out / "truth" / "masks" / f"garden_{k:03d}.png", optimize=True)
    for k in progress(range(1, len(poses), max(len(poses) // 4, 1)), "maps and relit views"):
        view = sensor(poses[k], WIDTH // 2, HEIGHT // 2)
        name = f"garden_{k:03d}.exr"
        _, seen = trace_object(objects, everything, view)
        for key, image in material_maps(parts[:3], objects, everything, view, seen).items():
            write_exr(
                out / "truth" / {"base_color": "albedo"}.get(key, key) / name, image, half=True
            )
        linear = np.array(mi.render(full, sensor=view, integrator=integrator, spp=spp))
        write_exr(out / "truth" / "relight" / "evening" / name, linear * seen[..., None], half=True)


def write_object(parts, path: Path) -> None:
    """The still life without its table as one PLY."""
    import pymeshlab

    from pipeline.geometry.mesh_io import Mesh, save_mesh, vertex_normals

    offsets = np.cumsum([0] + [len(p.vertices) for p in parts])
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(
        pymeshlab.Mesh(
            np.concatenate([p.vertices for p in parts]),
            np.concatenate([p.faces + o for p, o in zip(parts, offsets)]),
        )
    )
    meshes.meshing_merge_close_vertices(threshold=pymeshlab.PercentageValue(0.01))
    meshes.meshing_decimation_quadric_edge_collapse(targetfacenum=60000, optimalplacement=False)
    vertices = meshes.current_mesh().vertex_matrix()
    faces = meshes.current_mesh().face_matrix()
    save_mesh(path, Mesh(vertices, faces, vertex_normals(vertices, faces)))


def write_facts(parts, poses, exposure: float, out: Path) -> None:
    """transforms_truth.json (cameras) and facts.json (units and what the other files of truth/
    hold).
    """
    frames = [
        {"file_path": f"images/garden_{k:03d}.jpg", "transform_matrix": m.tolist()}
        for k, m in enumerate(poses)
    ]
    cameras_json = {
        "frame": "Y-up, metres, camera-to-world with OpenGL axes",
        "fl_x": FOCAL_35 / 36 * WIDTH,
        "w": WIDTH,
        "h": HEIGHT,
        "object_size": 0.35,
        "frames": frames,
    }
    (out / "truth" / "transforms_truth.json").write_text(json.dumps(cameras_json, indent=1) + "\n")
    points = np.concatenate([p.vertices for p in parts])
    facts = {
        "units": "metres",
        "up": "+Y, table top at y = 0",
        "object_bounds": [points.min(0).round(4).tolist(), points.max(0).round(4).tolist()],
        "exposure": round(exposure, 4),
        "focal_35mm": FOCAL_35,
        "fx_px": FOCAL_35 / 36 * WIDTH,
        "envmap": "sky and sun times exposure; "
        "table, lawn and hedge are geometry and not part of it",
        "maps": "linear, mean over the pixel, 0 where the object is not visible; "
        "principled BSDF, specular 0.5",
        "relight": "whole scene (with table, lawn and hedge) under relight/evening.exr, "
        "object pixels only",
    }
    (out / "truth" / "facts.json").write_text(json.dumps(facts, indent=1) + "\n")


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("examples/garden"))
    parser.add_argument("--spp", type=int, default=32)
    parser.add_argument(
        "--views", type=int, default=0, help="so many photos, spread out: few for a quick look"
    )
    parser.add_argument(
        "--truth-only", action="store_true", help="leave images/ as it is, make truth/ anew"
    )
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


def main() -> None:
    args = arguments()
    for name in (
        "images",
        "truth/masks",
        "truth/albedo",
        "truth/roughness",
        "truth/metallic",
        "truth/relight/evening",
    ):
        (args.out / name).mkdir(parents=True, exist_ok=True)

    parts = build_parts(args.seed)
    poses = cameras(args.seed, args.views)

    env = sky(np.random.default_rng(args.seed + 1))
    scene = build_scene(parts, env)
    exposure = find_exposure(scene, poses)
    if not args.truth_only:
        render_photos(scene, poses, exposure, args.out, args.spp, args.seed)
    write_exr(args.out / "truth" / "envmap.exr", env * exposure, half=True)
    evening = (
        sky(np.random.default_rng(args.seed + 2), 128, 14.0, 250.0, 0.5, (1.0, 0.6, 0.3)) * exposure
    )
    write_exr(args.out / "truth" / "relight" / "evening.exr", evening, half=True)
    render_truth(parts, evening, poses, args.out, 2 * args.spp)
    write_object(parts[:3], args.out / "truth" / "mesh.ply")
    write_facts(parts[:3], poses, exposure, args.out)


if __name__ == "__main__":
    main()
