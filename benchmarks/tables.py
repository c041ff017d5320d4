"""The tables of README.md and docs/ from the committed rows in benchmarks/results/, so that none is
typed by hand.

python -m benchmarks.tables
    writes all tables anew
python -m benchmarks.tables --take rows.json pairs_split_gibbs --command "python -m ..." --note ...
    keeps what a benchmark wrote first

benchmarks/results/NAME.json holds `command`, `commit`, `machine`, `note` and `data`: what the
benchmark wrote with --out, unchanged. A table stands between the lines `<!-- table: NAME -->` and
`<!-- end -->` of a page, and below it the command, machine and commit of its rows.
"""

from __future__ import annotations

import argparse
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks import (
    atlas_tables,
    ladder_tables,
    parsimony_tables,
    surfaces_tables,
    trust_tables,
)
from benchmarks.markdown import number, pipe_table
from benchmarks.stability import limits as stability
from benchmarks.study import pages as study_pages
from benchmarks.work import tables as work_tables
from pipeline.base.errors import InputError, nearest, run_stage
from pipeline.base.files import atomic_path, read_json, write_json

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
BETWEEN_MARKS = re.compile(r"(<!-- table: (\w+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)
PEAK = "peak: log p99.9 / median"  # statistic of benchmarks.lights
NOMINAL = ("50%", "80%", "95%")


def results(name: str) -> dict:
    """benchmarks/results/NAME.json."""
    return read_json(RESULTS / f"{name}.json")


def rows_of(name: str) -> list[dict]:
    """The rows of benchmarks/results/NAME.json."""
    return results(name)["data"]["rows"]


def source(name: str) -> str:
    """The line below a table: where its rows come from."""
    about = results(name)
    note = f" {about['note']}" if about["note"] else ""
    return (
        f"\n<sub>[{name}.json](../benchmarks/results/{name}.json): `{about['command']}`; "
        f"{about['machine']}; {about['commit']}.{note}</sub>\n"
    )


def nested(row: dict, *keys: str):
    """row[key][key]..., None where one is missing: a row need not have every figure."""
    for key in keys:
        row = row.get(key) if isinstance(row, dict) else None
    return row


def title(scene: str) -> str:
    """boombox__vestibule -> boombox, vestibule."""
    return scene.replace("__", ", ")


# Columns of the pairs: heading, keys in a row, digits, and how far a value is from the best one.
COLUMNS: list[tuple[str, tuple[str, ...], int, Callable[[float], float]]] = [
    ("light dB, a draw", ("light_psnr",), 1, lambda v: -v),
    ("light dB, mean of draws", ("light_psnr_of_mean",), 1, lambda v: -v),
    ("held-out dB", ("held_out_psnr",), 1, lambda v: -v),
    ("relit dB", ("relit_psnr",), 1, lambda v: -v),
    ("base colour RMS, raw", ("base_colour_rms",), 3, lambda v: v),
    ("base colour RMS, aligned", ("base_colour_rms_aligned",), 3, lambda v: v),
    ("80 % hold: SH", ("coverage", "sh", "80%"), 2, lambda v: abs(v - 0.8)),
    ("SH over its mean", ("coverage", "sh_relative", "80%"), 2, lambda v: abs(v - 0.8)),
    ("base colour of regions", ("coverage", "base_colour", "80%"), 2, lambda v: abs(v - 0.8)),
    ("relit pixels", ("coverage", "relit", "80%"), 2, lambda v: abs(v - 0.8)),
]
ERRORS = COLUMNS[:6]


def by_scene(name: str) -> dict[str, dict]:
    """Rows of a file with one row per scene."""
    return {row["scene"]: row for row in rows_of(name)}


def rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)


def mean_of(name: str, *keys: str) -> float:
    """Mean of a figure over the rows. Rows transcribed from an older page have rounded figures, and
    not all of them: their `means`, as that page had them, go before.
    """
    printed = nested(results(name)["data"], "means", *keys)
    return float(np.mean([nested(r, *keys) for r in rows_of(name)])) if printed is None else printed


def pairs() -> str:
    """Both methods on every pair; dpi_paper's figure in bold where it is the better one."""
    ours, theirs = by_scene("pairs_split_gibbs"), by_scene("pairs_dpi_paper")
    body = []
    for scene, row in ours.items():
        cells = [title(scene)]
        for _, keys, digits, distance in COLUMNS:
            a, b = (rounded(nested(r, *keys), digits) for r in (row, theirs[scene]))
            other = number(b, digits)
            better = a is not None and b is not None and distance(b) < distance(a)
            cells.append(f"{number(a, digits)} ({f'**{other}**' if better else other})")
        body.append(cells)
    mean = ["mean of the pairs"]
    for _, keys, digits, _ in COLUMNS:
        a, b = (mean_of(name, *keys) for name in ("pairs_split_gibbs", "pairs_dpi_paper"))
        mean.append(f"{number(a, digits)} ({number(b, digits)})")
    head = ["scene", *(heading for heading, *_ in COLUMNS)]
    both = source("pairs_split_gibbs") + source("pairs_dpi_paper")
    return pipe_table(head, [*body, mean]) + both


def intervals() -> str:
    """Share held by the 50, 80 and 95 % intervals, mean over the pairs."""
    names = {
        "sh": "SH coefficients of the light",
        "sh_relative": "the same over their mean",
        "base_colour": "base colour of regions",
        "relit": "relit pixels",
    }
    body = [
        [text]
        + [
            number(mean_of(f"pairs_{method}", "coverage", quantity, nominal), 2)
            for method in ("split_gibbs", "dpi_paper")
            for nominal in NOMINAL
        ]
        for quantity, text in names.items()
    ]
    head = [f"`{m}` {n[:-1]} %" for m in ("split_gibbs", "dpi_paper") for n in NOMINAL]
    return pipe_table(["share of true values inside", *head], body)


def not_better() -> str:
    """Every figure of the pairs and of garden in which dpi_paper is better than split_gibbs, or
    equal.
    """
    ours, theirs = by_scene("pairs_split_gibbs"), by_scene("pairs_dpi_paper")
    cases = [(title(s), ours[s], theirs[s]) for s in ours]
    garden = {row["method"]: row for row in rows_of("garden_draws")}
    cases.append(("garden", garden["split_gibbs"], garden["dpi_paper"]))
    body = []
    for scene, row, other in cases:
        for heading, keys, digits, distance in ERRORS:
            a, b = (rounded(nested(r, *keys), digits) for r in (row, other))
            if a is not None and b is not None and distance(b) <= distance(a):
                body.append([scene, heading, number(a, digits), number(b, digits)])
    return pipe_table(["scene", "figure", "`split_gibbs`", "`dpi_paper`"], body)


def pairs_seconds() -> str:
    """Seconds of one draw on each pair."""
    rows = rows_of("pairs_split_gibbs")
    head = [row["scene"].split("__")[0] for row in rows]
    return pipe_table(head, [[number(row["seconds"]) for row in rows]])


def pairs_all_levels() -> str:
    """dpi_paper with every noise level."""
    body = [
        [title(row["scene"])]
        + [number(nested(row, *keys), digits) for _, keys, digits, _ in COLUMNS]
        for row in rows_of("pairs_all_levels")
    ]
    return pipe_table(["scene", *(heading for heading, *_ in COLUMNS)], body) + source(
        "pairs_all_levels"
    )


def side_by_side() -> str:
    """split_gibbs against each other method on the same scene, seconds and quality."""
    rows = rows_of("side_by_side")
    ours = {row["scene"]: row for row in rows if row["method"] == "split_gibbs"}
    body = []
    for row in rows:
        if row["method"] == "split_gibbs":
            continue
        mine = ours[row["scene"]]
        method = row["method"] + (f" ({row['note']})" if "note" in row else "")
        cells = [title(row["scene"]), method, number(mine["seconds"]), number(row["seconds"], 0)]
        cells.append(number(row["seconds"] / mine["seconds"]))
        for _, (key,), digits, _ in (c for c in ERRORS if c[1] != ("light_psnr_of_mean",)):
            pair = [number(r.get(key), digits) for r in (mine, row)]
            cells.append(" \\| ".join(pair) if all(pair) else "")
        body.append(cells)
    head = "scene,other method,split_gibbs s,other s,times,light dB,held-out dB,relit dB"
    head += ",base colour raw,aligned"
    return pipe_table(head.split(","), body) + source("side_by_side")


def garden_draws() -> str:
    """Held-out views of garden by method."""
    body = [
        [
            f"`{row['method']}`",
            str(row["samples"]),
            number(row.get("seconds")),
            number(row["held_out_psnr"], 2),
            number(row.get("held_out_psnr_of_mean"), 2),
        ]
        for row in rows_of("garden_draws")
    ]
    head = ["method", "draws", "s a draw", "held-out dB, a draw", "held-out dB, mean picture"]
    return pipe_table(head, body) + source("garden_draws")


def garden_stages() -> str:
    """Seconds of every stage."""
    rows = rows_of("garden_stages")
    table = pipe_table([r["stage"] for r in rows], [[number(r["seconds"], 0) for r in rows]])
    return table + source("garden_stages")


def scenes() -> str:
    """Whole chains on scene folders."""
    stages = ("poses", "masks", "mesh", "fit", "sample", "refine")
    body = []
    for row in rows_of("scenes"):
        share = row["stereo_share"]
        mesh = row["mesh"] + (f", {number(share, 2)}" if share is not None else "")
        body.append(
            [row["scene"], row["photos"], row["masks"], mesh, number(row["held_out_psnr"])]
            + [number(row["seconds"][stage], 0) for stage in stages]
            + [number(row["sum_of_stage_seconds"], 0), number(row["peak_gib"], 2)]
        )
    head = ["scene", "photos", "masks", "mesh, stereo share", "PSNR dB"]
    head += [f"{stage} s" for stage in stages] + ["all stages s", "peak GiB"]
    return pipe_table(head, body) + source("scenes")


# Columns of the real sets: heading, keys in a row, digits.
REAL_SETS: list[tuple[str, tuple[str, ...], int]] = [
    ("unlit dB", ("unlit_psnr",), 1),
    ("lit dB", ("lit_psnr",), 1),
    ("lit over unlit dB", ("gain",), 1),
    ("charts", ("charts",), 0),
    ("utilisation", ("utilisation",), 2),
    ("mesh s", ("mesh_seconds",), 0),
    ("mesh, processor s", ("cpu_seconds", "mesh"), 0),
]
REAL_TRUTH: list[tuple[str, tuple[str, ...], int]] = [
    ("F-score at 1 %", ("truth", "f1_at_1_percent_of_size"), 3),
    ("at .5 %", ("truth", "f1_at_half_percent"), 3),
    ("Chamfer, % of the diagonal", ("truth", "chamfer_percent_of_diagonal"), 3),
    ("normals: median degrees", ("truth", "normal_error_median_degrees"), 1),
    ("mean", ("truth", "normal_error_mean_degrees"), 1),
    ("below 10 degrees", ("truth", "normal_error_below_10_degrees"), 2),
]


def real_set_rows() -> list[tuple[str, str, dict]]:
    """(set, "before" or "now", row) of every set: rows of the version before real photos were
    worked on, and of the present one, as far as it has been measured.
    """
    found = {"before": by_scene("real_sets_before")}
    if (RESULTS / "real_sets.json").exists():
        found["now"] = by_scene("real_sets")
    scenes = dict.fromkeys(scene for rows in found.values() for scene in rows)
    return [
        (scene, when, rows[scene])
        for scene in scenes
        for when, rows in found.items()
        if scene in rows
    ]


def real_set_source() -> str:
    """The lines below a table of the real sets."""
    now = source("real_sets") if (RESULTS / "real_sets.json").exists() else ""
    return source("real_sets_before") + now


def real_sets() -> str:
    """Relightable assets from real photos beside the plain textured mesh."""
    body = []
    for scene, when, row in real_set_rows():
        if "failed" in row:
            body.append([scene, when, row["failed"]] + [""] * (len(REAL_SETS) + 1))
            continue
        cells = [number(nested(row, *keys), digits) for _, keys, digits in REAL_SETS]
        for key in ("metallic_median", "roughness_median"):
            cells.append(", ".join(number(sample[key], 2) for sample in row["samples"]))
        body.append([scene, when, *cells])
    means = []
    times = list(dict.fromkeys(when for _, when, _ in real_set_rows()))
    good = [(scene, when) for scene, when, row in real_set_rows() if "failed" not in row]
    in_all = {scene for scene, _ in good if all((scene, when) in good for when in times)}
    for when in times:
        rows = [row for scene, w, row in real_set_rows() if w == when and scene in in_all]
        cells = [
            number(float(np.mean([nested(row, *k) for row in rows])), d)
            for _, k, d in REAL_SETS[:3]
        ]
        means.append([f"mean of {len(rows)}", when, *cells] + [""] * (len(REAL_SETS) - 1))
    head = ["set", "", *(heading for heading, *_ in REAL_SETS)]
    head += ["median metallic, a sample each", "median roughness"]
    return pipe_table(head, body + means) + real_set_source()


def real_sets_truth() -> str:
    """Errors of surfaces and normals of the sets whose truth is known."""
    body = []
    for scene, when, row in real_set_rows():
        if row.get("truth"):
            cells = [number(nested(row, *keys), digits) for _, keys, digits in REAL_TRUTH]
            body.append([scene, when, *cells])
    return pipe_table(["set", "", *(heading for heading, *_ in REAL_TRUTH)], body)


SURROUNDINGS = [
    ("held-out dB", "held_out_psnr", 2),
    ("held-out dB, dome alone", "alone_psnr", 2),
    ("light dB", "light_psnr", 1),
    ("sky dB", "sky_psnr", 1),
    ("relit dB", "relit_psnr", 1),
    ("radiance over truth", "radiance_over_truth", 2),
    ("ground: radii", "ground_extent", 1),
    ("background: share of sphere", "background_share_of_sphere", 3),
]


def surroundings() -> str:
    """What the photos show around the object as evidence, each part on and off."""
    body = [
        [row["scene"], row["variant"]]
        + [number(row.get(key), digits) for _, key, digits in SURROUNDINGS]
        for row in rows_of("surroundings")
    ]
    head = ["scene", "evidence", *(heading for heading, *_ in SURROUNDINGS)]
    return pipe_table(head, body) + source("surroundings")


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


def bad_input() -> str:
    """Cases of the corpus by group, before and now; without those that a machine cannot try."""
    tried_in = lambda name: [row for row in rows_of(name) if row["happened"] != "not tried"]
    now, before = tried_in("bad_input"), tried_in("bad_input_before")
    groups = list(dict.fromkeys(row["group"] for row in now))
    right = lambda rows, group: sum(r["right"] for r in rows if group in (r["group"], "all"))
    tried = lambda rows, group: sum(group in (r["group"], "all") for r in rows)
    body = [
        [
            group,
            str(tried(now, group)),
            str(right(now, group)),
            f"{right(before, group)} of {tried(before, group)}",
        ]
        for group in [*groups, "all"]
    ]
    head = ["what is spoilt", "cases", "right", "right before"]
    return pipe_table(head, body) + source("bad_input") + source("bad_input_before")


def changed_files() -> str:
    """Files changed at random, by reader (benchmarks.corpus.fuzz_readers)."""
    body = [
        [
            row["reader"],
            str(row["inputs"]),
            str(row["taken"]),
            str(row["inputs"] - row["taken"] - sum(find["times"] for find in row["finds"])),
            str(sum(find["times"] for find in row["finds"])),
            number(row["seconds"], 0),
        ]
        for row in rows_of("fuzz_readers")
    ]
    head = ["reader", "files", "taken, and right", "refused by a message", "finds", "seconds"]
    return pipe_table(head, body) + source("fuzz_readers")


def faults() -> str:
    """How often a re-run ended with the undisturbed bytes, by what had happened before it."""
    groups: dict[str, list[dict]] = {}
    for row in rows_of("faults"):
        kind = "a full disk, in each stage" if "disk full" in row["fault"] else row["fault"]
        groups.setdefault(kind, []).append(row)
    body = []
    for kind, rows in groups.items():
        tried = [row for row in rows if row["tried"]]
        seconds = number(float(np.median([row["seconds"] for row in tried])), 0) if tried else ""
        body.append([kind, str(len(tried)), str(sum(row["right"] for row in tried)), seconds])
    head = ["what happened", "tried", "right", "re-run s, median"]
    return pipe_table(head, body) + source("faults")


def parsimony() -> str:
    """What the choose stage saves and costs, over all scenes."""
    return parsimony_tables.summary(rows_of("parsimony")) + source("parsimony")


def parsimony_scenes() -> str:
    """The same for every scene."""
    return parsimony_tables.by_scene(rows_of("parsimony")) + source("parsimony")


TABLES = {
    make.__name__: make
    for make in (
        pairs,
        intervals,
        not_better,
        pairs_seconds,
        pairs_all_levels,
        side_by_side,
        garden_draws,
        garden_stages,
        scenes,
        real_sets,
        real_sets_truth,
        surroundings,
        prior,
        prior_seconds,
        lights,
        spread,
        calibration,
        calibration_p,
        bad_input,
        changed_files,
        faults,
        parsimony,
        parsimony_scenes,
    )
}


def study(make: Callable[[dict], str]) -> Callable[[], str]:
    """A table of the study on suite XS, from its committed rows."""
    return lambda: make(results("study_xs")["data"])


TABLES |= {name: study(make) for name, make in study_pages.TABLES.items()}
TABLES["study_source"] = lambda: source("study_xs")
TABLES["study_s_scores"] = lambda: study_pages.TABLES["study_scores"](results("study_s")["data"])
TABLES["study_s_by_scene"] = lambda: (
    study_pages.TABLES["study_by_scene"](results("study_s")["data"]) + source("study_s")
)


def stability_cures() -> str:
    """Points of the suite before and after what was cured."""
    found = [results(name)["data"] for name in ("stability_before", "stability_after")]
    return stability.cures(*found) + source("stability_before") + source("stability_after")


def stability_table(make: Callable[[dict], str]) -> Callable[[], str]:
    """A table of the stability suite, from its committed rows."""
    return lambda: make(results("stability")["data"]) + source("stability")


TABLES["stability_cures"] = stability_cures
TABLES["trust_summary"] = lambda: trust_tables.summary(rows_of("trust"))
TABLES["trust_wrong"] = lambda: trust_tables.wrong(rows_of("trust")) + source("trust")
TABLES |= {name: stability_table(make) for name, make in stability.TABLES.items()}
TABLES["surfaces_choice"] = lambda: surfaces_tables.choice(results("surfaces")["data"])
TABLES["surfaces"] = lambda: surfaces_tables.table(results("surfaces")["data"]) + source("surfaces")
TABLES["atlas"] = lambda: atlas_tables.table(rows_of("atlas")) + source("atlas")
TABLES["ladder"] = lambda: ladder_tables.photos(rows_of("ladder")) + source("ladder")
TABLES["ladder_truth"] = lambda: (
    ladder_tables.truths(rows_of("ladder_truth")) + source("ladder_truth")
)
TABLES["ladder_worst"] = lambda: ladder_tables.worst(rows_of("ladder_truth"))
TABLES["work_slopes"] = lambda: work_tables.slopes(results("work")["data"])
TABLES["work_figures"] = lambda: work_tables.figures(results("work")["data"]) + source("work")


def pages() -> list[Path]:
    """Pages that may hold tables."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def filled(page: Path) -> str:
    """The text of a page with every table made anew. InputError for a table that nobody makes."""

    def table(match: re.Match) -> str:
        start, name, _, end = match.groups()
        if name not in TABLES:
            raise InputError(f"there is no table '{name}'", page, nearest(name, TABLES))
        return f"{start}\n{TABLES[name]()}\n{end}"

    return BETWEEN_MARKS.sub(table, page.read_text(encoding="utf-8"))


def head_commit() -> str:
    """Short name of the commit at hand."""
    command = ["git", "rev-parse", "--short", "HEAD"]
    return subprocess.run(
        command, cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.strip()


def take(args: argparse.Namespace) -> None:
    """Keep a benchmark's output under benchmarks/results/, with what made it."""
    file, name = args.take
    if not args.command:
        raise InputError("rows without their command", file, "say --command 'python -m ...'")
    data = read_json(Path(file))
    machine = args.machine or data.get("machine")
    if not machine:
        raise InputError("rows without their machine", file, "say --machine '...'")
    about = {
        "command": args.command,
        "commit": args.commit or head_commit(),
        "machine": machine,
        "note": args.note,
    }
    write_json(RESULTS / f"{name}.json", about | {"data": data})


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--take", nargs=2, metavar=("FILE", "NAME"))
    parser.add_argument("--command", help="what made FILE")
    parser.add_argument("--commit", help="if not the one at hand")
    parser.add_argument("--machine", help="if more is to be said than FILE does")
    parser.add_argument("--note", default="")
    args = parser.parse_args()
    if args.take:
        take(args)
    for page in pages():
        text = filled(page)
        with atomic_path(page) as path:
            path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    run_stage(main)
