"""Scores of an explanation, or of a finished USD asset, against a scene's truth.

Nothing is turned, moved or resized before it is compared; the errors' spaces, masks and scale rules
stand in pipeline/render/declared.py. Pictures are rendered twice with independent noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.optimize import minimize_scalar

from pipeline.base.errors import InputError
from pipeline.base.images import linear_to_srgb
from pipeline.geometry.mesh_io import save_mesh
from pipeline.geometry.surface import Surface
from pipeline.posterior.textures import gather
from pipeline.render.declared import METRICS
from pipeline.render.draw_metrics import crps, sample_variance
from pipeline.render.envmap import resample_area, solid_angles
from pipeline.render.light_metrics import light_errors, ssim_map
from pipeline.render.map_metrics import map_errors
from pipeline.render.metrics import crossed_error, flip_map, psnr, render_twice
from pipeline.render.observe import Tracer
from pipeline.render.renderer import Explanation, Renderer
from pipeline.render.samples import MEAN
from pipeline.report.truth import MAPS, Picture, TrueView, Truth, outline_overlap
from pipeline.usd.read import UsdAsset, open_stage, read_asset, variants_of

SPP = 128  # paths per pixel, half of them for each of the two pictures
MAX_DEPTH = 6  # path vertices after the camera, as the truth was rendered with
LIGHT_ROWS = 32  # at which lights are compared, whatever their own size
FACTORS = 4.0  # log of the largest factor, and of the smallest, that a channel is aligned by
LEAST_OVERLAP = 0.2  # of outlines, below which an asset stands elsewhere than the cameras think


@dataclass
class Scored:
    """values: by name of METRICS; views: PSNR of each picture by its name; pictures: (2, h, w, 3)
    of each; albedo (n, 3) at the true pixels; log_light (h, 2h, 3), log mean 0.
    """

    values: dict[str, float]
    views: dict[str, float]
    pictures: dict[str, np.ndarray]
    albedo: np.ndarray
    log_light: np.ndarray


def true_pictures(truth: Truth) -> dict[str, tuple[TrueView, Picture, np.ndarray | None]]:
    """Every true picture by name ("novel/<view>", "relight/<light>/<view>"), with its view and its
    light, None for the scene's own.
    """
    out: dict[str, tuple[TrueView, Picture, np.ndarray | None]] = {}
    for known in truth.views:
        out[f"novel/{known.view.name}"] = known, known.photo, None
    for name, relit in truth.relights.items():
        for known, shown in zip(relit.views, relit.pictures):
            out[f"relight/{name}/{known.view.name}"] = known, shown, relit.light
    return out


def rendered(
    renderer: Renderer, x: Explanation, truth: Truth, spp: int, step: Callable[[], object]
) -> dict[str, np.ndarray]:
    """What `x` shows of every true picture, (2, h, w, 3), inside the masks."""
    out = {}
    for name, (known, _, light) in true_pictures(truth).items():
        lit = x if light is None else replace(x, light=light)
        out[name] = render_twice(renderer, lit, known.view, known.mask, spp)
        step()
    return out


def picture_psnr(pair: np.ndarray, shown: Picture, mask: np.ndarray) -> float:
    """PSNR in dB of a twice-rendered picture (2, h, w, 3)."""
    return psnr(pair[0], shown.pixels, mask, pair[1], shown.again)


def on_black(pair: np.ndarray, shown: Picture, mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both pictures (h, w, 3) as sRGB values, each the mean of its renders, black outside the
    mask.
    """
    inside = lambda values: linear_to_srgb(np.where(mask[..., None], values, 0))
    return inside(pair.mean(0)), inside(shown.mean)


def picture_ssim(pair: np.ndarray, shown: Picture, mask: np.ndarray) -> float:
    """SSIM as sRGB values, mean inside the mask."""
    return float(ssim_map(*on_black(pair, shown, mask))[mask].mean())


def picture_flip(pair: np.ndarray, shown: Picture, mask: np.ndarray) -> float:
    """FLIP, mean inside the mask."""
    return float(flip_map(*on_black(pair, shown, mask))[mask].mean())


def best_factor(
    pairs: list[np.ndarray], shown: list[Picture], masks: list[np.ndarray]
) -> np.ndarray:
    """Factor (3,) of linear pictures (2, h, w, 3) under which the error that `picture_psnr` is of
    is least over all of them, within e^-FACTORS to e^FACTORS.

    Least squares of linear radiance are led by highlights, which pictures of sRGB values in [0, 1]
    show as white, however bright: one that is a little too wide pulls all else down.
    """
    inside = lambda pictures: np.concatenate([one[m] for one, m in zip(pictures, masks)])
    first, second = (inside([pair[k] for pair in pairs]) for k in (0, 1))
    true = inside([picture.pixels for picture in shown])
    again = inside([p.pixels if p.again is None else p.again for p in shown])

    def error(log_factor: float, c: int) -> float:
        factor = np.exp(log_factor)
        both = (factor * first[:, c], true[:, c], factor * second[:, c], again[:, c])
        return float(crossed_error(*both).mean())

    found = [
        minimize_scalar(error, bounds=(-FACTORS, FACTORS), args=(c,), method="bounded").x
        for c in range(3)
    ]
    return np.exp(found)


def relit_names(truth: Truth) -> dict[str, list[str]]:
    """Names of the true pictures under every other light."""
    names = true_pictures(truth)
    return {
        light: [name for name in names if name.startswith(f"relight/{light}/")]
        for light in truth.relights
    }


def relight_psnr(pictures: dict[str, np.ndarray], truth: Truth, aligned: bool = False) -> float:
    """PSNR in dB of relit pictures (2, h, w, 3), mean over them. aligned: after one factor per
    channel and light, `best_factor`.
    """
    true = true_pictures(truth)
    found = []
    for names in relit_names(truth).values():
        ours = [pictures[name] for name in names]
        shown = [true[name][1] for name in names]
        masks = [true[name][0].mask for name in names]
        factor = best_factor(ours, shown, masks) if aligned else 1.0
        of = zip(ours, shown, masks)
        found += [picture_psnr(one * factor, true_one, mask) for one, true_one, mask in of]
    return float(np.mean(found))


def aligned_psnr(pictures: dict[str, np.ndarray], truth: Truth) -> float:
    """`relight_psnr` after the best factors."""
    return relight_psnr(pictures, truth, True)


def picture_scores(
    pictures: dict[str, np.ndarray], truth: Truth
) -> tuple[dict[str, float], dict[str, float]]:
    """Scores by name of METRICS, and PSNR of every picture. Without relit views there are no scores
    of them.
    """
    true = true_pictures(truth)
    each = lambda score: {n: score(pictures[n], true[n][1], true[n][0].mask) for n in true}
    of, ssim, flip = each(picture_psnr), each(picture_ssim), each(picture_flip)

    mean = lambda found, start: float(np.mean([v for k, v in found.items() if k.startswith(start)]))
    values = {
        "novel_view_psnr": mean(of, "novel"),
        "novel_view_ssim": mean(ssim, "novel"),
        "novel_view_flip": mean(flip, "novel"),
    }
    if truth.relights:
        values |= {
            "relight_psnr": mean(of, "relight"),
            "relight_psnr_channel": aligned_psnr(pictures, truth),
            "relight_ssim": mean(ssim, "relight"),
            "relight_flip": mean(flip, "relight"),
        }
    return values, of


def shown_pixels(known: TrueView) -> np.ndarray:
    """Inner pixels (h, w) of a view that show the object: where a render of its roughness has none,
    nothing was met.
    """
    roughness = known.maps.get("roughness")
    return known.mask if roughness is None else known.mask & (roughness > 0)


def map_truth(truth: Truth) -> dict[str, np.ndarray]:
    """True maps at `shown_pixels` of all views, (n, 3) and (n,), of those maps that all have."""
    names = [name for name in MAPS if all(name in known.maps for known in truth.views)]
    return {
        name: np.concatenate([known.maps[name][shown_pixels(known)] for known in truth.views])
        for name in names
    }


def maps_shown(
    mesh: Path, x: Explanation, truth: Truth
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Base colour (n, 3), roughness and metallic (n,) of `x` at the pixels of `map_truth`; zero
    where the asset has no surface.
    """
    tracer = Tracer(mesh)
    maps = [np.ascontiguousarray(m) for m in (x.base_color, x.roughness, x.metallic)]
    look_up = lambda uv: np.concatenate([gather(m, uv).reshape(len(uv), -1) for m in maps], 1)
    parts = []
    for known in truth.views:
        shown = tracer.pixel_means(known.view, look_up)
        parts.append(shown[shown_pixels(known)])
    table = np.concatenate(parts)
    return table[:, :3], table[:, 3], table[:, 4]


def score_explanation(
    renderer: Renderer,
    x: Explanation,
    truth: Truth,
    spp: int = SPP,
    step: Callable[[], object] = lambda: None,
) -> Scored:
    """All scores of one explanation. `step()` is called after each picture."""
    pictures = rendered(renderer, x, truth, spp, step)
    values, views = picture_scores(pictures, truth)

    rows = min(LIGHT_ROWS, len(x.light), *([] if truth.light is None else [len(truth.light)]))
    light = resample_area(x.light, rows, 2 * rows)
    if truth.light is not None:
        values |= light_errors(light, resample_area(truth.light, rows, 2 * rows))

    albedo = np.zeros((0, 3))
    known = map_truth(truth)
    if known:
        albedo, roughness, metallic = maps_shown(renderer.mesh, x, truth)
        values |= map_errors(albedo, roughness, metallic, known)
    return Scored(values, views, pictures, albedo, centred_log(light))


def centred_log(light: np.ndarray) -> np.ndarray:
    """Log radiance (h, 2h, 3) less its solid-angle mean over all channels."""
    logs = np.log(np.maximum(light, 1e-3 * light.mean()))
    weight = solid_angles(*light.shape[:2])[..., None] / (12 * np.pi)
    return logs - (logs * weight).sum()


def score_draws(draws: list[Scored], truth: Truth) -> dict[str, float]:
    """Scores that draws have together; needs two of them at least."""
    out = {"variance_light": light_variance([d.log_light for d in draws])}
    if truth.relights:
        out |= score_relit_draws(draws, truth)
    known = map_truth(truth)
    if "albedo" in known:
        colors = np.array([d.albedo.ravel() for d in draws])
        out["crps_albedo"] = crps(colors, known["albedo"].ravel())
        out["variance_albedo"] = sample_variance(colors)
    return out


def score_relit_draws(draws: list[Scored], truth: Truth) -> dict[str, float]:
    """Scores of relit pictures that draws have together."""
    true = true_pictures(truth)
    relit = [name for name in true if name.startswith("relight/")]
    mean = {name: np.mean([d.pictures[name] for d in draws], axis=0) for name in relit}
    of_mean = [picture_psnr(mean[name], true[name][1], true[name][0].mask) for name in relit]

    inside = lambda pixels, name: linear_to_srgb(pixels)[true[name][0].mask].ravel()
    pixels = np.array(
        [np.concatenate([inside(d.pictures[n].mean(0), n) for n in relit]) for d in draws]
    )
    shown = np.concatenate([inside(true[n][1].mean, n) for n in relit])
    return {
        "relight_psnr_of_mean": float(np.mean(of_mean)),
        "crps_relight": crps(pixels, shown),
    }


def light_variance(logs: list[np.ndarray]) -> float:
    """Variance between draws of log radiance, each of log mean 0, averaged over solid angle."""
    weight = solid_angles(*logs[0].shape[:2])[..., None] / (12 * np.pi)
    return float((np.var(logs, axis=0, ddof=1) * weight).sum())


def renderer_of(asset: UsdAsset, folder: Path, light_rows: int) -> Renderer:
    """A renderer of the asset's mesh, which is written to `folder` with its normal map."""
    mesh = folder / "mesh_uv.ply"
    save_mesh(mesh, asset.mesh)
    if asset.normal is not None:
        Surface.of(mesh).with_normals(2 * asset.normal - 1)
    return Renderer(mesh, len(asset.explanation.roughness), light_rows, MAX_DEPTH)


def score_asset(
    path: Path, truth: Truth, spp: int = SPP, step: Callable[[], object] = lambda: None
) -> dict:
    """Scores of every variant of a USD asset, and of all samples together where there are several.
    Raises InputError where the file cannot be scored.
    """
    samples: dict[str, dict] = {}
    draws: list[Scored] = []
    notes = list(truth.notes)
    for variant in variants_of(open_stage(path)):
        asset = read_asset(path, variant)
        with TemporaryDirectory() as folder:
            light = asset.explanation.light if truth.light is None else truth.light
            renderer = renderer_of(asset, Path(folder), len(light))
            overlap = outline_overlap(renderer.mesh, truth)
            if overlap < LEAST_OVERLAP:
                raise InputError(
                    f"the asset is not where the truth's cameras look: its outline and the "
                    f"object's share {overlap:.0%} of their union",
                    path,
                    "place it in the frame of the scene's transforms.json (Z-up) before scoring",
                )
            own = asset.explanation  # in the unit of the user's photos, as the truth's folder is
            seen = replace(own, light=own.light / truth.white)
            scored = score_explanation(renderer, seen, truth, spp, step)
        if variant != MEAN:
            draws.append(scored)
        values = scored.values | {"outline_overlap": overlap}
        samples[variant or "asset"] = {"scores": values, "views": scored.views}
        notes += [note for note in asset.notes if note not in notes]

    together = score_draws(draws, truth) if len(draws) > 1 else {}
    return {
        "asset": path.name,
        "spp": spp,
        "samples": samples,
        "together": together,
        "notes": notes,
    }


def table(scored: dict) -> str:
    """The scores of `score_asset` as lines of text, a column for each sample."""
    names = list(scored["samples"])
    lines = [f"{'':34s}" + "".join(f"{name:>12s}" for name in names)]
    for key, metric in METRICS.items():
        found = [scored["samples"][name]["scores"].get(key) for name in names]
        if key in scored["together"]:
            found = [scored["together"][key]]
        if any(value is not None for value in found):
            head = metric.title + (f" ({metric.unit})" if metric.unit else "")
            cells = "".join("" if v is None else f"{v:12.{metric.digits}f}" for v in found)
            lines.append(f"{head:34s}{cells}")
    overlap = [scored["samples"][name]["scores"]["outline_overlap"] for name in names]
    lines.append(f"{'overlap of outlines':34s}" + "".join(f"{v:12.3f}" for v in overlap))
    return "\n".join(lines + [f"note: {note}" for note in scored["notes"]])
