"""What the Snakefile needs to know about scenes and code, so that Snakemake re-runs what changed
and nothing else.
"""

from __future__ import annotations

import ast
import fcntl
import hashlib
import json
from functools import cache
from pathlib import Path

from pipeline.base.config import Scene, load_scene, slice_of
from pipeline.base.errors import InputError
from pipeline.photos.capture import camera_file, find_photos
from pipeline.run.stage import overrides

ROOT = Path(__file__).resolve().parents[2]


def _module_file(name: str) -> Path | None:
    path = ROOT / Path(*name.split("."))
    return next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.exists()), None)


@cache
def _imports(file: Path) -> frozenset[Path]:
    """Project files that a project file imports, at any depth of its syntax tree."""
    package = ".".join(file.relative_to(ROOT).parent.parts)
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            base = package.rsplit(".", node.level - 1)[0] if node.level > 1 else package
            module = (
                (f"{base}.{node.module}" if node.module else base) if node.level else node.module
            )
            names = [module] + [f"{module}.{a.name}" for a in node.names]
        found |= {
            f for n in names if n.split(".")[0] in ("pipeline", "stages") and (f := _module_file(n))
        }
    return frozenset(found)


def code_digest(stage: str) -> str:
    """Hash of a stage's script and of every project module it imports, directly or not.

    The modules that describe settings and command lines are left out: what matters of them is in
    the stage's slice.
    """
    todo, seen = [ROOT / "stages" / f"{stage}.py"], set()
    while todo:
        file = todo.pop()
        if file not in seen and file.name not in (
            "config.py",
            "stage.py",
            "progress.py",
            "errors.py",
            "files.py",
        ):
            seen.add(file)
            todo += _imports(file)
    return hashlib.sha256(b"".join(f.read_bytes() for f in sorted(seen))).hexdigest()[:16]


def flattened(settings: dict, above: str = "") -> list[str]:
    """{"mesh": {"grid": 128}} -> ["mesh.grid=128"], the form that stages take."""
    out = []
    for key, value in settings.items():
        out += (
            flattened(value, f"{above}{key}.")
            if isinstance(value, dict)
            else [f"{above}{key}={value}"]
        )
    return out


class Scenes:
    """Validated configurations of the scenes that targets ask for."""

    def __init__(self, settings: dict):
        self.settings = flattened(settings)
        self.loaded: dict[str, Scene] = {}

    def __call__(self, name: str) -> Scene:
        if name not in self.loaded:
            self.loaded[name] = load_scene(
                Path("configs") / f"{name}.yaml", overrides(self.settings)
            )
        return self.loaded[name]

    def slice(self, name: str, *sections: str) -> str:
        return json.dumps(slice_of(self(name), *sections), sort_keys=True)

    def photos(self, name: str) -> list[str]:
        """Files that the capture stage reads."""
        folder = Path(self(name).photos)
        masks = (
            sorted(p for p in (folder / "masks").glob("*") if p.is_file())
            if (folder / "masks").is_dir()
            else []
        )
        return [str(p) for _, p, _ in find_photos(folder)] + [str(p) for p in masks]

    def cameras(self, name: str) -> list[str]:
        """Files with known cameras that the poses stage reads."""
        folder = Path(self(name).photos)
        given = [
            p for p in (camera_file(folder), folder / "transforms_test.json") if p and p.exists()
        ]
        return [str(p) for p in given + sorted((folder / "sparse" / "0").glob("*.*"))]

    def mesh(self, name: str) -> list[str]:
        """The given mesh, if there is one."""
        folder = Path(self(name).photos)
        return [str(p) for p in (folder / "mesh.ply", folder / "mesh.obj") if p.exists()][:1]


def only_one_run(path: Path):
    """Hold a lock that the operating system releases when this process ends, however it ends;
    InputError if taken.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle = open(path, "w")
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise InputError(
            "another run is at work in this folder", path, "wait for it, or stop it first"
        ) from error
    return handle
