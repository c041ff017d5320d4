"""When masks' edges pull at a fused surface: those of given masks, once it was taken."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.base.config import Mesh as MeshSettings
from pipeline.surface import fusion
from pipeline.surface.photometric import Refined
from pipeline.surface.prediction import Gain
from pipeline.surface.silhouettes import silhouettes_of
from tests.surface.test_surface import sphere

sphere = sphere  # the fixture: a rig around a sphere, and its masks

GOOD = Gain(share=0.5, standard_error=0.01, photos=14, empty=0.0)
NO_BETTER = Gain(share=0.01, standard_error=0.01, photos=14, empty=0.0)


@pytest.mark.parametrize(
    "found, given, pulls",
    [
        (GOOD, True, [False, True]),
        (GOOD, False, [False]),
        (NO_BETTER, True, [False]),
        (replace(GOOD, empty=0.2), True, [False]),
    ],
)
def test_outlines_pull_once_a_surface_with_given_masks_was_taken(
    sphere, monkeypatch, found, given, pulls
):
    """The photos' part is left out: depth is the hull's, refinement moves nothing and notes whether
    masks pull, and the gain is said.
    """
    rig, masks = sphere
    seen = silhouettes_of(rig, masks, [v.name for v in rig.views], given)
    called = []

    def noted(mesh, views, images, near, settings, masks, threads):
        called.append(masks is not None)
        return Refined(mesh, np.ones(len(mesh.vertices)), {})

    monkeypatch.setattr(fusion, "refine_mesh", noted)
    monkeypatch.setattr(fusion, "_depths", lambda *_: ([None], 1.0))
    nothing = lambda field: np.zeros_like(field)
    fused = lambda grid, strict, *_: fusion.Fused(strict, nothing(strict), nothing(strict))
    monkeypatch.setattr(fusion, "fuse", fused)
    monkeypatch.setattr(fusion, "gain", lambda *_: found)

    images = [np.zeros((96, 96), np.float32)] * len(rig.views)
    _, _, facts = fusion.build_surface(seen, images, MeshSettings(grid=48), 1)
    assert called == pulls
    assert facts["method"] == ("fused" if found == GOOD else "hull")
    assert ("outlines" in facts) == (len(pulls) == 2)


@pytest.mark.parametrize("wrong, saved, stands_in", [(0.1, 0.0, 1), (0.1, 0.5, 0), (0.01, 0.0, 0)])
def test_the_hull_stands_in_where_depth_is_doubtful_and_saves_little(
    sphere, monkeypatch, wrong, saved, stands_in
):
    """Depth carves half a truncation distance off the ball, all over."""
    rig, masks = sphere
    seen = silhouettes_of(rig, masks, [v.name for v in rig.views], True)
    grid = seen.grid(48)
    hull = fusion.to_mesh(seen.hull(grid, 0), grid, seen.covered)
    many = np.full(grid.shape, 1e3, np.float32)
    carved = lambda grid, strict, *_: fusion.Fused(strict - 0.5, many, 0 * many)
    monkeypatch.setattr(fusion, "fuse", carved)
    monkeypatch.setattr(fusion, "carved_solids", lambda field, *_: np.zeros(field.shape, bool))
    monkeypatch.setattr(fusion, "without_seen_through", lambda depths, *_: (depths, wrong))
    monkeypatch.setattr(
        fusion, "gain_around", lambda *_: lambda points: np.full(len(points), saved)
    )

    found, facts = fusion.fuse_what_masks_allow(grid, seen, [None] * 12, hull, [], 1)
    away = [np.linalg.norm(mesh.vertices - rig.center, axis=1).mean() for mesh in (hull, found)]
    lost = (away[0] - away[1]) / grid.cell
    assert lost < 0.7 if stands_in else lost > 1.3
    assert facts.get("earned", 1.0) == 1 - stands_in
    assert ("earned" in facts) == (wrong == 0.1)
