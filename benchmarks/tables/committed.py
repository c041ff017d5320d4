"""Rows that a benchmark wrote and that are committed: benchmarks/results/NAME.json holds `command`,
`commit`, `machine`, `note` and `data`, what the benchmark wrote with --out, unchanged.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

from pipeline.base.errors import InputError
from pipeline.base.files import read_json, write_json

ROOT = Path(__file__).resolve().parents[2]

RESULTS = ROOT / "benchmarks" / "results"


def results(name: str) -> dict:
    """benchmarks/results/NAME.json."""
    return read_json(RESULTS / f"{name}.json")


def rows_of(name: str) -> list[dict]:
    """The rows of benchmarks/results/NAME.json."""
    return results(name)["data"]["rows"]


def by_scene(name: str) -> dict[str, dict]:
    """Rows of a file with one row per scene."""
    return {row["scene"]: row for row in rows_of(name)}


def source(name: str) -> str:
    """The line below a table: where its rows come from."""
    about = results(name)
    note = f" {about['note']}" if about["note"] else ""
    return (
        f"\n<sub>[{name}.json](../benchmarks/results/{name}.json): `{about['command']}`; "
        f"{about['machine']}; {about['commit']}.{note}</sub>\n"
    )


def nested(row: dict, *keys: str):
    """row[key][key]..., None where one is missing: a row need not have every figure."""
    for key in keys:
        row = row.get(key) if isinstance(row, dict) else None
    return row


def title(scene: str) -> str:
    """boombox__vestibule -> boombox, vestibule."""
    return scene.replace("__", ", ")


def head_commit() -> str:
    """Short name of the commit at hand."""
    command = ["git", "rev-parse", "--short", "HEAD"]
    return subprocess.run(
        command, cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.strip()


def keep(file: Path, name: str, command: str, commit: str, machine: str, note: str) -> None:
    """Keep a benchmark's output as the rows `name`, with what made it. commit: empty for the one at
    hand; machine: empty where the file says it.

    Raises InputError where nothing says what command or which machine made them.
    """
    if not command:
        raise InputError("rows without their command", file, "say --command 'python -m ...'")
    data = read_json(file)
    machine = machine or data.get("machine")
    if not machine:
        raise InputError("rows without their machine", file, "say --machine '...'")
    about = {
        "command": command,
        "commit": commit or head_commit(),
        "machine": machine,
        "note": note,
    }
    write_json(RESULTS / f"{name}.json", about | {"data": data})
