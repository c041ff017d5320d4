"""One self-contained HTML page per scene: inputs, geometry, every sample, what is certain and what
is not, timings.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from pipeline.base.config import Scene
from pipeline.base.enough import AUTO, FILE
from pipeline.base.files import atomic_path, read_json
from pipeline.geometry.cameras import load_cameras
from pipeline.geometry.mesh_io import load_mesh
from pipeline.render.metrics import held_out_photos, score_held_out
from pipeline.render.observe import Observations
from pipeline.render.renderer import Explanation, Renderer
from pipeline.render.samples import Samples, Spread, mean_of
from pipeline.report.draws import (
    alike_words,
    color_facts,
    interval_words,
    relit_facts,
    samples_words,
    unseen_words,
    weights_words,
)
from pipeline.report.files import asset_files
from pipeline.report.html import page
from pipeline.report.pictures import Painter, contact_sheet, normal_map, spread_pictures
from pipeline.report.trust import evidence, in_words, load_model, probability
from pipeline.report.viewer import viewer_data

STAGES = ("capture", "poses", "masks", "mesh", "atlas", "observe", "choose", "fit")


def stage_facts(work: Path, auto: bool) -> dict[str, dict]:
    """The metrics that every stage wrote, in order of the work; of as many samples as were
    exported. auto: whether their number was left to the stage `enough`.
    """
    facts = {s: read_json(work / s / f"{s}.json") for s in STAGES}
    export = read_json(work / "export.json")
    for k in range(export["samples"]):
        facts[f"sample {k}"] = read_json(work / "sample" / str(k) / "sample.json")
        facts[f"refine {k}"] = read_json(work / "refine" / str(k) / "refine.json")
    if auto:
        facts["enough"] = read_json(work / "enough" / str(export["samples"] - 1) / FILE)
    return facts | {"export": export}


@dataclass
class HeldOut:
    """What scores on held-out photos need (pipeline/render/metrics.py)."""

    observations: Observations
    renderer: Renderer


def mean_held_out(work: Path, mean: Explanation, painter: Painter) -> float | None:
    """PSNR in dB of the samples' mean on photos that were held out, scored as the refine stage
    scores a sample; None without any.
    """
    poses, settings = work / "poses", painter.scene.refine
    observations = Observations(work / "observe", poses / "cameras.json")
    judge = HeldOut(observations, painter.renderer(mean, painter.ground))
    photos = held_out_photos(judge, poses, work / "mesh", painter.scene.observe.erode)
    scored = score_held_out(judge, mean, photos, settings.score_pixels, settings.score_spp)
    return scored["held_out_psnr"]


def make_report(work: Path, usd: Path, out: Path, scene: Scene) -> dict:
    """Render the pictures and write `out`. Returns metrics; raises InputError when a stage's result
    is missing.
    """
    facts = stage_facts(work, scene.samples == AUTO)
    count = facts["export"]["samples"]
    rig = load_cameras(work / "poses" / "cameras.json")
    explanations = Samples.of(work, count)

    held = facts["observe"]["held_out"]
    view = next((v for v in rig.views if held and v.name == held[0]), rig.views[0])
    texels = explanations.texels
    painter = Painter(work, view, scene, texels)
    samples = [painter.sample(x) for x in explanations]
    mean = mean_of(explanations, explanations.weights)
    of_mean = None
    if mean is not None:
        of_mean = painter.sample(mean) | {"held_out": mean_held_out(work, mean, painter)}
    spread = Spread.of(explanations)
    pictures = {
        "photos": contact_sheet(work, rig),
        "masks": (work / "masks" / "overlay.jpg").read_bytes(),
        "mesh": (work / "mesh" / "preview.png").read_bytes(),
        "atlas": (work / "atlas" / "atlas.png").read_bytes(),
        "normals": normal_map(work),
        "photo": painter.photo_jpeg(),
        "spread": spread_pictures(spread, texels) if spread else {},
    }
    held_out = [f["held_out_psnr"] for stage, f in facts.items() if stage.startswith("refine")]
    scores = [score for score in held_out if score is not None]
    found = evidence(work, rig, explanations, scene, scores)
    model = load_model()
    trust = in_words(found, model, facts["mesh"]["method"] == "given")
    brightness = float(np.mean([s["mean_radiance"] for s in samples]))
    relit = relit_facts([s["relit"] for s in samples], brightness)
    certain = color_facts(spread, texels) | relit if spread else {}
    enough = samples_words(certain, count) if certain else ""
    within = interval_words(certain) if certain else ""
    weights = explanations.weights
    counts = weights_words(weights, len(explanations.judged[0].pixel)) if certain else ""
    said: dict = {"trust": trust, "enough": enough, "within": within, "counts": counts}
    said["alike"] = alike_words(spread, scene.refine.gloss == "tested") if spread else ""
    said["unseen"] = unseen_words(load_mesh(work / "atlas" / "mesh_uv.ply"), texels)
    said["files"] = asset_files(usd, out, count)
    named = [("mean of the samples", mean)] if mean is not None else []
    each = ((f"sample {k}", x) for k, x in enumerate(explanations))
    said["viewer"] = viewer_data(
        load_mesh(work / "atlas" / "mesh_uv.ply"),
        chain(named, each),
        view.position - rig.center,
        brightness,
    )
    shown = view.name, view.name in held
    html = page(usd, scene, facts, pictures, samples, of_mean, *shown, said)
    with atomic_path(out) as temporary:
        temporary.write_text(html, encoding="utf-8")
    metrics = {"mib": round(len(html) / 2**20, 2), "view": view.name, "samples": count}
    metrics["unseen_share"] = texels.unseen_share
    metrics |= certain | {"weights": weights.tolist()}
    if of_mean:
        metrics["mean_held_out_psnr"] = of_mean["held_out"]
    if found is None:
        return metrics | {"trust": None}
    return metrics | {"trust": asdict(found) | {"chance_of_failure": probability(found, model)}}
