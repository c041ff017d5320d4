"""Put a `Problem` together from the folders of the stages before."""

from __future__ import annotations

from pathlib import Path

from pipeline.base.config import Scene
from pipeline.posterior.problem import Problem
from pipeline.render.observe import Observations
from pipeline.render.renderer import Renderer
from pipeline.surface.facts import SurfaceFacts


def load_problem(
    observe: Path,
    poses: Path,
    atlas: Path,
    mesh: Path,
    scene: Scene,
    texture: int,
    light_height: int,
) -> Problem:
    """Observations, and a renderer with textures of side `texture` under a light of `light_height`
    rows.

    observe, poses, atlas, mesh: folders of those stages. Raises InputError where the mesh's folder
    has no surface.json.
    """
    observations = Observations(observe, poses / "cameras.json")
    renderer = Renderer(
        atlas / "mesh_uv.ply",
        texture,
        light_height,
        scene.render.max_depth,
        observations.surroundings.ground,
    )

    return Problem(
        observations,
        renderer,
        scene.render.roughness_min,
        SurfaceFacts.load(mesh).normal_error,
    )
