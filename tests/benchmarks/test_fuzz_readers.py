"""Readers take a changed file for something right, or refuse it by a message; the fuzz that tries
them finds what does neither.
"""

import json
import os
import signal
import string
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.corpus import fuzz_readers
from benchmarks.corpus.fuzz_readers import READERS, changed, fuzz
from benchmarks.corpus.mutate import PNG, with_checksums
from benchmarks.corpus.readers import Reader, Seed, photo_seeds, read_config
from pipeline.base.config import Scene, parse_scene
from pipeline.base.errors import InputError
from pipeline.photos.transforms_file import Transforms, read_transforms_file
from tests.seeds import numpy_rng

RENDERED = ("PLY", "OBJ")  # load the renderer, or Open3D for every file: tests/heavy

# --- the fuzz itself --------------------------------------------------------------------------


def defect(folder):
    """A reader with every kind of defect, and a good refusal, by the file's last byte."""
    match (folder / "file").read_bytes()[-1] % 8:
        case 0:
            os.kill(os.getpid(), signal.SIGSEGV)
        case 1:
            raise KeyError("a traceback")
        case 2:
            raise AssertionError("something wrong taken")
        case 3:
            raise InputError("no place and no cure")
        case 4:
            raise InputError("what", "where", "cure")


def planted(monkeypatch, read) -> Reader:
    reader = Reader("planted", lambda: [Seed({"file": bytes(range(64))}, "file")], read)
    monkeypatch.setattr(fuzz_readers, "READERS", (reader,))
    return reader


def test_every_kind_of_defect_is_found(monkeypatch):
    row = fuzz(planted(monkeypatch, defect), 60, count=80)
    said = " ".join(find["what"] for find in row["finds"])
    for what in ("SIGSEGV", "KeyError in", "AssertionError in", "without place or cure"):
        assert what in said, row
    assert row["inputs"] == 80 and 0 < row["taken"] < 80
    assert sum(find["times"] for find in row["finds"]) < 80 - row["taken"], "refusals are no finds"


def test_a_hang_is_found_and_the_rest_is_tried(monkeypatch):
    monkeypatch.setattr(fuzz_readers, "LIMIT", 0.5)
    reader = planted(monkeypatch, lambda f: (f / "file").stat().st_size < 64 and time.sleep(9))
    row = fuzz(reader, 30, count=4)
    assert row["inputs"] == 4 and {f["what"] for f in row["finds"]} == {"no end after 0.5 s"}


def test_inputs_are_the_same_whenever_they_are_made():
    for reader in READERS:
        once, again = reader.seeds(), reader.seeds()
        for number in range(20):
            assert changed(reader, once, number) == changed(reader, again, number), reader.name


def test_a_changed_png_gets_the_checksums_of_what_it_holds():
    png = next(s.files[s.spoil] for s in photo_seeds() if s.files[s.spoil].startswith(PNG))
    assert with_checksums(png) == png
    broken = bytearray(png)
    broken[30] ^= 1
    assert with_checksums(bytes(broken)) == png


# --- the readers ------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    "reader", [r for r in READERS if r.name not in RENDERED], ids=lambda reader: reader.name
)
def test_readers_take_what_is_right_and_refuse_the_rest(reader):
    row = fuzz(reader, 120, count=60)
    assert row["inputs"] == 60 and not row["finds"], row["finds"]
    assert 0 < row["taken"] < 60, "changes are too mild or too harsh to tell anything"


real = st.floats(allow_nan=True, allow_infinity=True) | st.integers(-3, 3)


@given(st.lists(st.lists(real, min_size=3, max_size=5), min_size=3, max_size=5))
@settings(derandomize=True, deadline=None, max_examples=60)
def test_any_matrix_is_a_pose_or_refused(tmp_path_factory, rows):
    file = tmp_path_factory.getbasetemp() / "any_matrix.json"
    frame = {"file_path": "images/p0.png", "transform_matrix": rows}
    file.write_text(json.dumps({"fl_x": 90, "frames": [frame]}))
    try:
        pose = read_transforms_file(file).frames[0].camera_to_world(file)
    except InputError as error:
        assert str(file) in str(error) and error.cure
        return
    turn = pose[:3, :3]
    assert np.isfinite(pose).all() and np.allclose(turn @ turn.T, np.eye(3), atol=1e-6)
    assert np.linalg.det(turn) > 0


scalar = st.none() | st.booleans() | st.integers() | st.floats() | st.text(string.printable)
key = st.text(max_size=4) | st.sampled_from([*Scene.model_fields, "grid", "method", "points"])
tree = st.recursive(scalar, lambda part: st.lists(part) | st.dictionaries(key, part), max_leaves=8)


@pytest.mark.slow
@given(st.dictionaries(key, tree, max_size=4))
@settings(derandomize=True, deadline=None, max_examples=60)
def test_any_mapping_is_a_configuration_or_refused(own):
    try:
        scene = parse_scene({"photos": "photos"} | own, "s.yaml")
    except InputError as error:
        assert "s.yaml" in str(error) and error.cure
        return
    assert Scene.model_validate(scene.model_dump(mode="json")) == scene


@given(st.dictionaries(key | st.sampled_from([*Transforms.model_fields]), tree, max_size=5))
@settings(derandomize=True, deadline=None, max_examples=60)
def test_any_json_is_a_file_of_cameras_or_refused(tmp_path_factory, own):
    file = tmp_path_factory.getbasetemp() / "any_cameras.json"
    file.write_text(json.dumps(own))
    try:
        found = read_transforms_file(file)
    except InputError as error:
        assert str(file) in str(error) and error.cure
        return
    assert all(isinstance(frame.file_path, str) for frame in found.frames)


def test_bytes_that_are_no_configuration_are_refused(tmp_path):
    (tmp_path / "s.yaml").write_bytes(numpy_rng(0).bytes(200))
    with pytest.raises(InputError, match="s.yaml"):
        read_config(tmp_path)
