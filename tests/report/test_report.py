"""The report: one file, no outside address, every sample in it, and plain words about what went
wrong. What several tests look for on the same page is looked for in one report (`page`).
"""

import base64
import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pipeline.base.config import Scene
from pipeline.base.errors import InputError
from pipeline.base.files import read_json, write_json
from pipeline.base.images import linear_to_srgb, srgb_to_linear, to_srgb8, write_exr, write_png
from pipeline.geometry.cameras import Rig, save_cameras
from pipeline.geometry.mesh_io import load_mesh
from pipeline.geometry.normal_maps import write_normal_map
from pipeline.render.draw_metrics import COMMON_ERROR, half_width, predictive_reach
from pipeline.render.renderer import NO_HIGHLIGHT, Renderer
from pipeline.render.samples import LEVEL, Spread
from pipeline.render.stacking import LeftOut
from pipeline.render.surface_texels import SurfaceTexels
from pipeline.report import trust
from pipeline.report.choices import bare_choice, gloss_choices
from pipeline.report.draws import (
    alike_words,
    color_facts,
    relit_facts,
    unseen_words,
    weights_words,
)
from pipeline.report.files import asset_files
from pipeline.report.html import tint_from
from pipeline.report.make import make_report
from pipeline.report.pictures import (
    BESIDE,
    Painter,
    evening_light,
    heat,
    on_surface,
    range_words,
    roughness_words,
    spread_pictures,
    where_seen,
)
from pipeline.surface.raster import texel_faces
from tests.render.pictures import render_view
from tests.render.test_renderer import explanation
from tests.seeds import numpy_rng

SIZE = 48
SCENE = Scene(photos="nowhere", samples=2, preset="draft", report={"relight_size": 32, "spp": 16})
UPPER = np.arange(16)[:, None] < np.full(16, 12)  # texels that photos show, of 16 a side
FACTS = {
    "capture": {"clipped_share": 0.05},
    "poses": {"registered": 4, "photos": 5, "unregistered": ["blurred <b>"]},
    "masks": {},
    "mesh": {"method": "hull", "why": "stereo found too little", "mask_share_without_surface": 0.0},
    "observe": {"held_out": ["v1"]},
    "choose": {"decisions": {"texture": {"why": "choose.enabled is false"}}},
    "fit": {"warnings": ["the fit stopped early"]},
}


PHOTOS: list[np.ndarray] = []  # rendered once for the whole file


def photos(ball: Path, views) -> list[np.ndarray]:
    if not PHOTOS:
        renderer = Renderer(ball / "mesh_uv.ply", 16, 8, SCENE.render.max_depth)
        PHOTOS.extend(render_view(renderer, explanation(16, 8, seed=0), v, 64) for v in views)
    return PHOTOS


@pytest.fixture(scope="module", autouse=True)
def few_paths():
    """A report's evidence from few paths a pixel: what is said of it is on the page all the same.
    Its figures: test_trust.py.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trust, "SPP", 4)
        yield


@pytest.fixture
def work(tmp_path, ball, ring) -> Path:
    """Folders of a whole run on the ball, to be changed."""
    return finished_run(tmp_path / "work", ball, ring(4, SIZE))


@pytest.fixture(scope="module")
def page(tmp_path_factory, ball, ring) -> tuple[dict, str, Path]:
    """Metrics and text of the report of a run that nobody has changed, and the run's place."""
    place = tmp_path_factory.mktemp("reported")
    work = finished_run(place / "work", ball, ring(4, SIZE))
    out = place / "exports" / "mein garten é_report.html"
    asset = place / "mein <garten> é.usda"
    asset.touch()
    metrics = make_report(work, asset, out, SCENE)
    return metrics, out.read_text(encoding="utf-8"), place


def test_the_asset_is_a_click_away(page, page_of_one):
    """By an address relative to the page; what is not there is not named."""
    link = '<a href="../mein%20%3Cgarten%3E%20%C3%A9.usda">mein &lt;garten&gt; é.usda</a>'
    assert link in page[1] and ".usdz" not in page[1]
    assert "Open it" not in page_of_one[1]


@pytest.mark.parametrize("samples", [1, 2])
def test_all_files_of_an_asset_are_named(tmp_path, samples):
    made = ["a.usda", "a.usdz", *(f"a/sample_{k}.usda" for k in range(samples))]
    (tmp_path / "a").mkdir()
    for name in made:
        (tmp_path / name).touch()
    found = asset_files(tmp_path / "a.usda", tmp_path / "a_report.html", samples)
    assert [href for href, _, _ in found] == (made if samples > 1 else made[:2])


@pytest.fixture(scope="module")
def page_of_one(page) -> tuple[dict, str]:
    """The same of the run's first sample alone."""
    *_, place = page
    exported = place / "work" / "export.json"
    both = read_json(exported)
    write_json(exported, both | {"samples": 1})
    metrics = make_report(place / "work", place / "a.usda", place / "a.html", SCENE)
    write_json(exported, both)
    return metrics, (place / "a.html").read_text(encoding="utf-8")


def finished_run(work: Path, ball: Path, views) -> Path:
    """Folders of a whole run on the ball: view v1 is held out, its photo is rendered from sample
    0.
    """
    (work / "atlas").mkdir(parents=True)
    for f in ball.iterdir():
        (work / "atlas" / f.name).symlink_to(f)
    for stage, facts in FACTS.items():
        write_json(work / stage / f"{stage}.json", facts | {"seconds": 1.5, "peak_gib": 0.25})
    # nothing is known around the object; one pixel, for the photos held out are asked for here
    pixel = {"pixel": np.zeros((1, 2)), "rgb": np.ones((1, 3)), "clipped": np.zeros((1, 3), bool)}
    where = {"view": np.zeros(1, int), "uv": np.zeros((1, 2)), "cosine": np.ones(1)}
    names = {"views": np.array(["v0", "v2", "v3"]), "held_out": np.array(["v1"])}
    np.savez(work / "observe" / "observations.npz", **pixel, **where, **names)
    write_json(work / "export.json", {"seconds": 0.5, "samples": 2})
    write_json(work / "atlas" / "atlas.json", {"utilisation": 0.6, "seconds": 2.0})
    save_cameras(work / "poses" / "cameras.json", Rig(views, np.zeros(3), 0.5, "sfm"))
    samples = [explanation(16, 8, seed=k) for k in range(2)]
    for k, x in enumerate(samples):
        x.save(work / "refine" / str(k))
        LeftOut(np.arange(2), np.eye(2)[[k, k], :, None] * np.ones(3)).save(
            work / "refine" / str(k)
        )
        SurfaceTexels.of(load_mesh(ball / "mesh_uv.ply"), UPPER).save(work / "refine" / str(k))
        write_json(
            work / "refine" / str(k) / "refine.json", {"held_out_psnr": 30.0 + k, "seconds": 3.0}
        )
        write_json(work / "sample" / str(k) / "sample.json", {"seconds": 4.0})
    for folder in ("poses/images", "mesh/masks", "masks/masks"):
        (work / folder).mkdir(parents=True, exist_ok=True)
    for v, photo in zip(views, photos(ball, views)):
        write_exr(work / "poses" / v.image, photo)
        for stage in ("mesh", "masks"):
            mask = (photo.sum(-1) > 0).astype(np.uint8) * 255
            write_png(work / stage / "masks" / f"{v.name}.png", mask)
    Image.fromarray(to_srgb8(photo)).save(work / "masks" / "overlay.jpg")
    for name in ("mesh/preview.png", "atlas/atlas.png"):
        if not (work / name).exists():
            Image.fromarray(to_srgb8(photo)).save(work / name)
    return work


def test_page_is_whole_and_self_contained(page):
    metrics, html, place = page
    pictures = html.split("<script", 1)[0]  # the viewer's own stand behind
    sources = re.findall(r'(?:src|link[^>]*href|url)\s*[=(]\s*["\']?([^"\'\s>)]*)', pictures)
    assert sources and all(s.startswith("data:image/") for s in sources)
    assert not re.search(
        r"https?://|//[a-z]+\.|@import|<script [^>]*src|" + re.escape(str(place)), html
    )
    for s in sources:  # every picture decodes
        Image.open(io.BytesIO(base64.b64decode(s.split(",", 1)[1]))).load()
    # photos, masks, mesh, atlas, photo; 4 spreads; 3 lights + 6 pictures of the mean, each sample
    assert len(sources) == 5 + 4 + 3 * 9
    assert metrics["view"] == "v1" and metrics["mib"] < 8 and "held out: no fit has seen it" in html
    assert "variant sample_1 of mein &lt;garten&gt; é.usda" in html and "<garten>" not in html
    assert "30.5 dB PSNR" in html and "hull" in html and "stereo found too little" in html


def test_the_mean_of_samples_comes_first_with_its_own_score(page, page_of_one):
    """On the photo that was held out; it was rendered from sample 0, of two."""
    metrics, html, _ = page
    mean = metrics["mean_held_out_psnr"]
    assert 10 < mean < 40 and f"30.5 dB PSNR a sample, {mean:.1f} their mean" in html
    assert html.index("variant mean of") < html.index("variant sample_0 of")
    metrics, html = page_of_one
    assert "mean_held_out_psnr" not in metrics and "variant mean" not in html


def test_the_page_says_how_much_each_sample_counts_in_the_mean(page, page_of_one):
    """Both of them err alike, each at a place of its own; where no photo judges it says that."""
    metrics, html, _ = page
    np.testing.assert_allclose(metrics["weights"], 0.5, atol=1e-3)
    assert "The mean counts sample 0 by 50 % and 1 by 50 %" in html
    assert "The mean counts" not in page_of_one[1]
    assert "too few" in weights_words(np.full(2, 0.5), 0)


def test_how_many_samples_were_made_is_said_where_it_was_left_open(work, tmp_path):
    found = {"drawn": 2, "needed": 5, "samples": 2, "spread": 0.041, "known_to": 0.02}
    write_json(work / "enough" / "1" / "enough.json", found)
    scene = SCENE.model_copy(update={"samples": "auto"})
    make_report(work, tmp_path / "a.usda", tmp_path / "a.html", scene)
    html = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "<td>2, as many as allowed" in html and "5 give a mean that is known to 0.02" in html


def test_a_scene_of_which_nothing_was_held_out_says_so(work, tmp_path):
    """`observe: {held_out: 0}`: every photo is in the asset."""
    write_json(work / "observe" / "observe.json", {"held_out": []})
    for k in range(2):
        file = work / "refine" / str(k) / "refine.json"
        write_json(file, {"held_out_psnr": None, "held_out_standard_error": None, "held_out": {}})
    metrics = make_report(work, tmp_path / "a.usda", tmp_path / "a.html", SCENE)
    html = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "none was held out: every photo is in the asset" in html and "used in the fit" in html
    assert metrics["trust"] is None


def test_the_page_says_where_the_lights_colour_is_from():
    """Off, unknown to a sampler, or not to be seen: the object alone tells of it."""
    seen, cut_out = {"tint_around": [0.1, 0.0]}, {"surroundings": "none: nothing but the object"}
    assert tint_from(SCENE, seen) == "from what the photos show around the object"
    assert tint_from(SCENE, cut_out) == "from the object alone: nothing but the object"
    other = {"sample": SCENE.sample.model_copy(update={"method": "dpi_paper"})}
    off = {"observe": SCENE.observe.model_copy(update={"tint": False})}
    for update in (other, off):
        assert tint_from(SCENE.model_copy(update=update), seen) == "from the object alone"


def test_warnings_are_on_the_page(page):
    _, html, _ = page
    assert "1 of 5 photos could not be placed" in html and "blurred &lt;b&gt;" in html
    assert "5 % of the pixels are saturated" in html and "fit: the fit stopped early" in html
    assert "hollows that no outline shows are filled" in html  # the surface is a hull


def test_trust_is_on_the_page_and_in_the_metrics(page, page_of_one):
    metrics, html, _ = page
    assert 'class="trust"' in html and "The chance that pictures under new light" in html
    assert "a surface made from photos costs under new light" in html  # the mesh was not given
    found = metrics["trust"]
    assert found["explained"] == 30.5 and 0 < found["chance_of_failure"] < 1
    metrics, html = page_of_one
    assert metrics["trust"] is None and "takes two samples at least" in html


@pytest.mark.parametrize("count", [2, 3, 6])
def test_intervals_of_right_samples_hold_what_they_say(count):
    drawn = numpy_rng(0).normal(size=(count + 1, 20_000))
    samples, truth = drawn[:-1], drawn[-1]
    reach = predictive_reach(count, LEVEL) * samples.std(0, ddof=1)
    assert (np.abs(truth - samples.mean(0)) <= reach).mean() == pytest.approx(LEVEL, abs=0.02)


def test_how_far_colours_may_be_off_is_on_the_page(page, page_of_one):
    metrics, html, _ = page
    assert f"within ±{metrics['color_within']:.2f} (sRGB) of the mean of" in html
    assert f"another light within ±{metrics['relit_within']:.2f}" in html
    for what in ("color_within", "relit_within"):
        assert half_width(0, 2, LEVEL, COMMON_ERROR) < metrics[what] < metrics[f"{what}_hard"]
    metrics, html = page_of_one
    assert "color_within" not in metrics and "relit_within" not in metrics
    assert "The true base colour is put within" not in html


def test_relit_views_may_be_off_by_what_samples_differ_and_what_they_share():
    """Two samples that differ by d have the deviation d / sqrt 2; most pixels by .1, in sRGB and
    under a light of brightness 2.
    """
    one = np.full((100, 3), 0.4)
    other = one + np.where(np.arange(100) < 90, 0.1, 0.3)[:, None]
    radiance = [srgb_to_linear(shown) / 2 for shown in (one, other)]
    found = relit_facts(radiance, 2.0)
    apart = predictive_reach(2, LEVEL) * 0.1 / np.sqrt(2)
    together = 1.2816 * COMMON_ERROR  # of 80 % of a normal error
    assert found["relit_within"] == pytest.approx(np.hypot(apart, together), rel=1e-3)
    alike = relit_facts(3 * radiance[:1], 2.0)
    assert list(alike.values()) == pytest.approx(2 * [together], rel=1e-3)
    assert relit_facts(radiance[:1], 2.0) == {}


@pytest.mark.slow
def test_normal_map_is_on_the_page_where_there_is_one(page, work, tmp_path):
    _, html, _ = page
    assert "normal map" not in html

    write_normal_map(work / "atlas" / "normal.png", np.broadcast_to([0.0, 0.0, 1.0], (8, 8, 3)))
    facts = {"utilisation": 0.6, "normal_map_median_tilt": 7.25}
    write_json(work / "atlas" / "atlas.json", facts)
    make_report(work, tmp_path / "a.usda", tmp_path / "a.html", SCENE)
    html = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert "normal map: what decimation took, 7.2 degrees" in html
    assert html.split("<script", 1)[0].count("data:image/") == 5 + 4 + 3 * 9 + 1


def test_one_sample_shows_no_spread(page_of_one):
    _, html = page_of_one
    assert "One sample shows no spread" in html and "standard deviation of" not in html


def test_a_missing_stage_is_named_and_the_old_page_stays(work, tmp_path):
    out = tmp_path / "a.html"
    out.write_text("old")
    (work / "fit" / "fit.json").unlink()
    with pytest.raises(InputError, match="fit.json"):
        make_report(work, tmp_path / "a.usda", out, SCENE)
    assert out.read_text() == "old"


def test_render_agrees_with_the_projection(ball, ring):
    """Against `View.project`, not against another render: an off-centre wide view, so that no swap
    or flip goes unseen.
    """
    view = replace(ring(4, SIZE)[1], width=64, height=40, fx=50.0, fy=50.0, cx=44.0, cy=14.0)
    picture = render_view(Renderer(ball / "mesh_uv.ply", 16, 8, 2), explanation(16, 8), view, 8)
    rows, columns = np.nonzero(picture.sum(-1))
    uv, _ = view.project(load_mesh(ball / "mesh_uv.ply").vertices)
    assert np.allclose(
        [columns.min(), rows.min(), columns.max() + 1, rows.max() + 1],
        [*uv.min(0), *uv.max(0)],
        atol=1.2,
    )


def test_the_shown_render_is_the_photos_view(work):
    from pipeline.geometry.cameras import load_cameras

    view = next(v for v in load_cameras(work / "poses" / "cameras.json").views if v.name == "v1")
    painter = Painter(work, view, SCENE, SurfaceTexels.load(work / "refine" / "0"))
    picture = lambda b: np.asarray(Image.open(io.BytesIO(b))).astype(float)
    shown, photo = (
        picture(painter.sample(explanation(16, 8, seed=0))["render"]),
        picture(painter.photo_jpeg()),
    )
    error = lambda a: np.abs(a - photo).mean()
    assert error(shown) < 8 and error(shown) < 0.6 * min(error(shown[::-1]), error(shown[:, ::-1]))


def test_render_lines_up_with_the_photo(work, ring):
    """The sample that made the photo beats another one, and a mirrored photo: orientation and maps
    reach the page right.
    """
    from pipeline.geometry.cameras import load_cameras

    view = next(v for v in load_cameras(work / "poses" / "cameras.json").views if v.name == "v1")
    painter = Painter(work, view, SCENE, SurfaceTexels.load(work / "refine" / "0"))
    right, wrong = (painter.sample(explanation(16, 8, seed=k))["psnr"] for k in (0, 1))
    painter.photo = painter.photo[:, ::-1]
    mirrored = painter.sample(explanation(16, 8, seed=0))["psnr"]
    assert right > 25 and right > wrong + 3 and right > mirrored + 3


def test_spread_is_dark_where_samples_agree():
    picture = lambda b: np.asarray(Image.open(io.BytesIO(b))).astype(int)
    pair = [explanation(16, 8, seed=0), explanation(16, 8, seed=1, roughness=0.9)]
    everywhere = np.ones((16, 16), bool)
    shown = spread_pictures(Spread.of(pair), SurfaceTexels(everywhere, everywhere))
    base, rough, metal, light = (picture(b) for b in shown.values())
    assert np.abs(metal - heat(np.zeros((1, 1)), 1)[0, 0]).max() < 6  # same metallic in both
    deviation = np.full((1, 1), 0.4 / np.sqrt(2))  # of roughness .5 and .9
    assert np.abs(rough - heat(deviation, 0.3)[0, 0]).max() < 6
    assert base.mean() > metal.mean() + 5 and light.mean() > metal.mean() + 5


def test_a_spread_is_shown_where_photos_show_the_surface(page):
    """Elsewhere grey, and black beside the charts; the page says how much is grey."""
    color = np.full((16, 16, 3), 200, np.uint8)
    surface = np.arange(16)[None] < np.full((16, 1), 12)
    texels = SurfaceTexels(surface, surface & UPPER)
    shown = where_seen(color, texels)
    assert (shown[UPPER & surface] == 200).all() and (shown[~UPPER & surface] == 128).all()
    assert (shown[~surface] == BESIDE).all()
    assert (on_surface(color[..., 0], texels)[surface] == 200).all()
    metrics, html, _ = page
    share = metrics["unseen_share"]
    assert 0.1 < share < 0.5 and f"No photo shows {100 * share:.0f} % of the surface" in html
    assert re.search("photos from [a-z ]+ would show", html)


def test_the_page_says_where_photos_are_missing(ball):
    mesh = load_mesh(ball / "mesh_uv.ply")
    face = texel_faces(mesh, 64)[0]
    centre = mesh.vertices[mesh.faces].mean(1)[face]  # the ball's own normals, about its centre
    surface = face >= 0
    for where, hidden in (
        ("below", centre[..., 1] < -0.2),
        ("above", centre[..., 1] > 0.2),
        ("other sides", np.abs(centre[..., 1]) < 0.2),
    ):
        said = unseen_words(mesh, SurfaceTexels(surface, surface & ~hidden))
        assert f"photos from {where} would show" in said
    assert unseen_words(mesh, SurfaceTexels(surface, surface)) == ""


def test_that_all_samples_have_one_roughness_is_called_a_choice():
    rough = [explanation(16, 8, seed=k, roughness=0.9) for k in (0, 1)]
    said = alike_words(Spread.of(rough), tested=True)
    assert "does not make it certain" in said
    assert alike_words(Spread.of(rough), tested=False) == ""
    other = explanation(16, 8, seed=1, roughness=0.5)
    assert alike_words(Spread.of([rough[0], other]), tested=True) == ""


def test_evening_light_comes_from_its_sun():
    from pipeline.render.envmap import directions, mean_radiance

    light = evening_light(16)
    assert np.isclose(mean_radiance(light).mean(), 1, rtol=1e-4) and light.min() > 0
    brightest = directions(16, 32)[np.unravel_index(light.sum(-1).argmax(), (16, 32))]
    assert brightest @ (np.array([0.75, 0.35, 0.56]) / np.linalg.norm([0.75, 0.35, 0.56])) > 0.97


def test_facts_of_the_page_are_the_stages_own(work):
    from pipeline.report.make import stage_facts

    facts = stage_facts(work, auto=False)
    assert (
        facts["refine 1"] == read_json(work / "refine" / "1" / "refine.json")
        and list(facts)[-1] == "export"
    )


@pytest.mark.slow
def test_choices_are_said_with_their_evidence(page, work):
    """Nothing where `choose` is off; else what was chosen, what was allowed, and why."""
    _, html, _ = page
    assert "No more model" not in html

    bounces = {
        "chosen": {"render": {"max_depth": 2}},
        "configured": {"render": {"max_depth": 4}},
        "evidence": {
            "hemisphere_blocked_by_the_object": {"mean": 0.031},
            "lost_share_by_max_depth": {"2": 0.014, "3": 0.0},
        },
    }
    fit = {
        "chosen": {"fit": {"texture": 64, "steps": 120, "pixels": 1366}},
        "configured": {"fit": {"texture": 256, "steps": 300, "pixels": 8192}},
        "evidence": {"looks_at_a_texel": 40.02},
    }
    write_json(work / "choose" / "choose.json", {"decisions": {"bounces": bounces, "fit": fit}})
    step = lambda to, gain: {"from": 0, "to": to, "gain": gain, "standard_error": 0.04}
    gloss = {
        "photos_left_out": 3,
        "blocks": 70,
        "rungs": ["matt", "one gloss", "gloss map"],
        "surface": {"chosen": "matt", "tried": []},
        "bodies": [
            {"share": 0.8, "chosen": "one gloss", "tried": [step(1, 0.31), step(2, 0.02)]},
            {"share": 0.1, "chosen": "matt", "tried": [step(1, -0.025), step(2, 0.05)]},
            {"share": 0.05, "chosen": "matt", "tried": [step(1, -0.025), step(2, -0.01)]},
            {"share": 0.04, "chosen": "matt", "tried": [step(1, -0.02), step(2, -0.01)]},
            {"share": 0.0, "chosen": "gloss map", "tried": []},
        ],
    }
    refined = read_json(work / "refine" / "1" / "refine.json")
    write_json(work / "refine" / "1" / "refine.json", refined | {"gloss": gloss})

    make_report(work, Path("x.usda"), work / "r.html", SCENE)
    said = (work / "r.html").read_text(encoding="utf-8")
    rows = [re.split("<t[dh][^>]*>", row)[1:] for row in said.split("<tr>")]
    rows = [[cell.strip() for cell in row] for row in rows]
    start = rows.index(["of what", "chosen", "why"]) + 1
    assert rows[start : start + 5] == [
        [
            "surface interactions of light",
            "1 of 3",
            "the object hides 3.1 % of its own sky, and what is left out is 1.4 % of the light",
        ],
        [
            "the fit",
            "120 of 300 steps, 1366 of 8192 pixels, 64 of 256 texels a side",
            "every texel is looked at 40 times",
        ],
        [
            "gloss and metal of sample 1",
            "matt",
            "nothing else was tried; judged by 70 blocks of 3 photos left out",
        ],
        ["a body of it, 80 %", "one gloss", "it saves 31.0 % ± 4.0 of the error of matt"],
        [
            "a body of it, 10 %",
            "matt",
            "gloss map would save 5.0 % ± 4.0 of the error: too little to be sure",
        ],
    ]
    assert rows[start + 5][:2] == ["2 bodies of it, 9 %", "matt"]
    assert rows[start + 5][2].startswith("nothing else predicts better")
    assert "sample 0" not in str(rows[start : start + 6])


def test_a_gloss_that_nothing_could_judge_is_said_so():
    found = gloss_choices("2", {"why": "too few photos to judge them by"})
    assert found == [
        ("gloss and metal of sample 2", "maps, as drawn", "too few photos to judge them by")
    ]


@pytest.mark.parametrize(
    "gain, chosen, said",
    [
        (0.05, True, "to have none saves 5.0 % ± 1.0 of the error of the above"),
        (-0.1, False, "without any it predicts no better"),
    ],
)
def test_a_sample_without_a_highlight_is_said_so(gain, chosen, said):
    tried = {"gain": gain, "standard_error": 0.01, "chosen": chosen}
    ((what, how, why),) = bare_choice("2", tried)
    assert what == "highlight of sample 2" and why == said
    assert how == ("none, in place of the above" if chosen else "as above")
    assert bare_choice("2", None) == []
    x = replace(explanation(), ior=NO_HIGHLIGHT if chosen else 1.5)
    assert ("no highlight" in roughness_words(x)) == chosen


def test_a_constant_map_has_its_value_in_words():
    assert range_words(np.full((4, 4), 0.812)) == "0.81 everywhere"
    assert range_words(np.linspace(0.81, 0.82, 16)) == "white = 1"


def test_samples_needed_follow_from_their_spread(page):
    """Of two base colours that differ by d everywhere the standard deviation is d / sqrt 2."""
    one = explanation(16, 8, seed=0)
    color = np.full((16, 16, 3), 0.2, np.float32)
    other = linear_to_srgb(color) + 0.1
    pair = [replace(one, base_color=color), replace(one, base_color=srgb_to_linear(other))]
    everywhere = SurfaceTexels(np.ones((16, 16), bool), np.ones((16, 16), bool))
    found = color_facts(Spread.of(pair), everywhere)
    assert found["spread"] == pytest.approx(0.1 / np.sqrt(2), rel=1e-3)
    assert found["samples_needed"] == 13  # .005 / .0004 = 12.5
    reach = half_width(0.1 / np.sqrt(2), 2, LEVEL, COMMON_ERROR)
    assert [found[k] for k in ("color_within", "color_within_hard")] == pytest.approx(
        [reach, reach], rel=1e-3
    )
    assert color_facts(Spread.of([pair[0], pair[0]]), everywhere)["samples_needed"] == 2

    metrics, said, _ = page
    assert f"so {metrics['samples_needed']} give a mean" in said
