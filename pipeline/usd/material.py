"""UsdPreviewSurface and its texture readers."""

from __future__ import annotations

from dataclasses import dataclass

from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

from pipeline.usd.textures import Asset

Kinds = Sdf.ValueTypeNames
# UsdUVTexture's output is scale x value + bias: from [0, 1] back to a normal
NORMAL_SCALE = Gf.Vec4f(2, 2, 2, 1)
NORMAL_BIAS = Gf.Vec4f(-1, -1, -1, 0)


@dataclass(frozen=True)
class Slot:
    """An input of UsdPreviewSurface that a texture may be read into: `space` of its file, `kind` of
    the input, `output` of the texture.
    """

    input: str
    space: str
    kind: Sdf.ValueTypeName
    output: str


SLOTS = {
    "base_color": Slot("diffuseColor", "sRGB", Kinds.Color3f, "rgb"),
    "roughness": Slot("roughness", "raw", Kinds.Float, "r"),
    "metallic": Slot("metallic", "raw", Kinds.Float, "r"),
    "normal": Slot("normal", "raw", Kinds.Normal3f, "rgb"),
}


@dataclass(frozen=True)
class Material:
    """UsdPreviewSurface and the reader of texture coordinates for its textures."""

    surface: UsdShade.Shader
    reader: UsdShade.Shader

    def texture(self, name: str) -> UsdShade.Shader:
        """A texture reader for the map `name`, connected to its slot; defined at the current edit
        target.
        """
        slot = SLOTS[name]
        title = "".join(word.title() for word in name.split("_"))
        path = self.surface.GetPath().GetParentPath().AppendChild(title)
        texture = UsdShade.Shader.Define(self.surface.GetPrim().GetStage(), path)
        texture.CreateIdAttr("UsdUVTexture")
        st = texture.CreateInput("st", Kinds.Float2)
        st.ConnectToSource(self.reader.ConnectableAPI(), "result")

        texture.CreateInput("sourceColorSpace", Kinds.Token).Set(slot.space)
        for wrap in ("wrapS", "wrapT"):
            texture.CreateInput(wrap, Kinds.Token).Set("clamp")
        if name == "normal":
            texture.CreateInput("scale", Kinds.Float4).Set(NORMAL_SCALE)
            texture.CreateInput("bias", Kinds.Float4).Set(NORMAL_BIAS)

        texture.CreateOutput(slot.output, Kinds.Float3 if slot.output == "rgb" else Kinds.Float)
        surface_input = self.surface.CreateInput(slot.input, slot.kind)
        surface_input.ConnectToSource(texture.ConnectableAPI(), slot.output)
        return texture

    def dress(self, asset: Asset, prefix: str) -> None:
        """Give the surface one sample's maps and values at the current edit target."""
        self.surface.CreateInput("ior", Kinds.Float).Set(asset.ior)
        for name, slot in SLOTS.items():
            value = getattr(asset, name)
            if isinstance(value, str):
                file = self.texture(name).CreateInput("file", Kinds.Asset)
                file.Set(Sdf.AssetPath(f"{prefix}{value}"))
            elif value is not None:
                self.surface.CreateInput(slot.input, slot.kind).Set(value)


def define_material(stage: Usd.Stage, root: Usd.Prim, mesh: UsdGeom.Mesh) -> Material:
    """UsdPreviewSurface (metallic workflow), bound to the mesh; `Material.dress` gives it maps."""
    path = root.GetPath().AppendChild(f"{root.GetName()}_material")
    material = UsdShade.Material.Define(stage, path)

    reader = UsdShade.Shader.Define(stage, path.AppendChild("St"))
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Kinds.String).Set("st")
    reader.CreateOutput("result", Kinds.Float2)

    surface = UsdShade.Shader.Define(stage, path.AppendChild("Surface"))
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("useSpecularWorkflow", Kinds.Int).Set(0)

    out = surface.CreateOutput("surface", Kinds.Token)
    material.CreateSurfaceOutput().ConnectToSource(out.GetAttr().GetPath())
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    return Material(surface, reader)
