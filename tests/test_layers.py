"""The floors of the house: a folder of pipeline/ imports only from those above it, in no circle."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FLOORS = "base geometry photos masks surface render prior posterior usd report run".split()
SOURCES = sorted((ROOT / "pipeline").rglob("*.py"))


def module_of(file: Path) -> str:
    """pipeline/base/files.py -> pipeline.base.files; a package's __init__.py is the package."""
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(file): file for file in SOURCES}


def imports(file: Path) -> set[str]:
    """Modules of pipeline/ that a file imports anywhere, inside functions too."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}:{node.lineno}: import by the full name"
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return {name for name in found if name in MODULES and "." in name}


ARROWS = {name: imports(file) - {name} for name, file in MODULES.items()}


def floor(module: str) -> int:
    """Position of a module's folder in FLOORS; pipeline itself stands above all."""
    return FLOORS.index(module.split(".")[1]) if "." in module else -1


def test_every_folder_has_its_floor():
    folders = {p.name for p in (ROOT / "pipeline").iterdir() if p.is_dir() and p.name[0] != "_"}
    assert folders == set(FLOORS)


def test_no_import_runs_upward():
    wrong = [
        f"{name} -> {other}"
        for name, others in ARROWS.items()
        for other in others
        if name != "pipeline" and floor(other) > floor(name)
    ]
    assert wrong == []


def test_samplers_do_not_import_training():
    """Weights are made by prior/training; using them needs none of it."""
    wrong = [
        f"{name} -> {other}"
        for name, others in ARROWS.items()
        for other in others
        if other.startswith("pipeline.prior.training")
        and not name.startswith("pipeline.prior.training")
    ]
    assert wrong == []


def test_no_import_runs_in_a_circle():
    left = {
        name: {o for o in others if o in MODULES and not MODULES[o].name.startswith("__init__")}
        for name, others in ARROWS.items()
    }
    while left:
        free = [name for name, others in left.items() if not others & left.keys()]
        assert free, f"a circle among {sorted(left)}"
        for name in free:
            del left[name]


def test_packages_hold_no_logic():
    """An __init__.py is a docstring; only the top one does something: it finds Dr.Jit's LLVM."""
    for file in SOURCES:
        if file.name == "__init__.py" and file.parent.name != "pipeline":
            assert [type(n).__name__ for n in ast.parse(file.read_text()).body] == ["Expr"], file
