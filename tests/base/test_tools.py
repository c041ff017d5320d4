"""Small shared tools: whole files, progress, metrics, doctor."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from pipeline.base.errors import InputError, nearest
from pipeline.base.files import atomic_path, read_json, stage_folder, write_json
from pipeline.base.progress import progress
from pipeline.base.runtime import set_threads
from pipeline.render.metrics import light_psnr, psnr
from tests.seeds import numpy_rng

ROOT = Path(__file__).resolve().parents[2]


def test_a_failing_write_leaves_the_old_file(tmp_path):
    write_json(tmp_path / "a.json", {"x": np.float32(1.5), "y": np.arange(2)})
    with pytest.raises(RuntimeError):
        with atomic_path(tmp_path / "a.json") as temporary:
            temporary.write_text("half")
            raise RuntimeError
    assert (
        read_json(tmp_path / "a.json") == {"x": 1.5, "y": [0, 1]}
        and len(list(tmp_path.iterdir())) == 1
    )


def test_a_failing_stage_leaves_the_old_folder(tmp_path):
    with stage_folder(tmp_path / "s", "result") as out:
        (out / "result").write_text("old")
    with pytest.raises(RuntimeError):
        with stage_folder(tmp_path / "s", "result") as out:
            (out / "result").write_text("new")
            raise RuntimeError
    assert (tmp_path / "s" / "result").read_text() == "old"
    with stage_folder(tmp_path / "s", "result") as out:
        (out / "result").write_text("new")
    assert (tmp_path / "s" / "result").read_text() == "new" and len(list(tmp_path.iterdir())) == 1


@pytest.fixture
def letters(tmp_path, monkeypatch):
    """A folder of somebody's, below the working folder, and a link to it beside it."""
    folder = tmp_path / "here" / "letters"
    folder.mkdir(parents=True)
    (folder / "to_my_mother.txt").write_text("Dear mother,")
    (tmp_path / "here" / "link").symlink_to(folder)
    monkeypatch.chdir(tmp_path / "here")
    return folder


@pytest.mark.parametrize(
    "out, fact",
    [
        ("letters", "holds no result"),
        ("letters/to_my_mother.txt", "no folder"),
        ("link", "no folder"),
        (".", "the one that you are in"),
        ("..", "the one that you are in"),
        ("letters/../../here", "the one that you are in"),
    ],
)
def test_nobodys_folder_is_replaced(letters, out, fact):
    """Refused before any work, so that nothing is written and nothing is deleted."""
    before = sorted(letters.parent.parent.rglob("*"))
    with pytest.raises(InputError, match=fact):
        with stage_folder(out, "result"):
            pytest.fail("work has begun")
    assert sorted(letters.parent.parent.rglob("*")) == before
    assert (letters / "to_my_mother.txt").read_text() == "Dear mother,"


def test_what_appears_during_the_work_is_not_deleted(tmp_path):
    with pytest.raises(InputError, match="holds no result"):
        with stage_folder(tmp_path / "s", "result") as out:
            (out / "result").write_text("new")
            (tmp_path / "s").mkdir()
            (tmp_path / "s" / "letter").write_text("Dear mother,")
    assert (tmp_path / "s" / "letter").read_text() == "Dear mother,"


def test_an_empty_folder_is_filled(tmp_path):
    (tmp_path / "s").mkdir()
    with stage_folder(tmp_path / "s", "result") as out:
        (out / "result").write_text("new")
    assert (tmp_path / "s" / "result").read_text() == "new"


def test_two_at_work_on_one_result_do_not_mix(tmp_path):
    """The second is refused as long as the first is at work, and harms nothing of it."""
    with stage_folder(tmp_path / "s", "result") as out:
        (out / "result").write_text("first")
        with pytest.raises(InputError, match="another process is making this result"):
            with stage_folder(tmp_path / "s", "result"):
                pytest.fail("work has begun")
    assert (tmp_path / "s" / "result").read_text() == "first"
    with stage_folder(tmp_path / "s", "result") as out:
        (out / "result").write_text("second")
    assert (tmp_path / "s" / "result").read_text() == "second"
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


def test_what_a_killed_run_left_behind_is_not_in_the_result(tmp_path):
    (tmp_path / ".partial-s" / "images").mkdir(parents=True)
    (tmp_path / ".partial-s" / "images" / "old").write_text("old")
    (tmp_path / ".partial-s" / "old").write_text("old")
    with stage_folder(tmp_path / "s", "result") as out:
        (out / "result").write_text("new")
    assert {p.name for p in (tmp_path / "s").rglob("*")} == {"result", ".files.json"}


KILLED_WHILE_REMOVING = """
import os, shutil, sys
from pathlib import Path
from pipeline.base.files import stage_folder

def remove(folder, ignore_errors=False):
    for file in Path(folder).rglob("result"):
        file.unlink()
        os.kill(os.getpid(), 9)

with stage_folder(sys.argv[1], "result") as out:
    (out / "result").write_text("new")
    (out / "other").write_text("new")
    shutil.rmtree = remove
"""


def test_a_kill_while_the_old_result_is_removed_leaves_the_new_one_whole(tmp_path):
    """Half of an old result, without its mark, would be nobody's, and refused for ever."""
    with stage_folder(tmp_path / "s", "result") as out:
        (out / "result").write_text("old")
        (out / "other").write_text("old")
    words = [sys.executable, "-c", KILLED_WHILE_REMOVING, tmp_path / "s"]
    assert subprocess.run(words, cwd=ROOT, check=False).returncode == -signal.SIGKILL

    assert {p.read_text() for p in (tmp_path / "s").glob("[!.]*")} == {"new"}
    with stage_folder(tmp_path / "s", "result") as out:
        (out / "result").write_text("newest")
    assert (tmp_path / "s" / "result").read_text() == "newest"
    assert [p.name for p in tmp_path.iterdir()] == ["s"]


def test_missing_and_broken_json_are_named(tmp_path):
    (tmp_path / "b.json").write_text("{")
    for name, fact in (("a.json", "missing"), ("b.json", "not valid JSON")):
        with pytest.raises(InputError, match=fact):
            read_json(tmp_path / name)


def test_unwritable_folder_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be made"):
        write_json(tmp_path / "file" / "a.json", {})


def test_progress_tells_time_left(capsys):
    assert list(progress(range(3), "work")) == [0, 1, 2]
    assert "work: 3/3, took 0:00" in capsys.readouterr().err


def test_psnr_of_known_errors():
    a = np.full((4, 4, 3), 0.5)
    from pipeline.base.images import linear_to_srgb, srgb_to_linear

    b = srgb_to_linear(linear_to_srgb(a) + 0.1)
    assert np.isclose(psnr(a, b), 20, atol=0.01)
    mask = np.zeros((4, 4), bool)
    mask[0] = True
    b[1:] = 9
    assert np.isclose(psnr(a, b, mask), 20, atol=0.01)


def test_psnr_of_two_noisy_renders_is_that_of_the_picture_without_noise():
    rng, photo = numpy_rng(0), np.full((100, 100, 3), 0.3)
    shown = 1.2 * photo
    noisy = lambda: shown + rng.normal(scale=0.025, size=shown.shape)
    a, b = noisy(), noisy()
    assert (
        np.isclose(psnr(a, photo, again=b), psnr(shown, photo), atol=0.1)
        and psnr(a, photo) < psnr(shown, photo) - 0.4
    )


def test_light_psnr_ignores_one_scale():
    env = numpy_rng(0).uniform(0.1, 2, (8, 16, 3))
    assert light_psnr(env, 3 * env) > 80 > light_psnr(env, env[::-1])


def test_nearest_name():
    assert "draft" in nearest("drfat", ["draft", "standard"]) and "known names" in nearest(
        "zzz", ["draft"]
    )


def test_doctor_renders(monkeypatch):
    from pipeline.run import doctor

    assert "8x8" in doctor.render()
    monkeypatch.setattr(doctor, "STACK", ("no-such-package",))
    assert doctor.versions() == [
        (False, "no-such-package is missing: pip install --no-deps -r requirements.lock")
    ]


@pytest.mark.slow
def test_threads_are_obeyed_by_libraries_that_are_loaded_later():
    code = """
from pipeline.base.runtime import set_threads
set_threads(1)
import cv2, drjit, numba, numpy, torch
from threadpoolctl import threadpool_info
from pipeline.base.runtime import mitsuba
print(cv2.getNumThreads(), drjit.thread_count(), numba.get_num_threads(), torch.get_num_threads())
print(*[pool["num_threads"] for pool in threadpool_info()])
"""
    unset = {k: v for k, v in os.environ.items() if not k.endswith("_NUM_THREADS")}
    ran = subprocess.run(
        [sys.executable, "-c", code],
        text=True,
        capture_output=True,
        check=True,
        cwd=ROOT,
        env=unset | {"PYTHONPATH": str(ROOT)},
    )
    assert set(ran.stdout.split()) == {"1"}


def test_threads_reach_a_blas_that_is_loaded():
    """It read its variables when numpy was imported; with another number its sums are others."""
    import drjit  # here: pipeline must be imported first, it points Dr.Jit at its LLVM

    before = {pool["filepath"]: pool["num_threads"] for pool in threadpool_info()}
    of_drjit = drjit.thread_count()
    assert before
    try:
        for count in (2, 1):
            set_threads(count)
            assert all(pool["num_threads"] == count for pool in threadpool_info())
    finally:
        set_threads(max(before.values()))
        drjit.set_thread_count(of_drjit)  # one thread would make Mitsuba's EXR files wait forever
