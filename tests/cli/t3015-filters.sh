#!/bin/sh
# K: export ply 4d filters
# spin-export --crop, --min-views, --floaters, --scale and --translate: which splats are kept, with
# which positions and sizes.
. tests/cli/lib.sh

if ! python3 -c 'import numpy' 2>/dev/null; then
    skip "filters" "no python3 with numpy"
    done_testing
fi
compare=${SPIN_BUILD:-build/release}/tests/tools/compare-images
export PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=exporters/python

# Python with ply(path), which returns the columns of a binary PLY by name, and the bundles of
# spin4d.
cat >"$work/preamble" <<'P'
import sys
import numpy as np
import spin4d
def ply(path):
    data = open(path, 'rb').read()
    head, body = data.split(b'end_header\n', 1)
    names = [l.split()[2].decode() for l in head.split(b'\n') if l.startswith(b'property')]
    return dict(zip(names, np.frombuffer(body, '<f4').reshape(-1, len(names)).T))
P

# A grid of 4 x 4 x 4 with a spacing of 0.1, a small splat far from it, and one far from it that is
# large enough to reach it.
{
    printf 'ply\nformat ascii 1.0\nelement vertex 66\n'
    printf 'property float %s\n' x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3
    echo end_header
    for x in 0 1 2 3; do for y in 0 1 2 3; do for z in 0 1 2 3; do
        echo "0.$x 0.$y 0.$z 1 1 1 2 -5 -5 -5 1 0 0 0"
    done; done; done
    echo "4 0 0 1 1 1 2 -5 -5 -5 1 0 0 0"
    echo "0 4 0 1 1 1 2 -5 1 -5 1 0 0 0"
} >"$work/grid.ply"
run "$bin/spin-import" "$work/grid.ply" -o "$work/grid.spin"
is "$code" 0 "imports the grid"
export_grid() { # OUT OPTION...
    out=$work/$1
    shift
    run "$bin/spin-export" "$work/grid.spin" --to ply -o "$out" --max-scale 0 "$@"
}

export_grid front --backdrop off
is "$code" 0 "--backdrop off without a backdrop"
err_has "warning: --backdrop off has no effect: these splats have no backdrop" "says so"
export_grid box --crop -0.05,-0.05,-0.05,0.15,0.35,0.25 --json
is "$code $(member filtered) $(member left_out) $(member splats_mean)" "0 42 0 24" "a box: how many are out of it"
out_has '"crop": 42' "and for which reason"
holds "a box keeps what is in it" 'p = ply(sys.argv[1])
assert len(p["x"]) == 24 and p["x"].max() < .15 and p["y"].max() > .25 and p["z"].max() < .25' "$work/box/frame_00000.ply"
export_grid ball --crop 4,0,0,0.5 --check
is "$code" 0 "a sphere, checked"
holds "a sphere keeps what is in it" 'assert list(ply(sys.argv[1])["x"]) == [4]' "$work/ball/frame_00000.ply"
export_grid alone --floaters 5
is "$code" 0 "--floaters"
err_has "^1 of 66 splats left out: 1 by --floaters" "it is said what went, and why"
holds "what is far from all others goes, unless it reaches them" 'p = ply(sys.argv[1])
assert len(p["x"]) == 65 and p["x"].max() < 1 and p["y"].max() == 4' "$work/alone/frame_00000.ply"
export_grid nothing --crop 9,9,9,1
is "$code" 0 "nothing is left"
err_has "^warning: no splats are left; left out: 66 by --crop" "it is said"
export_grid moved --scale 2 --translate 1,-2,3 --rotate 0,0,90 --check
is "$code" 0 "scaled, moved, turned, and checked"
export_grid plain
holds "scale first, then the place, then the turn" 'a, b = ply(sys.argv[1]), ply(sys.argv[2])
q = np.stack([2 * a[k] + t for k, t in zip("xyz", (1, -2, 3))])
assert np.allclose(np.stack([-q[1], q[0], q[2]]), np.stack([b[k] for k in "xyz"]), atol=1e-5)
assert np.allclose(a["scale_1"] + np.log(2), b["scale_1"], atol=1e-6)' "$work/plain/frame_00000.ply" "$work/moved/frame_00000.ply"
for wrong in --crop=1,2,3 --crop=1,2,3,-1 --crop=0,0,0,1,1,-1 --scale=0 --translate=1,2 --floaters=0.5 --min-views=0; do
    export_grid never "$wrong"
    fails 2 spin-export "$wrong"
done
export_grid never --min-views 2
fails 2 spin-export "--min-views without a data set"

# The cameras of court-mini: splats visible to enough training cameras of their frame are kept.
run "$bin/spin-import" "$clip" --data "$clip" -o "$work/court.spin"
run "$bin/spin-export" "$work/court.spin" --to ply -o "$work/court"
run "$bin/spin-export" "$work/court.spin" --to ply -o "$work/seen" --min-views 6 --json
is "$code" 0 "--min-views"
holds "by the pictures of six cameras" 'import json
a, b, root = ply(sys.argv[1]), ply(sys.argv[2]), sys.argv[3]
meta = json.load(open(root + "/train_meta.json"))
p = np.stack([a[k] for k in "xyz"] + [np.ones(len(a["x"]))])
n = 0
for k, w in zip(meta["k"][2], meta["w2c"][2]):
    c = np.array(w)[:3] @ p
    u, v = (np.array(k) @ c)[:2] / c[2]
    n = n + ((c[2] > .2) & (u >= 0) & (v >= 0) & (u <= meta["w"]) & (v <= meta["h"]))
assert 0 < (n >= 6).sum() < len(n) and np.array_equal(a["x"][n >= 6], b["x"])' \
    "$work/court/frame_00002.ply" "$work/seen/frame_00002.ply" "$clip"
run "$bin/spin-export" "$work/court.spin" --to ply -o "$work/never" --min-views 7
fails 2 spin-export "--min-views beyond the cameras"
err_has "frame 0 has 6 training views" "it is said how many there are"

# --decimate applies to the splats that filters keep; floaters are measured among all splats; the
# transform comes last.
export_grid twenty --floaters 5 --decimate 20 --scale 2 --json
is "$code $(member filtered) $(member splats_mean)" "0 1 20" "--decimate of what --floaters leaves"
holds "is what is largest of that, moved" 'p = ply(sys.argv[1])
assert len(p["x"]) == 20 and p["x"].max() < 1 and p["y"].max() == 8, p' "$work/twenty/frame_00000.ply"
# A clip whose first frames are empty, far from the origin: page and images face the place where
# splats will appear.
mkdir "$work/late"
sed 's/vertex 66/vertex 1/; /end_header/q' "$work/grid.ply" >"$work/late/0.ply"
echo "-9 -9 -9 1 1 1 2 -5 -5 -5 1 0 0 0" >>"$work/late/0.ply"
sed '/end_header/,$s/^\(0\.[0-9]\|4\|0\) /50\1 /' "$work/grid.ply" >"$work/late/1.ply"
run "$bin/spin-import" "$work/late" -o "$work/late.spin"
run "$bin/spin-export" "$work/late.spin" --to images -o "$work/late-images" --size 64x48 --crop 400,-9,-9,600,9,9
err_has "^warning: 1 of 2 renders shows only" "the frame that has splats shows them"
run "$bin/spin-export" "$work/late.spin" -o "$work/late.html" --crop 400,-9,-9,600,9,9
grep -q '"centre": *\[50' "$work/late.html"
ok $? "the page is about the middle of them"
run "$bin/spin-export" "$work/court.spin" --to ply -o "$work/few" --min-views 6 --decimate 50% --json
is "$code" 0 "--decimate of what six cameras see"
out_has "\"unit\": \"in all\"" "counts rows of the clip, not of a frame"
mkdir "$work/apart" && cp "$work/grid.ply" "$work/apart/0.ply"
sed 's/vertex 66/vertex 65/; $ d' "$work/grid.ply" >"$work/apart/1.ply"
run "$bin/spin-import" "$work/apart" -o "$work/apart.spin"
# sequence.json declares persistent rows if the same rows are kept in every frame.
run "$bin/spin-export" "$work/court.spin" --to ply -o "$work/part" --crop 0,0,0,1
grep -q '"identity": false' "$work/part/sequence.json"
ok $? "splats that move out of a sphere leave other rows in each frame"
run "$bin/spin-export" "$work/court.spin" --to ply -o "$work/faint" --min-opacity 0.9
grep -q '"identity": true' "$work/faint/sequence.json"
ok $? "rows that are faint in all frames leave the others the same"
run "$bin/spin-export" "$work/apart.spin" --to ply -o "$work/apart-few" --crop 0,0,0,1 --decimate 20 --json
out_has "\"unit\": \"a frame\"" "or of a frame, where frames share none"
holds "leaves half of it, and nothing else" 'a, b = ply(sys.argv[1]), ply(sys.argv[2])
rows = lambda p: {r.tobytes() for r in np.stack([p[k] for k in p], 1)}
assert rows(b) < rows(a) and .3 * len(a["x"]) < len(b["x"]) <= .55 * len(a["x"]), (len(a["x"]), len(b["x"]))' \
    "$work/seen/frame_00002.ply" "$work/few/frame_00002.ply"

# Cameras move with the scene, so the image is the same.
for how in '' '--scale 3 --translate 1,2,-3'; do
    # shellcheck disable=SC2086
    run "$bin/spin-export" "$work/court.spin" --to images -o "$work/pictures$(echo "$how" | wc -w)" --range 2:3 $how
done
run "$bin/spin-export" "$work/court.spin" --to images -o "$work/pictures5" --range 2:3 --translate 1000,0,0
! grep -q 'only the background' "$work/err"
ok $? "cameras move with the scene"
if [ -x "$compare" ]; then
    run "$compare" "$work/pictures0/cam_00_frame_00002.png" "$work/pictures4/cam_00_frame_00002.png"
    [ "$code" = 0 ] && [ "$(cut -d' ' -f1 "$work/out")" -le 2 ]
    ok $? "a scene that is scaled and moved, from its cameras"
    # The near plane is scaled too; for data sets in small units it is derived from the visible
    # points.
    run "$bin/spin-export" "$work/court.spin" --to images -o "$work/tiny" --range 2:3 --scale 0.01
    run "$compare" "$work/pictures0/cam_00_frame_00002.png" "$work/tiny/cam_00_frame_00002.png"
    [ "$code" = 0 ] && [ "$(cut -d' ' -f1 "$work/out")" -le 2 ]
    ok $? "a hundredth of the size, from its cameras"
else
    skip "pictures of a moved scene" "$compare is not built"
fi
holds "the clip in centimetres" 'import json, os
src, to, s = sys.argv[1], sys.argv[2], 0.01
os.mkdir(to)
os.symlink(os.path.abspath(src) + "/ims", to + "/ims")
for name in ("train_meta.json", "test_meta.json"):
    meta = json.load(open(f"{src}/{name}"))
    for row in (row for frame in meta["w2c"] for w2c in frame for row in w2c[:3]):
        row[3] *= s
    json.dump(meta, open(f"{to}/{name}", "w"))
run = dict(np.load(src + "/params.npz"))
run["means3D"] = (s * run["means3D"]).astype("f4")
run["log_scales"] = (np.log(s) + run["log_scales"]).astype("f4")
np.savez(to + "/params.npz", **run)' "$clip" "$work/centimetres"
run "$bin/spin-import" "$work/centimetres" --data "$work/centimetres" -o "$work/centimetres.spin"
run "$bin/spin-eval" "$work/court.spin" --source --range 2:3 --json
psnr=$(member psnr)
run "$bin/spin-eval" "$work/centimetres.spin" --source --range 2:3 --json
is "$(member psnr | cut -c1-5)" "$(echo "$psnr" | cut -c1-5)" "units do not change what is measured"
run "$bin/spin-retrain" "$work/centimetres.spin" -o "$work/taught.spin" --range 2:3 --scale 0.25 --iterations 20 --device cpu
is "$code" 0 "nor that it can be trained"
run "$bin/spin-export" "$work/court.spin" --to ply -o "$work/far" --translate 1,0,0
! grep -q '"data"' "$work/far/sequence.json" && grep -q '"data"' "$work/court/sequence.json"
ok $? "a moved scene does not name its data set"
grep -q '"identity": true' "$work/court/sequence.json" && grep -q '"identity": false' "$work/seen/sequence.json"
ok $? "a filtered clip is not said to keep its rows"

# 4D splats are filtered as rows, at their positions in the frame nearest to their own centre in
# time.
run "$bin/spin-import" fixtures/ftgs_ply/sh1_clamped/scene.ftgs.ply -o "$work/4d.spin"
run "$bin/spin-export" "$work/4d.spin" -o "$work/part.ftgs.ply" --crop 0,-99,-99,99,99,99 --scale 2 --translate 0,1,0 --json
is "$code" 0 "4D splats, cropped and moved"
filtered=$(member filtered)
run "$bin/spin-import" "$work/part.ftgs.ply" -o "$work/part.spin"
holds "each row by where it is at the frame nearest to its own time; all of it moves" 'a, b = (spin4d.load(p) for p in sys.argv[1:3])
v = {k: (a.values("source/4d/" + k), b.values("source/4d/" + k)) for k in ("centres", "times", "paths", "log_scales")}
own = v["times"][0][:, 0]
sigma, opacity = a.values("source/4d/sigmas")[:, 0], 1 / (1 + np.exp(-a.values("source/4d/logit_opacities")[:, 0]))
weight = np.exp(-.5 * ((a.times[None] - own[:, None]) / sigma[:, None]) ** 2)
shown = (weight >= a.splats_4d["least_weight"]) & (weight * opacity[:, None] >= a.splats_4d["least_opacity"])
away = np.where(shown, np.abs(a.times[None] - own[:, None]), np.inf)
near = np.where(shown.any(1), a.times[away.argmin(1)], own)
at = v["centres"][0] + v["paths"][0].reshape(len(own), 3) * (near - own)[:, None]
kept = at[:, 0] >= 0
assert 0 < kept.sum() == len(kept) - int(sys.argv[3])
kept &= shown.any(1)  # a file has no others
assert len(v["centres"][1]) == kept.sum(), (len(v["centres"][1]), kept.sum())
assert np.allclose(2 * v["centres"][0][kept] + (0, 1, 0), v["centres"][1], atol=1e-5)
assert np.allclose(2 * v["paths"][0][kept], v["paths"][1], rtol=1e-5, atol=1e-6)
assert np.allclose(np.log(2) + v["log_scales"][0][kept], v["log_scales"][1], atol=1e-5)' "$work/4d.spin" "$work/part.spin" "$filtered"
run "$bin/spin-export" "$work/4d.spin" -o "$work/part.tsog" --crop 0,-99,-99,99,99,99 --check
is "$code" 0 "--check of filtered 4D splats"
done_testing
