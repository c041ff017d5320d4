"""Every test is of one tier, and only the heavy ones are left out of a plain `pytest`."""

import pytest

from tests.conftest import COLLECTED, LONGEST_FIRST, TESTS, tier_of

TIERS = {"unit", "slow", "dag", "heavy"}
WORKERS = ["-n", "2", "--dist", "loadfile", "--no-loadscope-reorder"]


def test_every_test_is_of_the_one_tier_of_its_place(request):
    """Of all tests of this run, those that -m left out too."""
    for item in request.config.stash[COLLECTED]:
        tiers = [mark.name for mark in item.iter_markers() if mark.name in TIERS]
        folder = item.path.relative_to(TESTS).parts[0]
        assert len(set(tiers)) == 1, item.nodeid
        assert (tiers[0] == folder) == (folder in ("dag", "heavy")), item.nodeid
        assert tiers[0] in ("unit", "slow", folder), item.nodeid


def test_files_with_long_tests_come_first(request):
    """A worker that begins one last keeps the other waiting."""
    place: dict = {}
    for item in request.config.stash[COLLECTED]:
        tier = next(mark.name for mark in item.iter_markers() if mark.name in TIERS)
        place.setdefault(item.path, set()).add(LONGEST_FIRST.index(tier))
    first = [min(places) for places in place.values()]  # in the order of the run
    assert first == sorted(first)


def test_a_plain_run_leaves_out_the_heavy_tests_only(pytestconfig):
    assert pytestconfig.getini("addopts") == ["--strict-markers", "-m", "not heavy", *WORKERS]
    assert {line.split(":")[0] for line in pytestconfig.getini("markers")} >= TIERS


@pytest.mark.parametrize(
    "place, marks, fixtures, tier",
    [
        ("render/test_a.py", set(), [], "unit"),
        ("test_a.py", {"parametrize"}, ["ball"], "unit"),
        ("posterior/test_a.py", {"slow"}, [], "slow"),
        ("posterior/test_a.py", set(), ["problem", "toy"], "slow"),
        ("dag/test_a.py", set(), [], "dag"),
        ("heavy/test_a.py", {"heavy"}, ["toy"], "heavy"),
    ],
)
def test_the_place_the_mark_slow_and_the_scene_decide(place, marks, fixtures, tier):
    assert tier_of(TESTS / place, marks, fixtures) == tier


@pytest.mark.parametrize(
    "place, mark", [("posterior/test_a.py", "heavy"), ("dag/test_a.py", "slow"), ("x/a.py", "dag")]
)
def test_a_mark_against_the_place_is_an_error(place, mark):
    """A heavy test outside tests/heavy would never be run."""
    with pytest.raises(ValueError, match=mark):
        tier_of(TESTS / place, {mark})
