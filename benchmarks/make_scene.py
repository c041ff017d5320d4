"""Render a scene folder with known truth from a textured asset and a lat-long light.

python -m benchmarks.make_scene ASSET LIGHT.exr OUT [--relight A.exr B.exr] [--size 480] \\
    [--spp 64] [--views 16] [--test 4] [--seed 0]

ASSET is a folder with mesh.ply (Z-up, v up), base_color.png (sRGB), roughness.png and metallic.png;
transmission.png, where it is there, says what share of the light goes through the surface.
OUT gets images/, masks/, transforms.json, transforms_test.json and mesh.ply as docs/scene_folder.md
describes them (Z-up), and truth/, which no stage reads: envmap.exr, the light; linear/, what the
photos show before they are clipped and rounded; albedo/, roughness/ and metallic/ of every view;
relight/, the test views under the same light (<view>_self.exr) and under those of --relight.
linear/again/ and relight/<light>/again/ have the test views once more, rendered with noise of their
own, so that a score can leave the truth's noise out (pipeline.render.metrics.psnr). The photos are
exposed so that 3 % of the object is near clipping; truth/ has the lights at that exposure.

Frame of what is computed here: Y-up, the object at the origin.
"""

from __future__ import annotations

import argparse
import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.true_maps import FIELD_OF_VIEW, camera_positions, transform_matrix, write_truth
from pipeline.base.errors import InputError, run_stage
from pipeline.base.files import stage_folder
from pipeline.base.images import read_exr, to_srgb8, write_exr
from pipeline.base.progress import progress
from pipeline.base.runtime import mitsuba as mi
from pipeline.render.envmap import check_lat_long

ASSET_FILES = ("mesh.ply", "base_color.png", "roughness.png", "metallic.png")
TRANSMISSION = "transmission.png"  # of an asset that light goes through
MAX_DEPTH = 6  # path vertices after the camera
BRIGHT = 0.85  # what the object's 97th percentile is exposed to
PROBE_SIZE = 96  # pixels along a side of the pictures that exposure is measured on
PROBE_SPP = 32
MASK_SPP = 16
AGAIN = 500  # added to a picture's seed when it is rendered a second time


@dataclass
class Options:
    """size: pixels along a side; spp: paths per pixel; views, test: photos to fit, and to score."""

    size: int = 480
    spp: int = 64
    views: int = 16
    test: int = 4
    seed: int = 0


def sensor(position: np.ndarray, size: int):
    """Mitsuba's camera at `position` (3,), looking at the origin."""
    look = mi.ScalarTransform4f().look_at(origin=position.tolist(), target=[0, 0, 0], up=[0, 1, 0])
    film = {
        "type": "hdrfilm",
        "width": size,
        "height": size,
        "rfilter": {"type": "box"},
        "pixel_format": "rgb",
    }
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": FIELD_OF_VIEW,
            "fov_axis": "x",
            "to_world": look,
            "film": film,
            "sampler": {"type": "independent"},
        }
    )


def read_light(path: Path) -> np.ndarray:
    """Radiance (h, w, 3). Raises InputError when the file is missing, unreadable or no light.

    Not by Mitsuba: its reading and writing of EXR waits forever where Dr.Jit has one thread.
    """
    if not path.is_file():
        raise InputError("there is no such light", path, "give a lat-long .exr")
    return check_lat_long(read_exr(path), path)


def check_asset(asset: Path) -> None:
    """Raises InputError naming the first file that an asset lacks."""
    for name in ASSET_FILES:
        if not (asset / name).is_file():
            raise InputError(
                "the asset lacks this file", asset / name, f"put {', '.join(ASSET_FILES)} there"
            )


def load_scene(
    asset: Path, light: np.ndarray, turned: float = 0.0, more: dict[str, dict] | None = None
):
    """Mitsuba's scene of the asset, turned to Y-up, in a light (h, w, 3), which is turned about the
    vertical by so many degrees. more: further shapes of the scene, by name.
    """

    def texture(name: str, raw: bool) -> dict:
        return {"type": "bitmap", "filename": str(asset / name), "raw": raw}

    material = {
        "type": "principled",
        "base_color": texture("base_color.png", False),
        "roughness": texture("roughness.png", True),
        "metallic": texture("metallic.png", True),
        "specular": 0.5,
    }
    if (asset / TRANSMISSION).is_file():
        material["spec_trans"] = texture(TRANSMISSION, True)
    else:  # seen from within too, where the mesh has a hole
        material = {"type": "twosided", "b": material}
    mesh = {
        "type": "ply",
        "filename": str(asset / "mesh.ply"),
        "flip_tex_coords": True,
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], -90),
        "bsdf": material,
    }
    env = {"type": "envmap", "bitmap": mi.Bitmap(light.astype(np.float32))}
    if turned:
        env["to_world"] = mi.ScalarTransform4f().rotate([0, 1, 0], turned)
    return mi.load_dict({"type": "scene", "env": env, "obj": mesh, **(more or {})})


def render(scene, camera, spp: int, seed: int = 0) -> np.ndarray:
    """Path-traced picture (h, w, 3) on black."""
    paths = mi.load_dict({"type": "path", "max_depth": MAX_DEPTH, "hide_emitters": True})
    return np.array(mi.render(scene, sensor=camera, integrator=paths, spp=spp, seed=seed))


def exposed(asset: Path, light: np.ndarray, positions: np.ndarray):
    """The light at a photographer's exposure, the scene in it, and the factor. positions: of the
    cameras that exposure is measured with.
    """
    scene = load_scene(asset, light)
    probes = [render(scene, sensor(p, PROBE_SIZE), PROBE_SPP) for p in positions]
    shown = np.concatenate([probe[probe.sum(-1) > 0] for probe in probes])
    factor = BRIGHT / np.percentile(shown, 97)

    light = light * factor
    return light, load_scene(asset, light), float(factor)


def object_mask(scene, camera) -> np.ndarray:
    """Whether any of many rays through a pixel meets the object, (h, w)."""
    depth = mi.load_dict({"type": "aov", "aovs": "dd:depth"})
    return np.array(mi.render(scene, sensor=camera, integrator=depth, spp=MASK_SPP))[..., 0] > 0


def write_split(
    split: str, asset: Path, scene, positions: np.ndarray, options: Options, out: Path
) -> None:
    """Photos, masks, truth and transforms of the split "train" or "test"."""
    frames = []
    for k, position in enumerate(progress(positions, f"{split} views")):
        name = f"{split}_{k:03d}"
        camera = sensor(position, options.size)
        seed = k + 1000 * options.seed
        picture = render(scene, camera, options.spp, seed)
        mask = object_mask(scene, camera)

        Image.fromarray(to_srgb8(picture)).save(out / "images" / f"{name}.png")
        Image.fromarray((mask * 255).astype(np.uint8)).save(out / "masks" / f"{name}.png")
        write_truth(asset, position, options.size, out, name)
        write_exr(out / "truth" / "linear" / f"{name}.exr", picture)
        if split == "test":
            write_exr(out / "truth" / "relight" / f"{name}_self.exr", picture)
            again = render(scene, camera, options.spp, seed + AGAIN)
            write_exr(out / "truth" / "linear" / "again" / f"{name}.exr", again)
        frames.append(
            {
                "file_path": f"images/{name}.png",
                "mask_path": f"masks/{name}.png",
                "transform_matrix": transform_matrix(position),
            }
        )

    file = "transforms.json" if split == "train" else "transforms_test.json"
    angle = float(np.radians(FIELD_OF_VIEW))
    cameras = {"camera_angle_x": angle, "w": options.size, "h": options.size, "frames": frames}
    (out / file).write_text(json.dumps(cameras, indent=1), encoding="utf-8")


def write_relit(
    asset: Path, light: np.ndarray, name: str, positions: np.ndarray, options: Options, out: Path
) -> None:
    """The test views under another light, and that light, under truth/relight/."""
    light, scene, _ = exposed(asset, light, positions[:1])
    folder = out / "truth" / "relight" / name
    folder.mkdir()
    write_exr(folder.with_suffix(".exr"), light)
    for k, position in enumerate(progress(positions, f"under {name}")):
        camera = sensor(position, options.size)
        write_exr(folder / f"test_{k:03d}.exr", render(scene, camera, options.spp))
        again = render(scene, camera, options.spp, AGAIN)
        write_exr(folder / "again" / f"test_{k:03d}.exr", again)


def make_scene(asset: Path, light: Path, relights: list[Path], options: Options, out: Path) -> dict:
    """Write the scene folder `out`; returns its name and the exposure factor. Of the same bits
    whenever it is made, where Dr.Jit has one thread.

    Raises InputError when a file of the asset or a light is missing, or `out` holds something.
    """
    check_asset(asset)
    radiance = read_light(light)
    others = {path.stem: read_light(path) for path in relights}
    if out.exists() and any(out.iterdir()):
        raise InputError("the folder is not empty", out, "remove it or choose another name")

    train = camera_positions(options.views, options.seed)
    test = camera_positions(options.test, options.seed + 100, 5, 50)
    with stage_folder(out, "truth/envmap.exr") as folder:
        for name in ("images", "masks"):
            (folder / name).mkdir()
        for name in ("albedo", "roughness", "metallic", "relight"):
            (folder / "truth" / name).mkdir(parents=True)

        radiance, scene, factor = exposed(asset, radiance, train[:4])
        write_exr(folder / "truth" / "envmap.exr", radiance)
        write_split("train", asset, scene, train, options, folder)
        write_split("test", asset, scene, test, options, folder)
        for name, other in others.items():
            write_relit(asset, other, name, test, options, folder)
        shutil.copy(asset / "mesh.ply", folder / "mesh.ply")
    return {"out": out.name, "scale": factor}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("asset", type=Path)
    parser.add_argument("light", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--relight", type=Path, nargs="*", default=[])
    parser.add_argument("--size", type=int, default=480)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--views", type=int, default=16)
    parser.add_argument("--test", type=int, default=4)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()

    options = Options(args.size, args.spp, args.views, args.test, args.seed)
    print(json.dumps(make_scene(args.asset, args.light, args.relight, options, args.out)))


if __name__ == "__main__":
    run_stage(main)
