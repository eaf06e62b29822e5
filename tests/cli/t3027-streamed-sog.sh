#!/bin/sh
# K: sog export lod levels streamed
# Streamed SOG: static splats at several levels of detail, and one SOG per frame with the others.
. tests/cli/lib.sh

# A wall of 21,000 static splats before which 50 move, in three frames whose rows have different
# orders.
python3 - "$work/frames" <<'EOP'
import os, random, struct, sys
random.seed(5)
os.makedirs(sys.argv[1])
names = 'x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3'.split()
def splat(x, y, z, c, size):
    return [x, y, z, c, -c, 0.5, 1.5, size, size, size - 2, 1, 0.1, 0.2, 0]
wall = [splat(i % 150 / 10, i // 150 / 10, random.gauss(0, 0.01), (i // 700 % 5 - 2) / 3, -3) for i in range(21000)]
for f in range(3):
    rows = wall + [splat(7 + f, 7, 1 + k / 50, 1, -4) for k in range(50)]
    random.shuffle(rows)
    with open('%s/frame_%05d.ply' % (sys.argv[1], f + 4), 'wb') as out:
        out.write(('ply\nformat binary_little_endian 1.0\nelement vertex %d\n' % len(rows)).encode())
        out.write(''.join('property float %s\n' % n for n in names).encode() + b'end_header\n')
        out.writelines(struct.pack('<14f', *r) for r in rows)
EOP
"$bin/spin-import" -q "$work/frames" -o "$work/in.spin"
ok $? "the clip is imported"

# Checks a streamed SOG by PlayCanvas's specification, version 1: N splats at level 0, L levels.
valid() { # FOLDER N L NAME
    python3 - "$1" "$2" "$3" 2>"$work/err" <<'EOP'
import json, math, os, sys
folder, n, levels = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
m = json.load(open(folder + '/lod-meta.json'))
assert m['version'] == 1 and m['asset']['generator'].startswith('spin4d ')
assert m['lodLevels'] == levels == len(m['counts']) and m['count'] == sum(m['counts']) and m['counts'][0] == n
assert m['lodErrors'] is True
chunk = [json.load(open(os.path.join(folder, f))) for f in m['filenames']]
assert all(c['version'] == 2 for c in chunk)
assert all(os.path.exists(os.path.join(folder, os.path.dirname(f), i)) for f, c in zip(m['filenames'], chunk)
           for i in c['means']['files'] + c['quats']['files'] + c['scales']['files'] + c['sh0']['files'])
runs, sums, leaves = [[] for _ in chunk], [0] * levels, []
def visit(node):
    low, high = node['bound']['min'], node['bound']['max']
    assert ('children' in node) != ('lods' in node)
    for v in low + high: assert v == float('%.7g' % v)
    if 'lods' in node:
        assert sorted(node['lods']) == [str(k) for k in range(levels)]
        for k, r in node['lods'].items():
            assert m['filenames'][r['file']].startswith(k + '_')
            runs[r['file']].append((r['offset'], r['count']))
            sums[int(k)] += r['count']
        e = node['errors']
        assert len(e) == levels and e[0] == 0 and e == sorted(e) and math.isfinite(e[-1]) and (levels == 1 or e[-1] > 0)
        for a, b in zip(range(levels), range(1, levels)):
            assert node['lods'][str(b)]['count'] == -(-node['lods'][str(a)]['count'] // 4)
        leaves.append(node)
        return
    assert len(node['children']) == 2
    for c in node['children']:
        visit(c)
    assert low == [min(c['bound']['min'][i] for c in node['children']) for i in range(3)]
    assert high == [max(c['bound']['max'][i] for c in node['children']) for i in range(3)]
visit(m['tree'])
assert sums == m['counts'] and max(l['lods']['0']['count'] for l in leaves) <= 16384
for r, c in zip(runs, chunk): # the runs cover the chunk
    at = 0
    for offset, count in sorted(r):
        assert offset == at
        at += count
    assert at == c['count']
EOP
    ok $? "$4"
}

# Prints the rows of a frame of a bundle, rounded, one per line, sorted.
rows() { # BUNDLE FRAME
    "$bin/spin-export" -q "$1" --to ply --range "$2:$(($2 + 1))" -o "$work/ply" --force &&
        python3 - "$work/ply" <<'EOP'
import glob, struct, sys
data = open(glob.glob(sys.argv[1] + '/*.ply')[0], 'rb').read()
head, body = data.split(b'end_header\n', 1)
w = head.count(b'property float ')
at = [head.split(b'property float ')[1:].index(p) for p in head.split(b'property float ')[1:]]
names = [p.split(b'\n')[0].decode() for p in head.split(b'property float ')[1:]]
keep = [names.index(k) for k in ('x', 'y', 'z', 'f_dc_0')]
for line in sorted('%.1f %.1f %.1f %.1f' % tuple(round(v[k], 1) + 0.0 for k in keep)
                   for v in struct.iter_unpack('<%df' % w, body)):
    print(line)
EOP
}

run "$bin/spin-export" "$work/in.spin" --to streamed-sog -o "$work/s" --json
is "$code" 0 "a clip is written"
is "$(python3 -c 'import json, sys; d = json.load(open(sys.argv[1])); print(d["frames"], d["splats_mean"])' "$work/out")" "3 21050" "its frames have all splats"
err_has "the same in all frames, and streamed: 21000 splats" "the static splats are counted"
err_has "streamed SOG: 21000 splats at level 0, 330 splats at level 3; 4 chunks" "and the levels are described"
valid "$work/s" 21000 4 "the index follows the specification"
is "$(ls "$work/s")" "0_0
1_0
2_0
3_0
frame_00004.sog
frame_00005.sog
frame_00006.sog
lod-meta.json
sequence.json" "the folder has chunks and frames"
"$bin/spin-import" -q "$work/s/frame_00005.sog" -o "$work/moving.spin"
is "$("$bin/spin-import" --info "$work/moving.spin" | awk '/^splats/ { print $2 }')" 50 "a frame's file has the moving splats only"

run "$bin/spin-import" "$work/s" -o "$work/back.spin"
is "$code" 0 "the clip is imported again"
run "$bin/spin-import" "$work/s" --info
out_has "every frame contains the 21000 static splats of the streamed SOG" "a note says how"
for f in 4 6; do
    rows "$work/in.spin" $f >"$work/a"
    rows "$work/back.spin" $f >"$work/b"
    cmp "$work/a" "$work/b" 2>"$work/err" && [ "$(wc -l <"$work/b")" = 21050 ]
    ok $? "frame $f has its splats"
done
"$bin/spin-import" -q "$work/s" --lod 2 -o "$work/coarse.spin"
is "$("$bin/spin-import" --info "$work/coarse.spin" | awk '/^splats/ { print $2 }')" 1364 "--lod 2 is the level of the static splats"
"$bin/spin-import" -q "$work/s/lod-meta.json" -o "$work/still.spin"
is "$("$bin/spin-import" --info "$work/still.spin" | awk '/^splats/ { print $2 }')" 21000 "the index alone is the static part"

# Without the static splats, the frames would be incomplete.
mkdir "$work/cut" && cp "$work/s/sequence.json" "$work"/s/*.sog "$work/cut"
run "$bin/spin-import" "$work/cut" -o "$work/cut.spin"
fails 1 spin-import "frames without their static splats"
err_has "cut/lod-meta.json' does not exist, but contains the static splats of these frames" "says what is missing"

# An export that fails leaves neither chunks nor the index of the chunks that it has replaced.
cp -r "$work/s" "$work/broken" && rm -r "$work/broken/2_0" && : >"$work/broken/2_0"
run "$bin/spin-export" -q "$work/in.spin" --to streamed-sog --range 5:6 -o "$work/broken" --force
is "$code" 1 "a chunk that cannot be written"
err_has "cannot make folder '.*broken/2_0': a file has that name" "says which"
[ ! -e "$work/broken/lod-meta.json" ] && [ ! -e "$work/broken/0_0" ] && [ ! -e "$work/broken/1_0" ]
ok $? "the former index and the new chunks are gone"

# Rotations apply to both parts.
"$bin/spin-export" -q "$work/in.spin" --to streamed-sog --rotate 90,0,0 -o "$work/turned" &&
    "$bin/spin-import" -q "$work/turned" -o "$work/turned.spin" --force &&
    "$bin/spin-export" -q "$work/in.spin" --to sog --rotate 90,0,0 -o "$work/whole" &&
    "$bin/spin-import" -q "$work/whole" -o "$work/whole.spin"
ok $? "a rotated clip"
rows "$work/turned.spin" 5 >"$work/a"
rows "$work/whole.spin" 5 >"$work/b"
cmp "$work/a" "$work/b" 2>"$work/err"
ok $? "static and moving splats are rotated alike"

# A single frame is static as a whole. Fewer levels replace those of the former export.
run "$bin/spin-export" "$work/in.spin" --to streamed-sog --range 5:6 --levels 3 -o "$work/s" --force
is "$code" 0 "one frame replaces the clip"
is "$(grep -c warning: "$work/err")" 0 "no file stays, so nothing is said of it"
valid "$work/s" 21050 3 "with three levels"
is "$(ls "$work/s")" "0_0
1_0
2_0
lod-meta.json
sequence.json" "files of the former export are removed"
echo mine >"$work/s/notes"
run "$bin/spin-export" "$work/in.spin" --to streamed-sog --range 5:6 --levels 3 -o "$work/s" --force
err_has "'$work/s' was not empty: files that are not overwritten stay in it" "a file that does stay is announced"
rm "$work/s/notes"
"$bin/spin-import" -q "$work/s" -o "$work/one.spin"
rows "$work/in.spin" 5 >"$work/a"
rows "$work/one.spin" 5 >"$work/b"
cmp "$work/a" "$work/b" 2>"$work/err"
ok $? "it is imported with its number"
run "$bin/spin-export" -q "$work/in.spin" --to streamed-sog --range 5:6 --levels 1 -o "$work/one"
valid "$work/one" 21050 1 "one level"
run "$bin/spin-export" "$work/in.spin" --to ply --range 5:6 -o "$work/s" --force
is "$(grep -c warning: "$work/err") $(ls "$work/s" | tr '\n' ' ')" "0 frame_00005.ply sequence.json " "another format replaces the chunks, too"

run "$bin/spin-export" "$work/in.spin" --to streamed-sog -o "$work/x.sog"
fails 2 spin-export "a file as the output"
run "$bin/spin-export" "$work/in.spin" --to streamed-sog --levels 9 -o "$work/x"
fails 2 spin-export "too many levels"
run "$bin/spin-export" -q "$work/moving.spin" --to streamed-sog --min-opacity 0.99 -o "$work/x"
fails 1 spin-export "a frame without splats"
"$bin/spin-import" -q fixtures/d3dgs/cloud -o "$work/all.spin"
run "$bin/spin-export" "$work/all.spin" --to streamed-sog -o "$work/x"
fails 1 spin-export "a clip without static splats"
err_has "no splat is the same in all .* frames" "says why"
[ ! -e "$work/x" ]
ok $? "refused exports leave nothing"
done_testing
