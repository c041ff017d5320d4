"""Scores of finished assets: a right one scores at the renderer's limit, wrong ones less, and other
tools' layouts are read.
"""

import json
import shutil
import sys
from dataclasses import replace

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade

from benchmarks.make_scene import Options, make_scene
from pipeline.base.errors import InputError
from pipeline.base.images import read_exr, read_png, srgb_to_linear, write_exr, write_png
from pipeline.geometry.cameras import Y_FROM_Z_UP
from pipeline.geometry.mesh_io import Mesh, load_mesh, save_mesh
from pipeline.render.declared import METRICS
from pipeline.render.renderer import Explanation
from pipeline.render.stacking import LeftOut
from pipeline.report.score import best_factor, picture_psnr, score_asset, table
from pipeline.report.truth import Picture, load_truth
from pipeline.run import cli
from pipeline.usd.preview_surface import for_preview_surface
from pipeline.usd.read import read_asset, turned
from pipeline.usd.write import export
from tests.seeds import numpy_rng

SPP = 64


@pytest.fixture(scope="module")
def scene(ball, tmp_path_factory):
    """A two-coloured ball under a light with a bright half, as asset and as scene with truth."""
    folder = tmp_path_factory.mktemp("scored")
    mesh = load_mesh(ball / "mesh_uv.ply")
    back = Y_FROM_Z_UP[:3, :3]  # from Y-up to the Z-up of an asset folder
    z_up = Mesh(mesh.vertices @ back, mesh.faces, mesh.normals @ back, mesh.uv)
    (folder / "asset").mkdir()
    save_mesh(folder / "asset" / "mesh.ply", z_up)
    color = np.full((16, 16, 3), (190, 120, 60))
    color[:, 8:] = (60, 120, 160)
    write_png(folder / "asset" / "base_color.png", color)
    write_png(folder / "asset" / "roughness.png", np.full((16, 16), 128))
    write_png(folder / "asset" / "metallic.png", np.zeros((16, 16)))

    light = np.full((16, 32, 3), 0.7, np.float32)
    light[3:7, 4:10] = (6, 5, 4)
    write_exr(folder / "own.exr", light)
    write_exr(folder / "other.exr", np.roll(light, 13, 1)[..., ::-1])
    options = Options(size=48, spp=256, views=2, test=2)
    lights = folder / "own.exr", [folder / "other.exr"]
    make_scene(folder / "asset", *lights, options, folder / "scene")
    return folder


def true_explanation(scene) -> Explanation:
    grey = lambda name: (read_png(scene / "asset" / f"{name}.png") / 255).astype(np.float32)
    color = srgb_to_linear(read_png(scene / "asset" / "base_color.png") / 255)
    light = read_exr(scene / "scene" / "truth" / "envmap.exr")
    return Explanation(light, color, grey("roughness"), grey("metallic"))


def exported(scene, ball, tmp_path, *explanations):
    """The .usda of these explanations on the true mesh."""
    folders = []
    for k, x in enumerate(explanations):
        folders.append(tmp_path / f"sample{k}")
        x.save(folders[-1])
        LeftOut.by_none().save(folders[-1])
    out = tmp_path / "ball.usda"
    export(ball, folders, out, {"preset": "draft"})
    return out


def wrong(x: Explanation) -> Explanation:
    """Its base colour too dark, in other proportions."""
    other = x.copy()
    other.base_color = (x.base_color * [0.5, 0.7, 0.9]).astype(np.float32)
    return other


@pytest.mark.slow
def test_a_right_asset_scores_at_the_limit_and_a_wrong_one_less(scene, ball, tmp_path):
    x = true_explanation(scene)
    truth = load_truth(scene / "scene")
    found = score_asset(exported(scene, ball, tmp_path, x, wrong(x)), truth, SPP)
    right, less = (found["samples"][f"sample_{k}"]["scores"] for k in (0, 1))

    # what 8-bit textures, 32 paths a picture and their tone-mapping leave
    assert right["relight_psnr"] > 38 and right["novel_view_psnr"] > 38
    assert right["albedo_mse"] < 1e-4 and right["roughness_mse"] < 1e-4
    assert right["light_psnr_log"] > 60 and right["sun_degrees"] < 0.1
    assert right["outline_overlap"] > 0.9

    assert less["relight_psnr"] < right["relight_psnr"] - 12
    assert less["albedo_mse"] > 100 * right["albedo_mse"]
    # one factor cannot mend other proportions, a factor for each channel can
    assert less["albedo_mse_scalar"] > 1e-3 and less["albedo_mse_channel"] < 1e-4
    dielectric = less["relight_psnr_channel"]
    assert less["relight_psnr"] + 5 < dielectric < right["relight_psnr"]

    assert set(right) - {"outline_overlap"} | set(found["together"]) == set(METRICS)
    assert "relight PSNR (dB)" in table(found)


def in_unit(scene, unit, folder):
    """The scene with photos in EXR, its radiance in another unit."""
    shutil.copytree(scene / "scene", folder)
    for file in folder.glob("truth/**/*.exr"):
        if not {"albedo", "roughness", "metallic", "normal"} & set(file.parts):
            write_exr(file, unit * read_exr(file))
    cameras = folder / "transforms_test.json"
    cameras.write_text(cameras.read_text().replace(".png", ".exr"))
    for file in folder.glob("images/test_*.png"):
        shutil.copy(folder / "truth" / "linear" / f"{file.stem}.exr", file.with_suffix(".exr"))
    return folder


@pytest.mark.parametrize("unit", [2.0**-7, 2.0**6])
def test_scores_do_not_depend_on_the_unit_of_radiance(scene, ball, tmp_path, unit):
    """Above the unit's white every two pictures are alike, and in a large unit all are black."""
    x = true_explanation(scene)
    found = []
    for k, scale in enumerate((unit, unit * 2.0 ** np.sign(np.log2(unit)))):
        truth = load_truth(in_unit(scene, scale, tmp_path / f"scene{k}"))
        lit = [replace(one, light=scale * one.light) for one in (x, wrong(x))]
        (tmp_path / str(k)).mkdir()
        asset = exported(scene, ball, tmp_path / str(k), *lit)
        found.append(score_asset(asset, truth, SPP)["samples"])

    right, less = (found[0][f"sample_{k}"]["scores"] for k in (0, 1))
    assert right["relight_psnr"] > 33 and right["novel_view_psnr"] > 33
    assert less["relight_psnr"] < right["relight_psnr"] - 12
    assert abs(right["light_level"]) < 1e-3
    # the white is a power of two, which changes no digit
    for name in ("relight_psnr", "novel_view_ssim", "light_level"):
        assert found[1]["sample_0"]["scores"][name] == pytest.approx(right[name], abs=1e-5)


def plain_stage(path, scene, up=UsdGeom.Tokens.z):
    """Another tool's stage: Z-up, a polygon mesh with st at faces' corners, no normals, scaled by
    its transform, and a dome light turned to Z-up. Returns stage, mesh and light.
    """
    mesh = load_mesh(scene / "scene" / "mesh.ply")  # Z-up
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.Xform.Define(stage, "/World").AddScaleOp().Set(Gf.Vec3f(0.5, 0.5, 0.5))
    prim = UsdGeom.Mesh.Define(stage, "/World/thing")
    prim.CreatePointsAttr((2 * mesh.vertices).tolist())
    prim.CreateFaceVertexCountsAttr([3] * len(mesh.faces))
    prim.CreateFaceVertexIndicesAttr(mesh.faces.ravel().tolist())
    prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    st = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(
        "UVMap", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
    )
    st.Set(mesh.uv[mesh.faces.ravel()].tolist())

    dome = UsdLux.DomeLight.Define(stage, "/World/env")
    dome.AddRotateXOp().Set(90.0)
    file = scene / "scene" / "truth" / "envmap.exr"
    dome.CreateTextureFileAttr(Sdf.AssetPath(str(file)))
    dome.CreateIntensityAttr(0.5)
    dome.CreateExposureAttr(1.0)  # 0.5 * 2 = 1
    return stage, prim, dome


def constant_material(stage, prim, **values):
    """UsdPreviewSurface without a texture, bound to the mesh."""
    material = UsdShade.Material.Define(stage, "/World/look")
    surface = UsdShade.Shader.Define(stage, "/World/look/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    kinds = Sdf.ValueTypeNames
    for name, value in values.items():
        kind = kinds.Color3f if name == "diffuseColor" else kinds.Float
        surface.CreateInput(name, kind).Set(value)
    source = surface.CreateOutput("surface", kinds.Token)
    material.CreateSurfaceOutput().ConnectToSource(source.GetAttr().GetPath())
    UsdShade.MaterialBindingAPI.Apply(prim.GetPrim()).Bind(material)


def test_another_tools_layout_is_read(scene, ball, tmp_path):
    """Constants for textures, one of them missing; Z-up; the same mesh and light come out."""
    stage, prim, _ = plain_stage(tmp_path / "plain.usda", scene)
    constant_material(stage, prim, diffuseColor=Gf.Vec3f(0.2, 0.3, 0.4), metallic=1.0)
    stage.GetRootLayer().Save()

    asset = read_asset(tmp_path / "plain.usda")
    x = asset.explanation
    np.testing.assert_allclose(
        x.base_color.reshape(-1, 3), 0 * x.base_color.reshape(-1, 3) + [0.2, 0.3, 0.4], atol=1e-6
    )  # a metal's is not the viewer's own
    assert (x.metallic == 1).all() and (x.roughness == 0.5).all()
    assert any("roughness is not authored" in note for note in asset.notes)

    truth = load_truth(scene / "scene")
    np.testing.assert_allclose(x.light, truth.light, rtol=1e-4)
    mine, true = load_mesh(ball / "mesh_uv.ply"), asset.mesh
    np.testing.assert_allclose(true.vertices, mine.vertices[mine.faces.ravel()], atol=1e-6)
    np.testing.assert_allclose(true.uv, mine.uv[mine.faces.ravel()], atol=1e-6)
    outward = (true.normals * true.vertices).sum(1)
    assert outward.min() > 0

    found = score_asset(tmp_path / "plain.usda", truth, 16)
    assert 5 < found["samples"]["asset"]["scores"]["relight_psnr"] < 30


def test_a_texture_is_read_as_its_shader_says(scene, tmp_path):
    """Scale and bias, a channel of a colour texture, raw and sRGB."""
    values = np.zeros((4, 8, 3), np.uint8)
    values[..., 0], values[..., 1], values[..., 2] = 51, 102, 204
    write_png(tmp_path / "map.png", values)
    stage, prim, _ = plain_stage(tmp_path / "textured.usda", scene)
    constant_material(stage, prim, metallic=0.0)
    surface = UsdShade.Shader(stage.GetPrimAtPath("/World/look/surface"))
    kinds = Sdf.ValueTypeNames
    for slot, output, space, scale in (
        ("diffuseColor", "rgb", "sRGB", 1.0),
        ("roughness", "g", "raw", 0.5),
    ):
        shader = UsdShade.Shader.Define(stage, f"/World/look/{slot}")
        shader.CreateIdAttr("UsdUVTexture")
        shader.CreateInput("file", kinds.Asset).Set(Sdf.AssetPath("./map.png"))
        shader.CreateInput("sourceColorSpace", kinds.Token).Set(space)
        shader.CreateInput("scale", kinds.Float4).Set(Gf.Vec4f(scale, scale, scale, 1))
        shader.CreateInput("bias", kinds.Float4).Set(Gf.Vec4f(0.1 * (scale < 1)))
        kind = kinds.Float3 if output == "rgb" else kinds.Float
        shader.CreateOutput(output, kind)
        surface.CreateInput(slot, kind).ConnectToSource(shader.ConnectableAPI(), output)
    stage.GetRootLayer().Save()

    x = read_asset(tmp_path / "textured.usda").explanation
    shown = for_preview_surface(x)[0].base_color[3, 3]
    np.testing.assert_allclose(shown, srgb_to_linear(values[0, 0] / 255), atol=1e-6)
    assert (x.base_color[3, 3] < shown).all()
    np.testing.assert_allclose(x.roughness, 0.5 * 102 / 255 + 0.1, atol=1e-6)


@pytest.mark.parametrize("ior, read", [(1.0, 1.0), (1.33, 1.33), (2.4, 1.5)])
def test_an_index_of_refraction_is_read_where_the_renderer_has_it(scene, tmp_path, ior, read):
    stage, prim, _ = plain_stage(tmp_path / "plain.usda", scene)
    constant_material(stage, prim, roughness=0.5, metallic=0.0, ior=ior)
    stage.GetRootLayer().Save()
    asset = read_asset(tmp_path / "plain.usda")
    assert asset.explanation.ior == pytest.approx(read)
    assert any("ior is left out" in note for note in asset.notes) == (ior != read)


def test_what_is_not_read_is_said(scene, tmp_path):
    """Hidden meshes and inputs that the renderer has not are noted, moved textures refused."""
    stage, prim, _ = plain_stage(tmp_path / "rich.usda", scene)
    constant_material(stage, prim, opacity=0.5, ior=1.5, clearcoat=1.0)
    UsdGeom.Mesh.Define(stage, "/World/floor").MakeInvisible()
    UsdGeom.Mesh.Define(stage, "/World/hint").CreatePurposeAttr(UsdGeom.Tokens.guide)
    stage.GetRootLayer().Save()
    asset = read_asset(tmp_path / "rich.usda")
    assert "2 meshes that are not rendered are left out" in asset.notes
    said = [note for note in asset.notes if note.endswith(" is left out")]
    assert said == ["opacity is left out", "clearcoat is left out"]

    write_png(tmp_path / "map.png", np.full((4, 4, 3), 99))
    kinds = Sdf.ValueTypeNames
    texture = UsdShade.Shader.Define(stage, "/World/look/texture")
    texture.CreateIdAttr("UsdUVTexture")
    texture.CreateInput("file", kinds.Asset).Set(Sdf.AssetPath("./map.png"))
    texture.CreateOutput("rgb", kinds.Float3)
    move = UsdShade.Shader.Define(stage, "/World/look/move")
    move.CreateIdAttr("UsdTransform2d")
    scale = move.CreateInput("scale", kinds.Float2)
    scale.Set(Gf.Vec2f(1, 1))
    move.CreateOutput("result", kinds.Float2)
    texture.CreateInput("st", kinds.Float2).ConnectToSource(move.ConnectableAPI(), "result")
    surface = UsdShade.Shader(stage.GetPrimAtPath("/World/look/surface"))
    surface.CreateInput("diffuseColor", kinds.Color3f).ConnectToSource(
        texture.ConnectableAPI(), "rgb"
    )
    stage.GetRootLayer().Save()
    read_asset(tmp_path / "rich.usda")  # scaled by one
    scale.Set(Gf.Vec2f(2, 2))
    stage.GetRootLayer().Save()
    with pytest.raises(InputError, match="UsdTransform2d"):
        read_asset(tmp_path / "rich.usda")


def test_what_cannot_be_scored_is_named(scene, tmp_path):
    stage, prim, dome = plain_stage(tmp_path / "a.usda", scene)
    stage.RemovePrim(dome.GetPath())
    stage.GetRootLayer().Save()
    with pytest.raises(InputError, match="no dome light"):
        read_asset(tmp_path / "a.usda")
    stage.RemovePrim(prim.GetPath())
    stage.GetRootLayer().Save()
    with pytest.raises(InputError, match="no mesh"):
        read_asset(tmp_path / "a.usda")
    with pytest.raises(InputError, match="no such file"):
        read_asset(tmp_path / "b.usda")

    stage, prim, _ = plain_stage(tmp_path / "c.usda", scene)
    UsdGeom.Xformable(prim).AddTranslateOp().Set(Gf.Vec3d(9, 0, 0))
    stage.GetRootLayer().Save()
    truth = load_truth(scene / "scene")
    with pytest.raises(InputError, match="not where the truth's cameras look"):
        score_asset(tmp_path / "c.usda", truth, 2)
    with pytest.raises(InputError, match="no held-out cameras"):
        load_truth(scene / "asset")


def test_a_turned_light_is_the_light_turned():
    """A quarter turn about the vertical is a roll by a quarter of the columns; bilinear weights at
    pixel centres are exact."""
    light = numpy_rng(0).random((8, 16, 3)).astype(np.float32)
    quarter = np.array([[0, 0, 1.0], [0, 1, 0], [-1, 0, 0]])  # +Z to +X: longitude grows
    np.testing.assert_allclose(turned(light, quarter), np.roll(light, -4, 1), atol=1e-5)
    assert turned(light, np.eye(3)) is light


def test_the_command_prints_a_table_and_writes_json(scene, ball, tmp_path, monkeypatch, capsys):
    path = exported(scene, ball, tmp_path, true_explanation(scene))
    out = tmp_path / "scores.json"
    command = ["heliograph", "score", str(path), "--truth", str(scene / "scene")]
    monkeypatch.setattr(sys, "argv", [*command, "--spp", "4", "--out", str(out)])
    cli.main()
    assert "albedo MSE" in capsys.readouterr().out
    scored = json.loads(out.read_text())
    assert set(scored["samples"]) == {"sample_0"} and scored["together"] == {}

    monkeypatch.setattr(sys, "argv", [*command, "--spp", "3"])
    with pytest.raises(SystemExit):
        cli.main()
    assert "give an even number" in capsys.readouterr().err


def one_picture(level):
    """Matt values (h, w, 3) of a level, with a highlight of another width, far above white."""
    out = np.full((20, 20, 3), level)
    out[:4] = 30.0
    return out


@pytest.mark.parametrize("wrong", [0.5, 0.8, 1.3])
def test_highlights_above_white_do_not_lead_the_factor(wrong):
    """Least squares of linear values would make of a wider highlight a factor of 4 / 6 or less."""
    truth = one_picture(0.3)
    ours = wrong * one_picture(0.3)
    ours[4:6] = 30.0
    mask = np.ones((20, 20), bool)
    factor = best_factor([np.stack([ours, ours])], [Picture(truth, None)], [mask])
    assert factor == pytest.approx([1 / wrong] * 3, rel=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_no_picture_is_further_from_the_truth_with_its_best_factor(seed):
    rng = numpy_rng(seed)
    truth, ours = (rng.gamma(1.0, rng.uniform(0.1, 1.0), (12, 12, 3)) for _ in range(2))
    mask = rng.random((12, 12)) < 0.7
    pair, shown = np.stack([ours, ours]), Picture(truth, None)
    factor = best_factor([pair], [shown], [mask])
    aligned, raw = picture_psnr(pair * factor, shown, mask), picture_psnr(pair, shown, mask)
    assert aligned > raw - 1e-3
