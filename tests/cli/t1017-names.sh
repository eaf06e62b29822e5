#!/bin/sh
# K: names numbers pattern sequence windows text
# Numbered names of files and folders, patterns in and out, and text that was written on Windows.
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
err_has "'a_%d_\*.ply' or that of 'a_\*_%d.ply'" "both readings are named"
is "$(numbers "$work/two" '--pattern a_*_%d.ply')" 10,30 "--pattern chooses one"

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
done_testing
