"""What a later run sees of files that were damaged since they were made."""

import os

import pytest

from pipeline.base.errors import InputError
from pipeline.base.files import stage_folder
from pipeline.base.manifest import NAME, damaged, is_remainder, note_anew, write_manifest


@pytest.fixture
def made(tmp_path):
    """A stage's folder, and an export elsewhere, both in its manifest."""
    folder = tmp_path / "work"
    (folder / "images").mkdir(parents=True)
    files = [folder / "a.json", folder / "images" / "b.exr", tmp_path / "export.usda"]
    for file in files:
        file.write_bytes(b"0123456789")
    write_manifest(folder / NAME, files)
    return folder


def cut(file, size: int, keep_time: bool = True) -> None:
    times = file.stat()
    os.truncate(file, size)
    if keep_time:
        os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
    else:
        os.utime(file, (0, 0))


def test_what_is_as_it_was_made_is_not_damaged(made):
    assert damaged(made / NAME) == []
    assert damaged(made / "no manifest") == []


@pytest.mark.parametrize("keep_time", [True, False])
@pytest.mark.parametrize("name", ["a.json", "images/b.exr"])
def test_a_stages_own_file_of_another_size_is_damaged(made, name, keep_time):
    cut(made / name, 3, keep_time)
    assert damaged(made / NAME) == [name]


def test_a_stages_own_file_that_is_missing_is_damaged(made):
    (made / "a.json").unlink()
    assert damaged(made / NAME) == ["a.json"]


def test_a_cut_export_is_damaged_and_an_edited_one_is_not(made):
    """The user's edits have a time of their own; they must not be overwritten."""
    export = made.parent / "export.usda"
    after = export.stat().st_mtime + 3  # Snakemake sets it when the stage has ended
    export.write_bytes(b"edited")
    os.utime(export, (9, 9))
    assert damaged(made / NAME) == []
    export.write_bytes(b"edited by hand")
    os.utime(export, (after, after))  # longer is not what a power cut leaves
    assert damaged(made / NAME) == []
    export.unlink()
    assert damaged(made / NAME) == []

    export.write_bytes(b"0123456789")
    write_manifest(made / NAME, [export])
    cut(export, 4)
    os.utime(export, (after, after))
    assert damaged(made / NAME) == ["../export.usda"]
    cut(export, 0, keep_time=False)
    assert damaged(made / NAME) == ["../export.usda"]


@pytest.mark.parametrize("text", ["", '{"a.js', "[1]", '{"a.json": 3}'])
def test_a_damaged_manifest_counts_itself(made, text):
    (made / NAME).write_text(text)
    assert damaged(made / NAME) == [NAME]


def test_a_stages_folder_has_its_manifest(tmp_path):
    with stage_folder(tmp_path / "s", "result") as out:
        (out / "images").mkdir()
        (out / "images" / "a").write_text("12")
        (out / "result").write_text("3")
    assert damaged(tmp_path / "s" / NAME) == []
    cut(tmp_path / "s" / "images" / "a", 1)
    assert damaged(tmp_path / "s" / NAME) == ["images/a"]


def test_what_is_noted_anew_is_not_damaged(made):
    (made / "a.json").unlink()
    cut(made / "images" / "b.exr", 3)
    cut(made.parent / "export.usda", 2)
    assert len(damaged(made / NAME)) == 3
    note_anew(made / NAME)
    assert damaged(made / NAME) == []
    cut(made / "images" / "b.exr", 1)
    assert damaged(made / NAME) == ["images/b.exr"]

    (made / NAME).write_text("{")
    note_anew(made / NAME)
    assert not (made / NAME).exists()


def test_what_is_left_of_a_result_is_replaced_and_no_other_file_is(tmp_path):
    """A stage that is killed after its end: Snakemake deletes those of its files that it knows, and
    the next run notes that they are missing.
    """
    folder = tmp_path / "mesh"

    def run() -> None:
        with stage_folder(folder, "mesh.json") as out:
            (out / "masks").mkdir()
            (out / "masks" / "p0.png").write_text("12")
            (out / "mesh.json").write_text("{}")

    run()
    (folder / "mesh.json").unlink()
    note_anew(folder / NAME)
    assert is_remainder(folder)
    run()
    assert (folder / "mesh.json").exists() and damaged(folder / NAME) == []

    (folder / "mesh.json").unlink()
    note_anew(folder / NAME)
    (folder / "masks" / "mine.png").write_text("3")
    with pytest.raises(InputError, match="no earlier result"):
        run()
    assert (folder / "masks" / "mine.png").read_text() == "3"
    (folder / "masks" / "mine.png").unlink()
    (folder / NAME).unlink()
    with pytest.raises(InputError, match="no earlier result"):
        run()
