"""Capture: photos as linear light at working size, with exposure undone and clipped values
known.
"""

from pathlib import Path

from pipeline.base.files import report_metrics, stage_folder
from pipeline.run.stage import Stage, stage


def work(s: Stage) -> None:
    from pipeline.photos.capture import capture

    with stage_folder(s.out, "capture.json") as out:
        metrics = capture(Path(s.scene.photos), out, s.scene.capture)
        report_metrics(out / "capture.json", metrics | s.costs())


if __name__ == "__main__":
    stage(__doc__, {}, work)
