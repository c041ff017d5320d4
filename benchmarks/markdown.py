"""How figures and tables are written on the pages."""

from __future__ import annotations

import re


def number(value: float | None, digits: int = 1) -> str:
    """A figure as the tables print it: .78 for 0.78, nothing for None."""
    if value is None:
        return ""
    text = f"{value:.{0 if value >= 100 else digits}f}"
    return re.sub(r"^(-?)0\.", r"\1.", text) if digits > 1 else text


def pipe_table(head: list[str], body: list[list[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *body]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)
