"""How many triangles the surface needs: as few as leave it where the photos show it.

Decimation by quadrics (`pipeline.surface.clean.Decimation`) keeps flat places with few triangles
and bent ones with many, so one number says how much detail there is. A surface is close enough if
it lies within a share of a photo's pixel of the dense one, at all but a few of the pixels that show
either: nearer than that, no photo and no mask tells them apart. Both ways, so that neither a part
that decimation lost nor one that it made goes unseen. What of shading lies between triangles is the
normal map's (`pipeline.surface.bake`).
"""

from __future__ import annotations

import numpy as np

from pipeline.geometry.cameras import View
from pipeline.geometry.mesh_io import Mesh
from pipeline.surface.clean import Decimation
from pipeline.surface.preview import caster

FEWER = 2.0**0.5  # each attempt has so many times fewer triangles
FEWEST = 1000  # triangles that are always there: what they cost is not felt
ELSEWHERE = 0.05  # share of the pixels at which the surfaces may lie further apart
PIXELS = 40_000  # that are looked at, of all photos together


class Seen:
    """A surface and the points at which the photos show it.

    points (p, 3); footprints (p,): how wide a pixel of its photo is there, across the ray.
    """

    def __init__(self, mesh: Mesh, views: list[View]):
        self.mesh = mesh
        self.scene, self.o3d = caster(mesh)
        found = [self._through(view) for view in views]
        self.points = np.concatenate([points for points, _ in found])
        self.footprints = np.concatenate([footprints for _, footprints in found])

    def _through(self, view: View) -> tuple[np.ndarray, np.ndarray]:
        origins, directions = (a.reshape(-1, 3) for a in view.rays(view.pixel_centers()))
        rays = np.concatenate([origins, directions], -1).astype(np.float32)
        far = self.scene.cast_rays(self.o3d.core.Tensor(rays))["t_hit"].numpy()
        hit = np.isfinite(far)
        points = origins[hit] + far[hit, None] * directions[hit]
        return points, view.project(points)[1] / view.fx

    def distance_to(self, other: Seen) -> np.ndarray:
        """Of each point to another surface, in pixels (p,)."""
        points = self.o3d.core.Tensor(self.points.astype(np.float32))
        return other.scene.compute_distance(points).numpy() / self.footprints


def pixels_apart(one: Seen, other: Seen, scale: float = 1.0) -> float:
    """Within how many pixels the two surfaces lie of each other at all but ELSEWHERE of the pixels
    that show them; 0 where no photo shows any. scale: of the views they were seen by.
    """
    apart = [a.distance_to(b) for a, b in ((one, other), (other, one))]
    return max((float(np.quantile(d, 1 - ELSEWHERE)) / scale for d in apart if len(d)), default=0.0)


def sparse(views: list[View], pixels: int) -> tuple[list[View], float]:
    """The views reduced to have about so many pixels together, and by which factor."""
    total = sum(float(view.width) * view.height for view in views)
    scale = min(1.0, (pixels / total) ** 0.5)
    return [view.scaled(scale) for view in views], scale


def as_few_faces(
    dense: Mesh, most: int, views: list[View], tolerance: float
) -> tuple[Mesh, Mesh, dict]:
    """The dense surface decimated to `most` triangles; the same with as few as stay within
    `tolerance` pixels of the photos `views`; and how these were chosen: `attempts` as [triangles,
    pixels apart], of which the last was too far.
    """
    surface = Decimation(dense)
    few, scale = sparse(views, 8 * PIXELS)  # an object fills about an eighth of its photos
    whole = Seen(surface.mesh(), few)
    richest = kept = surface.to(most)
    attempts = []
    trial = richest
    while tolerance:
        apart = pixels_apart(whole, Seen(trial, few), scale)
        attempts.append((len(trial.faces), apart))
        if apart > tolerance:
            break
        kept = trial
        if len(trial.faces) < FEWEST * FEWER:
            break
        trial = surface.to(int(len(trial.faces) / FEWER))
    return richest, kept, {"tolerance": tolerance, "most": most, "attempts": attempts}
