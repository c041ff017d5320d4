"""The files of an exported asset, as links of the report."""

from __future__ import annotations

import os
from pathlib import Path
from urllib.parse import quote


def asset_files(usd: Path, page: Path, samples: int) -> list[tuple[str, str, str]]:
    """(address, name, what it opens with) of the asset's files that are there. Addresses are
    relative to the page's folder, so that page and asset may move together. samples: how many the
    asset has.
    """
    several, own = samples > 1, usd.with_suffix("")
    whole = "the mean of the samples" if several else "the sample"
    found = [
        (usd, f"{whole}; every sample is a variant, of the set sample" if several else whole),
        (usd.with_suffix(".usdz"), f"{whole}, all in one file"),
    ]
    found += [(own / f"sample_{k}.usda", f"sample {k} alone") for k in range(samples) if several]
    return [(address(file, page), file.name, what) for file, what in found if file.is_file()]


def address(file: Path, page: Path) -> str:
    """Of a file, relative to the folder of a page."""
    return quote(Path(os.path.relpath(file, page.parent)).as_posix())
