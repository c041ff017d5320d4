"""DDPM's noise schedule with T = 1000 (Ho et al. 2020, linear beta), and its EDM reading (Karras et
al. 2022).

x_t = sqrt(ab_t) x_0 + sqrt(1 - ab_t) n, ab_t = ALPHA_BAR[t]. Divided by sqrt(ab_t) that is x_0 +
sigma_t n with sigma_t = sqrt((1 - ab_t) / ab_t), so one denoiser D(x; sigma) serves both.
"""

from __future__ import annotations

import numpy as np

T = 1000
BETA = np.linspace(1e-4, 0.02, T)
ALPHA_BAR = np.cumprod(1 - BETA)


def sigma(t: int) -> float:
    """EDM noise level of DDPM step t in 0..T-1."""
    return float(np.sqrt((1 - ALPHA_BAR[t]) / ALPHA_BAR[t]))


def subsequence(steps: int) -> np.ndarray:
    """`steps` of the T levels, descending, evenly spaced, the first and the last included."""
    if not 2 <= steps <= T:
        raise ValueError(f"steps must lie in 2..{T}")
    return np.unique(np.round(np.linspace(0, T - 1, steps)).astype(int))[::-1]


def posterior(t: int, s: int) -> tuple[float, float, float]:
    """q(x_s | x_t, x_0) for s < t: coefficients of x_0 and x_t, and the standard deviation (DDPM
    Eq. 7, for a step from t to s instead of to t - 1).

    s = -1 stands for the noise-free end.
    """
    ab_t = ALPHA_BAR[t]
    ab_s = ALPHA_BAR[s] if s >= 0 else 1.0
    alpha = ab_t / ab_s

    of_clean = np.sqrt(ab_s) * (1 - alpha) / (1 - ab_t)
    of_noisy = np.sqrt(alpha) * (1 - ab_s) / (1 - ab_t)
    deviation = np.sqrt((1 - alpha) * (1 - ab_s) / (1 - ab_t))
    return float(of_clean), float(of_noisy), float(deviation)
