"""Runs a case in a process of its own, bounded in time and memory, and judges how it ended."""

from __future__ import annotations

import importlib
import os
import resource
import runpy
import signal
import sys
import time
import traceback
from pathlib import Path

from benchmarks.corpus.case import Case
from benchmarks.corpus.mounts import NotPossible
from benchmarks.corpus.project import Project

ROOT = Path(__file__).resolve().parents[2]
INPUTS = {
    "capture": (),
    "poses": ("capture",),
    "masks": ("poses",),
    "mesh": ("poses", "masks"),
    "atlas": ("mesh",),
    "observe": ("poses", "mesh", "atlas"),
    "choose": ("observe", "poses", "atlas", "mesh"),
    "fit": ("observe", "poses", "atlas", "mesh", "choose"),
    "sample": ("observe", "poses", "atlas", "mesh", "choose", "fit"),
}
MEMORY = (
    12 * 2**30
)  # bytes of address space: a reader that asks for more than the machine has stops
OLD = "left by an earlier run"
NOT_POSSIBLE = 77  # exit status of a case that this machine cannot try
ENDINGS = {None: "hang", 0: "result", 2: "message", NOT_POSSIBLE: "not tried"}
STOPPED = "Heliograph cannot go on."
# What a stage imports and may be shared by all processes: loaded once, before they begin. Not
# Mitsuba, whose threads would not be there in a child.
LOADED = {
    "capture": ("pipeline.run.stage", "pipeline.photos.capture"),
    "poses": ("pipeline.photos.poses", "pycolmap"),
    "masks": ("pipeline.masks.make",),
    "choose": ("scipy.stats", "torch"),
}


def arguments(case: Case, project: Project, stage: str) -> list[str]:
    """The command line of a stage in a project."""
    out = ["--config", f"configs/{project.name}.yaml", "--threads", "1"]
    for other in INPUTS[stage]:
        out += [f"--{other}", f"work/{project.name}/{other}"]
    index = ["--index", "0"] if stage == "sample" else []
    words = [*out, *index, "--out", f"work/{project.name}/{stage}", *case.options]
    stay_inside(project, words)
    return words


def stay_inside(project: Project, words: list[str]) -> None:
    """ValueError for an --out that does not lie in the project: a defect that a case looks for may
    delete what is there.
    """
    top = project.folder.resolve()
    for option, value in zip(words, words[1:]):
        if option == "--out" and not (top / value).resolve().is_relative_to(top):
            raise ValueError(f"--out {value} leaves the case's own folder")


def run(case: Case, project: Project, stage: str, log: Path) -> tuple[int | None, float]:
    """Run a stage; (exit status, negative for a signal, None where time ran out; seconds)."""
    words = arguments(case, project, stage)
    for name in LOADED.get(stage, ()):
        importlib.import_module(name)
    start = time.monotonic()
    child = os.fork()
    if child == 0:
        _become(case, project, stage, words, log)

    deadline = start + case.timeout
    while time.monotonic() < deadline:
        found, status = os.waitpid(child, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status), time.monotonic() - start
        time.sleep(0.01)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return None, time.monotonic() - start


def _become(case: Case, project: Project, stage: str, words: list[str], log: Path) -> None:
    """In the child: be the stage's command. Does not return."""
    status = 1
    try:
        os.setsid()
        handle = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        os.dup2(handle, 1)
        os.dup2(handle, 2)
        os.chdir(project.folder)
        os.environ.update(case.surroundings)
        if case.inside and stage == case.stages[-1]:
            case.inside()
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if case.surroundings:  # what an interpreter looks at when it starts
            command = [sys.executable, "-m", f"stages.{stage}", *words]
            os.execve(sys.executable, command, os.environ | {"PYTHONPATH": str(ROOT)})
        sys.argv = [stage, *words]
        runpy.run_module(f"stages.{stage}", run_name="__main__")
        status = 0
    except NotPossible as error:
        print(error)
        status = NOT_POSSIBLE
    except SystemExit as leave:
        status = leave.code if isinstance(leave.code, int) else 1
    except BaseException:  # what a user would see
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def cut(file: Path) -> None:
    """Take the second half of a file away, as a power cut may."""
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])


def seed_old_result(project: Project, stage: str) -> Path:
    """A complete earlier result of the stage, which a failing run must leave alone."""
    folder = project.work / stage
    folder.mkdir(parents=True)
    for name in (f"{stage}.json", "kept.txt"):
        (folder / name).write_text(OLD, encoding="utf-8")
    return folder / "kept.txt"


def verdict(case: Case, project: Project, before: dict[str, str], old: Path, log: Path) -> str:
    """What is wrong with a run that ended with exit status 0 or 2; empty where nothing is."""
    text = log.read_text(encoding="utf-8", errors="replace")
    after = project.users_files()
    lost = [name for name, digest in before.items() if after.get(name) != digest]
    if lost:
        return f"the user's files were changed: {lost[:3]}"
    if "Traceback" in text:
        return "a traceback"
    if list(project.folder.rglob(".partial-*")):
        return "a half-written result was left behind"
    if case.check:
        try:
            case.check(project)
        except AssertionError as error:
            return f"the result is not right: {error}"
        return ""

    if not old.exists() or old.read_text(encoding="utf-8") != OLD:
        return "the earlier result was lost"
    said = text[text.find(STOPPED) :]
    missing = [word for word in (*case.words, "what to do:") if word not in said]
    return f"the message does not say {missing}" if missing else ""


def judge(case: Case, folder: Path) -> dict:
    """Make the case's project in `folder`, run it, and say how it ended: a row of the table."""
    project = Project(folder, case.scene, case.photos)
    project.make()
    case.spoil(project)
    before = project.users_files()
    log = project.work / "log.txt"
    log.parent.mkdir(parents=True, exist_ok=True)
    log.touch()

    seconds = 0.0
    status: int | None = 0
    for stage in case.stages:
        old = seed_old_result(project, stage)
        status, spent = run(case, project, stage, log)
        seconds += spent
        if status != 0:
            break
        if stage in project.cut_after:
            cut(project.work / stage / project.cut_after[stage])

    happened = ENDINGS.get(status, "traceback")
    if status is not None and status < 0:
        happened = f"killed by {signal.Signals(-status).name}"
    wrong = "" if happened in (case.expected, "not tried") else f"{happened} in {stage}"
    if happened == case.expected:
        wrong = verdict(case, project, before, old, log)
    return {
        "group": case.group,
        "case": case.name,
        "expected": case.expected,
        "happened": happened,
        "stage": stage,
        "seconds": round(seconds, 2),
        "right": not wrong,
        "wrong": wrong,
        "said": said(log),
    }


def said(log: Path) -> str:
    """The message of a stage, or the last line of a traceback; the program's own files without
    where it lies.
    """
    text = log.read_text(encoding="utf-8", errors="replace").replace(f"{ROOT}/", "").strip()
    if STOPPED in text:
        return " ".join(text[text.rfind(STOPPED) + len(STOPPED) :].split())
    if "Traceback" in text:
        return text.splitlines()[-1]
    return ""
