"""A name for the user whom the machine does not know."""

from __future__ import annotations

import getpass
import os


def name_the_user() -> None:
    """Give a user id that has no name, as in many containers, its number as one. Snakemake asks for
    a name as it starts, and ends with a KeyError (an OSError from Python 3.13 on) where there is
    none; a name in LOGNAME or USER is used as it is.
    """
    try:
        getpass.getuser()
    except (KeyError, OSError):
        os.environ["LOGNAME"] = str(os.getuid())
