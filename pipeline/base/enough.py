"""How many samples `samples: auto` asks for: what the workflow reads of the stage `enough`."""

from __future__ import annotations

from pathlib import Path

from pipeline.base.files import json_entry

AUTO = "auto"
FIRST = 3  # samples that are drawn before any are judged
FILE = "enough.json"


def samples_wanted(file: Path) -> int:
    """How many samples there shall be, by what the stage wrote. Raises InputError."""
    return json_entry(file, "samples")
