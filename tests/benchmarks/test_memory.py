"""Peak memory by stage, from what stages write about themselves."""

from pathlib import Path

import pytest

from benchmarks.memory import ORDER, named_folder, peaks, table
from pipeline.base.errors import InputError
from pipeline.base.files import write_json
from tests.conftest import TESTS


def test_folders_stand_side_by_side_with_the_largest_of_the_samples(tmp_path):
    for file, gib in (
        ("a/report.json", 0.5),
        ("a/mesh/mesh.json", 2.25),
        ("a/sample/0/sample.json", 1.0),
        ("a/sample/1/sample.json", 1.5),
        ("b/mesh/mesh.json", 0.75),
    ):
        write_json(tmp_path / file, {"peak_gib": gib})
    columns = [peaks("garden, before", tmp_path / "a"), peaks("now", tmp_path / "b")]
    assert table(columns).splitlines() == [
        "| stage | garden, before | now |",
        "| --- | --- | --- |",
        "| mesh | 2.25 | .75 |",
        "| sample | 1.50 |  |",
        "| report | .50 |  |",
    ]


def test_a_folder_has_a_name_and_stages(tmp_path):
    with pytest.raises(InputError, match="no stage is finished"):
        peaks("now", tmp_path)
    assert named_folder("at 4747f7f=work/a=b") == ("at 4747f7f", Path("work/a=b"))
    for text in ("work/garden", "=work/garden", "now="):
        with pytest.raises(InputError, match="NAME=FOLDER"):
            named_folder(text)


def test_no_stage_is_left_out():
    stages = {file.stem for file in (TESTS.parent / "stages").glob("[a-z]*.py")}
    assert set(ORDER) == stages and len(ORDER) == len(stages)
