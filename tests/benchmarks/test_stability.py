"""The stability suite: every spoiler does what it says, and nothing at its harmless value; curves
break where the rule says; a run goes on where it stopped."""

import sys

import numpy as np
import pytest

from benchmarks.stability import __main__ as stability
from benchmarks.stability import cameras, lights, masks, meshes, photos, things
from benchmarks.stability import point as point_module
from benchmarks.stability.gather import KEPT, gathered, of_point
from benchmarks.stability.knobs import KNOBS
from benchmarks.stability.limits import (
    breaking_points,
    coverage_limit,
    figures,
    limit,
    side_by_side,
)
from benchmarks.stability.point import done
from benchmarks.stability.points import Point, points_of
from benchmarks.stability.scenes import BASE, randomness
from benchmarks.stability.spoil import copied
from benchmarks.study.methods import OURS
from benchmarks.suite.objects import OBJECTS
from benchmarks.suite.patches import assembled
from benchmarks.suite.solid_noise import SolidNoise
from benchmarks.true_maps import camera_positions, transform_matrix
from pipeline.base.errors import InputError
from pipeline.base.files import write_json
from pipeline.base.images import read_exr, read_png, to_srgb8, write_exr, write_png
from pipeline.geometry.mesh_io import load_mesh, save_mesh
from pipeline.render.envmap import directions, solid_angles
from tests.seeds import numpy_rng

SPOILERS = {name: knob for name, knob in KNOBS.items() if knob.spoil is not None}


@pytest.fixture
def rng():
    return numpy_rng(3)


@pytest.fixture(scope="module")
def mesh():
    return assembled(OBJECTS["vase"].patches())


@pytest.fixture
def scene(tmp_path, mesh):
    """A scene folder as make_scene writes it, with photos of a shaded ball, and light, as truth."""
    folder = tmp_path / "origin"
    y, x = np.mgrid[:40, :40] - 19.5
    inside = np.hypot(x, y) < 12
    frames = []
    for k, position in enumerate(camera_positions(8, 0)):
        name = f"train_{k:03d}"
        light = np.where(inside, 0.5 + 0.03 * x + 0.02 * (k - 4), 0)[..., None] * [1, 0.8, 0.6]
        write_exr(folder / "truth" / "linear" / f"{name}.exr", light)
        write_png(folder / "images" / f"{name}.png", to_srgb8(light))
        write_png(folder / "masks" / f"{name}.png", inside * np.uint8(255))
        matrix = transform_matrix(position)
        frames.append({"file_path": f"images/{name}.png", "transform_matrix": matrix})
    write_json(folder / "transforms.json", {"camera_angle_x": 0.7, "frames": frames})
    write_exr(folder / "truth" / "envmap.exr", np.full((8, 16, 3), 0.4, np.float32))
    save_mesh(folder / "mesh.ply", mesh)
    return folder


def content(folder) -> dict[str, bytes]:
    """Every file of a scene folder but truth/, by its path."""
    files = [f for f in folder.rglob("*") if f.is_file() and "truth" not in f.parts]
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}


def same_mesh(one, two) -> None:
    """Reading a mesh brings normals to length 1 anew, which may change their last bit."""
    one, two = load_mesh(one), load_mesh(two)
    for key in ("vertices", "faces", "uv"):
        np.testing.assert_array_equal(getattr(one, key), getattr(two, key))
    np.testing.assert_allclose(one.normals, two.normals, atol=1e-6)


@pytest.mark.parametrize("name", SPOILERS)
def test_harmless_changes_nothing_and_hard_one_kind_of_file(name, scene, tmp_path):
    knob = SPOILERS[name]
    before = content(scene)
    for value in (knob.values[0], knob.values[-1]):
        folder = tmp_path / f"spoilt_{value}"
        copied(scene, folder)
        knob.spoil(folder, value, randomness(name))
        after = content(folder)
        changed = {file for file in before if after.get(file) != before[file]}
        if value == knob.values[0]:
            assert not changed - {"mesh.ply"}
            same_mesh(folder / "mesh.ply", scene / "mesh.ply")
        else:
            assert len({file.split("/")[0] for file in changed}) == 1, changed
    assert content(scene) == before


def test_curves_are_of_one_case_that_gets_worse():
    """Twice the jitter is twice the same jitter."""
    flat = np.full((6, 4, 4, 3), 0.3)
    inside = np.ones((6, 4, 4), bool)
    one, two = (
        np.log2(photos.exposure_jitter(flat, inside, stops, randomness("exposure")) / 0.3)
        for stops in (0.1, 0.2)
    )
    np.testing.assert_allclose(two, 2 * one)


def test_jitter_has_the_spread_it_says(rng):
    flat = np.full((4000, 1, 1, 3), 0.3)
    stops = np.log2(photos.exposure_jitter(flat, None, 0.5, rng) / 0.3)
    assert stops[..., 0].std() == pytest.approx(0.5, rel=0.05)
    assert np.ptp(stops, axis=-1).max() < 1e-12
    balance = np.log(photos.white_balance_jitter(flat, None, 0.2, rng) / 0.3)
    assert np.abs(balance.sum(-1)).max() < 1e-12
    assert balance.std() == pytest.approx(0.2, rel=0.05)


def test_blur_and_noise_keep_the_mean(rng):
    photo = np.zeros((2, 41, 41, 3))
    photo[:, 20, 20] = 1
    at = np.arange(41) - 20
    for change, spread in ((photos.blur, 2.0), (photos.motion_blur, 6 / np.sqrt(12))):
        out = change(photo, None, 2.0 if change is photos.blur else 6.0, rng)
        assert out.sum() == pytest.approx(photo.sum(), rel=1e-3)
        variance = (out[0, ..., 0] * (at[:, None] ** 2 + at[None, :] ** 2)).sum()
        expected = 2 * spread**2 if change is photos.blur else spread**2
        # linear interpolation adds up to 1/4 square pixel along each axis
        assert expected * 0.95 <= variance <= expected * 1.15 + 0.5

    flat = np.full((1, 200, 200, 3), 0.25)
    out = photos.noise(flat, None, 0.1, rng)
    assert out.mean() == pytest.approx(0.25, abs=1e-3)
    assert out.std() == pytest.approx(0.05, rel=0.02)  # 0.1 sqrt(0.25)


def test_clipping_and_underexposure(rng):
    photo = rng.random((3, 20, 20, 3))
    inside = np.ones((3, 20, 20), bool)
    gain = photos.clipping_gain(photo, inside, 0.3)
    assert (photo * gain >= 1).any(-1).mean() == pytest.approx(0.3, abs=0.01)
    assert photos.underexposure(photo, inside, 3) == 1 / 8


def test_truth_has_the_photos_exposure(scene, tmp_path):
    """What light is known follows the photos; light that the object is shown in anew does not."""
    truth = scene / "truth"
    files = ("envmap", "relight/test_000_self", "relight/studio_90/test_000", "linear/test_000")
    for file in files:
        write_exr(truth / f"{file}.exr", np.full((8, 16, 3), 0.4, np.float32))
    write_png(scene / "images" / "test_000.png", np.zeros((8, 16, 3)))
    folder = tmp_path / "spoilt"
    copied(scene, folder)
    KNOBS["underexposed"].spoil(folder, 2, randomness("underexposed"))
    levels = [read_exr(folder / "truth" / f"{file}.exr").mean() for file in files]
    np.testing.assert_allclose(levels, [0.1, 0.1, 0.4, 0.1], rtol=1e-6)
    np.testing.assert_array_equal(
        read_png(folder / "images" / "test_000.png"), to_srgb8(np.full((8, 16, 3), 0.1))
    )
    assert read_exr(truth / "envmap.exr").mean() == pytest.approx(0.4)


def test_jpeg_loses_more_at_lower_quality(rng):
    picture = rng.integers(0, 255, (32, 32, 3), dtype=np.uint8)
    error = [np.abs(photos.jpeg(picture, q).astype(float) - picture).mean() for q in (100, 75, 5)]
    assert error[0] == 0 < error[1] < error[2]


def transforms(count: int = 24) -> dict:
    frames = [{"transform_matrix": transform_matrix(p)} for p in camera_positions(count, 0)]
    return {"camera_angle_x": 0.7, "frames": frames}


def test_cameras_are_off_by_what_is_said(rng):
    before = transforms(400)
    after = cameras.pose_noise(before, 1.0, rng)
    matrices = lambda c: np.array([frame["transform_matrix"] for frame in c["frames"]])
    old, new = matrices(before), matrices(after)
    np.testing.assert_allclose(
        new[:, :3, :3] @ new[:, :3, :3].transpose(0, 2, 1),
        np.eye(3)[None].repeat(400, 0),
        atol=1e-9,
    )
    moved = np.degrees(np.linalg.norm(new[:, :3, 3] - old[:, :3, 3], axis=1)) / 3.3
    # of three components the one along the position does not move it
    assert np.sqrt((moved**2).mean()) == pytest.approx(np.sqrt(2), rel=0.1)
    assert before == transforms(400)

    longer = cameras.focal_error(before, 0.1, rng)["camera_angle_x"]
    assert np.tan(0.35) / np.tan(longer / 2) == pytest.approx(1.1)


def test_gap_leaves_a_sector_empty(rng):
    left = cameras.baseline_gap(transforms(), 180, rng)["frames"]
    azimuth = [np.degrees(np.arctan2(*np.array(f["transform_matrix"])[[1, 0], 3])) for f in left]
    around = np.sort(np.mod(azimuth, 360))
    assert np.diff(np.append(around, around[0] + 360)).max() >= 180
    assert 6 <= len(left) < 24
    assert len(cameras.baseline_gap(transforms(), 359, rng)["frames"]) == 3


def test_outlines_move_by_pixels(rng):
    y, x = np.mgrid[:60, :60] - 29.5
    disc = (np.hypot(x, y) < 15)[None]
    radius = lambda mask: np.sqrt(mask.sum() / np.pi)
    for pixels in (-4, 3):
        assert radius(masks.moved_edge(disc, pixels, rng)[0]) == pytest.approx(15 + pixels, abs=0.5)
    kept = masks.missing(np.repeat(disc, 8, 0), 0.25, rng)
    assert sum(mask is None for mask in kept) == 2


def test_meshes_are_wrong_as_said(mesh, rng):
    radius = meshes.radius(mesh)
    moved = meshes.shifted(mesh, 0.1, rng).vertices - mesh.vertices
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 0.1 * radius)
    np.testing.assert_allclose(meshes.scaled(mesh, 0.2, rng).vertices, 1.2 * mesh.vertices)
    left = meshes.holes(mesh, 0.2, rng)
    assert len(left.faces) == pytest.approx(0.8 * len(mesh.faces), abs=1)
    turned = (meshes.flipped(mesh, 0.3, rng).faces != mesh.faces).any(1).mean()
    assert turned == pytest.approx(0.3, abs=0.01)
    rough = meshes.rough(mesh, 0.02, rng)
    along = ((rough.vertices - mesh.vertices) * mesh.normals).sum(1)
    assert along.std() == pytest.approx(0.02 * radius, rel=0.1)
    twice = meshes.overlapping_uv(mesh, 0.25, rng).uv
    assert twice[:, 0].max() <= 0.75 and (twice[:, 1] == mesh.uv[:, 1]).all()


def test_materials_have_their_shares(rng):
    points = rng.uniform(-0.6, 0.6, (3000, 3))
    noise = SolidNoise(1)
    base = OBJECTS["vase"]
    plain = base.materials[0](points, noise)
    of = lambda thing: thing.materials[0](points, noise)
    assert of(things.of_metal_share(base, 0.3))[2].mean() == pytest.approx(0.3, abs=0.03)
    mirror = of(things.of_mirror_share(base, 0.6))
    assert (mirror[1] == things.SHARPEST).mean() == pytest.approx(0.6, abs=0.03)
    assert (of(things.of_roughness(base, 0.2))[1] == 0.2).all()
    assert of(things.of_albedo(base, 0.1))[0].mean() == pytest.approx(0.1, rel=0.05)
    textured = of(things.of_texture_share(base, 0.1))[0]
    assert (textured == plain[0]).all(1).mean() == pytest.approx(0.1, abs=0.03)
    assert things.of_transmission(base, 0) == base
    for change, value in ((things.of_metal_share, 0), (things.of_mirror_share, 0)):
        for one, two in zip(of(change(base, value)), plain):
            np.testing.assert_array_equal(one, two)
    np.testing.assert_array_equal(of(things.of_texture_share(base, 1))[0], plain[0])


def test_things_stay_in_the_ball():
    made = [things.bowl_of_depth(1.6), things.rods(0.05)]
    made += [things.several(("vase", "bowl", "blob"), count) for count in (1, 2, 3)]
    for thing in made:
        patches = thing.patches()
        assert np.linalg.norm(assembled(patches).vertices, axis=1).max() < 1.25
        assert {patch.part for patch in patches} <= set(range(len(thing.materials)))


def test_sun_has_its_peak():
    for peak in (10, 1e4):
        light = lights.sun_and_sky(peak, 32).mean(-1)
        assert light.max() / np.median(light) == pytest.approx(peak, rel=0.05)


def test_lamp_is_as_large_at_any_distance():
    light = lights.lamp_and_room(64)
    weight = solid_angles(64, 128)
    lit = (light.mean(-1) - lights.even_room(64).mean(-1)) * weight
    cap = 2 * np.pi * (1 - np.cos(lights.LAMP_ANGLE))
    assert lit.sum() == pytest.approx(cap * lights.LAMP_RADIANCE, rel=0.02)
    middle = (lit[..., None] * directions(64, 128)).sum((0, 1))
    assert middle @ lights.LAMP / np.linalg.norm(middle) > 0.999


def test_every_point_has_a_scene_and_the_harmless_share_theirs():
    points = points_of("S", list(KNOBS))
    assert len(points) == sum(len(knob.values) for knob in KNOBS.values())
    scene_of = lambda knob, rank: Point("S", BASE, knob, KNOBS[knob].values[rank]).scene
    assert scene_of("blur", 0) == scene_of("jpeg", 0) == scene_of("seeds", -1) == "s_vase"
    assert scene_of("mask_grown", 0) == scene_of("mask_missing", 0) == "s_vase_hull"
    changed = [p.scene for p in points if p.changed]
    assert len(changed) == len(set(changed))
    assert scene_of("views", 1) == "s_vase"  # it has as many photos
    assert Point("S", BASE, "seeds", 6).seeds == [6, 7, 8]
    assert Point("S", BASE, "draws", 2).seeds == [0, 1]
    assert len(points_of("XS", list(KNOBS))) == 2 * len(KNOBS)
    with pytest.raises(InputError, match="did you mean 'blur'"):
        points_of("S", ["blurr"])


def row(value, dB, coverage=0.7, method=OURS, knob="blur") -> dict:
    about = {"base": BASE, "knob": knob, "value": value, "method": method}
    scores = dict.fromkeys(("relight_psnr", "relight_psnr_channel", "light_psnr_log"), dB)
    return about | {"scores": scores | {"albedo_mse": 0.01}, "coverage": coverage, "seconds": 9.0}


def test_a_curve_breaks_at_its_first_fall():
    rows = [row(0, 25), row(0.7, 22.1), row(1.5, 22.0), row(4, 10)]
    assert limit(rows)["value"] == 1.5 and coverage_limit(rows) is None
    rows[1]["coverage"] = 0.39
    assert limit(rows)["value"] == 1.5 and coverage_limit(rows)["value"] == 0.7
    rows[1] = {key: value for key, value in row(0.7, 25).items() if key != "scores"}
    rows[1] |= {"refused": "no", "coverage": None}
    assert limit(rows)["value"] == 0.7 and coverage_limit(rows) is None
    assert limit([row(0, 25), row(4, 22.1)]) is None
    assert coverage_limit([row(0, 25, coverage=0.3), row(4, 25)])["value"] == 0


def test_tables_say_where():
    rows = [row(0, 25), row(1.5, 21.5), row(4, 10, 0.3)]
    refused = {key: value for key, value in row(4, 0, None, "map").items() if key != "scores"}
    rows += [row(0, 20, None, "map"), refused | {"refused": "too blurred"}]
    text = breaking_points({"rows": rows})
    line = "| defocus, pixels | `vase` | 0, 1.5, 4 | 25.0 | **1.5** (-3.5 dB) | **4** (refused) | "
    assert line + "**4** (.30) |" in text
    assert "| defocus | 4 | 10.0 |" in figures({"rows": rows})
    held = breaking_points({"rows": [row(0, 25), row(4, 24)]})
    assert "| holds to 4 (-1.0 dB) | holds to 4 (.70) |" in held


def test_methods_are_compared_at_the_hard_ends():
    """At the last value that both have, and at no other."""
    rows = [row(0, 25), row(4, 20), row(0, 24, None, "map"), row(4, 21.5, None, "map")]
    rows += [row(0, 23, None, "dpi_paper"), row(1.5, 10, None, "dpi_paper")]
    text = side_by_side({"rows": rows})
    assert f"| `{OURS}` | behind `map` | 1 of 1 | defocus 1.5 |" in text
    assert f"| `{OURS}` | ahead of `map` | 0 of 1 |  |" in text and "`dpi_paper`" not in text
    rows += [row(0, 26, None, f"{OURS}_mean"), row(4, 22, None, f"{OURS}_mean")]
    text = side_by_side({"rows": rows})
    assert f"| `{OURS}_mean` | ahead of `map` | 1 of 1 | defocus 0.5 |" in text
    assert f"of `{OURS}" not in text  # a mean is not compared with its own draws


def test_a_run_goes_on_where_it_stopped(tmp_path, monkeypatch):
    """Points whose rows are there are not made again; a point that fails leaves its message and is
    tried again; a refusal is a result."""
    ran = []

    def process(command, **options):
        value = float(next(c for c in command if c.startswith("--value=")).split("=")[1])
        methods = command[command.index("--methods") + 1].split(",")
        ran.append((value, methods))
        for method in methods:
            point = Point("S", BASE, "blur", value)
            rows = tmp_path / "rows" / point.scene / method
            if value == 4:
                write_json(rows / "refused.json", {"refused": "no"})
            elif value != 1.5 or len(ran) > 4:
                for seed in range(3):
                    write_json(rows / f"{seed}.json", {})
        broken = value == 1.5 and len(ran) <= 4
        return type("Ended", (), {"returncode": int(broken), "stderr": "out of luck"})()

    monkeypatch.setattr(stability.subprocess, "run", process)
    words = ["x", "--knobs", "blur", "--methods", f"{OURS},map", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(SystemExit, match="1 of 4 points failed"):
        stability.main()
    assert [value for value, _ in ran] == [0, 4, 1.5, 0.7]
    failed = tmp_path / "rows" / "s_vase_blur_1p5" / "map" / "failed.txt"
    assert failed.read_text() == "out of luck"

    (tmp_path / "rows" / "s_vase" / "map" / "0.json").unlink()
    stability.main()
    assert ran[4:] == [(0, ["map"]), (1.5, [OURS, "map"])]
    assert not failed.exists()
    assert done(Point("S", BASE, "blur", 4), "map", tmp_path)


def test_fewer_draws_are_a_row_but_where_draws_are_counted(tmp_path, monkeypatch):
    """Draws up to the first that is missing; a knob that counts draws needs all of them."""
    point = Point("S", BASE, "blur", 4)
    rows = tmp_path / "rows" / point.scene / OURS
    cost = {stage: {"cpu_seconds": 2.0} for stage in ("sample", "refine")}
    one = {"scores": dict.fromkeys(KEPT, 20.0), "cost": cost, "commit": "c"}
    for seed in (0, 2):
        write_json(rows / f"{seed}.json", one)
    assert done(point, OURS, tmp_path, 1) and not done(point, OURS, tmp_path, 2)
    (found,) = of_point(point, OURS, tmp_path)
    assert found["draws"] == 1 and "coverage" not in found

    draws = Point("S", BASE, "draws", 2)
    (tmp_path / "rows" / draws.scene).mkdir()
    rows.rename(tmp_path / "rows" / draws.scene / OURS)
    assert of_point(draws, OURS, tmp_path) == []


def test_a_refusal_is_a_result(tmp_path, monkeypatch):
    """It is kept, gathered as a point, and not tried again; an error that is none is not caught."""
    tried = []

    def chain(scene, work):
        tried.append(work.name)
        raise InputError("the light moves", work, "walk around it")

    monkeypatch.setattr(point_module, "make_scene_of", lambda point, out: tmp_path / point.scene)
    monkeypatch.setattr(point_module, "chain", chain)
    point = Point("S", BASE, "turntable", 1)
    for _ in range(2):
        point_module.run(point, [OURS, f"{OURS}_mean", "map"], tmp_path)
    assert tried == ["s_vase_turntable_1"] * 2  # once for each method that draws
    rows = gathered(tmp_path)["rows"]
    assert [(r["knob"], r["value"], r["refused"]) for r in rows] == [
        ("turntable", 1, "the light moves")
    ] * 3
    assert not gathered_at(Point("S", BASE, "turntable", 0.2), tmp_path)
    with pytest.raises(InputError, match="walk around it"):  # a mean by itself, without its draws
        point_module.run(Point("S", BASE, "turntable", 0.2), [f"{OURS}_mean"], tmp_path)

    monkeypatch.setattr(point_module, "chain", lambda *a: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        point_module.run(Point("S", BASE, "turntable", 0.2), ["map"], tmp_path)


def gathered_at(point, out) -> list[dict]:
    return [row for method in (OURS, "map") for row in of_point(point, method, out)]


def test_parts_share_no_scene():
    points = points_of("S", list(KNOBS))
    one, two = (stability.part_of(points, part) for part in ("1/2", "2/2"))
    assert len(one) + len(two) == len(points)
    assert not {p.scene for p in one} & {p.scene for p in two}
    for wrong in ("3/2", "0/2", "x"):
        with pytest.raises(InputError, match="is no part"):
            stability.part_of(points, wrong)
