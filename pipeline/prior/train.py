"""Train the light prior: EDM loss (Karras et al. 2022, Eq. 8 and Table 1) weighted by solid angle (and 30 % evenly), EMA, resumable.

python -m pipeline.prior.train --config configs/prior_small.yaml --data MAPS --catalogue CSV --minutes 60 --out RUN
"""

from __future__ import annotations

import argparse
import copy
import json
import time
from pathlib import Path

import numpy as np
import torch

from ..config import read_yaml
from ..envmap import solid_angles
from ..errors import run_stage
from ..files import atomic_path
from .data import Batches, catalogue_rows, read_maps, to_codes
from .network import LABELS, SIGMA_DATA, Denoiser
from .procedural import generate


def prepare(config: dict, data: Path, catalogue: Path, cache: Path) -> dict:
    """Codes and labels of real and procedural maps, with the statistics of the value code; cached in `cache`."""
    if not cache.exists():
        maps, labels, held = read_maps(data, catalogue_rows(catalogue, config["licence_prefix"]), config["height"])
        made, made_labels = generate(config["procedural"], config["height"], config["seed"])
        real = to_codes(maps)
        with atomic_path(cache) as temporary, open(temporary, "wb") as file:
            np.savez(file, real=real, labels=labels, held=held, made=to_codes(made), made_labels=made_labels,
                     mean=real[~held].mean(), std=real[~held].std())
    return dict(np.load(cache))


def loss_of(model, x, labels, sigma, weights) -> torch.Tensor:
    """EDM-weighted denoising error per map (n,), averaged over solid angle."""
    noisy = x + sigma[:, None, None, None] * torch.randn_like(x)
    error = ((model(noisy, sigma, labels) - x) ** 2).mean(1)
    return (error * weights).sum((1, 2)) * (sigma**2 + SIGMA_DATA**2) / (sigma * SIGMA_DATA) ** 2


def held_out_loss(model, codes, labels, weights, config) -> float:
    """Loss on held-out real maps over fixed noise levels and fixed noise, without labels."""
    generator_state = torch.get_rng_state()
    torch.manual_seed(1234)
    levels = torch.exp(config["sigma_log_mean"] + config["sigma_log_std"] * torch.linspace(-1.5, 1.5, 8))
    with torch.no_grad():
        losses = [loss_of(model, codes, torch.full_like(labels, len(LABELS)), s.expand(len(codes)), weights).mean()
                  for s in levels]
    torch.set_rng_state(generator_state)
    return float(torch.stack(losses).mean())


def train(config: dict, data: dict, out: Path, minutes: float, device: str) -> None:
    """Train until the time is up; a checkpoint and a log line every two minutes."""
    torch.manual_seed(config["seed"])
    h = config["height"]
    even = np.full((h, 2 * h), 1 / (2 * h * h))                       # keeps the pole rows trained: all rows are shown
    weights = torch.from_numpy(0.7 * solid_angles(h, 2 * h) / (4 * np.pi) + 0.3 * even).float().to(device)
    normal = lambda v: torch.from_numpy((np.ascontiguousarray(v) - data["mean"]) / (2 * data["std"])).float().to(device)
    held = data["held"].astype(bool)
    test, test_labels = normal(data["real"][held]), torch.from_numpy(data["labels"][held]).to(device)
    known, known_labels = normal(data["real"][~held])[: len(test)], torch.from_numpy(data["labels"][~held])[: len(test)]
    model = Denoiser(**config["network"]).to(device)
    average = copy.deepcopy(model)
    optimizer = torch.optim.AdamW(model.parameters(), config["learning_rate"], betas=(0.9, 0.99), weight_decay=1e-4)
    images, path = 0, out / "checkpoint.pt"
    if path.exists():
        state = torch.load(path, map_location=device, weights_only=True)
        model.load_state_dict(state["model"]), average.load_state_dict(state["average"])
        optimizer.load_state_dict(state["optimizer"])
        images = state["images"]
    batches = Batches(data["real"][~held], data["labels"][~held], data["made"], data["made_labels"],
                      config["real_share"], config["seed"] + images)
    start = last = time.monotonic()
    total, seen = 0.0, 0
    while True:
        x, labels = batches.draw(config["batch"])
        x, labels = normal(x), torch.from_numpy(labels).to(device)
        labels = torch.where(torch.rand(len(labels), device=device) < config["label_dropout"],
                             torch.full_like(labels, len(LABELS)), labels)
        sigma = torch.exp(config["sigma_log_mean"] + config["sigma_log_std"] * torch.randn(len(x), device=device))
        loss = loss_of(model, x, labels, sigma, weights).mean()
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.param_groups[0]["lr"] = config["learning_rate"] * min(1, (images + 1) / 3000)
        optimizer.step()
        images += len(x)
        decay = 0.5 ** (len(x) / min(config["ema_images"], max(images / 5, 1)))
        with torch.no_grad():
            torch._foreach_lerp_(list(average.parameters()), list(model.parameters()), 1 - decay)
        total, seen = total + float(loss.detach()) * len(x), seen + len(x)
        now = time.monotonic()
        if now - last > 120 or now - start > 60 * minutes:
            line = {"images": images, "minutes": round((now - start) / 60, 2), "train": total / seen,
                    "held_out": held_out_loss(average, test, test_labels, weights, config),
                    "train_same_levels": held_out_loss(average, known, known_labels.to(device), weights, config)}
            with atomic_path(path) as temporary:
                torch.save({"model": model.state_dict(), "average": average.state_dict(),
                            "optimizer": optimizer.state_dict(), "images": images}, temporary)
            with open(out / "log.jsonl", "a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
            print(json.dumps(line), flush=True)
            total, seen, last = 0.0, 0, now
        if now - start > 60 * minutes:
            return


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--data", type=Path, required=True, help="folder of lat-long EXR maps")
    parser.add_argument("--catalogue", type=Path, required=True, help="CSV with name, class, licence, ldr")
    parser.add_argument("--out", type=Path, required=True, help="run folder: checkpoint.pt, log.jsonl, data.npz")
    parser.add_argument("--minutes", type=float, default=60, help="time box of this call; a later call resumes")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--device", default="cpu")
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    config = read_yaml(args.config)
    args.out.mkdir(parents=True, exist_ok=True)
    data = prepare(config, args.data, args.catalogue, args.out / "data.npz")
    train(config, data, args.out, args.minutes, args.device)


if __name__ == "__main__":
    run_stage(main)
