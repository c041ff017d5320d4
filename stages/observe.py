"""Observe: random pixels over all views in one table, with cached primary hits; some views held out
for scoring.
"""

from pipeline.base.files import report_metrics, stage_folder
from pipeline.run.stage import Stage, stage


def work(s: Stage) -> None:
    from pipeline.render.observe import make_observations

    with stage_folder(s.out, "observe.json") as out:
        metrics = make_observations(
            s.args.poses,
            s.args.mesh,
            s.args.atlas / "mesh_uv.ply",
            out,
            s.scene.observe,
            s.scene.poses,
        )
        report_metrics(out / "observe.json", metrics | s.costs())


if __name__ == "__main__":
    stage(
        __doc__,
        {
            "poses": "folder of the poses stage",
            "mesh": "folder of the mesh stage (final masks)",
            "atlas": "folder of the atlas stage",
        },
        work,
    )
