#!/bin/sh
# K: names numbers pattern sequence windows text
# Numbered files and folders, patterns for input and output, and text files written on Windows.
. tests/cli/lib.sh

run "$bin/spin-import" -q "$clip" -o "$work/in.spin"
run "$bin/spin-export" -q "$work/in.spin" --range 0:3 -o "$work/three/f_%04d_v2.ply"
is "$code" 0 "the output may be a pattern"
is "$(ls "$work/three" | grep -c '^f_000[012]_v2\.ply$')" 3 "which names the files"
run "$bin/spin-export" -q "$work/in.spin" --range 0:3 -o "$work/start/f.####.ply" --start 1001
is "$(ls "$work/start" | grep ply | tr '\n' ' ')" "f.1001.ply f.1002.ply f.1003.ply " "--start and hash signs"
run "$bin/spin-export" "$work/in.spin" --range 0:3 -o "$work/both/f_#.ply" --pattern 'g_%d.ply'
fails 2 spin-export "a pattern twice"
rm "$work/three/sequence.json" "$work/start/sequence.json"

numbers() { # INPUT
    run "$bin/spin-import" --info --json $2 "$1"
    tr -d ' \n' <"$work/out" | sed -n 's/.*"numbers":\[\([0-9,]*\)\].*/\1/p'
}
is "$(numbers "$work/three")" 0,2 "constant numbers are no frame numbers"
is "$(numbers "$work/start/f.####.ply")" 1001,1003 "the input may be a pattern"
is "$(numbers "$work/start" '--pattern f.%d.ply')" 1001,1003 "or have one as an option"
mkdir -p "$work/folders/t_1" "$work/folders/t_2" "$work/models/00001/point_cloud/iteration_7" "$work/models/00002/point_cloud/iteration_7"
for i in 1 2; do
    cp "$work/three/f_000${i}_v2.ply" "$work/folders/t_$i/splat.ply"
    cp "$work/three/f_000${i}_v2.ply" "$work/models/0000$i/point_cloud/iteration_7/point_cloud.ply"
done
is "$(numbers "$work/folders")" 1,2 "a folder for each frame"
is "$(numbers "$work/models")" 1,2 "a model for each frame"
is "$(numbers "$work/models/%d/point_cloud/iteration_7/point_cloud.ply")" 1,2 "as a pattern"
mkdir "$work/runs"
mv "$work/folders/t_1" "$work/runs/run_1"
mv "$work/folders/t_2" "$work/runs/run_2"
run "$bin/spin-import" --info "$work/runs"
fails 1 spin-import "several runs"

mkdir "$work/two"
for i in 1 2 3; do cp "$work/three/f_0000_v2.ply" "$work/two/a_${i}_$((40 - 10 * i)).ply"; done
run "$bin/spin-import" --info "$work/two"
fails 1 spin-import "two numbers that count"
err_has "'a_%d_\*.ply' or --pattern 'a_\*_%d.ply'" "both readings are named"
is "$(numbers "$work/two" '--pattern a_*_%d.ply')" 10,30 "--pattern chooses one"

mkdir "$work/streamed"
run "$bin/spin-export" -q "$work/in.spin" --range 0:1 --to splat -o "$work/sky.splat"
cp "$work/sky.splat" "$work/streamed/environment.sog"
echo '{}' >"$work/streamed/lod-meta.json"
run "$bin/spin-import" --info "$work/streamed"
fails 1 spin-import "the sky of a streamed SOG alone"

# ---- Text ----------------------------------------------------------------------------------------

cp -r fixtures/datasets/blender_mini "$work/blender"
chmod -R u+w "$work/blender"
for f in "$work"/blender/*.json; do
    { printf '\357\273\277'; sed 's,\./\([a-z]*\)/,.\\\\\1\\\\,; s/$/\r/' "$f"; } >"$work/json"
    mv "$work/json" "$f"
done
grep -q '\\\\' "$work/blender/transforms_train.json"
ok $? "names have backslashes"
run "$bin/spin-import" -q "$work/three/f_0000_v2.ply" --data "$work/blender" --pair order -o "$work/w.spin"
is "$code" 0 "JSON with a byte order mark, CRLF and backslashes"
printf '\377\376{\0}\0' >"$work/blender/transforms_train.json"
run "$bin/spin-import" "$work/three/f_0000_v2.ply" --data "$work/blender" -o "$work/u.spin"
fails 1 spin-import "UTF-16"
err_has "UTF-16" "is named"

# ---- Positions far from the origin ---------------------------------------------------------------

{
    printf 'ply\nformat ascii 1.0\nelement vertex 4\n'
    printf 'property double %s\n' x y z
    printf 'property float %s\n' f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3
    printf 'end_header\n'
    for y in 5411932.001 5411932.002 5411933.003 5411934.125; do
        echo "448262.5 $y 120 0 0 0 1 -3 -3 -3 1 0 0 0"
    done
} >"$work/utm.ply"
places() { # the y coordinates of a binary PLY with one splat a row of 17 floats
    python3 -c 'import struct, sys
b = open(sys.argv[1], "rb").read(); at = b.index(b"end_header\n") + 11
print(*["%.6f" % struct.unpack_from("<f", b, at + 68 * i + 4)[0] for i in range(4)])' "$1"
}
run "$bin/spin-import" "$work/utm.ply" -o "$work/utm.spin"
is "$code" 0 "UTM coordinates"
out_has "relative to 448263, 5411933, 120\|relative to 44826[23], 541193[23], 120" "the shift is named"
run "$bin/spin-export" -q "$work/utm.spin" --to ply -o "$work/near.ply" --translate -448262,-5411932,-120
is "$code" 0 "an export closer to 0"
is "$(places "$work/near.ply")" "0.001000 0.002000 1.003000 2.125000" "has the digits of the file"
run "$bin/spin-export" "$work/utm.spin" --to ply -o "$work/far.ply"
is "$code" 0 "an export with the shift undone"
err_has "steps of 0\.[0-9]*" "the steps of floats are named"
is "$(places "$work/far.ply" | cut -c1-7)" 5411932 "and the coordinates are those of the file"
run "$bin/spin-export" "$work/utm.spin" --to ply -o "$work/relative.ply" --relative
is "$code" 0 "a relative export"
grep -q 'steps of' "$work/err"
is $? 1 "needs no warning"
done_testing
