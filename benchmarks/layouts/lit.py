"""Held-out views again under a set's other lights, of which the set has names and --lights maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from benchmarks.layouts.content import Options, Relit, Shot, chosen_names
from benchmarks.layouts.maps import blender_light, map_file
from pipeline.base.errors import InputError


def under_maps(
    names: list[str],
    test: list[Shot],
    picture: Callable[[Shot, str], Path],
    where: Path,
    options: Options,
) -> tuple[list[Relit], list[str]]:
    """Views under those of `names`, the other lights found in the folder `where`, that are chosen
    and have a map; and a note about those that have none. picture: a held-out view's in a light.
    Raises InputError for a light that --relights names and that the set, or --lights, lacks.
    """
    found = []
    lacking = []
    for name in chosen_names(names, options, where):
        file = map_file(name, options)
        if file is not None:
            lit = [replace(shot, photo=picture(shot, name)) for shot in test]
            found.append(Relit(name, blender_light(file, 1.0, options.light_rows), lit))
        elif options.relights is not None:
            raise InputError(
                f"there is no map of the light '{name}'",
                options.lights or "--lights",
                f"give the folder that holds {name}.hdr or {name}.exr with --lights",
            )
        else:
            lacking.append(name)

    if not lacking:
        return found, []
    said = f"views under {', '.join(lacking)} are left out: their maps are not there"
    return found, [f"{said}; give the folder that holds <name>.hdr with --lights"]
