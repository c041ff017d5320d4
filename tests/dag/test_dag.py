"""The whole DAG on a toy scene (given cameras, masks and mesh), and what re-running it does."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pipeline.base.images import to_srgb8
from pipeline.geometry.cameras import Y_FROM_Z_UP, View
from pipeline.geometry.mesh_io import Mesh, load_mesh, save_mesh
from pipeline.prior.training.procedural import outdoor
from pipeline.prior.value_code import scale_of
from pipeline.render.metrics import render_view
from pipeline.render.renderer import Explanation, Renderer
from pipeline.usd.check import check
from tests.conftest import look_at

ROOT = Path(__file__).resolve().parents[2]
TINY = """
photos: "{photos}"
preset: draft
samples: 2
atlas: {{resolution: 64, padding: 1}}
observe: {{pixels: 3000}}
render: {{max_depth: 3}}
fit: {{steps: 20, learning_rate: 0.05, pixels: 400, spp: 2, texture: 16}}
sample: {{steps: 12, learning_rate: 0.05, pixels: 300, spp: 2, texture: 16}}
refine: {{steps: 4, pixels: 300, spp: 2, texture: 48}}
report: {{relight_size: 48, spp: 4}}
"""


def snakemake(folder: Path, *arguments: str, **options) -> subprocess.CompletedProcess:
    return subprocess.run(
        [
            sys.executable,
            "-m",
            "snakemake",
            "-s",
            str(ROOT / "Snakefile"),
            "--profile",
            str(ROOT / "profiles/default"),
            "--directory",
            str(folder),
            "--cores",
            "2",
            *arguments,
        ],
        capture_output=True,
        text=True,
        **options,
    )


@pytest.fixture(scope="module")
def project(tmp_path_factory, ball) -> Path:
    """A project folder with configs/toy.yaml and a rendered scene in a folder with spaces and
    umlauts.
    """
    folder = tmp_path_factory.mktemp("project")
    scene = folder / "Fotos für den Test"
    (scene / "images").mkdir(parents=True)
    (folder / "configs").mkdir()
    (folder / "configs" / "toy.yaml").write_text(TINY.format(photos=scene.name), encoding="utf-8")
    light = outdoor(np.random.default_rng(4), 32, 64).astype(np.float32)
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
        picture = render_view(renderer, truth, View("v", "", 48, 48, 80, 80, 24, 24, pose), 32)
        alpha = (picture.max(-1) > 0) * np.uint8(255)
        Image.fromarray(np.dstack([to_srgb8(picture), alpha])).save(
            scene / "images" / f"Bild {k}.png"
        )
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


def jobs(folder: Path, *arguments: str) -> set[str]:
    """Rules that a dry run would execute."""
    plan = snakemake(folder, "-n", *arguments)
    assert plan.returncode == 0, plan.stderr
    return {
        line.split()[-1].rstrip(":")
        for line in (plan.stdout + plan.stderr).splitlines()
        if line.startswith(("rule ", "localrule "))
    }


def test_whole_chain(project):
    start = time.time()
    done = snakemake(project, "exports/toy.usda", "exports/toy_report.html")
    assert done.returncode == 0, done.stderr[-3000:] + done.stdout[-3000:]
    print(f"toy scene through the DAG: {time.time() - start:.0f} s")
    assert check(project / "exports" / "toy.usda") == []
    report = (project / "exports" / "toy_report.html").read_text(encoding="utf-8")
    assert report.count("data:image/") > 15 and "http://" not in report and "https://" not in report
    refined = json.loads((project / "work/toy/refine/1/refine.json").read_text())
    assert refined["held_out_psnr"] > 15
    assert not [p for p in project.rglob(".partial-*")]


def test_nothing_to_do_when_nothing_changed(project):
    assert jobs(project, "exports/toy.usda", "exports/toy_report.html") == set()


def test_one_option_reruns_only_what_depends_on_it(project):
    assert jobs(project, "exports/toy.usda", "--config", "refine={steps: 5}") == {
        "refine",
        "export",
    }
    assert "sample" in jobs(project, "exports/toy.usda", "--config", "fit={steps: 7}")
    assert "mesh" not in jobs(project, "exports/toy.usda", "--config", "observe={pixels: 2000}")


def test_more_samples_only_add_jobs(project):
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
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "stages.sample",
            "--config",
            "configs/toy.yaml",
            "--threads",
            "1",
            "--index",
            "1",
            "--observe",
            str(work / "observe"),
            "--poses",
            str(work / "poses"),
            "--atlas",
            str(work / "atlas"),
            "--fit",
            str(work / "fit"),
            "--out",
            str(tmp_path / "alone"),
        ],
        cwd=project,
        capture_output=True,
        text=True,
        env={k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")},
    )  # by hand, as in a user's shell
    assert done.returncode == 0, done.stderr
    for name in ("light", "base_color", "roughness", "metallic"):
        assert (tmp_path / "alone" / f"{name}.exr").read_bytes() == (
            work / "sample" / "1" / f"{name}.exr"
        ).read_bytes()


def test_a_killed_run_continues(project):
    """kill -9 of the whole process group in the middle of the fit; the next run finishes the
    work.
    """
    command = [
        sys.executable,
        "-m",
        "snakemake",
        "-s",
        str(ROOT / "Snakefile"),
        "--profile",
        str(ROOT / "profiles/default"),
        "--directory",
        str(project),
        "--cores",
        "2",
        "exports/toy.usda",
        "--config",
        "fit={steps: 2000}",
    ]
    running = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    deadline = time.time() + 120
    while not (project / "work/toy/.partial-fit").exists() and time.time() < deadline:
        time.sleep(0.2)
    assert (project / "work/toy/.partial-fit").exists()
    os.killpg(running.pid, signal.SIGKILL)
    running.wait()
    done = snakemake(project, "exports/toy.usda", "--config", "fit={steps: 8}")
    assert done.returncode == 0, done.stderr[-3000:]
    assert (
        check(project / "exports" / "toy.usda") == []
        and not (project / "work/toy/.partial-fit").exists()
    )


@pytest.mark.parametrize(
    "change, words",
    [
        ("samples: 0", ["samples", "greater than or equal to 1"]),
        ("smples: 3", ["smples", "samples"]),
        ("photos: nowhere", ["nowhere", "does not exist"]),
    ],
)
def test_mistakes_come_as_plain_messages(project, change, words):
    key = change.split(":")[0]
    lines = [
        x
        for x in (project / "configs/toy.yaml").read_text(encoding="utf-8").splitlines()
        if not x.startswith(key + ":")
    ]
    (project / "configs" / "wrong.yaml").write_text("\n".join(lines + [change]), encoding="utf-8")
    done = snakemake(project, "exports/wrong.usda")
    text = done.stdout + done.stderr
    assert done.returncode != 0 and all(w in text for w in words) and "Traceback" not in text, text


def test_every_stage_explains_itself():
    for stage in (
        "capture",
        "poses",
        "masks",
        "mesh",
        "atlas",
        "observe",
        "fit",
        "sample",
        "refine",
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
