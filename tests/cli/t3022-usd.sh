#!/bin/sh
# K: usd export import usda usdz
# USD, exported and imported again: the layers of value clips, numbers and times, packages, and
# refused files.
. tests/cli/lib.sh

# Compares the arrays of two bundles, and their frame rates and numbers.
same_values() { # BUNDLE BUNDLE [ERROR]
    python3 - "$1" "$2" "${3:-1e-6}" <<'P'
import sys
sys.path.insert(0, "exporters/python")
import numpy as np, spin4d
a, b = map(spin4d.load, sys.argv[1:3])
assert a.numbers == b.numbers and a.meta["fps"] == b.meta["fps"], (a.numbers, b.numbers, a.meta["fps"], b.meta["fps"])
for f in range(len(a)):
    for x, y in zip(a.frame(f), b.frame(f)):
        assert np.abs(x - y).max() <= float(sys.argv[3]) * np.abs(x).max(), f
P
}

# Exporting the imported stage again gives the same stage, up to the last digits of numbers.
round() { # INPUT NAME OPTION...
    input=$1 name=$2
    shift 2
    run "$bin/spin-import" "fixtures/$input" -o "$work/$name.spin" --force "$@"
    run "$bin/spin-export" "$work/$name.spin" --to usd --fps 24 -o "$work/$name-1"
    run "$bin/spin-import" "$work/$name-1" -o "$work/back.spin" --force --json
    is "$code $(member from)" "0 usd" "$input: the stage is recognised"
    run "$bin/spin-export" "$work/back.spin" --to usd -o "$work/$name-2"
    python3 - "$work/$name-1" "$work/$name-2" <<'P'
import glob, os, re, sys
a, b = sys.argv[1:]
names = sorted(os.path.basename(n) for n in glob.glob(a + "/*.usda"))
assert len(names) > 3 and names == sorted(os.path.basename(n) for n in glob.glob(b + "/*.usda"))
number = re.compile(r"(-?[0-9]+(?:[.][0-9]+)?(?:e[-+]?[0-9]+)?)(?![.0-9])")
for name in names:
    one, two = (number.split(open(d + "/" + name).read().split("doc =")[-1].partition("\n")[2]) for d in (a, b))
    assert one[::2] == two[::2], name
    for x, y in zip(map(float, one[1::2]), map(float, two[1::2])):
        assert abs(x - y) <= 2e-6 * abs(x) + 1e-9, (name, x, y)
P
    ok $? "$input: written again, the same"
    for end in usdc usdz usda; do
        run "$bin/spin-export" "$work/$name.spin" -o "$work/$name.$end" --fps 24
        is "$code" 0 "$input: one file, $end"
        run "$bin/spin-import" "$work/$name.$end" -o "$work/one.spin" --force
        same_values "$work/back.spin" "$work/one.spin"
        ok $? "$input: $end has the values of the text"
    done
}
round splats/spz4 frames
round d3dgs/cloud tracks
is "$(grep -c subLayers "$work/tracks-2/frame_00000.usda")" 1 "with what is still in one layer"
round 4dgs/birth_sh2/scene.4dgs slices --frames 4

run "$bin/spin-import" "$work/tracks-1/clip.usda" -o "$work/one.spin" --force --json
is "$code $(member frames)" "0 $(ls "$work"/tracks-1/frame_*.usda | wc -l)" "clip.usda instead of its folder"
run "$bin/spin-import" "$work/tracks-1/frame_00001.usda" -o "$work/one.spin" --force --json
is "$code $(member frames)" "0 1" "one layer"
mkdir "$work/two" && cp "$work"/frames-1/frame_0000[02].usda "$work"/frames-1/still.usda "$work/two"
mv "$work/two/still.usda" "$work"
sed -i 's,@./still.usda@,@../still.usda@,' "$work"/two/*.usda
run "$bin/spin-import" "$work/two" -o "$work/two.spin" --json
is "$code $(member frames)" "0 2" "a file for each frame"
run "$bin/spin-import" --info "$work/two"
out_has "^frames  *2, numbers 0 to 2" "with the numbers of their names"
cp "$work/two/frame_00000.usda" "$work/two/frame_00003.usd"
run "$bin/spin-import" "$work/two" -o "$work/no.spin"
fails 1 spin-import "a folder of several kinds of USD and no stage"
err_has "give one of the files" "says what to give"
nothing_at "$work/no.spin" "nothing was written"
rm "$work/tracks-1/frame_00001.usda"
run "$bin/spin-import" "$work/tracks-1" -o "$work/no.spin"
fails 1 spin-import "a clip that is missing"
err_has "frame_00001.usda" "names the file"

# A frame without splats, in one file.
python3 - "$work/late" <<'P'
import os, struct, sys
os.mkdir(sys.argv[1])
names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
for i in range(3):
    with open("%s/%d.ply" % (sys.argv[1], i), "wb") as f:
        f.write(("ply\nformat binary_little_endian 1.0\nelement vertex 2\n"
                 + "".join("property float %s\n" % n for n in names) + "end_header\n").encode())
        for k in range(2):
            f.write(struct.pack("<14f", i + k, 0, 0, 0, 0, 0, 3, -3, -3, -3, 1, 0, 0, 0))
P
run "$bin/spin-import" "$work/late" -o "$work/late.spin"
for end in usdc usda; do
    run "$bin/spin-export" "$work/late.spin" -o "$work/late.$end" --crop 1.5,-1,-1,9,9,9
    run "$bin/spin-import" --info "$work/late.$end"
    out_has "^splats  *0 to 2 a frame, mean 1" "$end: a frame without splats"
done
grep -q '^        [0-9]*: \[(.*),(.*)\],$' "$work/late.usda" && ! grep -q '\[,\|,\]' "$work/late.usda"
ok $? "commas are between the values of text"

# One file: what is refused, and what stays when it fails.
run "$bin/spin-export" "$work/tracks.spin" -o "$work/frame_%d.usdc"
fails 2 spin-export "a crate for each frame"
err_has "end the pattern with .usda" "says what to do"
run "$bin/spin-export" "$work/tracks.spin" -o "$work/named/f_%d.usda" --range 1:3
is "$code $(ls "$work/named" | grep -c '^f_[12].usda$')" "0 2" "text layers that are named by a pattern"
run "$bin/spin-export" "$work/tracks.spin" -o "$work/tracks.usdz"
fails 1 spin-export "a package that exists"
run "$bin/spin-export" "$work/tracks.spin" -o "$work/tracks.usdz" --force --half --fps 24
is "$code" 0 "--force overwrites it"
err_has "usd rounds values; rms error" "half floats are reported"
run "$bin/spin-import" "$work/tracks.usdc" -o "$work/one.spin" --force
run "$bin/spin-import" "$work/tracks.usdz" -o "$work/half.spin"
same_values "$work/one.spin" "$work/half.spin" 2e-3
ok $? "and have the values"
for end in usdz usda; do
    (ulimit -f 16 && exec "$bin/spin-export" -q "$work/tracks.spin" -o "$work/full.$end") >"$work/out" 2>"$work/err"
    is "$?" 1 "$end: a limit on files"
    nothing_at "$work/full.$end" "nothing was written"
done
is "$(ls "$work" | grep -c 'tmp\.')" 0 "and no temporary file stays"
done_testing
