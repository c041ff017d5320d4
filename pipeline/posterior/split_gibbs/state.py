"""The state of a chain, frozen, and what a kernel is.

A kernel is a function `kernel(rng, state) -> state, info`, as in blackjax: it leaves the posterior
of what it draws, given all else, as it is. Nothing in a state is ever changed in place, so keeping
a state is keeping a reference, and going back to one is using it again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
import torch


class Randomness(NamedTuple):
    """The random numbers of one draw: numpy's for materials and choices, torch's for lights."""

    numpy: np.random.Generator
    torch: torch.Generator


@dataclass(frozen=True)
class RegionMaterials:
    """What the R regions of the surface are made of.

    color (R, 3): mean base colour mu of a region's points, linear Rec.709;
    spread (R,): their deviation tau about it, relative to it;
    roughness (R,): index into `LobeTable.roughness`;
    metallic (R,): in [0, 1], a value of `lobes.METALLIC`.
    """

    color: np.ndarray
    spread: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray

    def __len__(self) -> int:
        return len(self.metallic)

    @classmethod
    def joined(cls, parts: list[RegionMaterials]) -> RegionMaterials:
        """The regions of all parts, one after the other."""
        columns = ([getattr(part, f.name) for part in parts] for f in fields(cls))
        return cls(*(np.concatenate(column) for column in columns))

    def of(self, regions: list[int]) -> RegionMaterials:
        """Some of the regions."""
        return RegionMaterials(*(getattr(self, f.name)[regions] for f in fields(self)))

    def made_of(self, roughness: int, metallic: float) -> RegionMaterials:
        """The same colours in another material."""
        return replace(
            self,
            roughness=np.full_like(self.roughness, roughness),
            metallic=np.full_like(self.metallic, metallic),
        )

    def where(self, chosen: np.ndarray, other: RegionMaterials) -> RegionMaterials:
        """These regions where `chosen` (R,) holds, those of `other` elsewhere."""

        def mixed(mine: np.ndarray, theirs: np.ndarray) -> np.ndarray:
            return np.where(chosen.reshape((-1,) + (1,) * (mine.ndim - 1)), mine, theirs)

        pairs = ((getattr(self, f.name), getattr(other, f.name)) for f in fields(self))
        return RegionMaterials(*(mixed(mine, theirs) for mine, theirs in pairs))


@dataclass(frozen=True)
class Noise:
    """Errors of the n rows: Student's t as a scale mixture of normals.

    scale: eta, the relative error; weight (n,): lambda, the precision of every row about it;
    design_effect: kappa, how many rows stand for one independent row.
    """

    scale: float
    weight: np.ndarray
    design_effect: float = 1.0


@dataclass(frozen=True)
class State:
    """All unknowns of a chain.

    code (3, M): the light's code under which the photos are explained (z of the split sweeps);
    log_scale: log of the factor between the decoded light and the scene's radiance;
    materials, offsets (3, p): the regions' materials; how every point lies off its region's, steps
    of roughness and whether its metallic is the other kind's (coherence.py); and the index
    into `LobeTable.spreads` of what its normals spread by;
    noise: the rows' errors;
    color_step, spread_step (R,): step sizes of the materials' proposals, which adapt;
    coefficients (1, K): the code as modes of the Gaussian prior, during the start only;
    prior_code (3, M): the code's twin under the prior (x), during the split sweeps only.
    """

    code: torch.Tensor
    log_scale: float
    materials: RegionMaterials
    offsets: np.ndarray
    noise: Noise
    color_step: np.ndarray
    spread_step: np.ndarray
    coefficients: torch.Tensor | None = None
    prior_code: torch.Tensor | None = None

    @property
    def modes(self) -> torch.Tensor:
        """`coefficients`, which must be there. Raises ValueError after the start."""
        if self.coefficients is None:
            raise ValueError("the light is no longer in modes of the Gaussian prior")
        return self.coefficients

    @property
    def twin(self) -> torch.Tensor:
        """`prior_code`, which must be there. Raises ValueError before `light_moves.split`."""
        if self.prior_code is None:
            raise ValueError("the light's code is not split yet")
        return self.prior_code


Kernel = Callable[[Randomness, State], tuple[State, Any]]


def run(rng: Randomness, state: State, *kernels: Kernel) -> State:
    """The state after each kernel in turn."""
    for kernel in kernels:
        state, _ = kernel(rng, state)
    return state
