"""Settings of a prior's training, validated once."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from pipeline.base.config import Section, read_yaml, validated


class Network(Section):
    """Shape of the U-Net (pipeline.prior.network.UNet)."""

    channels: tuple[int, ...] = Field(
        (24, 48, 96),
        min_length=1,
        description="per scale, multiples of 8; each scale halves the size",
    )
    blocks: tuple[int, ...] = Field(
        (1, 2, 2), min_length=1, description="residual blocks per scale, each way"
    )
    embedding: int = Field(96, ge=8, multiple_of=2)
    sources: int = Field(2, ge=1, le=2, description="2: measured maps are told from made ones")
    dropout: float = Field(0, ge=0, lt=1, description="share of a block's channels, in training")


class Training(Section):
    """One run of pipeline.prior.training.train."""

    height: int = Field(
        32, ge=8, le=64, multiple_of=4, description="rows of the maps; columns are twice as many"
    )
    network: Network = Network()
    licence_prefix: str = Field("CC0", description="rows of the catalogue to train on")
    procedural: int = Field(
        1300, ge=0, description="maps made by pipeline.prior.training.procedural"
    )
    real_share: float = Field(0.6, gt=0, le=1, description="measured maps' share of every batch")
    strong_share: float = Field(
        0, ge=0, le=1, description="of measured maps' views, strong ones (strong_views.py)"
    )
    batch: int = Field(32, ge=1)
    images: int = Field(
        200000,
        ge=1,
        description="length of the learning rate's cosine; training goes on at its end value",
    )
    learning_rate: float = Field(5e-4, gt=0, le=0.1)
    weight_decay: float = Field(1e-4, ge=0, description="AdamW's, of matrices and kernels")
    ema_images: int = Field(20000, ge=1, description="half-life of the weight average, in images")
    label_dropout: float = Field(
        0.3, ge=0, le=1, description="share of the batch trained without its class"
    )
    sigma_log_mean: float = Field(-0.8, description="EDM's P_mean")
    sigma_log_std: float = Field(
        1.6, gt=0, description="EDM's P_std, widened: guidance uses high noise levels too"
    )
    seed: int = Field(0, ge=0)


def load_training(path: Path) -> Training:
    """Read and validate a training configuration. Raises InputError naming file, key and cure."""
    return validated(Training, read_yaml(path), path)
