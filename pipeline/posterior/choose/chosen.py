"""What the choose stage has chosen, for the stages that take it; and what it says where it is off,
without a look at the evidence.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from pipeline.base.config import SETTINGS_OF, Scene, merge, validated
from pipeline.base.files import json_entry, write_json

FILE = "chosen.json"


@dataclass(frozen=True)
class Chosen:
    """settings: {section: {setting: value}}, which later stages take in place of the configured
    ones.
    """

    settings: dict

    def save(self, folder: Path) -> None:
        """Write chosen.json into the folder of the choose stage."""
        write_json(folder / FILE, asdict(self))

    @classmethod
    def load(cls, folder: Path) -> Chosen:
        """Read chosen.json from the folder of the choose stage. Raises InputError where it is
        missing.
        """
        return cls(settings=json_entry(folder / FILE, "settings"))


def nothing_chosen() -> dict:
    """As `decide.choose`, where the stage is off: everything stays as configured."""
    off = {"why": "choose.enabled is false"}
    return {"enabled": False, "settings": {}, "decisions": dict.fromkeys(SETTINGS_OF, off)}


def chosen_scene(scene: Scene, folder: Path) -> Scene:
    """`scene` with what the choose stage, whose folder this is, has chosen."""
    settings = Chosen.load(folder).settings
    return validated(Scene, merge(scene.model_dump(), settings), folder / FILE)
