#!/bin/sh
# K: sog import lod
# Streamed SOG: lod-meta.json and its chunks, made of the SOG files of the fixtures.
. tests/cli/lib.sh

python3 - "$work/s" <<'EOP'
import json, os, sys, zipfile
root = sys.argv[1]
for name, frame in (('0_0', 0), ('0_1', 1), ('1_0', 2), ('env', 1)):
    zipfile.ZipFile('fixtures/splats/sog/frame_%05d.sog' % frame).extractall('%s/%s' % (root, name))
def leaf(**lods):
    return {'bound': {'min': [-9] * 3, 'max': [9] * 3},
            'lods': {k[1:]: dict(file=f, offset=o, count=n) for k, (f, o, n) in lods.items()}}
tree = {'bound': {'min': [-9] * 3, 'max': [9] * 3}, 'children': [
    leaf(l0=(0, 0, 25), l1=(2, 5, 10)),
    {'bound': {'min': [-9] * 3, 'max': [9] * 3}, 'children': [leaf(l0=(0, 25, 15)), leaf(l0=(1, 0, 40))]}]}
json.dump(dict(version=1, count=90, counts=[80, 10], lodLevels=2, environment='env/meta.json',
               filenames=['0_0/meta.json', '0_1/meta.json', '1_0/meta.json'], tree=tree),
          open(root + '/lod-meta.json', 'w'))
EOP
ok $? "a streamed SOG is written"

# The rows of a file of splats, exported as PLY.
rows() { # NAME INPUT OPTION...
    name=$1
    shift
    "$bin/spin-import" -q "$@" -o "$work/$name.spin" --force 2>>"$work/log" &&
        "$bin/spin-export" -q "$work/$name.spin" --to ply -o "$work/$name" --force &&
        python3 -c '
import glob, sys
header, body = open(glob.glob(sys.argv[1] + "/*.ply")[0], "rb").read().split(b"end_header\n")
n = int(header.split(b"element vertex ")[1].split()[0])
open(sys.argv[1] + ".rows", "w").writelines(body[i * len(body) // n:(i + 1) * len(body) // n].hex() + "\n" for i in range(n))' \
            "$work/$name"
}
for i in 0 1 2; do rows f$i fixtures/splats/sog/frame_0000$i.sog; done
cat "$work/f0.rows" "$work/f1.rows" "$work/f1.rows" >"$work/fine"
{ sed -n 6,15p "$work/f2.rows" && cat "$work/f1.rows"; } >"$work/coarse"

for input in "$work/s" "$work/s/lod-meta.json"; do
    rows level0 "$input"
    cmp "$work/level0.rows" "$work/fine"
    ok $? "${input##*/}: the finest level and the sky are read"
    rows level1 "$input" --lod 1
    cmp "$work/level1.rows" "$work/coarse"
    ok $? "${input##*/}: --lod 1 reads the runs of that level"
done
run "$bin/spin-import" "$work/s" --info
out_has "streamed SOG: level of detail 0 of 0 to 1, the finest; --lod selects another" "the level is said"
out_has "the last 40 splats are the sky ('.*s/env/meta.json')" "and the sky"
run "$bin/spin4d" "$work/s" --lod 1 -o "$work/one.splat"
is "$code" 0 "spin4d takes --lod"
is "$(find "$work/one.splat" -name '*.splat' -exec wc -c {} + | awk 'NR == 1 { print $1 }')" 1600 "of 10 splats and the sky"
run "$bin/spin-import" "$work/s" --lod 1 --positions-only -o "$work/positions.spin"
is "$code" 0 "positions alone are read"
run "$bin/spin4d" "$work/level1.spin" --lod 1 -o "$work/two.splat"
fails 2 spin4d "--lod of a bundle"
run "$bin/spin-import" --info "$work/s" --lod 2
fails 1 spin-import "a level that does not exist"
err_has "lod-meta.json': --lod is 2, but this level of detail has no splats: levels are 0 to 1" "names the levels"
run "$bin/spin-import" --info fixtures/splats/sog/frame_00000.sog --lod 0
fails 2 spin-import "--lod of a SOG that is not streamed"

# Malformed files, and files that are not there.
edit() { # PYTHON, with the document as d
    python3 -c "
import json, sys
d = json.load(open(sys.argv[1] + '/lod-meta.json'))
leaf = d['tree']['children'][0]['lods']
$1
json.dump(d, open(sys.argv[1] + '/lod-meta.json', 'w'))" "$work/t"
}
try() { # PYTHON TEXT NAME
    rm -rf "$work/t"
    cp -r "$work/s" "$work/t"
    edit "$1"
    run "$bin/spin-import" --info "$work/t"
    fails 1 spin-import "$3"
    err_has "$2" "$3: says so"
}
try "d['version'] = 2" "version is 2, expected 1" "a newer version"
try "d['filenames'][0] = '../s/0_0/meta.json'" "expected a path below the folder" "a path that climbs out"
try "d['environment'] = '/etc/passwd'" "expected a path below the folder" "an absolute path"
try "leaf['0']['file'] = 3" "refers to file 3, but 'filenames' has 3 entries" "a file that is not listed"
try "leaf['0']['count'] = 26" "contains 40 splats, but the leaves of the tree list 41" "more splats than a chunk has"
try "leaf['0']['count'] = 24; leaf['0']['offset'] = 2" "overlapping" "runs that overlap"
try "leaf['0']['offset'] = 30; leaf['0']['count'] = 20; d['tree']['children'].pop()" "list overlapping splats" "a run beyond a chunk"
try "leaf['0']['offset'] = -1" "no valid 'file', 'offset' and 'count'" "a negative offset"
try "leaf['x'] = leaf['0']" "'x' is not a level" "a level that is no number"
try "d['tree'] = {}" "'tree' contains no splats" "an empty tree"

rm -rf "$work/t"
cp -r "$work/s" "$work/t"
rm -r "$work/t/0_1" "$work/t/env"
rows partial "$work/t"
head -n 10 "$work/coarse" | cmp - "$work/partial.rows"
ok $? "without a file of the finest level, the next one is read"
run "$bin/spin-import" --info "$work/t"
out_has "level of detail 1 of 0 to 1, the finest whose files exist" "which is said"
out_has "the sky is not imported: '.*t/env/meta.json'" "as is a sky that is missing"
run "$bin/spin-import" --info "$work/t" --lod 0
fails 1 spin-import "a level without its files"
err_has "t/0_1/meta.json' does not exist" "names the file"
done_testing
