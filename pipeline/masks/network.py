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

SIDE = 1024  # pixels of the network's input and output


def network_masks(poses: Path, rig: Rig, settings: Masks, threads: int) -> tuple[dict, dict]:
    """Photo name -> mask (h, w) bool by the network `masks.onnx_model`, and facts. Its input is (1,
    3, 1024, 1024), (rgb - 128) / 256; its output a saliency of that size.

    Raises InputError when the network or onnxruntime is missing.
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
    name_of_input = session.get_inputs()[0].name

    out = {}
    for v in progress(rig.views, "masks by network"):
        photo = to_srgb8(read_exr(poses / v.image))
        pixels = (cv2.resize(photo, (SIDE, SIDE)).astype(np.float32) - 128) / 256
        saliency = session.run(None, {name_of_input: pixels.transpose(2, 0, 1)[None]})[0].squeeze()

        span = max(float(saliency.max() - saliency.min()), 1e-6)
        saliency = ((saliency - saliency.min()) / span).astype(np.float32)
        out[v.name] = cv2.resize(saliency, (v.width, v.height)) > 0.5
    return out, {"why": f"asked for; network {settings.onnx_model.name}"}
