"""Weights as safetensors files of at most PART bytes: NAME.safetensors, or NAME-1-of-2.safetensors
and so on.
"""

from __future__ import annotations

import json
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from pipeline.base.errors import InputError
from pipeline.base.files import atomic_path
from pipeline.prior.locate import part_paths
from pipeline.prior.weight_facts import CURE

PART = 15 * 2**20


def _groups(tensors: dict[str, torch.Tensor], limit: int) -> list[dict[str, torch.Tensor]]:
    """Tensors in their order, in groups of at most `limit` bytes or of one tensor."""
    groups: list[dict[str, torch.Tensor]] = [{}]
    size = 0
    for name, value in tensors.items():
        bytes_ = value.numel() * value.element_size()
        if groups[-1] and size + bytes_ > limit:
            groups.append({})
            size = 0
        groups[-1][name] = value.contiguous()
        size += bytes_
    return groups


def save_parts(
    tensors: dict[str, torch.Tensor], facts: dict, path: Path, limit: int = PART
) -> list[Path]:
    """Write `tensors` with `facts` (JSON) beside each; `path` ends in .safetensors. Older parts of
    that name are removed.
    """
    groups = _groups(tensors, limit)
    numbered = [
        path.with_name(f"{path.stem}-{k + 1}-of-{len(groups)}.safetensors")
        for k in range(len(groups))
    ]
    names = numbered if len(groups) > 1 else [path]
    for name, group in zip(names, groups):
        with atomic_path(name) as temporary:
            save_file(group, str(temporary), {"heliograph": json.dumps(facts)})

    for old in {path, *path.parent.glob(f"{path.stem}-*-of-*.safetensors")} - set(names):
        old.unlink(missing_ok=True)
    return names


def load_parts(path: Path) -> tuple[dict[str, torch.Tensor], dict]:
    """Tensors as float32, and the facts. Raises InputError when the files were not written by
    `save_parts`.
    """
    tensors = {}
    facts = {}
    try:
        for part in part_paths(path):
            with safe_open(str(part), "pt") as file:
                facts = json.loads((file.metadata() or {})["heliograph"])
                tensors.update({k: file.get_tensor(k).float() for k in file.keys()})
    except (SafetensorError, KeyError, OSError, ValueError) as error:
        raise InputError(
            f"not a Heliograph light prior ({type(error).__name__}: {error})",
            path,
            CURE,
        ) from error
    return tensors, facts
