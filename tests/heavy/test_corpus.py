"""Bad input to the stages that load the renderer: damaged meshes, full disks, missing libraries."""

import pytest

from tests.benchmarks.test_corpus import RENDERED, all_end_well


@pytest.mark.parametrize("group", RENDERED)
def test_bad_input_ends_well(group, tmp_path):
    all_end_well(group, tmp_path)
