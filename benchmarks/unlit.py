"""The yardstick of an asset from photos: the same mesh with the photos averaged into a texture.

python -m benchmarks.unlit --work work/garden work/banana [--out rows.json]

A relightable asset is worth its name only if it predicts photos better than the plain textured mesh
does. This command bakes that texture on the very mesh and atlas of a finished scene, from the
photos that fit and sample may read, and scores it on the held-out views in the very pixels, at the
size and by the error formula (`pipeline.render.metrics`) of the score in refine.json. It has the
texels that the scene is configured with, though the asset's maps may be smaller by the choice of
the stage `choose`. Both stand side by side in the row, with what else tells a good asset from a bad
one: charts and utilisation of the atlas, seconds of the stages, and the medians of metallic and
roughness of every sample.

Each texel is the robust mean, in sRGB, of the photos' pixels whose ray meets the mesh there. A
photo that shows the texel larger counts for more because it has more pixels there, and a pixel
counts by the cosine of incidence. Visibility is exact, for a ray ends at the first surface. What no
photo shows has the colours that an asset has there (`pipeline.posterior.unseen_colors`).
"""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np

from benchmarks.scenes import machine
from pipeline.base.config import Observe
from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import read_json, write_json
from pipeline.base.images import linear_to_srgb, read_exr, srgb_to_linear
from pipeline.base.progress import progress
from pipeline.geometry.cameras import View
from pipeline.geometry.mesh_io import load_mesh
from pipeline.posterior.textures import fill, gather, splat
from pipeline.posterior.unseen_colors import over_unseen
from pipeline.render.envmap import mean_radiance
from pipeline.render.metrics import held_out_photos, psnr, scored_pixels
from pipeline.render.observe import Observations, Tracer, object_pixels
from pipeline.render.tint import tint_of

PIXELS = 6_000_000  # at most so many of all photos' pixels, evenly over them
CHUNK = 1 << 20  # pixels splatted at once
PASSES = 4  # of the robust mean; the first one is the plain mean
OUTLIER = 0.3  # sRGB difference at which a pixel keeps a quarter of its weight
LEAST_WEIGHT = 0.05  # pixels' weight from which a texel counts as seen
SUBPIXELS = 4  # rays along each side of a scored pixel


@dataclass
class PhotoPixels:
    """Pixels that show the object: uv (n, 2), color (n, 3) in sRGB, weight (n,)."""

    uv: np.ndarray
    color: np.ndarray
    weight: np.ndarray


def photo_pixels(
    views: list[View], poses: Path, mesh: Path, tracer: Tracer, erode: float
) -> PhotoPixels:
    """The pixels inside the masks of `views`, of which the ray meets the mesh; PIXELS at most.

    poses, mesh: folders of those stages. erode: rim in pixels that is left out. Raises InputError
    where the masks leave nothing.
    """
    inside = object_pixels(views, mesh, erode)
    share = min(1.0, PIXELS / sum(len(pixels) for pixels in inside))
    rng = np.random.default_rng(0)
    parts = []

    for view, pixels in zip(progress(views, "photos"), inside):
        count = round(share * len(pixels))
        rows, columns = rng.permutation(pixels)[:count].T
        uv, cosine, hit = tracer.hit(*view.rays(np.stack([columns, rows], -1) + 0.5))

        color = linear_to_srgb(read_exr(poses / view.image)[rows, columns])
        parts.append((uv[hit].astype(np.float32), color[hit], cosine[hit].astype(np.float32)))
    return PhotoPixels(*(np.concatenate(columns) for columns in zip(*parts)))


def bake(pixels: PhotoPixels, size: int, passes: int = PASSES) -> tuple[np.ndarray, np.ndarray]:
    """Texture (size, size, 3) in sRGB, the robust mean of `pixels`, and which texels they show.

    passes: 1 for the plain mean; each further one weights the pixels by 1 / (1 + (r / OUTLIER)^2)^2
    (Geman-McClure) of their residual r to the mean so far. Texels that no pixel shows take the
    nearest seen one's colour.
    """
    texture = np.zeros((size, size, 3), np.float32)
    for number in range(passes):
        sums = np.zeros((size, size, 4))
        for start in range(0, len(pixels.uv), CHUNK):
            part = slice(start, start + CHUNK)
            uv = pixels.uv[part]
            color = pixels.color[part]
            weight = pixels.weight[part].astype(np.float64)
            if number:
                residual = np.abs(color - gather(texture, uv)).mean(-1)
                weight /= (1 + (residual / OUTLIER) ** 2) ** 2

            counted = np.concatenate([color, np.ones((len(uv), 1), np.float32)], 1)
            sums += splat(uv, weight[:, None] * counted, size)

        if not number:
            seen = sums[..., 3] > LEAST_WEIGHT
        mean = sums[..., :3] / np.maximum(sums[..., 3:], 1e-9)
        texture = fill(mean.astype(np.float32), seen)
    return texture, seen


def picture(view: View, mask: np.ndarray, texture: np.ndarray, tracer: Tracer) -> np.ndarray:
    """The textured mesh in `view`, linear (h, w, 3); black beside the mesh and outside `mask`.

    Each pixel is the mean of SUBPIXELS^2 rays in linear light, as a photo's is.
    """
    rows, columns = np.nonzero(mask)
    corner = np.stack([columns, rows], -1)
    total = np.zeros((len(rows), 3), np.float32)

    for step in np.ndindex(SUBPIXELS, SUBPIXELS):
        uv, _, hit = tracer.hit(*view.rays(corner + (np.array(step) + 0.5) / SUBPIXELS))
        total[hit] += srgb_to_linear(gather(texture, uv[hit]))

    out = np.zeros(mask.shape + (3,), np.float32)
    out[rows, columns] = total / SUBPIXELS**2
    return out


HeldOut = list[tuple[View, np.ndarray, np.ndarray]]  # as `held_out_photos` gives them


def load(work: Path, erode: float) -> tuple[HeldOut, Tracer, PhotoPixels]:
    """Held-out views with their photos and masks, primary hits, and pixels to bake, of a scene's
    folder with the stages poses, mesh, atlas and observe done.
    """
    poses = work / "poses"
    observations = Observations(work / "observe", poses / "cameras.json")
    problem = SimpleNamespace(observations=observations, renderer=None)
    held_out = held_out_photos(problem, poses, work / "mesh", erode)
    tracer = Tracer(work / "atlas" / "mesh_uv.ply")
    return held_out, tracer, photo_pixels(observations.views, poses, work / "mesh", tracer, erode)


def score_unlit(
    work: Path, size: int, erode: float, scored: int | None = None
) -> tuple[dict[str, dict[str, float]], np.ndarray]:
    """PSNR on each held-out view of the textures by the robust and by the plain mean, in `scored`
    pixels (None: in all), and which texels (size, size) photos show.
    """
    held_out, tracer, pixels = load(work, erode)
    some = scored_pixels(held_out, scored) if scored else [mask for _, _, mask in held_out]
    mesh = load_mesh(work / "atlas" / "mesh_uv.ply")
    scores = {}
    for name, passes in (("plain", 1), ("robust", PASSES)):
        texture, seen = bake(pixels, size, passes)
        texture = over_unseen(texture, seen, mesh)
        scores[name] = {
            view.name: psnr(picture(view, chosen, texture, tracer), photo, chosen)
            for (view, photo, _), chosen in zip(held_out, some)
        }
    return scores, seen


def lit_samples(work: Path) -> list[Path]:
    """Folders of the refined samples, by number. Raises InputError where there are none."""
    found = [f.parent for f in (work / "refine").glob("*/refine.json") if f.parent.name.isdigit()]
    if not found:
        raise InputError(
            "no refined sample",
            work / "refine",
            "make the scene first: snakemake exports/NAME.usda",
        )
    return sorted(found, key=lambda folder: int(folder.name))


def configured_side(work: Path, lit_side: int) -> int:
    """Texels a side of the base colour that the scene is configured with, whatever the stage choose
    has made of it; where it decided nothing, the asset's own, `lit_side`.
    """
    decided = read_json(work / "choose" / "choose.json")["decisions"]["texture"]
    if "configured" in decided:
        return decided["configured"]["refine"]["texture"]
    return lit_side


def lit_sample(folder: Path, seen: np.ndarray) -> dict:
    """A refined sample's score as its stage wrote it, medians of its maps over the texels `seen`
    (t, t), and how warm its light is (`pipeline.render.tint`). A stage that scores random pixels
    of the views says the score's standard error.
    """
    facts = read_json(folder / "refine.json")
    roughness, metallic = (read_exr(folder / f"{name}.exr") for name in ("roughness", "metallic"))
    # the choose stage may have made these smaller than the base colour
    size = roughness.shape[::-1]
    seen = cv2.resize(seen.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    roughness, metallic = roughness[seen], metallic[seen]
    return {
        "psnr": facts["held_out_psnr"],
        "psnr_standard_error": facts.get("held_out_standard_error"),
        "views": facts["held_out"],
        "roughness_median": float(np.median(roughness)),
        "metallic_median": float(np.median(metallic)),
        "metallic_share_above_half": float((metallic > 0.5).mean()),
        "light_warm": float(tint_of(mean_radiance(read_exr(folder / "light.exr")))[0]),
    }


def stage_seconds(work: Path, column: str = "s") -> dict[str, float]:
    """Wall seconds of each job's last run, as Snakemake noted them in benchmarks/*.tsv.

    column: `s`, or `cpu_time` for processor seconds, which other jobs on the machine hardly change.
    """
    seconds = {}
    for file in sorted((work / "benchmarks").glob("*.tsv")):
        with file.open(encoding="utf-8") as lines:
            seconds[file.stem] = float(next(csv.DictReader(lines, delimiter="\t"))[column])
    return seconds


def mean(values: list[float]) -> float:
    return float(np.mean(values))


def row(work: Path, erode: float) -> dict:
    """A finished scene's unlit and lit scores and what else tells its quality.

    Raises InputError where a stage is missing, or where the lit score is of other views.
    """
    samples = lit_samples(work)
    lit_side = len(read_exr(samples[0] / "base_color.exr"))
    size = configured_side(work, lit_side)
    scored = read_json(samples[0] / "refine.json")["held_out_pixels"]
    unlit, seen = score_unlit(work, size, erode, scored)
    if not unlit["robust"]:
        raise InputError("no held-out view shows the object", work, "raise observe.held_out")
    lit = [lit_sample(folder, seen) for folder in samples]
    for folder, sample in zip(samples, lit):
        if set(sample["views"]) != set(unlit["robust"]):
            raise InputError(
                "the sample was scored on other views than the texture",
                folder / "refine.json",
                "run the scene's stages again",
            )

    atlas = read_json(work / "atlas" / "atlas.json")
    seconds = stage_seconds(work)
    unlit_psnr = mean(list(unlit["robust"].values()))
    lit_psnr = mean([sample["psnr"] for sample in lit])
    return {
        "scene": work.resolve().name,
        "unlit_psnr": unlit_psnr,
        "lit_psnr": lit_psnr,
        "gain": lit_psnr - unlit_psnr,
        "unlit_psnr_plain_mean": mean(list(unlit["plain"].values())),
        "unlit_views": unlit["robust"],
        "samples": lit,
        "texture": {"unlit": size, "lit": lit_side},
        "charts": atlas["charts"],
        "utilisation": atlas["utilisation"],
        "packed_by": atlas.get("packed_by"),  # none by versions with one packer
        "faces": atlas["faces"],
        "mesh_seconds": seconds.get("mesh"),
        "seconds": seconds,
        "cpu_seconds": stage_seconds(work, "cpu_time"),
    }


def rows_of_scenes(
    description: str | None, row: Callable[[Path, float], dict], unprinted: str = ""
) -> None:
    """The command line of a benchmark that makes a row of every finished scene, by its folder and
    `observe.erode`: prints each, but for its key `unprinted`, and writes all to --out.
    """
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--work", type=Path, nargs="+", required=True, metavar="work/SCENE")
    parser.add_argument(
        "--erode", type=float, default=Observe().erode, help="the scene's observe.erode"
    )
    parser.add_argument("--out", type=Path, help="JSON file for all rows")
    args = parser.parse_args()

    rows = []
    for work in args.work:
        rows.append(row(work, args.erode))
        print(json.dumps({k: v for k, v in rows[-1].items() if k != unprinted}), flush=True)
    if args.out:
        write_json(args.out, {"machine": machine(), "rows": rows})


def main() -> None:
    rows_of_scenes(__doc__, row)


if __name__ == "__main__":
    run_stage(main)
