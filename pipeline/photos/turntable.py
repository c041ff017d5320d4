"""Does the light move with the camera? An object on a turntable before a fixed camera and lamp, or
a flash on the camera.

One distant light around the object explains photos of a static scene only. Structure from motion
cannot tell the two apart, for it sees relative motion. Brightness can. Let d be the angle, about
the vertical axis, from a point's own middle view to a view. In static light a matt point keeps its
brightness over d. In light that moves with the camera every point brightens and darkens as it
turns past the lamp, and all points by the same course f(d). The evidence is the share of the
variance of matched points' log brightness, each less its own mean, that one common

    f(d) = a sin d + b cos d + c sin 2d + e cos 2d

explains. Gloss is no evidence: in static light each point has its highlight at another d.

Where no points were matched, the surface's own texels take their place (render/moving_light.py).

Where the light moves, the cameras' path says which of the two it is: a turntable's cameras stand on
a circle to within a fraction of a per cent, hand-held ones to within ten.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from pipeline.base.errors import InputError
from pipeline.geometry.cameras import View
from pipeline.photos.readings import Readings

MOVING = 0.1  # explained share from which the light moves with the camera
CIRCLE = 0.02  # deviation from a circle, over its radius, up to which it is a turntable's
FEWEST_VIEWS = 8
FEWEST_POINTS = 100
SEEN_BY = 4  # views of a point


@dataclass
class LightMotion:
    """explained: share of variance that turning past the lamp explains, None where too few points
    were matched; points: how many were; circle: the cameras' deviation from a circle over its
    radius; course: root mean square of f(d) in stops; least_course: what it must reach at least.
    """

    explained: float | None
    points: int
    circle: float
    course: float | None = None
    least_course: float = 0.0

    @property
    def moves(self) -> bool:
        if self.explained is None or (self.course or 0.0) < self.least_course:
            return False
        return self.explained > MOVING

    def facts(self) -> dict:
        return asdict(self) | {"moves_with_camera": self.moves}


def light_motion(
    views: list[View], level: Readings, xyz: np.ndarray, center: np.ndarray, radius: float
) -> LightMotion:
    """Evidence from matched points xyz (n, 3) within the object's sphere. level: their log2
    brightness less the photos' gains.
    """
    on_object = np.linalg.norm(xyz - center, axis=1) < radius
    return motion_of(views, level.of_points(on_object), center)


def motion_of(
    views: list[View], level: Readings, center: np.ndarray, least_course: float = 0.0
) -> LightMotion:
    """Evidence from the log2 brightness of points on the object, whose axis passes through
    `center`.
    """
    positions = np.stack([v.position for v in views])
    up = -np.stack([v.world_to_camera[1, :3] for v in views]).mean(0)
    up /= np.linalg.norm(up)

    use = level.photos_of_points() >= SEEN_BY
    found: tuple[float | None, float | None] = None, None
    if len(views) >= FEWEST_VIEWS and use.sum() >= FEWEST_POINTS:
        found = explained_by_turning(level.of_points(use), azimuths(positions - center, up))
    share, course = found
    return LightMotion(share, int(use.sum()), off_circle(positions), course, least_course)


def azimuths(offsets: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Angle (n,) in radians about the unit vector `up` of offsets (n, 3) from the axis."""
    side = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    side /= np.linalg.norm(side)
    return np.arctan2(offsets @ np.cross(up, side), offsets @ side)


def explained_by_turning(level: Readings, azimuth: np.ndarray) -> tuple[float, float]:
    """Share of the variance of log brightness, each point less its mean, that f(d) explains, and
    the root mean square of f(d) over it. azimuth: (views,). Outliers are drawn in to three
    deviations.
    """
    count = level.photos_of_points()
    centred = lambda a: a - (level.sum_of_points(a) / count)[level.point]

    own = azimuth[level.view]
    middle = np.arctan2(level.sum_of_points(np.sin(own)), level.sum_of_points(np.cos(own)))
    d = own - middle[level.point]
    basis = np.stack([centred(f) for f in (np.sin(d), np.cos(d), np.sin(2 * d), np.cos(2 * d))], 1)

    rest = centred(level.value)
    limit = 3 * 1.4826 * np.median(np.abs(rest))
    rest = rest.clip(-limit, limit)
    if not rest.any():
        return 0.0, 0.0
    course = basis @ np.linalg.lstsq(basis, rest, rcond=None)[0]
    left = ((rest - course) ** 2).sum() / (rest**2).sum()
    return float(1 - left), float(np.sqrt((course**2).mean()))


def off_circle(positions: np.ndarray) -> float:
    """Root mean square distance of points (n, 3) from their best circle, over its radius."""
    centred = positions - positions.mean(0)
    _, _, axes = np.linalg.svd(centred, full_matrices=False)
    flat = centred @ axes[:2].T
    system = np.concatenate([2 * flat, np.ones((len(flat), 1))], 1)
    x, y, rest = np.linalg.lstsq(system, (flat**2).sum(1), rcond=None)[0]

    radius = np.sqrt(max(rest + x * x + y * y, 1e-12))
    radial = np.hypot(flat[:, 0] - x, flat[:, 1] - y) - radius
    return float(np.sqrt((radial**2 + (centred @ axes[2]) ** 2).mean()) / radius)


def resting(motion: LightMotion) -> str:
    """What light that rests would look like."""
    if not motion.least_course or motion.course is None:
        return "static light: below 3 %"
    return f"{motion.course:.2f} stops; static light: below {motion.least_course:g}"


def check(
    motion: LightMotion, where: str, accept: bool, out_of_focus: Sequence[str] = ()
) -> list[str]:
    """What to tell the user: nothing, or, where the light moves and `accept` is set, one warning.
    out_of_focus: what focus.py says of the photos. Blur may look like light that moves.

    Raises InputError where the light moves and `accept` is not set.
    """
    if not motion.moves:
        return []
    course = (
        f"{100 * (motion.explained or 0):.0f} % of what changes in brightness follows the turn "
        f"past the lamp ({resting(motion)})"
    )
    if out_of_focus:
        text = (
            f"{out_of_focus[0]}, and brightness changes as if the light moved with the camera: "
            f"{course}"
        )
        return refused_or_told(text, where, accept, "photograph in focus")

    turntable = motion.circle < CIRCLE
    kind = (
        "the object was turned before a fixed camera and lamp (the cameras stand on a circle to "
        f"within {100 * motion.circle:.1f} %)"
        if turntable
        else "a lamp or flash moves with the camera"
    )
    text = (
        f"the light moves with the camera: {course}; {kind}. No one light around the object "
        "explains such photos"
    )
    cure = "photograph a resting object in resting light and walk around it"
    return refused_or_told(text, where, accept, cure)


def refused_or_told(text: str, where: str, accept: bool, cure: str) -> list[str]:
    """`text` as a warning where `accept` is set. Raises InputError where it is not."""
    if accept:
        return [f"{text}: light and materials of the asset are not to be trusted"]
    way_on = "or set `poses: {moving_light: accept}` to have mesh and textures all the same"
    raise InputError(text, where, f"{cure}, {way_on}")
