"""Curves of the suite's points, and where they break.

A method breaks at the first value at which its relight PSNR is 3 dB or more below that of the
harmless value, or the pipeline refuses the scene; and, counted by itself, at the first value at
which its 80 % intervals hold less than 40 %, half of what they promise. Coverage is the mean over
three kinds of unknowns (the light's harmonics, relit pixels, base colours:
benchmarks/study/together.py) of the share that intervals of all draws of a point hold, Student's
predictive intervals for fewer than nine; one draw has none.
"""

from __future__ import annotations

from benchmarks.markdown import number, pipe_table
from benchmarks.stability.knobs import KNOBS
from benchmarks.study.methods import METHODS, is_ours

FALL = 3.0  # dB
LEAST_COVERAGE = 0.4


def curve(data: dict, base: str, knob: str, method: str) -> list[dict]:
    """A method's rows of a knob that are known, from harmless to hard."""
    rows = {
        row["value"]: row
        for row in data["rows"]
        if (row["base"], row["knob"], row["method"]) == (base, knob, method)
    }
    return [rows[value] for value in KNOBS[knob].values if value in rows]


def relight(row: dict) -> float | None:
    return None if "refused" in row else row["scores"]["relight_psnr"]


def broken(row: dict, start: dict) -> bool:
    """Whether a row is refused, or its views too far below the harmless row's."""
    here, there = relight(row), relight(start)
    return here is None or (there is not None and here <= there - FALL)


def limit(rows: list[dict]) -> dict | None:
    """The first row of a curve that is broken; None where it holds to its end."""
    return next((row for row in rows if broken(row, rows[0])), None)


def coverage_limit(rows: list[dict]) -> dict | None:
    """The first row whose intervals hold less than half of what they promise, the harmless one
    counted; None where there is none.
    """
    known = [row for row in rows if row.get("coverage") is not None]
    return next((row for row in known if row["coverage"] < LEAST_COVERAGE), None)


def bases_in(data: dict) -> list[str]:
    return list(dict.fromkeys(row["base"] for row in data["rows"]))


def methods_in(data: dict) -> list[str]:
    """In the order of METHODS."""
    found = {row["method"] for row in data["rows"]}
    return [name for name in METHODS if name in found]


def leading(data: dict) -> str:
    """The method whose curves are told at length: the first one."""
    return methods_in(data)[0]


def knobs_in(data: dict, base: str) -> list[str]:
    """Those of which two values at least are known."""
    return [
        name
        for name in KNOBS
        if any(len(curve(data, base, name, method)) > 1 for method in methods_in(data))
    ]


def fall(row: dict, start: dict) -> str:
    """Change of relight PSNR against the harmless value, in dB."""
    here, there = relight(row), relight(start)
    return "refused" if here is None or there is None else f"{here - there:+.1f} dB"


def relight_cell(rows: list[dict]) -> str:
    """Where a method's views break, for the table."""
    if len(rows) < 2:
        return ""
    found = limit(rows)
    if found is None:
        return f"holds to {rows[-1]['value']:g} ({fall(rows[-1], rows[0])})"
    return f"**{found['value']:g}** ({fall(found, rows[0])})"


def coverage_cell(rows: list[dict]) -> str:
    """Where its intervals break."""
    known = [row for row in rows if row.get("coverage") is not None]
    if len(known) < 2:
        return ""
    found = coverage_limit(rows) or known[-1]
    shown = f"({number(found['coverage'], 2)})"
    if found["coverage"] < LEAST_COVERAGE:
        return f"**{found['value']:g}** {shown}"
    return f"holds to {found['value']:g} {shown}"


def breaking_points(data: dict) -> str:
    """Every knob and method: the first values that break views and intervals."""
    methods = methods_in(data)
    drawn = [method for method in methods if METHODS[method].drawn]
    body = []
    for base in bases_in(data):
        for name in knobs_in(data, base):
            knob = KNOBS[name]
            curves = {method: curve(data, base, name, method) for method in methods}
            known = {row["value"] for rows in curves.values() for row in rows}
            values = ", ".join(f"{value:g}" for value in knob.values if value in known)
            of_leading = curves[leading(data)]
            start = relight(of_leading[0]) if of_leading else None
            cells = [knob.title + (f", {knob.unit}" if knob.unit else ""), f"`{base}`", values]
            cells += [number(start), *(relight_cell(curves[method]) for method in methods)]
            body.append(cells + [coverage_cell(curves[method]) for method in drawn])
    head = ["knob", "scene", "values", "relight dB, harmless"]
    head += [f"`{method}`: views break at" for method in methods]
    return pipe_table(head + [f"`{method}`: intervals break at" for method in drawn], body)


def ends(data: dict, base: str, method: str, ours: str) -> dict[str, float]:
    """By how many dB `ours` is ahead of a method at the hard end of every knob of which both have a
    score there.
    """
    found = {}
    for name in knobs_in(data, base):
        last = [curve(data, base, name, one)[-1:] for one in (ours, method)]
        if KNOBS[name].of_the_run or not all(last) or last[0][0]["value"] != last[1][0]["value"]:
            continue
        here, there = (relight(rows[0]) for rows in last)
        if here is not None and there is not None:
            found[name] = here - there
    return found


def side_by_side(data: dict) -> str:
    """Where our default, and the mean of its draws, is ahead of each other method at the hard ends,
    and where behind.
    """
    methods = methods_in(data)
    body = []
    for base in bases_in(data):
        for ours in filter(is_ours, methods):
            for method in (name for name in methods if not is_ours(name)):
                ahead = ends(data, base, method, ours)
                body += ahead_and_behind(f"`{ours}`", f"`{method}`", ahead) if ahead else []
    return pipe_table(["what", "is", "hard ends", "by so many dB of relight PSNR"], body)


def ahead_and_behind(ours: str, other: str, ahead: dict[str, float]) -> list[list[str]]:
    """The cells of two rows, for leads in dB by knob."""
    body = []
    for word, chosen in (
        ("ahead of", {name: gain for name, gain in ahead.items() if gain > 0}),
        ("behind", {name: gain for name, gain in ahead.items() if gain <= 0}),
    ):
        order = sorted(chosen, key=lambda name: -abs(chosen[name]))
        parts = [f"{KNOBS[name].title} {abs(chosen[name]):.1f}" for name in order]
        count = f"{len(chosen)} of {len(ahead)}"
        body.append([ours, f"{word} {other}", count, "; ".join(parts)])
    return body


def figures(data: dict) -> str:
    """Every point of the leading method: scores, coverage and seconds."""
    body = []
    for base in bases_in(data):
        for name in knobs_in(data, base):
            for row in curve(data, base, name, leading(data)):
                cells = [KNOBS[name].title, f"{row['value']:g}"]
                if "refused" in row:
                    body.append([*cells, f"refused: {row['refused']}", "", "", "", "", ""])
                    continue
                scores = row["scores"]
                cells += [number(scores["relight_psnr"]), number(scores["relight_psnr_channel"])]
                cells += [number(scores["light_psnr_log"]), number(scores["albedo_mse"], 4)]
                cells += [number(row.get("coverage"), 2), number(row["seconds"])]
                body.append(cells)
    head = ["knob", "value", "relight dB", "aligned dB", "light dB", "albedo MSE"]
    return pipe_table([*head, "80 % hold", "core s a draw"], body)


def both_scores(rows: tuple[dict, dict], name: str, digits: int) -> str:
    """A score before and after."""
    say = lambda row: "refused" if "refused" in row else number(row["scores"][name], digits)
    return " \\| ".join(map(say, rows))


def cures(before: dict, after: dict) -> str:
    """The points that both have, before and after what was cured; the harmless scene once."""
    key = lambda row: (row["base"], row["knob"], row["value"], row["method"])
    now = {key(row): row for row in after["rows"]}
    body: dict[tuple[str, str], list[str]] = {}
    for row in before["rows"]:
        knob = KNOBS[row["knob"]]
        if key(row) not in now or knob.of_the_run or row["knob"] == "views":
            continue
        harmless = row["value"] == knob.values[0]
        what = "nothing is wrong" if harmless else f"{knob.title}, {row['value']:g}"
        both = row, now[key(row)]
        scores = ("relight_psnr", "relight_psnr_channel", "light_psnr_log")
        cells = [both_scores(both, name, 1) for name in scores]
        cells += [both_scores(both, "metallic_mse", 2)]
        cells += [" \\| ".join(number(r.get("coverage"), 2) or "-" for r in both)]
        body.setdefault((what, f"`{row['method']}`"), cells)
    head = ["point", "method", "relight dB", "aligned dB", "light dB", "metallic MSE", "80 % hold"]
    return pipe_table(head, [[*names, *cells] for names, cells in body.items()])


TABLES = {
    "stability_limits": breaking_points,
    "stability_ends": side_by_side,
    "stability_figures": figures,
}
