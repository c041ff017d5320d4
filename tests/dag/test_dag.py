"""The whole DAG on a toy scene (given cameras, masks and mesh) under two names at once, and what
re-running it does.

The tests share one project and follow each other: each leaves it as it found it, up to
`test_a_file_that_has_lost_its_end_is_made_again`, from where on the scene ODD is not up to date.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from pxr import Usd

from pipeline.base.images import read_exr, read_png, to_srgb8
from pipeline.geometry.cameras import Y_FROM_Z_UP, View
from pipeline.geometry.mesh_io import Mesh, load_mesh, save_mesh
from pipeline.prior.training.procedural import outdoor
from pipeline.prior.value_code import scale_of
from pipeline.render.metrics import psnr
from pipeline.render.renderer import Explanation, Renderer
from pipeline.run.workflow import WAITS
from pipeline.usd.check import check
from tests.conftest import look_at
from tests.dag.snakemake_server import Server
from tests.render.pictures import render_view
from tests.seeds import numpy_rng, seeded

ROOT = Path(__file__).resolve().parents[2]
TINY = """
photos: "{photos}"
preset: draft
samples: {samples}
atlas: {{resolution: 64, padding: 1}}
observe: {{pixels: 3000}}
render: {{max_depth: 3}}
fit: {{steps: 20, learning_rate: 0.05, pixels: 400, spp: 2, texture: 16}}
sample:
  prior: prior.safetensors
  start_prior: gaussian.safetensors
  light: 16
  texture: 16
  points: 60
  smooth: 1
  start_points: 30
  region_steps: 20
refine: {{steps: 4, pixels: 300, spp: 2, texture: 48, shading_pixels: 1000, score_spp: 16}}
report: {{relight_size: 48, spp: 4}}
"""
CHOOSING = "choose: {enabled: true, texture: auto, bounces: auto, light: auto}\n"


ODD = "it's $(touch hacked) b"
CHAIN = {"capture", "poses", "masks", "mesh", "atlas", "observe"}
CHAIN |= {"choose", "fit", "sample", "refine"}
MOST_STEPS = 100_000  # of a fit: minutes on any machine, and it is killed long before
DRAWS = {"sample", "refine", "export", "report"}


def words(folder: Path, *arguments: str, code: Path = ROOT) -> list[str]:
    """What to tell Snakemake in the project `folder` with the Snakefile of `code`."""
    return [
        *("-s", str(code / "Snakefile"), "--profile", str(code / "profiles/default")),
        *("--directory", str(folder), "--cores", "2", *arguments),
    ]


def command(folder: Path, *arguments: str) -> list[str]:
    """Snakemake as in a user's shell."""
    return [sys.executable, "-m", "snakemake", *words(folder, *arguments)]


def surroundings(folder: Path, code: Path = ROOT) -> dict:
    """So that the modules of `code` are imported and no others."""
    return {"cwd": folder, "env": os.environ | {"PYTHONPATH": str(code)}}


@pytest.fixture(scope="module")
def snakemake(tmp_path_factory) -> Iterator[Callable[..., subprocess.CompletedProcess]]:
    """snakemake(folder, *arguments, code=ROOT): run it to its end, in a child of one process that
    has loaded it.
    """
    with Server(tmp_path_factory.mktemp("server")) as server:

        def run(folder: Path, *arguments: str, code: Path = ROOT) -> subprocess.CompletedProcess:
            return server.run(words(folder, *arguments, code=code), **surroundings(folder, code))

        yield run


@pytest.fixture(scope="module")
def jobs(snakemake) -> Callable[..., set[str]]:
    """jobs(folder, *arguments, code=ROOT): rules that a dry run would execute."""

    def planned(folder: Path, *arguments: str, code: Path = ROOT) -> set[str]:
        plan = snakemake(folder, "-n", *arguments, code=code)
        assert plan.returncode == 0, plan.stderr
        return {
            line.split()[-1].rstrip(":")
            for line in (plan.stdout + plan.stderr).splitlines()
            if line.startswith(("rule ", "localrule "))
        }

    return planned


def exported(scene: str) -> list[str]:
    return [f"exports/{scene}.usda", f"exports/{scene}_report.html"]


@pytest.fixture(scope="module")
def project(tmp_path_factory, ball) -> Path:
    """A project folder with two configurations of a rendered scene, whose folder has spaces and
    umlauts, and weights of its own.
    """
    folder = tmp_path_factory.mktemp("project")
    scene = folder / "Fotos für den Test"
    (scene / "images").mkdir(parents=True)
    (scene / "masks").mkdir()
    (folder / "configs").mkdir()
    for name, samples, more in (("toy", 2, ""), (ODD, 1, CHOOSING)):
        text = TINY.format(photos=scene.name, samples=samples) + more
        (folder / "configs" / f"{name}.yaml").write_text(text, encoding="utf-8")
    shutil.copy(ROOT / "weights" / "prior_tiny.safetensors", folder / "prior.safetensors")
    shutil.copy(ROOT / "weights" / "gaussian_tiny.safetensors", folder / "gaussian.safetensors")
    light = outdoor(numpy_rng(4), 32, 64).astype(np.float32)
    color = np.full((16, 16, 3), 0.5, np.float32)
    color[:8] = [0.6, 0.2, 0.1]
    truth = Explanation(
        light / scale_of(light) * 0.5,
        color,
        np.full((16, 16), 0.4, np.float32),
        np.zeros((16, 16), np.float32),
    )
    renderer, frames = Renderer(ball / "mesh_uv.ply", 16, 32, 3), []
    for k in range(9):
        a = 2 * np.pi * k / 9
        pose = look_at([2.2 * np.sin(a), 0.6 * (k % 3), 2.2 * np.cos(a)])
        picture = render_view(
            renderer, truth, View("v", "", 48, 48, 80, 80, 24, 24, pose), 32, seeded(k)
        )
        alpha = (picture.max(-1) > 0) * np.uint8(255)
        Image.fromarray(np.dstack([to_srgb8(picture), alpha])).save(
            scene / "images" / f"Bild {k}.png"
        )
        Image.fromarray(alpha).save(scene / "masks" / f"Bild {k}.png")
        matrix = np.linalg.inv(Y_FROM_Z_UP) @ np.linalg.inv(pose) @ np.diag([1.0, -1, -1, 1])
        frames.append({"file_path": f"images/Bild {k}.png", "transform_matrix": matrix.tolist()})
    (scene / "transforms.json").write_text(
        json.dumps({"fl_x": 80, "w": 48, "h": 48, "frames": frames})
    )
    mesh, back = load_mesh(ball / "mesh_uv.ply"), np.linalg.inv(Y_FROM_Z_UP)[:3, :3]
    save_mesh(
        scene / "mesh.ply", Mesh(mesh.vertices @ back.T, mesh.faces, mesh.normals @ back.T, mesh.uv)
    )
    return folder


def files_in(folder: Path) -> dict[str, bytes]:
    return {p.name: p.read_bytes() for p in folder.iterdir()}


def psnr_of_one_colour(work: Path) -> float:
    """Of the held-out photo's own mean colour all over the object."""
    (name,) = json.loads((work / "observe/observe.json").read_text())["held_out"]
    photo = read_exr(work / f"capture/images/{name}.exr")
    mask = read_png(work / f"mesh/masks/{name}.png") > 127
    return psnr(np.broadcast_to(photo[mask].mean(0), photo.shape), photo, mask)


def test_whole_chain_of_two_scenes_at_once(project, tmp_path):
    logs = {scene: tmp_path / f"{k}.log" for k, scene in enumerate(("toy", ODD))}
    running = [
        subprocess.Popen(
            command(project, *exported(scene)),
            stdout=log.open("w"),
            stderr=subprocess.STDOUT,
            **surroundings(project),
        )
        for scene, log in logs.items()
    ]
    for process, log in zip(running, logs.values(), strict=True):
        assert process.wait() == 0, log.read_text()[-3000:]

    for scene in logs:
        usda = project / "exports" / f"{scene}.usda"
        assert check(usda) == []
        stage = Usd.Stage.Open(str(usda))
        said = stage.GetDefaultPrim().GetCustomDataByKey("heliograph")
        assert ("base_color_within" in said) == (said["samples"] > 1)
        report = (project / "exports" / f"{scene}_report.html").read_text(encoding="utf-8")
        assert report.count("data:image/") > 12
        assert "http://" not in report and "https://" not in report
        refined = json.loads((project / f"work/{scene}/refine/0/refine.json").read_text())
        # at most half the squared error of a picture of one colour, which scores 10 dB less than
        # these short chains do
        assert refined["held_out_psnr"] > psnr_of_one_colour(project / "work" / scene) + 3
    assert not list(project.rglob(".partial-*"))
    assert not list(project.rglob("hacked")) and not (ROOT / "hacked").exists()


def test_two_scenes_of_one_content_have_one_result(project):
    """Nothing of one run went into the other."""
    work = project / "work"
    for file in ("observe/observations.npz", "sample/0/light.exr", "refine/0/base_color.exr"):
        assert (work / "toy" / file).exists()
    assert (work / "toy/atlas/mesh_uv.ply").read_bytes() == (
        work / ODD / "atlas/mesh_uv.ply"
    ).read_bytes()
    assert (work / "toy/observe/observations.npz").read_bytes() == (
        work / ODD / "observe/observations.npz"
    ).read_bytes()


def test_later_stages_take_what_was_chosen_and_only_where_asked(project):
    """The ball hides nothing of its own sky, a given mesh has no normal error, and its photos are
    of 48 pixels.
    """
    settings = lambda scene: json.loads((project / f"work/{scene}/choose/choose.json").read_text())
    side = lambda scene, name: len(read_exr(project / f"work/{scene}/refine/0/{name}.exr"))
    assert settings("toy")["settings"] == {}
    assert side("toy", "base_color") == side("toy", "roughness") == 48

    chosen = settings(ODD)["settings"]
    assert chosen["render"] == {"max_depth": 2} and chosen["sample"] == {"light": 16}
    assert chosen["refine"] == {"texture": 48, "gloss_texture": 16}
    assert side(ODD, "base_color") == 48 and side(ODD, "roughness") == side(ODD, "metallic") == 16


def test_a_body_has_no_more_gloss_than_its_rung(project):
    """Of one number where all bodies stand on a rung of one number."""
    for scene in ("toy", ODD):
        folder = project / f"work/{scene}/refine/0"
        found = json.loads((folder / "refine.json").read_text())["gloss"]
        chosen = {body["chosen"] for body in found["bodies"]}
        assert found["photos_left_out"] == 8 and chosen <= set(found["rungs"])
        if chosen <= {"matt"} or chosen <= {"one gloss"}:
            assert np.ptp(read_exr(folder / "roughness.exr")) < 1e-6
        if not chosen & {"one metal", "as drawn"}:
            assert not read_exr(folder / "metallic.exr").any()


def test_nothing_to_do_when_nothing_changed(project, jobs):
    """For all scenes: the first rule, `all`."""
    assert jobs(project) == set()


@pytest.fixture(scope="module")
def code(tmp_path_factory) -> Path:
    """A copy of the code, to edit."""
    folder = tmp_path_factory.mktemp("code")
    for name in ("pipeline", "stages", "profiles", "configs"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "Snakefile", folder / "Snakefile")
    return folder


def test_an_edited_comment_plans_no_job_and_edited_code_does(project, code, jobs):
    file = code / "pipeline/base/images.py"
    text = file.read_text(encoding="utf-8")
    file.write_text(f"# A comment.\n{text.replace(chr(34) * 3, chr(34) * 3 + 'Or: ', 1)}\n\n\n")
    assert jobs(project, *exported("toy"), code=code) == set()

    file.write_text(f"{text}\n\nEXTRA = 1\n")
    assert jobs(project, *exported("toy"), code=code) == CHAIN | {"export", "report"}

    file.write_text(text)
    page = code / "pipeline/report/make.py"
    page.write_text(f"{page.read_text(encoding='utf-8')}\n\nEXTRA = 1\n")
    assert jobs(project, *exported("toy"), code=code) == {"report"}


def test_replaced_weights_rerun_samples_and_what_follows(project, jobs):
    weights = project / "prior.safetensors"
    before = weights.read_bytes()
    shutil.copyfile(ROOT / "weights" / "prior_small.safetensors", weights)
    assert jobs(project, *exported("toy")) == DRAWS
    weights.write_bytes(before)


def test_a_replaced_mask_reruns_from_the_capture_on(project, jobs):
    mask = next(project.glob("Fotos*/masks/Bild 4.png"))
    before = mask.read_bytes()
    pixels = np.array(Image.open(mask))
    pixels[20:24, 20:24] = 0
    Image.fromarray(pixels).save(mask)
    assert jobs(project, *exported("toy")) == CHAIN | {"export", "report"}
    mask.write_bytes(before)


def test_the_same_files_written_again_are_no_reason(project, jobs):
    """As the two tests before have left them."""
    assert jobs(project) == set()


def test_one_option_reruns_only_what_depends_on_it(project, jobs):
    refine = jobs(project, "exports/toy.usda", "--config", "refine={steps: 5}")
    assert refine == {"refine", "export"}
    assert "sample" in jobs(project, "exports/toy.usda", "--config", "fit={steps: 7}")
    depth = jobs(project, f"exports/{ODD}.usda", "--config", "render={max_depth: 4}")
    assert depth == {"choose", "fit", "sample", "refine", "export"}
    assert "mesh" not in jobs(project, "exports/toy.usda", "--config", "observe={pixels: 2000}")


def test_more_samples_only_add_jobs(project, snakemake):
    plan = snakemake(project, "-n", "exports/toy.usda", "--config", "samples=3")
    text = plan.stdout + plan.stderr
    count = {
        line.split()[0]: line.split()[1]
        for line in text.splitlines()
        if len(line.split()) == 2 and line.split()[1].isdigit()
    }
    assert count.get("sample") == "1" and count.get("refine") == "1" and "fit" not in count, text


def test_sample_alone_equals_sample_among_others(project, tmp_path):
    work = project / "work" / "toy"
    folders = [
        word
        for s in ("observe", "poses", "atlas", "mesh", "choose", "fit")
        for word in (f"--{s}", str(work / s))
    ]
    done = subprocess.run(
        [
            *(sys.executable, "-m", "stages.sample", "--config", "configs/toy.yaml"),
            *("--threads", "1", "--index", "1", "--out", str(tmp_path / "alone"), *folders),
        ],
        cwd=project,
        capture_output=True,
        text=True,
        check=False,
        env={
            k: v for k, v in surroundings(project)["env"].items() if not k.endswith("_NUM_THREADS")
        },
    )  # by hand, as in a user's shell
    assert done.returncode == 0, done.stderr
    for name in ("light", "base_color", "roughness", "metallic"):
        assert (tmp_path / "alone" / f"{name}.exr").read_bytes() == (
            work / "sample" / "1" / f"{name}.exr"
        ).read_bytes()


def test_a_file_that_has_lost_its_end_is_made_again(project, snakemake, jobs):
    """With its time kept, as after a power cut: nothing else tells."""
    target = f"work/{ODD}/refine/0/refine.json"
    file = project / "work" / ODD / "refine/0/roughness.exr"
    whole, at = file.read_bytes(), file.stat().st_mtime_ns
    os.truncate(file, len(whole) // 2)
    os.utime(file, ns=(at, at))
    assert jobs(project, f"exports/{ODD}.usda") == {"refine", "export"}

    done = snakemake(project, target)
    assert done.returncode == 0 and "refine_0 is made again" in done.stderr, done.stderr[-3000:]
    assert len(file.read_bytes()) == len(whole)
    assert jobs(project, target) == set()


def test_a_failed_stage_is_due_again(project, snakemake, jobs):
    """Its old result and all made from it stay in place, but do not pass for up to date."""
    work, more = project / "work" / ODD, ("--config", "fit={steps: 9}")
    before = files_in(work / "fit"), (project / f"exports/{ODD}.usda").read_bytes()
    obstacle = work / ".partial-fit"
    obstacle.write_text("a file where the stage needs a folder")
    failed = snakemake(project, f"exports/{ODD}.usda", *more)
    assert failed.returncode != 0 and "Error in rule fit" in failed.stdout + failed.stderr
    assert (files_in(work / "fit"), (project / f"exports/{ODD}.usda").read_bytes()) == before

    obstacle.unlink()
    assert jobs(project, f"exports/{ODD}.usda", *more) == {"fit", "sample", "refine", "export"}


def test_a_killed_run_continues(project, tmp_path, snakemake, jobs):
    """kill -9 of Snakemake alone in the middle of the fit, with the old result still in place: the
    next run waits for the stage that was left behind, and when that is killed too, finishes the
    work. Before, the scene was refused to a second run.
    """
    work, target = project / "work" / ODD, f"work/{ODD}/fit/fit.json"
    before = files_in(work / "fit")
    log = tmp_path / "next.log"
    endless = ("--config", f"fit={{steps: {MOST_STEPS}}}")
    with left_behind(command(project, target, *endless), project) as running:
        wait_for(lambda: (work / ".partial-fit").exists(), running)

        # a second run that was not refused would wait for the endless stage
        refused_log = tmp_path / "refused.log"
        refused = project_run(project, target, log=refused_log)
        wait_for(lambda: refused.poll() is not None or WAITS in refused_log.read_text(), refused)
        said = refused_log.read_text()
        assert refused.poll() and "another run is at work on this scene" in said
        assert "Traceback" not in said
        assert "fit" in jobs(project, target, "--config", "fit={steps: 7}")  # a plan is none

        os.kill(running.pid, signal.SIGKILL)
        running.wait()
        following = project_run(project, target, "--config", "fit={steps: 8}", log=log)
        wait_for(lambda: WAITS in log.read_text(), following)
        assert files_in(work / "fit") == before and following.poll() is None

    assert following.wait() == 0, log.read_text()[-3000:]
    assert files_in(work / "fit") != before and not (work / ".partial-fit").exists()
    later = jobs(project, f"exports/{ODD}.usda", "--config", "fit={steps: 8}")
    assert later == {"sample", "refine", "export"}


@contextmanager
def left_behind(run: list[str], folder: Path) -> Iterator[subprocess.Popen]:
    """A run of this command in a process group of its own, all of which is killed at the end."""
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    running = subprocess.Popen(run, start_new_session=True, **quiet, **surroundings(folder))
    try:
        yield running
    finally:
        os.killpg(running.pid, signal.SIGKILL)
        running.wait()


def project_run(project: Path, *arguments: str, log: Path) -> subprocess.Popen:
    """A run that has begun; what it says goes into `log`."""
    run = command(project, *arguments)
    return subprocess.Popen(
        run, stdout=log.open("w"), stderr=subprocess.STDOUT, **surroundings(project)
    )


def wait_for(happened, running: subprocess.Popen) -> None:
    """Until `happened()`; a run that ends before has failed."""
    while not happened():
        assert running.poll() is None or happened()
        time.sleep(0.1)


def test_samples_are_drawn_until_they_are_enough(project, snakemake, jobs):
    """`samples: auto`: three, and then as many as they ask for, in the same run."""
    auto = ("exports/toy.usda", "--config", "samples=auto", "most_samples=4")
    done = snakemake(project, *auto)
    assert done.returncode == 0, done.stderr
    exported = json.loads((project / "work/toy/export.json").read_text())["samples"]
    (*_, last) = sorted((project / "work/toy/enough").iterdir())
    found = json.loads((last / "enough.json").read_text())
    assert found["drawn"] == found["samples"] == exported == int(last.name) + 1
    assert exported == min(max(found["needed"], 3), 4)
    assert jobs(project, *auto) == set()


@pytest.mark.parametrize("name", ["-rf", "a{b}"])
def test_names_that_cannot_be_are_refused(project, name, snakemake):
    done = snakemake(project, "-n", "--", f"exports/{name}.usda")
    said = done.stdout + done.stderr
    assert done.returncode != 0 and "cannot be the name of a scene" in said
    assert "Traceback" not in said


@pytest.mark.parametrize(
    "change, expected",
    [
        ("samples: 0", ["samples", "greater than or equal to 1"]),
        ("smples: 3", ["smples", "samples"]),
        ("photos: nowhere", ["nowhere", "does not exist"]),
    ],
)
def test_mistakes_come_as_plain_messages(project, change, expected, snakemake):
    key = change.split(":")[0]
    lines = [
        x
        for x in (project / "configs/toy.yaml").read_text(encoding="utf-8").splitlines()
        if not x.startswith(key + ":")
    ]
    (project / "configs" / "wrong.yaml").write_text("\n".join(lines + [change]), encoding="utf-8")
    done = snakemake(project, "exports/wrong.usda")
    text = done.stdout + done.stderr
    assert done.returncode != 0 and all(w in text for w in expected) and "Traceback" not in text, (
        text
    )


def test_every_stage_explains_itself():
    for stage in (
        "capture",
        "poses",
        "masks",
        "mesh",
        "atlas",
        "observe",
        "choose",
        "fit",
        "sample",
        "refine",
        "enough",
        "export",
        "report",
    ):
        done = subprocess.run(
            [sys.executable, "-m", f"stages.{stage}", "--help"],
            cwd=ROOT,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0 and "--out" in done.stdout, done.stderr
