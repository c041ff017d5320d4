"""Sample: one posterior draw of light and materials. Independent of every other sample."""

from pipeline.base.files import report_metrics, stage_folder
from pipeline.run.stage import PROBLEM_FOLDERS, Stage, stage


def work(s: Stage) -> None:
    from pipeline.base.errors import InputError, nearest
    from pipeline.base.runtime import set_threads
    from pipeline.posterior.load import load_problem
    from pipeline.posterior.samplers import SAMPLERS
    from pipeline.prior.load import load_prior
    from pipeline.render.renderer import Explanation

    settings = s.scene.sample
    if settings.method not in SAMPLERS:
        raise InputError(
            f"unknown sampler '{settings.method}'",
            "sample.method",
            nearest(settings.method, SAMPLERS),
        )
    prior = load_prior(settings.prior)
    # one thread: sums in a fixed order, so sample k is bit-identical anywhere
    set_threads(s.args.threads)
    with stage_folder(s.out) as out:
        problem = load_problem(
            *s.problem_folders,
            s.scene,
            settings.texture,
            prior.height,
        )
        drawn, facts = SAMPLERS[settings.method](
            problem, prior, Explanation.load(s.args.fit), settings, s.args.index
        )
        drawn.save(out)
        report_metrics(
            out / "sample.json",
            {"index": s.args.index, "method": settings.method} | facts | s.costs(),
        )


if __name__ == "__main__":
    stage(
        __doc__,
        {
            **PROBLEM_FOLDERS,
            "fit": "folder of the fit stage",
        },
        work,
        lambda parser: parser.add_argument(
            "--index", type=int, required=True, help="which sample: its seed"
        ),
    )
