"""Depth and normal of every pixel of a photo by slanted-plane PatchMatch.

Bleyer et al. 2011 (slanted planes), Galliani et al. 2015 (Gipuma: red-black propagation), Xu and
Tao 2019 (ACMH: the best plane of each of eight regions is tried; geometric consistency in the
cost).

A pixel's plane is known by the depth of the pixel's centre and by its unit normal in the camera's
frame. Its cost is 1 - ZNCC between the pixel's patch and the patches that the plane sends it to in
other photos, the mean of the best few: in the others the point may be hidden.

Letters: q = ((x - cx) / fx, (y - cy) / fy, 1) the ray of a pixel; z depth along the optical axis; n
unit normal towards the camera; M, t the rotation and shift from this camera into another one, K its
fx, fy, cx, cy, width, height; X, Y, Z a point there; u, v its pixel coordinates.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange

Single = Any  # a float32, which compiled code must not mix with Python's own float

REACH = 5  # half width of a patch in pixels
STEP = 2  # every second pixel of it is compared
SIDE = len(range(-REACH, REACH + 1, STEP))
SAMPLES = SIDE * SIDE
# of every sample of a patch from its centre, row by row
OFFSETS = np.arange(-REACH, REACH + 1, STEP, dtype=np.float32)
RIGHT, DOWN = np.tile(OFFSETS, SIDE), np.repeat(OFFSETS, SIDE)
BEST = 3  # other photos that count
ONE = np.float32(1)  # an integer beside a float32 would make it a float64
HALF = np.float32(0.5)
WORST = np.float32(2)  # cost of a patch that leaves the photo
PLAIN = np.float32(2e-6)  # variance of grey levels (0 to 1) below which a patch has no texture
COLOR_WIDTH = np.float32(0.12)  # grey levels that still belong together (bilateral weight)
GEOMETRIC_WEIGHT = np.float32(0.2)  # cost per pixel of reprojection error
GEOMETRIC_LIMIT = np.float32(3)  # pixels of it that count
STEEPEST = np.float32(0.12)  # cosine to the ray: a plane is seen at more than 7 degrees
STRETCH = np.float32(8)  # a patch is not compared with one so much larger


class Others(NamedTuple):
    """The photos that one photo is compared with.

    which: (n,) their places in `images` and `depths`; images: (views, h, w) grey, padded to one
    size; depths: (views, h, w) their own depths, used where `geometric`; rotations (n, 3, 3),
    shifts (n, 3): from this camera into theirs; cameras: (n, 6) fx, fy, cx, cy, width, height. All
    numbers float32.
    """

    which: np.ndarray
    images: np.ndarray
    depths: np.ndarray
    rotations: np.ndarray
    shifts: np.ndarray
    cameras: np.ndarray
    geometric: bool


class Patch(NamedTuple):
    """Grey values and bilateral weights (SAMPLES,) around pixel (x, y); weighted mean, variance."""

    x: int
    y: int
    values: np.ndarray
    weights: np.ndarray
    mean: Single
    variance: Single


class Plane(NamedTuple):
    """Depth of the pixel's centre and unit normal in the camera's frame."""

    z: Single
    n0: Single
    n1: Single
    n2: Single


@njit(fastmath=True, cache=True)
def patch_at(
    image: np.ndarray,
    width: int,
    height: int,
    x: int,
    y: int,
    values: np.ndarray,
    weights: np.ndarray,
) -> Patch:
    """The patch around pixel (x, y); `values` and `weights` are filled in place."""
    middle = image[y, x]
    total = np.float32(0)
    first = np.float32(0)
    second = np.float32(0)
    k = 0
    for row in range(SIDE):
        r = min(max(y - REACH + row * STEP, 0), height - 1)
        for column in range(SIDE):
            c = min(max(x - REACH + column * STEP, 0), width - 1)
            value = image[r, c]
            difference = (value - middle) / COLOR_WIDTH
            away = np.float32((row * STEP - REACH) ** 2 + (column * STEP - REACH) ** 2)
            near = np.exp(-away / np.float32(2 * REACH * REACH))
            weight = near / (ONE + difference * difference)
            values[k] = value
            weights[k] = weight
            total += weight
            first += weight * value
            second += weight * value * value
            k += 1

    for k in range(SAMPLES):
        weights[k] /= total
    mean = first / total
    return Patch(x, y, values, weights, mean, second / total - mean * mean)


@njit(fastmath=True, cache=True)
def photometric_cost(
    patch: Patch,
    plane: Plane,
    q0: Single,
    q1: Single,
    camera: np.ndarray,
    image: np.ndarray,
    M: np.ndarray,
    t: np.ndarray,
    K: np.ndarray,
) -> Single:
    """1 - ZNCC (0 to 2) of a patch with its picture in another photo under a plane.

    The plane's homography is replaced by its linear part at the patch's centre.
    """
    p0 = M[0, 0] * q0 + M[0, 1] * q1 + M[0, 2]
    p1 = M[1, 0] * q0 + M[1, 1] * q1 + M[1, 2]
    p2 = M[2, 0] * q0 + M[2, 1] * q1 + M[2, 2]
    Z = plane.z * p2 + t[2]
    if Z <= np.float32(1e-6):
        return WORST

    inverse = ONE / Z
    X = (plane.z * p0 + t[0]) * inverse
    Y = (plane.z * p1 + t[1]) * inverse
    u = K[0] * X + K[2] - HALF
    v = K[1] * Y + K[3] - HALF
    if (
        u < REACH
        or v < REACH
        or u >= K[4] - np.float32(REACH + 1)
        or v >= K[5] - np.float32(REACH + 1)
    ):
        return WORST

    # change of the point, then of its picture, per pixel to the right and down
    facing = plane.n0 * q0 + plane.n1 * q1 + plane.n2
    slope_x = -plane.n0 / facing
    slope_y = -plane.n1 / facing
    right = plane.z * inverse / camera[0]
    down = plane.z * inverse / camera[1]
    right_z = M[2, 0] + p2 * slope_x
    down_z = M[2, 1] + p2 * slope_y
    ux = K[0] * right * (M[0, 0] + p0 * slope_x - X * right_z)
    vx = K[1] * right * (M[1, 0] + p1 * slope_x - Y * right_z)
    uy = K[0] * down * (M[0, 1] + p0 * slope_y - X * down_z)
    vy = K[1] * down * (M[1, 1] + p1 * slope_y - Y * down_z)
    if abs(ux * vy - uy * vx) < np.float32(0.05) or abs(ux) + abs(uy) + abs(vx) + abs(vy) > STRETCH:
        return WORST

    first = np.float32(0)
    second = np.float32(0)
    cross = np.float32(0)
    most_u = K[4] - np.float32(1.001)
    most_v = K[5] - np.float32(1.001)
    # one loop without a sign in its indices: compiled to steps of several samples at once
    for k in range(SAMPLES):
        at_u = min(max(u + RIGHT[k] * ux + DOWN[k] * uy, np.float32(0)), most_u)
        at_v = min(max(v + RIGHT[k] * vx + DOWN[k] * vy, np.float32(0)), most_v)
        column = np.int32(at_u)
        row = np.int32(at_v)
        s = at_u - np.float32(column)
        r = at_v - np.float32(row)
        i = np.uint32(column)
        j = np.uint32(row)
        i1 = i + np.uint32(1)
        j1 = j + np.uint32(1)
        top = image[j, i] + s * (image[j, i1] - image[j, i])
        bottom = image[j1, i] + s * (image[j1, i1] - image[j1, i])
        value = top + r * (bottom - top)
        weighted = patch.weights[k] * value
        first += weighted
        second += weighted * value
        cross += weighted * patch.values[k]

    spread = second - first * first
    if spread < PLAIN:
        return np.float32(1)
    return ONE - (cross - first * patch.mean) / np.sqrt(spread * patch.variance)


@njit(fastmath=True, cache=True)
def reprojection_error(
    x: int,
    y: int,
    z: Single,
    q0: Single,
    q1: Single,
    camera: np.ndarray,
    depths: np.ndarray,
    M: np.ndarray,
    t: np.ndarray,
    K: np.ndarray,
) -> Single:
    """Pixels between the centre of pixel (x, y) and the place to which the other photo's own depth
    sends its picture back; at most GEOMETRIC_LIMIT, which also stands for no depth there.
    """
    X = z * (M[0, 0] * q0 + M[0, 1] * q1 + M[0, 2]) + t[0]
    Y = z * (M[1, 0] * q0 + M[1, 1] * q1 + M[1, 2]) + t[1]
    Z = z * (M[2, 0] * q0 + M[2, 1] * q1 + M[2, 2]) + t[2]
    if Z <= np.float32(1e-6):
        return GEOMETRIC_LIMIT
    u = K[0] * X / Z + K[2]
    v = K[1] * Y / Z + K[3]
    if u < 0 or v < 0 or u >= K[4] or v >= K[5]:
        return GEOMETRIC_LIMIT
    depth = depths[int(v), int(u)]
    if depth <= 0:
        return GEOMETRIC_LIMIT

    X = (u - K[2]) / K[0] * depth - t[0]
    Y = (v - K[3]) / K[1] * depth - t[1]
    Z = depth - t[2]
    a = M[0, 0] * X + M[1, 0] * Y + M[2, 0] * Z
    b = M[0, 1] * X + M[1, 1] * Y + M[2, 1] * Z
    c = M[0, 2] * X + M[1, 2] * Y + M[2, 2] * Z
    if c <= np.float32(1e-6):
        return GEOMETRIC_LIMIT
    du = camera[0] * a / c + camera[2] - (np.float32(x) + HALF)
    dv = camera[1] * b / c + camera[3] - (np.float32(y) + HALF)
    return min(np.sqrt(du * du + dv * dv), GEOMETRIC_LIMIT)


@njit(fastmath=True, cache=True)
def plane_cost(
    patch: Patch,
    plane: Plane,
    camera: np.ndarray,
    others: Others,
    costs: np.ndarray,
    limit: Single = WORST,
) -> Single:
    """Mean of the BEST smallest costs over the other photos; WORST as soon as it is sure not to be
    below `limit`, whatever the rest of them say. `costs` (n,): working space.
    """
    q0 = (np.float32(patch.x) + HALF - camera[2]) / camera[0]
    q1 = (np.float32(patch.y) + HALF - camera[3]) / camera[1]
    facing = plane.n0 * q0 + plane.n1 * q1 + plane.n2
    if facing > -STEEPEST * np.sqrt(q0 * q0 + q1 * q1 + ONE):
        return WORST

    count = len(others.which)
    best = min(BEST, count)
    enough = limit * np.float32(best)
    for k in range(count):
        M = others.rotations[k]
        t = others.shifts[k]
        K = others.cameras[k]
        image = others.images[others.which[k]]
        cost = photometric_cost(patch, plane, q0, q1, camera, image, M, t, K)
        if others.geometric:
            depths = others.depths[others.which[k]]
            cost += GEOMETRIC_WEIGHT * reprojection_error(
                patch.x, patch.y, plane.z, q0, q1, camera, depths, M, t, K
            )
        p = k
        while p > 0 and costs[p - 1] > cost:
            costs[p] = costs[p - 1]
            p -= 1
        costs[p] = cost

        # those that are still to come cost nothing at best
        least = np.float32(0)
        for p in range(best - (count - 1 - k)):
            least += costs[p]
        if least > enough:
            return WORST

    total = np.float32(0)
    for k in range(best):
        total += costs[k]
    return total / np.float32(best)


@njit(fastmath=True, cache=True)
def best_of_region(
    region: int, x: int, y: int, inside: np.ndarray, cost: np.ndarray
) -> tuple[int, int]:
    """Column and row of the cheapest plane in one of eight regions around (x, y), or (-1, -1):
    0 to 3 a wedge nearby (above, below, left, right), 4 to 7 a strip further out.
    """
    h, w = cost.shape
    dx = (0, 0, -1, 1)[region % 4]
    dy = (-1, 1, 0, 0)[region % 4]
    found = np.float32(1e9)
    at_x = -1
    at_y = -1
    first = 1 if region < 4 else 3
    last = 4 if region < 4 else 25
    pace = 1 if region < 4 else 2
    for step in range(first, last, pace):
        aside = step - 1 if region < 4 else 0
        for side in range(-aside, aside + 1, max(2 * aside, 1)):
            a = x + dx * step + dy * side
            b = y + dy * step + dx * side
            if 0 <= a < w and 0 <= b < h and inside[b, a] and cost[b, a] < found:
                found = cost[b, a]
                at_x = a
                at_y = b
    return at_x, at_y


@njit(fastmath=True, cache=True)
def carried(
    depth: Single, normal: np.ndarray, from_x: int, from_y: int, x: int, y: int, camera: np.ndarray
) -> Plane:
    """The plane of pixel (from_x, from_y) where it meets the ray of pixel (x, y); z = 0 where it
    does not.
    """
    own = (
        normal[0] * (np.float32(x) + HALF - camera[2]) / camera[0]
        + normal[1] * (np.float32(y) + HALF - camera[3]) / camera[1]
        + normal[2]
    )
    there = (
        normal[0] * (np.float32(from_x) + HALF - camera[2]) / camera[0]
        + normal[1] * (np.float32(from_y) + HALF - camera[3]) / camera[1]
        + normal[2]
    )
    z = depth * there / own if own < np.float32(-1e-3) else np.float32(0)
    return Plane(z, normal[0], normal[1], normal[2])


@njit(fastmath=True, cache=True)
def _random(state: Any) -> tuple[Any, Single]:
    """The next state of a linear congruential generator, and a number in [-1, 1)."""
    state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
    return state, np.float32((state >> np.uint64(40)) / 8388608.0 - 1.0)


@njit(fastmath=True, cache=True)
def _alike(a: Plane, b: Plane) -> Any:
    """Whether trying one plane after the other is not worth the time."""
    near = abs(a.z - b.z) < np.float32(2e-5) * a.z
    return near and a.n0 * b.n0 + a.n1 * b.n1 + a.n2 * b.n2 > np.float32(0.9995)


@njit(fastmath=True, cache=True)
def moved(
    plane: Plane, attempt: int, width: Single, low: Single, high: Single, state: Any
) -> tuple[Plane, Any]:
    """A plane nearby: depth and normal changed, or one of them. width: share of the range of
    depths (low to high) and, doubled, of the normal's length.
    """
    state, a = _random(state)
    state, b = _random(state)
    state, c = _random(state)
    state, d = _random(state)
    z = plane.z
    if attempt % 3 != 1:
        z = min(max(z + a * width * HALF * (high - low), low), high)
    if attempt % 3 == 0:
        return Plane(z, plane.n0, plane.n1, plane.n2), state
    lean = min(width + width, ONE)
    n0 = plane.n0 + b * lean
    n1 = plane.n1 + c * lean
    n2 = plane.n2 + d * lean
    length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) + np.float32(1e-12)
    return Plane(z, n0 / length, n1 / length, n2 / length), state


@njit(fastmath=True, parallel=True, cache=True)
def sweep(
    image: np.ndarray,
    camera: np.ndarray,
    others: Others,
    near: np.ndarray,
    far: np.ndarray,
    depth: np.ndarray,
    normal: np.ndarray,
    cost: np.ndarray,
    rows: np.ndarray,
    color: int,
    fresh: bool,
    spread: Single,
    tries: int,
    seed: int,
) -> None:
    """Improve the planes of one colour of the checkerboard, in place. In what order rows are taken
    changes nothing: planes of the other colour alone are looked at.

    image: (h, w) grey; near, far: (h, w) depths allowed, 0 where there is no object; depth (h, w),
    normal (h, w, 3), cost (h, w): the planes; rows: those with an object, of which every thread
    takes as many that lie together here; fresh: their costs are not known yet; spread: width of the
    first of `tries` random changes, see `moved`, each half as wide as the one before.
    """
    h, w = depth.shape
    inside = far > 0
    for place in prange(len(rows)):
        y = rows[place]
        values = np.empty(SAMPLES, np.float32)
        weights = np.empty(SAMPLES, np.float32)
        costs = np.empty(len(others.which), np.float32)
        for x in range((y + color) % 2, w, 2):
            if not inside[y, x]:
                continue
            patch = patch_at(image, w, h, x, y, values, weights)
            if patch.variance < PLAIN:
                cost[y, x] = 1
                continue
            plane = Plane(depth[y, x], normal[y, x, 0], normal[y, x, 1], normal[y, x, 2])
            best = plane_cost(patch, plane, camera, others, costs) if fresh else cost[y, x]

            state = np.uint64(seed) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(y * w + x)
            state, _ = _random(state)
            width = spread
            for attempt in range(8 + tries):
                if attempt < 8:
                    a, b = best_of_region(attempt, x, y, inside, cost)
                    if a < 0:
                        continue
                    other = carried(depth[b, a], normal[b, a], a, b, x, y, camera)
                    if other.z < near[y, x] or other.z > far[y, x] or _alike(other, plane):
                        continue
                else:
                    other, state = moved(plane, attempt - 8, width, near[y, x], far[y, x], state)
                    width *= HALF
                found = plane_cost(patch, other, camera, others, costs, best)
                if found < best:
                    best = found
                    plane = other
            depth[y, x] = plane.z
            normal[y, x, 0] = plane.n0
            normal[y, x, 1] = plane.n1
            normal[y, x, 2] = plane.n2
            cost[y, x] = best


@njit(fastmath=True, parallel=True, cache=True)
def count_agreeing(
    camera: np.ndarray,
    others: Others,
    depth: np.ndarray,
    normal: np.ndarray,
    normals: np.ndarray,
    tolerance: Single,
    cosine: Single,
) -> np.ndarray:
    """In how many of the other photos the surface stands in the same place: (h, w).

    depth (h, w), normal (h, w, 3): of this photo; others.depths, normals (views, h, w, 3): of all;
    tolerance: difference in depth; cosine: between normals, at least.
    """
    h, w = depth.shape
    out = np.zeros((h, w), np.float32)
    for y in prange(h):
        for x in range(w):
            z = depth[y, x]
            if z <= 0:
                continue
            q0 = (np.float32(x) + HALF - camera[2]) / camera[0]
            q1 = (np.float32(y) + HALF - camera[3]) / camera[1]
            n = normal[y, x]
            for k in range(len(others.which)):
                M = others.rotations[k]
                t = others.shifts[k]
                K = others.cameras[k]
                X = z * (M[0, 0] * q0 + M[0, 1] * q1 + M[0, 2]) + t[0]
                Y = z * (M[1, 0] * q0 + M[1, 1] * q1 + M[1, 2]) + t[1]
                Z = z * (M[2, 0] * q0 + M[2, 1] * q1 + M[2, 2]) + t[2]
                if Z <= 0:
                    continue
                u = K[0] * X / Z + K[2]
                v = K[1] * Y / Z + K[3]
                if u < 0 or v < 0 or u >= K[4] or v >= K[5]:
                    continue
                there = others.depths[others.which[k], int(v), int(u)]
                if there <= 0 or abs(there - Z) > tolerance:
                    continue
                m = normals[others.which[k], int(v), int(u)]
                alike = (
                    m[0] * (M[0, 0] * n[0] + M[0, 1] * n[1] + M[0, 2] * n[2])
                    + m[1] * (M[1, 0] * n[0] + M[1, 1] * n[1] + M[1, 2] * n[2])
                    + m[2] * (M[2, 0] * n[0] + M[2, 1] * n[1] + M[2, 2] * n[2])
                )
                if alike >= cosine:
                    out[y, x] += ONE
    return out
