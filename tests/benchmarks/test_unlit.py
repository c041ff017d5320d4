"""The unlit yardstick: the baked texture, its score on held-out views, and the row of a scene."""

import shutil

import numpy as np
import pytest

from benchmarks import view_dependence, viewer
from benchmarks.unlit import PhotoPixels, bake, load, picture, row, score_unlit
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, write_json
from pipeline.base.images import linear_to_srgb, read_exr, srgb_to_linear, write_exr, write_png
from pipeline.geometry.cameras import Rig, save_cameras
from pipeline.geometry.mesh_io import load_mesh
from pipeline.geometry.surface import Surface
from pipeline.posterior.choose.chosen import Chosen
from pipeline.posterior.textures import fill, gather
from pipeline.render.metrics import render_pixels, scored_pixels
from pipeline.render.observe import Tracer
from pipeline.render.renderer import Explanation, Renderer
from pipeline.surface.raster import texel_faces
from tests.seeds import numpy_rng

SIZE = 48  # of the photos
TEXELS = 64
SCORED = 300  # pixels


def painted(uv):
    """A smooth sRGB colour for each point (n, 2) of the unit square."""
    u, v = uv.T
    return np.stack([0.3 + 0.4 * u, 0.6 - 0.3 * v, 0.5 + 0.2 * np.sin(6 * u)], -1)


@pytest.fixture
def scattered():
    """Pixels all over the texture, showing `painted`."""
    uv = numpy_rng(0).random((60_000, 2)).astype(np.float32)
    return PhotoPixels(uv, painted(uv).astype(np.float32), np.ones(len(uv), np.float32))


def test_the_texture_is_what_pixels_show(scattered):
    texture, seen = bake(scattered, TEXELS)
    inner = scattered.uv[(np.abs(scattered.uv - 0.5) < 0.45).all(1)]
    assert seen.all()
    assert np.abs(gather(texture, inner) - painted(inner)).max() < 0.02


def test_a_minority_of_wrong_pixels_is_forgotten(scattered):
    wrong = numpy_rng(1).random(len(scattered.uv)) < 0.2
    scattered.color[wrong] = 1
    texture, _ = bake(scattered, TEXELS)
    error = np.abs(gather(texture, scattered.uv) - painted(scattered.uv)).mean()
    plain_mean = 0.2 * np.abs(1 - painted(scattered.uv)).mean()
    assert error < 0.4 * plain_mean


def test_the_better_view_of_a_texel_counts_for_more():
    uv = np.full((2, 2), 0.5, np.float32)
    color = np.array([[0.5, 0.5, 0.5], [0.52, 0.52, 0.52]], np.float32)
    texture, seen = bake(PhotoPixels(uv, color, np.array([0.9, 0.3], np.float32)), 8)
    np.testing.assert_allclose(texture[seen], 0.505, atol=2e-4)
    np.testing.assert_allclose(texture, 0.505, atol=2e-4)  # texels not shown take the nearest one's


@pytest.fixture
def work(tmp_path, ball, ring):
    """A scene's folder as after the refine stage: a ball that is painted, smoothly over the charts'
    borders, and looks the same from everywhere.
    """
    folder = tmp_path / "ball"
    for name in ("poses/images", "mesh/masks", "observe", "choose", "refine/0", "benchmarks"):
        (folder / name).mkdir(parents=True)
    shutil.copytree(ball, folder / "atlas")
    views = ring(8, SIZE)
    save_cameras(folder / "poses" / "cameras.json", Rig(views, np.zeros(3), 0.6, "given"))

    mesh = load_mesh(folder / "atlas" / "mesh_uv.ply")
    face, weight = texel_faces(mesh, 512)
    places = np.einsum("ijk,ijkc->ijc", weight, mesh.vertices[mesh.faces[face]])
    places = fill(places, face >= 0).astype(np.float32)
    tracer = Tracer(folder / "atlas" / "mesh_uv.ply")
    columns, rows = np.meshgrid(np.arange(SIZE), np.arange(SIZE))
    centres = np.stack([columns.ravel(), rows.ravel()], -1) + 0.5
    for view in views:
        uv, _, hit = tracer.hit(*view.rays(centres))
        color = srgb_to_linear(painted(0.5 + gather(places, uv)[:, :2]))
        color = np.where(hit[:, None], color, 0).reshape(SIZE, SIZE, 3)
        write_exr(folder / "poses" / view.image, color.astype(np.float32))
        mask = hit.reshape(SIZE, SIZE).astype(np.uint8) * 255
        write_png(folder / "mesh" / "masks" / f"{view.name}.png", mask)

    names = np.array([view.name for view in views])
    none = np.zeros(0)
    columns = dict.fromkeys(("view", "pixel", "rgb", "clipped", "cosine"), none)
    columns |= {"uv": np.zeros((0, 2))}
    file = folder / "observe" / "observations.npz"
    np.savez(file, **columns, views=names[1:], held_out=names[:1])

    write_json(folder / "choose" / "choose.json", {"decisions": {"texture": {"why": "off"}}})
    color = np.full((TEXELS, TEXELS, 3), 0.5, np.float32)
    write_exr(folder / "refine" / "0" / "base_color.exr", color)
    write_exr(folder / "refine" / "0" / "metallic.exr", np.full((TEXELS, TEXELS), 0.9, np.float32))
    write_exr(folder / "refine" / "0" / "roughness.exr", np.full((TEXELS, TEXELS), 0.3, np.float32))
    light = np.tile(np.exp([0.3, 0, -0.3]).astype(np.float32), (8, 16, 1))
    write_exr(folder / "refine" / "0" / "light.exr", light)
    scores = {"held_out_psnr": 20.0, "held_out": {"v0": 20.0}, "held_out_pixels": SCORED}
    write_json(folder / "refine" / "0" / "refine.json", scores)
    atlas = {"charts": 9, "utilisation": 0.6, "faces": 100}
    write_json(folder / "atlas" / "atlas.json", atlas)
    table = "s\th:m:s\tcpu_time\n12.5\t0:00:12\t20.0\n"
    (folder / "benchmarks" / "mesh.tsv").write_text(table)
    return folder


def test_what_looks_the_same_from_everywhere_is_predicted(work):
    scores, seen = score_unlit(work, TEXELS, erode=1.5)
    assert list(scores["robust"]) == ["v0"]
    assert scores["robust"]["v0"] > 35 and scores["plain"]["v0"] > 35
    assert 0.1 < seen.mean() < 0.9


def test_the_score_is_that_of_the_held_out_photo(work):
    """A held-out photo brighter by .1 in sRGB is missed by just that."""
    file = work / "poses" / "images" / "v0.exr"
    write_exr(file, srgb_to_linear(linear_to_srgb(read_exr(file)) + 0.1))
    scores, _ = score_unlit(work, TEXELS, erode=1.5)
    assert scores["robust"]["v0"] == pytest.approx(20.0, abs=0.4)


def test_pixels_beside_the_mesh_are_black(work, ring):
    view = ring(8, SIZE)[0]
    texture = np.full((8, 8, 3), 0.5, np.float32)
    mask = np.zeros((SIZE, SIZE), bool)
    mask[0, 0] = mask[SIZE // 2, SIZE // 2] = True
    found = picture(view, mask, texture, Tracer(work / "atlas" / "mesh_uv.ply"))
    assert found[0, 0].max() == 0
    np.testing.assert_allclose(found[SIZE // 2, SIZE // 2], srgb_to_linear(0.5), rtol=1e-5)
    assert (found.max(-1) > 0).sum() == 1


def test_lit_and_unlit_stand_side_by_side(work):
    found = row(work, erode=1.5)
    assert found["scene"] == "ball"
    assert found["lit_psnr"] == 20
    assert found["gain"] == pytest.approx(20 - found["unlit_psnr"])
    assert found["samples"][0]["metallic_median"] == pytest.approx(0.9)
    assert found["samples"][0]["roughness_median"] == pytest.approx(0.3)
    assert found["samples"][0]["light_warm"] == pytest.approx(0.6 / np.sqrt(2), abs=1e-3)
    assert found["mesh_seconds"] == 12.5 and found["cpu_seconds"] == {"mesh": 20.0}
    assert found["charts"] == 9 and found["utilisation"] == 0.6


def test_unlit_is_scored_in_the_pixels_that_lit_was_scored_in(work):
    """What the held-out photo shows beside them makes no difference."""
    held_out, *_ = load(work, 1.5)
    (chosen,) = scored_pixels(held_out, SCORED)
    assert chosen.sum() < held_out[0][2].sum()
    before = row(work, erode=1.5)["unlit_psnr"]

    file = work / "poses" / "images" / "v0.exr"
    photo = read_exr(file)
    for where, same in ((~chosen, True), (chosen, False)):
        write_exr(file, np.where(where[..., None], 0.9, photo).astype(np.float32))
        assert (row(work, erode=1.5)["unlit_psnr"] == before) == same


def test_unlit_has_the_texels_that_were_configured(work):
    """Not the fewer ones that the stage choose has left the asset, in colour or in gloss."""
    assert row(work, erode=1.5)["texture"] == {"unlit": TEXELS, "lit": TEXELS}
    gloss = np.full((TEXELS // 8, TEXELS // 8), 0.9, np.float32)
    for name in ("roughness", "metallic"):
        write_exr(work / "refine" / "0" / f"{name}.exr", gloss)
    before = row(work, erode=1.5)["unlit_psnr"]

    configured = {"configured": {"refine": {"texture": 2 * TEXELS}}}
    write_json(work / "choose" / "choose.json", {"decisions": {"texture": configured}})
    found = row(work, erode=1.5)
    assert found["texture"] == {"unlit": 2 * TEXELS, "lit": TEXELS}
    scores = score_unlit(work, 2 * TEXELS, 1.5, SCORED)[0]["robust"]
    assert before != found["unlit_psnr"] == pytest.approx(scores["v0"])


def test_scores_of_other_views_are_not_compared(work):
    file = work / "refine" / "0" / "refine.json"
    write_json(file, read_json(file) | {"held_out": {"v3": 20.0}})
    with pytest.raises(InputError, match="other views"):
        row(work, erode=1.5)
    shutil.rmtree(work / "refine" / "0")
    with pytest.raises(InputError, match="no refined sample"):
        row(work, erode=1.5)


def test_a_free_highlight_predicts_what_moves_with_the_camera(work, ring):
    """And adds nothing to photos in which nothing does."""
    still = view_dependence.row(work, erode=1.5)
    assert still["lit_psnr"] == [20.0] and set(still["views"]["free"]) == {"v0"}
    assert still["free_psnr"] > still["unlit_psnr"] - 0.3

    tracer, surface = Tracer(work / "atlas" / "mesh_uv.ply"), Surface.of(work / "atlas/mesh_uv.ply")
    columns, rows = np.meshgrid(np.arange(SIZE), np.arange(SIZE))
    centres = np.stack([columns.ravel(), rows.ravel()], -1) + 0.5
    for view in ring(8, SIZE):
        seen, hit = view_dependence.see(tracer, surface, view, centres)
        color = np.zeros((SIZE * SIZE, 3))
        lobe = 0.3 * np.exp(4 * (seen.reflected @ [0, 1, 0] - 1))
        color[hit] = srgb_to_linear(painted(seen.uv) + lobe[:, None])
        picture = color.reshape(SIZE, SIZE, 3).astype(np.float32)
        write_exr(work / "poses" / view.image, picture)
    moving = view_dependence.row(work, erode=1.5)
    assert moving["free_psnr"] > moving["unlit_psnr"] + 1
    assert moving["free"]["left"] < 0.7


def test_a_viewer_shows_what_an_asset_carries_better_than_the_renderers_numbers(work):
    """Photos of the renderer's own, of a dielectric that is rough."""
    flat = lambda value: np.full((TEXELS, TEXELS), value, np.float32)
    color = np.full((TEXELS, TEXELS, 3), 0.5, np.float32)
    x = Explanation(np.ones((8, 16, 3), np.float32), color, flat(1.0), flat(0.0))
    x.save(work / "refine" / "0")
    Chosen({"render": {"max_depth": 2}}).save(work / "choose")
    held_out, *_ = load(work, 1.5)
    view, photo, mask = held_out[0]
    made = Renderer(work / "atlas" / "mesh_uv.ply", TEXELS, 8, 2)
    picture = render_pixels(made, x, view, mask, 64)
    write_exr(work / "poses" / "images" / "v0.exr", picture)

    (sample,) = viewer.row(work, erode=1.5)["samples"]
    assert min(sample["renderer"], sample["exported"]) > sample["unchanged"] + 2
    assert sample["clipped"] == 0
