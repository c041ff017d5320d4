import shutil
from dataclasses import replace

import numpy as np
import pytest
from pxr import Usd, UsdShade

from pipeline.base.errors import InputError
from pipeline.base.images import read_exr
from pipeline.render.renderer import Explanation, ior_of
from pipeline.render.samples import Samples, mean_of
from pipeline.render.stacking import LeftOut
from pipeline.usd.check import check
from pipeline.usd.preview_surface import for_preview_surface, from_preview_surface
from pipeline.usd.read import read_asset
from pipeline.usd.write import export
from tests.render.test_renderer import explanation
from tests.seeds import numpy_rng, seeded


def varied(seed: int) -> Explanation:
    """An explanation of which every map varies."""
    rng = numpy_rng(seed)
    gloss = rng.random((2, 16, 16)).astype(np.float32)
    return replace(explanation(16, 8, seed=seed), roughness=gloss[0], metallic=gloss[1])


WEIGHTS = 0.5, 0.3, 0.2  # of samples 0, 1, 2 in their mean


def judged(weight):
    """Errors that make a sample count by `weight` beside others: of independent errors v weights
    are as 1 / (v + e), with e their mean.
    """
    own = np.zeros((2, 3, 3))
    e = 1.0
    scale = 2 * e / np.mean([1 / w for w in WEIGHTS])  # so that the mean of v is e
    own[:, WEIGHTS.index(weight)] = (3 * (scale / weight - e)) ** 0.5  # at one pixel of three
    return LeftOut(np.arange(3), own)


@pytest.fixture
def exported(tmp_path, ball):
    samples = []
    for k in range(3):
        folder = tmp_path / "refine" / str(k)
        varied(k).save(folder)
        judged(WEIGHTS[k]).save(folder)
        samples.append(folder)
    out = tmp_path / "exports" / "mein garten é.usda"
    out.parent.mkdir()
    (out.parent / "users.txt").write_text("mine")
    return export(ball, samples, out, {"preset": "draft"}), out, samples


def child(stage, suffix=""):
    """The mesh, or what else has the asset's name with a suffix."""
    root = stage.GetDefaultPrim()
    return root.GetChild(root.GetName() + suffix)


def files_of(stage):
    light = child(stage, "_light").GetAttribute("inputs:texture:file").Get().path
    maps = [
        UsdShade.Shader(p).GetInput("file").Get().path
        for p in stage.Traverse()
        if UsdShade.Shader(p) and UsdShade.Shader(p).GetIdAttr().Get() == "UsdUVTexture"
    ]
    return [light] + maps


def test_validators_are_silent_and_users_files_untouched(exported):
    metrics, out, _ = exported
    assert (
        metrics["problems"] == []
        and check(out) == []
        and (out.parent / "users.txt").read_text() == "mine"
    )


def test_the_light_is_in_the_photos_unit(tmp_path, ball):
    """Under work/ 1 stands for the scene's white."""
    varied(0).save(tmp_path / "refine")
    judged(WEIGHTS[0]).save(tmp_path / "refine")
    out = tmp_path / "exports" / "s.usda"
    out.parent.mkdir()
    export(ball, [tmp_path / "refine"], out, {}, white=16.0)
    asset = read_asset(out, "sample_0").explanation
    assert np.array_equal(asset.light, 16 * varied(0).light)


def test_variants_switch_light_and_every_map(exported):
    _, out, _ = exported
    stage = Usd.Stage.Open(str(out))
    variants = stage.GetDefaultPrim().GetVariantSet("sample")
    assert variants.GetVariantNames() == ["mean", "sample_0", "sample_1", "sample_2"]
    for k in range(3):
        variants.SetVariantSelection(f"sample_{k}")
        assert len(files_of(stage)) == 4 and all(f"/sample_{k}/" in f for f in files_of(stage))


def test_a_sample_without_a_highlight_says_so_and_so_does_what_reads_it(tmp_path, ball):
    """In its variant and in its own file; the other keeps 1.5, and the mean has the mean
    reflectance.
    """
    folders = [tmp_path / "refine" / str(k) for k in range(2)]
    for k, folder in enumerate(folders):
        replace(varied(k), ior=(1.5, 1.0)[k]).save(folder)
        judged(WEIGHTS[k]).save(folder)
    out = tmp_path / "exports" / "s.usda"
    out.parent.mkdir()
    export(ball, folders, out, {})
    assert check(out) == []
    share = Samples(folders).weights[0]
    for variant, ior in (
        ("sample_0", 1.5),
        ("sample_1", 1.0),
        ("mean", ior_of(0.04 * share)),
    ):
        assert read_asset(out, variant).explanation.ior == pytest.approx(ior, abs=1e-4)
    assert read_asset(out.with_suffix("") / "sample_1.usda").explanation.ior == 1.0


def test_exports_open_elsewhere(exported, tmp_path):
    _, out, _ = exported
    shutil.copytree(out.parent, tmp_path / "else where")
    shutil.rmtree(out.parent)
    moved = tmp_path / "else where" / out.name
    assert check(moved) == [] and all(
        f.startswith("./") for f in files_of(Usd.Stage.Open(str(moved)))
    )
    assert check(moved.with_suffix("") / "sample_1.usda") == []


def test_light_stays_float(exported):
    """The third defect of the published code: its light passes through 8-bit PNG."""
    _, out, samples = exported
    assert (
        read_exr(out.with_suffix("") / "sample_2" / "light.exr")
        == read_exr(samples[2] / "light.exr")
    ).all()


def test_check_finds_what_is_wrong(exported):
    _, out, _ = exported
    (out.with_suffix("") / "sample_1" / "light.exr").unlink()
    assert any("sample_1" in p for p in check(out))
    stage = Usd.Stage.Open(str(out.with_suffix("") / "sample_0.usda"))
    child(stage, "_light").GetAttribute("inputs:texture:file").Set("/somewhere/else.exr")
    child(stage).GetAttribute("faceVertexCounts").Set([3])
    stage.GetRootLayer().Save()
    problems = " ".join(check(out.with_suffix("") / "sample_0.usda"))
    assert "absolute path" in problems and len(problems) > 60
    (out.parent / "broken.usda").write_text("nonsense")
    with pytest.raises(InputError, match="not a readable USD"):
        check(out.parent / "broken.usda")


def test_base_colour_is_stored_as_srgb(exported):
    from PIL import Image

    from pipeline.base.images import srgb_to_linear

    _, out, samples = exported
    stored = np.asarray(Image.open(out.with_suffix("") / "sample_0" / "base_color.png")) / 255
    shown, _ = for_preview_surface(Explanation.load(samples[0]))
    assert np.allclose(srgb_to_linear(stored), shown.base_color, atol=0.01)
    read = read_asset(out, "sample_0").explanation.base_color
    assert np.allclose(read, read_exr(samples[0] / "base_color.exr"), atol=0.01)


def test_a_failing_export_leaves_the_old_one(exported, ball, monkeypatch):
    _, out, samples = exported
    before = {f: f.read_bytes() for f in out.parent.rglob("*") if f.is_file()}
    monkeypatch.setattr("pipeline.usd.write.check", lambda path: [f"{path.name}: wrong"])
    with pytest.raises(RuntimeError, match="sample_1.usda: wrong"):
        export(ball, samples[::-1], out, {"preset": "draft"})
    assert {f: f.read_bytes() for f in out.parent.rglob("*") if f.is_file()} == before


def test_without_a_package_the_export_stands_and_says_why(exported, ball, monkeypatch):
    _, out, samples = exported
    assert check(out.with_suffix(".usdz")) == []
    monkeypatch.setattr(
        "pipeline.usd.write.UsdUtils.CreateNewUsdzPackage", lambda asset, target: False
    )
    metrics = export(ball, samples[:2], out, {"preset": "draft"})
    assert not metrics["usdz"] and ".usdz" in metrics["warnings"][0] and check(out) == []
    assert not out.with_suffix(".usdz").exists()  # an older package would show an older result


def test_package_holds_the_mean(exported):
    from pxr import Ar

    _, out, samples = exported
    stage = Usd.Stage.Open(str(out.with_suffix(".usdz")))
    for attribute in (
        a
        for p in stage.Traverse()
        for a in p.GetAttributes()
        if a.GetTypeName() == "asset" and a.Get().path
    ):
        assert (
            Ar.GetResolver().OpenAsset(Ar.ResolvedPath(attribute.Get().resolvedPath)).GetSize() > 0
        )
    assert stage.GetDefaultPrim().GetCustomDataByKey("heliograph")["sample"] == "mean"
    flat = Usd.Stage.Open(str(out.with_suffix("") / "sample_1.usda"))
    assert flat.GetDefaultPrim().GetCustomDataByKey("heliograph")["sample"] == 1


def test_an_asset_opens_with_the_mean_of_its_samples(exported):
    """Means of radiance and of linear base colour, in the main file and in one of its own, in which
    samples count by their weights; so say the metrics and each sample's file.
    """
    metrics, out, folders = exported
    samples = [Explanation.load(folder) for folder in folders]
    expected = mean_of(samples, np.array(WEIGHTS))
    np.testing.assert_allclose(metrics["weights"], WEIGHTS, atol=1e-3)
    for k, weight in enumerate(WEIGHTS):
        flat = Usd.Stage.Open(str(out.with_suffix("") / f"sample_{k}.usda"))
        said = flat.GetDefaultPrim().GetCustomDataByKey("heliograph")["weight_in_mean"]
        assert abs(said - weight) < 2e-3
    for asset in (read_asset(out), read_asset(out.with_suffix("") / "mean.usda")):
        found = asset.explanation
        np.testing.assert_allclose(found.light, expected.light, rtol=1e-5)
        shown, _ = for_preview_surface(expected, decide=True)
        np.testing.assert_array_equal(found.metallic, expected.metallic >= 0.5)
        color = from_preview_surface(shown).base_color
        np.testing.assert_allclose(found.base_color, color, atol=0.01)
        np.testing.assert_allclose(found.roughness, expected.roughness, atol=0.003)


def test_one_sample_has_no_mean(exported, ball):
    _, out, folders = exported
    export(ball, folders[:1], out, {"preset": "draft"})
    stage = Usd.Stage.Open(str(out))
    assert stage.GetDefaultPrim().GetVariantSet("sample").GetVariantNames() == ["sample_0"]
    assert not (out.with_suffix("") / "mean.usda").exists() and out.with_suffix(".usdz").exists()


def test_mesh_and_light_conventions(exported, ball):
    from pxr import UsdGeom, UsdLux

    from pipeline.geometry.mesh_io import load_mesh

    _, out, _ = exported
    stage, mesh = Usd.Stage.Open(str(out)), load_mesh(ball / "mesh_uv.ply")
    prim, light = UsdGeom.Mesh(child(stage)), UsdLux.DomeLight(child(stage, "_light"))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert (
        prim.GetSubdivisionSchemeAttr().Get() == "none"
        and prim.GetNormalsInterpolation() == "vertex"
    )
    assert np.allclose(prim.GetExtentAttr().Get(), [mesh.vertices.min(0), mesh.vertices.max(0)])
    assert np.allclose(UsdGeom.PrimvarsAPI(prim).GetPrimvar("st").Get(), mesh.uv)
    assert light.GetIntensityAttr().Get() == 1 and light.GetExposureAttr().Get() == 0
    assert not UsdGeom.Xformable(
        light
    ).GetOrderedXformOps()  # a rotation would turn the light against the object


def test_unwritable_target_is_named(ball, tmp_path, exported):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be made"):
        export(ball, exported[2], tmp_path / "file" / "a.usda", {})


def test_nobodys_folder_is_replaced(ball, tmp_path, exported):
    """`a.usda` keeps its textures in `a/`: if somebody has one, it is not deleted."""
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "to_my_mother.txt").write_text("Dear mother,")
    with pytest.raises(InputError, match="no earlier export"):
        export(ball, exported[2], tmp_path / "a.usda", {})
    assert [p.name for p in (tmp_path / "a").iterdir()] == ["to_my_mother.txt"]
    assert not (tmp_path / "a.usda").exists()


def test_fit_and_export_agree_on_the_texture_frame(ball):
    """Image row 0 is v = 1 and column 0 is u = 0 for the renderer too; else the exported PNGs would
    be upside down.
    """
    from pipeline.geometry.mesh_io import load_mesh
    from pipeline.render.renderer import Explanation, Renderer

    mesh, grey = load_mesh(ball / "mesh_uv.ply"), np.full((16, 16), 1, np.float32)
    corners = mesh.vertices[mesh.faces]
    centre, uv = corners.mean(1), mesh.uv[mesh.faces].mean(1)
    out = centre / np.linalg.norm(centre, axis=1, keepdims=True)
    renderer = Renderer(ball / "mesh_uv.ply", 16, 8, 2)
    for axis, ramp in ((1, np.linspace(1, 0, 16)[:, None]), (0, np.linspace(0, 1, 16)[None])):
        base = np.broadcast_to(ramp[..., None], (16, 16, 3)).astype(np.float32).copy()
        renderer.set(Explanation(np.ones((8, 16, 3), np.float32), base, grey, 0 * grey))
        seen = np.mean(
            [renderer.radiance(centre + out, -out, seeded(seed)).mean(-1) for seed in range(8)], 0
        )
        assert np.corrcoef(seen, uv[:, axis])[0, 1] > 0.9


def shader_of(stage, name):
    return UsdShade.Shader(child(stage, "_material").GetChild(name))


def test_normal_map_is_exported_as_the_specification_asks(bumpy, tmp_path, exported):
    """UsdPreviewSurface: raw values, scale 2 and bias -1, on the input `normal`; one file for all
    variants; and none where the surface has no map.
    """
    out = tmp_path / "with map" / "a.usda"
    export(bumpy, exported[2][:2], out, {"preset": "draft"})
    files = (out, out.with_suffix("") / "sample_1.usda", out.with_suffix(".usdz"))
    for file in files:
        assert check(file) == []
        stage = Usd.Stage.Open(str(file))
        source = shader_of(stage, "Surface").GetInput("normal").GetConnectedSource()
        texture = shader_of(stage, "Normal")
        assert source[0].GetPrim() == texture.GetPrim() and source[1] == "rgb"
        assert texture.GetInput("sourceColorSpace").Get() == "raw"
        assert texture.GetInput("scale").Get() == (2, 2, 2, 1)
        assert texture.GetInput("bias").Get() == (-1, -1, -1, 0)
        assert texture.GetInput("file").Get().resolvedPath

    exported_map = out.with_suffix("") / "normal.png"
    assert exported_map.read_bytes() == (bumpy / "normal.png").read_bytes()
    plain = Usd.Stage.Open(str(exported[1]))
    assert not shader_of(plain, "Normal") and not shader_of(plain, "Surface").GetInput("normal")


def test_a_map_of_one_value_is_a_number_in_the_material(ball, tmp_path):
    """Roughness varies in sample 0 only, metallic nowhere: each variant carries what it has, no
    file is written for the rest, and the package holds none.
    """
    samples = []
    for k, roughness in enumerate((None, 0.3, 0.7001)):
        x = varied(k)
        if roughness is not None:
            # within what 8 bits tell of one value, on both sides of where they round
            image = np.full((16, 16), roughness, np.float32)
            image[::2] += 0.9 / 255
            x = replace(x, roughness=image)
        replace(x, metallic=np.zeros((4, 4), np.float32)).save(tmp_path / str(k))
        judged(WEIGHTS[0]).save(tmp_path / str(k))
        samples.append(tmp_path / str(k))
    out = tmp_path / "exports" / "a.usda"
    export(ball, samples, out, {"preset": "draft"})

    written = {str(p.relative_to(out.parent / "a")) for p in out.parent.glob("a/*/*.png")}
    colors = {f"{name}/base_color.png" for name in ("mean", "sample_0", "sample_1", "sample_2")}
    assert written == colors | {"mean/roughness.png", "sample_0/roughness.png"}
    stage = Usd.Stage.Open(str(out))
    variants = stage.GetDefaultPrim().GetVariantSet("sample")
    for k, expected in enumerate((None, 0.3, 0.7001)):
        variants.SetVariantSelection(f"sample_{k}")
        flat = Usd.Stage.Open(str(out.with_suffix("") / f"sample_{k}.usda"))
        for place in (stage, flat):
            surface = shader_of(place, "Surface")
            assert surface.GetInput("metallic").Get() == 0 and not shader_of(place, "Metallic")
            assert bool(shader_of(place, "Roughness")) == (expected is None)
            assert surface.GetInput("roughness").HasConnectedSource() == (expected is None)
            if expected is not None:
                assert abs(surface.GetInput("roughness").Get() - expected) <= 0.5 / 255 + 1e-6
        read = read_asset(out, f"sample_{k}").explanation
        assert (read.metallic == 0).all() and (np.ptp(read.roughness) > 0.5) == (expected is None)
    assert check(out) == [] and check(out.with_suffix(".usdz")) == []
