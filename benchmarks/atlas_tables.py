"""Table of the rows of benchmarks.atlas: routes from a mesh to an atlas."""

from __future__ import annotations

from benchmarks.markdown import number, pipe_table


def percent(share: float) -> str:
    """A share in percent; 0 where nothing at all is meant."""
    return "0" if share <= 0 else f"{100 * share:.2g}"


def table(rows: list[dict]) -> str:
    """Every route on every mesh."""
    body = []
    for row in rows:
        cells = [row["mesh"], f"{row['faces']:,}", row["route"]]
        if "failed" in row:
            body.append([*cells, row["failed"]] + [""] * 6)
            continue
        cells += [str(row["charts"]), number(row["utilisation"], 2)]
        cells += [percent(row["overlap"]), percent(row["mirrored"])]
        cells += [number(row["angle_stretch"], 2), number(row["area_stretch"], 2)]
        body.append([*cells, number(row["seconds"], 0 if row["seconds"] >= 10 else 1)])
    head = ["mesh", "triangles", "route", "charts", "share of the page", "overlap %", "mirrored %"]
    head += ["angles: ratio", "areas: doublings", "processor s"]
    return pipe_table(head, body)
