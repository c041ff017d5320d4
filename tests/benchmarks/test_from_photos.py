"""Things whose truth is known, without their mesh: what the chain then gets."""

import json

import pytest

from benchmarks import from_photos
from pipeline.base.errors import InputError


@pytest.fixture
def thing(tmp_path, monkeypatch):
    """A scene folder as benchmarks.make_scene leaves it; work/ in a place of its own."""
    monkeypatch.setattr(from_photos, "ROOT", tmp_path / "project")
    folder = tmp_path / "thing"
    for kind in ("images", "masks", "truth/relight"):
        (folder / kind).mkdir(parents=True)
    (folder / "images" / "train_000.png").write_bytes(b"photo")
    (folder / "mesh.ply").write_bytes(b"ply")
    for number, name in enumerate(from_photos.CAMERAS):
        frames = [{"file_path": f"images/{number}.png"}]
        (folder / name).write_text(json.dumps({"frames": frames}))
    return folder


def test_the_mesh_and_the_truth_are_left_out_and_all_cameras_kept(thing):
    own = from_photos.without_mesh(thing)
    assert own.name == "thing_own" and not (own / "mesh.ply").exists()
    assert (own / "images" / "train_000.png").read_bytes() == b"photo"
    assert [f.name for f in (own / "truth").iterdir()] == ["cameras.json"]
    frames = json.loads((own / "truth" / "cameras.json").read_text())["frames"]
    assert [frame["file_path"] for frame in frames] == ["images/0.png", "images/1.png"]
    assert (thing / "mesh.ply").exists()


def test_a_folder_that_is_there_is_not_made_again(thing):
    """Its photos would be newer than what was made of them."""
    before = (from_photos.without_mesh(thing) / "images" / "train_000.png").stat()
    after = (from_photos.without_mesh(thing) / "images" / "train_000.png").stat()
    assert before.st_ino == after.st_ino


def test_a_folder_without_truth_is_refused(thing):
    (thing / "mesh.ply").unlink()
    with pytest.raises(InputError, match="truth is not known"):
        from_photos.without_mesh(thing)
