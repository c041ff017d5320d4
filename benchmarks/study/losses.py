"""Scenes on which another method relights better than ours, in sentences."""

from __future__ import annotations

from benchmarks.study.methods import is_ours
from benchmarks.study.tables import methods_in, scene_mean, scenes_in
from benchmarks.tables.committed import title

LEAST = 0.05  # dB, below which two means are printed alike


def losses(data: dict, theirs: str = "dpi_paper") -> str:
    """For each of our presets: where `theirs` relights better in the mean of the draws, by how many
    dB, and by how many where a factor for each channel is free.
    """
    ours = [name for name in methods_in(data) if is_ours(name)]
    said = [behind(data, name, theirs) for name in ours]
    return "\n\n".join(said) + "\n"


def behind(data: dict, ours: str, theirs: str) -> str:
    lead = {
        key: {scene: ahead(data, scene, ours, theirs, key) for scene in scenes_in(data)}
        for key in ("relight_psnr", "relight_psnr_channel")
    }
    raw, aligned = lead.values()
    lost = {scene: by for scene, by in raw.items() if by is not None and by > LEAST}
    judged = sum(by is not None for by in raw.values())
    where = [
        f"{title(scene)} by {by:.1f} dB (aligned {-(aligned[scene] or 0):+.1f})"
        for scene, by in sorted(lost.items(), key=lambda item: -item[1])
    ]
    also = [s for s, by in aligned.items() if by is not None and by > LEAST]
    text = f"`{ours}` is behind `{theirs}` on {len(lost)} of {judged} scenes"
    text += f": {'; '.join(where)}." if where else "."
    return f"{text} Aligned, with a factor for each channel, it is behind on {len(also)}."


def ahead(data: dict, scene: str, ours: str, theirs: str, key: str) -> float | None:
    """dB by which `theirs` is better; None where either has no rows."""
    mine, other = (scene_mean(data, scene, name, key) for name in (ours, theirs))
    return None if mine is None or other is None else other - mine
