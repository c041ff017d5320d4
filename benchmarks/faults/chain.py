"""The whole chain on a small project, as processes that may be killed, and what it has made."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import psutil

from benchmarks.corpus.project import Project

ROOT = Path(__file__).resolve().parents[2]
SCENE = "toy"
TARGETS = (f"exports/{SCENE}.usda", f"exports/{SCENE}_report.html")
PATIENCE = 900.0  # seconds after which a run counts as a hang
SMALL = {
    "samples": 1,
    "atlas": {"resolution": 64, "padding": 1},
    "observe": {"pixels": 3000},
    "render": {"max_depth": 3},
    "fit": {"steps": 20, "learning_rate": 0.05, "pixels": 400, "spp": 2, "texture": 16},
    "sample": {
        "prior": "prior_tiny",
        "start_prior": "gaussian_tiny",
        "light": 16,
        "texture": 16,
    },
    "refine": {"steps": 4, "pixels": 300, "spp": 2, "texture": 48},
    "report": {"relight_size": 48, "spp": 4},
}
COSTS = {"seconds", "peak_gib", "finished"}  # entries of metrics that no two runs share
# Files that hold the time when they were made, or how long it took.
TIMED = {".log", ".tsv", ".html", ".usdz"}


@dataclass
class End:
    """How a run of the workflow ended: exit status (None where it was stopped as hanging), all
    that it said, wall seconds.
    """

    status: int | None
    said: str
    seconds: float


class Chain:
    """A project and runs of the workflow in it, one thread each."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.work = folder / "work" / SCENE
        self.log = folder / "run.txt"

    def make(self) -> Chain:
        """The project, with nothing run."""
        project = Project(self.folder, SCENE)
        project.make()
        project.settings |= SMALL
        project.write_config()
        return self

    def copy(self, folder: Path) -> Chain:
        """The same project, with all that was made in it and all times of files."""
        shutil.copytree(self.folder, folder, symlinks=True)
        return Chain(folder)

    def start(self, *more: str) -> subprocess.Popen:
        """Begin a run; its output is added to the log."""
        words = [
            *(sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile")),
            *("--profile", str(ROOT / "profiles/default"), "--directory", str(self.folder)),
            *("--cores", "1", *more, *TARGETS),
        ]
        surroundings = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
        with self.log.open("a") as log:
            return subprocess.Popen(
                words,
                cwd=self.folder,
                env=surroundings,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def run(self, *more: str) -> End:
        """Run it to its end."""
        begin, before = time.monotonic(), self.log.stat().st_size if self.log.exists() else 0
        running = self.start(*more)
        status = wait(running)
        said = self.log.read_bytes()[before:].decode(errors="replace")
        return End(status, said, time.monotonic() - begin)

    def due(self) -> str:
        """The jobs that a dry run would execute, empty where all is up to date."""
        plan = self.run("-n").said
        lines = [line.strip() for line in plan.splitlines()]
        rules = [line for line in lines if line.startswith(("rule ", "localrule "))]
        return " ".join(line.split()[-1].rstrip(":") for line in rules)

    def sums(self) -> dict[str, str]:
        """Digest of every file that was made; JSON without what a run has cost; without the
        workflow's own notes and files that hold times.
        """
        made = [*self.work.rglob("*"), *(self.folder / "exports").rglob("*")]
        return {
            str(file.relative_to(self.folder)): digest(file)
            for file in sorted(made)
            if file.is_file() and file.suffix not in TIMED and not hidden(file, self.folder)
        }

    def leftovers(self) -> list[str]:
        """Half-written results."""
        return [str(p.relative_to(self.folder)) for p in self.folder.rglob(".partial-*")]


def hidden(file: Path, top: Path) -> bool:
    return any(part.startswith(".") for part in file.relative_to(top).parts)


def digest(file: Path) -> str:
    """Digest of a file's bytes, of JSON without its costs; what is no JSON is taken as it is."""
    data = file.read_bytes()
    if file.suffix == ".json":
        try:
            data = json.dumps(without_costs(json.loads(data)), sort_keys=True).encode()
        except ValueError:  # a damaged file, which differs from a whole one either way
            pass
    return hashlib.sha256(data).hexdigest()


def without_costs(value: object) -> object:
    """A JSON value without the entries of COSTS, at any depth."""
    if isinstance(value, dict):
        return {k: without_costs(v) for k, v in value.items() if k not in COSTS}
    return [without_costs(v) for v in value] if isinstance(value, list) else value


def wait(running: subprocess.Popen) -> int | None:
    """A run's exit status; None, and it is ended, where it takes longer than PATIENCE."""
    try:
        return running.wait(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        os.killpg(running.pid, signal.SIGKILL)
        running.wait()
        return None


def stage_of(running: subprocess.Popen) -> psutil.Process | None:
    """The process of the stage that a run executes at the moment."""
    try:
        below = psutil.Process(running.pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return None
    for process in below:
        if stage_name(process):
            return process
    return None


def stage_name(process: psutil.Process) -> str:
    """Which stage a process is; empty for any other process."""
    try:
        words = process.cmdline()
    except (psutil.NoSuchProcess, psutil.ZombieProcess):
        return ""
    if not words or "python" not in Path(words[0]).name:  # a process that ends has no words
        return ""
    return next((w for w in words if w.startswith("stages.")), "").removeprefix("stages.")
