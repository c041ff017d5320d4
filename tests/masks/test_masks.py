import numpy as np
import pytest

from pipeline.base.config import Masks
from pipeline.base.errors import InputError
from pipeline.base.images import read_exr, read_png, write_png
from pipeline.geometry.cameras import save_cameras
from pipeline.masks.facts import MaskFacts
from pipeline.masks.make import make_masks, said_of_things
from pipeline.photos.ground_plane import NoGround
from pipeline.photos.radiance import level_of, white_of
from tests.masks.conftest import GROUND, PAINTS

BALL = ((0, 0, 0), 0.45, PAINTS["warm"])
BESIDE = ((1.12, GROUND + 0.4, 0.26), 0.4, PAINTS["cold"])  # before the ball in p1
RESTING = ((0.66, GROUND + 0.26, 0), 0.26, PAINTS["warm"])


@pytest.fixture
def table(make_table):
    """A painted ball on a table with grey noise; truth masks."""
    folder, rig, truth = make_table([BALL])
    return folder, rig, truth[0]


def made(folder, out, settings=None):
    """What make_masks returns, and the masks by name."""
    out.mkdir()
    metrics = make_masks(folder, out, settings or Masks(), 2)
    return metrics, {p.stem: read_png(p) > 127 for p in (out / "masks").iterdir()}


def overlaps(masks, truth):
    """IoU per mask."""
    return np.array([(m & truth[n]).sum() / (m | truth[n]).sum() for n, m in masks.items()])


@pytest.mark.slow
def test_object_is_told_from_its_table_down_to_the_contact(table, tmp_path):
    folder, _, truth = table
    metrics, masks = made(folder, tmp_path / "out")
    assert metrics["method"] == "plane" and metrics["warnings"] == []
    recall = [(m & truth[n]).sum() / truth[n].sum() for n, m in masks.items()]
    assert min(recall) > 0.95
    assert overlaps(masks, truth).mean() > 0.93


@pytest.mark.slow
def test_photos_brighter_than_white_are_masked_as_well(make_table, tmp_path):
    """Of a level at which `capture` leaves the user's unit as it is: the whole ball and most of the
    table are above white.
    """
    ball = ((0, 0, 0), 0.45, [[0.75, 0.5, 0.45], [0.45, 0.5, 0.75], [0.5, 0.7, 0.45]])
    folder, rig, (truth,) = make_table([ball], gain=2.5)
    photo = read_exr(folder / rig.views[0].image)
    assert white_of([level_of(photo)]) == 1.0 and (photo > 1).mean() > 0.5
    _, masks = made(folder, tmp_path / "out")
    assert overlaps(masks, truth).mean() > 0.93


@pytest.mark.slow
def test_a_thing_beside_the_object_is_left_out_and_said_so(make_table, tmp_path, capsys):
    folder, rig, (ball, beside) = make_table([BALL, BESIDE], radius=1.5)
    metrics, masks = made(folder, tmp_path / "out")
    assert overlaps(masks, ball).mean() > 0.9
    assert len(metrics["others"]) == 1
    assert metrics["others"][0]["size"] == pytest.approx(0.8 / 0.9, abs=0.2)
    assert 0.75 < metrics["others"][0]["distance"] < 1.5  # cells reach beyond the balls

    text = metrics["warnings"][0]
    assert "one other thing" in text and "masks.parts: all" in text
    assert text in capsys.readouterr().err
    hidden = [n for n in ball if ball[n].sum() < 0.95 * max(m.sum() for m in ball.values())]
    assert set(metrics["hidden_in"]) & set(hidden)

    _, both = made(folder, tmp_path / "all", Masks(parts="all"))
    assert overlaps(both, {n: ball[n] | beside[n] for n in ball}).mean() > 0.85


@pytest.mark.slow
def test_one_corrected_mask_mends_the_set(make_table, tmp_path):
    folder, rig, (ball, resting) = make_table([BALL, RESTING], radius=0.9)
    _, before = made(folder, tmp_path / "before")
    both = {n: ball[n] | resting[n] for n in ball}
    assert overlaps(before, both).mean() > 0.85  # they touch: automatically, one thing

    side = max(ball, key=lambda n: resting[n].sum())
    write_png(folder / "masks" / f"{side}.png", ball[side] * np.uint8(255))
    metrics, after = made(folder, tmp_path / "after")
    others = {n: m for n, m in after.items() if n != side}
    assert metrics["given"] == [side] and metrics["method"] == "plane"
    assert (after[side] == ball[side]).all()
    left = lambda masks: np.mean([(masks[n] & resting[n]).sum() for n in others])
    assert left(after) < 0.35 * left(before)
    assert overlaps(others, ball).mean() > overlaps(before, ball).mean() + 0.1


@pytest.mark.slow
def test_without_a_ground_plane_one_mask_is_enough(make_table, tmp_path):
    folder, rig, (ball,) = make_table([BALL])
    rig.facts["plane"] = None
    save_cameras(folder / "cameras.json", rig)
    write_png(folder / "masks" / "p0.png", ball["p0"] * np.uint8(255))
    _, masks = made(folder, tmp_path / "out")
    assert overlaps(masks, ball).mean() > 0.85


def test_given_masks_win_and_missing_ones_are_named(table, tmp_path):
    folder, rig, truth = table
    for v in rig.views:
        write_png(folder / "masks" / f"{v.name}.png", truth[v.name] * np.uint8(255))
    metrics, masks = made(folder, tmp_path / "out")
    assert metrics["method"] == "given" and len(metrics["given"]) == len(rig.views)
    assert (masks[rig.views[0].name] == truth[rig.views[0].name]).all()
    (folder / "masks" / f"{rig.views[2].name}.png").unlink()
    with pytest.raises(InputError, match=rig.views[2].name):
        make_masks(folder, tmp_path, Masks(method="given"), 2)


def test_the_next_stage_learns_which_masks_carve(table, tmp_path):
    """From given.json alone: confidence.json is for people."""
    folder, _, truth = table
    spoilt = "p3"
    for name, mask in truth.items():
        half = mask & (np.arange(mask.shape[1]) > mask.shape[1] / 2)
        write_png(
            folder / "masks" / f"{name}.png", (half if name == spoilt else mask) * np.uint8(255)
        )
    made(folder, tmp_path / "out")
    known = MaskFacts.load(tmp_path / "out")
    assert known.all_given and set(known.carving) == set(truth) - {spoilt}


def test_without_a_ground_plane_the_cure_is_told(table, tmp_path):
    folder, rig, _ = table
    rig.facts["plane"] = None
    save_cameras(folder / "cameras.json", rig)
    with pytest.raises(InputError, match="folder masks/"):
        make_masks(folder, tmp_path, Masks(), 2)

    rig.facts |= NoGround("only 7 points were matched", "spread out a newspaper").facts()
    save_cameras(folder / "cameras.json", rig)
    with pytest.raises(InputError, match="only 7 points were matched(.|\n)*spread out a newspaper"):
        make_masks(folder, tmp_path, Masks(), 2)


def test_network_back_end_needs_its_file(table, tmp_path):
    with pytest.raises(InputError, match="no such network"):
        make_masks(table[0], tmp_path, Masks(method="onnx", onnx_model="/nowhere.onnx"), 2)


def test_cameras_that_look_elsewhere_are_said():
    assert said_of_things({"axes_miss_by": 0.1}) == []
    assert "40 % of its radius" in said_of_things({"axes_miss_by": 0.4})[0]
