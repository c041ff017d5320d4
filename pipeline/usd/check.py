"""USD compliance: every validator that OpenUSD ships, plus this project's own promise of relative,
existing files.
"""

from __future__ import annotations

import os
from pathlib import Path

from pxr import Sdf, Usd, UsdUtils, UsdValidation

from pipeline.base.errors import InputError


def _validate(stage: Usd.Stage) -> list[str]:
    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    return [f"{e.GetType()} {e.GetName()}: {e.GetMessage()}" for e in context.Validate(stage)]


def _paths(stage: Usd.Stage) -> list[str]:
    """Authored asset paths of the composed stage that are absolute or do not exist."""
    out = []
    for prim in stage.TraverseAll():
        for attribute in prim.GetAttributes():
            value = attribute.Get()
            if isinstance(value, Sdf.AssetPath) and value.path:
                if os.path.isabs(value.path) or "://" in value.path:
                    out.append(f"{attribute.GetPath()}: absolute path {value.path}")
                elif not value.resolvedPath:  # looks into a .usdz, too
                    out.append(f"{attribute.GetPath()}: missing file {value.path}")
    return out


def check(path: str | Path) -> list[str]:
    """Problems of a USD file, with each variant selected in turn; an empty list is a pass.
    InputError if unreadable.
    """
    try:
        stage = Usd.Stage.Open(str(path))
    except Exception as error:  # pxr raises Tf.ErrorException, not an OSError
        raise InputError(
            f"not a readable USD file ({error})", path, "export the scene again"
        ) from error
    root = stage.GetDefaultPrim()
    names = root.GetVariantSet("sample").GetVariantNames() if root and root.HasVariantSets() else []
    problems = []
    for name in names or [None]:
        if name:
            root.GetVariantSet("sample").SetVariantSelection(name)
        problems += [
            f"{Path(path).name} [{name or 'flat'}] {p}" for p in _validate(stage) + _paths(stage)
        ]
    layers, assets, missing = UsdUtils.ComputeAllDependencies(Sdf.AssetPath(str(path)))
    return problems + [f"{Path(path).name}: unresolved {m}" for m in missing]
