"""Fit: a point estimate of light and materials together (DPI, Eq. 15)."""

from pipeline.base.files import report_metrics, stage_folder
from pipeline.run.stage import PROBLEM_FOLDERS, Stage, stage


def work(s: Stage) -> None:
    from pipeline.base.runtime import set_threads
    from pipeline.posterior.fit import fit
    from pipeline.posterior.load import load_problem

    set_threads(s.args.threads)
    with stage_folder(s.out) as out:
        problem = load_problem(
            *s.problem_folders,
            s.scene,
            s.scene.fit.texture,
            s.scene.render.light_height,
        )
        best, facts = fit(problem, s.scene.fit)
        best.save(out)
        report_metrics(out / "fit.json", facts | s.costs())


if __name__ == "__main__":
    stage(
        __doc__,
        PROBLEM_FOLDERS,
        work,
    )
