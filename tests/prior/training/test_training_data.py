"""Maps on disk, new views of them, training and its files."""

import csv

import cv2
import numpy as np
import pytest
import torch

from pipeline.base.errors import InputError
from pipeline.base.images import luminance, write_exr, write_png
from pipeline.prior.network import KINDS
from pipeline.prior.training import augment, procedural
from pipeline.prior.training import train as training
from pipeline.prior.training.data import ROWS, Batches, Data, half, make_cache, radiance, scale_free
from pipeline.prior.training.settings import Training, load_training
from pipeline.prior.training.sources import PEAK, expand, find_sources, read_source
from pipeline.prior.training.strong_views import draw_strong_view
from pipeline.prior.training.train import Run, fixed_loss, row_weights, train
from pipeline.prior.weight_facts import LABELS
from pipeline.prior.weight_files import load_parts, part_paths, save_parts
from pipeline.render.envmap import directions, mean_radiance, resample_area, solid_angles
from tests.seeds import numpy_rng, torch_rng


def sun_map(h=32):
    env = np.full((h, 2 * h, 3), [0.2, 0.3, 0.5], np.float32)
    env[h // 4, h // 2] = 4000
    return env


def test_sources_of_every_kind(tmp_path):
    write_exr(tmp_path / "a.exr", sun_map())
    cv2.imwrite(str(tmp_path / "b.hdr"), np.ascontiguousarray(sun_map()[..., ::-1]))
    write_png(tmp_path / "c.png", np.full((32, 64, 3), 128, np.uint8))
    found = find_sources(tmp_path, None)
    assert [(s.path.name, s.expanded, s.label) for s in found] == [
        ("a.exr", False, 4),
        ("b.hdr", False, 4),
        ("c.png", True, 4),
    ]
    a, b = (read_source(s.path) for s in found[:2])
    assert np.allclose(a, b, rtol=0.02)  # RGBE has 8 bits of mantissa
    assert read_source(found[2].path).shape == (32, 64, 3)


def test_inverse_tone_mapping_undoes_reinhard():
    world = np.geomspace(1e-3, PEAK, 50)[:, None, None] * np.array([1.2, 1, 0.4])
    world *= PEAK / luminance(world).max()
    y = luminance(world)
    display = world / y[..., None] * (y * (1 + y / PEAK**2) / (1 + y))[..., None]
    assert np.allclose(expand(display), world, rtol=1e-3)


@pytest.mark.parametrize(
    "damage, message",
    [
        (lambda p: write_exr(p / "x.exr", np.ones((32, 32, 3), np.float32)), "2:1"),
        (lambda p: write_exr(p / "x.exr", -sun_map()), "negative"),
        (lambda p: (p / "x.exr").write_bytes(b"no"), "not a readable EXR"),
        (lambda p: (p / "x.hdr").write_bytes(b"no"), "Radiance HDR"),
        (lambda p: (p / "x.png").write_bytes(b"no"), "not a readable image"),
        (lambda p: None, "holds no"),
    ],
)
def test_unusable_maps_are_named(tmp_path, damage, message):
    damage(tmp_path)
    with pytest.raises(InputError, match=message):
        for source in find_sources(tmp_path, None):
            read_source(source.path)


def catalogue(folder, **over):
    write_exr(folder / "a.exr", sun_map())
    row = {"name": "a", "class": "outdoor", "licence": "CC0", "ldr": "0"} | over
    with open(folder / "maps.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, row)
        writer.writeheader()
        writer.writerow(row)
    return folder / "maps.csv"


def test_catalogue_chooses_by_licence(tmp_path):
    path = catalogue(tmp_path)
    assert find_sources(tmp_path, path, "CC0")[0].label == LABELS.index("outdoor")
    with pytest.raises(InputError, match="licence starting with 'MIT'"):
        find_sources(tmp_path, path, "MIT")


@pytest.mark.parametrize(
    "over, message",
    [({"name": "b"}, "'b'"), ({"class": "outdor"}, "outdoor"), ({"ldr": "1"}, None)],
)
def test_catalogue_rows_are_checked(tmp_path, over, message):
    path = catalogue(tmp_path, **over)
    if message is None:
        assert find_sources(tmp_path, path, "CC0")[0].expanded
        return
    with pytest.raises(InputError, match=message):
        find_sources(tmp_path, path, "CC0")


def test_catalogue_without_columns(tmp_path):
    write_exr(tmp_path / "a.exr", sun_map())
    (tmp_path / "maps.csv").write_text("name,class\na,outdoor\n")
    with pytest.raises(InputError, match="ldr, licence"):
        find_sources(tmp_path, tmp_path / "maps.csv", "")


def test_storage_keeps_a_sun():
    env = sun_map(ROWS)
    env[10, 10] = 3e6
    assert np.allclose(radiance(half(env)), env, rtol=2e-3)


def test_unmoved_view_is_a_turn():
    """From the centre, a turn by whole columns is a roll."""
    env = numpy_rng(0).random((16, 32, 3)).astype(np.float32)
    turned = augment.moved(env, np.zeros(3), 2 * np.pi * 5 / 32)
    assert min(np.abs(turned - np.roll(env, k, 1)).max() for k in (5, -5)) < 1e-3


def test_moved_view_sees_along_its_rays():
    """Paint every direction of the sphere by its own position: a view from o shows o + t d."""
    h = 64
    env = directions(h, 2 * h).astype(np.float32)
    origin = np.array([0.3, 0.1, -0.2])
    seen = augment.moved(env, origin, 0.0)
    offset = seen - origin
    offset = offset / np.linalg.norm(offset, axis=-1, keepdims=True)
    middle = slice(8, -8)  # bilinear look-up is rough at the poles
    assert np.abs(offset - env)[middle].max() < 0.02


def test_views_keep_a_uniform_light():
    rng = numpy_rng(0)
    for _ in range(6):
        view = augment.draw_view(np.ones((ROWS, 2 * ROWS, 3), np.float32), 16, rng)
        assert view.shape == (16, 32, 3) and view.std((0, 1)).max() < 1e-4


def test_unmoved_views_keep_the_energy(monkeypatch):
    monkeypatch.setattr(augment, "WHITE_BALANCE", 0.0)
    monkeypatch.setattr(augment, "CONTRAST", 0.0)
    monkeypatch.setattr(augment, "MOVE_ALONG", 0.0)
    monkeypatch.setattr(augment, "MOVE_UP", 0.0)
    env, rng = sun_map(64), numpy_rng(1)
    for _ in range(8):
        assert np.allclose(
            mean_radiance(augment.draw_view(env, 16, rng)), mean_radiance(env), rtol=0.02
        )


def test_stretched_latitudes_stay_between_the_poles():
    """Every direction painted by its height: stretched, heights still fall from pole to pole."""
    h = 64
    env = np.repeat(directions(h, 2 * h)[..., 1:], 3, -1).astype(np.float32)
    heights = augment.moved(env, np.zeros(3), 0.0, (0.5, -0.25))[..., 0].mean(1)
    assert (np.diff(heights) < 0).all() and np.abs(heights - env[..., 0].mean(1)).max() > 0.05
    assert np.allclose(heights[[0, -1]], [1, -1], atol=0.02)


def test_strong_views_keep_two_uniform_lights_apart():
    """A view of a dim map and of a bright one shows both, each its own, or the dim one alone."""
    dim, bright = (np.full((ROWS, 2 * ROWS, 3), value, np.float32) for value in (1.0, 100.0))
    rng, seen = numpy_rng(3), []
    for _ in range(24):
        view, both = draw_strong_view(dim, bright, 16, rng)
        seen.append(both)
        assert view.shape == (16, 32, 3) and np.isfinite(view).all()
        spread = np.log(view.max((0, 1)) / view.min((0, 1)))
        assert (spread > 1).all() if both else (spread < 1e-3).all()
    assert 0 < sum(seen) < 24


def test_strong_views_count_as_made(cache):
    data = Data.load(cache, 8)
    _, labels, made = Batches(data, 1.0, 0, strong_share=0.5).draw(40)
    assert 5 < made.sum() < 35 and set(labels) == {len(LABELS)}


@pytest.mark.parametrize("name", ["outdoor", "night"])
def test_made_lights_are_light(name):
    env = getattr(procedural, name)(numpy_rng(2), 32, 64)
    assert env.shape == (32, 64, 3) and np.isfinite(env).all() and env.min() >= 0 and env.mean() > 0


def test_made_rooms_are_lit():
    """Rooms reflect their lamps: nothing is black, and light is brighter than what it falls on."""
    from pipeline.prior.training import rooms

    for maker in (rooms.indoor, rooms.studio):
        env = maker(numpy_rng(5), 32, 64, spp=8)
        assert np.isfinite(env).all() and np.median(env) > 0 and env.max() > 5 * np.median(env)


def test_a_room_reflects_what_its_lamp_gives():
    """A closed grey box under a lamp: mean radiosity = albedo x emitted power / ((1 - albedo)
    area).
    """
    from pipeline.prior.training.path_traced import Quads, glowing, trace

    quads = Quads()
    quads.box([-1, -1, -1], [1, 1, 1], np.full(3, 0.5))
    lamp = glowing(
        np.array([-0.2, 0.99, -0.2]), np.array([0.4, 0, 0]), np.array([0, 0, 0.4]), np.full(3, 10.0)
    )
    env = trace(quads, [lamp], np.zeros(3), 32, 64, 64, 1)
    nearest_wall = np.abs(directions(32, 64)).max(-1)
    area = solid_angles(32, 64) / nearest_wall**3  # of wall per pixel: r = 1 / m, cosine = m
    wall = env.mean(-1) < 0.5  # pixels at the lamp's edge show it in part
    radiosity = np.pi * (env.mean(-1) * area)[wall].sum() / area.sum()
    assert np.isclose(radiosity, 0.5 * np.pi * 10 * 0.16 / (0.5 * 24), rtol=0.06)


@pytest.fixture
def cache(tmp_path):
    folder = tmp_path / "maps"
    folder.mkdir()
    for name in ("a", "b", "c", "g"):  # by hash, one or none of these is held out
        write_exr(folder / f"{name}.exr", sun_map(ROWS))
    write_png(folder / "l.png", np.full((ROWS, 2 * ROWS, 3), 100, np.uint8))
    path = tmp_path / "data.npz"
    make_cache(folder, None, "", 0, 0, path)
    return path


TINY = {
    "height": 8,
    "network": {"channels": [8, 8], "blocks": [1, 1], "embedding": 8, "sources": 2},
    "batch": 4,
    "images": 100000,
    "learning_rate": 5e-3,
}


def test_cache_holds_what_was_read(cache):
    data = Data.load(cache, 8)
    assert len(data.maps) == 5 and data.made.tolist() == [False] * 4 + [True]
    codes, labels, made = Batches(data, 0.5, 0).draw(40)
    assert codes.shape == (40, 3, 8, 16) and set(labels) == {len(LABELS)} and 5 < made.sum() < 35
    assert np.isclose(data.measured(False).std(), 0.5, rtol=1e-3)  # EDM's sigma_data


def test_cache_of_something_else(tmp_path):
    (tmp_path / "data.npz").write_bytes(b"no")
    with pytest.raises(InputError, match="not a cache"):
        Data.load(tmp_path / "data.npz", 8)


@pytest.mark.slow
def test_training_learns_and_resumes(cache, tmp_path, monkeypatch):
    monkeypatch.setattr(training, "WARM_UP", 1)
    config, data, out = Training(**TINY), Data.load(cache, 8), tmp_path / "run"
    out.mkdir()
    run = Run(config, {}, out, "cpu")
    x, weights = torch.from_numpy(data.measured(False)[:4]), row_weights(8)
    labels = torch.full((4,), len(LABELS) + KINDS)
    before = fixed_loss(run.model, x, weights, config)
    for _ in range(60):
        run.step(x, labels, weights)
    assert fixed_loss(run.model, x, weights, config) < 0.5 * before
    run.save()
    again = Run(config, {}, out, "cpu")
    assert again.images == run.images
    assert all(
        torch.equal(a, b)
        for a, b in zip(again.model.state_dict().values(), run.model.state_dict().values())
    )
    (out / "state.pt").unlink()
    carried = Run(config, {}, out, "cpu")  # the weight average alone came back from another machine
    assert carried.images == run.images
    assert all(
        torch.allclose(a, b, atol=1e-2)
        for a, b in zip(carried.model.state_dict().values(), run.average.state_dict().values())
    )


def test_training_stops_in_time_and_logs(cache, tmp_path):
    out = tmp_path / "run"
    out.mkdir()
    train(Training(**TINY), Data.load(cache, 8), out, 0.0, "cpu")
    assert (out / "log.jsonl").read_text().count("\n") == 1 and (
        out / "average.safetensors"
    ).exists()


def test_settings_name_the_mistake(tmp_path):
    (tmp_path / "p.yaml").write_text("heigth: 64\n")
    with pytest.raises(InputError, match="height"):
        load_training(tmp_path / "p.yaml")


def test_weights_in_parts(tmp_path):
    path = tmp_path / "w.safetensors"
    tensors = {k: torch.randn(100, generator=torch_rng(0)) for k in "abc"}
    assert len(save_parts(tensors, {"x": 1}, path, limit=900)) == 2
    loaded, facts = load_parts(path)
    assert facts == {"x": 1} and all(torch.equal(loaded[k], tensors[k]) for k in tensors)
    save_parts(tensors, {"x": 2}, path)
    assert part_paths(path) == [path]  # the older parts are gone
    save_parts(tensors, {"x": 1}, path, limit=900)[0].unlink()
    with pytest.raises(InputError, match="1 of 2 parts"):
        load_parts(path)


def test_a_smaller_map_keeps_a_sun(tmp_path):
    big = sun_map(128)
    small = scale_free(resample_area(big, 16, 32))
    assert np.allclose(
        mean_radiance(small) / mean_radiance(small).sum(),
        mean_radiance(big) / mean_radiance(big).sum(),
        rtol=1e-4,
    )
