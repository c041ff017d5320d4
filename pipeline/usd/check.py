"""USD compliance: every validator that OpenUSD ships, plus this project's own promise of relative,
existing files.
"""

from __future__ import annotations

import os
from pathlib import Path

from pxr import Sdf, Usd, UsdUtils, UsdValidation

from pipeline.base.errors import InputError


def _validate(stage: Usd.Stage) -> list[str]:
    """What OpenUSD's own validators complain of."""
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
    """Problems of a USD file, with each variant selected in turn; an empty list is a pass. Raises
    InputError for an unreadable file.
    """
    try:
        stage = Usd.Stage.Open(str(path))
    except Exception as error:  # pxr raises Tf.ErrorException, not an OSError
        raise InputError(
            f"not a readable USD file ({error})", path, "export the scene again"
        ) from error

    file = Path(path).name
    root = stage.GetDefaultPrim()
    variants = []
    if root and root.HasVariantSets():
        variants = root.GetVariantSet("sample").GetVariantNames()

    problems = []
    for variant in variants or [None]:
        if variant:
            root.GetVariantSet("sample").SetVariantSelection(variant)
        found = _validate(stage) + _paths(stage)
        problems += [f"{file} [{variant or 'flat'}] {p}" for p in found]

    _, _, missing = UsdUtils.ComputeAllDependencies(Sdf.AssetPath(str(path)))
    return problems + [f"{file}: unresolved {m}" for m in missing]
