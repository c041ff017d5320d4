"""Read a finished asset back, ours or another tool's: meshes, UsdPreviewSurface materials (textures
or constants) and the dome light, from the USD alone.

Frame of the result: Y-up, the stage's own units, light as pipeline/render/envmap.py has it. Several
meshes become one, whose atlas has a tile for each material.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade

from pipeline.base.errors import InputError
from pipeline.geometry.cameras import Y_FROM_Z_UP
from pipeline.geometry.mesh_io import Mesh, unit, vertex_normals
from pipeline.render.envmap import check_lat_long, directions, uv_from_direction
from pipeline.render.light_grid import bilinear
from pipeline.render.renderer import Explanation
from pipeline.usd.preview_surface import from_preview_surface
from pipeline.usd.read_maps import Maps, read_maps, read_radiance, tiled

CONSTANT_ROWS = 32  # of a light that is one colour
OUTSIDE = 1e-3  # how far texture coordinates may lie outside of [0, 1]


@dataclass
class UsdAsset:
    """mesh: with uv; explanation: light and square maps of one size, with the numbers by which the
    renderer shows that UsdPreviewSurface (preview_surface.py); normal: the normal map's values
    (t, t, 3) in [0, 1], or None; notes: what was assumed.
    """

    mesh: Mesh
    explanation: Explanation
    normal: np.ndarray | None
    notes: list[str] = field(default_factory=list)


def open_stage(path: Path) -> Usd.Stage:
    """Raises InputError where there is no readable USD file."""
    if not path.exists():
        raise InputError("there is no such file", path, "give an exported .usda, .usd or .usdz")
    try:
        return Usd.Stage.Open(str(path))
    except Exception as error:  # pxr raises Tf.ErrorException, not an OSError
        raise InputError(f"not a readable USD file ({error})", path, "export it again") from error


def variants_of(stage: Usd.Stage) -> list[str | None]:
    """Names in the default prim's variant set `sample`; [None] where it has none."""
    root = stage.GetDefaultPrim()
    if not root or "sample" not in root.GetVariantSets().GetNames():
        return [None]
    return list(root.GetVariantSet("sample").GetVariantNames())


def read_asset(path: Path, variant: str | None = None) -> UsdAsset:
    """The asset, with this variant of `sample` selected. Raises InputError where it lacks a mesh, a
    light or texture coordinates, or has them in a form that is not read.
    """
    stage = open_stage(path)
    if variant is not None:
        stage.GetDefaultPrim().GetVariantSet("sample").SetVariantSelection(variant)
    turn = np.eye(4)
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z:
        turn = Y_FROM_Z_UP

    notes: list[str] = []
    every = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    prims = [prim for prim in every if rendered(prim)]
    if len(prims) < len(every):
        notes.append(f"{len(every) - len(prims)} meshes that are not rendered are left out")
    if not prims:
        raise InputError("it has no mesh", path, "export the object's mesh, too")
    meshes = [read_mesh(UsdGeom.Mesh(prim), turn, path) for prim in prims]
    materials = [material_of(prim, path) for prim in prims]

    names = list(dict.fromkeys(str(m.GetPath()) if m else "" for m in materials))
    maps = []
    for name in names:
        found = next(m for m in materials if (str(m.GetPath()) if m else "") == name)
        maps.append(read_maps(found, path, notes))
    tile = [names.index(str(m.GetPath()) if m else "") for m in materials]

    merged = merge_meshes(meshes, tile, len(maps), maps, path)
    whole, normal = tiled(maps, notes)
    light = read_light(stage, turn, path, notes)
    x = Explanation(light, whole.base_color, whole.roughness, whole.metallic, ior=whole.ior)
    return UsdAsset(merged, from_preview_surface(x), normal, notes)


def rendered(prim: Usd.Prim) -> bool:
    """Whether a final picture shows it: visible, and neither a proxy nor a guide."""
    shape = UsdGeom.Imageable(prim)
    final = (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)
    return shape.ComputeVisibility() != UsdGeom.Tokens.invisible and shape.ComputePurpose() in final


def world_matrix(prim: Usd.Prim, turn: np.ndarray) -> np.ndarray:
    """Local to Y-up world, (4, 4) for column vectors."""
    matrix = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
    return turn @ np.array(matrix).T  # USD multiplies row vectors


def read_mesh(prim: UsdGeom.Mesh, turn: np.ndarray, path: Path) -> Mesh:
    """Triangles with a vertex for each corner of a face, uv (n, 2) or None."""
    if prim.GetSubdivisionSchemeAttr().Get() not in (None, UsdGeom.Tokens.none):
        if not prim.GetNormalsAttr().Get():
            raise InputError(
                "the mesh is a subdivision surface",
                f"{path}: {prim.GetPath()}",
                "export it with its subdivision applied, subdivisionScheme = none",
            )
    matrix = world_matrix(prim.GetPrim(), turn)
    points = np.array(prim.GetPointsAttr().Get(), float).reshape(-1, 3)
    counts = np.array(prim.GetFaceVertexCountsAttr().Get(), int)
    index = np.array(prim.GetFaceVertexIndicesAttr().Get(), int)
    if not len(points) or not len(counts):
        raise InputError("the mesh is empty", f"{path}: {prim.GetPath()}", "export it again")

    corner = fan(counts)
    if prim.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
        corner = corner[:, ::-1]
    world = points @ matrix[:3, :3].T + matrix[:3, 3]
    faces = np.arange(corner.size).reshape(-1, 3)
    if np.linalg.det(matrix[:3, :3]) < 0:
        corner = corner[:, ::-1]

    flat = index[corner].reshape(-1)
    normals = read_normals(prim, index, corner, matrix)
    if normals is None:
        normals = vertex_normals(world, index[corner])[flat]
    return Mesh(world[flat], faces, normals, read_st(prim, index, corner))


def fan(counts: np.ndarray) -> np.ndarray:
    """Corners (m, 3) of the triangles that polygons with `counts` corners fall into."""
    start = np.concatenate([[0], np.cumsum(counts)[:-1]])
    out = []
    for size in np.unique(counts):
        first = start[counts == size]
        for k in range(1, size - 1):
            out.append(np.stack([first, first + k, first + k + 1], 1))
    return np.concatenate(out)


def at_corners(
    values: np.ndarray, kind: str, index: np.ndarray, corner: np.ndarray
) -> np.ndarray | None:
    """Values (3 m, c) at the triangles' corners, of primvars that vary by vertex or by face's
    corner; None for others.
    """
    if kind in (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying):
        return values[index[corner].reshape(-1)]
    if kind == UsdGeom.Tokens.faceVarying:
        return values[corner.reshape(-1)]
    return None


def read_normals(
    prim: UsdGeom.Mesh, index: np.ndarray, corner: np.ndarray, matrix: np.ndarray
) -> np.ndarray | None:
    """Unit normals (3 m, 3) in the world, as authored; None where there are none."""
    values = prim.GetNormalsAttr().Get()
    kind = prim.GetNormalsInterpolation()
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    if primvar and primvar.HasValue():
        values, kind = primvar.ComputeFlattened(), primvar.GetInterpolation()
    if not values:
        return None
    local = at_corners(np.array(values, float).reshape(-1, 3), kind, index, corner)
    return None if local is None else unit(local @ np.linalg.inv(matrix[:3, :3]))


def read_st(prim: UsdGeom.Mesh, index: np.ndarray, corner: np.ndarray) -> np.ndarray | None:
    """Texture coordinates (3 m, 2): the primvar `st`, else the only one of its type."""
    api = UsdGeom.PrimvarsAPI(prim)
    st = api.GetPrimvar("st")
    if not (st and st.HasValue()):
        types = (Sdf.ValueTypeNames.TexCoord2fArray, Sdf.ValueTypeNames.Float2Array)
        others = [p for p in api.GetPrimvars() if p.GetTypeName() in types and p.HasValue()]
        if len(others) != 1:
            return None
        st = others[0]
    values = np.array(st.ComputeFlattened(), float).reshape(-1, 2)
    return at_corners(values, st.GetInterpolation(), index, corner)


def material_of(prim: Usd.Prim, path: Path) -> UsdShade.Material | None:
    """The bound material; None where none is bound. Raises InputError where parts of a mesh have
    materials of their own.
    """
    subsets = UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(prim))
    own = [UsdShade.MaterialBindingAPI(s).ComputeBoundMaterial()[0] for s in subsets]
    bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
    paths = {m.GetPath() for m in own if m}
    if len(paths) == 1 and not bound:
        return next(m for m in own if m)
    if paths - {bound.GetPath()} if bound else len(paths) > 1:
        raise InputError(
            "parts of the mesh have materials of their own",
            f"{path}: {prim.GetPath()}",
            "export one mesh for each material, or bake all into one material",
        )
    return bound or None


def merge_meshes(
    meshes: list[Mesh], tile: list[int], count: int, maps: list[Maps], path: Path
) -> Mesh:
    """One mesh; texture coordinates go to the tile of each one's material."""
    side = int(np.ceil(np.sqrt(count)))
    parts = []
    start = 0
    for mesh, k in zip(meshes, tile):
        uv = mesh.uv
        if uv is None:
            if maps[k].textured:
                raise InputError(
                    "a textured mesh has no texture coordinates `st`", path, "export them, too"
                )
            uv = np.full((len(mesh.vertices), 2), 0.5)
        if uv.min() < -OUTSIDE or uv.max() > 1 + OUTSIDE:
            raise InputError(
                f"texture coordinates run from {uv.min():.3g} to {uv.max():.3g}",
                path,
                "bake the textures into one atlas within [0, 1]",
            )
        at = np.array([k % side, side - 1 - k // side])
        parts.append((mesh.vertices, mesh.faces + start, mesh.normals, (at + uv) / side))
        start += len(mesh.vertices)
    return Mesh(*(np.concatenate(columns) for columns in zip(*parts)))


def read_light(stage: Usd.Stage, turn: np.ndarray, path: Path, notes: list[str]) -> np.ndarray:
    """Radiance (h, 2h, 3) of all dome lights together, turned as their prims are, with intensity,
    exposure and colour in the pixels.
    """
    kinds = (UsdLux.DomeLight, UsdLux.DomeLight_1)
    domes = [prim for prim in stage.Traverse() if any(prim.IsA(kind) for kind in kinds)]
    if not domes:
        raise InputError("it has no dome light", path, "export the estimated light as a DomeLight")
    if len(domes) > 1:
        raise InputError(
            f"it has {len(domes)} dome lights", path, "keep the one that was estimated"
        )
    others = [p for p in stage.Traverse() if p.HasAPI(UsdLux.LightAPI) and p not in domes]
    if others:
        notes.append(f"{len(others)} other lights are left out: only the dome light counts")

    prim = domes[0]
    value = lambda name, default: _value(prim, f"inputs:{name}", default)
    color = np.array(value("color", Gf.Vec3f(1, 1, 1)), float)
    factor = color * value("intensity", 1.0) * 2.0 ** value("exposure", 0.0)
    file = value("texture:file", None)
    if file is None or not file.path:
        notes.append("the dome light has no texture: one colour from all sides")
        return np.broadcast_to(factor, (CONSTANT_ROWS, 2 * CONSTANT_ROWS, 3)).astype(np.float32)

    layout = value("texture:format", "automatic")
    if layout not in ("latlong", "automatic"):
        raise InputError(f"the dome's format is {layout}", path, "export a lat-long texture")
    light = check_lat_long(read_radiance(file, path), file.path)
    rotation = world_matrix(prim, turn)[:3, :3]
    if prim.IsA(UsdLux.DomeLight_1) and value("poleAxis", "scene") in ("scene", "Z"):
        if np.allclose(turn, Y_FROM_Z_UP):  # its pole is the stage's up axis
            rotation = rotation @ Y_FROM_Z_UP[:3, :3].T
    rotation = unit(rotation.T).T  # a dome has no size
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4):
        raise InputError("the dome light is sheared", f"{path}: {prim.GetPath()}", "only turn it")
    return (turned(light, rotation) * factor).astype(np.float32)


def _value(prim: Usd.Prim, name: str, default: Any) -> Any:
    """What is authored, or the schema's fallback, or `default`."""
    found = prim.GetAttribute(name)
    value = found.Get() if found else None
    return default if value is None else value


def turned(light: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """The light (h, 2h, 3) turned by a rotation (3, 3), bilinear; untouched where it is none."""
    if np.allclose(rotation, np.eye(3), atol=1e-6):
        return light
    h, w = light.shape[:2]
    local = directions(h, w).reshape(-1, 3) @ rotation  # inverse of the rotation
    if 2 * h != w:
        uv = uv_from_direction(local)
        row, column = (uv[:, 1] * h).astype(int) % h, (uv[:, 0] * w).astype(int) % w
        return light[row, column].reshape(light.shape)
    index, weight = bilinear(local, h)
    flat = light.reshape(-1, 3)
    return np.einsum("kf,kfc->kc", weight, flat[index]).reshape(light.shape)
