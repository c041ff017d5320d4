"""transforms.json (NeRF-synthetic, instant-ngp, nerfstudio), read and validated once."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from pipeline.base.errors import InputError

# by how much axes may differ from right angles and from one length: files are rounded
RIGID = 0.01
MOST_TURNED = 3.1  # radians; a pinhole's angle of view ends at pi
Real = Annotated[float, Field(allow_inf_nan=False)]
Row = tuple[Real, Real, Real, Real]
FORMAT = "see NeRF-synthetic's or nerfstudio's format"


class Intrinsics(BaseModel):
    """A lens, of all frames or of one: lengths in pixels, angle in radians; distortion as OpenCV's.
    What is None is said elsewhere, or not at all.
    """

    model_config = ConfigDict(extra="ignore", frozen=True)

    w: Annotated[Real, Field(gt=0)] | None = None
    h: Annotated[Real, Field(gt=0)] | None = None
    fl_x: Annotated[Real, Field(gt=0)] | None = None
    fl_y: Annotated[Real, Field(gt=0)] | None = None
    camera_angle_x: Annotated[Real, Field(gt=0)] | None = None
    cx: Real | None = None
    cy: Real | None = None
    k1: Real | None = None
    k2: Real | None = None
    k3: Real | None = None
    k4: Real | None = None
    k5: Real | None = None
    k6: Real | None = None
    p1: Real | None = None
    p2: Real | None = None
    camera_model: str = ""
    is_fisheye: bool = False

    @model_validator(mode="after")
    def _angle_in_radians(self) -> Intrinsics:
        angle = self.camera_angle_x
        if angle is not None and angle > MOST_TURNED:
            raise ValueError(f"camera_angle_x is {angle:g}: it is given in radians, below pi")
        return self


class Frame(Intrinsics):
    """A photo. transform_matrix: camera to world, OpenGL axes, Z-up world."""

    file_path: str
    transform_matrix: tuple[Row, Row, Row, Row] | None = None

    def camera_to_world(self, file: Path) -> np.ndarray:
        """The pose (4, 4), rigid: a scale of the axes, which says nothing about a camera, is taken
        off. Raises InputError where there is none or where it is no pose.
        """
        if self.transform_matrix is None:
            raise InputError(f"frame '{self.file_path}' has no 4x4 transform_matrix", file, AGAIN)

        pose = np.array(self.transform_matrix)
        fault = _fault(pose)
        if fault:
            raise InputError(f"the matrix of frame '{self.file_path}' {fault}", file, AGAIN)

        length = np.linalg.norm(pose[:3, :3], axis=0).mean()
        left, _, right = np.linalg.svd(pose[:3, :3] / length)
        pose[:3, :3] = left @ right
        return pose


AGAIN = "export the cameras again: transform_matrix is camera to world, 4x4, rigid"


class Transforms(Intrinsics):
    """The file's contents."""

    frames: list[Frame]


def _fault(pose: np.ndarray) -> str:
    """What is wrong with a matrix (4, 4) as a pose; empty where nothing is."""
    if np.abs(pose[3] - [0, 0, 0, 1]).max() > RIGID:
        return f"has the last row {pose[3].tolist()}, not 0 0 0 1: is it transposed?"

    axes = pose[:3, :3]
    length = np.linalg.norm(axes, axis=0).mean()
    if length < 1e-9:
        return "has no axes: they are all zero"
    if np.linalg.det(axes) < 0:
        return "is mirrored: its axes are left-handed"
    gram = axes.T @ axes / length**2
    if np.abs(gram - np.eye(3)).max() > RIGID:
        return "is not rigid: its axes differ in length, or are not at right angles"
    return ""


def read_transforms_file(file: Path) -> Transforms:
    """Read `file`. Raises InputError naming frame, key and fact."""
    try:
        data: Any = json.loads(file.read_text(encoding="utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid JSON ({error})", file, "export the cameras again") from error

    try:
        return Transforms.model_validate(data)
    except ValidationError as error:
        raise InputError(_explained(error, data), file, FORMAT) from error


def _explained(error: ValidationError, data: Any) -> str:
    """The first thing that pydantic found, with the frame's photo and what stands there."""
    first = error.errors()[0]
    where = list(first["loc"])
    photo = ""
    if len(where) > 1 and where[0] == "frames":
        frame = data["frames"][where[1]]
        photo = (
            f" ({frame['file_path']})" if isinstance(frame, dict) and "file_path" in frame else ""
        )
    key = ".".join(str(part) for part in where) or "the file"
    more = ""
    if "transform_matrix" in where and first["type"] in ("missing", "too_long", "tuple_type"):
        more = "; it must be 4x4"
    return f"{key}{photo}: {first['msg']} (it is {_short(first.get('input'))}){more}"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) < 60 else text[:57] + "..."
