"""The prior over light, what it was made from, and whether draws under it are calibrated."""

from __future__ import annotations

from benchmarks.markdown import number, pipe_table
from benchmarks.tables.committed import results, rows_of, source

PEAK = "peak: log p99.9 / median"  # statistic of benchmarks.lights


def prior() -> str:
    """Fréchet distances and what else tells a prior's samples from maps."""
    rows = rows_of("prior")
    triple = lambda d: [number(d[k]) for k in ("all", "appearance", "structure")]
    body = []
    for row in rows:
        near, loss = row["nearest_ratio"], row.get("loss", {})
        losses = [number(loss[k], 3) for k in ("train", "held_out", "all_unseen") if k in loss]
        body.append(
            [row["prior"], *triple(row["frechet"])]
            + [", ".join(number(near[k], 2) for k in ("held_out", "unseen"))]
            + [number(row["seam"], 3), number(row["statistics"][PEAK]["ks"], 3), ", ".join(losses)]
        )
    first = rows[0]
    for name, key in (
        ("maps held out", "frechet_held_out"),
        ("unseen maps", "frechet_unseen"),
        ("one half of the training maps to the other", "frechet_halves"),
    ):
        seam = f"{number(first['seam_data'], 3)} (trained on)" if key == "frechet_held_out" else ""
        near = "" if key == "frechet_halves" else "1"
        body.append([name, *triple(first[key]), near, seam, "", ""])
    head = ["prior", "Fréchet", "appearance", "structure"]
    head += [
        "nearest to a training map, samples over held out, over unseen",
        "seam step over others",
    ]
    head += ["KS of log p99.9 / median", "loss trained on, held out, all unseen"]
    return pipe_table(head, body) + source("prior")


def prior_seconds() -> str:
    """Times of the priors that have them."""
    keys = ("forward_1", "forward_8", "sample_1", "sample_8")
    body = [
        [row["prior"]]
        + [number(row["seconds"][k], 3 if row["seconds"][k] < 1 else 1) for k in keys]
        for row in rows_of("prior")
        if "seconds" in row
    ]
    head = ["prior", "forward s, 1 map", "8 maps", "guided draw of 30 steps s, 1 map", "8 maps"]
    return pipe_table(head, body)


def lights() -> str:
    """Medians of the lights' statistics, measured and made."""
    data = results("lights")["data"]
    shown = [PEAK, "contrast: deviation of log", "energy share of the brightest 0.2 %"]
    shown += ["chroma: deviation of log R/B", "spectrum: slope over longitude"]
    shown += ["rough: mean step between columns"]
    body = [
        [label]
        + [", ".join(number(table[key][k][1], 2) for k in ("measured", "made")) for key in shown]
        for label, table in data.items()
    ]
    return pipe_table(["class", *shown], body) + source("lights")


def spread() -> str:
    """Spread of the draws and error of their mean, case by case."""
    data, body = results("spread")["data"], []
    for line in data["table"]:
        value, error = line["spread"]
        material = "white dielectric" if "Lambert" in line["kind"] else "metal"
        cells = [line["kind"].split()[0], material, f"{line['roughness']:g}", str(line["views"])]
        cells.append(number(value, 3) + (f" ± {number(error, 3)}" if error is not None else ""))
        cells += [number(line.get(k, [None])[0], 3) for k in ("spread_unseen", "error")]
        body.append(cells)
    head = ["kind", "material", "roughness", "views", "spread", "where unseen", "error of the mean"]
    alone = f"\nDraws of the prior alone ({data['prior']}): {number(data['prior_alone'], 2)}.\n"
    return pipe_table(head, body) + alone + source("spread")


def calibration() -> str:
    """How often the truth lies inside the draws' range."""
    data = results("calibration")["data"]
    body = []
    for name in ("SH", "pixels", "all"):
        group = data[name]
        cells = [number(group[k], 3) for k in ("inside", "nominal", "binomial_deviation")]
        body.append([name, *cells, number(group.get("mean_rank"), 3)])
    head = ["statistics", "inside the draws' range", "nominal"]
    head += ["binomial deviation of one statistic", "mean rank (nominal .5)"]
    return pipe_table(head, body) + source("calibration")


def calibration_p() -> str:
    """Chi-square p-value of the ranks of every statistic, least first."""
    found = sorted(results("calibration")["data"]["p_values"].items(), key=lambda item: item[1])
    text = lambda p: "below .0001" if p <= 1e-4 else number(p, 3)
    return pipe_table(["statistic", "p"], [[name, text(p)] for name, p in found])


TABLES = {
    make.__name__: make
    for make in (prior, prior_seconds, lights, spread, calibration, calibration_p)
}
