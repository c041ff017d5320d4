"""What the photos show around the object, as light: the ground near it, and views past it.

The ground is geometry: a horizontal plane whose radiance the photos show. It hides the distant
light below it and shines itself, with the object's shadow and the light that the object throws on
it as they are. Nothing reflects off it once more, for what it gives off is measured.

Views are directions of the distant light that photos look into. Where the ground lies, the light
as seen from the object's centre is the ground's; it is held to that there, so that a light that is
exported by itself shows a floor where there was one.

What lies around as a whole has about the tint of the light (split_gibbs/light_tint.py).

Letters: t texels along the ground's side, h rows of a lat-long light, M = 2 h^2 its pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from pipeline.base.runtime import mitsuba as mi
from pipeline.render.envmap import solid_angles

SIGHT_ROWS = 64  # of the lat-long grid that views past the object are kept at


@dataclass(frozen=True)
class Ground:
    """A part of the plane y = height, seen from above, with the radiance that it gives off.

    corner (2,): least x and z; texel: side of a texel; radiance (t, t, 3) and known (t, t): rows
    along z, columns along x. Where it is not known there is no ground.
    """

    height: float
    corner: np.ndarray
    texel: float
    radiance: np.ndarray
    known: np.ndarray

    def seen(self, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Whether rays (k, 3) meet the ground (k,), and the radiance there (k, 3), 0 elsewhere.
        Rays that start below it pass it by: it has an upper side only.
        """
        down = (direction[:, 1] < -1e-6) & (origin[:, 1] > self.height)
        sine = np.where(down, direction[:, 1], -1.0)
        distance = (self.height - origin[:, 1]) / sine
        across = origin[:, [0, 2]] + distance[:, None] * direction[:, [0, 2]]
        column, row = np.floor((across - self.corner) / self.texel).T
        side = len(self.known)
        inside = down & (column >= 0) & (column < side) & (row >= 0) & (row < side)

        row, column = (np.where(inside, at, 0).astype(int) for at in (row, column))
        met = inside & self.known[row, column]
        return met, np.where(met[:, None], self.radiance[row, column], 0)

    def shape(self) -> Any:
        """The ground for the path tracer: a Mitsuba mesh that emits upwards and is black itself.

        Emitters are never sampled on it: it is large and even, and paths find it.
        """
        side = len(self.known)
        row, column = np.nonzero(self.known)
        corners = np.stack([row, row + 1, row + 1, row]), np.stack([column] * 2 + [column + 1] * 2)
        number = np.arange(4 * len(row)).reshape(4, -1)
        faces = np.concatenate([number[[0, 1, 2]], number[[0, 2, 3]]], 1).T

        share = np.stack([corners[1].ravel(), corners[0].ravel()], -1) / side
        across = self.corner + share * side * self.texel
        points = np.stack([across[:, 0], np.full(len(across), self.height), across[:, 1]], -1)

        flat = lambda values, kind: np.ascontiguousarray(values, kind).ravel()
        mesh = mi.Mesh(
            "ground", len(points), len(faces), has_vertex_texcoords=True, props=self._shining()
        )
        params = mi.traverse(mesh)
        params["vertex_positions"] = flat(points, np.float32)
        params["vertex_texcoords"] = flat(share, np.float32)
        params["faces"] = flat(faces, np.uint32)
        params.update()
        return mesh

    def _shining(self) -> Any:
        """Mitsuba properties of the ground's mesh: black, and as bright as it was seen."""
        texture = {
            "type": "bitmap",
            "raw": True,
            "filter_type": "nearest",
            "wrap_mode": "clamp",
            "data": mi.TensorXf(np.ascontiguousarray(self.radiance, np.float32)),
        }
        properties = mi.Properties()
        properties["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": 0.0})
        properties["emitter"] = mi.load_dict(
            {"type": "area", "sampling_weight": 0.0, "radiance": texture}
        )
        return properties


@dataclass(frozen=True)
class Sightings:
    """Directions of the light whose radiance is seen: a lat-long table of SIGHT_ROWS rows.

    radiance (h, 2h, 3); deviation (h, 2h): relative error of it, infinite where nothing is seen;
    clipped (h, 2h): whether it is a lower bound.
    """

    radiance: np.ndarray
    deviation: np.ndarray
    clipped: np.ndarray

    def beside(self, other: Sightings) -> Sightings:
        """These, and where these see nothing, those of `other`."""
        mine = np.isfinite(self.deviation)
        return Sightings(
            np.where(mine[..., None], self.radiance, other.radiance),
            np.where(mine, self.deviation, other.deviation),
            np.where(mine, self.clipped, other.clipped),
        )

    def pooled(self, rows: int, least: float = 0.5) -> Sightings:
        """As a table of `rows` rows, which divide these or are a multiple of them. Of larger cells
        at least the share `least` is seen; they are a lower bound where any of what is seen is.
        """
        if rows > len(self.deviation):
            f = rows // len(self.deviation)
            return Sightings(*(np.repeat(np.repeat(v, f, 0), f, 1) for v in vars(self).values()))
        seen = np.isfinite(self.deviation)
        weight = solid_angles(*seen.shape)
        share = _blocks(weight * seen, rows)
        mean = lambda values: _blocks(values * weight * seen, rows) / np.maximum(share, 1e-12)
        enough = share >= least * _blocks(weight, rows)

        radiance = np.stack([mean(channel) for channel in np.moveaxis(self.radiance, -1, 0)], -1)
        deviation = mean(np.where(seen, self.deviation, 0))
        return Sightings(
            np.where(enough[..., None], radiance, 0),
            np.where(enough, deviation, np.inf),
            enough & (_blocks(self.clipped & seen, rows) > 0),
        )


def _blocks(values: np.ndarray, rows: int) -> np.ndarray:
    """Sums over blocks of a table (h, 2h), as one of `rows` rows."""
    f = len(values) // rows
    return values.reshape(rows, f, 2 * rows, f).sum((1, 3))


@dataclass(frozen=True)
class Around:
    """All that photos show beside the object. radiance (3,): its mean over all their pixels."""

    radiance: np.ndarray


@dataclass(frozen=True)
class Surroundings:
    """What is known around the object; None for what is not known or not asked for."""

    ground: Ground | None = None
    sightings: Sightings | None = None
    around: Around | None = None

    def arrays(self) -> dict[str, Any]:
        """As arrays of observations.npz: nothing for what is None."""
        return {
            f"{part.name}_{of_part.name}": np.asarray(getattr(value, of_part.name))
            for part in fields(self)
            if (value := getattr(self, part.name)) is not None
            for of_part in fields(value)
        }

    @classmethod
    def of(cls, arrays: Any) -> Surroundings:
        """From a mapping that has what `arrays` gave."""

        def part(kind: Any, name: str) -> Any:
            if f"{name}_{fields(kind)[0].name}" not in arrays:
                return None
            values = {f.name: arrays[f"{name}_{f.name}"] for f in fields(kind)}
            return kind(**{k: v if v.ndim else v.item() for k, v in values.items()})

        kinds = {"ground": Ground, "sightings": Sightings, "around": Around}
        return cls(**{name: part(kind, name) for name, kind in kinds.items()})
