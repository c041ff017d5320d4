"""Changed mesh files, whose readers load the renderer, or Open3D for every file."""

import pytest

from benchmarks.corpus.fuzz_readers import READERS, fuzz
from tests.benchmarks.test_fuzz_readers import RENDERED


@pytest.mark.parametrize(
    "reader", [r for r in READERS if r.name in RENDERED], ids=lambda reader: reader.name
)
def test_mesh_readers_take_what_is_right_and_refuse_the_rest(reader):
    row = fuzz(reader, 900, count=40)
    assert row["inputs"] == 40 and not row["finds"], row["finds"]
    assert 0 < row["taken"] < 40
