"""Report: one self-contained HTML page with inputs, geometry, samples, spread and timings."""

from pathlib import Path

from pipeline.base.files import report_metrics
from pipeline.base.manifest import NAME, write_manifest
from pipeline.run.stage import Stage, stage


def work(s: Stage) -> None:
    from pipeline.posterior.choose.chosen import chosen_scene
    from pipeline.report.make import make_report

    scene = chosen_scene(s.scene, s.args.work / "choose")
    metrics = make_report(s.args.work, Path(s.args.usd), s.out, scene)
    report_metrics(s.args.work / "report.json", metrics | s.costs())
    write_manifest(s.args.work / f".report{NAME}", [s.args.work / "report.json", s.out])


if __name__ == "__main__":
    stage(
        __doc__,
        {"work": "folder of the scene's stages (work/<scene>)", "usd": "the exported .usda"},
        work,
    )
