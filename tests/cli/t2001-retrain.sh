#!/bin/sh
# K: retrain threads
# spin-retrain on the smallest data set: reports, files, options.
. tests/cli/lib.sh

run_of=$fixtures/d3dgs/trained
data=$fixtures/datasets/panoptic_mini
if [ ! -d "$run_of" ] || [ ! -d "$data" ]; then
    skip "retrain" "no fixtures at $run_of and $data"
    done_testing
fi
small='--preset paper --device cpu --levels 4 --hash-log2 10 --finest-resolution 32 --hidden 16'
in=$work/in.spin
run "$bin/spin-import" "$run_of" --data "$data" -o "$in" --json
is "$code" 0 "imports the run"
cp "$work/out" "$work/import.json"

run "$bin/spin-retrain" "$in" --dry-run $small --json
is "$code" 0 "--dry-run succeeds"
is_json "--dry-run --json is one document"
greater "$(member bytes_needed)" 0
ok $? "--dry-run knows the memory needed"
greater "$(member bytes_available)" 0
ok $? "--dry-run knows the memory available"
splats=$(sed -n 's/^    "mean": \([0-9.]*\),*$/\1/p' "$work/import.json")
is "$(member splats_mean)" "$splats" "--dry-run knows the splats of a frame"

run "$bin/spin-retrain" "$in" -o "$work/one.spin" $small --iterations 6 --json --threads 1 \
    --log "$work/log.jsonl" --preview "$work/preview"
is "$code" 0 "retrains six steps"
is_json "--json at the end is one document"
is "$(member iterations)" 6 "reports its iterations"
frames=$(member frames "$work/import.json")
is "$(member frames)" "$frames" "reports the frames of the run"
is "$(member splats_mean)" "$splats" "and its splats"
is "$(member output)" "$work/one.spin" "and its output"
is "$(sed -n 's/^  "device": "\(cpu\) (.*, 1 thread)",*$/\1/p' "$work/out")" cpu "and on what it ran"
greater "$(member seconds)" 0 && greater 600 "$(member seconds)"
ok $? "and for how long"
# quality WHICH KEY: a value of "test" or "before" in the last report
quality() { sed -n '/"'"$1"'": {/,/}/s/.*"'"$2"'": \(-*[0-9][-0-9.e]*\),*$/\1/p' "$work/out"; }
for which in test before; do
    psnr=$(quality $which psnr)
    ssim=$(quality $which ssim)
    greater "$psnr" 1 && greater 60 "$psnr" && greater "$ssim" -1 && greater 1 "$ssim"
    ok $? "and its quality, $which ($psnr dB, $ssim)"
done
cp "$work/out" "$work/retrain.json"
# as_measured WHICH NAME: the last spin-eval --json agrees with the report of the training.
as_measured() {
    awk -v a="$(sed -n '/"'"$1"'": {/,/}/s/.*"psnr": \([0-9.]*\).*/\1/p' "$work/retrain.json")" \
        -v b="$(member psnr)" 'BEGIN { d = a - b; exit !(a != "" && b != "" && d < 1e-3 && d > -1e-3) }'
    ok $? "$2"
}
run "$bin/spin-eval" "$work/one.spin" --json
as_measured test "spin-eval measures the same after"
run "$bin/spin-eval" "$in" --json
as_measured before "and the same before"
is "$(grep -c '"views": \[\[[0-9]*, [0-9]*\], \[[0-9]*, [0-9]*\], \[[0-9]*, [0-9]*\]\]' "$work/log.jsonl")" 6 \
    "--log has a line for every step"
greater "$(find "$work/preview" -name 'cam_*_frame_*_iteration_0000006.png' | wc -l)" 0
ok $? "--preview has pictures"
nothing_at "$work/one.spin." "no unfinished state is left"
run "$bin/spin-retrain" "$in" -o "$work/one.spin" $small --iterations 6
fails 1 spin-retrain "does not overwrite"

run "$bin/spin-retrain" "$in" -o "$work/two.spin" $small --iterations 6 --threads 2
is "$code" 0 "retrains on two threads"
same_frames "$work/one.spin" "$work/two.spin" "one thread and two give the same bits"
run "$bin/spin-retrain" "$in" -o "$work/other.spin" $small --iterations 6 --seed 7
other_frames "$work/one.spin" "$work/other.spin" "another seed gives others"

run "$bin/spin-retrain" "$in" -o "$work/still.spin" $small --iterations 6 --lr-position 0 \
    --precision full
is "$code" 0 "retrains without moving the splats"
if command -v python3 >/dev/null 2>&1; then
    python3 -c 'import sys, zipfile
z = zipfile.ZipFile(sys.argv[1])
moved = zipfile.ZipFile(sys.argv[2])
name = "trained/means/00000.npy"
still = z.read(name) == z.read("source/means/00000.npy")
sys.exit(not (still and moved.read(name) != z.read(name)))' "$work/still.spin" "$work/one.spin"
    ok $? "--lr-position 0 leaves them where they are, the default does not"
else
    skip "--lr-position 0" "no python3"
fi

# Changes by ablation options are recorded in the bundle; the paper's defaults are not.
run "$bin/spin-retrain" "$in" -o "$work/plain.spin" $small --iterations 6 --lr-position 0 \
    --activation relu --scene-normalise none --json
is "$code" 0 "retrains with ReLU, without the contraction, at fixed positions"
learned=$(sed -n '/"test": {/,/}/s/.*"psnr": \([0-9.]*\).*/\1/p' "$work/out")
run "$bin/spin-eval" "$work/plain.spin" --json
awk -v a="$learned" -v b="$(member psnr)" 'BEGIN { d = a - b; exit !(b != "" && d < 1e-3 && d > -1e-3) }'
ok $? "and spin-eval decodes it the same way"
run "$bin/spin-retrain" "$in" -o "$work/x.spin" $small --activation tanh
fails 2 spin-retrain "no such activation"

# Splats with attributes of their own: the network's initial contribution is zero.
run "$bin/spin-retrain" "$in" -o "$work/own.spin" $small --iterations 1 --residual source --lr-residual 0 \
    --lr-position 0 --lr-table 0 --head-lr-factor 0 --sh-degree 0 --precision full --json
is "$code" 0 "retrains with the source's values to add to"
before=$(sed -n '/"before": {/,/}/s/.*"psnr": \([0-9.]*\).*/\1/p' "$work/out")
after=$(sed -n '/"test": {/,/}/s/.*"psnr": \([0-9.]*\).*/\1/p' "$work/out")
"$bin/spin-export" "$in" --to ply --sh 0 -o "$work/source" -q 2>"$work/err"
"$bin/spin-export" "$work/own.spin" --to ply -o "$work/added" -q 2>"$work/err"
if command -v python3 >/dev/null 2>&1 && python3 -c 'import numpy' 2>/dev/null; then
    python3 -c 'import glob, sys
import numpy as np
def read(path):
    raw = open(path, "rb").read()
    end = raw.index(b"end_header\n") + 11
    names = [l.split()[2] for l in raw[:end].decode().splitlines() if l.startswith("property")]
    a = np.frombuffer(raw, "<f4", -1, end).reshape(-1, len(names))
    return {n: a[:, i] for i, n in enumerate(names)}
def unit(v):
    q = np.stack([v["rot_%d" % i] for i in range(4)])
    return q / np.linalg.norm(q, axis=0)
for a, b in zip(sorted(glob.glob(sys.argv[1] + "/*.ply")), sorted(glob.glob(sys.argv[2] + "/*.ply"))):
    a, b = read(a), read(b)
    for k in a:
        if not k.startswith("rot_"):
            assert np.allclose(a[k], b[k], rtol=0, atol=1e-6), k
    assert np.allclose(unit(a), unit(b), rtol=0, atol=1e-6)
' "$work/source" "$work/added" 2>"$work/err"
    ok $? "nothing added: the source's attributes come out"
else
    skip "nothing added" "no python3 with numpy"
fi
awk -v a="$before" -v b="$after" 'BEGIN { d = a - b; exit !(a > 1 && d < 0.01 && d > -0.01) }'
ok $? "and look the same: $before dB before and $after dB after"
# A dynamic track has one rotation, in a reference frame of its own: that of the splat in the frame
# it was read from.
run "$bin/spin-import" fixtures/court-mini --data fixtures/court-mini -o "$work/mini.spin"
run "$bin/spin-retrain" "$work/mini.spin" -o "$work/turned.spin" --residual source --iterations 1 --lr-track 0 \
    --lr-displacement 0 --lr-residual 0 --lr-position 0 --densify-every 0 --precision full --backdrop off
is "$code" 0 "retrains tracks from the source's values"
"$bin/spin-export" "$work/mini.spin" --to ply --range 0:1 -o "$work/first" -q 2>"$work/err"
"$bin/spin-export" "$work/turned.spin" --to ply --range 0:1 -o "$work/turned" -q 2>"$work/err"
if command -v python3 >/dev/null 2>&1 && python3 -c 'import numpy' 2>/dev/null; then
    python3 -c 'import glob, sys
import numpy as np
def rotations(folder):
    raw = open(glob.glob(folder + "/*.ply")[0], "rb").read()
    end = raw.index(b"end_header\n") + 11
    names = [l.split()[2] for l in raw[:end].decode().splitlines() if l.startswith("property")]
    a = np.frombuffer(raw, "<f4", -1, end).reshape(-1, len(names))
    q = np.stack([a[:, names.index("rot_%d" % i)] for i in range(4)])
    return q / np.linalg.norm(q, axis=0)
assert np.abs((rotations(sys.argv[1]) * rotations(sys.argv[2])).sum(0)).min() > 1 - 1e-5
' "$work/first" "$work/turned" 2>"$work/err"
    ok $? "their rotations come out where they were read"
else
    skip "their rotations" "no python3 with numpy"
fi
# Points that no training camera sees learn nothing, so they are nearly opaque from the start, as
# the others become.
if command -v python3 >/dev/null 2>&1 && python3 -c 'import numpy' 2>/dev/null; then
    python3 -c 'import os, sys
import numpy as np
p = np.load(sys.argv[1])
os.mkdir(sys.argv[2])
for f, means in enumerate(p["means3D"]):
    with open("%s/frame_%05d.ply" % (sys.argv[2], 8 + f), "w") as ply:
        ply.write("ply\nformat ascii 1.0\nelement vertex %d\n" % len(means))
        ply.write("".join("property float %s\n" % c for c in "xyz") + "end_header\n")
        np.savetxt(ply, means)
' fixtures/court-mini/params.npz "$work/points"
    run "$bin/spin-import" "$work/points" --data fixtures/court-mini -o "$work/points.spin"
    run "$bin/spin-retrain" "$work/points.spin" -o "$work/unseen.spin" --iterations 1 --lr-track 0 --lr-residual 0 \
        --densify-every 0 --precision full --test-cams 0,3,7,12,15,19 --backdrop off
    is "$code" 0 "retrains points for two cameras"
    "$bin/spin-import" --info "$work/unseen.spin" --views --json >"$work/views.json"
    is "$(awk '/"camera": / { camera = $2 } /"test": true/ { print camera }' "$work/views.json" | tr -d , | sort -nu | xargs)" \
        "0 3 7 12 15 19" "--info --views marks the cameras that were held out"
    "$bin/spin-export" "$work/unseen.spin" --to ply --range 8:9 -o "$work/unseen" -q 2>"$work/err"
    python3 -c 'import glob, sys
import numpy as np
raw = open(glob.glob(sys.argv[1] + "/*.ply")[0], "rb").read()
end = raw.index(b"end_header\n") + 11
names = [l.split()[2] for l in raw[:end].decode().splitlines() if l.startswith("property")]
logit = np.frombuffer(raw, "<f4", -1, end).reshape(-1, len(names))[:, names.index("opacity")]
faint, strong = (np.abs(logit - x) < 1e-3 for x in (-2.1972, 1.5))
assert strong.sum() > 100 and faint.sum() > 1000 and (faint | strong).all(), np.unique(logit)
' "$work/unseen" 2>"$work/err"
    ok $? "those that neither sees are nearly opaque, all others faint"
    # Moving cameras: a track is initialised from a frame in which it is visible.
    mkdir "$work/moving"
    python3 -c 'import json, os, sys
source = os.path.abspath("fixtures/court-mini")
os.symlink(source + "/ims", sys.argv[1] + "/ims")
for name in "train_meta.json", "test_meta.json":
    m = json.load(open(source + "/" + name))
    for key in "k", "w2c":
        if name[1] == "r":
            m[key][0] = len(m[key][0]) * [m[key][0][m["cam_id"][0].index(23)]]
    json.dump(m, open(sys.argv[1] + "/" + name, "w"))
' "$work/moving"
    run "$bin/spin-retrain" "$work/points.spin" -o "$work/unseen.spin" --iterations 1 --lr-track 0 --lr-residual 0 \
        --densify-every 0 --precision full --data "$work/moving" --force
    is "$code" 0 "retrains points whose first frame is seen from one place"
    "$bin/spin-export" "$work/unseen.spin" --to ply --range 8:9 -o "$work/unseen" -q --force 2>"$work/err"
    python3 -c 'import glob, sys
import numpy as np
raw = open(glob.glob(sys.argv[1] + "/*.ply")[0], "rb").read()
end = raw.index(b"end_header\n") + 11
names = [l.split()[2] for l in raw[:end].decode().splitlines() if l.startswith("property")]
logit = np.frombuffer(raw, "<f4", -1, end).reshape(-1, len(names))[:, names.index("opacity")]
assert 0 < (np.abs(logit - 1.5) < 1e-3).sum() < 30, np.unique(logit, return_counts=True)
' "$work/unseen" 2>"$work/err"
    ok $? "tracks that cameras of other frames see are faint too, only splats of one frame are not"
else
    skip "points that no camera sees" "no python3 with numpy"
fi
for precision in 'half 1e-3' 'compact 0.02'; do
    run "$bin/spin-retrain" "$in" -o "$work/own.spin" $small --iterations 6 --residual points --force --json \
        --threads 1 --precision ${precision% *}
    is "$code" 0 "retrains with points' values to add to"
    learned=$(sed -n '/"test": {/,/}/s/.*"psnr": \([0-9.]*\).*/\1/p' "$work/out")
    run "$bin/spin-eval" "$work/own.spin" --json
    awk -v a="$learned" -v b="$(member psnr)" -v most="${precision#* }" \
        'BEGIN { d = a - b; exit !(b != "" && d < most && d > -most) }'
    ok $? "and spin-eval adds them as well, ${precision% *} precision ($learned, $(member psnr))"
done
run "$bin/spin-retrain" "$in" -o "$work/own0.spin" $small --iterations 6 --residual points --lr-residual 0
if command -v python3 >/dev/null 2>&1; then
    python3 -c 'import sys, zipfile
a, b = (zipfile.ZipFile(f).read("trained/residual/00000.npy") for f in sys.argv[1:])
sys.exit(len(a) != len(b) or a == b)' "$work/own0.spin" "$work/own.spin"
    ok $? "these values are trained, and with --lr-residual 0 they stay"
else
    skip "these values are trained" "no python3"
fi
run "$bin/spin-retrain" "$in" -o "$work/own2.spin" $small --iterations 6 --residual points --threads 3
same_frames "$work/own.spin" "$work/own2.spin" "one thread and three give the same bits"

# Each option beyond the paper trains a different network and is recorded in the bundle; its default
# value changes nothing.
run "$bin/spin-retrain" "$in" -o "$work/as.spin" $small --iterations 3
run "$bin/spin-retrain" "$in" -o "$work/same.spin" $small --iterations 3 --dynamic-weight 1
cmp -s "$work/as.spin" "$work/same.spin"
ok $? "spelling out what stands without does nothing"
for more in '--dynamic-weight 4' '--antialias on'; do
    # shellcheck disable=SC2086
    run "$bin/spin-retrain" "$in" -o "$work/more.spin" $small --iterations 3 $more --force
    is "$code" 0 "retrains with $more"
    other_frames "$work/as.spin" "$work/more.spin" "$more: another network"
    # shellcheck disable=SC2086
    run "$bin/spin-retrain" "$in" -o "$work/more3.spin" $small --iterations 3 $more --force --threads 3
    same_frames "$work/more.spin" "$work/more3.spin" "$more: the same bits on three threads"
done
run "$bin/spin-retrain" "$in" -o "$work/anti.spin" $small --iterations 3 --antialias on --force --json
learned=$(sed -n '/"test": {/,/}/s/.*"psnr": \([0-9.]*\).*/\1/p' "$work/out")
run "$bin/spin-eval" "$work/anti.spin" --json
awk -v a="$learned" -v b="$(member psnr)" 'BEGIN { d = a - b; exit !(b != "" && d < 1e-3 && d > -1e-3) }'
ok $? "what was trained antialiased is measured so"

# stderr is not a terminal.
run "$bin/spin-retrain" "$in" -o "$work/lines.spin" $small --iterations 6 --eval-every 3
! grep -q '^retraining' "$work/err"
ok $? "a short run writes no line of progress"
run env SPIN_PROGRESS=1e-9 "$bin/spin-retrain" "$in" -o "$work/lines.spin" $small --iterations 6 --eval-every 3 --force
is "$(grep -c '^retraining  [1-6]/6  [0-9.]*%  [0-9.e+]* it/s  [0-9:]* left  loss [0-9.]*' "$work/err")" 6 \
    "SPIN_PROGRESS asks for more of them: done, rate, time left, loss"
is "$(grep -c '^retraining  [45]/6 .*loss [0-9.]*, test PSNR [0-9.]* dB$' "$work/err") $(grep -c '^retraining.*dB' "$work/err")" \
    "2 3" "and the PSNR, once it was measured"
! grep -q "$(printf '\033')" "$work/err"
ok $? "without the escapes of a terminal"
run env SPIN_PROGRESS=1e-9 "$bin/spin-retrain" "$in" -o "$work/lines.spin" $small --iterations 2 --quiet --force
is "$code $(grep -vc '^warning: ' "$work/err")" "0 0" "--quiet: none"

# The outermost cameras are held out for extrapolated views.
run "$bin/spin-import" fixtures/court-mini --data fixtures/court-mini -o "$work/mini.spin"
run "$bin/spin-retrain" "$work/mini.spin" -o "$work/outer.spin" --device cpu --iterations 2 --test-outer 2
is "$code" 0 "holds two outer cameras out"
err_has " 24 training and 24 test views" "four of the six training cameras are left"
run "$bin/spin-eval" "$work/outer.spin" --split outer --json --report "$work/outer.html"
is "$code $(member split)" "0 outer" "the outer views are measured"
[ "$(grep -c '^ *"camera": ' "$work/out")" -ge 12 ]
ok $? "those of both cameras in six frames"
grep -q '[0-9] outer test views of' "$work/outer.html"
ok $? "the report names the split"
run "$bin/spin-eval" "$work/mini.spin" --test-cams 3 --split outer
fails 1 spin-eval "camera 3 is between the others"
err_has "no held-out camera is outside the range of directions of the training cameras" "and is not measured as an outer one"
run "$bin/spin-retrain" "$work/mini.spin" -o "$work/few.spin" --device cpu --iterations 2 --test-outer 5
fails 2 spin-retrain "two cameras must be left"

# A warning if an export uses another background than the training.
run "$bin/spin-export" "$work/outer.spin" --to images --background white --range 0:1 -o "$work/over-white"
err_has "^warning: the splats were trained over a different background: --background 0,0,0 draws over that of the training\$" "images over white"
run "$bin/spin-export" "$work/outer.spin" --to images --background white --transparent --range 0:1 -o "$work/over-nothing"
! grep -q background "$work/err"
ok $? "not for images with alpha"
run "$bin/spin-export" "$work/outer.spin" --to ply --background white --range 0:1 -o "$work/no-images"
err_has "^warning: --background has no effect: this export renders no images\$" "nor for splats, which have none"

# peak: what the line about the best evaluation must say, computed from the evaluations that the
# last run printed
peak() {
    awk '/^iteration [0-9]*: test PSNR/ { last = $5; if ($5 > best) { best = $5; at = $2 + 0 } }
        END { if (best > last + 0.05) printf "%d %s", at, best }' "$work/err"
}
said_peak() { sed -n 's/^the test PSNR was highest at iteration \([0-9]*\), with \([0-9.]*\) dB.*/\1 \2/p' "$work/err"; }
run "$bin/spin-import" fixtures/4dgaussian/coarse_and_fine/model --data fixtures/datasets/blender_mini -o "$work/balls.spin"
run "$bin/spin-retrain" "$work/balls.spin" -o "$work/fast.spin" --device cpu --iterations 60 --eval-every 5 --lr-track 30
is "$(said_peak)" "$(peak)" "where the test views were best, if that was before the end"
run "$bin/spin-retrain" "$work/balls.spin" -o "$work/slow.spin" --device cpu --iterations 200 --eval-every 20 --lr-residual 30
is "$(said_peak)" "$(peak)" "nothing where they were best at the end"

# A preset sets defaults: options before it on the command line still override them.
run "$bin/spin-retrain" "$in" -o "$work/preset.spin" $small --iterations 2 --preset short
is "$code" 0 "retrains with a preset"
if command -v python3 >/dev/null 2>&1; then
    python3 -c 'import json, sys, zipfile
o = json.loads(zipfile.ZipFile(sys.argv[1]).read("meta.json"))["trained"]["options"]
sys.exit(not (o["iterations"] == 2 and o["hash_log2"] == 10 and o["residual"] == "points" and
              o["lr_table"] == 0.04 and o["views_per_frame"] == 3))' "$work/preset.spin"
    ok $? "its own options, and those given"
else
    skip "what a preset sets" "no python3"
fi
run "$bin/spin-retrain" "$in" -o "$work/x.spin" --preset long
fails 2 spin-retrain "no such preset"

run "$bin/spin-retrain" "$in" -o "$work/cuda.spin" $small --iterations 1 --device cuda
fails 1 spin-retrain "--device cuda in a build that has none"
err_has "no CUDA device" "--device cuda: says that it cannot"
nothing_at "$work/cuda" "nothing is written without the device"

run "$bin/spin-import" "$run_of" -o "$work/blind.spin"
run "$bin/spin-retrain" "$work/blind.spin" -o "$work/seeing.spin" $small --iterations 1
fails 2 spin-retrain "no data set"
run "$bin/spin-retrain" "$work/blind.spin" --data "$data" -o "$work/seeing.spin" $small --iterations 1
is "$code" 0 "takes a data set from --data"

done_testing
