"""The facts that the mesh stage passes on."""

from types import SimpleNamespace

import pytest

from pipeline.base.config import Scene
from pipeline.base.errors import InputError
from pipeline.base.files import write_json
from pipeline.posterior import load
from pipeline.render.surroundings import Surroundings
from pipeline.surface.facts import SurfaceFacts


def test_facts_come_back_as_they_were_saved(tmp_path):
    SurfaceFacts(normal_error=0.03125).save(tmp_path)
    assert SurfaceFacts.load(tmp_path) == SurfaceFacts(normal_error=0.03125)


def test_missing_facts_are_named(tmp_path):
    with pytest.raises(InputError, match="surface.json.*missing"):
        SurfaceFacts.load(tmp_path)
    write_json(tmp_path / "surface.json", {})
    with pytest.raises(InputError, match="no entry 'normal_error'"):
        SurfaceFacts.load(tmp_path)


def test_a_problem_without_observations_says_which_stage_makes_them(tmp_path, ball):
    with pytest.raises(InputError, match="there are no observations"):
        load.load_problem(tmp_path, tmp_path, ball, tmp_path, Scene(photos="nowhere"), 16, 16)


def test_a_problem_takes_the_normals_error_from_the_meshs_folder(tmp_path, ball, monkeypatch):
    SurfaceFacts(normal_error=0.0625).save(tmp_path)
    seen = SimpleNamespace(surroundings=Surroundings())
    monkeypatch.setattr(load, "Observations", lambda *folders: seen)
    scene = Scene(photos="nowhere")
    problem = load.load_problem(tmp_path, tmp_path, ball, tmp_path, scene, 16, 16)
    assert problem.normal_error == 0.0625
