"""Tables of the rows of benchmarks.surfaces: what a surface takes, and how good it is."""

from __future__ import annotations

from benchmarks.markdown import number, pipe_table
from benchmarks.study.front import Point
from benchmarks.study.front import choice as front_choice

SCORES = {
    "f1_at_1_percent_of_size": "F-score at 1 % of the size",
    "f1_at_half_percent": "F-score at .5 %",
    "unlit_psnr": "unlit PSNR, dB",
}


def score(found: dict, name: str) -> float:
    return found["unlit_psnr"] if name == "unlit_psnr" else found["truth"][name]


def table(data: dict) -> str:
    """All settings, fastest first."""
    body = []
    for found in sorted(data["rows"], key=lambda one: one["core_seconds"]):
        truth = found["truth"]
        cells = [found["setting"], number(found["core_seconds"], 0), number(found["peak_gib"], 2)]
        cells += [f"{found['faces']:,}"]
        cells += [number(truth[key], 3) for key in SCORES if key in truth]
        cells += [number(truth["chamfer_percent_of_diagonal"], 2)]
        cells += [number(truth["normal_error_median_degrees"])]
        body.append([*cells, number(found["unlit_psnr"])])
    head = ["setting", "core s", "peak GiB", "triangles", "F-score at 1 %", "at .5 %"]
    head += ["Chamfer, % of the diagonal", "normals, median degrees", "unlit PSNR, dB"]
    return pipe_table(head, body)


def points(data: dict, name: str) -> list[Point]:
    """Settings as points of a chart of the score `name`."""
    return [Point(f["setting"], f["core_seconds"], score(f, name), 0, 0) for f in data["rows"]]


def choice(data: dict) -> str:
    """One sentence: which setting to choose, by the F-score at .5 %."""
    return front_choice(points(data, "f1_at_half_percent"), True, "", "a surface") + "\n"
