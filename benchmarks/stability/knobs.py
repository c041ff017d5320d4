"""KNOBS: the failure modes by name, each with its values from harmless to hard.

A knob spoils the inputs of a base scene (`spoil`), takes its photos anew (`shoot`), or renders
another scene (`render`). Its first value is the harmless one; where that is a base scene with
nothing changed, the base's own rows stand for it. To add a knob, add an entry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.stability import cameras, lights, masks, meshes, photos, things
from benchmarks.stability.scenes import (
    Recipe,
)
from benchmarks.stability.spoil import (
    Spoiler,
    on_cameras,
    on_exposure,
    on_masks,
    on_mesh,
    on_photos,
    on_pictures,
)
from benchmarks.suite.make import LIGHT_ROWS
from pipeline.base.errors import InputError, nearest

Render = Callable[[Recipe, float], Recipe]
Shot = Callable[[lights.Shoot, float], np.ndarray]


@dataclass(frozen=True)
class Knob:
    """title, unit: of the curve's axis; values: from harmless to hard.

    render(recipe, value) -> the scene's recipe; shoot: its fit photos, taken anew; spoil: a change
    of the folder. settings: of the chain, at every value; without_mesh: the surface is made from
    the masks. harmless: name of the first scene, where several knobs share it; from_base: it is
    the base. draws: the value is how many there are; first: it is the number of the first.
    """

    title: str
    unit: str
    values: tuple[float, ...]
    spoil: Spoiler | None = None
    render: Render | None = None
    shoot: Shot | None = None
    settings: dict = field(default_factory=dict)
    without_mesh: bool = False
    harmless: str = ""
    from_base: bool = False
    draws: bool = False
    first: bool = False

    @property
    def own_base(self) -> bool:
        """Whether its harmless scene is not the base."""
        return (self.render is not None and not self.from_base) or self.without_mesh

    @property
    def of_the_run(self) -> bool:
        """Whether every value has the same scene."""
        return self.draws or self.first

    def seeds(self, value: float, draws: int) -> list[int]:
        """Numbers of the draws at a value."""
        start = int(value) if self.first else 0
        return list(range(start, start + (int(value) if self.draws else draws)))


def on_thing(change: Callable) -> Render:
    """change(thing, value) -> thing."""
    return lambda recipe, value: replace(recipe, thing=change(recipe.thing, value))


def in_light(make: Callable[[float], np.ndarray]) -> Render:
    return lambda recipe, value: replace(recipe, light=make(value))


def with_views(recipe: Recipe, count: float) -> Recipe:
    return replace(recipe, options=replace(recipe.options, views=int(count)))


GROUP = ("pedestal_ball", "torus_knot", "rounded_case", "blob")
HULL = {"mesh": {"method": "hull", "grid": 96}}
sun = in_light(lambda peak: lights.sun_and_sky(peak, LIGHT_ROWS))
lamp = in_light(lambda _: lights.lamp_and_room(LIGHT_ROWS))

KNOBS: dict[str, Knob] = {
    # photos
    "views": Knob("photos", "", (48, 16, 6, 3), render=with_views),
    "gap": Knob(
        "sector without a photo",
        "degrees",
        (0, 120, 240, 300),
        on_cameras(cameras.baseline_gap),
    ),
    "exposure": Knob(
        "exposure jitter", "stops", (0, 0.1, 0.3, 1), on_photos(photos.exposure_jitter)
    ),
    "white_balance": Knob(
        "white-balance jitter",
        "log",
        (0, 0.03, 0.1, 0.3),
        on_photos(photos.white_balance_jitter),
    ),
    "blur": Knob("defocus", "pixels", (0, 0.7, 1.5, 4), on_photos(photos.blur)),
    "motion_blur": Knob("motion blur", "pixels", (0, 2, 5, 12), on_photos(photos.motion_blur)),
    "noise": Knob("photon noise at white", "", (0, 0.03, 0.1, 0.3), on_photos(photos.noise)),
    "jpeg": Knob("JPEG quality", "", (photos.LOSSLESS, 75, 20, 3), on_pictures(photos.jpeg)),
    "clipped": Knob(
        "pixels that are clipped",
        "share",
        (0, 0.1, 0.3, 0.7),
        on_exposure(photos.clipping_gain),
    ),
    "underexposed": Knob("underexposure", "stops", (0, 2, 4, 7), on_exposure(photos.underexposure)),
    # cameras
    "pose": Knob("pose noise", "degrees", (0, 0.2, 1, 4), on_cameras(cameras.pose_noise)),
    "focal": Knob(
        "focal length too long",
        "share",
        (0, 0.02, 0.08, 0.3),
        on_cameras(cameras.focal_error),
    ),
    # masks, with the surface made from them
    "mask_grown": Knob(
        "masks too large",
        "pixels",
        (0, 1, 3, 8),
        on_masks(masks.moved_edge),
        settings=HULL,
        without_mesh=True,
        harmless="hull",
    ),
    "mask_shrunk": Knob(
        "masks too small",
        "pixels",
        (0, -1, -3, -8),
        on_masks(masks.moved_edge),
        settings=HULL,
        without_mesh=True,
        harmless="hull",
    ),
    "mask_missing": Knob(
        "masks missing",
        "share",
        (0, 0.25, 0.6, 1),
        on_masks(masks.missing),
        settings=HULL,
        without_mesh=True,
        harmless="hull",
    ),
    # given meshes
    "mesh_shift": Knob("mesh moved", "radii", (0, 0.02, 0.06, 0.2), on_mesh(meshes.shifted)),
    "mesh_scale": Knob("mesh too large", "share", (0, 0.03, 0.1, 0.3), on_mesh(meshes.scaled)),
    "mesh_holes": Knob("mesh with holes", "share", (0, 0.05, 0.2, 0.5), on_mesh(meshes.holes)),
    "mesh_flipped": Knob(
        "triangles inside out", "share", (0, 0.1, 0.3, 1), on_mesh(meshes.flipped)
    ),
    "mesh_rough": Knob(
        "mesh's vertices displaced",
        "radii",
        (0, 0.005, 0.015, 0.05),
        on_mesh(meshes.rough),
    ),
    "uv_overlap": Knob(
        "texture used twice",
        "share",
        (0, 0.1, 0.25, 0.5),
        on_mesh(meshes.overlapping_uv),
    ),
    # light
    "sun": Knob("sun's peak over the median", "", (10, 1e2, 1e3, 1e5), render=sun),
    "near_light": Knob(
        "nearness of the lamp",
        "1 / radii",
        (0, 0.1, 0.25, 0.6),
        render=lamp,
        shoot=lights.near_lamp,
    ),
    "turntable": Knob(
        "light turns with the camera", "share", (0, 0.05, 0.2, 1), shoot=lights.turntable
    ),
    "photographer": Knob(
        "photographer's size", "degrees", (0, 10, 25, 50), shoot=lights.photographer
    ),
    # material and shape
    "roughness": Knob(
        "roughness",
        "",
        (1, 0.5, 0.2, things.SHARPEST),
        render=on_thing(things.of_roughness),
    ),
    "metal": Knob(
        "metal",
        "share",
        (0, 0.3, 0.7, 1),
        render=on_thing(things.of_metal_share),
        from_base=True,
    ),
    "mirror": Knob(
        "mirror",
        "share",
        (0, 0.2, 0.6, 1),
        render=on_thing(things.of_mirror_share),
        from_base=True,
    ),
    "translucent": Knob(
        "light that goes through",
        "share",
        (0, 0.2, 0.5, 1),
        render=on_thing(things.of_transmission),
        from_base=True,
    ),
    "black": Knob(
        "mean base colour, to black",
        "",
        (0.4, 0.15, 0.05, 0.02),
        render=on_thing(things.of_albedo),
        harmless="grey",
    ),
    "snow": Knob(
        "mean base colour, to snow",
        "",
        (0.4, 0.6, 0.8, 0.95),
        render=on_thing(things.of_albedo),
        harmless="grey",
    ),
    "texture": Knob(
        "textured",
        "share",
        (1, 0.5, 0.1, 0),
        render=on_thing(things.of_texture_share),
        from_base=True,
    ),
    "bowl": Knob(
        "depth of a white bowl",
        "",
        (0.2, 0.6, 1, 1.6),
        render=on_thing(lambda _, depth: things.bowl_of_depth(depth)),
    ),
    "thin": Knob(
        "radius of rods",
        "",
        (0.25, 0.12, 0.06, 0.02),
        render=on_thing(lambda _, radius: things.rods(radius)),
    ),
    "objects": Knob(
        "objects",
        "",
        (1, 2, 3, 4),
        render=on_thing(lambda _, count: things.several(GROUP, int(count))),
    ),
    # the run
    "seeds": Knob("first draw's number", "", (0, 3, 6, 9), first=True),
    "draws": Knob("draws", "", (12, 6, 3, 2), draws=True),
}


def knob_named(name: str) -> Knob:
    """Raises InputError for an unknown name."""
    if name not in KNOBS:
        raise InputError(f"there is no knob '{name}'", "--knobs", nearest(name, KNOBS))
    return KNOBS[name]
