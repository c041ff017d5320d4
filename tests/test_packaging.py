"""What is said about the package in several places agrees, and setup.sh installs the whole lock."""

import ast
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from pipeline import __version__
from pipeline.run.doctor import STACK

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
CITATION = yaml.safe_load((ROOT / "CITATION.cff").read_text())
LOCK = (ROOT / "requirements.lock").read_text()
PINS = dict(re.findall(r"^([^\s#=]+)==(\S+)", LOCK, re.MULTILINE))

# what runs inside Blender has these from it, and runs nowhere else (benchmarks/blender_render.py)
OF_BLENDER = {"bpy", "mathutils"}


def declared(*extras: str) -> list[Requirement]:
    """The project's direct dependencies, with those of optional groups."""
    table = PROJECT["project"]
    lines = table["dependencies"] + [
        line for extra in extras for line in table["optional-dependencies"][extra]
    ]
    return [Requirement(line) for line in lines]


def test_the_version_has_one_place():
    assert PROJECT["project"]["dynamic"] == ["version"]
    assert PROJECT["tool"]["setuptools"]["dynamic"]["version"] == {"attr": "pipeline.__version__"}
    assert CITATION["version"] == __version__


def test_what_is_no_code_is_packed_too():
    """Pages, styles and fitted models lie beside the modules that read them."""
    patterns = PROJECT["tool"]["setuptools"]["package-data"]["*"]
    beside = [
        file
        for folder in ("pipeline", "stages")
        for file in (ROOT / folder).rglob("*")
        if file.is_file() and file.suffix != ".py" and "__pycache__" not in file.parts
    ]
    assert {file.name for file in beside} >= {"trust.json", "page.html", "py.typed"}
    assert [f.name for f in beside if not any(f.match(pattern) for pattern in patterns)] == []


def test_the_citation_names_software_and_paper():
    assert CITATION["cff-version"] == "1.2.0" and CITATION["type"] == "software"
    assert CITATION["license"] == PROJECT["project"]["license"] == "Apache-2.0"
    assert CITATION["authors"] == PROJECT["project"]["authors"]
    (paper,) = CITATION["references"]
    families = [author["family-names"] for author in paper["authors"]]
    assert families[0] == "Lyu" and families[-1] == "Theobalt" and len(families) == 7
    assert (paper["volume"], paper["issue"], paper["year"]) == (42, 6, 2023)


def third_party_imports(folder: str) -> set[str]:
    """Top-level modules from outside that the files of a folder import, inside functions too."""
    found = set()
    for file in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                found.add(node.module.split(".")[0])
    ours = {"pipeline", "stages", "benchmarks", "tests", "examples"}
    return found - sys.stdlib_module_names - ours - OF_BLENDER


@pytest.mark.parametrize(
    "folder, extras",
    [
        ("pipeline", ["masks"]),
        ("stages", []),
        ("benchmarks", ["dev"]),
        ("examples", []),
        ("tests", ["dev"]),
    ],
)
def test_every_import_is_a_declared_dependency(folder, extras):
    names = {canonicalize_name(r.name) for r in declared(*extras)}
    makers = packages_distributions()
    undeclared = {
        module
        for module in third_party_imports(folder)
        if not names & {canonicalize_name(name) for name in makers.get(module, [module])}
    }
    assert undeclared == set()


def test_the_doctor_asks_for_every_dependency():
    assert sorted(STACK, key=str.lower) == sorted((r.name for r in declared()), key=str.lower)


def test_the_lock_pins_what_is_declared():
    wrong = [
        str(requirement)
        for requirement in declared("dev")
        if not requirement.specifier.contains(PINS.get(canonicalize_name(requirement.name), "0"))
    ]
    assert wrong == []


def requirements(text: str) -> list[str]:
    """A lock's requirements, each with its hashes."""
    lines = "".join(line for line in text.splitlines(True) if not line.startswith("#"))
    return re.split(r"\n(?=\S)", lines.strip())


def test_every_requirement_of_the_lock_has_a_hash():
    for requirement in requirements(LOCK):
        first, *hashes = requirement.replace("\\\n", "\n").split("\n")
        assert re.fullmatch(r"\S+==\S+ ", first), first
        assert hashes and all(re.fullmatch(r" +--hash=sha256:[0-9a-f]{64} ?", h) for h in hashes)
    assert "://" not in LOCK and "index-url" not in LOCK


FAKE_PYTHON = """#!/bin/sh
case "$*" in
    *"-m venv"*)
        mkdir -p .venv/bin
        cp "$0" .venv/bin/python
        cp "$0" .venv/bin/uv
        printf '#!/bin/sh\\necho examined\\n' >.venv/bin/heliograph
        chmod +x .venv/bin/heliograph ;;
    *"config list") echo ":env:.find-links='/wheels'" ;;
    *"pip install "* | *"-m pip"*)
        echo "$0 $* from $UV_FIND_LINKS" >>calls
        [ ! -f no_network ] || { echo "no network" >&2; exit 1; }
        case "$0" in *uv) [ ! -f no_uv ] || exit 1 ;; esac
        for last in "$@"; do :; done
        [ ! -f "$last" ] || { cat "$last"; echo "# end of a call"; } >>installed ;;
    *) exec REAL "$@" ;;
esac
""".replace("REAL", sys.executable)


@pytest.fixture
def checkout(tmp_path):
    """A folder with setup.sh and what it reads, and a function that runs it with a python whose pip
    only writes down what it was asked for.
    """
    for name in ("setup.sh", "requirements.lock", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    for name, text in (("python", FAKE_PYTHON), ("df", "#!/bin/sh\necho\necho d 9 9 99999 9 /\n")):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(0o755)

    def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess:
        return subprocess.run(
            ["sh", str(tmp_path / "setup.sh"), *arguments],
            env=os.environ
            | {"PATH": f"{tmp_path}:{os.environ['PATH']}", "PYTHON": f"{tmp_path}/python"}
            | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
            | environment,
            capture_output=True,
            text=True,
        )

    return tmp_path, run


def test_setup_installs_the_whole_lock(checkout):
    folder, run = checkout
    done = run()
    assert done.returncode == 0 and done.stdout.endswith("examined\n"), done.stderr
    texts = (folder / "installed").read_text().split("# end of a call\n")
    first, whole = (requirements(text) for text in texts[:2])
    assert [r.split("==")[0] for r in first] == ["setuptools", "uv", "wheel-axle-runtime"]
    assert set(first) < set(whole) == set(requirements(LOCK))
    by_pip, by_uv, project = (folder / "calls").read_text().splitlines()
    assert all("--require-hashes" in c and "--no-deps" in c for c in (by_pip, by_uv))
    assert "/python -m pip" in by_pip and by_uv.startswith(".venv/bin/uv")
    assert by_uv.endswith("from /wheels")  # uv is told what pip is
    assert "--editable ." in project and "--no-deps" in project
    assert not (folder / ".venv" / ".uv").exists()


def test_where_uv_fails_pip_installs_the_lock_and_setup_says_so(checkout):
    folder, run = checkout
    (folder / "no_uv").touch()
    done = run()
    assert done.returncode == 0 and "uv could not install" in done.stdout, done.stderr
    last = (folder / "calls").read_text().splitlines()[-2]
    assert "/python -m pip" in last and "--require-hashes" in last


def test_setup_does_only_what_is_left(checkout):
    folder, run = checkout
    run()
    (folder / "calls").unlink()
    assert run().stdout == "" and not (folder / "calls").exists()
    with open(folder / "pyproject.toml", "a") as file:
        file.write("# changed\n")
    assert run().returncode == 0
    assert "--editable ." in (folder / "calls").read_text().splitlines()[0]


def test_setup_says_plainly_what_is_wrong(checkout):
    folder, run = checkout
    absent = run(PYTHON="no-such-python")
    assert absent.returncode == 1 and "there is no 'no-such-python'" in absent.stderr
    (folder / "df").write_text("#!/bin/sh\necho\necho d 9 9 100 9 /\n")
    full = run()
    assert full.returncode == 1 and "100 MiB are free" in full.stderr
    (folder / "df").write_text("#!/bin/sh\necho\necho d 9 9 99999 9 /\n")
    (folder / "no_network").touch()
    failed = run()
    assert failed.returncode == 1 and "Run setup.sh again" in failed.stderr
    (folder / "no_network").unlink()
    assert run().returncode == 0


def test_setup_takes_no_kept_packages_that_are_not_whole(checkout):
    """As one that was cut off while it kept them leaves them: nothing is left that the next run
    would take for installed.
    """
    folder, run = checkout
    run("--keep")
    shutil.rmtree(folder / ".venv")
    failed = run()  # without pyvenv.cfg
    assert failed.returncode == 1 and "are not whole; delete that folder" in failed.stderr
    assert not (folder / ".venv").exists()


def test_setup_starts_from_kept_packages(checkout, tmp_path_factory):
    folder, run = checkout
    assert "packages kept in" in run("--keep").stdout
    kept = folder / "cache" / "heliograph" / "environment"
    settings = f"command = python -m venv {folder}/.venv\n"
    (kept / "pyvenv.cfg").write_text(settings)
    (kept / "bin" / "tool").write_text(f"#!{folder}/.venv/bin/python\n")
    (kept / "bin" / "tool").chmod(0o755)

    other = tmp_path_factory.mktemp("other")
    for name in ("setup.sh", "requirements.lock", "pyproject.toml", "python", "df"):
        shutil.copy(folder / name, other)
    done = subprocess.run(
        ["sh", str(other / "setup.sh")],
        env=os.environ | {"PYTHON": str(other / "python"), "XDG_CACHE_HOME": str(folder / "cache")},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0 and "starting from the packages in" in done.stdout, done.stderr
    tool = other / ".venv" / "bin" / "tool"
    assert tool.read_text() == f"#!{other}/.venv/bin/python\n" and os.access(tool, os.X_OK)
    assert (kept / "bin" / "tool").read_text() == f"#!{folder}/.venv/bin/python\n"
    assert not (other / "installed").exists()  # the lock is the same: pip has nothing to do
    assert "--editable ." in (other / "calls").read_text()

    # a lock that differs there is not noted as installed here
    (other / "requirements.lock").write_text(
        (folder / "requirements.lock").read_text() + "# more\n"
    )
    again = subprocess.run(
        ["sh", str(other / "setup.sh")],
        env=os.environ | {"PYTHON": str(other / "python"), "XDG_CACHE_HOME": str(folder / "cache")},
        capture_output=True,
        text=True,
    )
    assert again.returncode == 0, again.stderr
    assert "# more" in (other / ".venv" / ".heliograph-lock").read_text()
    assert "# more" not in (folder / ".venv" / ".heliograph-lock").read_text()
    assert "# more" not in (kept / ".heliograph-lock").read_text()
    assert run("--hold").returncode == 1
