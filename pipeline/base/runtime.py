"""The run-time surroundings: LLVM for Dr.Jit, libusb for Open3D, threads. Imported before mitsuba,
always.

Dr.Jit's LLVM back-end loads libLLVM at run time. The PyPI package `karellen-llvm-core` puts a
recent one into the environment's prefix, so no system package and no root is needed. The versions
14 and 15, which a system may have, abort. Open3D links against the system library libusb-1.0; the
PyPI package `libusb-package` ships the same library, and loading it first satisfies the dynamic
linker.
"""

from __future__ import annotations

import ctypes
import importlib
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from threadpoolctl import threadpool_limits

from pipeline.base.errors import InputError

if TYPE_CHECKING:
    import numpy as np

VARIANT = "llvm_ad_rgb"


def llvm_path() -> Path | None:
    """The LLVM shared library that Dr.Jit will load: the user's DRJIT_LIBLLVM_PATH, else the
    environment's own.
    """
    if os.environ.get("DRJIT_LIBLLVM_PATH"):
        return Path(os.environ["DRJIT_LIBLLVM_PATH"])
    found = sorted(Path(sys.prefix, "lib").glob("libLLVM*.so*"), key=lambda p: len(p.name))
    return found[0] if found else None


def point_at_llvm() -> Path | None:
    """Set DRJIT_LIBLLVM_PATH if the user has not; Dr.Jit reads it when it is first imported."""
    path = llvm_path()
    if path is not None and path.exists():
        os.environ["DRJIT_LIBLLVM_PATH"] = str(path)
    return path


def _load_mitsuba() -> ModuleType:
    path = point_at_llvm()
    if path is None or not path.exists():
        raise InputError(
            "no LLVM library for Dr.Jit",
            path or Path(sys.prefix, "lib"),
            "run 'pip install --no-deps -r requirements.lock' in this environment, or point "
            "DRJIT_LIBLLVM_PATH at a libLLVM.so of version 19 or newer",
        )
    try:
        module = importlib.import_module("mitsuba")
        module.set_variant(VARIANT)
    except ImportError as error:
        raise InputError(
            f"Mitsuba, or its LLVM library, cannot be used ({error})",
            path,
            "point DRJIT_LIBLLVM_PATH at a libLLVM.so of version 19 or newer, or leave it unset",
        ) from error
    module.set_log_level(module.LogLevel.Error)
    return module


def __getattr__(name: str) -> ModuleType:
    """`from pipeline.base.runtime import mitsuba` loads Mitsuba on first use: it takes a second."""
    if name == "mitsuba":
        globals()[name] = _load_mitsuba()
        return globals()[name]
    raise AttributeError(name)


_rays = 0


def rays_made() -> int:
    """How many rays this process has given to Mitsuba so far: for a figure of cost. A path counts
    once, by its camera ray.
    """
    return _rays


def mitsuba_rays(origins: np.ndarray, directions: np.ndarray) -> Any:
    """Mitsuba rays of origins and directions (n, 3)."""
    import numpy as np

    global _rays
    _rays += len(origins)
    mi = importlib.import_module(__name__).mitsuba
    columns = lambda rows: np.ascontiguousarray(rows.T, np.float32)
    return mi.Ray3f(mi.Point3f(columns(origins)), mi.Vector3f(columns(directions)))


def import_open3d() -> ModuleType:
    """Open3D with its libusb dependency met. Raises InputError in plain words when it cannot be
    loaded.
    """
    try:
        ctypes.CDLL("libusb-1.0.so.0", mode=ctypes.RTLD_GLOBAL)
    except OSError:
        try:
            import libusb_package

            ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
        except (ImportError, OSError) as error:
            raise InputError(
                f"Open3D needs the library libusb-1.0 ({error})",
                "open3d",
                "pip install libusb-package, or install libusb-1.0-0 with the system's packages",
            ) from error
    try:
        return importlib.import_module("open3d")
    except (ImportError, OSError) as error:
        raise InputError(
            f"Open3D cannot be imported ({error})",
            "open3d",
            "pip install --no-deps -r requirements.lock in this environment",
        ) from error


def set_threads(count: int) -> None:
    """Give Dr.Jit, torch, OpenCV, numba and the BLAS of numpy and scipy `count` threads each, those
    that are loaded and those that are loaded later.

    Floating-point sums depend on the number of threads; a stage whose result must be bit-identical
    fixes it. A BLAS, torch and numba read the variables once, when they are loaded. Dr.Jit and
    OpenCV read none; they are loaded here, in a tenth of a second each.
    """
    for variable in (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMBA_NUM_THREADS",
    ):
        os.environ[variable] = str(count)
    threadpool_limits(count)

    import cv2

    cv2.setNumThreads(count)
    import drjit

    drjit.set_thread_count(count)
    if "torch" in sys.modules:
        import torch

        torch.set_num_threads(count)
