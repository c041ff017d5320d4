"""Masks: which pixels show the object (given, or found without any download)."""

from pipeline.base.files import report_metrics, stage_folder
from pipeline.run.stage import Stage, stage


def work(s: Stage) -> None:
    from pipeline.masks.make import make_masks

    with stage_folder(s.out, "masks.json") as out:
        metrics = make_masks(s.args.poses, out, s.scene.masks, s.args.threads)
        report_metrics(out / "masks.json", metrics | s.costs())


if __name__ == "__main__":
    stage(__doc__, {"poses": "folder of the poses stage"}, work)
