"""Cases of configurations and options: unknown, invalid, damaged, or not fit for each other."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.corpus.case import message, result
from benchmarks.corpus.photos import right
from benchmarks.corpus.project import Project

GROUP = "settings"
SAMPLE = ("choose", "sample")  # no scene chooses: what is configured holds


def config(text: str | bytes) -> Callable[[Project], None]:
    """Write configs/s.yaml."""

    def spoil(p: Project) -> None:
        p.config.write_bytes(text.encode() if isinstance(text, str) else text)

    return spoil


OK = "photos: photos\n"
REFUSED: list[tuple[str, str | bytes, tuple[str, ...]]] = [
    ("an unknown section", OK + "messh: {grid: 128}", ("messh", "mesh")),
    ("an unknown key", OK + "mesh: {gird: 128}", ("mesh.gird", "grid")),
    ("a value out of its range", OK + "mesh: {grid: 7}", ("mesh.grid", "48", "7")),
    ("a word for a number", OK + "samples: many", ("samples", "many")),
    ("a number for a section", OK + "mesh: 3", ("mesh", "3")),
    ("an empty section", OK + "mesh:", ("mesh", "None")),
    ("NaN", OK + "sample: {guidance: .nan}", ("sample.guidance", "nan")),
    ("infinity", OK + "poses: {object_size: .inf}", ("poses.object_size", "inf")),
    ("a number of 40 digits", OK + f"samples: 1{'0' * 39}", ("samples", "1000")),
    ("a trillion pixels a step", OK + "fit: {pixels: 1000000000000}", ("fit.pixels",)),
    ("an odd number of paths", OK + "fit: {spp: 3}", ("fit.spp", "3")),
    ("no photos", "samples: 2", ("photos",)),
    ("an empty name for the photos", "photos: ''", ("photos",)),
    ("a folder that does not exist", "photos: nowhere", ("nowhere", "does not exist")),
    ("a file for the folder", "photos: configs/s.yaml", ("configs/s.yaml",)),
    ("an unknown preset", OK + "preset: ultra", ("ultra", "draft")),
    ("a list for the preset", OK + "preset: [draft]", ("preset",)),
    ("an unknown mask method", OK + "masks: {method: magic}", ("masks.method", "magic")),
    ("a list instead of a mapping", "- photos\n- photos", ("s.yaml", "key: value")),
    ("nothing", "", ("s.yaml", "photos")),
    ("brackets that are not closed", OK + "mesh: {grid: [", ("s.yaml", "YAML")),
    ("tabs for indentation", OK + "mesh:\n\tgrid: 128", ("s.yaml", "YAML")),
    ("bytes that are no UTF-8", b"photos: \xff\xfe\x80", ("s.yaml",)),
    ("a day that does not exist", "photos: 2020-13-45", ("s.yaml",)),
    ("numbers for keys", OK + "1: 2\n3: 4", ("s.yaml", "1")),
    ("numbers for keys of a section", OK + "mesh: {1: 2}", ("s.yaml", "mesh.1")),
    ("10 000 brackets", "photos: " + "[" * 10_000, ("s.yaml",)),
    ("a billion laughs", "a: &a [x, x]\n" + OK, ("s.yaml", "'a'")),
    ("code in a tag", "photos: !!python/object/apply:os.system ['touch hacked']", ("s.yaml",)),
]
for _name, _text, _words in REFUSED:
    message(GROUP, _name, *_words)(config(_text))


@message(GROUP, "no such configuration", "s.yaml", "there is no such")
def no_file(p: Project) -> None:
    p.config.unlink()


@message(GROUP, "a folder for a configuration", "s.yaml")
def folder_for_file(p: Project) -> None:
    p.config.unlink()
    p.config.mkdir()


@result(GROUP, "a byte order mark before it", right)
def byte_order_mark(p: Project) -> None:
    p.config.write_text(OK, encoding="utf-8-sig")


def option(name: str, *words: str, options: tuple[str, ...]) -> None:
    """A case of the command line, with a good project."""
    message(GROUP, name, *words, options=options)(lambda p: None)


option("--set without a value", "--set", "mesh.grid", options=("--set", "mesh.grid"))
option("--set with broken YAML", "--set", "mesh.grid", options=("--set", "mesh.grid={"))
option("--set below a number", "samples", options=("--set", "samples=2", "--set", "samples.a=1"))
option("--set of a day that does not exist", "samples", options=("--set", "samples=2020-13-45"))
option("no threads", "--threads", options=("--threads", "0"))
option("the project's folder for the result", "--out", ".", options=("--out", "."))
option("the photos' folder for the result", "--out", "photos", options=("--out", "photos/images"))
option("the scene's folder for the result", "--out", "photos", options=("--out", "photos"))
option("the configurations' folder for the result", "--out", options=("--out", "configs"))


@message(
    GROUP,
    "somebody's folder for the result",
    "letters",
    "capture.json",
    options=("--out", "letters"),
)
def somebodys_folder(p: Project) -> None:
    (p.folder / "letters").mkdir()
    (p.folder / "letters" / "to_my_mother.txt").write_text("Dear mother,")


@message(GROUP, "a file for the result", "letter", options=("--out", "letter"))
def file_for_result(p: Project) -> None:
    (p.folder / "letter").write_text("Dear mother,")


# --- what belongs together --------------------------------------------------------------------


def sample(name: str, *words: str, **settings: object) -> None:
    """A case of the sample stage, which must find out before it reads anything large."""

    def spoil(p: Project) -> None:
        p.settings["sample"] = settings
        p.write_config()

    message(GROUP, name, *words, stages=SAMPLE)(spoil)


sample("rows of the light that do not divide the prior's", "sample.light", "24", "32", light=24)
sample("prior_tiny with more rows than it has", "sample.light", "32", "16", prior="prior_tiny")
sample("a prior that does not exist", "prior_huge", "prior_", prior="prior_huge")
sample("a network for the starts' prior", "gaussian", start_prior="prior_tiny")
sample("an unknown sampler", "gibs", "split_gibbs", method="gibs")
sample("a label that the prior does not know", "sample.label", "moon", label="moon")
