"""Photo sets: which photos of a set are taken."""

import os

import pytest

from benchmarks import real_sets
from pipeline.base.errors import InputError, run_stage


@pytest.fixture
def photos(tmp_path, monkeypatch):
    """A folder of sets, one with two passes and masks; work/ in a place of its own."""
    monkeypatch.setattr(real_sets, "ROOT", tmp_path / "project")
    for kind, suffix in (("images", "jpg"), ("masks", "png")):
        folder = tmp_path / "photos" / "socketed_axe" / kind
        folder.mkdir(parents=True)
        for number in (8834, 8835, 8850, 8860, 8862):
            (folder / f"IMG_{number}.{suffix}").write_bytes(b"")
    (tmp_path / "photos" / "banana").mkdir()
    return tmp_path / "photos"


def test_one_pass_is_taken_with_its_masks(photos):
    folder = real_sets.scene_folder(photos, "socketed_axe")
    assert folder.name == "socketed_axe" and folder.parent != photos
    names = sorted(f.relative_to(folder).as_posix() for f in folder.glob("*/*.*"))
    kept = ("IMG_8835", "IMG_8850", "IMG_8860")
    assert names == [f"images/{n}.jpg" for n in kept] + [f"masks/{n}.png" for n in kept]


def test_other_sets_are_taken_as_they_are(photos):
    assert real_sets.scene_folder(photos, "banana") == photos / "banana"


def test_what_is_missing_is_named(photos):
    with pytest.raises(InputError, match="no such set"):
        real_sets.scene_folder(photos, "kiwi")
    with pytest.raises(InputError, match="IMG_9000"):
        real_sets.part_of(photos / "socketed_axe", "IMG_9000", "IMG_9001")


def test_a_failed_set_says_why(tmp_path, capsys):
    assert real_sets.failure(tmp_path).startswith("no stage was begun")
    (tmp_path / "capture.log").write_text("photos: 26/26, took 0:02\n")
    os.utime(tmp_path / "capture.log", (1, 1))

    def stop():
        raise InputError("the light turned with the camera", tmp_path, "move the camera")

    with pytest.raises(SystemExit):
        run_stage(stop)
    (tmp_path / "poses.log").write_text("features (plain)\n" + capsys.readouterr().err)
    assert real_sets.failure(tmp_path) == "poses: the light turned with the camera"

    (tmp_path / "poses.log").write_text("Traceback\nValueError: nothing\n\n")
    assert real_sets.failure(tmp_path) == "poses: ValueError: nothing"
