"""Report: one self-contained HTML page with inputs, geometry, samples, spread and timings."""

from pathlib import Path

from pipeline.base.files import report_metrics
from pipeline.run.stage import Stage, stage


def work(s: Stage) -> None:
    from pipeline.report.make import make_report

    metrics = make_report(s.args.work, Path(s.args.usd), s.out, s.scene)
    report_metrics(s.args.work / "report.json", metrics | s.costs())


if __name__ == "__main__":
    stage(
        __doc__,
        {"work": "folder of the scene's stages (work/<scene>)", "usd": "the exported .usda"},
        work,
    )
