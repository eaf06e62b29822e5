#!/bin/sh
# K: 4d tsog sogst export import
# 4D splats exported as TSOG and .sogst and imported again: within the quantisation of the
# container, in the layout that its players require.
. tests/cli/lib.sh

run_in=fixtures/realtime4dgs/rot4d_noshfs

# Upper bounds of the errors over all frames: Python expressions of "check" in a report.
within() { # NAME EXPRESSION
    python3 -c 'import json, sys
c = json.load(open(sys.argv[1]))["check"]
at = {k: v["largest"] for k, v in c.items() if isinstance(v, dict)}
sys.exit(0 if eval(sys.argv[2], at | {"check": c}) else print(at, {k: v["rms"] for k, v in c.items() if isinstance(v, dict)}) or 1)' "$work/out" "$2" >"$work/err"
    ok $? "$1"
}

# The archive: meta.json first, all members stored, no extra fields, and the stream offsets as
# declared.
laid_out() { # FILE NAME
    python3 - "$1" 2>"$work/err" <<'P'
import json, struct, sys, zipfile
data = open(sys.argv[1], 'rb').read()
z = zipfile.ZipFile(sys.argv[1])
all = z.infolist()
assert z.testzip() is None and all[0].filename == 'meta.json'
at = 0
for i in all:
    assert i.compress_type == 0 and not i.flag_bits & 8 and not i.extra and i.header_offset == at
    assert struct.unpack_from('<HH', data, at + 26) == (len(i.filename), 0)
    at += 30 + len(i.filename) + i.file_size
m = json.loads(z.read('meta.json'))
if 'streams' in m:
    s, end = m['streams'], {i.filename: i.header_offset + 30 + len(i.filename) + i.file_size for i in all}
    still = [n for n in end if 'shN' not in n and n != 'meta.json']
    assert s['geometry_bytes'] == max(end[n] for n in still)
    first = next((f for f in s['segments'] if f), s['persistent'])
    assert s['reveal_bytes'] == max(end[n] for n in still if n.startswith(first + '/'))
    p = m['segments']['persistent'][1]
    for one, name in zip(m['segments']['list'], s['segments']):
        assert one['range'][0] == p and (name is None) == (one['range'][1] == p)
        p = one['range'][1]
    assert p == m['count']
    names = [i.filename for i in all]
    sh = [k for k, n in enumerate(names) if 'shN' in n]
    assert sh == list(range(len(names) - len(sh), len(names)))
P
    ok $? "$2"
}

run "$bin/spin-import" "$run_in" --time-duration -0.5,4.5 -o "$work/r.spin"
is "$code" 0 "a run of Realtime-4DGS"
for to in tsog sogst; do
    run "$bin/spin-export" "$work/r.spin" -o "$work/r.$to" --fps 30 --check --json
    is "$code $(member to) $(member bytes)" "0 $to $(wc -c <"$work/r.$to")" "goes out as $to by its ending"
    python3 tests/cli/rounding.py "$work/out" "$work/err" log_scale rotation_deg colour sh
    ok $? "$to: and says how near"
    within "$to: as near as its steps" \
        'place < 1.5e-3 and log_scale < 0.02 and rotation_deg < 1 and opacity < 0.06 and colour < 0.01 and check["frames"] > 100'
    within "$to: and not nearer" 'min(place, log_scale, rotation_deg, opacity, colour) > 1e-6'
    laid_out "$work/r.$to" "$to: laid out as its players ask"
    run "$bin/spin-import" "$work/r.$to" -o "$work/$to.spin" --json
    is "$code $(member from) $(member frames)" "0 $to 151" "and comes back"
    run "$bin/spin-export" "$work/$to.spin" -o "$work/again.$to" --check --json
    is "$code" 0 "goes out again"
    within "$to: a second time little is lost" \
        'place < 2e-3 and log_scale < 0.01 and rotation_deg < 1 and opacity < 0.01 and colour < 0.01'
    run "$bin/spin-export" "$work/$to.spin" -o "$work/turned.$to" --rotate 180,0,0 --sh 1 --min-opacity 0.1 --check --json
    is "$code" 0 "$to: turned, with less SH and without what is faint"
    within "$to: and as near as that" 'place < 2e-3 and rotation_deg < 1 and opacity < 0.01'
    run "$bin/spin-export" "$work/r.spin" -o "$work/r.$to" --fps 30
    fails 1 spin-export "$to: a file that is there"
    run "$bin/spin-export" "$work/r.spin" -o "$work/one.$to" --range 3:4
    fails 1 spin-export "$to: one frame"
    nothing_at "$work/one.$to" "nothing was written"
done

# Times are relative to the exported part of the clip, and quantisation steps follow its length.
run "$bin/spin-import" "$run_in" --time-duration -0.5,4.5 --range 30:61 -o "$work/part.spin"
is "$code" 0 "a part of the clip"
run "$bin/spin-export" "$work/part.spin" -o "$work/part.tsog" --fps 30 --check --json
is "$code" 0 "goes out"
within "with the same steps" 'place < 2e-3 and opacity < 0.003 and check["frames"] == 31'
run "$bin/spin-import" "$work/part.tsog" --info
out_has "frames  *31," "as a clip of 31 frames"

# Splats that never fade, beside short-lived ones.
run "$bin/spin-import" fixtures/hybrid4dgs/small/model -o "$work/h.spin"
is "$code" 0 "a run of Hybrid 3D-4DGS"
for to in tsog sogst; do
    run "$bin/spin-export" "$work/h.spin" -o "$work/h.$to" --fps 30 --check --json
    is "$code" 0 "goes out as $to"
    within "$to: nothing fades that should not" 'opacity < 0.05 and place < 2e-3 and check["opacity"]["rms"] < 0.006'
done

# Curved paths.
run "$bin/spin-import" fixtures/sogst/no_segments/scene.sogst -o "$work/n.spin"
is "$code" 0 "a .sogst comes in"
run "$bin/spin-export" "$work/n.spin" -o "$work/n.sogst" --segment 0 --check --json
is "$code" 0 "and goes out in one piece"
laid_out "$work/n.sogst" "laid out so"
is "$(grep -c seg_000 "$work/n.sogst")" 0 "without segments"
# Long clips: a TSOG has no segments, and a .sogst at most 999, whose default length grows.
mkdir "$work/long"
"$bin/spin-export" "$work/n.spin" --range 0:1 -o "$work/one.ply" --force >"$work/out" 2>"$work/err"
for i in $(seq 1001); do ln "$work/one.ply" "$work/long/frame_$i.ply"; done
run "$bin/spin-import" "$work/long" -o "$work/long.spin"
run "$bin/spin-export" "$work/long.spin" --fps 1 -o "$work/long.tsog"
is "$code" 0 "1001 frames of a second go out as TSOG"
run "$bin/spin-import" "$run_in" --time-duration 0,1200 -o "$work/hour.spin"
run "$bin/spin-export" "$work/hour.spin" --fps 30 -o "$work/hour.sogst"
is "$code" 0 "1200 seconds go out as .sogst"
laid_out "$work/hour.sogst" "laid out so"
run "$bin/spin-export" "$work/hour.spin" -o "$work/hour.sogst" --fps 30 --force --segment 1
is "$code" 2 "but not in 1200 segments"
err_has "more than 999 segments" "as the error says"

# Paths of degree 2; every eighth splat is slow, centred long before the clip, and fades over fifty
# clip lengths.
{
    printf 'ply\nformat ascii 1.0\ncomment sogst.time_min 1\ncomment sogst.time_max 3\ncomment sogst.fps 30\n'
    echo 'element vertex 768'
    for p in x y z rot_0 rot_1 rot_2 rot_3 scale_0 scale_1 scale_2 opacity f_dc_0 f_dc_1 f_dc_2 vx vy vz t_center t_sigma \
        ax ay az; do
        echo "property float $p"
    done
    echo end_header
    awk 'BEGIN {
        for (i = 0; i < 768; i++) {
            long = i % 8 == 0
            print cos(i), sin(i), i / 400, 1, i % 3 / 3, 0.2, i % 5 / 5, -3 - i % 4, -3, -4, 1 + i % 3, i % 7 / 7, 0.1, 1, \
                cos(2 * i) * (long ? 0.01 : 1), sin(3 * i) * !long, i % 4 / 2 * !long, \
                long ? -150 : 0.9 + i * 0.618034 % 2.2, long ? 100 : 0.1 + i % 6 / 20, 0, -4.9 * !long, i % 2 / 2 * !long
        }
    }'
} >"$work/x.ply"
run "$bin/spin-import" "$work/x.ply" -o "$work/p.spin"
is "$code" 0 "the PLY of paths of degree 2 comes in"
run "$bin/spin-export" "$work/p.spin" -o "$work/p.sogst" --check --json
is "$code" 0 "and goes out"
within "as near as its steps" 'place < 6e-4 and log_scale < 0.02 and rotation_deg < 1 and opacity < 0.1'
run "$bin/spin-export" "$work/p.spin" -o "$work/slow.sogst" --fps 10 --check --json
is "$code" 0 "three times as slowly"
within "which is as near" 'place < 6e-4'
run "$bin/spin-export" "$work/p.spin" -o "$work/p.tsog" --check --json
is "$code" 0 "and as TSOG"
err_has "paths of degree 2: they are approximated by degree 1, with errors of up to" "whose straight paths are fitted"
within "where they are seen" 'check["place"]["rms"] < 1.2 and opacity < 0.01'

# Frames: each splat in its own frame only. A clip of 12 frames at 24 per second lasts half a
# second.
run "$bin/spin-import" "$run_in" --frames 12 -o "$work/frames.spin"
run "$bin/spin-export" "$work/frames.spin" -o "$work/frames.tsog" --fps 24 --check --json
is "$code" 0 "frames go out as TSOG"
within "each as near as its steps" \
    'place < 1.5e-3 and log_scale < 0.02 and rotation_deg < 1 and opacity < 0.002 and colour < 0.01 and check["frames"] == 12'
laid_out "$work/frames.tsog" "laid out as its player asks"
grep -aq '"timeline":{"type":0,"N":12,"delta":5461,.*"playback":{"duration":0.5,"fps":24,' "$work/frames.tsog"
ok $? "as frames for half a second"
run "$bin/spin-import" "$work/frames.tsog" -o "$work/frames-back.spin" --json
is "$code $(member from) $(member frames)" "0 tsog 12" "and come back"
out_has '"splats_4d": null' "as frames"
python3 - "$work/frames.spin" "$work/frames-back.spin" <<'P'
import sys
sys.path.insert(0, "exporters/python")
import numpy as np, spin4d
a, b = map(spin4d.load, sys.argv[1:])
for f in range(len(a)):
    for x, y in zip(a.frame(f), b.frame(f)):  # rows are in another order
        x, y = (np.reshape(v, (len(v), -1)) for v in (x, y))
        x, y = x.T @ x / len(x), y.T @ y / len(y)
        assert np.abs(x - y).max() <= 0.02 * np.abs(x).max(), f
P
ok $? "with the same splats"
for bundle in frames frames-back; do
    "$bin/spin-import" --info "$work/$bundle.spin" | grep '^splats' >"$work/$bundle.count"
done
cmp -s "$work/frames.count" "$work/frames-back.count"
ok $? "of as many splats each"
run "$bin/spin-export" "$work/frames.spin" -o "$work/some.tsog" --range 2:11:4 --min-opacity 0.2 --rotate 180,0,0 --check --json
is "$code" 0 "some of them, turned, without what is faint"
within "as near" 'place < 1.5e-3 and rotation_deg < 1 and opacity < 0.002 and check["frames"] == 3'
run "$bin/spin-export" "$work/frames.spin" -o "$work/one.tsog" --range 2:3
fails 1 spin-export "one frame is no clip"
err_has "needs a clip of two or more frames" "and says so"
nothing_at "$work/one.tsog" "nothing was written"

# The splats of all frames are one list, but less than 40 bytes of each are in memory, nearly all of
# them in the encoder of WebP.
case ${SPIN_BUILD:-} in
*asan* | *tsan*) skip "memory of a clip of frames" "sanitisers reserve more memory than ulimit -d allows" ;;
*)
    run "$SPIN_BUILD/tests/bench/clip" "$work/balls" 120 4000 0 1
    run "$bin/spin-import" "$work/balls" -o "$work/balls.spin"
    mkdir "$work/small"
    (ulimit -d $((16384 + 120 * 4000 * 64 / 1024)) && run "$bin/spin-export" "$work/balls.spin" --fps 30 --threads 1 \
        -o "$work/small/balls.tsog" && exit "$code")
    is $? 0 "480,000 splats in 120 frames need less than 64 bytes each"
    is "$(ls -A "$work/small")" balls.tsog "and leave no temporary file"
    run "$bin/spin-export" "$work/balls.spin" --fps 30 --check --json -o "$work/balls.tsog"
    is "$(grep -c "without any splat" "$work/err")" 0 "no frame is empty"
    within "and come back" 'place < 1.5e-3 and opacity < 0.002 and check["splats"] == 480000'
    greater 420000 "$(wc -c <"$work/balls.tsog")"
    ok $? "in Morton order: static splats are neighbours, so the file is small"
    cmp -s "$work/balls.tsog" "$work/small/balls.tsog"
    ok $? "the same with any number of threads"
    ;;
esac

# What the format cannot store is reported.
run "$bin/spin-export" "$work/frames.spin" -o "$work/frames.sogst"
fails 1 spin-export "frames are no 4D splats"
err_has "'sogst' stores 4D splats, but this clip has frames" "by their name"
nothing_at "$work/frames.sogst" "nothing was written"
run "$bin/spin-import" "$fixtures/realtime4dgs/rot4d_sht" -o "$work/sht.spin"
if [ "$code" = 0 ]; then
    run "$bin/spin-export" "$work/sht.spin" -o "$work/sht.tsog" --fps 30 --check --json
    is "$code" 0 "colours in time"
    err_has "cannot represent colours that change: .* an error of up to 0.1 on a scale" "are frozen, and how much that is"
    within "geometry and opacity are not touched" 'place < 5e-4 and opacity < 0.0025 and check["colour"]["rms"] < 0.025'
else
    skip "colours in time" "no such fixture"
fi
# A check reads the file back after the memory of encoding is free: it adds 41 bytes for each of the
# 200,000 splats to the peak of the export, instead of 75.
case ${SPIN_BUILD:-} in
*asan* | *tsan* | *cov*) skip "the memory of a check" "sanitisers need memory of their own" ;;
*)
    python3 - "$work/many.ftgs.ply" <<'P'
import random, struct, sys
random.seed(4)
names = ('x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 '
         'time log_duration velocity_0 velocity_1 velocity_2').split()
head = ('ply\nformat binary_little_endian 1.0\ncomment ftgs_version 1\ncomment time_units normalized\ncomment sh_degree 0\n'
        'comment use_velocity 1\ncomment min_duration 0.02\ncomment opacity_floor 0.0001\ncomment n_frames 2\n'
        'element vertex 200000\n' + ''.join('property float %s\n' % n for n in names) + 'end_header\n')
def row():
    r = random.uniform
    return [r(-3, 3) for _ in range(6)] + [2] + [r(-5, -3) for _ in range(3)] + [r(.1, 1) for _ in range(4)] + \
        [r(0, 1), -1.6] + [r(-1, 1) for _ in range(3)]
with open(sys.argv[1], 'wb') as out:
    out.write(head.encode() + b''.join(struct.pack('<19f', *row()) for _ in range(2000)) * 100)
P
    run "$bin/spin-import" "$work/many.ftgs.ply" -o "$work/many.spin" -q
    is "$code" 0 "200,000 splats"
    python3 - "$bin/spin-export" "$work" 2>"$work/err" <<'P'
import os, sys
def peak(*more):
    argv = [sys.argv[1], '-q', sys.argv[2] + '/many.spin', '-o', sys.argv[2] + '/many.tsog', '--force', '--threads', '1', *more]
    _, status, used = os.wait4(os.spawnv(os.P_NOWAIT, argv[0], argv), 0)
    assert status == 0
    return used.ru_maxrss * 1024
plain, checked = peak(), peak('--check')
print((checked - plain) / 200000, 'bytes a splat', plain, checked, file=sys.stderr)
assert checked - plain < 58 * 200000
P
    ok $? "a check adds less than 58 bytes for each splat to the peak of the memory"
    sed 's/^/# /' "$work/err"
    ;;
esac
done_testing
