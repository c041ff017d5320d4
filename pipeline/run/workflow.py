"""What the Snakefile needs to know about scenes, so that Snakemake re-runs what changed and nothing
else, and so that a scene's name is never read as a command.
"""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

from pipeline.base import manifest
from pipeline.base.config import SETTINGS_OF, Scene, configured, load_scene, slice_of
from pipeline.base.errors import InputError
from pipeline.base.locks import lock
from pipeline.photos.colmap_model import model_folder
from pipeline.photos.given_masks import mask_file
from pipeline.photos.scene_files import camera_file, cameras_given, find_photos
from pipeline.posterior.check_settings import check_settings
from pipeline.prior.locate import generator_files, prior_files
from pipeline.run.stage import overrides
from pipeline.run.times import not_from_the_future, settle_times

CONFIGS, WORK, EXPORTS = Path("configs"), Path("work"), Path("exports")
WAITS = "a killed run has left this job at work: waiting for its end"
LONGEST_NAME = 100  # bytes: file names are made of it, and file systems end at 255


def checked_name(name: str) -> str:
    """A scene's name, which is the stem of its configuration and becomes part of file names.

    Raises InputError for names that cannot be files (`/`, control characters, too long), that a
    command would take for an option (a leading `-`), that mean other folders or hidden files (a
    leading `.`), that Snakemake takes for a wildcard (braces), or that USD takes for a separator of
    folders (a backslash). Anything else may stand in a name, quotes, spaces and `$` too.
    """
    wrong = [c for c in name if c in "/\\{}" or not c.isprintable()]
    if not name or name[0] in ".-" or wrong or len(name.encode()) > LONGEST_NAME:
        raise InputError(
            f"'{name}' cannot be the name of a scene",
            CONFIGS,
            f"call it by at most {LONGEST_NAME} bytes without / \\ {{ }} and without . or - in "
            "front",
        )
    return name


def flattened(settings: dict, above: str = "") -> list[str]:
    """{"mesh": {"grid": 128}} -> ["mesh.grid=128"], the form that stages take.

    Texts are passed on as the user wrote them, in YAML.
    """
    out = []
    for key, value in settings.items():
        if isinstance(value, dict):
            out += flattened(value, f"{above}{key}.")
        else:
            text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
            out.append(f"{above}{key}={text}")
    return out


def literal(text: str) -> str:
    """`text` as one word of a shell command that Snakemake formats first."""
    return shlex.quote(text).replace("{", "{{").replace("}", "}}")


def _unfinished(scene: str, job: str) -> str:
    return f"{WORK}/{scene}/.unfinished/{job}"


def exported_files(scene: str) -> list[Path]:
    """What exports/ has of a scene beside its folder."""
    return [EXPORTS / f"{scene}{end}" for end in (".usda", ".usdz", "_report.html")]


def manifest_of(scene: str, job: str) -> Path:
    """Where a job notes the files that it has made."""
    if job in ("export", "report"):
        return WORK / scene / f".{job}{manifest.NAME}"
    stage, _, sample = job.partition("_")
    return WORK / scene / stage / sample / manifest.NAME


def unfinished_runs(scene: str, job: str) -> int:
    """How many runs of a job have begun and not come to their end, whether they failed or were
    killed, and one more where files that it has made are damaged. It is part of what decides that
    a job is due (see `stage_command`).
    """
    file = Path(_unfinished(scene, job))
    runs = file.stat().st_size if file.exists() else 0
    return runs + bool(manifest.damaged(manifest_of(scene, job)))


def note_damage(scene: str, job: str) -> None:
    """Count a job whose files are damaged as one that has not come to its end, from now on."""
    found = manifest.damaged(manifest_of(scene, job))
    if not found:
        return
    print(f"{scene}: {job} is made again: damaged since: {', '.join(found[:3])}", file=sys.stderr)
    file = Path(_unfinished(scene, job))
    file.parent.mkdir(parents=True, exist_ok=True)
    with open(file, "a") as mark:
        mark.write("\n")
    manifest.note_anew(manifest_of(scene, job))


def stage_command(stage: str, job: str, options: str, settings: list[str]) -> str:
    """The shell command of a stage as a template that Snakemake fills in; `:q` quotes what it fills
    in. Its log keeps everything, the terminal sees the progress.

    job: the stage's name, with the sample's number where there is one. options: further words of
    the command. settings: the user's overrides, key=value.

    The command adds a byte to the job's file of unfinished runs and takes it off when all is done
    (Snakemake's shell ends at the first failure). Without it a job that failed would be forgotten:
    Snakemake notes the new parameters of failed jobs too, and does not mind that a file in the
    middle of the chain is missing or old as long as the files made from it are there.

    It holds a lock on that file as long as it or the stage is alive: when Snakemake alone is killed
    its stage goes on, and the next run's must wait for it. That run is planned with the stage's
    byte, which therefore stays when Snakemake, the shell's parent, is dead.
    """
    mark = Path(_unfinished("{wildcards.scene:q}", job))
    overriding = "".join(f" --set {literal(setting)}" for setting in settings)
    return (
        f"mkdir -p {mark.parent}; exec 9>> {mark}; "
        f"flock -n 9 || {{{{ echo '{job}: {WAITS}' >&2; flock 9; }}}}; echo >> {mark}; "
        f"OMP_NUM_THREADS={{threads}} {literal(sys.executable)} -m stages.{stage} "
        f"--config {CONFIGS}/{{wildcards.scene:q}}.yaml{overriding} --threads {{threads}} "
        f"{options} 2>&1 | tee {{log:q}}; "
        f"if kill -0 $PPID 2> /dev/null; then truncate --size=-1 {mark}; fi"
    )


class Scenes:
    """Validated configurations of the scenes that targets ask for.

    settings: the user's overrides, nested. exclusive: whether to hold a lock on every scene that is
    asked for until the process ends, and to set right what has happened to its files; asked with
    each scene. Other scenes may be made in the same folder at the same time.
    """

    def __init__(self, settings: dict, exclusive: Callable[[], bool] = lambda: False):
        self.settings = flattened(settings)
        self.exclusive = exclusive
        self.loaded: dict[str, Scene] = {}
        self.locks: list = []

    def __call__(self, name: str) -> Scene:
        if name not in self.loaded:
            file = CONFIGS / f"{checked_name(name)}.yaml"
            scene = load_scene(file, overrides(self.settings))
            check_settings(scene.sample)
            if self.exclusive():
                self.locks.append(only_one_run(WORK / name / ".running"))
                settle_times([WORK / name, EXPORTS / name, *exported_files(name)])
            self.loaded[name] = scene
        return self.loaded[name]

    @staticmethod
    def known() -> list[str]:
        """Names of the scenes that have a configuration."""
        return sorted(file.stem for file in CONFIGS.glob("*.yaml"))

    def unfinished(self, name: str, job: str) -> int:
        """`unfinished_runs` of a scene's job. Where the job may be run, damage is noted first, so
        that the number stays the same when the job has repaired it.
        """
        self(name)
        if self.exclusive():
            note_damage(name, job)
        return unfinished_runs(name, job)

    def slice(self, name: str, *sections: str) -> str:
        """The values of those sections of a scene's configuration, as JSON."""
        return json.dumps(slice_of(self(name), *sections), sort_keys=True)

    def choosable(self, name: str) -> str:
        """What the choose stage reads of the settings that it may lower, as JSON; nothing where it
        is off, so that such a setting then makes due only the stages that take it.
        """
        scene = self(name)
        if not scene.choose.enabled:
            return ""
        values = {decision: configured(scene, decision) for decision in SETTINGS_OF}
        return json.dumps(values | {"drawn_on": scene.sample.texture}, sort_keys=True)

    def photos(self, name: str) -> list[str]:
        """Files that the capture stage reads: photos and the masks that were given for them."""
        folder = Path(self(name).photos)
        photos = [path for _, path, _ in self._found(name)]
        masks = [mask for path in photos if (mask := mask_file(folder, path))]
        return not_from_the_future(photos + masks)

    def order(self, name: str) -> str:
        """Photos in their order, which are for scoring only, and whether cameras are given, so that
        none may be left out: what the capture stage takes from given cameras beside the photos'
        paths.
        """
        photos = [[photo, split] for photo, _, split in self._found(name)]
        return json.dumps([photos, cameras_given(Path(self(name).photos))])

    def _found(self, name: str) -> list[tuple[str, Path, str]]:
        return find_photos(Path(self(name).photos))

    def cameras(self, name: str) -> list[str]:
        """Files with known cameras that the poses stage reads."""
        folder = Path(self(name).photos)
        given = [
            p for p in (camera_file(folder), folder / "transforms_test.json") if p and p.exists()
        ]
        model = model_folder(folder)
        return not_from_the_future(given + (sorted(model.glob("*.*")) if model else []))

    def held_out(self, name: str) -> float:
        """What the poses stage reads of the section observe: the share of photos kept for
        scoring.
        """
        return self(name).observe.held_out

    def network(self, name: str) -> list[str]:
        """The user's network that the masks stage runs, if it is asked for."""
        masks = self(name).masks
        return [str(masks.onnx_model)] if masks.method == "onnx" and masks.onnx_model else []

    def mesh(self, name: str) -> list[str]:
        """The given mesh, if there is one."""
        folder = Path(self(name).photos)
        found = [p for p in (folder / "mesh.ply", folder / "mesh.obj") if p.exists()]
        return not_from_the_future(found[:1])

    def priors(self, name: str) -> list[str]:
        """Weight files that the sample stage reads, every part of each."""
        sample = self(name).sample
        files = prior_files(sample.prior) + prior_files(sample.start_prior)
        files += generator_files(sample.method)
        here = Path.cwd()
        return [str(f.relative_to(here) if f.is_relative_to(here) else f) for f in files]


def only_one_run(path: Path) -> TextIO:
    """Hold a lock that the operating system releases when this process ends, however it ends;
    InputError if taken.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        return lock(path)
    except BlockingIOError as error:
        raise InputError(
            "another run is at work on this scene",
            path.parent,
            "wait for it, or stop it first; other scenes may be made at the same time",
        ) from error
