"""Composites splats and a Blender scene. It writes the path of the scene's camera for spin-export,
and renders the scene together with the images that spin-export wrote for this path, by depth. Run
it with `blender -b FILE.blend -P spin_film.py -- ...`:

    cameras PATH.json      write the path of the scene's camera, for spin-export --path
    over FOLDER OUT        render the scene with the EXR files of FOLDER, one per frame, to
                           OUT0001.png and so on

Blender's world has z up. The environment variable SPIN_UP names the axis that points up in the
scene of the splats, as spin-export --up does."""
import json
import math
import os
import re
import sys

import bpy
from mathutils import Matrix

UP = os.environ.get("SPIN_UP", "-y")
# From Blender's world to the splats' scene.
TO_SCENE = {"-y": Matrix.Rotation(math.radians(90), 4, "X"), "y": Matrix.Rotation(math.radians(-90), 4, "X"),
            "z": Matrix.Identity(4)}[UP]


def frames(scene):
    return range(scene.frame_start, scene.frame_end + 1)


def cameras(path):
    scene, poses = bpy.context.scene, []
    scale = scene.render.resolution_percentage / 100
    width, height = int(scene.render.resolution_x * scale), int(scene.render.resolution_y * scale)
    for frame in frames(scene):
        scene.frame_set(frame)
        p = scene.camera.calc_matrix_camera(bpy.context.evaluated_depsgraph_get(), x=width, y=height)
        pose = TO_SCENE @ scene.camera.matrix_world
        poses.append({"camera_to_world": [v for row in pose for v in row],
                      "fov": math.degrees(2 * math.atan(1 / p[1][1])), "aspect": width / height})
    with open(path, "w") as out:
        json.dump({"camera_type": "perspective", "render_width": width, "render_height": height,
                   "fps": scene.render.fps, "camera_path": poses}, out)


def over(folder, out):
    scene = bpy.context.scene
    files = sorted(f for f in os.listdir(folder) if f.endswith(".exr"))
    if not files:
        sys.exit(f"{folder} has no EXR")
    scene.use_nodes = True
    scene.render.film_transparent = True
    scene.view_settings.view_transform = "Standard"  # the colours that splats were trained on
    scene.view_layers[0].use_pass_z = True
    nodes, links = scene.node_tree.nodes, scene.node_tree.links
    nodes.clear()
    splats = nodes.new("CompositorNodeImage")
    splats.image = bpy.data.images.load(os.path.join(os.path.abspath(folder), files[0]))
    splats.image.source = "SEQUENCE"
    splats.frame_duration = len(files)
    splats.frame_start = scene.frame_start
    splats.frame_offset = int(re.search(r"(\d+)\.exr$", files[0])[1]) - 1
    splats.use_auto_refresh = True
    render, both, result = (nodes.new(n) for n in ("CompositorNodeRLayers", "CompositorNodeZcombine",
                                                   "CompositorNodeComposite"))
    both.use_alpha = True
    links.new(splats.outputs["Image"], both.inputs[0])
    links.new(splats.outputs["Depth"], both.inputs[1])
    links.new(render.outputs["Image"], both.inputs[2])
    links.new(render.outputs["Depth"], both.inputs[3])
    links.new(both.outputs["Image"], result.inputs["Image"])
    scene.render.image_settings.file_format = "PNG"
    scene.render.filepath = os.path.abspath(out)
    bpy.ops.render.render(animation=True)


words = sys.argv[sys.argv.index("--") + 1:]
{"cameras": cameras, "over": over}[words[0]](*words[1:])
