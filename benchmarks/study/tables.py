"""Tables of a study's rows."""

from __future__ import annotations

import numpy as np

from benchmarks.markdown import number, pipe_table
from benchmarks.study.intervals import paired, views_of
from benchmarks.study.methods import METHODS, OURS
from benchmarks.tables.committed import title
from pipeline.render.declared import METRICS

SHOWN = (
    "relight_psnr",
    "relight_psnr_channel",
    "novel_view_psnr",
    "light_psnr_log",
    "light_psnr_tone_mapped",
    "sun_degrees",
    "albedo_mse",
    "albedo_mse_scalar",
    "albedo_mse_channel",
    "roughness_mse",
    "metallic_mse",
)
LIKENESS = (
    "relight_psnr",
    "relight_ssim",
    "relight_flip",
    "novel_view_psnr",
    "novel_view_ssim",
    "novel_view_flip",
    "light_ssim",
)
TOGETHER = (
    "relight_psnr_of_mean",
    "crps_relight",
    "crps_albedo",
    "variance_albedo",
    "variance_light",
)
DIFFERENCES = (
    "relight_psnr",
    "novel_view_psnr",
    "light_psnr_log",
    "albedo_mse_scalar",
    "albedo_mse_channel",
)


def methods_in(data: dict) -> list[str]:
    """In the order of METHODS."""
    found = {row["method"] for row in data["rows"]}
    return [name for name in METHODS if name in found]


def scenes_in(data: dict) -> list[str]:
    return list(dict.fromkeys(row["scene"] for row in data["rows"]))


def rows_for(data: dict, scene: str, method: str) -> list[dict]:
    return [r for r in data["rows"] if (r["scene"], r["method"]) == (scene, method)]


def drawn(data: dict, scene: str, method: str) -> dict:
    """Scores of the draws together; empty where there is one draw only."""
    found = [r for r in data["together"] if (r["scene"], r["method"]) == (scene, method)]
    return found[0]["scores"] if found else {}


def scene_mean(data: dict, scene: str, method: str, key: str) -> float | None:
    """A score's mean over the draws of a scene; None without any."""
    rows = rows_for(data, scene, method)
    if not rows:
        return None
    if key in TOGETHER:
        return drawn(data, scene, method).get(key)
    return float(np.mean([row["scores"][key] for row in rows]))


def mean_of(data: dict, method: str, key: str) -> float | None:
    """Mean over scenes; None where a scene lacks it, so that means are of the same scenes."""
    found = [scene_mean(data, scene, method, key) for scene in scenes_in(data)]
    known = [value for value in found if value is not None]
    return float(np.mean(known)) if len(known) == len(found) else None


def timing(data: dict) -> list[dict]:
    """Rows that times are taken of: those made for it, which may be of fewer scenes; else all."""
    return data.get("times") or data["rows"]


def timed(data: dict, method: str) -> list[dict]:
    """Rows whose times may be compared: those of the machine and the day of our own rows, or of the
    most of them, which are the reference; the same processor is up to 1.4 times as fast on another
    day. Empty where these lack a scene.
    """
    found = timing(data)
    of = lambda name: [row for row in found if row["method"] == name]
    where = lambda row: (row["machine"], row.get("date"))
    places = [where(row) for row in of(OURS)]
    if not places:
        return []
    place = max(places, key=places.count)
    rows = [row for row in of(method) if where(row) == place]
    return rows if {row["scene"] for row in rows} == {row["scene"] for row in found} else []


def seconds(data: dict, method: str) -> float | None:
    """Processor seconds of a row, which is a draw with its refinement or all those of a mean; mean
    over scenes and rows. None where there is no time to compare.
    """
    costs = [row["cost"] for row in timed(data, method)]
    spent = [cost["sample"]["cpu_seconds"] + cost["refine"]["cpu_seconds"] for cost in costs]
    return float(np.mean(spent)) if spent else None


def shares_held(data: dict, method: str, nominal: str = "80%") -> np.ndarray | None:
    """Share of the true values that a method's intervals hold (scenes, kinds of unknowns); None
    where a scene has no several draws.
    """
    found = [drawn(data, scene, method).get("coverage") for scene in scenes_in(data)]
    if not all(found):
        return None
    return np.array([[held[kind][nominal] for kind in sorted(held)] for held in found])


def coverage_error(shares: np.ndarray, nominal: float = 0.8) -> np.ndarray:
    """How far intervals are from holding what they promise (...): mean over kinds of unknowns of
    |share over all scenes - nominal|, for shares (..., scenes, kinds).

    Not over scenes: one scene's unknowns hang together by the level of its light and lie inside or
    outside together, so that honest draws too would be wrong in every single scene.
    """
    return np.abs(shares.mean(-2) - nominal).mean(-1)


def heading(key: str) -> str:
    metric = METRICS[key]
    return metric.title + (f", {metric.unit}" if metric.unit else "")


def scores(data: dict) -> str:
    """Means over the scenes of every method that has rows of all."""
    body = []
    for method in methods_in(data):
        cells = [f"`{method}`", number(seconds(data, method)), *means(data, method, SHOWN)]
        if any(cells[1:]):
            body.append(cells)
    return pipe_table(["method", "core s", *(heading(key) for key in SHOWN)], body)


def means(data: dict, method: str, keys: tuple[str, ...]) -> list[str]:
    """Cells with a method's means over scenes."""
    return [number(mean_of(data, method, key), METRICS[key].digits) for key in keys]


def likeness(data: dict) -> str:
    """How like the true pictures the rendered ones are, by three measures of it."""
    body = [[f"`{method}`", *means(data, method, LIKENESS)] for method in methods_in(data)]
    kept = [cells for cells in body if any(cells[1:])]
    return pipe_table(["method", *(heading(key) for key in LIKENESS)], kept)


def draws(data: dict) -> str:
    """What several draws say together."""
    body = []
    for method in methods_in(data):
        cells = [f"`{method}`", *means(data, method, TOGETHER)]
        held = [shares_held(data, method, nominal) for nominal in ("50%", "80%", "95%")]
        cells += [number(None if s is None else float(s.mean()), 2) for s in held]
        if any(cells[1:]):
            body.append(cells)
    head = ["method", *(heading(key) for key in TOGETHER), "50 % hold", "80 % hold", "95 % hold"]
    return pipe_table(head, body)


def with_interval(found: tuple[float, float, float], digits: int) -> str:
    mean, low, high = (number(value, digits) for value in found)
    return mean if np.isnan(found[1]) else f"{mean} ({low} to {high})"


def differences(data: dict) -> str:
    """Every method less ours, paired by scene, with bootstrap intervals over scenes."""
    body = []
    for method in methods_in(data):
        if method == OURS:
            continue
        cells = [f"`{method}`"]
        for key in DIFFERENCES:
            pairs = [
                (scene_mean(data, s, method, key), scene_mean(data, s, OURS, key))
                for s in scenes_in(data)
            ]
            known = np.array([pair for pair in pairs if None not in pair], float)
            digits = max(METRICS[key].digits, 2)
            cells.append(with_interval(paired(*known.T), digits) if len(known) else "")
        body.append(cells)
    return pipe_table([f"less `{OURS}`", *(heading(key) for key in DIFFERENCES)], body)


def longer_down(head: list[str], body: list[list[str]]) -> str:
    """The table, turned so that what is more of goes down and not across."""
    table = [head, *body]
    if len(head) > len(table):
        table = [list(column) for column in zip(*table)]
    return pipe_table(table[0], table[1:])


def by_scene(data: dict) -> str:
    """Relight PSNR of every scene and method: our draws' mean, then the others' difference from it,
    with bootstrap intervals over the scene's pictures.
    """
    scenes = [scene for scene in scenes_in(data) if rows_for(data, scene, OURS)]
    mine = {scene: views_of(rows_for(data, scene, OURS), "relight") for scene in scenes}
    body = [[f"`{OURS}`", *(number(float(mine[scene].mean())) for scene in scenes)]]
    for method in methods_in(data):
        if method == OURS:
            continue
        cells = []
        for scene in scenes:
            rows = rows_for(data, scene, method)
            found = paired(views_of(rows, "relight"), mine[scene]) if rows else None
            cells.append(with_interval(found, 1) if found else "")
        body.append([f"`{method}` less that", *cells])
    return longer_down(["relight PSNR, dB", *map(title, scenes)], body)


def levels(data: dict) -> str:
    """Log of the light's mean radiance over the true one, mean over draws, per scene."""
    scenes = scenes_in(data)
    body = []
    for method in methods_in(data):
        found = [scene_mean(data, scene, method, "light_level") for scene in scenes]
        body.append([f"`{method}`", *(number(value, 2) for value in found)])
    return longer_down(["log of the light's level", *map(title, scenes)], body)


def mean_cost(rows: list[dict], part: str, key: str) -> float:
    return float(np.mean([row["cost"][part][key] for row in rows]))


def costs(data: dict) -> str:
    """Seconds, rays and memory, of the methods whose times may be compared."""
    body = []
    for method in methods_in(data):
        rows = timed(data, method)
        if not rows:
            continue
        cells = [f"`{method}`", number(mean_cost(rows, "sample", "cpu_seconds"))]
        cells.append(number(mean_cost(rows, "refine", "cpu_seconds")))
        cells.append(number(seconds(data, method) / 2))
        rays = mean_cost(rows, "sample", "rays") + mean_cost(rows, "refine", "rays")
        cells += [number(rays / 1e6, 2), number(max(row["peak_gib"] for row in rows), 2)]
        body.append([*cells, str(len(rows))])
    head = ["method", "core s: sampling", "refinement", "s on two cores, two draws at a time"]
    return pipe_table([*head, "million rays", "peak GiB", "rows"], body)


def declarations() -> str:
    """What every score is taken of."""
    body = [[m.title, m.unit, m.better, m.space, m.mask, m.scale, "none"] for m in METRICS.values()]
    return pipe_table(["score", "unit", "better", "space", "where", "scale", "rotation"], body)


def printed(data: dict) -> str:
    """All tables as text."""
    parts = [("scores", scores), ("draws together", draws), ("less ours", differences)]
    parts += [("by scene", by_scene), ("costs", costs)]
    return "\n".join(f"{title}\n\n{make(data)}" for title, make in parts)
