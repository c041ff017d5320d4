"""Refine: one sample's materials at full texture size, with the light's shape held (DPI, Eq. 17);
how it predicts photos that its base colours are not made from, and photos that were held out.
"""

from pipeline.base.files import report_metrics, stage_folder
from pipeline.run.stage import CHOSEN_FOLDER, PROBLEM_FOLDERS, Stage, stage

SCORE_UNITS = 5  # progress: scoring a view takes as long as so many of Adam's steps


def work(s: Stage) -> None:
    from pipeline.base.progress import Bar
    from pipeline.geometry.mesh_io import load_mesh
    from pipeline.posterior.choose.chosen import chosen_scene
    from pipeline.posterior.draw_facts import DrawFacts
    from pipeline.posterior.judge import judge
    from pipeline.posterior.load import load_problem
    from pipeline.posterior.refine import refine, units
    from pipeline.posterior.textures import seen_texels
    from pipeline.render.metrics import held_out_photos, score_held_out
    from pipeline.render.renderer import Explanation
    from pipeline.render.surface_texels import SurfaceTexels

    scene = chosen_scene(s.scene, s.args.choose)
    settings = scene.refine
    with stage_folder(s.out, "refine.json") as out:
        sample = Explanation.load(s.args.sample)
        rows = sample.light.shape[0]
        problem = load_problem(*s.problem_folders, scene, settings.texture, rows)
        held_out = held_out_photos(problem, s.args.poses, s.args.mesh, scene.observe.erode)
        drawn = DrawFacts.load(s.args.sample).scale_drawn

        index = s.args.index
        total = units(settings) + SCORE_UNITS * len(held_out)
        with Bar(f"refine {index}", total) as bar:
            refined, facts = refine(problem, sample, settings, index, bar, drawn)
            scores = score_held_out(
                problem,
                refined,
                held_out,
                settings.score_pixels,
                settings.score_spp,
                lambda: bar.step("held-out views", SCORE_UNITS),
            )
            refined.save(out)
            judge(problem, refined, settings).save(out)
            shown = seen_texels(problem.observations.uv, settings.texture)
            SurfaceTexels.of(load_mesh(problem.renderer.mesh), shown).save(out)
        report_metrics(out / "refine.json", {"index": index} | facts | scores | s.costs())


if __name__ == "__main__":
    stage(
        __doc__,
        {
            **PROBLEM_FOLDERS,
            **CHOSEN_FOLDER,
            "sample": "folder of the sample",
        },
        work,
        lambda parser: parser.add_argument("--index", type=int, required=True, help="which sample"),
    )
