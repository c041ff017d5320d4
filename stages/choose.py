"""Choose: how much model the scene needs, decided from its photos and its surface. With
`choose: {enabled: false}` everything stays as configured.
"""

from pipeline.base.files import report_metrics, stage_folder
from pipeline.run.stage import PROBLEM_FOLDERS, Stage, stage


def work(s: Stage) -> None:
    from pipeline.posterior.check_settings import check_settings
    from pipeline.posterior.choose.chosen import Chosen, nothing_chosen

    check_settings(s.scene.sample)  # rows of the light are chosen from those that are possible
    with stage_folder(s.out, "choose.json") as out:
        if s.scene.choose.enabled:
            # loaded here, for scenes without decisions need none of it
            from pipeline.posterior.choose.decide import Evidence, choose

            found = choose(Evidence(*s.problem_folders), s.scene)
        else:
            found = nothing_chosen()
        Chosen(found["settings"]).save(out)
        report_metrics(out / "choose.json", found | s.costs())


if __name__ == "__main__":
    stage(__doc__, PROBLEM_FOLDERS, work)
