#!/bin/sh
# K: long blender film images exr depth
# The Blender section of docs/how-to/viewers.md: its camera path is exported, and the images of the
# splats are composited in front of and behind what it renders.
. tests/cli/lib.sh

if ! command -v blender >/dev/null || ! blender --version | grep -q '^Blender [3-9]'; then
    skip "a film in Blender" "no blender"
    done_testing
fi
run "$bin/spin-import" "$clip" --data "$clip" -o "$work/court.spin"

# Camera 15 of the clip in two frames, shifted a little in the second; a red ball close to the
# camera, a green one far behind the splats.
cat >"$work/scene.py" <<'P'
import json, math, sys
import bpy
from mathutils import Matrix, Vector
clip, out, width = sys.argv[-3:]
meta = json.load(open(clip + "/test_meta.json"))
to_world = Matrix.Rotation(math.radians(-90), 4, "X")
pose = to_world @ Matrix(meta["w2c"][0][1]).inverted() @ Matrix.Diagonal((1, -1, -1, 1))
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
lens = bpy.data.cameras.new("camera")
lens.angle = 2 * math.atan(0.5 * meta["w"] / meta["k"][0][1][0][0])
camera = bpy.data.objects.new("camera", lens)
scene.collection.objects.link(camera)
scene.camera = camera
for frame, aside in (1, 0), (2, 0.1):
    camera.matrix_world = pose @ Matrix.Translation((aside, 0, 0))
    for path in "location", "rotation_euler":
        camera.keyframe_insert(path, frame=frame)
for name, colour, place, size in ("near", (1, 0, 0, 1), (-0.25, 0.1, -1), 0.1), ("far", (0, 1, 0, 1), (0, 0, -60), 9):
    bpy.ops.mesh.primitive_uv_sphere_add(radius=size, location=pose @ Vector(place))
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    light = nodes.new("ShaderNodeEmission")
    light.inputs["Color"].default_value = colour
    material.node_tree.links.new(light.outputs[0], nodes["Material Output"].inputs["Surface"])
    bpy.context.object.data.materials.append(material)
scene.frame_start, scene.frame_end = 1, 2
scene.render.engine = "CYCLES"
scene.cycles.samples = 2
scene.cycles.use_denoising = False
scene.render.resolution_x, scene.render.resolution_y = int(width), int(width) * 9 // 16
bpy.ops.wm.save_as_mainfile(filepath=out)
P
film=docs/how-to/spin_film.py
blend() { LC_ALL=C blender -b "$@" >"$work/said" 2>&1 && ! grep -q '^Error\|Traceback' "$work/said"; }
blend -P "$work/scene.py" -- "$clip" "$work/scene.blend" 160
ok $? "Blender makes a scene"
blend "$work/scene.blend" -P "$film" -- cameras "$work/path.json"
ok $? "the path of its camera goes out"
run "$bin/spin-export" "$work/court.spin" --to images --path "$work/path.json" --format exr --background none --depth -o "$work/splats"
is "$code $(ls "$work/splats" | tr '\n' ' ')" "0 path_frame_00000.exr path_frame_00001.exr " "spin-export draws along it"
run "$bin/spin-export" "$work/court.spin" --to images --path "$work/path.json" -o "$work/plain"
blend "$work/scene.blend" -P "$film" -- over "$work/splats" "$work/film-"
ok $? "Blender renders with these pictures"
is "$(find "$work" -name "film-000[12].png" | wc -l)" 2 "each frame"
if python3 -c 'import numpy' 2>/dev/null; then
    PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=tests/tools python3 - "$work" <<'P' 2>"$work/err"
import sys
import numpy as np
from pictures import png
work = sys.argv[1]
for f in 0, 1:
    film, plain = png(f"{work}/film-{f + 1:04d}.png")[..., :3], png(f"{work}/plain/path_frame_{f:05d}.png")
    red = (film[..., 0] > .9) & (film[..., 1] < .1) & (film[..., 2] < .1)
    green = (film[..., 1] > .9) & (film[..., 0] < .3)
    y, x = np.nonzero(red)
    assert 300 < red.sum() < 700 and abs(x.mean() - (48.9, 36.7)[f]) < 1 and abs(y.mean() - 32.3) < 1
    assert green.sum() == 0 and np.median(np.abs(film - plain)[~red]) < .01
P
    ok $? "the ball before the splats is seen where it is, the one behind is not, the rest is as spin-export draws it"
fi
done_testing
