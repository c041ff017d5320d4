"""Links of the pages lead somewhere, and the files they name are there."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*.md"))]
PAGES += [ROOT / "weights" / "MODEL_CARD.md"]
LINK = re.compile(r"\]\(([^)\s]+)\)")
LINE = re.compile(r"L\d+")
HEADING = re.compile(r"^#+ (.*)$", re.MULTILINE)
NAMED = re.compile(r"`((?:[\w.-]+/)*[\w-]+\.py)`")
PLACEHOLDER = re.compile(r"(^|/)[A-Z]+\.py$")  # `stages/NAME.py`: to be written by the reader
# a page names files below these as its sections do
FOLDERS = ["", "pipeline", "pipeline/posterior", "pipeline/posterior/split_gibbs"]
FOLDERS += ["pipeline/prior", "pipeline/prior/training"]
HISTORY = {"CHANGELOG.md", "experiments.md"}  # these also name what is no more


def slugs(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    text = LINK.sub("]", page.read_text(encoding="utf-8"))
    headings = HEADING.findall(text)
    return {re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings}


def leads_somewhere(page: Path, target: str) -> bool:
    path, _, anchor = target.partition("#")
    file = (page.parent / path).resolve() if path else page
    if not file.exists():
        return False
    if file.suffix == ".py" and LINE.fullmatch(anchor):
        return int(anchor[1:]) <= len(file.read_text(encoding="utf-8").splitlines())
    return not anchor or anchor in slugs(file)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    targets = LINK.findall(page.read_text(encoding="utf-8"))
    local = [t for t in targets if not t.startswith(("http://", "https://"))]
    assert [t for t in local if not leads_somewhere(page, t)] == []


@pytest.mark.parametrize("page", [p for p in PAGES if p.name not in HISTORY], ids=lambda p: p.name)
def test_python_files_that_a_page_names_are_there(page):
    found = NAMED.findall(page.read_text(encoding="utf-8"))
    named = {name for name in found if not PLACEHOLDER.search(name)}
    assert [n for n in sorted(named) if not any((ROOT / f / n).exists() for f in FOLDERS)] == []
