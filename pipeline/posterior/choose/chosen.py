"""What the choose stage has chosen, for the stages that take it; and what it says where it is off,
without a look at the evidence.
"""

from __future__ import annotations

from pathlib import Path

from pipeline.base.config import SETTINGS_OF, Scene, merge, validated
from pipeline.base.files import json_entry

FILE = "choose.json"


def nothing_chosen() -> dict:
    """What choose.json holds where the stage is off: everything stays as configured."""
    off = {"why": "choose.enabled is false"}
    return {"enabled": False, "settings": {}, "decisions": dict.fromkeys(SETTINGS_OF, off)}


def chosen_scene(scene: Scene, folder: Path) -> Scene:
    """`scene` with what the choose stage, whose folder this is, has chosen."""
    settings = json_entry(folder / FILE, "settings")
    return validated(Scene, merge(scene.model_dump(), settings), folder / FILE)
