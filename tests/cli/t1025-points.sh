#!/bin/sh
# K: points datasets colmap panoptic one command
# A data set that is given as the run: spin4d describes it, and prints a command that starts from
# the points found in it. The commands are run as they are printed.
. tests/cli/lib.sh
python3 tests/cli/layouts.py make "$work/sets"
ok $? "the data sets are written"
PATH=$(cd "$bin" && pwd):$PATH
n_measured=0

# spin4d describes the data set; its command is run with few iterations.
offered() { # FOLDER CONTENT OFFER FRAMES SPLATS
    run "$bin/spin4d" "$1" -o "$work/none.html"
    is "$code" 1 "$1: is no run"
    err_has "is a data set ($2, not a run: give the folder" "it is described"
    err_has "; or start from $3: spin4d " "and its points are offered"
    command=$(sed -n 's/.*; or start from .*: \(spin4d .*\)$/\1/p' "$work/err")
    (cd "$work" && eval "$command --iterations 20 --preset quick") >"$work/out" 2>"$work/err"
    ok $? "the command works"
    is "$(cat "$work/out" "$work/err" | grep 'held-out views' | grep -vc '^held-out views: [0-9.]* dB$')" 0 \
        "points have no quality before the training"
    n_measured=$((n_measured + $(cat "$work/out" "$work/err" | grep -c '^held-out views')))
    run spin-import --info "$work/$(basename "$1").spin" --json
    is "$(member frames)" "$4" "its clip has $4 frames"
    out_has "\"mean\": $5\b" "of $5 points"
}

cp -r fixtures/datasets/panoptic_mini "$work/pan op'tic"
cp -r fixtures/datasets/blender_mini "$work/blender"
printf 'ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n%s' \
    'property uchar red
property uchar green
property uchar blue
end_header
0 0 0 255 0 0
0.5 0 0 0 255 0
0 0.5 0 0 0 255
0 0 0.5 9 9 9
' >"$work/blender/fused.ply"
offered "$work/pan op'tic" "panoptic) of 11 cameras and 6 frames" "its points, for a still of its first frame" 1 290
offered "$work/blender" "transforms) of 2 cameras and 7 frames" "its points" 7 4
offered "$work/sets/multipleview" "colmap) of 3 cameras and 3 frames" "its points, for a still of its first frame" 1 2
offered "$work/sets/colmap_t" "colmap) of 3 cameras and 3 frames" "the points of its frames" 3 2

[ "$n_measured" -gt 0 ]
ok $? "the result is measured: $n_measured"

# Without points nothing is offered.
: >"$work/pan op'tic/init_pt_cld.npz"
run "$bin/spin4d" "$work/pan op'tic" -o "$work/none.html"
is "$(grep -c 'not a run: give the folder' "$work/err") $(grep -c 'or start from' "$work/err")" "1 0" "a data set without points"

# Each kind of file.
points=$work/sets/colmap_t/colmap_0/sparse/0/points3D.bin
run "$bin/spin-import" "$points" --json -o "$work/binary.spin"
is "$code $(member from) $(member frames)" "0 points 1" "points3D.bin"
is "$(tr -d ' \n' <"$work/out" | grep -o '"max":\[[^]]*\]')" '"max":[1,1,2]' "its positions"
mkdir "$work/text"
printf '# points\n7 -1 1 2.5 255 0 51 0.1\n9 1 2 3 0 255 0 0.1 1 1\n' >"$work/text/points3D.txt"
run "$bin/spin-import" "$work/text/points3D.txt" -o "$work/text.spin"
is "$code" 0 "points3D.txt"
run "$bin/spin-export" "$work/text.spin" --to numpy -o "$work/arrays"
run "$bin/spin-import" --info "$work/text.spin" --full
out_has "rgb" "its colours"
printf '# points\n7 -1 1 2.5 red 0 51 0.1\n' >"$work/text/points3D.txt"
run "$bin/spin-import" "$work/text/points3D.txt" -o "$work/none.spin"
fails 1 spin-import "a colour that is no number"
err_has "point 7: a colour is 'red', expected a number" "is named"
# Points far from 0, as text, as doubles in .bin and .npz, and as PLY: each keeps its digits.
mkdir -p "$work/utm/floats"
python3 - "$work/utm" <<'PY'
import io, struct, sys, zipfile
place = [(448262.5, y, 120.0) for y in (5411932.001, 5411932.002, 5411933.003, 5411934.125)]
with open(sys.argv[1] + "/points3D.txt", "w") as f:
    for i, p in enumerate(place):
        f.write("%d %.6f %.6f %.6f 255 0 51 0.1\n" % (i, *p))
with open(sys.argv[1] + "/points3D.bin", "wb") as f:
    f.write(struct.pack("<Q", len(place)))
    for i, p in enumerate(place):
        f.write(struct.pack("<Q3d3BdQ", i, *p, 255, 0, 51, 0.1, 0))
with open(sys.argv[1] + "/fused.ply", "w") as f:
    f.write("ply\nformat ascii 1.0\nelement vertex 4\n" + "".join("property double %s\n" % c for c in "xyz") + "end_header\n")
    for p in place:
        f.write("%.6f %.6f %.6f\n" % p)
for code, name in ("<f8", "init_pt_cld.npz"), ("<f4", "floats/other.NPZ"):
    head = "{'descr': '%s', 'fortran_order': False, 'shape': (4, 7), }" % code
    head = (head + " " * (117 - len(head)) + "\n").encode()
    rows = struct.pack("<28" + ("d" if code == "<f8" else "f"), *[v for p in place for v in (*p, 1, 0, 0.2, 0)])
    with zipfile.ZipFile(sys.argv[1] + "/" + name, "w") as z:
        z.writestr("data.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + rows)
PY
for name in points3D.txt points3D.bin init_pt_cld.npz fused.ply; do
    run "$bin/spin-import" --from points "$work/utm/$name" --force -o "$work/utm.spin"
    out_has "relative to 44826[23], 541193[23], 120" "$name: the shift is named"
    is "$(python3 -c 'import json, struct, sys, zipfile
z = zipfile.ZipFile(sys.argv[1]); b = z.read("source/means/00000.npy") if "source/means/00000.npy" in z.namelist() else z.read("source/means.npy")
at = len(b) - 48; shift = json.loads(z.read("meta.json"))["shift"]
print(*["%.5f" % (struct.unpack_from("<f", b, at + 12 * i + 4)[0] + shift[1]) for i in range(4)])' "$work/utm.spin")" \
        "5411932.00100 5411932.00200 5411933.00300 5411934.12500" "$name: the digits of the file"
done
run "$bin/spin-import" --from points "$work/utm/floats/other.NPZ" --force -o "$work/utm.spin"
is "$code" 0 "floats far from 0"
err_has "other.NPZ': positions are up to 5.41193e+06 from 0, where floats have steps of 0.5" "are warned of"
printf '# points\n' >"$work/text/points3D.txt"
run "$bin/spin-import" "$work/text/points3D.txt" -o "$work/none.spin"
fails 1 spin-import "a model without points"
run "$bin/spin-import" --from points "$(find fixtures/ply/inria_sh3 -name '*.ply' | head -n 1)" -o "$work/none.spin"
is "$code" 1 "Gaussians are no points"
err_has "contains Gaussians, not points: use --from ply" "says what to do"
done_testing
