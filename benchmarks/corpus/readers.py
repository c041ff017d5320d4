"""The readers of the user's files, the good files that a fuzz begins with, and what is true of all
that they take for good.
"""

from __future__ import annotations

import contextlib
import io
import json
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageCms

from benchmarks.corpus.meshes import ply, quads
from benchmarks.corpus.models import write_binary, write_text
from benchmarks.corpus.photos import HEIC, eight_bit, exif, jpeg, write_channels
from benchmarks.corpus.project import HEIGHT, VIEWS, WIDTH, Project, ball, obj_text, picture
from pipeline.geometry.mesh_io import Mesh, save_mesh, unit

RIGID = 1e-6  # by how much a rotation that was read may miss one


@dataclass(frozen=True)
class Seed:
    """Good files, path -> bytes. spoil: the one that is changed; kind: "bytes", "text", "json" or
    "yaml", by which ways.
    """

    files: dict[str, bytes]
    spoil: str
    kind: str = "bytes"


@dataclass(frozen=True)
class Reader:
    """read(folder) reads what a seed's files became: it returns, or raises InputError, or has a
    defect. AssertionError: it took something for good that is not.
    """

    name: str
    seeds: Callable[[], list[Seed]]
    read: Callable[[Path], None]


@contextlib.contextmanager
def good_project() -> Iterator[Project]:
    """A project in a temporary place."""
    with tempfile.TemporaryDirectory(prefix="heliograph-fuzz-") as folder:
        project = Project(Path(folder) / "project")
        project.make()
        yield project


def saved(image: Image.Image, kind: str, **options) -> bytes:
    """A picture as a file of Pillow's format `kind`."""
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


# --- photos and masks --------------------------------------------------------------------------


def photo_seeds() -> list[Seed]:
    """A view as JPEG, PNG and TIFF of 8 and 16 bits, EXR and HEIC, beside two good photos."""
    deep = np.asarray(eight_bit(), np.uint16)[..., ::-1] * 257
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    profile = profile[:24] + bytes(12) + profile[36:]  # without the time at which it was made
    tags = exif(0, time=0.01, f_number=4.0, iso=100, focal_35mm=50, orientation=6)
    with tempfile.TemporaryDirectory(prefix="heliograph-fuzz-") as folder:
        exr = Path(folder) / "p0.exr"
        write_channels(exr, {"RGBA": np.dstack(picture(0)).astype(np.float16)})
        linear = exr.read_bytes()

    photos = [
        ("p0.jpg", jpeg(quality=80, exif=tags.tobytes())),
        ("p0.jpg", jpeg(quality=80, progressive=True, icc_profile=profile)),
        ("p0.png", saved(eight_bit(), "PNG", icc_profile=profile)),
        ("p0.png", cv2.imencode(".png", deep)[1].tobytes()),
        ("p0.tif", saved(eight_bit(), "TIFF", compression="tiff_lzw")),
        ("p0.tif", cv2.imencode(".tif", deep)[1].tobytes()),
        ("p0.exr", linear),
        ("p0.heic", HEIC.read_bytes()),
    ]
    others = {f"images/p{k}.png": saved(eight_bit(k), "PNG") for k in (1, 2)}
    return [Seed(others | {f"images/{n}": data}, f"images/{n}") for n, data in photos]


def read_photos(folder: Path) -> None:
    """The capture stage; every pixel is light."""
    from pipeline.base.config import Capture
    from pipeline.base.images import read_exr
    from pipeline.photos.capture import capture

    out = folder / "captured"
    out.mkdir()
    facts = capture(folder, out, Capture(max_size=128, leave_out="none"))
    assert facts["photos"] == 3, facts["photos"]
    for file in (out / "images").iterdir():
        pixels = read_exr(file)
        assert np.isfinite(pixels).all() and pixels.min() >= 0, f"{file.name} holds no light"


def mask_seeds() -> list[Seed]:
    mask = Image.fromarray(picture(0)[1] * np.uint8(255))
    rgba = mask.convert("RGBA")
    rgba.putalpha(mask)
    files = [
        ("p0.png", saved(mask, "PNG")),
        ("p0.png", saved(mask.convert("1"), "PNG")),
        ("p0.png", saved(mask.convert("P"), "PNG")),
        ("p0.png", saved(rgba, "PNG")),
        ("p0.png", saved(mask.convert("I;16"), "PNG")),
        ("p0.jpg", saved(mask, "JPEG", quality=90)),
    ]
    return [Seed({name: data}, name) for name, data in files]


def read_masks(folder: Path) -> None:
    from pipeline.photos.given_masks import read_mask

    for file in folder.iterdir():
        mask = read_mask(file, (WIDTH, HEIGHT))
        assert mask.shape == (HEIGHT, WIDTH) and mask.dtype == np.uint8, (mask.shape, mask.dtype)
        assert mask.max() >= 128, "black"


# --- cameras -----------------------------------------------------------------------------------


def transforms_seeds() -> list[Seed]:
    with good_project() as p:
        cameras = p.cameras()
    full = cameras | {"fl_y": 90.0, "cx": 36.0, "cy": 28.0, "k1": 0.01, "camera_model": "OPENCV"}
    full |= {"aabb_scale": 4, "applied_transform": [[1, 0, 0, 0]]}
    angle = {k: v for k, v in cameras.items() if k != "fl_x"} | {"camera_angle_x": 0.76}
    photos = {f"images/p{k}.png": b"only its name counts" for k in range(VIEWS)}
    texts = [json.dumps(data, indent=1).encode() for data in (cameras, full, angle)]
    return [Seed(photos | {"transforms.json": t}, "transforms.json", "json") for t in texts]


def read_cameras(folder: Path) -> None:
    from pipeline.photos.given_cameras import read_transforms
    from pipeline.photos.scene_files import find_photos

    sizes = {name: (WIDTH, HEIGHT) for name, _, _ in find_photos(folder)}
    check_cameras(read_transforms(folder / "transforms.json", folder, sizes))


def check_cameras(found: dict) -> None:
    """Every lens has numbers of a lens, every pose is a rotation and a finite place."""
    assert found, "no camera"
    for name, (lens, pose) in found.items():
        turn = pose[:3, :3]
        assert np.isfinite(pose).all(), f"{name}: a pose that is not finite"
        assert np.abs(turn @ turn.T - np.eye(3)).max() < RIGID, f"{name}: no rotation"
        assert np.linalg.det(turn) > 0, f"{name}: mirrored"
        numbers = (lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion)
        assert np.isfinite(numbers).all() and min(lens.fx, lens.fy) > 0, f"{name}: no lens"


def model_seeds() -> list[Seed]:
    """A COLMAP model as text and as binary files; each of the three files in turn."""
    out = []
    for write, kind in ((write_text, "text"), (write_binary, "bytes")):
        with good_project() as p:
            model = write(p)
            files = {f"sparse/0/{f.name}": f.read_bytes() for f in sorted(model.iterdir())}
        out += [Seed(files, name, kind) for name in files]
    return out


def read_model_of(folder: Path) -> None:
    from pipeline.photos.colmap_model import model_folder, names_of, read_model
    from pipeline.photos.given_cameras import poses_of_model

    where = model_folder(folder)
    assert where is not None
    model = read_model(where)
    photos = [{"name": f"p{k}", "file": f"images/p{k}.png"} for k in range(VIEWS)]
    check_cameras(poses_of_model(model, names_of(photos, model, where)))
    points = np.array([p.xyz for p in model.points3D.values()])
    assert np.isfinite(points).all(), "a point that is not finite"


# --- meshes ------------------------------------------------------------------------------------


def ply_seeds() -> list[Seed]:
    """A ball as binary PLY with normals and texture coordinates, and as ASCII PLY without."""
    vertices, faces = ball(6)
    with good_project() as p:
        ply(p, vertices, faces.tolist())
        text = (p.scene / "mesh.ply").read_bytes()
    binary = saved_mesh("mesh.ply", vertices, faces)
    return [Seed({"mesh.ply": binary}, "mesh.ply"), Seed({"mesh.ply": text}, "mesh.ply", "text")]


def obj_seeds() -> list[Seed]:
    """A ball as OBJ: with normals and texture coordinates; with quads and without both."""
    texts = [saved_mesh("mesh.obj", *ball(6)), obj_text(*quads()).encode()]
    return [Seed({"mesh.obj": text}, "mesh.obj", "text") for text in texts]


def saved_mesh(name: str, vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """A mesh with normals and texture coordinates as a file."""
    with tempfile.TemporaryDirectory(prefix="heliograph-fuzz-") as folder:
        file = Path(folder) / name
        save_mesh(file, Mesh(vertices, faces, unit(vertices), np.abs(vertices[:, :2])))
        return file.read_bytes()


def read_mesh(folder: Path) -> None:
    from pipeline.surface.given import read_given, set_right

    for path in folder.iterdir():
        mesh = set_right(read_given(path), path)
        assert np.isfinite(mesh.vertices).all(), "a vertex that is not finite"
        assert len(mesh.faces) and mesh.faces.min() >= 0, "corners"
        assert mesh.faces.max() < len(mesh.vertices), "corners"
        assert mesh.normals.shape == mesh.vertices.shape, mesh.normals.shape
        assert np.isfinite(mesh.normals).all(), "a normal that is not finite"
        assert mesh.uv is None or np.isfinite(mesh.uv).all(), "texture coordinates"


# --- configurations ----------------------------------------------------------------------------

CONFIG = b"""\
photos: photos
preset: draft
samples: 3
capture: {max_size: 800, encoding: auto, exposure: none}
masks:
  method: auto
mesh:
  grid: 96
  method: hull
fit: {pixels: 4096, spp: 16}
sample:
  points: 70
  guidance: 1.5
"""


def config_seeds() -> list[Seed]:
    return [
        Seed({"s.yaml": CONFIG}, "s.yaml", "yaml"),
        Seed({"s.yaml": b"photos: photos\n"}, "s.yaml", "yaml"),
    ]


def read_config(folder: Path) -> None:
    from pipeline.base.config import Scene, load_scene

    scene = load_scene(folder / "s.yaml")
    plain = scene.model_dump(mode="json")
    json.dumps(plain, allow_nan=False)
    assert Scene.model_validate(plain) == scene, "another one after a round trip"


READERS = (
    Reader("photo", photo_seeds, read_photos),
    Reader("mask", mask_seeds, read_masks),
    Reader("transforms.json", transforms_seeds, read_cameras),
    Reader("COLMAP model", model_seeds, read_model_of),
    Reader("PLY", ply_seeds, read_mesh),
    Reader("OBJ", obj_seeds, read_mesh),
    Reader("configuration", config_seeds, read_config),
)
