"""Mutated files: a good project, some bytes of one file changed at random, the stages that read it.

python -m benchmarks.corpus.fuzz --seconds 300 --out fuzz.json [--first 0]

Every try has a seed of its own, so that a find can be made again (--first SEED --tries 1). A try is
a find if it ends otherwise than in a result or in one message, or changes a file of the user's.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from benchmarks.corpus.case import Case
from benchmarks.corpus.judge import ENDINGS, run
from benchmarks.corpus.models import write_binary, write_text
from benchmarks.corpus.photos import HEIC, eight_bit, instead, jpeg, write_channels
from benchmarks.corpus.project import Project, ball, picture
from benchmarks.scenes import machine
from pipeline.base import runtime
from pipeline.base.errors import run_stage
from pipeline.base.files import write_json
from pipeline.geometry.mesh_io import Mesh, save_mesh, unit

TO_POSES = ("capture", "poses")
TO_MESH = ("capture", "poses", "masks", "mesh")
MOST_CHANGES = 12
TOKENS = [b"0", b"-1", b"nan", b"1e999", b"[", b"}", b'"', b"\0", b"\xff" * 4, b"\n", b"../"]


def _jpeg(p: Project) -> Path:
    return instead(p, "p0.jpg", jpeg())


def _exr(p: Project) -> Path:
    path = instead(p, "p0.exr")
    write_channels(path, {"RGB": picture(0)[0]})
    return path


def _tiff(p: Project) -> Path:
    path = instead(p, "p0.tif")
    eight_bit().save(path)
    return path


def _ply(p: Project) -> Path:
    vertices, faces = ball()
    (p.scene / "mesh.obj").unlink()
    save_mesh(p.scene / "mesh.ply", Mesh(vertices, faces, unit(vertices)))
    return p.scene / "mesh.ply"


# reader -> which file of a project it reads (made where a good project has none), and the stages
READERS = {
    "PNG": (lambda p: p.images / "p0.png", ("capture",)),
    "JPEG": (_jpeg, ("capture",)),
    "TIFF": (_tiff, ("capture",)),
    "EXR": (_exr, ("capture",)),
    "HEIC": (lambda p: instead(p, "p0.heic", HEIC.read_bytes()), ("capture",)),
    "mask": (lambda p: p.masks / "p0.png", ("capture",)),
    "configuration": (lambda p: p.config, ("capture",)),
    "transforms.json": (lambda p: p.transforms, TO_POSES),
    "cameras.bin": (lambda p: write_binary(p) / "cameras.bin", TO_POSES),
    "images.bin": (lambda p: write_binary(p) / "images.bin", TO_POSES),
    "images.txt": (lambda p: write_text(p) / "images.txt", TO_POSES),
    "points3D.txt": (lambda p: write_text(p) / "points3D.txt", TO_POSES),
    "OBJ": (lambda p: p.scene / "mesh.obj", TO_MESH),
    "PLY": (_ply, TO_MESH),
}


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Some bytes changed, taken out, repeated, or replaced by a token; half of all changes near the
    beginning, where headers are.
    """
    out = bytearray(data)
    for _ in range(rng.integers(1, MOST_CHANGES)):
        reach = len(out) if rng.random() < 0.5 else min(len(out), 256)
        at = int(rng.integers(max(reach, 1)))
        kind = rng.integers(4)
        if kind == 0:
            out[at : at + 1] = rng.bytes(1)
        elif kind == 1:
            del out[at : at + int(rng.integers(1, 40))]
        elif kind == 2:
            out[at:at] = out[at : at + int(rng.integers(1, 40))]
        else:
            token = TOKENS[rng.integers(len(TOKENS))]
            out[at : at + len(token)] = token
    return bytes(out)


def attempt(seed: int, folder: Path) -> dict:
    """One try: reader, how it ended, and what was wrong (empty: nothing)."""
    rng = np.random.default_rng([71, seed])
    name = list(READERS)[seed % len(READERS)]
    file_of, stages = READERS[name]
    project = Project(folder)
    project.make()
    file = file_of(project)
    file.write_bytes(mutated(file.read_bytes(), rng))
    before = project.users_files()

    case = Case("fuzz", name, lambda p: None, timeout=60.0)
    log = project.work / "log.txt"
    log.parent.mkdir(parents=True, exist_ok=True)
    log.touch()
    status: int | None = 0
    for stage in stages:
        status, _ = run(case, project, stage, log)
        if status != 0:
            break
    happened = ENDINGS.get(status, f"exit status {status}")
    wrong = "" if happened in ("result", "message") else f"{happened} in {stage}"
    if project.users_files() != before:
        wrong = "a file of the user's was changed"
    text = log.read_text(encoding="utf-8", errors="replace").strip()
    said = text.splitlines()[-1:] if wrong else []
    return {"seed": seed, "reader": name, "happened": happened, "wrong": wrong, "said": said}


def _run() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60, help="no try begins later")
    parser.add_argument("--first", type=int, default=0, help="seed of the first try")
    parser.add_argument("--tries", type=int, default=10**9)
    parser.add_argument("--out", type=Path, required=True, help="JSON file")
    args = parser.parse_args()

    runtime.set_threads(1)
    start = time.monotonic()
    rows = []
    while time.monotonic() - start < args.seconds and len(rows) < args.tries:
        with tempfile.TemporaryDirectory(prefix="heliograph-fuzz-") as temporary:
            rows.append(attempt(args.first + len(rows), Path(temporary) / "p"))
        if rows[-1]["wrong"]:
            print(rows[-1], flush=True)

    finds = [row for row in rows if row["wrong"]]
    tries = Counter((row["reader"], row["happened"]) for row in rows)
    write_json(
        args.out,
        {
            "machine": machine(),
            "seconds": round(time.monotonic() - start, 1),
            "tries": len(rows),
            "rows": [
                {"reader": reader, "happened": happened, "tries": count}
                for (reader, happened), count in sorted(tries.items())
            ],
            "finds": finds,
        },
    )
    print(f"{len(rows)} tries, {len(finds)} finds")


if __name__ == "__main__":
    run_stage(_run)
