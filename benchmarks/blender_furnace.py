"""Inside Blender: what share of an even light its Principled BSDF reflects, for what
pipeline/usd/preview_surface.py takes Blender for.

PYTHON benchmarks/blender_furnace.py        PYTHON has the module bpy (benchmarks/blender.py)

A sphere under a white world, seen by an orthographic camera: the mean over its disc is the share of
an even light that is reflected. A line for each metallic, roughness and base colour.
"""

import tempfile
from pathlib import Path

import bpy
import numpy as np

METALLIC, ROUGHNESS, COLORS = (0, 1), (0.1, 0.3, 0.6, 1.0), (0, 0.5, 1)
SIDE, PATHS = 64, 128
WHITE = 1, 1, 1, 1


def furnace() -> tuple[bpy.types.Scene, bpy.types.Node]:
    """A scene with a sphere in it, and the sphere's BSDF."""
    bpy.ops.wm.read_factory_settings(use_empty=False)
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    scene = bpy.context.scene
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = WHITE

    bpy.ops.mesh.primitive_uv_sphere_add(segments=96, ring_count=64)
    sphere = bpy.context.object
    bpy.ops.object.shade_smooth()
    material = bpy.data.materials.new("tested")
    material.use_nodes = True
    sphere.data.materials.append(material)

    camera = bpy.data.cameras.new("view")
    camera.type, camera.ortho_scale = "ORTHO", 2
    thing = bpy.data.objects.new("view", camera)
    thing.location = 0, 0, 30
    scene.collection.objects.link(thing)
    scene.camera = thing

    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = PATHS, False
    scene.render.film_transparent = True
    scene.render.resolution_x = scene.render.resolution_y = SIDE
    scene.render.image_settings.file_format = "OPEN_EXR"
    return scene, material.node_tree.nodes["Principled BSDF"]


def reflected(scene: bpy.types.Scene, file: Path) -> float:
    scene.render.filepath = str(file)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(file))
    red, _, _, alpha = np.array(image.pixels[:]).reshape(-1, 4).T
    bpy.data.images.remove(image)
    return float(red.sum() / alpha.sum())


def main() -> None:
    scene, bsdf = furnace()
    with tempfile.TemporaryDirectory() as folder:
        for metallic in METALLIC:
            for roughness in ROUGHNESS:
                for color in COLORS:
                    bsdf.inputs["Base Color"].default_value = (color, color, color, 1)
                    bsdf.inputs["Roughness"].default_value = roughness
                    bsdf.inputs["Metallic"].default_value = metallic
                    found = reflected(scene, Path(folder) / "disc.exr")
                    print(f"reflects: {metallic=} {roughness=} {color=} {found:.4f}", flush=True)


if __name__ == "__main__":
    main()
