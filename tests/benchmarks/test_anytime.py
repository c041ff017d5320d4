"""Curves of runs that stop early."""

import pytest

from benchmarks.anytime.__main__ import curve, scored_stops, with_stops
from benchmarks.anytime.stops import Run
from pipeline.base.errors import InputError


def test_a_run_is_scored_at_a_few_of_its_stops():
    """What stops cost is not counted, and only scored ones are made."""
    made = []

    def stops():
        for number in range(1, 41):
            yield lambda number=number: made.append(number) or number

    found = curve(Run(40, stops()), lambda x: ({"relight_psnr": float(x)}, 100.0))
    numbers = [point["stop"] for point in found]
    assert numbers == made == scored_stops(40)
    assert numbers[0] == 3 and numbers[-1] == 40
    assert [point["scores"]["relight_psnr"] for point in found] == numbers
    assert all(100 <= point["cpu_seconds"] < 101 for point in found)


def test_methods_without_stops_are_refused():
    assert with_stops(["dpi_paper_300"]) == ["dpi_paper_300"]
    for name in ("map", "preset_draft", "split_gibbs_draft_mean"):
        with pytest.raises(InputError, match="may be stopped"):
            with_stops([name])
