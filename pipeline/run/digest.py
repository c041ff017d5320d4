"""The digest of a stage's code, by which Snakemake knows that a stage is due again."""

from __future__ import annotations

import ast
import hashlib
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

# Left out of every digest, and what these import with them: they decide nothing of what a stage
# computes. Each is named by its full path, so that another file of the same name counts.
NOT_COUNTED = frozenset(
    {
        "pipeline/base/config.py",  # which settings there are; values are in a slice
        "pipeline/base/errors.py",  # the wording of messages; a stage that fails has no result
        "pipeline/base/progress.py",  # lines on the terminal
        "pipeline/run/stage.py",  # the command line: options in, folders out
    }
)
DATA = (".html", ".css", ".js", ".j2", ".jinja", ".json", ".yaml", ".txt")


def _module_file(name: str, root: Path) -> Path | None:
    path = root / Path(*name.split("."))
    return next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.exists()), None)


def imported_names(tree: ast.Module) -> set[str]:
    """Modules, and names in modules, that a project file imports from the project, at any depth.

    Imports are absolute (tests/test_layers.py holds them to that). The __init__ of the packages on
    the way holds a docstring only and is counted where a name is imported from it.
    """
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}

    return {name for name in names if name.split(".")[0] in ("pipeline", "stages")}


def meaning(tree: ast.Module) -> str:
    """What a Python file does, as text: its syntax tree without comments and layout, which are not
    in it, and without docstrings, which are taken out of `tree`.
    """
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for node in ast.walk(tree):
        if isinstance(node, documented) and ast.get_docstring(node, clean=False) is not None:
            del node.body[0]

    return ast.dump(tree)


@cache
def _read(file: Path) -> tuple[set[str], bytes]:
    """Imported names of a Python file, and its meaning."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return imported_names(tree), meaning(tree).encode()


def counted_files(stage: str, root: Path = ROOT) -> list[Path]:
    """A stage's script, every project module that it imports, directly or not, and the data files
    (`DATA`: a page's template, its style) that lie beside those modules.
    """
    todo, modules = [root / "stages" / f"{stage}.py"], set()
    while todo:
        file = todo.pop()
        if file not in modules and file.relative_to(root).as_posix() not in NOT_COUNTED:
            modules.add(file)
            todo += [m for name in _read(file)[0] if (m := _module_file(name, root))]

    data = {
        beside
        for module in modules
        for beside in module.parent.iterdir()
        if beside.suffix in DATA and not beside.name.startswith(".")
    }
    return sorted(modules | data)


@cache
def code_digest(stage: str, root: Path = ROOT) -> str:
    """Hash of the files of `counted_files`: of Python files their meaning, of others their bytes,
    each with its path below `root`.
    """
    digest = hashlib.sha256()
    for file in counted_files(stage, root):
        content = _read(file)[1] if file.suffix == ".py" else file.read_bytes()
        digest.update(f"{file.relative_to(root).as_posix()}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()[:16]
