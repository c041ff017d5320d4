"""Errors that a user can act on: what is wrong, where, and how to repair it."""

from __future__ import annotations

import difflib
import sys
from pathlib import Path


class InputError(Exception):
    """Something of the user's cannot be used as it is.

    what:  the fact ("mask is 640x480, its photo 960x640")
    where: the file, folder or config key it was found in
    cure:  what to do about it, in one imperative sentence
    """

    def __init__(self, what: str, where: str | Path | None = None, cure: str | None = None):
        self.what = what
        self.where = where
        self.cure = cure

        parts = [what if where is None else f"{where}: {what}"]
        if cure:
            parts.append(f"  what to do: {cure}")
        super().__init__("\n".join(parts))


def nearest(name: str, known) -> str:
    """'Did you mean ...?' for a misspelt name, or the list of what there is."""
    close = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f"did you mean '{close[0]}'?" if close else "known names: " + ", ".join(sorted(known))


def run_stage(main) -> None:
    """Run a stage's `main()`; an InputError becomes a plain message and exit status 2, nothing else
    is caught.
    """
    try:
        main()
    except InputError as error:
        print(f"\nHeliograph cannot go on.\n  {error}", file=sys.stderr)
        sys.exit(2)
