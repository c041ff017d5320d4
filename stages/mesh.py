"""Mesh: the object's closed, decimated surface (given, or hull and depth maps fused by how much
photos agree).
"""

from pathlib import Path

from pipeline.base.files import report_metrics, stage_folder
from pipeline.run.stage import Stage, stage


def work(s: Stage) -> None:
    from pipeline.surface.make import make_mesh

    with stage_folder(s.out, "mesh.json") as out:
        metrics = make_mesh(
            s.args.poses, s.args.masks, Path(s.scene.photos), out, s.scene.mesh, s.args.threads
        )
        report_metrics(out / "mesh.json", metrics | s.costs())


if __name__ == "__main__":
    stage(
        __doc__, {"poses": "folder of the poses stage", "masks": "folder of the masks stage"}, work
    )
