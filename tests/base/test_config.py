import pytest

from pipeline.base.config import load_scene, parse_scene, slice_of
from pipeline.base.errors import InputError
from pipeline.run.stage import overrides


def test_preset_lies_under_the_scene(tmp_path):
    scene = parse_scene({"photos": "x", "preset": "draft", "mesh": {"grid": 99}}, "c.yaml")
    assert scene.mesh.grid == 99 and scene.mesh.faces == 15000 and scene.fit.texture == 128


@pytest.mark.parametrize(
    "own, parts",
    [
        ({"photos": "x", "meshh": {}}, ["meshh", "mesh"]),
        ({"photos": "x", "mesh": {"gird": 1}}, ["mesh.gird", "grid"]),
        ({"photos": "x", "mesh": {"depth_scale": 1}}, ["any more", "mesh.depth_pixels alone"]),
        ({"photos": "x", "poses": {"seed": 3}}, ["any more", "remove the line"]),
        ({"photos": "x", "observe": {"seed": 3}}, ["any more", "transforms_test.json"]),
        ({"photos": "x", "fit": {"seed": 3}}, ["any more", "remove the line"]),
        ({"photos": "x", "sample": {"seed": 3}}, ["any more", "raise `samples`"]),
        ({"photos": "x", "sample": {"search_sweeps": 3}}, ["any more", "no search"]),
        ({"photos": "x", "samples": 0}, ["samples", "greater than or equal to 1"]),
        ({"photos": "x", "samples": "all"}, ["correct samples", "'all'"]),
        ({"photos": "x", "poses": {"min_registered": 2}}, ["poses.min_registered: Input"]),
        ({"photos": "x", "preset": "drfat"}, ["drfat", "draft"]),
        ({"photos": "x", "preset": "é" * 200}, ["unknown preset"]),
        ({"photos": "x", "preset": "../presets/draft"}, ["unknown preset", "draft"]),
        ({}, ["photos"]),
        ({"photos": "x", "fit": {"spp": 3}}, ["fit.spp", "multiple of 2"]),
    ],
)
def test_mistakes_are_named(own, parts):
    with pytest.raises(InputError) as error:
        parse_scene(own, "c.yaml")
    assert all(p in str(error.value) for p in ["c.yaml"] + parts)


def test_files_that_are_no_configuration(tmp_path):
    (tmp_path / "a.yaml").write_text("- 1\n- 2\n")
    (tmp_path / "b.yaml").write_text("a: [")
    for name, fact in (("a", "key: value"), ("b", "not valid YAML"), ("c", "no such")):
        with pytest.raises(InputError, match=fact):
            load_scene(tmp_path / f"{name}.yaml")


def test_overrides_reach_their_place():
    assert overrides(["preset=draft", "mesh.grid=96"]) == {"preset": "draft", "mesh": {"grid": 96}}
    with pytest.raises(InputError):
        overrides(["mesh.grid"])


def test_slices_hold_only_what_was_asked():
    scene = parse_scene({"photos": "x"}, "c.yaml")
    assert set(slice_of(scene, "mesh", "samples")) == {"mesh", "samples"}
