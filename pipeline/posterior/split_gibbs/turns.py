"""Turns of a chain for the light: under the Gaussian prior, by decoupled annealing, by split Gibbs;
materials may be known.

`Turns` draws the light's code and the regions' mean colours; what else is unknown is drawn by
`after_light`, which a chain overrides (ours.py).
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch

from pipeline.base.config import Sample
from pipeline.base.progress import Bar
from pipeline.posterior.split_gibbs.light_codes import COMPONENTS, Coded, ModeCode, Modes, PixelCode
from pipeline.posterior.split_gibbs.light_draws import (
    SLICES,
    draw_light,
    noise_gain,
    prior_steps,
    widths,
)
from pipeline.posterior.split_gibbs.likelihood import Photos, Theta
from pipeline.prior.gaussian import GaussianPrior, translated
from pipeline.prior.sampling import lights, reverse_diffusion
from pipeline.prior.value_code import scale_of

FIRST, LAST = (
    0.15,
    0.02,
    # widths of the splitting in code units, where the prior's deviation is 0.5; above, log radiance
    # is far from linear
)
SMOOTH = 0.7  # noise level of the first smooth turn: hides all but the largest shapes


class Turns:
    """The state of one draw: photos, materials theta and log_scale of the light, coefficients (1,
    K) of the Gaussian prior's modes.
    """

    def __init__(
        self,
        photos: Photos,
        theta: Theta,
        log_scale: float,
        prior,
        gaussian: GaussianPrior,
        settings: Sample,
        rng,
        noise,
    ):
        self.photos, self.theta, self.log_scale = photos, theta, log_scale
        self.prior, self.gaussian, self.settings, self.rng, self.noise = (
            prior,
            gaussian,
            settings,
            rng,
            noise,
        )
        self.coefficients = torch.zeros(1, COMPONENTS)

    def after_light(self, coded: Coded, code: torch.Tensor, shifts=None) -> torch.Tensor:
        """The code after moves of all that is unknown beside the light and the mean colours;
        `shifts` says what it costs to move the code.
        """
        return code

    def light_turn(self, coded: Coded, about: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
        """Unknowns of the light's code drawn afresh about `about` together with the regions'
        colours; z is where to begin.
        """
        z = draw_light(
            coded,
            coded.centre(about),
            coded.join(z, self.theta),
            coded.width,
            SLICES,
            self.rng,
            self.noise,
        )
        self.theta.mu = coded.colours(z)
        self.photos.set(self.theta)
        return z[:, : coded.size]

    @cached_property
    def gaussian_modes(self) -> Modes:
        return Modes(self.gaussian, self.gaussian, COMPONENTS, self.photos.transport.h)

    def gaussian_code(self) -> ModeCode:
        """The light as modes of the Gaussian prior about its mean."""
        return ModeCode(
            self.photos, self.gaussian, self.log_scale, self.gaussian_modes, self.gaussian.flat_mean
        )

    def turns_with_gaussian(self, count: int) -> torch.Tensor:
        """Light | rest with the Gaussian prior's modes; the code (3, m) in that prior's units."""
        coded = self.gaussian_code()
        for _ in range(count):
            self.coefficients = self.light_turn(
                coded, torch.zeros(1, coded.size), self.coefficients
            )
            code = self.of_scale_one(
                self.gaussian, self.after_light(coded, coded.code(self.coefficients))
            )
            self.coefficients, coded.log_scale = coded.coefficients(code), self.log_scale
        return coded.code(self.coefficients)

    def of_scale_one(self, prior, code: torch.Tensor) -> torch.Tensor:
        """A code (3, M) for the same radiance as all maps were trained on, of scale one
        (prior/code.py); log_scale takes what was over.

        The photos move the code's mean: a scale that stood still would leave it where the network
        has never been, and be pulled back.
        """
        level = float(
            np.log(scale_of(lights(prior, code.reshape(1, 3, prior.height, prior.width))[0]))
        )
        self.log_scale += level
        return code - level / prior.log_spread

    def handed_over(self, code: torch.Tensor) -> torch.Tensor:
        """A code of the Gaussian prior (3, m) as one of the diffusion prior (3, M)."""
        g = self.gaussian
        return translated(code.reshape(1, 3, g.height, g.width), g, self.prior).reshape(3, -1)

    def smooth_turns(self, code: torch.Tensor, sigmas, bar: Bar) -> torch.Tensor:
        """Decoupled annealing (DAPS, Zhang et al. 2025): noise on the code, the network's mean
        under it, and a draw about that mean with the covariance that the Gaussian prior has under
        the same noise. Code (3, M) in and out.
        """
        prior, modes = (
            self.prior,
            Modes(self.gaussian, self.prior, COMPONENTS, self.photos.transport.h),
        )
        for sigma in map(float, sigmas):
            noisy = (code + sigma * torch.randn(code.shape, generator=self.noise)).reshape(
                1, 3, prior.height, prior.width
            )
            mean = prior.denoise(noisy, sigma, self.settings.label).reshape(3, -1)
            coded = ModeCode(self.photos, prior, self.log_scale, modes, mean, sigma)
            c = self.light_turn(coded, torch.zeros(1, coded.size), coded.coefficients(code))
            code = self.of_scale_one(prior, self.after_light(coded, coded.code(c)))
            bar.step(f"error {100 * self.photos.eta:.1f} %")
        return code

    def split_turns(self, code: torch.Tensor, rhos, bar: Bar) -> torch.Tensor:
        """Split Gibbs (split_gibbs.py): code (3, M) in, a draw of the prior side out."""
        prior, shape = self.prior, (1, 3, self.prior.height, self.prior.width)
        coded = PixelCode(self.photos, prior, self.log_scale, float(rhos[0]))
        z = code + float(rhos[0]) * torch.randn(code.shape, generator=self.noise)
        x = code
        for rho in map(float, rhos):
            coded.width, coded.gain = rho, noise_gain(prior.log_spread, rho)
            z = self.light_turn(coded, x, z)
            gap = (z - x).mean(1).numpy()
            cost = lambda d: float(
                -0.5 * z.shape[1] * ((gap + d / prior.log_spread) ** 2 - gap**2).sum() / rho**2
            )
            z = self.after_light(coded, z, cost)
            x = reverse_diffusion(
                prior,
                z.reshape(shape),
                rho,
                prior_steps(rho),
                self.settings.label,
                self.rng,
                self.noise,
            ).reshape(3, -1)
            was = self.log_scale
            x = self.of_scale_one(prior, x)
            z, coded.log_scale = z - (self.log_scale - was) / prior.log_spread, self.log_scale
            bar.step(f"error {100 * self.photos.eta:.1f} %")
        return x

    def diffusion_turns(self, code: torch.Tensor, title: str) -> torch.Tensor:
        """Smooth turns, then split ones: a code (3, M) to start from in, a draw out."""
        sigmas = np.geomspace(SMOOTH, FIRST, self.settings.smooth)
        rhos = widths(self.settings.levels, FIRST, LAST, self.settings.stay)
        with Bar(title, len(sigmas) + len(rhos)) as bar:
            return self.split_turns(self.smooth_turns(code, sigmas, bar), rhos, bar)
