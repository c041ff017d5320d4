"""What the page's viewer is given."""

import base64
import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pipeline.report
from pipeline.base.images import to_srgb8
from pipeline.geometry.mesh_io import Mesh, load_mesh
from pipeline.posterior.illumination.split_sum import ROUGHNESS
from pipeline.report import viewer
from pipeline.report.viewer import ROWS, drawn, light_levels, viewer_data
from tests.render.test_renderer import explanation

SCRIPT = (Path(pipeline.report.__file__).parent / "viewer.js").read_text(encoding="utf-8")
UNPACKED = {"position": "<u2", "normal": "i1", "uv": "<u2", "triangle": "<u4"}


def unpacked(text: str, kind: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), kind)


def data_of(mesh: Mesh, count: int = 2) -> dict:
    named = [(f"sample {k}", explanation(16, 8, seed=k)) for k in range(count)]
    found = viewer_data(mesh, named, np.array([0.0, 0.3, 1.0]), 1.0)
    assert found is not None
    return found


@pytest.fixture(scope="module")
def mesh(ball) -> Mesh:
    return load_mesh(ball / "mesh_uv.ply")


def test_the_mesh_is_what_it_was_to_a_few_hundred_thousandths(mesh):
    found = data_of(mesh)["mesh"]
    values = {name: unpacked(found[name], kind) for name, kind in UNPACKED.items()}
    size = np.array(found["size"])
    position = found["low"] + size * values["position"].reshape(-1, 3) / 65535
    assert np.abs(position - mesh.vertices).max() <= size.max() / 65535
    assert np.abs(values["normal"].reshape(-1, 3) / 127 - mesh.normals).max() < 0.01
    v_down = mesh.uv * [1, -1] + [0, 1]
    assert np.abs(values["uv"].reshape(-1, 2) / 65535 - v_down).max() < 2e-5
    assert (values["triangle"].reshape(-1, 3) == mesh.faces).all()


def test_an_even_light_stays_even_at_every_roughness_and_shines_pi_on_a_surface():
    even = np.full((ROWS, 2 * ROWS, 3), 1, np.float32) * [0.5, 1, 2]
    found = unpacked(light_levels(even), "<f2").reshape(len(ROUGHNESS) + 1, -1, 4)
    np.testing.assert_allclose(
        found[:-1, :, :3], np.tile([0.5, 1, 2], (*found[:-1].shape[:2], 1)), rtol=2e-3
    )
    np.testing.assert_allclose(
        found[-1, :, :3], np.pi * np.tile([0.5, 1, 2], (found.shape[1], 1)), rtol=2e-3
    )


def test_maps_are_pictures_of_what_they_were():
    x = explanation(16, 8, seed=0)
    x = replace(x, roughness=np.full_like(x.roughness, 0.25), metallic=0 * x.metallic)
    found = drawn("sample 0", x)
    picture = lambda address: np.asarray(
        Image.open(io.BytesIO(base64.b64decode(address.split(",")[1])))
    )
    assert (picture(found["gloss"]) == [64, 0, 0]).all()
    off = picture(found["color"]).astype(float).mean((0, 1)) - to_srgb8(x.base_color).mean((0, 1))
    assert np.abs(off).max() < 4  # a JPEG
    assert found["head_on"] == pytest.approx(0.04)


def test_script_and_page_ask_for_what_is_there(mesh, ball):
    """Of the data, of an explanation and of the mesh; and elements of the page by their names."""
    found = data_of(mesh)
    assert set(re.findall(r"\bdata\.(\w+)", SCRIPT)) <= set(found)
    assert set(re.findall(r"\bfrom\.(\w+)", SCRIPT)) <= set(found["shown"][0])
    assert set(re.findall(r"\bdata\.mesh\.(\w+)", SCRIPT)) == set(found["mesh"])
    page = (Path(pipeline.report.__file__).parent / "page.html").read_text(encoding="utf-8")
    asked = set(re.findall(r'getElementById\("([\w-]+)"\)', SCRIPT))
    assert asked and all(f'id="{name}"' in page for name in asked)
    names = set(re.findall(r'input\.name === "(\w+)"', SCRIPT))
    assert names and all(f'name="{name}"' in page for name in names)


def test_what_a_page_cannot_hold_is_left_out(mesh, monkeypatch):
    monkeypatch.setattr(viewer, "MOST_SHOWN", 1)
    assert [one["name"] for one in data_of(mesh)["shown"]] == ["sample 0"]
    monkeypatch.setattr(viewer, "MOST_TRIANGLES", len(mesh.faces) - 1)
    assert viewer_data(mesh, [], np.ones(3), 1.0) is None
