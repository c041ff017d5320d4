"""Put a `Problem` together from the folders of the stages before."""

from __future__ import annotations

from pathlib import Path

from pipeline.base.config import Scene
from pipeline.base.files import json_entry
from pipeline.posterior.problem import Problem
from pipeline.render.observe import Observations
from pipeline.render.renderer import Renderer


def load_problem(
    observe: Path, poses: Path, atlas: Path, scene: Scene, texture: int, light_height: int
) -> Problem:
    """Observations, and a renderer with textures of side `texture` under a light of `light_height`
    rows.
    """
    renderer = Renderer(atlas / "mesh_uv.ply", texture, light_height, scene.render.max_depth)
    normal_error = json_entry(atlas / "atlas.json", "normal_error")
    return Problem(
        Observations(observe, poses / "cameras.json"),
        renderer,
        scene.render.roughness_min,
        normal_error,
    )
