"""NeRF-synthetic (Mildenhall et al. 2020): transforms_{train,val,test}.json and RGBA pictures.

Facts, from the loader of the release (github.com/bmild/nerf, load_blender.py) and the files: poses
are camera to world, OpenGL axes, Z-up; camera_angle_x is horizontal, in radians, the same for all;
`file_path` has no suffix (.png); pictures are sRGB with straight alpha. The folder of test views
has depth and normal pictures too (<view>_depth_0001.png), which no score of ours reads. The set has
no light, no base colour and no views under another light.
"""

from __future__ import annotations

from pathlib import Path

from benchmarks.layouts.content import Content, Options, Shot, spaced
from benchmarks.layouts.transforms import angle_of, picture_of, read_cameras

CURE = "give the folder of one object, with transforms_train.json and transforms_test.json"
NOTE = "NeRF-synthetic has no light, no base colour and no relit views: only novel views are scored"


def shots(folder: Path, split: str, most: int | None) -> list[Shot]:
    """Views of transforms_<split>.json. Raises InputError naming what is missing or wrong."""
    file, cameras = read_cameras(folder, split, CURE)
    found = []
    for frame in spaced(cameras.frames, most):
        photo = picture_of(folder, frame.file_path, file, (".png",))
        pose, angle = frame.camera_to_world(file), angle_of(frame, cameras, file)
        found.append(Shot(f"{split}_{photo.stem}", photo, pose, angle))
    return found


def read(folder: Path, options: Options) -> Content:
    """Raises InputError naming what the folder lacks."""
    train = shots(folder, "train", options.train)
    test = shots(folder, options.held_out, options.test)
    return Content(train, test, notes=[NOTE])
