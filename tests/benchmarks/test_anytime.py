"""Curves of runs that stop early."""

import pytest

from benchmarks.anytime.__main__ import curve, scored_stops, with_stops
from benchmarks.anytime.charts import page
from benchmarks.anytime.stops import Run
from benchmarks.anytime.tables import methods_in, points, table
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


def rows_of(method: str, seconds: float) -> list[dict]:
    """Runs of two scenes, a stop half way and the whole."""
    scores = {
        "relight_psnr": 20.0,
        "novel_view_psnr": 25.0,
        "light_psnr_log": 15.0,
        "albedo_mse": 0.01,
    }
    stop = lambda k, add: {
        "stop": k,
        "count": 4,
        "cpu_seconds": k * seconds,
        "scores": scores | {"relight_psnr": 20.0 + k + add},
    }
    return [
        {"scene": scene, "method": method, "stops": [stop(2, add), stop(4, add)]}
        for scene, add in (("a", 0.0), ("b", 1.0))
    ]


def test_curves_are_means_over_scenes(tmp_path):
    """A method that lacks a scene is left out: its mean would be of other scenes."""
    rows = rows_of("split_gibbs_draft", 10.0) + rows_of("dpi_paper", 40.0)
    rows += rows_of("dpi_paper_300", 80.0)[:1]
    assert methods_in(rows) == ["split_gibbs_draft", "dpi_paper"]
    half, whole = points(rows, "split_gibbs_draft")
    assert (half.share, half.seconds, half.scores["relight_psnr"]) == (0.5, 10.0, 22.5)
    assert (whole.share, whole.seconds, whole.scores["relight_psnr"]) == (1.0, 20.0, 24.5)
    assert "| `dpi_paper` | 50% | 40.0 | 22.5 |" in table(rows)
    page(rows, tmp_path / "anytime")
    assert (tmp_path / "anytime.png").stat().st_size > 5000
