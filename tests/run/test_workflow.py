"""What the Snakefile asks: which code and files a stage depends on, names in commands, locks."""

import ast
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from snakemake.utils import format as snakemake_format

from pipeline.base.config import load_scene
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, stage_folder
from pipeline.base.locks import lock
from pipeline.prior.locate import prior_files
from pipeline.run import digest
from pipeline.run.digest import NOT_COUNTED, ROOT, counted_files, meaning
from pipeline.run.stage import of_the_disk, overrides
from pipeline.run.workflow import (
    WAITS,
    Scenes,
    checked_name,
    flattened,
    literal,
    manifest_of,
    only_one_run,
    stage_command,
    unfinished_runs,
)

STAGES = sorted(p.stem for p in (ROOT / "stages").glob("[!_]*.py"))
HOSTILE = ["a b", "it's", "x$(touch hacked)", "`touch hacked`", 'q"; touch hacked; "', "a&b|c", "ä"]


# --- code -------------------------------------------------------------------------------------


PARSED: dict[bytes, tuple] = {}
READ = digest._read.__wrapped__


def read_once(file: Path) -> tuple[set[str], bytes]:
    """What `digest._read` says, which depends on nothing but the content."""
    content = file.read_bytes()
    if content not in PARSED:
        PARSED[content] = READ(file)
    return PARSED[content]


@pytest.fixture
def code(tmp_path, monkeypatch) -> Path:
    """A copy of the code in which files may be edited."""
    monkeypatch.setattr(digest, "_read", read_once)
    for folder in ("pipeline", "stages"):
        shutil.copytree(
            ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__")
        )
    return tmp_path


def digests(code: Path) -> dict[str, str]:
    """Digests of the code as it is now."""
    digest.code_digest.cache_clear()
    return {stage: digest.code_digest(stage, code) for stage in STAGES}


def changed(before: dict[str, str], code: Path) -> set[str]:
    """Stages whose digest is another now."""
    after = digests(code)
    return {stage for stage in STAGES if before[stage] != after[stage]}


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new, 1), encoding="utf-8")


def test_the_digest_does_not_depend_on_where_the_code_lies(code):
    assert digests(code) == digests(ROOT)


def test_comments_docstrings_and_layout_change_no_digest(code):
    before = digests(code)
    for file in counted_files("sample", code):
        text = file.read_text(encoding="utf-8")
        if ast.get_docstring(ast.parse(text)):
            text = text.replace('"""', '"""Said otherwise. ', 1)
        file.write_text(f"# a comment\n\n{text}\n\n# another\n", encoding="utf-8")
    edit(code / "pipeline/base/images.py", "(", "(  # beside\n")
    assert changed(before, code) == set()


def test_docstrings_of_functions_and_classes_do_not_count_but_other_texts_do():
    source = (
        'class A:\n    """{0}"""\n\n    def f(self):\n        """{1}"""\n        return "{2}"\n'
    )
    read = lambda *texts: meaning(ast.parse(source.format(*texts)))
    assert read("a", "b", "c") == read("x", "y", "c") != read("x", "y", "z")


def test_a_digest_follows_imports_and_only_them(code):
    before = digests(code)
    edit(code / "pipeline/masks/ground.py", "\n\n\n", "\n\n\nEXTRA = 1\n\n\n")
    assert changed(before, code) == {"masks"}

    before = digests(code)
    edit(code / "pipeline/base/images.py", "\n\n\n", "\n\n\nEXTRA = 1\n\n\n")
    assert {"capture", "poses", "masks", "mesh", "fit", "sample"} <= changed(before, code)


def test_moved_code_changes_the_digest(code):
    """The same text under another name is other code: what imports it has changed."""
    before = digests(code)
    (code / "pipeline/masks/network.py").rename(code / "pipeline/masks/onnx.py")
    edit(code / "pipeline/masks/make.py", "pipeline.masks.network", "pipeline.masks.onnx")
    assert changed(before, code) == {"masks"}


def test_files_left_out_are_known_by_their_path_not_by_their_name(code):
    before = digests(code)
    for name in NOT_COUNTED:
        edit(code / name, "\n\n\n", "\n\n\nEXTRA = 1\n\n\n")
    assert changed(before, code) == set()

    (code / "pipeline/masks/config.py").write_text("LIMIT = 1\n")
    edit(
        code / "pipeline/masks/ground.py",
        "\n\n\n",
        "\n\n\nfrom pipeline.masks.config import LIMIT\n\n\n",
    )
    before = digests(code)
    (code / "pipeline/masks/config.py").write_text("LIMIT = 2\n")
    assert changed(before, code) == {"masks"}


def test_templates_beside_a_counted_module_count(code):
    (code / "pipeline/report/page.html").write_text("<p>one</p>")
    before = digests(code)
    (code / "pipeline/report/page.html").write_text("<p>two</p>")
    assert changed(before, code) == {"report"}


# --- inputs -----------------------------------------------------------------------------------


@pytest.fixture
def project(tmp_path, monkeypatch) -> Path:
    """A project folder with configs/s.yaml, three photos, and a mask for one of them."""
    monkeypatch.chdir(tmp_path)
    for folder in ("configs", "photos/images", "photos/masks"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "configs/s.yaml").write_text("photos: photos\n")
    for k in range(3):
        Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(tmp_path / f"photos/images/{k}.png")
    (tmp_path / "photos/masks/1.png").write_bytes(b"mask")
    (tmp_path / "photos/masks/Thumbs.db").write_bytes(b"not read")
    return tmp_path


def test_capture_reads_photos_and_the_masks_that_belong_to_them(project):
    assert Scenes({}).photos("s") == [
        "photos/images/0.png",
        "photos/images/1.png",
        "photos/images/2.png",
        "photos/masks/1.png",
    ]


def test_which_photos_are_for_scoring_is_part_of_what_capture_depends_on(project):
    frames = [{"file_path": f"images/{k}.png"} for k in range(3)]
    write = lambda name, frames: (project / "photos" / name).write_text(
        json.dumps({"frames": frames})
    )
    write("transforms.json", frames)
    before = Scenes({}).order("s")
    write("transforms.json", frames[:2])
    write("transforms_test.json", frames[2:])
    assert Scenes({}).order("s") != before and '["2", "test"]' in Scenes({}).order("s")


@pytest.mark.parametrize("cameras", ["transforms", "model"])
def test_cameras_given_after_a_run_make_capture_due(project, cameras):
    """Before, it may have left out photos that the cameras name."""
    before = Scenes({}).order("s")
    if cameras == "transforms":
        frames = [{"file_path": f"images/{k}.png"} for k in range(3)]
        (project / "photos/transforms.json").write_text(json.dumps({"frames": frames}))
    else:
        (project / "photos/sparse/0").mkdir(parents=True)
    assert Scenes({}).order("s") != before


def test_sample_reads_every_part_of_both_priors(project):
    files = Scenes({"sample": {"prior": "prior_base"}}).priors("s")
    names = [Path(f).name for f in files]
    assert names == [
        "prior_base-1-of-2.safetensors",
        "prior_base-2-of-2.safetensors",
        "gaussian_small.safetensors",
    ]
    assert all(Path(f).exists() for f in files)


def test_weights_in_the_project_are_named_from_there(project):
    """So that a project that was moved is not made again."""
    shutil.copy(ROOT / "weights/gaussian_small.safetensors", project / "own.safetensors")
    scenes = Scenes({"sample": {"prior": f"{project}/own.safetensors"}})
    assert scenes.priors("s")[0] == "own.safetensors"


def test_a_network_for_masks_is_read_when_it_is_asked_for(project):
    network = {"onnx_model": "net.onnx"}
    assert Scenes({"masks": network | {"method": "onnx"}}).network("s") == ["net.onnx"]
    assert Scenes({"masks": network}).network("s") == []


LATE = {
    "light": ({"sample": {"light": 24}}, "sample.light: a light of 24 rows does not divide"),
    "prior": ({"sample": {"prior": "prior_huge"}}, "there is no such prior"),
    "rows": ({"sample": {"prior": "prior_tiny"}}, "of 32 rows does not divide the prior's 16"),
    "start": ({"sample": {"start_prior": "prior_tiny"}}, "a Gaussian prior is asked for"),
    "method": ({"sample": {"method": "gibs"}}, "sample.method"),
    "label": ({"sample": {"label": "moon"}}, "no class 'moon'"),
    "made": ({"sample": {"method": "gan_latent", "prior": "prior_tiny"}}, "a multiple of 32 rows"),
    "network": ({"masks": {"method": "onnx"}}, "onnx_model must name"),
}


@pytest.mark.parametrize("wrong", LATE)
def test_settings_that_do_not_fit_each_other_are_refused_before_the_first_job(project, wrong):
    settings, message = LATE[wrong]
    with pytest.raises(InputError, match=message):
        Scenes(settings)("s")


def test_asking_for_a_scene_loads_neither_torch_nor_mitsuba(project):
    """The Snakefile is read for every job."""
    code = (
        "import sys; from pipeline.run.workflow import Scenes; Scenes({})('s'); print(*sys.modules)"
    )
    ran = subprocess.run(
        [sys.executable, "-c", code],
        text=True,
        capture_output=True,
        check=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert not {"torch", "mitsuba"} & set(ran.stdout.split())


def test_missing_parts_and_other_formats_of_weights_are_refused(tmp_path):
    for name in ("p-1-of-2.safetensors", "p-a-of-b.safetensors", "pq-2-of-2.safetensors"):
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(InputError, match="only 1 of 2 parts"):
        prior_files(f"{tmp_path}/p.safetensors")

    (tmp_path / "prior.pt").write_bytes(b"")
    with pytest.raises(InputError, match="safetensors files only"):
        prior_files(f"{tmp_path}/prior.pt")


def test_overrides_arrive_as_they_were_meant(project):
    given = {
        "samples": 2,
        "preset": "draft",
        "sample": {"label": None, "prior": "it's {here}"},
        "poses": {"match_exposure": False, "object_size": "0.5"},
    }
    scene = load_scene("configs/s.yaml", overrides(flattened(given)))
    assert scene.samples == 2 and scene.preset == "draft"
    assert scene.sample.label is None and scene.sample.prior == "it's {here}"
    assert scene.poses.match_exposure is False and scene.poses.object_size == 0.5


# --- names and commands -----------------------------------------------------------------------


@pytest.mark.parametrize("name", HOSTILE)
def test_names_of_any_letters_are_names(name):
    assert checked_name(name) == name


@pytest.mark.parametrize(
    "name", ["", ".", "..", ".hidden", "-rf", "a/b", "/a", "a\nb", "a\0b", "{a}", "a\\b", "x" * 101]
)
def test_names_that_no_file_can_have_are_refused(name):
    with pytest.raises(InputError, match="cannot be the name of a scene"):
        checked_name(name)
    with pytest.raises(InputError, match="cannot be the name of a scene"):
        Scenes({})(name)


def filled_in(folder: Path, name: str, settings: list[str]) -> str:
    """The command of a stage as Snakemake fills it in."""
    template = stage_command("fit", "fit", "--out work/{wildcards.scene:q}/fit", settings)
    wildcards = SimpleNamespace(scene=name)
    log = f"work/{name}/logs/fit.log"
    command = snakemake_format(template, wildcards=wildcards, threads=2, log=[log])
    (folder / log).parent.mkdir(parents=True, exist_ok=True)
    return f"set -euo pipefail; {command}"


def run_command(folder: Path, name: str, settings: list[str]) -> subprocess.CompletedProcess:
    """The same, run."""
    shell = filled_in(folder, name, settings)
    return subprocess.run(
        ["bash", "-c", shell], cwd=folder, capture_output=True, text=True, check=False
    )


@pytest.fixture
def tool(tmp_path, monkeypatch) -> Path:
    """A program in the place of Python that prints its arguments, one JSON list."""
    file = tmp_path / "my tools" / "it's python"
    file.parent.mkdir()
    file.write_text(
        "#!/bin/sh\nexec python3 -c 'import json, sys; print(json.dumps(sys.argv[1:]))' \"$@\"\n"
    )
    file.chmod(0o755)
    monkeypatch.setattr("pipeline.run.workflow.sys.executable", str(file))
    return file


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_names_and_settings_reach_a_stage_as_words(tmp_path, tool, name):
    settings = ["sample.prior=$(touch hacked) 'x'", "masks={method: given}"]
    done = run_command(tmp_path, name, settings)
    assert done.returncode == 0, done.stderr
    words = json.loads(done.stdout)
    assert words == [
        *("-m", "stages.fit", "--config", f"configs/{name}.yaml"),
        *("--set", settings[0], "--set", settings[1], "--threads", "2"),
        *("--out", f"work/{name}/fit"),
    ]
    assert (tmp_path / "work" / name / "logs" / "fit.log").read_text() == done.stdout
    assert not list(tmp_path.rglob("hacked"))


def test_a_literal_is_one_word():
    for text in ["{a}", "$HOME", "a'b", "*"]:
        assert shlex.split(snakemake_format(literal(text))) == [text]


def test_runs_that_do_not_end_well_are_counted(tmp_path, tool, monkeypatch):
    monkeypatch.chdir(tmp_path)
    good = tool.read_text()
    assert unfinished_runs("a b", "fit") == 0

    tool.write_text("#!/bin/sh\nexit 1\n")
    assert run_command(tmp_path, "a b", []).returncode == 1
    assert unfinished_runs("a b", "fit") == 1

    tool.write_text("#!/bin/sh\nkill -9 $PPID\n")
    assert run_command(tmp_path, "a b", []).returncode != 0
    assert unfinished_runs("a b", "fit") == 2

    tool.write_text(good)
    assert run_command(tmp_path, "a b", []).returncode == 0
    assert unfinished_runs("a b", "fit") == 2  # what the run was planned with: it is not due again


def test_a_run_whose_driver_was_killed_is_counted_for_good(tmp_path, tool, monkeypatch):
    """What is planned meanwhile has its byte in the plan."""
    monkeypatch.chdir(tmp_path)
    job = "touch begun; while kill -0 $PPID; do sleep 0.01; done; "
    job = f"bash -c {shlex.quote(job + filled_in(tmp_path, 's', []))}"
    driver = f"{job} & until [ -e begun ]; do sleep 0.01; done; kill -9 $$"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen(["bash", "-c", driver], cwd=tmp_path, **pipes) as driving:
        assert driving.wait() == -9
        driving.stdout.read()  # its end is that of the job that is left

    mark = tmp_path / "work" / "s" / ".unfinished" / "fit"
    assert (tmp_path / "work" / "s" / "logs" / "fit.log").read_text()
    assert run_command(tmp_path, "s", []).returncode == 0
    assert unfinished_runs("s", "fit") == 1 == mark.stat().st_size


def test_damaged_files_make_their_job_due_once(project, capsys):
    """A plan sees them; a run counts them for good, so that it has the plan's number to its end and
    after it.
    """
    with stage_folder("work/s/fit", "fit.json") as out:
        (out / "fit.json").write_text("{}")
    planned, run = Scenes({}), Scenes({}, exclusive=lambda: True)
    assert planned.unfinished("s", "fit") == 0

    Path("work/s/fit/fit.json").write_text("{")
    assert planned.unfinished("s", "fit") == 1 == planned.unfinished("s", "fit")
    assert planned.unfinished("s", "mesh") == 0
    assert run.unfinished("s", "fit") == 1 == run.unfinished("s", "fit")
    assert "fit is made again: damaged since: fit.json" in capsys.readouterr().err

    with stage_folder("work/s/fit", "fit.json") as out:
        (out / "fit.json").write_text("{}")
    assert run.unfinished("s", "fit") == 1 == planned.unfinished("s", "fit")


def test_every_job_has_its_own_manifest():
    found = [str(manifest_of("s", job)) for job in ("fit", "sample_12", "export", "report")]
    assert found == [
        "work/s/fit/.files.json",
        "work/s/sample/12/.files.json",
        "work/s/.export.files.json",
        "work/s/.report.files.json",
    ]


# --- full disks --------------------------------------------------------------------------------


def test_a_disk_that_openexr_finds_full_is_named(tmp_path):
    """As OpenEXR says it; with a disk that is full: benchmarks.faults."""
    found = RuntimeError('Failed to write pixel data to image file "a". No space left on device.')
    told = of_the_disk(found, tmp_path)
    assert isinstance(told, InputError) and "the disk is full" in str(told)
    other = RuntimeError("Failed to write pixel data")
    assert of_the_disk(other, tmp_path) is other


def test_a_disk_that_numpy_finds_full_is_named(tmp_path):
    """/dev/full takes nothing; numpy's error has no number."""
    with pytest.raises(OSError) as found, open("/dev/full", "wb", buffering=0) as file:
        np.save(file, np.zeros(1000))
    assert "the disk is full" in str(of_the_disk(found.value, tmp_path))
    short = OSError("8 requested and 0 written")
    assert "the disk is full" in str(of_the_disk(short, tmp_path))


# --- times ------------------------------------------------------------------------------------


def test_photos_from_the_future_are_named(project):
    photo = next(Path(path) for path in Scenes({}).photos("s"))
    tomorrow = time.time() + 86400
    os.utime(photo, (tomorrow, tomorrow))
    with pytest.raises(InputError, match=rf"{photo.name}: the file is from the future, by .*:"):
        Scenes({}).photos("s")


def test_results_of_a_clock_that_has_gone_back_are_from_now(project):
    """A plan leaves them alone; a run settles them, and nothing else."""
    files = [Path("work/s/fit/fit.json"), Path("exports/s/a.png"), Path("exports/s.usda")]
    others = [Path("exports/s2.usda"), Path("work/s2/fit.json"), Path("configs/s.yaml")]
    tomorrow = time.time() + 86400
    for file in files + others:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
        os.utime(file, (tomorrow, tomorrow))

    Scenes({})("s")
    assert all(file.stat().st_mtime == pytest.approx(tomorrow) for file in files)
    before = time.time()
    Scenes({}, exclusive=lambda: True)("s")
    of_the_disk = 1  # seconds by which its clock, of coarser ticks, may be behind
    assert all(before - of_the_disk < f.stat().st_mtime <= time.time() for f in files)
    assert all(file.stat().st_mtime == pytest.approx(tomorrow) for file in others)


# --- locks ------------------------------------------------------------------------------------


def test_a_job_waits_for_its_like_that_a_killed_run_has_left_at_work(tmp_path, tool):
    mark = tmp_path / "work" / "s" / ".unfinished" / "fit"
    mark.parent.mkdir(parents=True)
    left = lock(mark)
    shell = filled_in(tmp_path, "s", [])
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(["bash", "-c", shell], cwd=tmp_path, **pipes) as waiting:
        assert WAITS in waiting.stderr.readline()
        assert not (tmp_path / "work" / "s" / "logs" / "fit.log").exists()
        left.close()
    assert waiting.returncode == 0
    assert (tmp_path / "work" / "s" / "logs" / "fit.log").read_text()


def test_only_one_run_of_a_scene_at_a_time(tmp_path):
    first = only_one_run(tmp_path / ".running")
    with pytest.raises(InputError, match="another run"):
        only_one_run(tmp_path / ".running")
    first.close()
    only_one_run(tmp_path / ".running").close()


def test_a_lock_is_of_the_scenes_asked_for(project):
    shutil.copy("configs/s.yaml", "configs/t.yaml")
    first, second = Scenes({}, exclusive=lambda: True), Scenes({}, exclusive=lambda: True)
    first("s")
    second("t")
    with pytest.raises(InputError, match="another run is at work on this scene"):
        second("s")
    Scenes({})("s")  # who only looks needs no lock


def test_a_mistyped_scene_leaves_nothing_behind(project):
    with pytest.raises(InputError, match="no such configuration"):
        Scenes({}, exclusive=lambda: True)("nowhere")
    assert not os.path.exists("work")


def largest_peak(stage: str) -> float:
    """GiB that a stage took in the rows of `benchmarks.memory`, less the oldest version's, whose
    stages held all photos.
    """
    rows = read_json(ROOT / "benchmarks" / "results" / "memory.json")["data"]["rows"]
    return max(
        row["peak_gib"].get(stage, 0.0) for row in rows if not row["name"].endswith("4747f7f")
    )


def test_every_rule_states_its_memory_and_what_draws_is_on_one_thread():
    """Sums of floats in any order would make every draw another."""
    text = (ROOT / "Snakefile").read_text(encoding="utf-8")
    rules = {part.split(":")[0]: part for part in re.split("\n(?:rule|checkpoint) ", text)[1:]}
    assert set(STAGES) <= set(rules)
    for name in STAGES:
        stated = re.findall(r"\n        mem_mb=(\d+),", rules[name])
        assert len(stated) == 1 and int(stated[0]) >= 1.5 * 1024 * largest_peak(name), name
    for name in ("fit", "sample", "refine"):
        assert "threads: 2" not in rules[name], name
