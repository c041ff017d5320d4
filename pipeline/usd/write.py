"""Write exports/<scene>.usda and exports/<scene>/: Y-up, metres, UsdPreviewSurface, DomeLight,
relative paths only.

The dome's EXR carries the absolute scale (intensity 1, exposure 0, white) because Blender's
importer ignores `inputs:exposure`; a Y-up stage needs no rotation on the light (frames:
docs/scene_folder.md).
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from pxr import Gf, Kind, Sdf, Tf, Usd, UsdGeom, UsdLux, UsdUtils, Vt

from pipeline import __version__
from pipeline.base import manifest
from pipeline.base.errors import InputError
from pipeline.base.files import room_beside, writable_parent
from pipeline.base.locks import alone
from pipeline.geometry.mesh_io import Mesh
from pipeline.geometry.surface import Surface
from pipeline.render.renderer import Explanation
from pipeline.render.samples import MEAN, Samples, mean_of
from pipeline.usd.check import check
from pipeline.usd.material import define_material
from pipeline.usd.preview_surface import for_preview_surface
from pipeline.usd.textures import Asset, write_textures

GAUGE = (
    "light scale and base colour trade off: (s L, a / s) explains diffuse photos equally well. "
    "The fit starts with a median base colour of 0.35; specular light and interreflection move it "
    "from there."
)


def new_stage(path: Path, name: str, facts: dict) -> tuple[Usd.Stage, Usd.Prim]:
    """An empty stage, Y-up in metres, and its root /<name>, which carries `facts`."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, f"/{name}").GetPrim()
    stage.SetDefaultPrim(root)
    Usd.ModelAPI(root).SetKind(Kind.Tokens.component)

    facts = facts | {"version": __version__, "gauge": GAUGE}
    known = {key: value for key, value in facts.items() if value is not None}
    root.SetCustomDataByKey("heliograph", known)
    return stage, root


def define_mesh(stage: Usd.Stage, root: Usd.Prim, mesh: Mesh) -> UsdGeom.Mesh:
    """The mesh, of the root's name, with vertex normals and vertex st (v up)."""
    prim = UsdGeom.Mesh.Define(stage, root.GetPath().AppendChild(root.GetName()))
    points = mesh.vertices.astype(np.float32)
    prim.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    prim.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(mesh.faces), 3, np.int32)))
    prim.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.faces.astype(np.int32).ravel()))
    prim.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(mesh.normals.astype(np.float32)))
    prim.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    prim.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(0), points.max(0)])))
    prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    prim.CreateDoubleSidedAttr(True)

    st = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(
        "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex
    )
    assert mesh.uv is not None  # the atlas stage gives every mesh its own
    st.Set(Vt.Vec2fArray.FromNumpy(mesh.uv.astype(np.float32)))
    return prim


def define_light(stage: Usd.Stage, root: Usd.Prim) -> UsdLux.DomeLight:
    """A white lat-long dome of intensity 1 whose texture is set later."""
    light = UsdLux.DomeLight.Define(stage, root.GetPath().AppendChild(f"{root.GetName()}_light"))
    light.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
    light.CreateIntensityAttr(1.0)
    light.CreateExposureAttr(0.0)
    light.CreateColorAttr(Gf.Vec3f(1, 1, 1))
    light.CreateTextureFileAttr()
    return light


def write_variants(
    path: Path, name: str, mesh: Mesh, assets: dict[str, Asset], facts: dict
) -> None:
    """The main file: one variant per asset, the first one selected. All that differs between them,
    which texture readers there are too, is told inside of the variants: what is told outside would
    be stronger.
    """
    stage, root = new_stage(path, name, facts)
    material = define_material(stage, root, define_mesh(stage, root, mesh))
    light = define_light(stage, root)

    variants = root.GetVariantSets().AddVariantSet("sample")
    for variant, asset in assets.items():
        variants.AddVariant(variant)
        variants.SetVariantSelection(variant)
        with variants.GetVariantEditContext():
            material.dress(asset, "./")
            light.GetTextureFileAttr().Set(Sdf.AssetPath(f"./{asset.light}"))
    variants.SetVariantSelection(next(iter(assets)))
    stage.GetRootLayer().Save()


def write_flat(path: Path, name: str, mesh: Mesh, asset: Asset, facts: dict) -> None:
    """One variant without any composition, beside its folder of textures; `asset`: relative to the
    file's folder.
    """
    stage, root = new_stage(path, name, facts)
    material = define_material(stage, root, define_mesh(stage, root, mesh))
    light = define_light(stage, root)

    material.dress(asset, "./")
    light.GetTextureFileAttr().Set(Sdf.AssetPath(f"./{asset.light}"))
    stage.GetRootLayer().Save()


@contextlib.contextmanager
def staging(out: Path) -> Iterator[Path]:
    """A folder beside `out` in which an export is built under its final names, so that it can be
    checked before it is seen.
    """
    _earlier_export(out.with_suffix(""))
    writable_parent(out)
    with alone(out), room_beside(out.with_suffix("")) as room:
        yield room


def _earlier_export(folder: Path) -> None:
    """InputError for a folder that an export would replace though no export has made it."""
    if folder.is_dir() and any(folder.iterdir()) and not (folder / "sample_0.usda").exists():
        raise InputError(
            "the folder is not empty and holds no sample_0.usda: it is no earlier export",
            folder,
            "export under another name, or empty this folder yourself",
        )


def in_unit(x: Explanation, white: float) -> Explanation:
    """The explanation with its light in the photos' unit, in which `white` is what its 1 stands
    for.
    """
    return replace(x, light=x.light * np.float32(white))


def variants_from(samples: Samples) -> Iterator[tuple[str, Explanation]]:
    """Name and explanation of every variant, one after another: the mean, where there are samples
    enough, which is what a user sees first, and the samples.
    """
    mean = mean_of(samples, samples.weights)
    if mean is not None:
        yield MEAN, mean
    for k, x in enumerate(samples):
        yield f"sample_{k}", x


def build(
    folder: Path, scene: str, surface: Surface, samples: Samples, facts: dict, white: float
) -> tuple[str, dict[str, float]]:
    """Write <scene>.usda and <scene>/ into `folder`; returns the variant that is selected, and for
    each the share of its base colours that no UsdPreviewSurface is bright enough for.
    RuntimeError when a file does not pass the validators.
    """
    name = Tf.MakeValidIdentifier(scene)
    inside = folder / scene
    inside.mkdir()
    mesh = surface.geometry
    normal = None
    if surface.normal_map is not None:
        shutil.copy(surface.normal_map, inside / surface.normal_map.name)
        normal = f"{scene}/{surface.normal_map.name}"

    assets, clipped = {}, {}
    for variant, x in variants_from(samples):
        shown, clipped[variant] = for_preview_surface(in_unit(x, white), decide=variant == MEAN)
        assets[variant] = write_textures(shown, inside / variant, f"{scene}/{variant}", normal)
    for variant, asset in assets.items():
        own = facts | {"sample": variant}
        if variant != MEAN:
            k = int(variant.removeprefix("sample_"))
            own |= {"sample": k, "weight_in_mean": round(float(samples.weights[k]), 3)}
        write_flat(inside / f"{variant}.usda", name, mesh, asset.below(scene), own)
    write_variants(folder / f"{scene}.usda", name, mesh, assets, facts)

    files = [folder / f"{scene}.usda"] + [inside / f"{variant}.usda" for variant in assets]
    problems = [p for f in files for p in check(f)]
    if problems:
        raise RuntimeError("the export does not pass the USD validators:\n" + "\n".join(problems))
    return next(iter(assets)), clipped


def package(folder: Path, scene: str, variant: str) -> str | None:
    """Pack a variant as <scene>.usdz in `folder`. Returns why there is none, or None when it is
    there.
    """
    source = Sdf.AssetPath(str(folder / scene / f"{variant}.usda"))
    target = folder / f"{scene}.usdz"
    packed = UsdUtils.CreateNewUsdzPackage(source, str(target))

    why = f"OpenUSD could not pack {variant}.usda"
    if packed and target.exists():
        problems = check(target)
        if not problems:
            return None
        why = "the package does not pass the USD validators: " + "; ".join(problems)
    target.unlink(missing_ok=True)
    return f"{why}; the .usda files are complete without it"


def publish(folder: Path, out: Path) -> None:
    """Move a built export to its place; the .usda comes last, so that it never names files that are
    not there yet.
    """
    manifest.sync_all(folder)
    _earlier_export(out.with_suffix(""))
    if out.with_suffix("").exists():
        os.replace(out.with_suffix(""), folder / ".old")  # one step: a kill leaves no half of it
    os.replace(folder / out.stem, out.with_suffix(""))
    packed = folder / f"{out.stem}.usdz"
    if packed.exists():
        os.replace(packed, out.with_suffix(".usdz"))
    else:  # an older package would show an older result
        out.with_suffix(".usdz").unlink(missing_ok=True)
    os.replace(folder / out.name, out)
    manifest.sync(out.parent)


def export(atlas: Path, samples: list[Path], out: Path, facts: dict, white: float = 1.0) -> dict:
    """Write `out` (exports/<scene>.usda), its folder and a .usdz of the variant that is selected;
    an export that fails leaves the old one alone.

    samples: folders with light.exr, base_color.exr, roughness.exr, metallic.exr; white: the
    radiance in the photos' unit that 1 stands for in them (`pipeline.photos.radiance`). Raises
    InputError when exports/ cannot be written, RuntimeError when an export does not pass the USD
    validators.
    """
    surface = Surface.of(atlas / "mesh_uv.ply")
    with staging(out) as folder:
        facts = facts | {"samples": len(samples)}
        shown, clipped = build(folder, out.stem, surface, Samples(samples), facts, white)
        unpacked = package(folder, out.stem, shown)
        publish(folder, out)

    size = sum(f.stat().st_size for f in out.with_suffix("").rglob("*") if f.is_file()) / 2**20
    metrics = {
        "samples": len(samples),
        "weights": Samples(samples).weights.tolist(),
        "problems": [],
        "clipped_base_color": clipped,
        "usdz": unpacked is None,
        "mib": round(size, 2),
    }
    return metrics | ({"warnings": [f"no .usdz: {unpacked}"]} if unpacked else {})
