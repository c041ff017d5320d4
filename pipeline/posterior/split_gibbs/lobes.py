"""The transport operator of the rows at every roughness: four lobes each, mixed by metallic.

The operator is linear in the light for a fixed material (render/transport.py). Its four lobes are
traced at a few roughnesses and interpolated between them. A row of a point of metallic m and base
colour a sees (a U + W) L of a light L, with

    U = (1 - m) A + m (M1 - M0)        W = (1 - m) S + m M0

from the lobes A (diffuse), S (dielectric highlight), M1 and M0 (metal at white and at black).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from pipeline.render.light_grid import lit_by
from pipeline.render.principled_lobes import blurred_roughness, lobe_albedo
from pipeline.render.transport import Transport

# roughness of the lobes that are traced
TRACED = (0.08, 0.15, 0.25, 0.35, 0.5, 0.65, 0.8, 1.0)
# steps of roughness from one of them to the next, whose lobes are interpolated
BETWEEN = 4
# share of the light that a lobe may lose by what its facets reflect twice (the BSDF leaves it out)
SWALLOWED = 0.3
# of normals that are exact
NO_SPREAD = np.zeros(1)
# dielectric; metal. Nothing lies between: viewers do not agree on what that is
METALLIC = np.array([0.0, 1.0])


def metallic_step(metallic: np.ndarray) -> np.ndarray:
    """Index (R,) of the value of METALLIC nearest to `metallic` (R,)."""
    return np.abs(metallic[:, None] - METALLIC).argmin(1)


def mix(lobes: Any, metallic: Any) -> tuple[Any, Any]:
    """U and W from the four lobes (4, ...), arrays or tensors, at a metallic that broadcasts."""
    diffuse, highlight, metal_white, metal_black = lobes
    U = (1 - metallic) * diffuse + metallic * (metal_white - metal_black)
    W = (1 - metallic) * highlight + metallic * metal_black
    return U, W


def neighbours(step: Any, traced: int) -> tuple[Any, Any, Any]:
    """The two of `traced` lobes between which a roughness step lies, and its way from the first to
    the second, in [0, 1); for one step or an array of them.
    """
    low = step // BETWEEN
    return low, np.minimum(low + 1, traced - 1), step % BETWEEN / BETWEEN


def interpolated(values: np.ndarray) -> np.ndarray:
    """Values at every roughness step (steps, ...) from those of the traced lobes (k, ...)."""
    steps = np.arange(BETWEEN * (len(values) - 1) + 1)
    low, high, way = neighbours(steps, len(values))
    way = way.astype(values.dtype).reshape((-1,) + (1,) * (values.ndim - 1))
    return (1 - way) * values[low] + way * values[high]


@dataclass(frozen=True)
class LobeTable:
    """The lobes of n rows at every roughness step.

    direct: per traced roughness the light matrices (4, n, M), float32;
    off: per traced roughness four sparse (n, q), for light that comes off the object's nodes, or
    (n, q + 3) with the ground's columns (render/transport.py);
    roughness: its value at every step. Halfway between two traced lobes the interpolated one is 2
    to 6 % from a traced one, which is the Monte-Carlo error of tracing; the nearer traced neighbour
    is 7 to 22 % off. A gloss tells how bright the light is by how broad it is: with the traced
    roughnesses alone it would be sure of a wrong brightness;
    albedo (steps, 4): of every lobe;
    most_metallic (steps,): goes down where the lobe of a white metal loses more light than it may.
    From there on it is no metal there is (Heitz et al. 2016), yet it makes a good dark wool;
    spreads (s,): what the normals about a point may spread by, per axis in radians, the likeliest
    in the middle (normal_spread.py);
    blurred (steps, s): the step of the lobe that each roughness step shows under each spread.
    """

    direct: list[torch.Tensor]
    off: list[list]
    roughness: tuple[float, ...]
    albedo: np.ndarray
    most_metallic: np.ndarray
    spreads: np.ndarray
    blurred: np.ndarray

    @classmethod
    def trace(
        cls,
        transport: Transport,
        roughness_min: float,
        seed: int,
        swallowed: float = SWALLOWED,
        spreads: np.ndarray = NO_SPREAD,
    ) -> LobeTable:
        """Trace the lobes of `transport`'s rows at every roughness of TRACED from `roughness_min`
        on; `swallowed`: share of the light that a metal's lobe may lose; `spreads`: as above.
        """
        traced = [r for r in TRACED if r >= roughness_min]
        steps = np.arange(BETWEEN * (len(traced) - 1) + 1) / BETWEEN
        log_roughness = np.interp(steps, np.arange(len(traced)), np.log(traced))
        roughness = tuple(np.exp(log_roughness).round(3).tolist())
        shown = np.log(blurred_roughness(np.array(roughness)[:, None], spreads))
        blurred = np.abs(shown[..., None] - log_roughness).argmin(-1)

        # sharper lobes than the first of these are never shown: it stands in their place
        sharpest = blurred.min() // BETWEEN
        seeds = [seed * 101 + k for k in range(sharpest, len(traced))]
        matrices = transport.at_each(traced[sharpest:], seeds)
        lobes = [(torch.from_numpy(F), G) for F, G in matrices]
        direct, off = map(list, zip(*lobes[:1] * sharpest, *lobes))

        albedo = interpolated(np.stack([lobe_albedo(r) for r in traced]))
        most_metallic = np.array(
            [METALLIC[METALLIC * (1 - white) <= swallowed].max() for _, _, white, _ in albedo]
        )
        return cls(direct, off, roughness, albedo, most_metallic, spreads, blurred)

    @property
    def usual(self) -> int:
        """Index of the likeliest spread."""
        return len(self.spreads) // 2

    def at(self, step: int, rows: slice | torch.Tensor = slice(None)) -> torch.Tensor:
        """Light matrices (4, n, M) of some rows at one roughness step."""
        low, high, way = neighbours(step, len(self.direct))
        if way == 0:
            return self.direct[low][:, rows]
        return torch.lerp(self.direct[low][:, rows], self.direct[high][:, rows], float(way))

    def apply(self, light: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """(steps, 4, n, 3): what every lobe sees of a light (M, 3) and of the exitant radiance of
        the nodes (q, 3).
        """
        traced = [
            np.stack([lit_by(light, f) + g @ nodes for f, g in zip(F.numpy(), G)])
            for F, G in zip(self.direct, self.off)
        ]
        return interpolated(np.stack(traced))
