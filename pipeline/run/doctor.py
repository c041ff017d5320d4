"""`heliograph doctor`: is everything there, and does it work? Plain words, one line each."""

from __future__ import annotations

import os
import pkgutil
import shutil
import sys
from collections.abc import Callable
from importlib import import_module, metadata

import pipeline
import stages
from pipeline import __version__
from pipeline.base import runtime

STACK = (
    "drjit",
    "flip-evaluator",
    "Jinja2",
    "karellen-llvm-core",
    "libusb-package",
    "mitsuba",
    "numba",
    "numpy",
    "open3d",
    "opencv-python-headless",
    "OpenEXR",
    "pi-heif",
    "pillow",
    "psutil",
    "pycolmap",
    "pydantic",
    "pymeshlab",
    "PyYAML",
    "safetensors",
    "scikit-image",
    "scipy",
    "snakemake",
    "threadpoolctl",
    "torch",
    "usd-core",
    "xatlas",
)
# packages that the code imports where it needs them, or runs as a program
LATE = ("OpenEXR", "pi_heif", "pycolmap", "pymeshlab", "snakemake.cli")


def versions() -> list[tuple[bool, str]]:
    out = []
    for name in STACK:
        try:
            out.append((True, f"{name} {metadata.version(name)}"))
        except metadata.PackageNotFoundError:
            out.append((False, f"{name} is missing: pip install --no-deps -r requirements.lock"))
    return out


def render() -> str:
    """Render 8x8 pixels and differentiate them; returns what was found."""
    import drjit as dr

    from pipeline.base.runtime import mitsuba as mi

    scene = mi.load_dict(
        {
            "type": "scene",
            "light": {"type": "constant"},
            "ball": {"type": "sphere"},
            "integrator": {"type": "prb"},
            "sensor": {
                "type": "perspective",
                "fov": 30.0,
                "film": {"type": "hdrfilm", "width": 8, "height": 8},
                "to_world": mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
            },
        }
    )
    params = mi.traverse(scene)
    key = next(k for k in params.keys() if "reflectance" in k)
    dr.enable_grad(params[key])
    params.update()
    image = mi.render(scene, params, spp=16)
    dr.backward(dr.mean(image, axis=None))
    value = float(dr.mean(image, axis=None).array[0])
    if not (0.1 < value < 2 and dr.any(dr.grad(params[key]) != 0)):
        raise RuntimeError(f"the test picture is wrong: mean {value}")
    return (
        f"Mitsuba renders 8x8 pixels and their gradient (LLVM: {runtime.llvm_path()}, "
        f"{dr.thread_count()} threads)"
    )


def attempt(work: Callable[[], str], cure: str) -> tuple[bool, str]:
    """Run a check whose failure must be reported, whatever it is."""
    try:
        return True, work()
    except Exception as error:  # not hidden: it is what the doctor prints
        return False, f"{type(error).__name__}: {error}\n     what to do: {cure}"


def modules() -> str:
    """Import every module of Heliograph and what those import: a library that lacks one of its own
    fails here. Python keeps what it compiles on the way, so that no stage compiles it again.
    """
    found = [
        module.name
        for package in (pipeline, stages)
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
    ]
    for name in [*found, *LATE]:
        import_module(name)
    return f"all {len(found)} modules of Heliograph import"


def memory() -> str:
    import psutil

    free = shutil.disk_usage(".").free / 2**30
    total = psutil.virtual_memory().total / 2**30
    if total < 6 or free < 2:
        raise RuntimeError(
            f"{total:.1f} GiB of memory and {free:.1f} GiB of disk: 6 and 2 are needed"
        )
    return f"{os.cpu_count()} processors, {total:.1f} GiB of memory, {free:.0f} GiB of disk free"


def weights() -> str:
    from pipeline.prior.load import load_prior
    from pipeline.prior.locate import known_priors

    loaded = {name: load_prior(name) for name in known_priors()}
    if not loaded:
        raise RuntimeError("there are no weights under weights/")
    return "light priors load: " + ", ".join(
        f"{name} {prior.height}x{prior.width}" for name, prior in loaded.items()
    )


def writable() -> str:
    if not os.access("exports", os.W_OK):
        raise RuntimeError(
            "the folder exports/ cannot be written to (or this is not the project's top folder)"
        )
    return "exports/ can be written to"


def doctor() -> bool:
    """Print the findings; True when nothing is missing."""
    findings = [
        (sys.version_info >= (3, 11), f"heliograph {__version__}, Python {sys.version.split()[0]}")
    ] + versions()
    findings += [
        attempt(
            render,
            "pip install --no-deps -r requirements.lock, or set DRJIT_LIBLLVM_PATH to a libLLVM.so "
            "of version 19 or newer",
        ),
        attempt(
            lambda: f"open3d imports: {runtime.import_open3d().__version__}",
            "pip install libusb-package",
        ),
        attempt(modules, "pip install --no-deps -r requirements.lock"),
        attempt(weights, "check out weights/ again"),
        attempt(memory, "use another machine or the draft preset"),
        attempt(writable, "cd into the project; chmod u+w exports"),
    ]
    for good, text in findings:
        print(f"{'ok  ' if good else 'MISSING'} {text}")
    return all(good for good, _ in findings)
