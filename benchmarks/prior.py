"""Judge light priors against measured maps: Fréchet distance, memorisation, seam, yaw, histograms,
losses, times; sample sheets.

python -m benchmarks.prior --data RUN/data.npz --priors prior_base gaussian_base \\
    --reni reni.npz --out prior.json --sheets FOLDER

With `--others MAPS --catalogue CSV --licence "not stated"` there are more maps that no prior was
trained on. RUN/data.npz is made by pipeline.prior.training.train, reni.npz by benchmarks.reni.

The Fréchet distance (Heusel et al. 2017) is between features that anyone can recompute, of every
map's log code:

  appearance, 29 numbers: the mean of each opponent colour channel in 4 latitude bands, the log
    power of each channel in 4 bands of longitudinal frequency, and the percentiles 1, 25, 75, 99
    and 99.9 of log luminance over its median;
  structure, 30 numbers: of log luminance's differences d across and down at 4 scales, their mean
    size, their sparseness E d^2 / (E |d|)^2 (Huang and Mumford 1999), the skewness of those down,
    and the correlations of sizes between the two directions and between neighbouring scales
    (Portilla and Simoncelli 2000).

No feature changes with yaw; each is in units of the training maps' deviation. The distance between
maps held out and maps trained on is the floor that a prior cannot be expected to beat; `halves`,
the distance between two halves of the training maps, shows how much of it is the small number of
maps.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from scipy import linalg, stats
from scipy.ndimage import uniform_filter

from benchmarks.lights import statistics
from pipeline.base.files import write_json
from pipeline.base.images import write_png
from pipeline.base.progress import progress
from pipeline.base.runtime import set_threads
from pipeline.prior.gaussian import OPPONENT, GaussianPrior
from pipeline.prior.load import load_prior
from pipeline.prior.sampling import draw, lights, sheet
from pipeline.prior.training.data import Data, scale_free
from pipeline.prior.training.settings import Training
from pipeline.prior.training.sources import find_sources, read_source
from pipeline.prior.training.train import fixed_loss, row_weights
from pipeline.prior.value_code import to_log
from pipeline.prior.weight_facts import LABELS
from pipeline.render.envmap import resample_area, solid_angles

APPEARANCE = 29  # features of the first kind
SHRINK = 0.1  # of every covariance towards its diagonal: there are few measured maps


def appearance(x: np.ndarray) -> np.ndarray:
    """(n, 29) of opponent log codes (n, 3, h, w): how bright, coloured and busy a map is."""
    n, _, h, w = x.shape
    bands = x.reshape(n, 3, 4, h // 4, w).mean((3, 4)).reshape(n, -1)
    power = np.abs(np.fft.rfft(x, axis=-1)) ** 2
    weight = solid_angles(h, w)[:, :1]
    edges = [1, 2, 4, 10, w // 2 + 1]
    spectrum = [(power[..., a:b].sum(-1) * weight[:, 0]).sum(-1) for a, b in zip(edges, edges[1:])]
    spectrum = np.stack(spectrum, -1).reshape(n, -1)

    percentiles = np.percentile(x[:, 0].reshape(n, -1), [1, 25, 50, 75, 99, 99.9], axis=1).T
    percentiles = np.delete(percentiles - percentiles[:, 2:3], 2, 1)
    return np.concatenate([bands, np.log(spectrum + 1e-6), percentiles], 1)


def structure(x: np.ndarray) -> np.ndarray:
    """(n, 30) of log luminance (n, h, w): how its edges are made, which no Gaussian field can
    imitate.
    """
    h = x.shape[1]
    rows = h - h // 8
    mean = lambda d: d.mean((1, 2))
    correlations = lambda a, b: [
        np.corrcoef(u.ravel(), v.ravel())[0, 1] for u, v in zip(np.abs(a), np.abs(b))
    ]

    out = []
    finer = None
    for s in (h // 64, h // 32, h // 16, h // 8) if h >= 64 else (1, 2, 3, 4):
        smooth = uniform_filter(x, (0, s, s), mode=("nearest", "nearest", "wrap"))
        across = (np.roll(smooth, -s, 2) - smooth)[:, :rows]
        down = smooth[:, s : s + rows] - smooth[:, :rows]

        for d in (across, down):
            size = mean(np.abs(d))
            out.append(np.log(size + 1e-6))
            out.append(np.log(mean(d**2) / size**2))
        out.append(mean(down**3) / mean(down**2) ** 1.5)
        out.append(correlations(across, down))
        if finer:
            out.append(correlations(finer[0], across))
            out.append(correlations(finer[1], down))
        finer = (across, down)
    return np.stack(out, 1)


def features(codes: np.ndarray) -> np.ndarray:
    """(n, 59) of codes (n, 3, h, w)."""
    x = np.einsum("oc,nchw->nohw", OPPONENT.numpy(), codes)
    return np.concatenate([appearance(x), structure(x[:, 0])], 1)


def frechet(a: np.ndarray, b: np.ndarray) -> float:
    """Distance between normal distributions fitted to features (n, d) and (m, d)."""

    def moments(f):
        cov = np.cov(f.T)
        return f.mean(0), (1 - SHRINK) * cov + SHRINK * np.diag(np.diag(cov))

    (ma, ca), (mb, cb) = moments(a), moments(b)
    return float(((ma - mb) ** 2).sum() + np.trace(ca + cb - 2 * np.real(linalg.sqrtm(ca @ cb))))


def nearest(codes: np.ndarray, bank: np.ndarray) -> np.ndarray:
    """RMS distance (n,) of each code to the nearest of the bank over all yaws and mirrors,
    solid-angle weighted.
    """
    h, w = codes.shape[-2:]
    root = np.sqrt(solid_angles(h, w) / (4 * np.pi) / 3)
    spectrum = lambda x: np.fft.rfft(x * root, axis=-1)
    both = np.concatenate([bank, bank[..., ::-1]])
    spectra = spectrum(both)
    size = ((both * root) ** 2).sum((1, 2, 3))

    out = []
    for x in codes:
        product = (np.conj(spectrum(x))[None] * spectra).sum((1, 2))
        overlap = np.fft.irfft(product, n=w, axis=-1).max(-1)
        squared = float((size - 2 * overlap).min()) + ((x * root) ** 2).sum()
        out.append(np.sqrt(max(squared, 0)))
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
        turned = lambda k: prior.denoise(x.roll(k, -1), 1.0).roll(-k, -1)
        rms = lambda error: float(error.square().mean().sqrt())
        return {k: rms(turned(k) - plain) / size for k in (1, 2, 4, 8)}


def seconds(action, repeats: int) -> float:
    """Median wall time of `action` after one warm-up."""
    action()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return float(np.median(times))


def times(prior, steps: int) -> dict:
    """Forward pass and a whole draw, for 1 and 8 maps, on two threads."""
    set_threads(2)
    once = lambda n: prior.denoise(torch.randn(n, 3, prior.height, prior.width), 1.0)
    whole = lambda n: draw(prior, n, steps, 0)
    with torch.no_grad():
        out = {f"forward_{n}": seconds(partial(once, n), 9) for n in (1, 8)}
        return out | {f"sample_{n}": seconds(partial(whole, n), 1) for n in (1, 8)}


def histograms(prior_lights: np.ndarray, measured: np.ndarray) -> dict:
    """Per statistic of benchmarks.lights: Kolmogorov-Smirnov distance, and the quartiles of samples
    and of measured maps.
    """
    tables = [[statistics(m) for m in maps] for maps in (prior_lights, measured)]
    out = {}
    for key in tables[0][0]:
        a, b = ([row[key] for row in table] for table in tables)
        out[key] = {
            "ks": float(stats.ks_2samp(a, b)[0]),
            "samples": np.percentile(a, [10, 50, 90]),
            "measured": np.percentile(b, [10, 50, 90]),
        }
    return out


def distances(a: np.ndarray, b: np.ndarray) -> dict:
    """Fréchet distance of features a (n, 59) from those b of known maps, in either half of the
    space and in the whole.
    """
    unit = b.std(0) + 1e-9
    a = a / unit
    b = b / unit
    return {
        "all": frechet(a, b),
        "appearance": frechet(a[:, :APPEARANCE], b[:, :APPEARANCE]),
        "structure": frechet(a[:, APPEARANCE:], b[:, APPEARANCE:]),
    }


def judged(
    codes: np.ndarray,
    spread: float,
    mean: float,
    known: np.ndarray,
    held: np.ndarray,
    unseen: np.ndarray,
) -> dict:
    """Everything that needs samples only: codes (n, 3, h, w) beside those of maps known, held out,
    and unseen (held out or other).
    """
    radiance = lambda x: np.exp(x * spread + mean).transpose(0, 2, 3, 1)
    of_known = features(known)
    first, second = np.array_split(np.random.default_rng(0).permutation(len(known)), 2)
    near = lambda x: np.median(nearest(x, known))
    of_codes = near(codes)
    return {
        "frechet": distances(features(codes), of_known),
        "frechet_held_out": distances(features(held), of_known),
        "frechet_unseen": distances(features(unseen), of_known),
        "frechet_halves": distances(of_known[first], of_known[second]),
        "nearest_ratio": {"held_out": of_codes / near(held), "unseen": of_codes / near(unseen)},
        "seam": seam(codes),
        "seam_data": seam(known),
        "statistics": histograms(radiance(codes), radiance(np.concatenate([known, unseen]))),
    }


def all_unseen(data: Data, others: list[np.ndarray]) -> np.ndarray:
    """Codes of the maps held out and of other radiance maps that nobody trained on."""
    logs = [to_log(scale_free(resample_area(m, data.height, 2 * data.height))) for m in others]
    return np.concatenate([data.measured(True)] + ([data.codes(np.stack(logs))] if logs else []))


def judge(
    name: str, data: Data, others: list[np.ndarray], count: int, steps: int, folder: Path | None
) -> dict:
    """A row of the table for the prior called `name`, in that prior's own value code."""
    prior = load_prior(name)
    start = time.monotonic()
    data = replace(data, height=prior.height, mean=prior.code.mean, std=prior.code.std)
    known = data.measured(False)
    held = data.measured(True)
    unseen = all_unseen(data, others)
    if isinstance(prior, GaussianPrior):
        codes = prior.sample(count, torch.Generator().manual_seed(0))
    else:
        codes = draw(prior, count, steps, 100)

    out = {"prior": Path(name).stem, "samples": count, "held_out": len(held), "unseen": len(unseen)}
    out |= judged(codes.numpy(), prior.log_spread, data.mean, known, held, unseen)
    model = lambda x, sigma, label: prior.denoise(x, float(sigma[0]))
    loss = lambda x: fixed_loss(model, torch.from_numpy(x), row_weights(prior.height), Training())
    out["loss"] = {"train": loss(known), "held_out": loss(held), "all_unseen": loss(unseen)}
    out["yaw_error"] = yaw_error(prior, known)
    out["seconds"] = times(prior, steps)

    if folder:
        write_png(folder / f"{Path(name).stem}_all.png", sheet(lights(prior, codes[:64])))
        for label in () if isinstance(prior, GaussianPrior) else LABELS:
            maps = lights(prior, draw(prior, 64, steps, 7, label))
            write_png(folder / f"{Path(name).stem}_{label}.png", sheet(maps))
    return out | {"judged_in_seconds": time.monotonic() - start}


def judge_reni(path: Path, cache: Path, others: list[np.ndarray]) -> dict:
    """A row of the table for the samples that benchmarks.reni wrote."""
    codes = np.load(path)["codes"]
    data = Data.load(cache, codes.shape[2])
    known = data.measured(False)
    held = data.measured(True)
    unseen = all_unseen(data, others)
    scores = judged(codes, 2 * data.std, data.mean, known, held, unseen)
    return {"prior": "RENI-like", "samples": len(codes)} | scores


def show(row: dict) -> None:
    """Print a row with arrays rounded."""
    print(json.dumps(row, indent=1, default=lambda v: np.round(v, 3).tolist()), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--priors", nargs="+", default=["prior_small"])
    parser.add_argument("--reni", type=Path, help="samples of benchmarks.reni")
    parser.add_argument("--others", type=Path, help="folder with more maps for judging only")
    parser.add_argument("--catalogue", type=Path)
    parser.add_argument("--licence", default="not stated")
    parser.add_argument("--samples", type=int, default=128)
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--sheets", type=Path, help="folder for sample sheets, 64 per label")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()

    data = Data.load(args.data, 64)
    others = []
    if args.others:
        sources = find_sources(args.others, args.catalogue, args.licence)
        measured = [s for s in sources if not s.expanded]
        others = [read_source(s.path) for s in progress(measured, "other maps")]

    rows = []
    for name in args.priors:
        rows.append(judge(name, data, others, args.samples, args.steps, args.sheets))
        show(rows[-1])
    if args.reni:
        rows.append(judge_reni(args.reni, args.data, others))
        show(rows[-1])

    if args.out:
        machine = f"{platform.machine()}, {os.cpu_count()} cores"
        write_json(args.out, {"machine": machine, "rows": rows})


if __name__ == "__main__":
    main()
