"""Enough: how many samples there shall be, by those that are there (`samples: auto`)."""

from pipeline.base.enough import FILE
from pipeline.base.files import report_metrics, stage_folder
from pipeline.run.stage import Stage, stage


def work(s: Stage) -> None:
    from pipeline.render.enough import judged
    from pipeline.render.samples import Samples

    with stage_folder(s.out, FILE) as out:
        folders = [s.args.refine / str(k) for k in range(s.args.index + 1)]
        found = judged(Samples(folders), s.scene.most_samples)
        report_metrics(out / FILE, found | s.costs())


if __name__ == "__main__":
    stage(
        __doc__,
        {"refine": "folder of the refined samples (work/<scene>/refine)"},
        work,
        lambda parser: parser.add_argument(
            "--index", type=int, required=True, help="the last of the samples that are judged"
        ),
    )
