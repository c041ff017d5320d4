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
