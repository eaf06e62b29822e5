#!/bin/sh
# K: warnings
# Every situation that causes a warning: the exact lines, and their number. The tests of these
# situations cover others: t-retrain (options without effect), t1020 (plug-ins), t2005 (the log,
# SIMD paths), t2006 (nothing in view), t2016 (nonfinite values), t3003 (full disks), t5002 (idle
# processes), t-gltf (clips that are too large).
. tests/cli/lib.sh

if ! python3 -c 'import numpy' 2>/dev/null; then
    skip "warnings" "no python3 with NumPy"
    done_testing
fi

# warns NAME [LINE]...: the last run succeeded with exactly these warnings.
warns() {
    name=$1
    shift
    for line; do echo "warning: $line"; done >"$work/want"
    is "$code" 0 "$name"
    is "$(grep '^warning: ' "$work/err")" "$(cat "$work/want")" "$name: $# warnings"
}
# figure EXPRESSION: a value of j, the JSON that the last run printed.
figure() { python3 -c 'import json, sys
j = json.load(open(sys.argv[1]))
print(eval(sys.argv[2]))' "$work/out" "$1"; }

cp -R "$clip" "$work/data"
chmod -R u+w "$work/data"
python3 - "$work" fixtures <<'E'
import json, os, re, shutil, struct, sys, zipfile
import numpy as np

work, fixtures = sys.argv[1:]
rng = np.random.default_rng(3)


def path(*names):
    to = os.path.join(work, *names)
    os.makedirs(os.path.dirname(to), exist_ok=True)
    return to


def ply(to, n=40, rest=0, more=(), end=b"", **columns):
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2"] + ["f_rest_%d" % i for i in range(rest)] + [
        "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"] + list(more)
    rows = rng.normal(0, 1, (n, len(names))).astype("<f4")
    rows[:, names.index("scale_0"):names.index("rot_0")] -= 4
    for name, values in columns.items():
        for i in [i for i, n in enumerate(names) if n == name or n.startswith(name + "_")]:
            rows[:len(np.atleast_1d(values)) if np.ndim(values) else n, i] = values
    with open(path(to), "wb") as f:
        f.write(("ply\nformat binary_little_endian 1.0\nelement vertex %d\n" % n + "".join(
            "property float %s\n" % n for n in names) + "end_header\n").encode() + rows.tobytes() + end)


def read_ply(file):
    data = open(file, "rb").read()
    at = data.index(b"end_header\n") + 11
    names = re.findall(rb"property float (\S+)", data[:at])
    return data[:at], np.frombuffer(data[at:], "<f4").reshape(-1, len(names)).copy()


for k in range(4):
    ply("sequence/%d.ply" % k)
    ply("exp/%d.ply" % (3 + k), scale=0.05, opacity=0.5 if k else 3.0)
for k in range(3):
    ply("filter/%d.ply" % k, more=["filter_3D"])
    ply("embedding/%d.ply" % k, more=["embedding_0", "embedding_1"])
    ply("four/%d.ply" % k, rest=72)
    ply("extra/%d.ply" % k, end=b"7 bytes" if k else b"")
    ply("exp/%d.ply" % k, scale=0.05 if k else -3.0, opacity=3.0)
    ply("odd/%d.ply" % k, scale=[-3] + [9] * k)  # k of 40 are too large
    ply("far/%d.ply" % k, x=[0, 3000.0] if k else 1.0)
ply("half/0.ply", n=2, scale=[0.05, 0.5])  # half of them small is not most

# Zip files of torch.
model = path("4dg")
shutil.copytree(fixtures + "/4dgaussian/coarse_and_fine/model", model)
for name in ("sum", "more"):
    shutil.copytree(model, path(name))
last = "point_cloud/iteration_14000/"
shutil.copytree(model, path("guess"))
os.remove(path("guess/cfg_args"))
shutil.copytree(model, path("other"))
head, rows = read_ply(path("other", last + "point_cloud.ply"))
with open(path("other", last + "point_cloud.ply"), "wb") as f:
    f.write(head.replace(b"vertex %d\n" % len(rows), b"vertex %d\n" % (len(rows) - 1)) + rows[:-1].tobytes())
counts = open(path("counts"), "w")
print(len(rows), file=counts)
weights = path("sum", last + "deformation.pth")
with zipfile.ZipFile(weights) as z:
    members = [(i.filename, z.read(i)) for i in z.infolist()]
    small = next(n for n, d in members if "/data/" in n)
    two = [next(n for n, _ in members if n.endswith(end)) for end in ("/version", "/data.pkl")]
    print(small, two[0], file=counts)
data = bytearray(open(weights, "rb").read())
for magic, at in ((b"PK\1\2", 16), (b"PK\3\4", 14)):
    place = 0
    while True:
        place = data.find(magic, place)
        name = place + (46 if at == 16 else 30)
        if place < 0:
            break
        if any(data[name:name + len(n)] == n.encode() for n in two):
            data[place + at] ^= 255
        place += 4
open(weights, "wb").write(data)
with zipfile.ZipFile(path("more", last + "deformation.pth"), "w") as z:
    for name, d in members:
        z.writestr(name, d + b"12345" * (name == small))

# SpacetimeGaussians: a renamed column, and nonfinite values; without a network.
at = "point_cloud/iteration_12000/"
for name in ("fork", "nan", "bare"):
    shutil.copytree(fixtures + "/spacetimegs/full_techni/model", path(name))
head, rows = read_ply(path("fork", at + "point_cloud.ply"))
print(len(rows), file=counts)
with open(path("fork", at + "point_cloud.ply"), "wb") as f:
    f.write(head.replace(b"end_header", b"property float mine_0\nproperty float mine_1\nend_header") + np.concatenate(
        [rows, rows[:, :2]], 1).tobytes())
rows[[2, 5, 6], 0] = np.nan
with open(path("nan", at + "point_cloud.ply"), "wb") as f:
    f.write(head + rows.tobytes())
os.remove(path("bare", at + "point_cloud.pt"))

# Deformable 3DGS whose cfg_args declares the other kind.
shutil.copytree(fixtures + "/deformable3dgs/" + os.listdir(fixtures + "/deformable3dgs")[0] + "/model", path("kind"))
cfg = open(path("kind/cfg_args")).read()
print(cfg, file=open(path("kind/cfg_args"), "w"))
swap = {"True": "False", "False": "True"}
said = []
for key in ("is_blender", "is_6dof"):
    m = re.search(key + "=(True|False)", cfg)
    if m:
        cfg = cfg.replace(m.group(0), "%s=%s" % (key, swap[m.group(1)]))
        said.append("%s=%s" % (key, swap[m.group(1)]))
open(path("kind/cfg_args"), "w").write(cfg)
print(" ".join(said), file=counts)

# Data sets.
for name in ("missing", "focal"):
    shutil.copytree(fixtures + "/datasets/dynerf_mini", path(name))
for name in ("cam00/images/0002.png", "cam00/images/0003.png", "cam03/images/0003.png"):
    os.remove(path("missing", name))
poses = np.load(path("focal/poses_bounds.npy"))
poses[3, 14] *= 1.25
np.save(path("focal/poses_bounds.npy"), poses)
shutil.copytree(fixtures + "/datasets/colmap_mini", path("behind"))
images = bytearray(open(path("behind/sparse/0/images.bin"), "rb").read())
at = 8
for k in range(2):  # the second one
    start = at
    at = images.index(b"\0", at + 64) + 1
    name = images[start + 64:at - 1].decode()
    at += 8 + 24 * struct.unpack("<Q", images[at:at + 8])[0]
images[start + 52:start + 60] = struct.pack("<d", -1000.0)
open(path("behind/sparse/0/images.bin"), "wb").write(images)
print(name, file=counts)
shutil.copytree(fixtures + "/datasets4d/freetimegs_mini/scene", path("renamed"))
for name in os.listdir(path("renamed", "images")):
    os.rename(path("renamed", "images", name), path("renamed", "images", "view_" + "abc"[int(name[-1])]))
shutil.copytree(fixtures + "/datasets4d/easyvolcap_mini/scene", path("uneven"))
os.remove(path("uneven/images/01/000002.jpg"))

# The clip with cameras turned away: all, and five of eight; and with cameras shifted aside: all of
# them, all by a little less, and camera 12 in frame 1 only.
for name in ("away", "five", "aside", "less", "apart"):
    os.makedirs(path(name))
    os.symlink(os.path.join(work, "data", "ims"), path(name, "ims"))
    for which in ("train_meta.json", "test_meta.json"):
        m = json.load(open(os.path.join(work, "data", which)))
        for f, row in enumerate(m["w2c"]):
            for c, w in enumerate(row):
                if name == "away" or (name == "five" and m["cam_id"][f][c] <= 15):
                    w[1:3] = [[-x for x in r] for r in w[1:3]]
                if name in ("aside", "less"):
                    w[0][3] += 4.7 if name == "aside" else 4
                if name == "apart" and m["cam_id"][f][c] == 12 and f == 1:
                    w[0][3] += 3
        json.dump(m, open(path(name, which), "w"))
E
ok $? "makes the inputs"
{
    read -r n_4dg
    read -r member first
    read -r n_stg
    read -r kinds
    read -r second
} <"$work/counts"

# ---- Sources -------------------------------------------------------------------------------------

# of NAME ARGUMENTS...: the output of importing the source of that name.
of() {
    name=$1
    shift
    run "$bin/spin-import" "$work/$name" -o "$work/x.spin" --force "$@"
}
of filter
warns "filter_3D" "'$work/filter/0.ply': property 'filter_3D' (Mip-Splatting) is ignored"
mkdir "$work/flat" && LC_ALL=C sed '2a comment SplatRenderMode: 2dgs' "$work/sequence/0.ply" >"$work/flat/0.ply"
of flat
warns "2D splats" "'$work/flat/0.ply': trained as 2D splats (SplatRenderMode: 2dgs), drawn as flat 3D splats"
of embedding --from ply
warns "a canonical cloud" "'$work/embedding/0.ply': the canonical cloud of E-D3DGS is not a frame of the video"
of four
warns "SH degree 4" "'$work/four/0.ply': SH degree 4 is cut to degree 3"
of extra
warns "bytes after the last record, in two files" "'$work/extra/1.ply' has 7 bytes after its last record"
of exp
warns "values that look activated, in several files" \
    "'$work/exp/1.ply': all scales are positive and most are below 0.1; they are probably not logarithms" \
    "'$work/exp/4.ply': all opacities are in 0..1; they are probably not logits"
of half
warns "half of the scales small"
of 4dg --frames 2
warns "a sound run of 4DGaussians"
of guess --from 4dgaussian --frames 2
warns "no cfg_args" "'$work/guess/point_cloud/iteration_14000/deformation.pth': there is no cfg_args beside this file: the method's defaults are assumed"
save=point_cloud/iteration_14000
of other --frames 2
warns "a table of another save" \
    "'$work/other/$save/deformation_table.pth' is for $n_4dg Gaussians, but the cloud has $((n_4dg - 1))"
of sum --frames 2
warns "two wrong checksums" \
    "'$work/sum/$save/deformation.pth': the checksum of '$first' does not match; the file may be damaged"
of more --frames 2
warns "bytes behind a storage" \
    "'$work/more/$save/deformation.pth': storage 'data/${member##*/}' has 5 bytes more than its elements need"
cloud=point_cloud/iteration_12000/point_cloud.ply
base="only base colours are imported: there is no cameras.json: give positions with --camera"
of fork --times 0.5
warns "a fork's columns" "'$work/fork/$cloud': property 'mine_0' does not belong to SpacetimeGaussians and is ignored" \
    "'$work/fork/$cloud': $base"
of nan --times 0.5,1,1.5,2
warns "values that are not finite, times outside" "'$work/nan/$cloud': $base" \
    "'$work/nan/$cloud': 3 of $n_stg Gaussians dropped because of values that are not finite" \
    "2 of 4 times are outside the time range of the run, 0 to 0.95, such as 1.5"
of bare --times 0,1 --colour auto
warns "no network" \
    "'$work/bare/$cloud': only base colours are imported: there is no point_cloud.pt beside the cloud"
of bare --times 0,1 --colour base
warns "base colours that were asked for"
of kind --frames 2
set --
for kind in $kinds; do
    set -- "$@" "'$work/kind/cfg_args' has $kind, which does not match the network in '$(find "$work/kind" -name '*.pth' | tail -n 1)': the value is ignored"
done
warns "cfg_args of another kind" "$@"

# ---- Data sets -----------------------------------------------------------------------------------

with() { run "$bin/spin-import" --info fixtures/splats/splat --data "$work/$1" --pair order; }
with missing
warns "images are missing" "'$work/missing': 17 images for 5 cameras and 4 frames: 3 images are missing"
with focal
warns "focal lengths differ" \
    "'$work/focal': focal lengths differ between cameras; each keeps its own, other readers use the first for all"
with behind
warns "a camera with all points behind it" \
    "'$work/behind/sparse/0': all points are behind the camera of image '$second': its pose may be wrong, \
or in OpenGL's axes" \
    "the data set has one image per frame, each from a different camera position: this is right for the video of one moving \
camera; if the 9 images were taken at the same time, put them into a folder for each frame (see colmap in spin-importers(7))"

with renamed
warns "folders of other names" "'$work/renamed/images': the folders of frames are not named like the cameras of the model: \
'view_a' is used for 'cam000', and so on in the order of their names"
run "$bin/spin-import" --info fixtures/splats/splat --data "$work/uneven" --range 0:2 --pair order
warns "a camera with a frame less" "'$work/uneven/images/01' ends with frame 1 and '$work/uneven/images/00' with \
frame 2: the clip ends with frame 1"

# ---- Cameras against points ----------------------------------------------------------------------

# over DATA: renders of the points over its images, as JSON.
over() { run "$bin/spin-import" --check-cameras "$work/over" --data "$work/$1" "$clip" --force --json; }
# shares of the views that are drawn, in percent
shares() { figure '"%.0f" % (100 * sum(c["'"$1"'"] for c in j["cameras"]) / len(j["cameras"]))'; }
over data
warns "cameras that see the points"
over away
warns "cameras that look away" "only $(shares in_front) % of the points are in front of the cameras: check the axes, \
and that --data is the data set of this run"
over five
warns "five of eight that look away" "only $(shares in_front) % of the points are in front of the cameras: check the axes, \
and that --data is the data set of this run"
over aside
warns "cameras that look past them" "only $(shares inside) % of the points are inside the images: check the axes, \
and that --data is the data set of this run"
over less
warns "cameras that see few of them"
over apart
apart=$(figure '"camera %d has %.0f %% of the points in front and %.0f %% inside its image in frame %d, but the median of all views is %.0f %% and %.0f %%: check the pose of this camera" % next(
    (c["camera"], 100 * c["least_in_front"], 100 * c["least_inside"], c["frame"], 100 * j["shares"]["in_front"],
     100 * j["shares"]["inside"]) for c in j["shares"]["cameras"] if c["apart"])')
warns "one camera apart" "$apart"
is "${apart%% has*} $(echo "$apart" | grep -o 'in frame [0-9]*')" "camera 12 in frame 1" "and which"

# ---- Retraining ----------------------------------------------------------------------------------

in=$work/in.spin
run "$bin/spin-import" "$clip" --data "$work/data" -o "$in"
warns "an import"
retrain() { run "$bin/spin-retrain" "$in" -o "$work/out.spin" --device cpu --scale 0.25 --force --json "$@"; }
worse() { figure '"the result is worse than the source, test PSNR %.3f dB instead of %.3f dB: try " % (j["test"]["psnr"], j["before"]["psnr"])'; }
retrain --iterations 3 --backdrop off
warns "tracks that are worse" "$(worse)more --iterations, or --preset best"
small='--levels 2 --hash-log2 8 --hidden 16 --finest-resolution 16'
"$bin/spin-export" "$in" --to ply --source --scale 20 -o "$work/large" -q && rm "$work/large/sequence.json"
"$bin/spin-import" "$work/large" --data "$work/data" --pair order -o "$work/large.spin" -q
normal=$in in=$work/large.spin
# shellcheck disable=SC2086
retrain --preset paper --iterations 2 $small --resume
in=$normal
warns "points outside the ball, a network that is worse, nothing to resume" \
    "nothing to resume: '$work/out.spin' has no checkpoint, starting from the beginning" \
    "nearly all points are outside the unit ball: consider --scene-normalise auto" \
    "$(worse)more --iterations, --preset short, or --residual source"
greater "$(member outside_ball)" 0.9
ok $? "which they do"
# shellcheck disable=SC2086
retrain --preset paper --iterations 2 $small
greater "$(member outside_ball)" 0.09
ok $? "a tenth of the points outside the ball"
warns "is usual" "$(worse)more --iterations, --preset short, or --residual source"
retrain --method frames --refine 2 --lr-sh 1
warns "frames that are worse, an option without effect" "--lr-sh has no effect without a network" \
    "$(worse)a larger --refine, or --refine-start source"
retrain --iterations 3 --lr-position 0 --lr-tracked 0 --lr-displacement 0 --lr-track 0 --lr-residual 0
is "$code" 0 "a result that is as good"
SPIN_PROGRESS=soon retrain --iterations 3 --eval-every 1
is "$(grep -c "^warning: SPIN_PROGRESS='soon' is not a number of seconds; using 60 seconds$" "$work/err")" 1 \
    "SPIN_PROGRESS, once"

# ---- Images of half the size from one camera -----------------------------------------------------

cp -R "$work/data" "$work/small"
run "$bin/spin-export" "$in" --to images --size 80x45 --range 0:1 -o "$work/eighty"
first=$(find "$work/small/ims/0" -type f | sort | head -n 1)
cp "$work/eighty/cam_00_frame_00000.png" "$first"
run "$bin/spin-eval" "$in" --data "$work/small" --range 0:1 -q
warns "a picture that is smaller than its camera" "the images of 1 of 8 cameras are smaller than the data set states and are enlarged, \
such as 80 x 45 instead of 160 x 90 pixels for camera 0: use a smaller --scale to avoid that"
run "$bin/spin-eval" "$in" --data "$work/small" --range 0:1 -q --scale 0.5
warns "at the size that it has"

# ---- Exports -------------------------------------------------------------------------------------

export_to() { run "$bin/spin-export" "$1" --to "$2" -o "$work/$2" --force --device cpu; }
for to in splat gltf usd; do
    export_to "$work/out.spin" $to
    sed -i 's/ [0-9][0-9.]* dB / N dB /' "$work/err"
    warns "antialiased splats as $to" \
        "these splats were trained with antialiasing, but '$to' files do not tell viewers to use it; without antialiasing, \
images of the training's size have a PSNR of N dB against antialiased ones: enable it in the viewer, or bake it with --bake-antialias"
done
export_to "$work/out.spin" ply
warns "antialiased splats as ply"
export_to "$in" splat
warns "a folder that has the frames of a former export"
echo mine >"$work/splat/notes"
export_to "$in" splat
warns "a folder that has files" "folder '$work/splat' was not empty: files that are not overwritten stay in it"
of odd
warns "an import of odd splats"
echo mine >"$work/gltf/notes"
export_to "$work/x.spin" gltf
warns "splats that are left out, of a folder that has files" \
    "folder '$work/gltf' was not empty: files that are not overwritten stay in it" \
    "frame 1: 1 of 40 splats left out: 1 larger than the scene" \
    "frame 2: 2 of 40 splats left out: 2 larger than the scene"
out_has ", 39 splats each, .*, 3 splats left out$" "and the report adds them up"
of far
run "$bin/spin-export" "$work/x.spin" --to spz -o "$work/spz"
warns "a splat far away" \
    "frame 1: a coordinate of a splat is 3000: to store it, positions of this and all later frames are rounded to steps of 1/2048"
of sequence --data "$work/missing"
run "$bin/spin-export" "$work/x.spin" --to images --size 40x30 -o "$work/images"
warns "frames without a test view" "'$work/missing': 17 images for 5 cameras and 4 frames: 3 images are missing" \
    "2 of 4 frames were not rendered: the data set has no view of them that --views selects"
mv "$work/data" "$work/gone"
run "$bin/spin-export" "$in" --to images --size 40x30 --range 0:1 -o "$work/images2"
warns "a data set that is gone, whose cameras the bundle keeps"
run "$bin/spin-export" "$in" --to ply -o "$work/ply2"
warns "which only pictures need"
run "$bin/spin-export" "$in" --to ply --background white -o "$work/ply3"
warns "a background of no picture" "--background has no effect: this export renders no images"

# ---- Plug-ins ------------------------------------------------------------------------------------

places=$(for i in $(seq 1 66); do printf '%s:' "$work/none/$i/"; done)
run env SPIN_PLUGIN_PATH="${places%:}" "$bin/spin-import" --list
is "$code $(grep -c '^warning: ' "$work/err")" "0 65" "66 plug-ins that are not there: 64 lines, and one"
is "$(sed -n '3p;65p' "$work/err")" "warning: plug-in '$work/none/3/' of SPIN_PLUGIN_PATH does not exist; the plug-in is skipped
warning: SPIN_PLUGIN_PATH: 2 more plug-ins are skipped" "a line for each, and how many more there are"
done_testing
