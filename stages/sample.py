"""Sample: one posterior draw of light and materials. Independent of every other sample."""

from pipeline.base.files import report_metrics, stage_folder
from pipeline.run.stage import CHOSEN_FOLDER, PROBLEM_FOLDERS, Stage, stage


def work(s: Stage) -> None:
    from pipeline.posterior.check_settings import check_settings
    from pipeline.posterior.choose.chosen import chosen_scene
    from pipeline.posterior.draw_facts import DrawFacts
    from pipeline.posterior.load import load_problem
    from pipeline.posterior.samplers import SAMPLERS
    from pipeline.prior.load import load_prior
    from pipeline.render.renderer import Explanation

    scene = chosen_scene(s.scene, s.args.choose)
    settings = scene.sample
    check_settings(settings)  # again: light may be what the choose stage has chosen
    prior = load_prior(settings.prior)
    with stage_folder(s.out, "sample.json") as out:
        problem = load_problem(
            *s.problem_folders,
            scene,
            settings.texture,
            prior.height,
        )
        sampler = SAMPLERS[settings.method]
        drawn, facts = sampler(problem, prior, Explanation.load(s.args.fit), settings, s.args.index)
        unused = {}
        if problem.observations.surroundings.sightings and not sampler.looks_at_the_light:
            unused = {"sightings": f"{settings.method} knows of them by its start only"}
        drawn.save(out)
        DrawFacts(sampler.scale_drawn).save(out)
        report_metrics(
            out / "sample.json",
            {"index": s.args.index, "method": settings.method} | facts | unused | s.costs(),
        )


if __name__ == "__main__":
    stage(
        __doc__,
        {
            **PROBLEM_FOLDERS,
            **CHOSEN_FOLDER,
            "fit": "folder of the fit stage",
        },
        work,
        lambda parser: parser.add_argument(
            "--index", type=int, required=True, help="which sample: its seed"
        ),
    )
