"""Spoilt inputs and disturbed runs."""

from __future__ import annotations

import numpy as np

from benchmarks.markdown import number, pipe_table
from benchmarks.tables.committed import rows_of, source


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


TABLES = {make.__name__: make for make in (bad_input, changed_files, faults)}
