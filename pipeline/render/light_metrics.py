"""Errors of a light against the true one, both lat-long (h, 2h, 3) of one size and frame.

Every error has its space, its scale rule and its weighting in its docstring; no light is turned
before it is compared, because the cameras fix the frame.
"""

from __future__ import annotations

import numpy as np
from skimage.metrics import structural_similarity

from pipeline.base.images import luminance
from pipeline.render.envmap import directions, mean_radiance, solid_angles
from pipeline.render.metrics import light_psnr

PEAK_WIDTH = np.radians(6.0)  # of the Gaussian that finds a light's peak
PEAK_RADIUS = np.radians(15.0)  # around it, whose mean direction is the sun's
SHIFTS = 8


def tone_mapped(light: np.ndarray) -> np.ndarray:
    """L / (1 + L) in [0, 1), L the radiance over its solid-angle mean (Reinhard et al. 2002)."""
    relative = np.maximum(light, 0) / max(float(mean_radiance(light).mean()), 1e-12)
    return relative / (1 + relative)


def light_psnr_tone_mapped(light: np.ndarray, truth: np.ndarray) -> float:
    """PSNR in dB as `tone_mapped` values, solid-angle weighted: each is scaled by its own mean
    radiance, one factor for all channels.
    """
    weight = solid_angles(*light.shape[:2])[..., None] / (12 * np.pi)
    error = ((tone_mapped(light) - tone_mapped(truth)) ** 2 * weight).sum()
    return float(-10 * np.log10(max(error, 1e-10)))


def light_ssim(light: np.ndarray, truth: np.ndarray) -> float:
    """SSIM (Wang et al. 2004) of `tone_mapped` values, mean over pixels weighted by solid angle;
    wraps around in longitude.
    """
    pad = 11  # the window's size
    around = lambda env: np.concatenate([env[:, -pad:], env, env[:, :pad]], 1)
    pictures = (around(tone_mapped(env)) for env in (light, truth))
    shown = ssim_map(*pictures)[:, pad:-pad]
    return float((shown * solid_angles(*light.shape[:2])).sum() / (4 * np.pi))


def ssim_map(picture: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """SSIM (h, w) of two pictures (h, w, 3) in [0, 1], mean of the channels: Gaussian window of
    deviation 1.5, as Wang et al. 2004 have it.
    """
    _, full = structural_similarity(
        picture,
        truth,
        data_range=1.0,
        channel_axis=-1,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
        full=True,
    )
    return full.mean(-1)


def peak_direction(light: np.ndarray) -> np.ndarray:
    """Unit vector (3,) to the brightest part: the mean direction of the flux within PEAK_RADIUS of
    itself (mean shift), sought from where luminance, blurred by PEAK_WIDTH, is largest.
    """
    h, w = light.shape[:2]
    d = directions(h, w).reshape(-1, 3)
    flux = luminance(light).reshape(-1) * solid_angles(h, w).reshape(-1)
    blurred = np.exp((d @ d.T - 1) / PEAK_WIDTH**2) @ flux

    centre = d[blurred.argmax()]
    for _ in range(SHIFTS):  # so that the pixel at which it starts does not count
        near = d @ centre > np.cos(PEAK_RADIUS)
        centre = (flux[near, None] * d[near]).sum(0)
        centre = centre / np.linalg.norm(centre)
    return centre


def sun_direction_error(light: np.ndarray, truth: np.ndarray) -> float:
    """Angle in degrees between the `peak_direction`s of two lights: of the sun outdoors, else of
    the window or lamp that brings most light.
    """
    cosine = peak_direction(light) @ peak_direction(truth)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def light_errors(light: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """All of these by name. level: log of the mean radiance over the true one."""
    level = np.log(mean_radiance(light).mean() / mean_radiance(truth).mean())
    return {
        "light_psnr_log": light_psnr(light, truth),
        "light_psnr_tone_mapped": light_psnr_tone_mapped(light, truth),
        "light_ssim": light_ssim(light, truth),
        "sun_degrees": sun_direction_error(light, truth),
        "light_level": float(level),
    }
