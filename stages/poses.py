"""Poses: cameras given (transforms.json, COLMAP model) or found by structure from motion;
undistorted photos.
"""

from pathlib import Path

from pipeline.base.files import report_metrics, stage_folder
from pipeline.run.stage import Stage, stage


def work(s: Stage) -> None:
    from pipeline.photos.poses import make_poses

    with stage_folder(s.out, "poses.json") as out:
        metrics = make_poses(
            s.args.capture,
            Path(s.scene.photos),
            out,
            s.scene.poses,
            s.scene.observe,
            s.args.threads,
        )
        report_metrics(out / "poses.json", metrics | s.costs())


if __name__ == "__main__":
    stage(__doc__, {"capture": "folder of the capture stage"}, work)
