"""Every score by name: in which space, over which pixels, after which scaling and turning it is
taken, and which way is better.
"""

from __future__ import annotations

from dataclasses import dataclass

OBJECT = "true mask less 1.5 pixels"
SHOWN = "pixels of the held-out views that show the object"
SPHERE = "whole sphere, by solid angle"


@dataclass(frozen=True)
class Metric:
    """unit, better ("higher", "lower" or a value that is right); what it is taken of."""

    title: str
    unit: str
    better: str
    space: str
    mask: str
    scale: str = "none"
    digits: int = 1


SEEN = "sRGB in [0, 1], 67 pixels a degree"
SRGB = "sRGB in [0, 1], noise of both renders left out"
LINEAR = "linear Rec.709"
FACTOR = "the best factor per channel for a light's views"

METRICS: dict[str, Metric] = {
    "relight_psnr": Metric("relight PSNR", "dB", "higher", SRGB, OBJECT),
    "relight_psnr_channel": Metric("relight PSNR, aligned", "dB", "higher", SRGB, OBJECT, FACTOR),
    "relight_ssim": Metric("relight SSIM", "", "higher", "sRGB in [0, 1]", OBJECT, digits=3),
    "relight_flip": Metric("relight FLIP", "", "lower", SEEN, OBJECT, digits=3),
    "novel_view_psnr": Metric("novel-view PSNR", "dB", "higher", SRGB, OBJECT),
    "novel_view_ssim": Metric("novel-view SSIM", "", "higher", "sRGB in [0, 1]", OBJECT, digits=3),
    "novel_view_flip": Metric("novel-view FLIP", "", "lower", SEEN, OBJECT, digits=3),
    "albedo_mse": Metric("albedo MSE", "", "lower", LINEAR, SHOWN, digits=4),
    "albedo_mse_scalar": Metric(
        "albedo MSE, one factor", "", "lower", LINEAR, SHOWN, "one factor", 4
    ),
    "albedo_mse_channel": Metric(
        "albedo MSE, a factor per channel", "", "lower", LINEAR, SHOWN, "one factor per channel", 4
    ),
    "roughness_mse": Metric("roughness MSE", "", "lower", "[0, 1]", SHOWN, digits=4),
    "metallic_mse": Metric("metallic MSE", "", "lower", "[0, 1]", SHOWN, digits=4),
    "light_psnr_log": Metric(
        "light PSNR, log", "dB", "higher", "log radiance over a range of e^6", SPHERE, "one factor"
    ),
    "light_psnr_tone_mapped": Metric(
        "light PSNR, tone-mapped", "dB", "higher", "L / (1 + L)", SPHERE, "mean radiance 1"
    ),
    "light_ssim": Metric(
        "light SSIM", "", "higher", "L / (1 + L)", SPHERE, "mean radiance 1", digits=3
    ),
    "sun_degrees": Metric(
        "sun or peak direction", "degrees", "lower", "flux around the peak", "15 degrees around it"
    ),
    "light_level": Metric("log of the light's level", "", "0", "mean radiance", SPHERE, digits=2),
    "relight_psnr_of_mean": Metric("relight PSNR of the draws' mean", "dB", "higher", SRGB, OBJECT),
    "crps_relight": Metric("CRPS, relit pixels", "", "lower", "sRGB in [0, 1]", OBJECT, digits=4),
    "crps_albedo": Metric("CRPS, albedo", "", "lower", LINEAR, SHOWN, digits=4),
    "variance_albedo": Metric("variance of albedo", "", "none", LINEAR, SHOWN, digits=5),
    "variance_light": Metric(
        "variance of the light", "", "none", "log radiance", SPHERE, "log mean 0", 3
    ),
}
