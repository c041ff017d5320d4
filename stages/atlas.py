"""Atlas: one UV set in [0, 1]^2 without overlaps; a valid given one is kept."""

from pipeline.base.files import json_entry, report_metrics, stage_folder
from pipeline.run.stage import Stage, stage


def work(s: Stage) -> None:
    from pipeline.surface.atlas import make_atlas

    with stage_folder(s.out) as out:
        metrics = make_atlas(s.args.mesh / "mesh.ply", out, s.scene.atlas)
        known = {
            "normal_error": json_entry(s.args.mesh / "mesh.json", "normal_error")
        }  # the sampler asks for it (posterior/load.py)
        report_metrics(out / "atlas.json", metrics | known | s.costs())


if __name__ == "__main__":
    stage(__doc__, {"mesh": "folder of the mesh stage"}, work)
