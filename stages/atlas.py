"""Atlas: one UV set in [0, 1]^2 without overlaps; a valid given one is kept. And the normal map of
what decimation took from the surface.
"""

from pipeline.base.files import report_metrics, stage_folder
from pipeline.run.stage import Stage, stage


def work(s: Stage) -> None:
    from pipeline.surface.atlas import make_atlas
    from pipeline.surface.bake import make_normal_map

    with stage_folder(s.out, "atlas.json") as out:
        metrics = make_atlas(s.args.mesh / "mesh.ply", out, s.scene.atlas)
        metrics |= make_normal_map(s.args.mesh, out, s.scene.atlas)
        report_metrics(out / "atlas.json", metrics | s.costs())


if __name__ == "__main__":
    stage(__doc__, {"mesh": "folder of the mesh stage"}, work)
