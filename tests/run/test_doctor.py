"""The doctor names what is missing, whatever the way in which it fails, and its exit status says
so.
"""

import subprocess
import sys

import pytest

from pipeline.run import doctor


class Unheard(Exception):
    """Stands for the libraries' own exception classes (safetensors, pxr), which share no base but
    Exception.
    """


def test_a_failing_check_is_a_finding_with_a_cure():
    def fails():
        raise Unheard("header too large")

    good, text = doctor.attempt(fails, "check out weights/ again")
    assert not good and "Unheard: header too large" in text and "check out weights/ again" in text


def test_corrupt_weights_are_a_finding(tmp_path, monkeypatch):
    (tmp_path / "prior_small.safetensors").write_bytes(b"not a weight file")
    monkeypatch.setattr("pipeline.prior.locate.WEIGHTS", tmp_path)
    good, text = doctor.attempt(doctor.weights, "check out weights/ again")
    assert not good and "what to do" in text


def test_a_library_that_does_not_load_is_a_finding(monkeypatch):
    monkeypatch.setattr(doctor, "LATE", ("no_such_library",))
    good, text = doctor.attempt(doctor.modules, "install it again")
    assert not good and "no_such_library" in text and "install it again" in text


def test_every_module_imports():
    good, text = doctor.attempt(doctor.modules, "install it again")
    assert good, text


@pytest.fixture
def quick(monkeypatch, tmp_path):
    """The doctor without its slow checks, in a folder with exports/."""
    (tmp_path / "exports").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(doctor, "render", lambda: "renders")
    monkeypatch.setattr(doctor, "weights", lambda: "loads")
    monkeypatch.setattr(doctor, "memory", lambda: "enough")
    monkeypatch.setattr(doctor, "modules", lambda: "import")
    monkeypatch.setattr(doctor, "STACK", ("numpy",))
    monkeypatch.setattr(doctor.runtime, "import_open3d", lambda: pytest)
    return tmp_path


def test_all_good(quick, capsys):
    assert doctor.doctor() and "MISSING" not in capsys.readouterr().out


@pytest.mark.parametrize(
    "name, said",
    [("no-such-package", "no-such-package is missing"), (None, "exports/ cannot be written to")],
)
def test_one_thing_missing_is_not_all_good(quick, monkeypatch, capsys, name, said):
    if name:
        monkeypatch.setattr(doctor, "STACK", (name,))
    else:
        (quick / "exports").rmdir()
    assert not doctor.doctor()
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("MISSING")]
    assert len(lines) == 1 and said in lines[0]


@pytest.mark.parametrize("good", [True, False])
def test_exit_status(good, monkeypatch):
    from pipeline.run import cli

    monkeypatch.setattr(doctor, "doctor", lambda: good)
    monkeypatch.setattr(sys, "argv", ["heliograph", "doctor"])
    with pytest.raises(SystemExit) as end:
        cli._run()
    assert end.value.code == (0 if good else 1)


def test_check_of_a_missing_file_is_a_plain_message(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "pipeline.run.cli", "check", str(tmp_path / "none.usda")],
        capture_output=True,
        text=True,
    )
    assert done.returncode != 0 and "none.usda" in done.stderr and "Traceback" not in done.stderr
