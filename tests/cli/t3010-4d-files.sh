#!/bin/sh
# K: 4d ftgs sogst export import freetimegs
# 4D splats exported as files of 4D splats and imported again: the result equals the input, and what
# a file cannot store is reported.
. tests/cli/lib.sh
. tests/runs.sh

run_in=fixtures/realtime4dgs/rot4d_noshfs
ftgs=fixtures/ftgs_ply/sh1_clamped/scene.ftgs.ply

# Compares the frames of two bundles: the same splats in the same order, up to rounding. Times of
# the second are TO times those of the first.
same_frames() { # BUNDLE BUNDLE NAME
    if ! python3 -c 'import numpy' 2>/dev/null; then
        skip "$3" "no python3 with numpy"
        return
    fi
    PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=exporters/python python3 - "$1" "$2" 2>"$work/err" <<'P'
import sys
import numpy as np
import spin4d
a, b = (spin4d.load(p) for p in sys.argv[1:3])
assert len(a) == len(b) and a.splats_4d["n"] >= b.splats_4d["n"]
for i in range(0, len(a), max(1, len(a) // 7)):
    x, y = a.frame(i), b.frame(i)
    # a splat at the threshold of visibility may be visible in only one of them
    assert abs(len(x.means) - len(y.means)) <= 1, (i, len(x.means), len(y.means))
    if len(x.means) == len(y.means):
        turn = np.sign((x.quats * y.quats).sum(1, keepdims=True))
        assert np.allclose(x.quats, y.quats * turn, rtol=2e-5, atol=2e-5), (i, "quats")
        for name in set(x._fields) - {"quats"}:
            assert np.allclose(getattr(x, name), getattr(y, name), rtol=2e-5, atol=2e-5), (i, name)
P
    ok $? "$3"
}

run "$bin/spin-import" "$ftgs" -o "$work/a.spin"
is "$code" 0 "a .ftgs.ply comes in"
run "$bin/spin-export" "$work/a.spin" -o "$work/a.ftgs.ply" --json
is "$code $(member to) $(member bytes)" "0 ftgs $(wc -c <"$work/a.ftgs.ply")" "goes out by its ending"
run "$bin/spin-import" "$work/a.ftgs.ply" -o "$work/b.spin" --json
is "$code $(member from) $(member frames)" "0 freetimegs 181" "and comes back"
same_frames "$work/a.spin" "$work/b.spin" "as what it was"
# Splats rotated by arbitrary angles are read back unchanged in every frame.
for turn in 0,0,0 90,30,0; do
    run "$bin/spin-export" "$work/a.spin" -o "$work/turned-$turn.ftgs.ply" --rotate "$turn" --check --json
    is "$code $(python3 -c 'import json, sys
c = json.load(sys.stdin)["check"]
print(c["frames"], all(c[k]["largest"] < 2e-4 for k in c if isinstance(c[k], dict)))' <"$work/out")" "0 181 True" \
        "turned by $turn it is read back as it is"
done
# The flag for antialiased splats.
is_antialiased() {
    python3 -c 'import json, sys, zipfile
print(json.load(zipfile.ZipFile(sys.argv[1]).open("meta.json")).get("antialias", False))' "$1"
}
LC_ALL=C sed '0,/^comment ftgs_version/s//comment antialiased 1\n&/' "$ftgs" >"$work/anti.ftgs.ply"
run "$bin/spin-import" "$work/anti.ftgs.ply" -o "$work/anti.spin"
is "$(is_antialiased "$work/a.spin") $(is_antialiased "$work/anti.spin")" "False True" "antialiased, as a comment says"
for ending in ftgs.ply sogst.ply tsog sogst; do
    run "$bin/spin-export" "$work/anti.spin" -o "$work/anti-out.$ending" --force --fps 30
    [ $ending != ftgs.ply ] || run "$bin/spin-export" "$work/anti.spin" -o "$work/anti-out.$ending" --force
    run "$bin/spin-import" "$work/anti-out.$ending" -o "$work/anti-back.spin" --force
    is "$(is_antialiased "$work/anti-back.spin")" True "antialiased: .$ending says so"
done
run "$bin/spin-import" "$ftgs" -o "$work/part.spin" --range 60:121
is "$code" 0 "a part of the clip comes in"
run "$bin/spin-export" "$work/part.spin" -o "$work/part.ftgs.ply"
is "$code" 0 "goes out"
run "$bin/spin-import" "$work/part.ftgs.ply" -o "$work/part-back.spin" --json
is "$code $(member frames)" "0 61" "and comes back as a clip of its own"
same_frames "$work/part.spin" "$work/part-back.spin" "of the same frames at other times"
run "$bin/spin-export" "$work/a.spin" --range 0:60:3 -o "$work/third.ftgs.ply"
run "$bin/spin-import" "$work/third.ftgs.ply" -o "$work/third.spin"
! grep -q "frame rate" "$work/out"
ok $? "a frame rate that was written is not guessed"
run "$bin/spin-export" "$work/third.spin" -o "$work/third.sogst.ply"
grep -aq '^comment sogst.fps 10$' "$work/third.sogst.ply"
ok $? "every third of 30 frames a second are 10, there and back"
# Times are rounded to one of 256 values: the effect on opacities is reported, and equals what is
# read back.
run "$bin/spin-export" "$work/a.spin" -o "$work/a.sogst" --check --json
said=$(sed -n 's/.*rounds times: .* is off by up to \(.*\)$/\1/p' "$work/err")
python3 -c 'import json, sys
found = json.load(sys.stdin)["check"]["opacity"]["largest"]
sys.exit(not (0.01 < found and 0.8 < float(sys.argv[1] or 0) / found < 1.4))' "$said" <"$work/out"
ok $? "what rounded times cost is said: ${said:-nothing}"
run "$bin/spin-export" "$work/a.spin" -o "$work/a.tsog"
! grep -q "rounds times" "$work/err"
ok $? "16 bits of a time cost nothing"
run "$bin/spin-export" "$work/a.spin" -o "$work/a.ftgs.ply"
fails 1 spin-export "a file that is there"

run "$bin/spin-import" fixtures/freetimegs/still_sh0_no_optimizers --n-frames 12 -o "$work/twelve.spin" --json
is "$code $(member frames)" "0 12" "as many frames as are asked for"
run "$bin/spin-import" fixtures/freetimegs/still_sh0_no_optimizers --n-frames 0 -o "$work/none.spin"
fails 2 spin-import "no frames"
run "$bin/spin-import" fixtures/hostile/freetimegs/frames.ply -o "$work/many.spin" --json
is "$code $(member frames)" "0 65536" "of a million frames so many are taken"
out_has "has 1000000 frames, of which 65536 are sampled" "and that is said"

# The PLY for .sogst: paths of degree 2, a factor on covariances, and SH of degree 1 padded with
# zeros to degree 3.
python3 - "$work/curved.ply" <<'P'
import math, struct, sys
names = ("x y z rot_0 rot_1 rot_2 rot_3 scale_0 scale_1 scale_2 opacity f_dc_0 f_dc_1 f_dc_2 vx vy vz t_center t_sigma "
         + " ".join("f_rest_%d" % k for k in range(9)) + " ax ay az").split()
with open(sys.argv[1], "wb") as f:
    f.write(("ply\nformat binary_little_endian 1.0\ncomment sogst.time_min 1\ncomment sogst.time_max 3\n"
             "comment sogst.fps 30\ncomment sogst.cov2d_scale 1.5 0.5\nelement vertex 200\n"
             + "".join("property float %s\n" % n for n in names) + "end_header\n").encode())
    for i in range(200):
        f.write(struct.pack("<31f", *([math.cos(i), math.sin(i), i / 50, 1, i % 3 / 3, 0.2, i % 5 / 5, -3 - i % 4, -3, -4,
            1 + i % 3, i % 7 / 7, 0.1, 1, math.cos(2 * i), math.sin(3 * i), i % 4 / 2, 0.9 + i * 0.618 % 2.2, 0.1 + i % 6 / 20]
            + [math.sin(i * 9 + k) / 4 for k in range(9)] + [0.5, -4.9, i % 2 / 2])))
P
# Every frame that is compared equals what was written.
as_written() { # NAME
    is "$code $(python3 -c 'import json, sys
c = json.load(sys.stdin)["check"]
print(c["frames"], all(c[k]["largest"] < 2e-4 for k in c if isinstance(c[k], dict)))' <"$work/out")" "0 61 True" "$1"
}
has_line() { # FILE LINE TIMES
    is "$(sed '/^end_header/q' "$1" | LC_ALL=C grep -ac "^$2")" "$3" "$(basename "$1"): $3 lines $2"
}
run "$bin/spin-import" "$work/curved.ply" -o "$work/curved.spin" --json
is "$code $(member from) $(member frames)" "0 sogst 61" "the PLY for .sogst comes in"
run "$bin/spin-export" "$work/curved.spin" -o "$work/curved.sogst.ply" --check --json
is "$(member to) $(member bytes)" "sogst-ply $(wc -c <"$work/curved.sogst.ply")" "goes out by its ending"
as_written "and is read back as it is"
for line in 'time_min 0$' 'time_max 2$' 'fps 30$' 'motion_degree 2$' 'cov2d_scale 1.5 0.5$'; do
    has_line "$work/curved.sogst.ply" "comment sogst.$line" 1
done
has_line "$work/curved.sogst.ply" "property float f_rest_" 45
run "$bin/spin-import" "$work/curved.sogst.ply" -o "$work/curved-back.spin" --json
is "$code $(member from) $(member frames)" "0 sogst 61" "and comes back"
out_has "scaled by 1.5 and 0.5" "with its factor on covariances"
run "$bin/spin-export" "$work/curved.spin" -o "$work/turned.sogst.ply" --rotate 90,30,0 --sh 0 --fps 15 --check --json
as_written "turned, half as fast, it is read back as it is"
has_line "$work/turned.sogst.ply" "property float f_rest_" 0
has_line "$work/turned.sogst.ply" 'comment sogst.time_max 4$' 1

# Every tenth frame: the frame rate is a tenth, and frames keep their original numbers.
run "$bin/spin-export" "$work/a.spin" --to ply -o "$work/tenth" --range 0:181:10
is "$code $(sed -n 's/ *"fps": \([0-9.]*\),/\1/p' "$work/tenth/sequence.json")" "0 3" "30 frames a second, every tenth is 3"
run "$bin/spin-import" "$work/tenth" -o "$work/tenth.spin"
run "$bin/spin-export" "$work/tenth.spin" --to ply -o "$work/twentieth" --range 0:181:20
is "$code $(sed -n 's/ *"fps": \([0-9.]*\),/\1/p' "$work/twentieth/sequence.json")" "0 1.5" "and every other of these 1.5"

# Times of Realtime-4DGS have another unit.
run "$bin/spin-import" "$run_in" --time-duration -0.5,4.5 -o "$work/r.spin"
is "$code" 0 "a run of Realtime-4DGS"
run "$bin/spin-export" "$work/r.spin" --to ftgs -o "$work/r.ftgs.ply"
is "$code" 0 "goes out"
run "$bin/spin-import" "$work/r.ftgs.ply" -o "$work/rb.spin"
is "$code" 0 "and comes back"
for bundle in r rb; do
    "$bin/spin-export" "$work/$bundle.spin" --to ply -o "$work/$bundle" -q
done
is "$(ls "$work/rb" | wc -l)" "$(ls "$work/r" | wc -l)" "with as many frames"
run "$bin/spin-export" --json "$work/r.spin" --to ply -o "$work/r2" --range 0:150:50
mean=$(member splats_mean)
run "$bin/spin-export" --json "$work/rb.spin" --to ply -o "$work/rb2" --range 0:150:50
greater "$(member splats_mean)" "$(echo "$mean" | awk '{ print $1 * 0.999 }')"
ok $? "that show as many splats, and those too that the method itself hides"
greater "$(echo "$mean" | awk '{ print $1 * 1.2 }')" "$(member splats_mean)"
ok $? "which are few"

# The error of positions in pixels, where cameras of the data set see the splats.
stand_in "$work/data" "$clip/ims/0/000008.jpg"
cameras "$work/data" 7 5
run "$bin/spin-import" "$run_in" --time-duration 0,5 --data "$work/data" --data-from transforms:ending=.jpg \
    -o "$work/seen.spin"
is "$code" 0 "a run with the cameras of a data set"
run "$bin/spin-export" "$work/seen.spin" -o "$work/seen.ftgs.ply" --check
out_has "of the splat's size at most, .* pixels of the data set's cameras" "--check: in sizes and in pixels"
run "$bin/spin-export" "$work/r.spin" -o "$work/unseen.ftgs.ply" --check --json
out_has '"place_pixels": null' "--check: no pixels without a data set"

# What the format cannot store.
run "$bin/spin-import" "$run_in" --frames 3 -o "$work/frames.spin"
run "$bin/spin-export" "$work/frames.spin" -o "$work/frames.ftgs.ply"
fails 1 spin-export "frames"
err_has "'ftgs' stores 4D splats, but this clip has frames" "are refused by their name"
nothing_at "$work/frames.ftgs" "nothing was written"
run "$bin/spin-import" "$run_in" --range 0:1 -o "$work/one.spin"
run "$bin/spin-export" "$work/one.spin" -o "$work/one.ftgs.ply"
fails 1 spin-export "one frame"
err_has "needs a clip of two or more frames" "has no length"
nothing_at "$work/one.ftgs" "nothing was written"
if [ -d "$fixtures/realtime4dgs/rot4d_sht" ]; then
    "$bin/spin-import" "$fixtures/realtime4dgs/rot4d_sht" -o "$work/sht.spin" -q
    run "$bin/spin-export" "$work/sht.spin" -o "$work/sht.ftgs.ply"
    is "$code" 0 "colours in time"
    err_has "cannot represent colours that change" "are frozen with a warning"
fi
# 4D splats with fewer bits.
for how in full half compact; do
    run "$bin/spin-import" fixtures/realtime4dgs/rot4d_noshfs --time-duration -0.5,4.5 --precision $how -o "$work/$how.spin"
    is "$code" 0 "4D splats, --precision $how"
    run "$bin/spin-export" "$work/$how.spin" --to splat -o "$work/$how"
    is "$code" 0 "every frame has as many as were counted"
    run "$bin/spin-import" fixtures/ftgs_ply/sh1_clamped/scene.ftgs.ply --precision $how -o "$work/clamped-$how.spin"
    run "$bin/spin-export" "$work/clamped-$how.spin" --to splat -o "$work/clamped-$how"
    is "$code" 0 "also where rounding makes some invisible"
done
full=$(wc -c <"$work/full.spin") half=$(wc -c <"$work/half.spin") compact=$(wc -c <"$work/compact.spin")
[ "$half" -lt $((full * 3 / 4)) ] && [ "$compact" -lt "$half" ]
ok $? "of $full bytes $half and $compact are left"
for what in "fixtures/realtime4dgs/rot4d_noshfs --frames 3" "$clip/params.npz" "fixtures/realtime4dgs/rot4d_noshfs --positions-only"; do
    # shellcheck disable=SC2086
    run "$bin/spin-import" $what --precision half -o "$work/no.spin"
    fails 2 spin-import "what keeps no 4D splats: $what"
    nothing_at "$work/no.spin" "nothing was written"
done
done_testing
