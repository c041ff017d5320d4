"""Lights that are the knob, and photos taken anew in light that one distant map does not explain.

Lights are arrays (h, 2h, 3), relative radiance in the library's frame (pipeline/render/envmap.py).
Directions point from the object, Y-up.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.make_scene import Options, load_scene, render, sensor
from benchmarks.suite.lights import at_angles, make_light, sun_disc
from benchmarks.true_maps import camera_positions
from pipeline.base.images import read_exr
from pipeline.render.envmap import directions

SKY = "cloudy_12"
SUN = at_angles(40, 65)
LAMP = at_angles(35, 20)
LAMP_ANGLE = np.radians(12)  # half the angle that the lamp has, seen from the object's middle
LAMP_RADIANCE = 60.0
ROOM = 0.35  # radiance all around
SHADOW = 0.1  # of the light's radiance that is left where the photographer stands


def sun_and_sky(peak: float, h: int) -> np.ndarray:
    """A cloudy sky with a sun whose brightest pixel is `peak` times the map's median luminance."""
    sky = make_light(SKY, h)
    sky = np.minimum(sky, 2 * np.median(sky))  # no peak of its own
    disc = sun_disc(SUN, np.array([1.05, 1.0, 0.9]), h)
    middle = np.median(sky.mean(-1))
    strength = max(peak * middle - sky.mean(-1).max(), 0) / disc.mean(-1).max()
    return (sky + strength * disc).astype(np.float32)


def even_room(h: int) -> np.ndarray:
    """What is around besides the lamp."""
    height = directions(h, 2 * h)[..., 1:2]
    return (ROOM * (1 + 0.5 * height) * np.array([0.9, 1.0, 1.1])).astype(np.float32)


def lamp_and_room(h: int) -> np.ndarray:
    """The map of a round lamp of LAMP_ANGLE, as it is at any distance, and of the room."""
    fine = directions(4 * h, 8 * h) @ LAMP > np.cos(LAMP_ANGLE)
    share = fine.reshape(h, 4, 2 * h, 4).mean((1, 3))[..., None]
    return ((1 - share) * even_room(h) + share * LAMP_RADIANCE).astype(np.float32)


@dataclass
class Shoot:
    """Where photos are taken anew. light: the map of the scene at its photos' exposure."""

    asset: Path
    options: Options
    light: np.ndarray

    def photos(self, scene_for) -> np.ndarray:
        """Linear photos (n, h, w, 3) of the fit views; scene_for(position (3,)) -> Mitsuba's."""
        out = []
        for k, position in enumerate(camera_positions(self.options.views, self.options.seed)):
            camera = sensor(position, self.options.size)
            seed = k + 1000 * self.options.seed
            out.append(render(scene_for(position), camera, self.options.spp, seed))
        return np.array(out)


def shoot_of(folder: Path, asset: Path, options: Options) -> Shoot:
    return Shoot(asset, options, read_exr(folder / "truth" / "envmap.exr"))


def near_lamp(shoot: Shoot, nearness: float) -> np.ndarray:
    """The lamp at 1 / nearness from the object's middle, as large in angle as in the map. In light
    of `lamp_and_room`.
    """
    h = len(shoot.light)
    exposure = shoot.light.sum() / lamp_and_room(h).sum()
    distance = 1 / nearness
    lamp = {
        "type": "sphere",
        "center": (distance * LAMP).tolist(),
        "radius": float(distance * np.sin(LAMP_ANGLE)),
        "emitter": {
            "type": "area",
            "radiance": {"type": "rgb", "value": [float(LAMP_RADIANCE * exposure)] * 3},
        },
    }
    scene = load_scene(shoot.asset, even_room(h) * exposure, more={"lamp": lamp})
    return shoot.photos(lambda position: scene)


def turntable(shoot: Shoot, share: float) -> np.ndarray:
    """The light turns by this share of the camera's turn about the vertical: 1 is an object on a
    turntable before a fixed camera, or a flash.
    """
    first = camera_positions(shoot.options.views, shoot.options.seed)[0]
    azimuth = lambda position: np.degrees(np.arctan2(position[0], position[2]))

    def scene_for(position: np.ndarray):
        turn = (azimuth(position) - azimuth(first) + 180) % 360 - 180
        return load_scene(shoot.asset, shoot.light, turned=float(share * turn))

    return shoot.photos(scene_for)


def photographer(shoot: Shoot, degrees: float) -> np.ndarray:
    """A dark round photographer of this radius in degrees, seen from the object, behind every
    camera.
    """
    to = directions(*shoot.light.shape[:2])

    def scene_for(position: np.ndarray):
        hidden = to @ (position / np.linalg.norm(position)) > np.cos(np.radians(degrees))
        light = np.where(hidden[..., None], SHADOW * shoot.light, shoot.light)
        return load_scene(shoot.asset, light)

    return shoot.photos(scene_for)
