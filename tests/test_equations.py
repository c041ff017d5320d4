"""docs/equations.md leads to the code: every row names a function, its line and its tag; no
implemented equation is missing.

`python -m tests.test_equations --write` brings the line numbers up to date.
"""

import ast
import re
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "docs" / "equations.md"
ROW = re.compile(
    r"^\| (?P<tag>[^|]+?) \| [^|]+ \| `(?P<function>[\w.]+)` "
    r"\| \[`(?P<path>[\w./-]+):(?P<line>\d+)`\]\(\.\./(?P=path)#L(?P=line)\) \|",
    re.MULTILINE,
)
TAGS = re.compile(r"\bEqs?\. \d+(?:(?:, | and |, and )\d+)*")


@dataclass(frozen=True)
class Row:
    """One row of the table: `tag` (Eq. 13, Step 2) is implemented by `function` at path:line."""

    tag: str
    function: str
    path: str
    line: int


def rows() -> list[Row]:
    """All rows of all tables in docs/equations.md; lines that look like one but are not, fail."""
    text = TABLE.read_text(encoding="utf-8")
    found = [Row(m["tag"], m["function"], m["path"], int(m["line"])) for m in ROW.finditer(text)]
    assert len(found) == len(re.findall(r"^\| (?!tag \||---)", text, re.MULTILINE))
    return found


def definitions(file: Path) -> dict[str, ast.AST]:
    """Functions and classes of a file by qualified name: `fit`, `Chain`, `Chain.run`."""
    found = {}

    def visit(node, prefix=""):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.ClassDef):
                found[prefix + child.name] = child
                visit(child, prefix + child.name + ".")

    visit(ast.parse(file.read_text(encoding="utf-8")))
    return found


def tags_in(text: str) -> set[str]:
    """Equation tags of a text; "Eqs. 15, 16 and 17" are three."""
    numbers = (number for tag in TAGS.findall(text) for number in re.findall(r"\d+", tag))
    return {f"Eq. {number}" for number in numbers}


def posterior_files() -> list[Path]:
    return sorted((ROOT / "pipeline" / "posterior").rglob("*.py"))


def cells(row: Row) -> str:
    """The two cells that name a row's function and lead to it."""
    link = f"[`{row.path}:{row.line}`](../{row.path}#L{row.line})"
    return f"`{row.function}` | {link} |"


def write_lines() -> None:
    """Put each function's current line into the table; a row whose function is gone is an error."""
    text = TABLE.read_text(encoding="utf-8")
    for row in rows():
        line = definitions(ROOT / row.path)[row.function].lineno
        text = text.replace(cells(row), cells(replace(row, line=line)))
    TABLE.write_text(text, encoding="utf-8")


@pytest.mark.parametrize("row", rows(), ids=lambda row: f"{row.tag} {row.function}")
def test_row_leads_to_its_function(row):
    node = definitions(ROOT / row.path).get(row.function)
    assert node is not None, f"no {row.function} in {row.path}"
    assert node.lineno == row.line, "run python -m tests.test_equations --write"
    words = " ".join((ast.get_docstring(node) or "").split())
    assert re.search(rf"\b{re.escape(row.tag)}\b", words), f"{row.function} does not say {row.tag}"


def test_every_tag_in_posterior_is_in_the_table():
    listed = {row.tag for row in rows()}
    for file in posterior_files():
        unknown = tags_in(file.read_text(encoding="utf-8")) - listed
        assert not unknown, f"{file.relative_to(ROOT)}: {sorted(unknown)}"


def test_every_written_out_equation_has_its_row():
    """A docstring that gives an equation as published ("Eq. 13 (published):") is in the table."""
    written = {
        (tag, name, str(file.relative_to(ROOT)))
        for file in posterior_files()
        for name, node in definitions(file).items()
        for tag in re.findall(r"(Eq\. \d+) \(published\)", ast.get_docstring(node) or "")
    }
    assert len(written) >= 6
    assert written <= {(row.tag, row.function, row.path) for row in rows()}


def test_plural_tags_are_read():
    assert tags_in("Eqs. 15, 16 and 17; see Eq. 7.") == {"Eq. 7", "Eq. 15", "Eq. 16", "Eq. 17"}


if __name__ == "__main__":
    if sys.argv[1:] != ["--write"]:
        sys.exit("usage: python -m tests.test_equations --write")
    write_lines()
