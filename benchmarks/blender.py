"""What Blender shows of finished assets: held-out photos against Cycles' pictures of what its USD
importer makes of them.

python -m venv FOLDER && FOLDER/bin/pip install bpy==5.0.1
python -m benchmarks.blender --work work/garden --exports exports --blender FOLDER/bin/python \
    [--out rows.json] [--pictures FOLDER]

A row: `scene`, Blender's `version`, and for the mean and every sample, by the name of its variant,
`psnr`, dB in the pixels that the first sample's stage scored, and `level`, how bright the picture
is against the photos there. An asset is opened as it is; its dome light has to arrive as the
world's light, its textures and its normal map as the material's (benchmarks/blender_render.py).
FOLDER/<scene>.jpg has every photo beside Blender's picture of the mean.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from benchmarks.look import below_each_other, cropped
from benchmarks.scenes import machine
from benchmarks.unlit import lit_samples
from pipeline.base.config import Observe
from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import read_json, write_json
from pipeline.base.images import read_exr, to_srgb8, write_png
from pipeline.geometry.cameras import View
from pipeline.render.metrics import held_out_photos, psnr, scored_pixels
from pipeline.render.observe import Observations
from pipeline.render.samples import MEAN

RENDER = Path(__file__).with_name("blender_render.py")
SAMPLES = 16  # paths a pixel of each of two pictures, whose noise drops out of a score
SENSOR = 36.0  # width in millimetres; any will do
# Y-up to Blender's Z-up, as its importer turns assets; and a camera that looks along -z with y up
# from one that looks along +z with y down
Z_UP = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])
LOOKS_BACK = np.diag([1, -1, -1, 1.0])

HeldOut = list[tuple[View, np.ndarray, np.ndarray]]


def camera_of(view: View) -> dict:
    """The view as Blender's camera: `size` in pixels, `sensor` width and `lens` (focal length) in
    millimetres, `shift` of the principal point as shares of the sensor's width, right and up,
    `aspect` of a pixel, and `matrix` (4, 4), camera to Blender's Z-up world.
    """
    to_camera = np.vstack([view.world_to_camera[:3], [0, 0, 0, 1.0]])
    across = view.fx / view.fy  # of a pixel's height, how wide it is not: Blender's are >= 1
    shift = (view.width / 2 - view.cx) / view.width, (view.cy - view.height / 2) / view.width
    return {
        "size": [view.width, view.height],
        "sensor": SENSOR,
        "lens": view.fx * SENSOR / view.width,
        "shift": [shift[0], shift[1] * across],
        "aspect": [max(1, 1 / across), max(1, across)],
        "matrix": (Z_UP @ np.linalg.inv(to_camera) @ LOOKS_BACK).tolist(),
    }


def pictures(blender: Path, asset: Path, views: list[View]) -> list[np.ndarray]:
    """Of every view two pictures (2, h, w, 3), by Blender. Raises InputError where it fails."""
    with tempfile.TemporaryDirectory() as folder:
        job = Path(folder) / "job.json"
        write_json(job, {"samples": SAMPLES, "views": [camera_of(view) for view in views]})
        command = [str(part) for part in (blender, RENDER, asset.resolve(), job, folder)]
        made = subprocess.run(command, capture_output=True, text=True)
        if made.returncode:
            raise InputError(
                f"Blender did not render it:\n{made.stderr[-2000:]}",
                asset,
                "--blender names a Python that has the module bpy",
            )
        read = lambda number, seed: read_exr(Path(folder) / f"{number}_{seed}.exr")
        return [np.stack([read(k, 0), read(k, 1)]) for k in range(len(views))]


def compared(made: list[np.ndarray], held_out: HeldOut, chosen: list[np.ndarray]) -> dict:
    """dB, mean over views, and the level of the pictures in the chosen pixels."""
    scores = [
        psnr(picture, photo, mask, again)
        for (picture, again), (_, photo, _), mask in zip(made, held_out, chosen)
    ]
    seen = sum(picture[0][mask].sum() for picture, mask in zip(made, chosen))
    shown = sum(photo[mask].sum() for (_, photo, _), mask in zip(held_out, chosen))
    return {"psnr": float(np.mean(scores)), "level": float(seen / shown)}


def version_of(blender: Path) -> str:
    ask = "import bpy; print('is', bpy.app.version_string)"
    said = subprocess.run([blender, "-c", ask], capture_output=True, text=True, check=True)
    return said.stdout.rpartition("is ")[2].strip()


def beside_photos(made: list[np.ndarray], held_out: HeldOut) -> np.ndarray:
    """A sheet (h, w, 3) of photos and pictures, black beside the masks."""
    rows = []
    for two, (_, photo, mask) in zip(made, held_out):
        inside = np.where(mask[..., None], [photo, two.mean(0)], 0)
        rows.append(cropped([to_srgb8(image) for image in inside], mask))
    return below_each_other(rows)


def row(work: Path, exports: Path, blender: Path, erode: float, sheets: Path | None) -> dict:
    observations = Observations(work / "observe", work / "poses" / "cameras.json")
    photos = SimpleNamespace(observations=observations)
    held_out = held_out_photos(photos, work / "poses", work / "mesh", erode)
    pixels = read_json(lit_samples(work)[0] / "refine.json")["held_out_pixels"]
    chosen = scored_pixels(held_out, pixels)

    found = {"scene": work.name, "version": version_of(blender)}
    for asset in sorted((exports / work.name).glob("*.usda")):
        made = pictures(blender, asset, [view for view, _, _ in held_out])
        found[asset.stem] = compared(made, held_out, chosen)
        if sheets and asset.stem == MEAN:
            write_png(sheets / f"{work.name}.jpg", beside_photos(made, held_out))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--work", type=Path, nargs="+", required=True, metavar="work/SCENE")
    parser.add_argument("--exports", type=Path, default=Path("exports"))
    parser.add_argument("--blender", type=Path, required=True, help="a Python that has bpy")
    parser.add_argument(
        "--erode", type=float, default=Observe().erode, help="the scene's observe.erode"
    )
    parser.add_argument("--out", type=Path, help="JSON file for all rows")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="for sheets to look at")
    args = parser.parse_args()

    rows = []
    for work in args.work:
        rows.append(row(work, args.exports, args.blender, args.erode, args.pictures))
        print(json.dumps(rows[-1]), flush=True)
    if args.out:
        write_json(args.out, {"machine": machine(), "rows": rows})


if __name__ == "__main__":
    run_stage(main)
