"""Train the light prior: EDM loss (Karras et al. 2022, Eq. 8 and Table 1) weighted by solid angle
and evenly, half each, EMA, resumable.

python -m pipeline.prior.training.train --config configs/prior/small.yaml --data MAPS \\
    --catalogue CSV --minutes 60 --out RUN

RUN/state.pt holds all that a resumed run needs; RUN/average*.safetensors is the weight average
alone, in parts small enough to carry between machines. Where only the average is there, training
starts from it with a fresh optimiser, and says so.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import time
from pathlib import Path

import numpy as np
import torch

from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import atomic_path
from pipeline.prior.locate import part_paths
from pipeline.prior.network import KINDS, SIGMA_DATA, Denoiser
from pipeline.prior.training.data import Batches, Data, make_cache
from pipeline.prior.training.settings import Training, load_training
from pipeline.prior.weight_facts import LABELS
from pipeline.prior.weight_files import load_parts, save_parts
from pipeline.render.envmap import solid_angles

WARM_UP = 3000  # images over which the learning rate rises
LAST_RATE = 0.03  # share of the learning rate at the end of the cosine
LOG_SECONDS = 600  # between two lines of the log, and two checkpoints


def loss_of(model, x, labels, sigma, weights) -> torch.Tensor:
    """EDM-weighted denoising error per map (n,), averaged over solid angle."""
    noisy = x + sigma[:, None, None, None] * torch.randn_like(x)
    error = ((model(noisy, sigma, labels) - x) ** 2).mean(1)
    return (error * weights).sum((1, 2)) * (sigma**2 + SIGMA_DATA**2) / (sigma * SIGMA_DATA) ** 2


def fixed_loss(model, codes, weights, config: Training) -> float:
    """Loss on codes (n, 3, h, w) over fixed noise levels and fixed noise, without class; the random
    state is left as it was.
    """
    with torch.random.fork_rng():
        torch.manual_seed(1234)
        labels = torch.full((len(codes),), len(LABELS), device=codes.device)
        spread = config.sigma_log_std * torch.linspace(-1.5, 1.5, 8)
        losses = []
        with torch.no_grad():
            for level in torch.exp(config.sigma_log_mean + spread):
                sigma = level.expand(len(codes)).to(codes.device)
                losses.append(loss_of(model, codes, labels, sigma, weights).mean())
    return float(torch.stack(losses).mean())


def row_weights(h: int) -> torch.Tensor:
    """(h, 2h), sum 1: half by solid angle; half evenly, which keeps the rows at the poles trained.
    They cover little of the sphere, but a lat-long map shows them as large as the others.
    """
    even = np.full((h, 2 * h), 1 / (2 * h * h))
    by_angle = solid_angles(h, 2 * h) / (4 * np.pi)
    return torch.from_numpy(0.5 * by_angle + 0.5 * even).float()


def learning_rate(config: Training, images: int) -> float:
    """Linear warm-up, then a cosine down to LAST_RATE of it."""
    warm_up = min(1, (images + 1) / WARM_UP)
    phase = 0.5 * (1 + math.cos(math.pi * min(images / config.images, 1)))
    return config.learning_rate * warm_up * (LAST_RATE + (1 - LAST_RATE) * phase)


def decayed(model: torch.nn.Module, weight_decay: float) -> list[dict]:
    """AdamW's groups: matrices and kernels shrink, biases and norms do not."""
    parameters = list(model.parameters())
    return [
        {"params": [p for p in parameters if p.ndim > 1], "weight_decay": weight_decay},
        {"params": [p for p in parameters if p.ndim < 2], "weight_decay": 0.0},
    ]


class Run:
    """Model, weight average and optimiser of one training run, with their files."""

    def __init__(self, config: Training, facts: dict, out: Path, device: str):
        torch.manual_seed(config.seed)
        self.config = config
        self.facts = facts
        self.out = out
        self.device = device
        self.images = 0

        self.model = Denoiser(**config.network.model_dump()).to(device)
        self.average = copy.deepcopy(self.model).eval()
        self.optimizer = torch.optim.AdamW(
            decayed(self.model, config.weight_decay), config.learning_rate, betas=(0.9, 0.99)
        )

        if (out / "state.pt").exists():
            self._resume(torch.load(out / "state.pt", map_location=device, weights_only=True))
        elif part_paths(out / "average.safetensors"):
            tensors, old = load_parts(out / "average.safetensors")
            self.model.load_state_dict(tensors)
            self.average.load_state_dict(tensors)
            self.images = old["images"]
            print(
                f"resumed from the weight average at {self.images} images, with a fresh optimiser",
                flush=True,
            )

    def _resume(self, state: dict) -> None:
        self.model.load_state_dict(state["model"])
        self.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.images = state["images"]

    def save(self) -> None:
        """Write state.pt and average*.safetensors."""
        state = {
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "images": self.images,
        }
        with atomic_path(self.out / "state.pt") as temporary:
            torch.save(state, temporary)

        weights = {name: t.half().cpu() for name, t in self.average.state_dict().items()}
        facts = self.facts | {"images": self.images}
        save_parts(weights, facts, self.out / "average.safetensors")

    def step(self, x, labels, weights) -> float:
        """One optimiser step on codes x (n, 3, h, w), forward pass in bfloat16; returns the mean
        loss.
        """
        config = self.config
        dropped = torch.rand(len(labels), device=self.device) < config.label_dropout
        labels = torch.where(dropped, labels // KINDS * KINDS + len(LABELS), labels)
        spread = config.sigma_log_std * torch.randn(len(x), device=self.device)
        sigma = torch.exp(config.sigma_log_mean + spread)

        with torch.autocast(self.device.split(":")[0], torch.bfloat16):
            loss = loss_of(self.model, x, labels, sigma, weights).mean()
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        self.optimizer.param_groups[0]["lr"] = learning_rate(config, self.images)
        self.optimizer.step()

        self.images += len(x)
        half_life = min(config.ema_images, max(self.images / 5, 1))
        decay = 0.5 ** (len(x) / half_life)
        average: list[torch.Tensor] = list(self.average.parameters())
        with torch.no_grad():
            torch._foreach_lerp_(average, list(self.model.parameters()), 1 - decay)
        return float(loss.detach())


def facts_of(config: Training, data: Data) -> dict:
    """What the weight files say of themselves."""
    labels = data.labels[~data.made & ~data.held & (data.labels < len(LABELS))]
    present = {name: labels == k for k, name in enumerate(LABELS) if (labels == k).any()}
    return {
        "shares": {name: float(mine.mean()) for name, mine in present.items()},
        "network": config.network.model_dump(),
        "height": config.height,
        "mean": data.mean,
        "std": data.std,
        "made_maps": int(data.made.sum()),
        "real_maps": int((~data.made & ~data.held).sum()),
        "held_out_maps": int(data.held.sum()),
    }


def train(config: Training, data: Data, out: Path, minutes: float, device: str) -> None:
    """Train until the time is up; a checkpoint and a log line every ten minutes."""
    weights = row_weights(config.height).to(device)
    test = torch.from_numpy(data.measured(True)).to(device)
    known = torch.from_numpy(data.measured(False)).to(device)
    known = known[:: max(1, len(known) // max(len(test), 1))]  # as many as are held out
    run = Run(config, facts_of(config, data), out, device)
    if device != "cpu":  # on CPU oneDNN's own layout is the faster one: 69 against 77 ms per map
        run.model.to(memory_format=torch.channels_last)
    seed = config.seed + run.images
    batches = Batches(data, config.real_share, seed, config.strong_share)

    start = time.monotonic()
    last = start
    losses = []
    while True:
        x, labels, made = batches.draw(config.batch)
        labels = labels + KINDS * made * (config.network.sources - 1)
        codes = torch.from_numpy(x).to(device)
        losses.append(run.step(codes, torch.from_numpy(labels).to(device), weights))

        now = time.monotonic()
        over = now - start > 60 * minutes
        if now - last > LOG_SECONDS or over:
            line = {
                "images": run.images,
                "minutes": round((now - start) / 60, 2),
                "train": float(np.mean(losses)),
                "held_out": fixed_loss(run.average, test, weights, config) if len(test) else None,
                "train_same_levels": fixed_loss(run.average, known, weights, config),
            }
            run.save()
            with open(out / "log.jsonl", "a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
            print(json.dumps(line), flush=True)
            losses = []
            last = time.monotonic()
        if over:
            return


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument(
        "--data", type=Path, help="folder of lat-long maps: .exr, .hdr; .jpg, .png as a lower tier"
    )
    parser.add_argument(
        "--catalogue",
        type=Path,
        help="CSV with name, class, licence, ldr; none: every map, without class",
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        help="run folder: data.npz, state.pt, average*.safetensors, log.jsonl",
    )
    parser.add_argument(
        "--cache",
        type=Path,
        help="maps read and made once (default: OUT/data.npz); runs of other sizes may share it",
    )
    parser.add_argument(
        "--minutes", type=float, default=60, help="time box of this call; a later call resumes"
    )
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--device", default="cpu")
    args = parser.parse_args()

    torch.set_num_threads(args.threads)
    config = load_training(args.config)
    args.out.mkdir(parents=True, exist_ok=True)
    cache = args.cache or args.out / "data.npz"
    if not cache.exists():
        if args.data is None:
            raise InputError(
                "there is no cache of training maps", cache, "give --data FOLDER to read them from"
            )
        make_cache(
            args.data, args.catalogue, config.licence_prefix, config.procedural, config.seed, cache
        )
    train(config, Data.load(cache, config.height), args.out, args.minutes, args.device)


if __name__ == "__main__":
    run_stage(main)
