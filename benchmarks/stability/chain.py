"""The stages of a scene up to the fit, in this process: what all methods share.

The same functions as stages/*.py call, in the order of the Snakefile; a stage whose folder is
complete is not run again.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pipeline.base.config import Scene
from pipeline.base.files import stage_folder, write_json
from pipeline.masks.make import make_masks
from pipeline.photos.capture import capture
from pipeline.photos.poses import make_poses
from pipeline.posterior.fit import fit
from pipeline.posterior.load import load_problem
from pipeline.render.observe import make_observations
from pipeline.surface.atlas import make_atlas
from pipeline.surface.bake import make_normal_map
from pipeline.surface.make import make_mesh


def fitted(folders: dict[str, Path], scene: Scene, out: Path) -> dict:
    """The point estimate; returns its facts."""
    problem = load_problem(
        folders["observe"],
        folders["poses"],
        folders["atlas"],
        folders["mesh"],
        scene,
        scene.fit.texture,
        scene.render.light_height,
    )
    best, facts = fit(problem, scene.fit)
    best.save(out)
    return facts


def chain(scene: Scene, work: Path, threads: int = 1) -> None:
    """capture to fit below `work`. Raises InputError where a stage refuses its input."""
    names = ("capture", "poses", "masks", "mesh", "atlas", "observe", "fit")
    at = {name: work / name for name in names}
    photos = Path(scene.photos)

    def atlas(out: Path) -> dict:
        facts = make_atlas(at["mesh"] / "mesh.ply", out, scene.atlas)
        return facts | make_normal_map(at["mesh"], out, scene.atlas)

    steps: dict[str, Callable[[Path], dict]] = {
        "capture": lambda out: capture(photos, out, scene.capture),
        "poses": lambda out: make_poses(
            at["capture"], photos, out, scene.poses, scene.observe, threads
        ),
        "masks": lambda out: make_masks(at["poses"], out, scene.masks, threads),
        "mesh": lambda out: make_mesh(at["poses"], at["masks"], photos, out, scene.mesh, threads),
        "atlas": atlas,
        "observe": lambda out: make_observations(
            at["poses"],
            at["mesh"],
            at["atlas"] / "mesh_uv.ply",
            out,
            scene.observe,
            scene.poses,
        ),
        "fit": lambda out: fitted(at, scene, out),
    }
    for name, step in steps.items():
        if (at[name] / f"{name}.json").exists():
            continue
        with stage_folder(at[name], f"{name}.json") as out:
            write_json(out / f"{name}.json", step(out))
