"""Step 1 of split_gibbs: what a draw is made from, and the state it begins with.

Rows of the photos over the surface, regions of like colour, the operator at every roughness, how
much each point counts. What the model cannot say errs alike over whole parts of the surface, so
every draw takes points, a grouping into regions, and weights of its own: a loss-likelihood
bootstrap (Newton and Raftery 1994; Lyddon, Holmes and Walker 2019) of half strength.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from scipy.spatial import cKDTree

from pipeline.base.config import Sample
from pipeline.posterior.problem import Problem
from pipeline.posterior.random_numbers import generators
from pipeline.posterior.split_gibbs.coherence import Neighbours
from pipeline.posterior.split_gibbs.light_codes import COMPONENTS, Decoder, Modes, ModeUnknowns
from pipeline.posterior.split_gibbs.light_tint import drawn_tint
from pipeline.posterior.split_gibbs.likelihood import Mixer
from pipeline.posterior.split_gibbs.lobes import LobeTable
from pipeline.posterior.split_gibbs.normal_spread import spreads_about
from pipeline.posterior.split_gibbs.regions import features, group, texel_regions
from pipeline.posterior.split_gibbs.row_model import RowData
from pipeline.posterior.split_gibbs.state import Noise, Randomness, RegionMaterials, State
from pipeline.posterior.textures import gather
from pipeline.prior.gaussian import GaussianPrior
from pipeline.prior.load import load_gaussian
from pipeline.prior.protocol import Prior
from pipeline.prior.value_code import scale_of
from pipeline.render.renderer import Explanation
from pipeline.render.rows import Rows, choose_rows
from pipeline.render.transport import Transport
from pipeline.surface.normal_error import per_axis

# pieces of surface that err together; shape of their gamma weights: half the variance of a full
# bootstrap, for the draws' own spread adds to it
BLOCKS, SHAPE = 12, 2.0
# share of the spread of colours that regions explain, drawn afresh: nobody knows how many materials
# there are, nor where one ends
EXPLAINED = 0.6, 0.97
# radiosity nodes beside the points, as a share of their number
NODES = 0.5
# one of so many photos is kept to judge starts by
PHOTOS_PER_ASKED = 4
# noise and step sizes that a chain begins with
FIRST_ERROR, FIRST_STEP, FIRST_SPREAD = 0.3, 0.05, 0.3


@dataclass(frozen=True)
class Model:
    """What stays the same in a draw.

    data: the rows; mixer: their lobes at any materials; prior: of light, the network's; gaussian:
    the Gaussian prior of the start; log_scale_centre: mean of the log light scale's prior; tint
    (2,): of the light's mean radiance, None where it is free; view (n,) and uv (n, 2) of every row;
    region_map (t, t): region of every texel.
    """

    data: RowData
    mixer: Mixer
    prior: Prior
    gaussian: GaussianPrior
    settings: Sample
    log_scale_centre: float
    tint: np.ndarray | None
    view: np.ndarray
    uv: np.ndarray
    region_map: np.ndarray

    def decoder(self, prior: Prior, gain: float = 1.0) -> Decoder:
        """From codes of `prior` to what the operator acts on."""
        return Decoder.onto(prior, self.data.light_rows, gain)

    def without_some_photos(self, rng: np.random.Generator) -> Model:
        """The same, in which the rows of some photos do not count; with few photos all do."""
        photos = np.unique(self.view)
        asked = rng.permutation(photos)[: len(photos) // PHOTOS_PER_ASKED]
        data = replace(self.data, told=~np.isin(self.view, asked))
        return replace(self, data=data, mixer=Mixer(data))

    def modes(self, prior: Prior) -> Modes:
        """Modes of the Gaussian prior in codes of `prior`."""
        return Modes(self.gaussian, prior, COMPONENTS, self.data.light_rows)

    @cached_property
    def gaussian_unknowns(self) -> ModeUnknowns:
        """The light as modes of the Gaussian prior about its mean."""
        return ModeUnknowns.seen(self.modes(self.gaussian), self.gaussian.flat_mean)


def start_materials(
    fit: Explanation, uv: np.ndarray, region: np.ndarray, lobes: LobeTable
) -> RegionMaterials:
    """Region medians of the fit's maps at the points uv (p, 2), each of the nearer kind; none is
    more metallic than its roughness can be.
    """

    def medians(name: str) -> np.ndarray:
        values = gather(np.ascontiguousarray(getattr(fit, name)), uv).reshape(len(uv), -1)
        return np.stack([np.median(values[region == r], axis=0) for r in range(region.max() + 1)])

    color = np.clip(medians("base_color"), 0.02, 0.95)
    distance = np.abs(np.array(lobes.roughness) - medians("roughness"))
    roughness = distance.argmin(1)
    metallic = medians("metallic")[:, 0].round()
    return RegionMaterials(
        color=color,
        spread=np.full(len(color), FIRST_SPREAD),
        roughness=roughness,
        metallic=np.minimum(metallic, lobes.most_metallic[roughness]),
    )


def block_weights(position: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """How much each point (p, 3) counts in this draw, mean 1: the same within a block of surface,
    gamma between blocks.
    """
    centres = rng.choice(len(position), min(BLOCKS, len(position)), replace=False)
    block = cKDTree(position[centres]).query(position)[1]
    weight = rng.gamma(SHAPE, size=block.max() + 1)[block]
    return weight / weight.mean()


def operator(
    problem: Problem, rows: Rows, settings: Sample, seed: int
) -> tuple[Transport, LobeTable]:
    """T for these rows, and its lobes at every roughness, shown by normals as uncertain as the
    mesh's are.
    """
    error = per_axis(problem.normal_error)
    transport = Transport(
        problem.renderer.scene,
        problem.renderer.mesh,
        problem.observations,
        rows,
        settings.light,
        round(NODES * len(rows.starts)),
        seed,
        error,
        problem.renderer.ground,
    )
    spreads = spreads_about(error)
    return transport, LobeTable.trace(transport, problem.roughness_min, seed, spreads=spreads)


def row_data(
    rng: Randomness,
    problem: Problem,
    transport: Transport,
    lobes: LobeTable,
    region: np.ndarray,
    color: np.ndarray,
) -> RowData:
    """The rows of `transport` as the photos show them, with this draw's weights of points; color
    (p, 3): of the points in the fit.
    """
    rows, observations = transport.rows, problem.observations
    patch = rows.patch
    bounces = problem.renderer.max_depth - 1
    plain = RowData.plain(transport, lobes, patch @ observations.rgb, region, bounces)
    position = transport.position[rows.starts]
    return replace(
        plain,
        clipped=patch @ observations.clipped > 0,
        point_weight=block_weights(position, rng.numpy),
        neighbours=Neighbours.of(position, features(color), region),
        sightings=observations.surroundings.sightings,
    )


def set_up(
    problem: Problem, prior: Prior, fit: Explanation, settings: Sample, seed: int
) -> tuple[Randomness, Model, State]:
    """Step 1: random numbers, model and first state of draw `seed`; `fit` is the point estimate."""
    rng = Randomness(*generators(seed))
    observations, scene = problem.observations, problem.renderer.scene
    own = 1000 * seed

    rows = choose_rows(observations, scene, settings.points, settings.views, own)
    uv = observations.uv[rows.observation]
    uv_points = uv[rows.starts]

    explained = rng.numpy.uniform(*EXPLAINED)
    color = gather(fit.base_color, uv_points)
    region, centers = group(color, explained, int(rng.numpy.integers(2**31)))
    transport, lobes = operator(problem, rows, settings, own)
    data = row_data(rng, problem, transport, lobes, region, color)

    model = Model(
        data=data,
        mixer=Mixer(data),
        prior=prior,
        gaussian=load_gaussian(settings.start_prior),
        settings=settings,
        log_scale_centre=float(np.log(scale_of(fit.light))),
        tint=drawn_tint(observations.surroundings.around, rng.numpy),
        view=observations.view[rows.observation],
        uv=uv,
        region_map=texel_regions(fit.base_color, centers, settings.texture),
    )
    return rng, model, first_state(model, start_materials(fit, uv_points, region, lobes))


def first_state(model: Model, materials: RegionMaterials) -> State:
    """Plain noise, no offsets, normals that spread as is usual, the Gaussian prior's mean light."""
    regions = len(materials)
    offsets = np.zeros((3, len(model.data.region)), int)
    offsets[2] = model.data.lobes.usual
    return State(
        code=model.gaussian.flat_mean,
        log_scale=model.log_scale_centre,
        materials=materials,
        offsets=offsets,
        noise=Noise(FIRST_ERROR, np.ones(len(model.data.observed))),
        color_step=np.full(regions, FIRST_STEP),
        spread_step=np.full(regions, FIRST_STEP),
        coefficients=torch.zeros(1, COMPONENTS),
    )
