"""Fit: a point estimate of light and materials together (DPI, Eq. 15)."""

from pipeline.base.files import report_metrics, stage_folder
from pipeline.run.stage import CHOSEN_FOLDER, PROBLEM_FOLDERS, Stage, stage


def work(s: Stage) -> None:
    from pipeline.posterior.choose.chosen import chosen_scene
    from pipeline.posterior.fit import fit
    from pipeline.posterior.load import load_problem

    scene = chosen_scene(s.scene, s.args.choose)
    with stage_folder(s.out, "fit.json") as out:
        problem = load_problem(
            *s.problem_folders,
            scene,
            scene.fit.texture,
            scene.render.light_height,
        )
        best, facts = fit(problem, scene.fit)
        best.save(out)
        report_metrics(out / "fit.json", facts | s.costs())


if __name__ == "__main__":
    stage(
        __doc__,
        PROBLEM_FOLDERS | CHOSEN_FOLDER,
        work,
    )
