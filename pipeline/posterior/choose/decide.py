"""The decisions of a scene: what each sets, to what, and on which evidence.

Every decision is made from photos and surface alone, and never adds to what is configured. How
much gloss and metal are needed waits for the draws: each refinement decides it
(posterior/ladder.py).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from pipeline.base.config import Scene, configured, merge
from pipeline.base.runtime import mitsuba_rays
from pipeline.geometry.mesh_io import Mesh, load_mesh
from pipeline.posterior.choose.bounces import path_vertices
from pipeline.posterior.choose.fit_work import fit_work
from pipeline.posterior.choose.light_rows import light_rows
from pipeline.posterior.choose.texture_size import sampling_distance, texture_size
from pipeline.render.observe import Observations, Tracer
from pipeline.surface.facts import SurfaceFacts
from pipeline.surface.normal_error import UNSURE, per_axis

SEEN = 1500  # observed pixels whose points stand for what the photos show


@dataclass(frozen=True)
class Evidence:
    """What decisions are made from: folders of the stages observe, poses, atlas and mesh."""

    observe: Path
    poses: Path
    atlas: Path
    surface: Path

    @cached_property
    def observations(self) -> Observations:
        return Observations(self.observe, self.poses / "cameras.json")

    @cached_property
    def mesh(self) -> Mesh:
        return load_mesh(self.atlas / "mesh_uv.ply")

    @cached_property
    def scene(self) -> object:
        """Mitsuba's, with the mesh alone."""
        return Tracer(self.atlas / "mesh_uv.ply").scene

    @cached_property
    def sampling_distance(self) -> np.ndarray:
        """On the atlas, of random observed pixels (k,)."""
        rng = np.random.default_rng([31, 0])
        return sampling_distance(self.observations, self.scene, self.mesh, rng)

    def seen_points(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Position and normal (p, 3), towards the camera, at random observed pixels."""
        index = rng.choice(len(self.observations), min(SEEN, len(self.observations)), replace=False)
        origins, directions = self.observations.centre_rays(index)
        si = self.scene.ray_intersect(mitsuba_rays(origins, directions))  # type: ignore[attr-defined]

        hit = np.array(si.is_valid()).astype(bool)
        normal = np.array(si.n).T[hit]
        away = (normal * directions[hit]).sum(1, keepdims=True) > 0
        return np.array(si.p).T[hit], np.where(away, -normal, normal)


Decision = tuple[dict, dict]  # {section: {setting: value}}, evidence


def decide_texture(evidence: Evidence, scene: Scene, rng: np.random.Generator) -> Decision:
    """Base colour by the ground sampling distance. Roughness and metallic have no more detail than
    the maps on which they are drawn, `sample.texture`.
    """
    side, facts = texture_size(evidence.sampling_distance, scene.refine.texture)
    gloss = min(side, scene.sample.texture, scene.refine.gloss_texture or side)
    facts["drawn_on_texture"] = scene.sample.texture
    return {"refine": {"texture": side, "gloss_texture": gloss}}, facts


def decide_bounces(evidence: Evidence, scene: Scene, rng: np.random.Generator) -> Decision:
    """render.max_depth by how much of its own sky the object hides."""
    seen = evidence.seen_points(rng)
    depth, facts = path_vertices(evidence.scene, evidence.mesh, seen, scene.render.max_depth, rng)
    return {"render": {"max_depth": depth}}, facts


def decide_light(evidence: Evidence, scene: Scene, rng: np.random.Generator) -> Decision:
    """sample.light by the mesh's normal error, one step of its uncertainty below the estimate."""
    spread = per_axis(SurfaceFacts.load(evidence.surface).normal_error) / UNSURE
    rows, facts = light_rows(spread, scene.sample.light)
    return {"sample": {"light": rows}}, facts


def decide_fit(evidence: Evidence, scene: Scene, rng: np.random.Generator) -> Decision:
    """The fit's work by the ground sampling distance."""
    chosen, facts = fit_work(evidence.sampling_distance, scene.fit)
    return {"fit": chosen}, facts


DECISIONS: dict[str, Callable[[Evidence, Scene, np.random.Generator], Decision]] = {
    "texture": decide_texture,
    "bounces": decide_bounces,
    "light": decide_light,
    "fit": decide_fit,
}


def choose(evidence: Evidence, scene: Scene) -> dict:
    """What the stage says where it is on.

    `settings`: of `Chosen`. `decisions`: for each, `chosen` and `configured` in that form, and
    `evidence`; nothing but `why` where it is not taken.
    """
    settings: dict = {}
    decisions: dict = {}
    for number, (name, decide) in enumerate(DECISIONS.items()):
        if getattr(scene.choose, name) == "keep":
            decisions[name] = {"why": f"choose.{name} is `keep`"}
            continue

        chosen, facts = decide(evidence, scene, np.random.default_rng([31, number]))
        settings = merge(settings, chosen)
        decisions[name] = {
            "chosen": chosen,
            "configured": configured(scene, name),
            "evidence": facts,
        }
    return {"enabled": True, "settings": settings, "decisions": decisions}
