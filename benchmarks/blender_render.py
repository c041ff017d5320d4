"""Inside Blender: an asset imported as a user would, and its pictures from given cameras.

PYTHON benchmarks/blender_render.py ASSET JOB.json OUT        PYTHON has the module bpy

Called by benchmarks/blender.py. JOB.json: `samples`, Cycles' paths a pixel; `views`, each as
`blender.camera_of` has it. Writes OUT/<view>_<seed>.exr, linear, the object on nothing, for two
seeds. Nothing is set about the asset; of Cycles' settings only those that a comparison needs: no
denoising, every pixel its own square, as many paths for each.
"""

import json
import sys

import bpy
from mathutils import Matrix

SEEDS = 0, 1  # two pictures, whose noise is independent


def opened(asset: str) -> bpy.types.Scene:
    """Blender's start-up scene without its things, with the asset."""
    bpy.ops.wm.read_factory_settings(use_empty=False)
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    bpy.ops.wm.usd_import(filepath=asset)
    return bpy.context.scene


def set_cycles(scene: bpy.types.Scene, samples: int) -> None:
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = samples
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.cycles.pixel_filter_type = "BOX"
    scene.render.film_transparent = True
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"


def camera_in(scene: bpy.types.Scene) -> bpy.types.Object:
    thing = bpy.data.objects.new("view", bpy.data.cameras.new("view"))
    scene.collection.objects.link(thing)
    scene.camera = thing
    return thing


def look_through(scene: bpy.types.Scene, thing: bpy.types.Object, view: dict) -> None:
    camera, render = thing.data, scene.render
    camera.sensor_fit = "HORIZONTAL"
    camera.sensor_width = view["sensor"]
    camera.lens = view["lens"]
    camera.shift_x, camera.shift_y = view["shift"]
    camera.clip_start, camera.clip_end = 1e-3, 1e4
    thing.matrix_world = Matrix(view["matrix"])
    render.resolution_x, render.resolution_y = view["size"]
    render.resolution_percentage = 100
    render.pixel_aspect_x, render.pixel_aspect_y = view["aspect"]


def main() -> None:
    asset, job, out = sys.argv[1:]
    with open(job) as file:
        asked = json.load(file)
    scene = opened(asset)
    set_cycles(scene, asked["samples"])
    thing = camera_in(scene)
    for number, view in enumerate(asked["views"]):
        look_through(scene, thing, view)
        for seed in SEEDS:
            scene.cycles.seed = seed
            scene.render.filepath = f"{out}/{number}_{seed}.exr"
            bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main()
