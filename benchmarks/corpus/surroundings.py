"""Cases of the machine: full disk, unwritable folders, missing libraries, killed jobs."""

from __future__ import annotations

from benchmarks.corpus.case import message, result
from benchmarks.corpus.mounts import full, read_only
from benchmarks.corpus.photos import right
from benchmarks.corpus.project import Project

GROUP = "machine"
TO_MESH = ("capture", "poses", "masks", "mesh")


def nothing(p: Project) -> None:
    """A good project: what is bad is around it."""


message(GROUP, "disk full in capture", "full", "work/s", inside=full("work/s", 24))(nothing)


message(GROUP, "work/ can be read only", "work/s", "written", inside=read_only("work"))(nothing)
message(
    GROUP,
    "no LLVM library",
    "LLVM",
    "DRJIT_LIBLLVM_PATH",
    stages=TO_MESH,
    surroundings={"DRJIT_LIBLLVM_PATH": "/nowhere/libLLVM.so"},
)(nothing)
message(
    GROUP,
    "another library for LLVM",
    "LLVM",
    "DRJIT_LIBLLVM_PATH",
    stages=TO_MESH,
    surroundings={"DRJIT_LIBLLVM_PATH": "/lib/x86_64-linux-gnu/libc.so.6"},
)(nothing)


@result(GROUP, "what a killed job has left behind", right)
def killed(p: Project) -> None:
    left = p.work / ".partial-capture"
    left.mkdir(parents=True)
    (left / "photos.json").write_text('{"half')


def damaged(stage: str, file: str, reader: str) -> None:
    """A stage's result cut in the middle after the fact; `reader` must name it."""

    def spoil(p: Project) -> None:
        p.cut_after[stage] = file

    message(GROUP, f"{stage}/{file} cut in the middle", file, stages=(*before(reader), reader))(
        spoil
    )


def before(stage: str) -> tuple[str, ...]:
    order = ("capture", "poses", "masks", "mesh", "atlas", "observe")
    return order[: order.index(stage)]


damaged("capture", "photos.json", "poses")
damaged("capture", "images/p0.exr", "poses")
damaged("capture", "saturated/p0.png", "poses")
damaged("capture", "masks/p0.png", "poses")
damaged("poses", "cameras.json", "masks")
damaged("poses", "images/p1.exr", "masks")
damaged("poses", "masks/p1.png", "masks")
damaged("masks", "masks/p1.png", "mesh")
damaged("mesh", "mesh.ply", "atlas")
damaged("atlas", "mesh_uv.ply", "observe")
