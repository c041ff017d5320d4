"""Optional back-end: a salient-object network (ISNet-like ONNX file) that the user has
installed.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from pipeline.base.config import Masks
from pipeline.base.errors import InputError
from pipeline.base.images import read_exr, to_srgb8
from pipeline.base.progress import progress
from pipeline.geometry.cameras import Rig


def network_masks(poses: Path, rig: Rig, settings: Masks, threads: int) -> tuple[dict, dict]:
    """name -> mask by `masks.onnx_model`: input (1, 3, 1024, 1024), (rgb - 128) / 256; output:
    saliency of that size.
    """
    if settings.onnx_model is None or not settings.onnx_model.exists():
        raise InputError(
            "masks.method is onnx but there is no such network",
            settings.onnx_model or "masks.onnx_model",
            "give the path of an ISNet .onnx file, or use masks.method: plane",
        )
    try:
        import onnxruntime
    except ImportError as error:
        raise InputError(
            "masks.method is onnx but onnxruntime is not installed",
            "masks.method",
            "pip install onnxruntime, or use masks.method: plane",
        ) from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(
        str(settings.onnx_model), options, providers=["CPUExecutionProvider"]
    )
    out = {}
    for v in progress(rig.views, "masks by network"):
        photo = to_srgb8(read_exr(poses / v.image))
        x = (cv2.resize(photo, (1024, 1024)).astype(np.float32) - 128) / 256
        y = session.run(None, {session.get_inputs()[0].name: x.transpose(2, 0, 1)[None]})[
            0
        ].squeeze()
        y = (y - y.min()) / max(float(y.max() - y.min()), 1e-6)
        out[v.name] = cv2.resize(y.astype(np.float32), (v.width, v.height)) > 0.5
    return out, {"why": f"asked for; network {settings.onnx_model.name}"}
