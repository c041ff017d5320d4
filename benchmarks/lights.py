"""Statistics of procedural lights beside measured maps, per class: what the generator is tuned by.

python -m benchmarks.lights --data RUN/data.npz --out lights.json

RUN/data.npz is made by pipeline.prior.training.train. Per statistic: 10th, 50th and 90th percentile
over maps, measured | made.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from pipeline.base.files import write_json
from pipeline.prior.training.data import Data, radiance
from pipeline.prior.weight_facts import LABELS
from pipeline.render.envmap import resample_area, solid_angles


def statistics(env: np.ndarray) -> dict:
    """Of one radiance map (h, w, 3)."""
    h, w = env.shape[:2]
    weight = solid_angles(h, w)
    brightness = np.maximum(env.mean(-1), 1e-6)
    log = np.log(brightness)
    energy = (brightness * weight).ravel()
    order = np.argsort(-brightness.ravel())
    share = np.cumsum(energy[order]) / energy.sum()
    area = np.cumsum(weight.ravel()[order]) / (4 * np.pi)
    power = (np.abs(np.fft.rfft(log, axis=1)) ** 2 * weight[:, :1]).sum(0)
    frequency = np.arange(2, w // 4)
    slope = np.polyfit(np.log(frequency), np.log(power[frequency]), 1)[0]
    ratio = np.log(np.maximum(env[..., 0], 1e-6) / np.maximum(env[..., 2], 1e-6))
    return {
        "peak: log p99.9 / median": np.percentile(log, 99.9) - np.median(log),
        "max: log max / median": log.max() - np.median(log),
        "contrast: deviation of log": log.std(),
        "energy share of the brightest 0.2 %": share[np.searchsorted(area, 0.002)],
        "chroma: deviation of log R/B": ratio.std(),
        "tint: mean of log R/B": ratio.mean(),
        "spectrum: slope over longitude": slope,
        "up - down: difference of mean log": log[: h // 2].mean() - log[h // 2 :].mean(),
        "rough: mean step between columns": np.abs(np.diff(log, axis=1)).mean(),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--height", type=int, default=64)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()

    data = Data.load(args.data, args.height)
    table = {}
    for index, label in enumerate(LABELS):
        rows = {}
        for name, mark in (("measured", False), ("made", True)):
            maps = data.maps[(data.labels == index) & (data.made == mark) & ~data.held][:300]
            rows[name] = [
                statistics(resample_area(radiance(m), args.height, 2 * args.height)) for m in maps
            ]
        if not all(rows.values()):
            continue

        print(f"{label}: {len(rows['measured'])} measured, {len(rows['made'])} made")
        table[label] = {}
        for key in rows["measured"][0]:
            pair = {
                name: np.percentile([r[key] for r in values], [10, 50, 90])
                for name, values in rows.items()
            }
            table[label][key] = pair
            columns = [" ".join(f"{v:6.2f}" for v in values) for values in pair.values()]
            print(f"  {key:40s} {' | '.join(columns)}")

    if args.out:
        write_json(args.out, table)


if __name__ == "__main__":
    main()
