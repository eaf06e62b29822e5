#!/bin/sh
# K: export decimate 4d tsog sogst html
# --decimate drops the frames' splats, or 4D splats, that contribute least to the training views,
# down to a number, a share, a file size or a loss, in every kind of format; the loss is reported.
. tests/cli/lib.sh

# A value of the last report: a Python expression of d, "decimated", and r, the whole report.
of() {
    python3 -c 'import json, sys
r = json.load(open(sys.argv[1])); d = r["decimated"]; print(eval(sys.argv[2]))' "$work/out" "$1"
}
all_bytes() { find "$1" -type f -exec cat {} + | wc -c; }

run "$bin/spin-import" "$clip/params.npz" --data "$clip" -o "$work/c.spin"
is "$code" 0 "court-mini comes in, with its cameras"
run "$bin/spin-export" "$work/c.spin" --to ply -o "$work/p" --decimate 1000 --json
is "$code $(of 'r["splats_mean"], d["after"], d["unit"], d["by"], d["cameras"]')" \
    "0 (1000, 1000, 'a frame', 'their contribution to the images', 'training cameras')" "1000 splats a frame"
is "$(grep -ac 'element vertex 1000$' "$work"/p/frame_*.ply | grep -vc ':0$')" 6 "in each of six files"
many=$(of 'd["psnr"]')
grep -q '"identity": true' "$work/p/sequence.json"
ok $? "the same ones in each"
"$bin/spin-retrain" "$work/c.spin" -o "$work/refined.spin" --method frames --refine 1 --scale 0.25 -q 2>"$work/err"
run "$bin/spin-export" "$work/refined.spin" --source --to ply -o "$work/r-p" --decimate 1000
grep -q '"identity": false' "$work/r-p/sequence.json"
ok $? "beside refined frames others in each, and sequence.json says so"
run "$bin/spin-import" "$work/p" --info
out_has "1000 a frame" "which come in again"
run "$bin/spin-export" "$work/c.spin" --to spz -o "$work/s" --decimate 25%
is "$code" 0 "a quarter of them"
out_has "^decimated: .* splats a frame, by their contribution to the images; [0-9]* splats merged into these; [0-9.]* dB against all splats in 16 images" \
    "and what that loses is said"
run "$bin/spin-export" "$work/c.spin" --to ply -o "$work/q" --decimate 500 --json
is "$(of "d['psnr'] < $many")" True "half as many lose more"
run "$bin/spin-export" "$work/c.spin" -o "$work/page.html" --decimate 80kB --json
is "$code $(of 'd["reached"] <= 80000 and d["tries"] > 1')" "0 True" "a page of 80 kB"
[ "$(wc -c <"$work/page.html")" -le 80000 ] && [ "$(wc -c <"$work/page.html")" -gt 74000 ]
ok $? "is at most that large, and nearly"
run "$bin/spin-export" "$work/c.spin" -o "$work/small.html" --decimate 73kB --json
is "$code $(of 'd["reached"] > 69000 and d["after"] > 250')" "0 True" "so is one of 73 kB, most of which is no splats"
run "$bin/spin-export" "$work/c.spin" --to sog -o "$work/sog" --decimate 100kB --check --json
grep -q '"check": {' "$work/out" && [ "$code" = 0 ] && [ "$(all_bytes "$work/sog")" -le 100000 ] && [ "$(all_bytes "$work/sog")" -gt 90000 ]
ok $? "a folder counts with all its files, and is checked"
run "$bin/spin-export" "$work/c.spin" --to images -o "$work/i" --decimate 50% --range 0:1 --json
is "$code $(of 'd["psnr"] > 20')" "0 True" "pictures of half of them"
run "$bin/spin-export" "$work/c.spin" -o "$work/no.glb" --decimate 1kB
fails 1 spin-export "a size that nothing has"
nothing_at "$work/no.glb" "nothing was written"
is "$(find "$work" -name '*.tmp.*' | wc -l)" 0 "and no try is left"
for how in 0 -1 1.5 200% 3PB ''; do
    run "$bin/spin-export" "$work/c.spin" --to ply -o "$work/no" --decimate "$how"
    fails 2 spin-export "--decimate '$how'"
done
run "$bin/spin-export" "$work/c.spin" -o "$work/page.html" --decimate 50%
fails 1 spin-export "what is in the way is said"

# Without cameras, splats are ranked by opacity and size; cameras rank them better.
run "$bin/spin-import" "$clip/params.npz" -o "$work/blind.spin"
run "$bin/spin-export" "$work/blind.spin" --to ply -o "$work/b" --decimate 500 --json
is "$code $(of 'd["by"], d["cameras"]')" "0 ('opacity and size', 'all around')" "without cameras"
run "$bin/spin-import" "$work/b" --data "$clip" --pair order -o "$work/b.spin"
run "$bin/spin-import" "$work/q" -o "$work/q.spin"
for name in b q; do
    run "$bin/spin-eval" "$work/$name.spin" --split train --json
    eval "$name=\$(member psnr)"
done
# shellcheck disable=SC2154
awk "BEGIN { exit !($q > $b + 0.05) }"
ok $? "500 that cameras see show the pictures better: $q, $b dB"

# All training cameras of a frame are used, and splats outside all of their images are ranked too: a
# viewer that looks from elsewhere would miss them. Camera 7 is one of twelve, or the only one.
for n in 12 1; do
    mkdir "$work/rig$n"
    python3 - "$clip" "$work/rig$n" $n 2>"$work/err" <<'P'
import json, os, sys
source, to, n = os.path.abspath(sys.argv[1]), sys.argv[2], int(sys.argv[3])
os.symlink(source + '/ims', to + '/ims')
for name in 'train_meta.json', 'test_meta.json':
    m = json.load(open(source + '/' + name))
    if name[1] == 'r':
        at = [m['cam_id'][0].index(7 if i == 2 or n == 1 else 23) for i in range(n)]
        for key in 'fn', 'k', 'w2c', 'cam_id':
            m[key] = [[row[i] for i in at] for row in m[key]]
        m['cam_id'] = [[100 + i for i in range(n)] for row in m['cam_id']]
    json.dump(m, open(to + '/' + name, 'w'))
P
    run "$bin/spin-export" "$work/c.spin" --data "$work/rig$n" --to ply -o "$work/rig$n/ply" --range 0:1 --decimate 50%
    is "$code" 0 "half, by $n cameras"
done
run "$bin/spin-export" "$work/c.spin" --to ply -o "$work/whole" --range 0:1
python3 - "$clip/train_meta.json" "$work" 2>"$work/err" <<'P'
import glob, json, sys
import numpy as np

def means(folder):
    head, data = open(glob.glob(folder + '/*.ply')[0], 'rb').read().split(b'end_header\n', 1)
    n = int(head.split(b'element vertex ')[1].split()[0])
    return np.frombuffer(data, '<f4').reshape(n, -1)[:, :3]

def seen(camera, p):
    m = json.load(open(sys.argv[1]))
    i = m['cam_id'][0].index(camera)
    q = p @ np.array(m['w2c'][0][i])[:3, :3].T + np.array(m['w2c'][0][i])[:3, 3]
    u = q @ np.array(m['k'][0][i]).T
    u = u[:, :2] / u[:, 2:]
    return (q[:, 2] > 0) & (u >= 0).all(1) & (u[:, 0] < m['w']) & (u[:, 1] < m['h'])

for name, chosen in ('rig12', lambda p: seen(7, p) & ~seen(23, p)), ('rig1', lambda p: ~seen(7, p)):
    before, after = (chosen(means(sys.argv[2] + folder)).sum() for folder in ('/whole', '/' + name + '/ply'))
    print(name, before, after, file=sys.stderr)
    assert before > 100 and after > 0.3 * before
P
ok $? "splats that one of twelve sees are kept, and so are those that the only one does not"

# 4D splats: rows of the file; frames of it are decimated one by one.
run "$bin/spin-import" fixtures/realtime4dgs/rot4d_noshfs --time-duration -0.5,4.5 -o "$work/r.spin"
is "$code" 0 "a run of Realtime-4DGS"
for to in tsog sogst ftgs.ply; do
    run "$bin/spin-export" "$work/r.spin" -o "$work/r.$to" --decimate 100 --json
    is "$code $(of 'd["after"], d["unit"], d["by"], d["cameras"]')" "0 (100, 'in all', 'opacity and size', 'all around')" \
        "$to: 100 4D splats, without cameras"
    run "$bin/spin-import" "$work/r.$to" --info
    out_has " 100 splats\| 100 Gaussians\|, 100 " "as many are in the file"
done
run "$bin/spin-export" "$work/r.spin" -o "$work/half.tsog" --fps 30 --decimate 50% --check
is "$code" 0 "they are what was written"
run "$bin/spin-export" "$work/r.spin" --to ply -o "$work/all" --range 0:150:10
run "$bin/spin-export" "$work/r.spin" --to ply -o "$work/f" --range 0:150:10 --decimate 60
is "$code" 0 "frames of them"
python3 - "$work/all" "$work/f" 2>"$work/err" <<'P'
import glob, sys
import numpy as np

# The rows of each frame, identified by their scales, which do not change.
def frames(folder):
    for name in sorted(glob.glob(folder + '/*.ply')):
        head, data = open(name, 'rb').read().split(b'end_header\n', 1)
        n = int(head.split(b'element vertex ')[1].split()[0])
        names = [l.split()[2].decode() for l in head.splitlines() if l.startswith(b'property')]
        rows = np.frombuffer(data, '<f4').reshape(n, -1)
        yield {tuple(r) for r in rows[:, [names.index('scale_%d' % k) for k in range(3)]]}

all, kept = list(frames(sys.argv[1])), list(frames(sys.argv[2]))
ever = set.union(*kept)
assert max(map(len, all)) > 60 and 40 < max(map(len, kept)) <= 60, list(map(len, kept))
for a, k in zip(all, kept):
    assert k & a == a & ever, (len(a), len(k), len(a & ever))
merged = {len(k - a) for a, k in zip(all, kept)}
assert len(merged) == 1 and 0 < merged.pop() < 30, [len(k - a) for a, k in zip(all, kept)]
P
ok $? "have at most 60 each, a splat that is kept in all that its time shows, and the merged ones in all"
# Of each chosen pair of tracks, one has two rows in a frame and the other none: neither is merged.
# All pairs are chosen, or one of eight.
run "$bin/spin-retrain" "$work/c.spin" -o "$work/t.spin" --iterations 3 --precision full -q
is "$code" 0 "tracks"
for each in 1 8; do
    python3 - "$work/t.spin" "$work/two$each.spin" $each 2>"$work/err" <<'P'
import io, json, sys, zipfile
import numpy as np

old = zipfile.ZipFile(sys.argv[1])
meta = json.loads(old.read('meta.json'))
tracks, name = meta['trained']['tracks'], 'trained/track/%05d.npy'
planes = np.load(io.BytesIO(old.read(name % 0))).view('u1')
track = sum(p.astype('<u4') << 8 * k for k, p in enumerate(planes))
assert tracks['same_rows'] and (np.sort(track) == np.arange(tracks['n'])).all()
tracks['same_rows'] = False
meta.get('xor_rows', {}).pop('trained/track', None)
row = np.argsort(track)
# Both tracks of a pair have rows in the same arrays.
ends = [0, tracks['moving'], tracks['varying'], tracks['n']]
first = np.concatenate([np.arange(a, b - 1, 2) for a, b in zip(ends, ends[1:])])[::int(sys.argv[3])]
with zipfile.ZipFile(sys.argv[2], 'w', zipfile.ZIP_DEFLATED) as new:
    for member in old.namelist():
        if member not in ('meta.json', name % 0):
            new.writestr(member, old.read(member))
    for f in range(len(meta['trained']['splats'])):
        mine, at = track.copy(), io.BytesIO()
        mine[row[first + 1 - f % 2]] = first + f % 2
        np.save(at, mine)
        new.writestr(name % f, at.getvalue())
    new.writestr('meta.json', json.dumps(meta))
P
    ok $? "two rows of a track in a frame, one pair of $each"
    for range in 0:2 0:3; do
        run "$bin/spin-export" "$work/two$each.spin" --to ply -o "$work/two" --range $range --decimate 60% --force --json
        is "$code $(of 'd["after"] <= 0.6 * d["before"], d["after"] > 0.59 * d["before"]')" "0 (True, True)" "range $range is decimated"
        is "$(of '(d["merged"] > 0, r["frames"])')" "($([ $each = 8 ] && echo True || echo False), ${range#0:})" "by merging the other tracks only"
    done
done
done_testing
