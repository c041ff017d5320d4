"""How far an asset may be relied on under new light, from what its run knows.

Four figures are evidence; a logistic model, fitted to runs on scenes whose truth is known
(benchmarks/trust.py), turns them into the probability that pictures under new light are
worse than 18 dB. Words say which figure weighs, and what to photograph next.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np

from pipeline.base.config import Scene
from pipeline.base.files import read_json
from pipeline.base.images import read_png
from pipeline.geometry.cameras import Rig, View
from pipeline.render.envmap import directions, mean_radiance
from pipeline.render.metrics import psnr, render_twice
from pipeline.render.observe import Tracer
from pipeline.render.renderer import Explanation, Renderer
from pipeline.report.pictures import evening_light

MODEL = Path(__file__).with_name("trust.json")
SIDE = 96  # longest side in pixels of the pictures that draws are compared in
SPP = 32
VIEWS = 3
OUTLINE_SIDE, OUTLINE_VIEWS = 256, 8  # the same of outlines, which are cheap
BEST = 30.0  # dB above which a figure says no more
WEIGHS = 0.5  # log odds from which a figure is named as a reason
DOUBT = 0.2  # chance from which reasons are given

VERDICTS = (  # from which chance on
    (0.5, "Do not rely on this asset under new light."),
    (DOUBT, "Look closely before you rely on this asset under new light."),
    (0.0, "Nothing in this run speaks against using the asset under new light."),
)
NO_EVIDENCE = (
    "How far to trust the asset under new light is not known: that takes two samples at least "
    "(samples: 2) and eight photos, of which some are held out."
)
FROM_PHOTOS = (  # figures: docs/results.md, section 14
    "That chance was learned from runs whose surface was given. It does not see what a surface "
    "made from photos costs under new light: on things whose truth is known that was some "
    "decibels, and it called most of those safe that turned out to be worse than its limit. Look "
    "at the asset under another light yourself."
)
ADVICE = {
    "agreement": (
        "The samples look different from each other under new light: these photos leave open what "
        "the materials are. Photos that show highlights move over the surface help: come closer, "
        "go lower and higher, and walk all the way round."
    ),
    "explained": (
        "Photos that no fit has seen are not explained well. Look at the error pictures: a shape "
        "that repeats is a fault of the surface or the cameras, a shadow that moves is yours or a "
        "moving light's. Keep light, exposure and white balance fixed, take sharp photos with "
        "more overlap."
    ),
    "level": (
        "The samples disagree about how bright the light is, and with it how dark the object. "
        "Photograph the object together with its ground and surroundings, and something glossy "
        "beside it if you can."
    ),
    "outline": (
        "The surface's outline and the masks differ: parts are missing or were taken for the "
        "object. Correct one mask by hand, or add photos from the sides where the outline is wrong."
    ),
}


@dataclass(frozen=True)
class Evidence:
    """agreement: PSNR in dB between two draws' pictures under new light, mean over pairs;
    explained: of photos that no fit has seen; level: standard deviation between draws of the log of
    the light's mean radiance; outline: intersection over union of the surface's outline and the
    masks.
    """

    agreement: float
    explained: float
    level: float
    outline: float

    def vector(self) -> np.ndarray:
        """(4,), as the model takes them."""
        return np.array(
            [
                min(self.agreement, BEST) / 10,
                min(self.explained, BEST) / 10,
                self.level,
                np.log(max(1 - self.outline, 1e-3)),
            ]
        )


def agreement(draws: list[list[np.ndarray]], masks: list[np.ndarray]) -> float:
    """Mean PSNR in dB between pairs of draws. draws: of each its pictures (2, h, w, 3), rendered
    twice; masks (h, w) of the pictures. ValueError for fewer than two draws.
    """
    if len(draws) < 2:
        raise ValueError("one draw agrees with nothing")
    between = [
        psnr(a[0], b[0], mask, a[1], b[1])
        for one, other in combinations(draws, 2)
        for a, b, mask in zip(one, other, masks, strict=True)
    ]
    return float(np.mean(between))


def level(lights: Iterable[np.ndarray]) -> float:
    """Standard deviation between draws of the log of the mean radiance of lights (h, 2h, 3)."""
    return float(np.std([np.log(mean_radiance(light).mean()) for light in lights], ddof=1))


def overcast_light(height: int) -> np.ndarray:
    """A cloudy sky over dark ground (Moon and Spencer 1942), mean radiance 1, (h, 2h, 3)."""
    up = directions(height, 2 * height)[..., 1:2]
    light = np.where(up > 0, (1 + 2 * up) / 3, 0.1) * np.ones(3)
    light = light.astype(np.float32)
    return light / mean_radiance(light).mean()


def outline(mesh: Path, masks: list[tuple[View, np.ndarray]]) -> float:
    """Intersection over union of a mesh's outline and masks (h, w), all views together."""
    tracer = Tracer(mesh)
    both = either = 0
    for view, mask in masks:
        rays = view.rays(view.pixel_centers().reshape(-1, 2))
        hit = tracer.hit(*rays)[2].reshape(mask.shape)
        both += int((hit & mask).sum())
        either += int((hit | mask).sum())
    return both / max(either, 1)


def small_views(
    work: Path, rig: Rig, folder: str, side: int = SIDE, most: int = VIEWS
) -> list[tuple[View, np.ndarray]]:
    """At most `most` views, evenly taken, with `side` pixels, each with its mask (h, w) in
    `folder`.
    """
    found = []
    for view in rig.views[:: max(1, len(rig.views) // most)][:most]:
        small = view.scaled(min(1.0, side / max(view.width, view.height)))
        mask = read_png(work / folder / f"{view.name}.png")
        size = (small.width, small.height)
        found.append((small, cv2.resize(mask, size, interpolation=cv2.INTER_AREA) > 127))
    return found


def relit(
    renderer: Renderer, x: Explanation, views: list[tuple[View, np.ndarray]], brightness: float
) -> list[np.ndarray]:
    """Pictures (2, h, w, 3) of every view under two lights of this mean radiance."""
    lights = [brightness * light(len(x.light)) for light in (evening_light, overcast_light)]
    return [
        render_twice(renderer, replace(x, light=light.astype(np.float32)), view, mask, SPP)
        for light in lights
        for view, mask in views
    ]


def evidence(
    work: Path, rig: Rig, explanations: Sequence[Explanation], scene: Scene, held_out: list[float]
) -> Evidence | None:
    """Of a finished run; None where there are no two draws, or no photo was held out.

    held_out: PSNR in dB of each draw.
    """
    if len(explanations) < 2 or not held_out:
        return None
    texture = len(explanations[0].roughness)
    lights = [x.light for x in explanations]
    views = small_views(work, rig, "mesh/masks")
    mesh = work / "atlas" / "mesh_uv.ply"
    renderer = Renderer(mesh, texture, len(lights[0]), scene.render.max_depth)
    # one brightness for all draws: a light that one of them takes for brighter makes it darker here
    brightness = float(np.exp(np.mean([np.log(mean_radiance(x).mean()) for x in lights])))
    pictures = [relit(renderer, x, views, brightness) for x in explanations]
    masks = small_views(work, rig.training(), "masks/masks", OUTLINE_SIDE, OUTLINE_VIEWS)
    return Evidence(
        agreement(pictures, 2 * [mask for _, mask in views]),
        float(np.mean(held_out)),
        level(lights),
        outline(mesh, masks),
    )


def load_model() -> dict:
    """{"limit": dB, "intercept", "weights": (4,), "usual": (4,)}; usual: evidence of runs that went
    well, its medians.
    """
    return read_json(MODEL)


def probability(found: Evidence, model: dict) -> float:
    """That pictures under new light are worse than the model's limit."""
    logit = model["intercept"] + float(np.dot(model["weights"], found.vector()))
    return float(1 / (1 + np.exp(-logit)))


def weighing(found: Evidence, model: dict) -> list[str]:
    """Names of the figures that raise the odds by more than WEIGHS against runs that went well, the
    heaviest first.
    """
    raised = np.array(model["weights"]) * (found.vector() - model["usual"])
    names = [f.name for f in fields(Evidence)]
    return [names[k] for k in np.argsort(-raised) if raised[k] > WEIGHS]


def in_words(found: Evidence | None, model: dict, given: bool) -> list[str]:
    """Sentences for the report: how likely the asset misleads, why, and what to photograph next.

    given: the surface is the user's own mesh. No other is said to be safe: the model has not seen
    such runs.
    """
    if found is None:
        return [NO_EVIDENCE]
    chance = probability(found, model)
    doubt = chance if given else max(chance, DOUBT)
    verdict = next(text for least, text in VERDICTS if doubt >= least)
    said = [
        f"{verdict} The chance that pictures under new light are worse than "
        f"{model['limit']:.0f} dB is put at {100 * chance:.0f} %: samples agree to "
        f"{found.agreement:.1f} dB under new light, photos held out are explained to "
        f"{found.explained:.1f} dB, and surface and masks overlap to {100 * found.outline:.0f} %."
    ]
    said += [] if given else [FROM_PHOTOS]
    return said + [ADVICE[name] for name in weighing(found, model) if chance >= DOUBT]
