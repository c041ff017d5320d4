"""Procedural lat-long lights, so that the prior sees more suns, skies, windows and lamps than a hundred photographs hold.

Outdoor: Mitsuba's sun-and-sky model (Wilkie et al. 2021) over noise ground, skyline and clouds. Indoor: a box room with
furniture, windows and lamps seen from a random point; surfaces lit by sampled emitters plus an ambient term.
Arrays are (h, w, 3) relative radiance.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from ..envmap import directions, solid_angles

SUN_HALF_ANGLE = np.radians(0.2665)


def noise(rng, h: int, w: int, smooth: float, octaves: int = 4) -> np.ndarray:
    """Fractal noise, wrapped in longitude, zero mean and unit variance; `smooth` is the coarsest blur in pixels."""
    out = np.zeros((h, w))
    for octave in range(octaves):
        layer = gaussian_filter(rng.normal(size=(h, w)), smooth / 2**octave, mode=("nearest", "wrap"))
        out += layer / (layer.std() + 1e-9) / 2**octave
    return out / out.std()


def _sky_radiance(sun: np.ndarray, turbidity: float, albedo: float, d: np.ndarray, disc: bool) -> np.ndarray:
    """Evaluate Mitsuba's `sunsky` emitter in directions d (..., 3), Y-up; sky only, or the sun's disc only."""
    from ..runtime import mitsuba as mi
    import drjit as dr
    turn = mi.ScalarTransform4f().rotate([1, 0, 0], -90)             # the emitter is Z-up
    emitter = mi.load_dict({"type": "sunsky", "sun_direction": [sun[0], sun[1], sun[2]], "turbidity": turbidity,
                            "albedo": albedo, "to_world": turn, "sun_scale": float(disc), "sky_scale": float(not disc)})
    si = dr.zeros(mi.SurfaceInteraction3f, d.size // 3)
    si.wi = -mi.Vector3f(np.ascontiguousarray(d.reshape(-1, 3).T, np.float32))
    return np.array(emitter.eval(si)).T.reshape(d.shape)


def outdoor(rng: np.random.Generator, h: int, w: int) -> np.ndarray:
    """Sun and sky over a noise ground with a skyline and clouds."""
    d = directions(h, w)
    elevation, azimuth = np.radians(rng.uniform(2, 75)), rng.uniform(0, 2 * np.pi)
    sun = np.array([np.cos(elevation) * np.sin(azimuth), np.sin(elevation), np.cos(elevation) * np.cos(azimuth)])
    turbidity, ground_albedo = rng.uniform(1.5, 9.5), rng.uniform(0.05, 0.5)
    up = np.maximum(d, [-1, 0.02, -1])
    sky = _sky_radiance(sun, turbidity, ground_albedo, up / np.linalg.norm(up, axis=-1, keepdims=True), False)
    cover = rng.uniform(-1.5, 1.5)
    clouds = 1 / (1 + np.exp(-3 * (noise(rng, h, w, h / 6, 5) + cover)))
    grey = sky.mean((0, 1)).mean() * rng.uniform(0.5, 2.5)
    sky = sky * (1 - clouds[..., None]) + clouds[..., None] * grey * np.exp(0.3 * noise(rng, h, w, h / 8))[..., None]
    row, column = np.unravel_index((d @ sun).argmax(), (h, w))
    flux = _sky_radiance(sun, turbidity, ground_albedo, sun[None], True)[0] * np.pi * SUN_HALF_ANGLE**2
    flux = flux * (1 - clouds[row, column]) ** rng.uniform(1, 4)
    sky[row, column] += flux / solid_angles(h, w)[row, column]
    ambient = (sky * np.maximum(d[..., 1:2], 0) * solid_angles(h, w)[..., None]).sum((0, 1)) / np.pi + flux * sun[1] / np.pi
    return _with_ground(rng, sky, d, ambient)


def _with_ground(rng, sky, d, ambient):
    """Everything below a noise skyline becomes ground, hills, walls or trees: albedo times the light that falls there."""
    h, w = sky.shape[:2]
    height = np.radians(rng.choice([1, 5, 15, 30]) * np.abs(noise(rng, 1, w, w / 12, 4)[0]) + rng.uniform(-2, 6))
    color = rng.uniform(0.3, 1) * rng.uniform(0.75, 1, 3) * rng.choice([[0.35, 0.3, 0.22], [0.2, 0.3, 0.1], [0.5, 0.5, 0.5]])
    ground = ambient * color * np.exp(rng.uniform(0.1, 0.6) * noise(rng, h, w, h / 6, 5))[..., None]
    latitude = np.arcsin(np.clip(d[..., 1], -1, 1))
    upright = ambient * rng.uniform(0.05, 0.5) * rng.uniform(0.4, 1, 3) * np.exp(
        rng.uniform(0.2, 0.8) * noise(rng, h, w, h / 10, 5))[..., None]
    below = np.where((latitude > 0)[..., None], upright, ground)
    return np.where((latitude < height)[..., None], below, sky)


def _hit_box(origin, d, low, high, inside: bool):
    """Distance along d to an axis-aligned box (inf when missed), and the axis of the face hit."""
    with np.errstate(divide="ignore", invalid="ignore"):
        t0, t1 = (low - origin) / d, (high - origin) / d
    near, far = np.fmin(t0, t1), np.fmax(t0, t1)
    if inside:
        return far.min(-1), far.argmin(-1)
    enter, leave = near.max(-1), far.min(-1)
    return np.where((enter < leave) & (enter > 1e-3), enter, np.inf), near.argmax(-1)


def _emitters(rng, size):
    """Windows in the walls and lamps: (axis, at_high_end, low, high, radiance) rectangles on the room's faces."""
    out = []
    for _ in range(rng.integers(0, 4)):                                # windows
        axis, end = rng.choice([0, 2]), rng.integers(0, 2)
        low, high = np.zeros(3), size.copy()
        other = 2 - axis
        width, center = rng.uniform(0.5, 2.5), rng.uniform(0.2, 0.8) * size[other]
        low[other], high[other] = max(center - width / 2, 0), min(center + width / 2, size[other])
        low[1], high[1] = rng.uniform(0, 1.0), rng.uniform(1.6, size[1] - 0.05)
        out.append((axis, end, low, high, rng.uniform(10, 200) * rng.uniform([0.6, 0.8, 1.0], [1.0, 1.0, 1.4])))
    for _ in range(rng.integers(0 if out else 1, 5)):                  # ceiling lamps, or glowing wall lamps
        axis = rng.choice([1, 1, 0, 2])
        side = np.exp(rng.uniform(np.log(0.05), np.log(0.6), 3))
        center = rng.uniform(0.15, 0.85, 3) * size
        out.append((axis, 1 if axis == 1 else rng.integers(0, 2), center - side / 2, center + side / 2,
                    np.exp(rng.uniform(np.log(50), np.log(5000))) * rng.uniform([1, 0.65, 0.3], [1, 1.0, 1.0])))
    return out


def indoor(rng: np.random.Generator, h: int, w: int) -> np.ndarray:
    """A furnished box room; direct light by 24 points per emitter (unoccluded), ambient by the mean radiosity."""
    size = np.array([rng.uniform(3, 10), rng.uniform(2.3, 4), rng.uniform(3, 10)])
    eye = rng.uniform(0.25, 0.75, 3) * size
    angle = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(angle), np.sin(angle)
    d = directions(h, w) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    t, axis = _hit_box(eye, d, np.zeros(3), size, True)
    wall = rng.uniform(0.3, 0.85, (3, 1)) * rng.uniform(0.75, 1, (3, 3))
    albedo = np.where((axis == 1)[..., None], np.where(d[..., 1:2] > 0, wall[1], wall[2]), wall[0])
    normal = -np.sign(np.take_along_axis(d, axis[..., None], -1)) * np.eye(3)[axis]
    emitters, glow = _emitters(rng, size), np.zeros((h, w, 3))
    point = eye + d * t[..., None]
    for a, end, low, high, radiance in emitters:
        on = (axis == a) & ((np.take_along_axis(d, axis[..., None], -1)[..., 0] > 0) == bool(end))
        tangent = [i for i in range(3) if i != a]
        on &= ((point[..., tangent] > low[tangent]) & (point[..., tangent] < high[tangent])).all(-1)
        glow[on] = radiance * np.exp(0.4 * noise(rng, h, w, h / 8))[on][:, None]
    for _ in range(rng.integers(2, 9)):
        extent, at = rng.uniform(0.3, 1.8, 3), rng.uniform(0, 1, 3) * size * [1, 0, 1]
        tb, ab = _hit_box(eye, d, at - extent / 2 * [1, 0, 1], at + extent * [0.5, 1, 0.5], False)
        near = tb < t
        t = np.where(near, tb, t)
        glow[near] = 0
        albedo[near] = rng.uniform(0.03, 0.8) * rng.uniform(0.5, 1, 3)
        normal[near] = (-np.sign(np.take_along_axis(d, ab[..., None], -1)) * np.eye(3)[ab])[near]
    point = eye + d * t[..., None]
    direct, power = _direct(rng, point, normal, emitters, size)
    ambient = power / (2 * (size[0] * size[1] + size[1] * size[2] + size[0] * size[2])) * rng.uniform(0.3, 0.9)
    texture = np.exp(rng.uniform(0.05, 0.35) * noise(rng, h, w, h / 12, 5))[..., None]
    return np.where(glow > 0, glow, albedo * texture * (direct / np.pi + ambient))


def _direct(rng, point, normal, emitters, size):
    """Irradiance (h, w, 3) from rectangles, and the total power that they emit (3,)."""
    out, power = np.zeros(point.shape), np.zeros(3)
    for axis, end, low, high, radiance in emitters:
        low, high = np.clip(low, 0, size), np.clip(high, 0, size)
        tangent = [i for i in range(3) if i != axis]
        area = np.prod((high - low)[tangent])
        power += np.pi * area * radiance
        for _ in range(24):
            q = rng.uniform(low, high)
            q[axis] = size[axis] * end
            v = q - point
            r2 = (v**2).sum(-1) + 0.05
            cosines = np.maximum((normal * v).sum(-1), 0) * np.abs(v[..., axis]) / r2
            out += (cosines / r2 * area / 24)[..., None] * radiance
    return out, power


def generate(count: int, height: int, seed: int, supersample: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """`count` maps (n, h, 2h, 3) half outdoor, half indoor, and labels as in `network.LABELS` (n,)."""
    from ..envmap import resample_area
    from ..progress import progress
    rng, maps, labels = np.random.default_rng(seed), [], []
    for k in progress(range(count), "procedural lights"):
        big = (outdoor, indoor)[k % 2](rng, supersample * height, 2 * supersample * height)
        maps.append(resample_area(big, height, 2 * height))
        labels.append((1, 0)[k % 2])
    return np.stack(maps), np.array(labels)
