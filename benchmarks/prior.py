"""Judge a light prior against real maps: loss, Fréchet distance, memorisation, seam, yaw, peaks.

python -m benchmarks.prior --data RUN/data.npz --priors prior_small gaussian_small --samples 128 --out prior.json

RUN/data.npz is made by pipeline.prior.train (real maps with a held-out flag). Feature space of the Fréchet distance
(Heusel et al. 2017, with features anyone can recompute): of every map's log code, the mean of each opponent colour channel
in 4 latitude bands, the log power of each channel in 4 bands of longitudinal frequency, and the percentiles 1, 25, 75, 99
and 99.9 of log luminance over its median; 29 numbers, none changed by yaw or mirroring, in units of the training maps'
deviation. The floor is the distance between held-out and training maps.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
from pathlib import Path

import numpy as np
import torch
from scipy import linalg, stats

from pipeline.envmap import solid_angles
from pipeline.files import write_json
from pipeline.prior import load_prior
from pipeline.prior.gaussian import OPPONENT, GaussianPrior
from pipeline.prior.sampling import draw

SHRINK = 0.1            # of every covariance towards its diagonal: there are few real maps
LEVELS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)


def features(codes: np.ndarray) -> np.ndarray:
    """(n, 29) of codes (n, 3, h, w)."""
    x = np.einsum("oc,nchw->nohw", OPPONENT.numpy(), codes)
    n, _, h, w = x.shape
    bands = x.reshape(n, 3, 4, h // 4, w).mean((3, 4)).reshape(n, -1)
    power = np.abs(np.fft.rfft(x, axis=-1)) ** 2
    weight = solid_angles(h, w)[:, :1]
    edges = [1, 2, 4, 10, w // 2 + 1]
    spectrum = np.stack([(power[..., a:b].sum(-1) * weight[:, 0]).sum(-1) for a, b in zip(edges, edges[1:])], -1).reshape(n, -1)
    level = np.percentile(x[:, 0].reshape(n, -1), [1, 25, 50, 75, 99, 99.9], axis=1).T
    return np.concatenate([bands, np.log(spectrum + 1e-6), np.delete(level - level[:, 2:3], 2, 1)], 1)


def frechet(a: np.ndarray, b: np.ndarray) -> float:
    """Distance between normal distributions fitted to features (n, d) and (m, d)."""
    def moments(f):
        cov = np.cov(f.T)
        return f.mean(0), (1 - SHRINK) * cov + SHRINK * np.diag(np.diag(cov))
    (ma, ca), (mb, cb) = moments(a), moments(b)
    return float(((ma - mb) ** 2).sum() + np.trace(ca + cb - 2 * np.real(linalg.sqrtm(ca @ cb))))


def nearest(codes: np.ndarray, bank: np.ndarray) -> np.ndarray:
    """RMS distance (n,) of each code to the nearest of the bank over all yaws and mirrors, solid-angle weighted."""
    h, w = codes.shape[-2:]
    root = np.sqrt(solid_angles(h, w) / (4 * np.pi) / 3)
    f = lambda x: np.fft.rfft(x * root, axis=-1)
    both = np.concatenate([bank, bank[..., ::-1]])
    spectra, size, out = f(both), ((both * root) ** 2).sum((1, 2, 3)), []
    for x in codes:
        overlap = np.fft.irfft((np.conj(f(x))[None] * spectra).sum((1, 2)), n=w, axis=-1).max(-1)
        out.append(np.sqrt(max(float((size - 2 * overlap).min()) + ((x * root) ** 2).sum(), 0)))
    return np.array(out)


def seam(codes: np.ndarray) -> float:
    """Step across the wrap column over the mean step between columns."""
    step = np.abs(np.roll(codes, -1, -1) - codes).mean((0, 1, 2))
    return float(step[-1] / step[:-1].mean())


def yaw_error(prior, codes: np.ndarray) -> dict:
    """Relative RMS difference of denoise(roll(x)) and roll(denoise(x)) per shift in columns."""
    noise = torch.Generator().manual_seed(0)
    x = torch.from_numpy(codes[:4]) + torch.randn(codes[:4].shape, generator=noise)
    with torch.no_grad():
        plain = prior.denoise(x, 1.0)
        size = float(plain.std())
        return {k: float((prior.denoise(x.roll(k, -1), 1.0).roll(-k, -1) - plain).square().mean().sqrt()) / size for k in (1, 2, 4, 8)}


def peak(codes: np.ndarray, spread: float) -> np.ndarray:
    """log of the 99.9 percentile over the median of luminance-like radiance, (n,)."""
    level = np.log(np.exp(spread * codes).mean(1)).reshape(len(codes), -1)
    return np.percentile(level, 99.9, axis=1) - np.median(level, axis=1)


def samples_of(prior, count: int, steps: int) -> np.ndarray:
    """Codes (n, 3, h, w)."""
    if isinstance(prior, GaussianPrior):
        return prior.sample(count, torch.Generator().manual_seed(0)).numpy()
    lights = np.concatenate([draw(prior, min(16, count - k), steps, 100 + k) for k in range(0, count, 16)])
    return np.concatenate([prior.encode(light).numpy() for light in lights])


def judge(name: str, train: np.ndarray, held: np.ndarray, count: int, steps: int) -> dict:
    prior = load_prior(name)
    codes = samples_of(prior, count, steps)
    scale = features(train).std(0) + 1e-9
    near = nearest(codes, train)
    out = {"prior": name, "frechet": frechet(features(codes) / scale, features(train) / scale),
           "frechet_floor": frechet(features(held) / scale, features(train) / scale),
           "nearest_ratio": float(np.median(near) / np.median(nearest(held, train))), "seam": seam(codes), "seam_data": seam(train),
           "yaw_error": yaw_error(prior, train), "peak_ks": float(stats.ks_2samp(peak(codes, prior.log_spread), peak(train, prior.log_spread))[0]),
           "peak_median": float(np.median(peak(codes, prior.log_spread))), "peak_median_data": float(np.median(peak(train, prior.log_spread)))}
    losses = {}
    for which, x in (("held_out", held), ("train", train[:len(held)])):
        noise = torch.Generator().manual_seed(1)
        x, weight = torch.from_numpy(x), torch.from_numpy(solid_angles(*x.shape[-2:]).astype(np.float32).copy())
        weight = weight / weight.mean()
        with torch.no_grad():
            losses[which] = float(np.mean([((prior.denoise(x + s * torch.randn(x.shape, generator=noise), s) - x).square() * weight).mean()
                                           / (s**2 * 0.25 / (s**2 + 0.25)) for s in LEVELS]))
    return out | {"loss": losses}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--priors", nargs="+", default=["prior_small", "gaussian_small"])
    parser.add_argument("--samples", type=int, default=128)
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    data = np.load(args.data)
    codes = ((data["real"] - data["mean"]) / (2 * data["std"])).astype(np.float32)
    train, held = codes[~data["held"]], codes[data["held"]]
    rows = []
    for name in args.priors:
        rows.append(judge(name, train, held, args.samples, args.steps))
        print(json.dumps(rows[-1], indent=1), flush=True)
    if args.out:
        write_json(args.out, {"machine": f"{platform.machine()}, {os.cpu_count()} cores", "rows": rows})


if __name__ == "__main__":
    main()
