"""Refine: one sample's materials at full texture size, with the light's shape held (DPI, Eq. 17);
held-out score.
"""

from pipeline.base.files import read_json, report_metrics, stage_folder
from pipeline.run.stage import PROBLEM_FOLDERS, Stage, stage


def work(s: Stage) -> None:
    from pipeline.base.runtime import set_threads
    from pipeline.posterior.load import load_problem
    from pipeline.posterior.refine import COARSE, refine
    from pipeline.render.metrics import score_held_out
    from pipeline.render.renderer import Explanation

    set_threads(s.args.threads)
    settings = s.scene.refine
    with stage_folder(s.out) as out:
        sample = Explanation.load(s.args.sample)
        rows = sample.light.shape[0]
        problem = load_problem(*s.problem_folders, s.scene, settings.texture, rows)
        small = load_problem(*s.problem_folders, s.scene, min(COARSE, settings.texture), rows)
        drawn = read_json(s.args.sample / "sample.json").get("scale_drawn", False)
        refined, facts = refine(problem, small, sample, settings, s.args.index, rescale=not drawn)
        refined.save(out)
        scores = score_held_out(
            problem,
            refined,
            s.args.poses,
            s.args.mesh,
            s.scene.observe.erode,
            2 * s.scene.report.spp,
        )
        report_metrics(out / "refine.json", {"index": s.args.index} | facts | scores | s.costs())


if __name__ == "__main__":
    stage(
        __doc__,
        {
            **PROBLEM_FOLDERS,
            "sample": "folder of the sample",
        },
        work,
        lambda parser: parser.add_argument("--index", type=int, required=True, help="which sample"),
    )
