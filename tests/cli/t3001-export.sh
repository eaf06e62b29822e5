#!/bin/sh
# K: ply images
# spin-export: PLY frames that read back, images, and what cannot be exported.
. tests/cli/lib.sh

run_of=$fixtures/d3dgs/trained
data=$fixtures/datasets/panoptic_mini
if [ ! -d "$run_of" ] || [ ! -d "$data" ]; then
    skip "export" "no fixtures at $run_of and $data"
    done_testing
fi
in=$work/in.spin
run "$bin/spin-import" "$run_of" --data "$data" -o "$in" --json
is "$code" 0 "imports the run"
frames=$(member frames)
splats=$(sed -n 's/^    "mean": \([0-9.]*\),*$/\1/p' "$work/out")

run "$bin/spin-export" "$in" --to ply -o "$work/ply" --json
is "$code" 0 "exports PLY"
is_json "--json is one document"
is "$(member to)" ply "reports 'to'"
is "$(member frames)" "$frames" "reports 'frames'"
is "$(member splats_mean)" "$splats" "reports 'splats_mean'"
is "$(ls "$work/ply" | wc -l)" "$((frames + 1))" "one file a frame, and sequence.json"
[ "$(find "$work/ply" -name 'frame_[0-9][0-9][0-9][0-9][0-9].ply' | wc -l)" -eq "$frames" ]
ok $? "five digits in every name"
head -c 3 "$work/ply"/frame_00000.ply | grep -q ply
ok $? "they are PLY"
run "$bin/spin-import" --info --json "$work/ply"
is "$(member from)" ply "they read back"
is "$(member frames)" "$frames" "all of them"
run "$bin/spin-export" "$in" --to ply -o "$work/ply"
fails 1 spin-export "does not overwrite"
touch -d '2 minutes ago' "$work/ply/frame_00000.ply.tmp.999999999"
run "$bin/spin-export" "$in" --to ply -o "$work/ply" --force
is "$code" 0 "overwrites with --force"
is "$(find "$work/ply" -name '*.tmp.*' | wc -l)" 0 "and removes what a killed export has left"
touch -d '2 minutes ago' "$work/swept.glb.tmp.999999999" "$work/swept.html.tmp.999999999" "$work/swept.bin.tmp.999999999"
run "$bin/spin-export" "$in" --to gltf -o "$work/swept.glb"
run "$bin/spin-export" "$in" --to html --split -o "$work/swept.html"
is "$code $(find "$work" -name '*.tmp.*' | wc -l)" "0 0" "so do those of one file"
run "$bin/spin-export" "$in" --to ply -o "$work/part" --range 1:4:2 --json
is "$(member frames)" 2 "--range with a step"
is "$(ls "$work/part" | tr '\n' ' ')" "frame_00001.ply frame_00003.ply sequence.json " "keeps the frames' numbers"

run "$bin/spin-export" "$in" --to ply -o "$work/no" --sh 9
fails 2 spin-export "an exporter's option is checked"
err_has "--sh '9'" "and the option is named"
nothing_at "$work/no" "and nothing was written"
run "$bin/spin-export" "$in" --to images -o "$work/images"
is "$code" 0 "exports pictures"
find "$work/images" -name '*.png' | grep -q png
ok $? "they are PNG"

# Without a data set, or if it no longer exists: seen from the front.
run "$bin/spin-import" fixtures/splats/splat/frame_00000.splat -o "$work/alone.spin"
run "$bin/spin-export" "$work/alone.spin" --to images --size 60x40 -o "$work/alone"
is "$code $(ls "$work/alone" | tr '\n' ' ')" "0 front_frame_00000.png sequence.json " "pictures without a data set"
run "$bin/spin-export" "$work/alone.spin" --to images --data-from panoptic -o "$work/never"
fails 2 spin-export "--data-from without a data set"
cp -r "$clip" "$work/run"
run "$bin/spin-import" "$work/run" --data "$work/run" -o "$work/moved.spin"
run "$bin/spin-export" "$work/moved.spin" --to images --path train --repeat 1 --size 60x40 --range 0:2 -o "$work/rig"
is "$code $(ls "$work/rig" | tr '\n' ' ')" "0 sequence.json train_frame_00000.png train_frame_00001.png " "a path through the training cameras"
rm -r "$work/run"
run "$bin/spin-export" "$work/moved.spin" --to images --size 60x40 --range 0:1 -o "$work/gone"
is "$code $(find "$work/gone" -name '*.png' | wc -l)" "0 2" "a data set that is gone"
err_has "^'.*$work/run.* does not exist: using the cameras that the bundle keeps" "is no warning, as the bundle keeps its cameras"

# A data set that exists but is empty, has no images, or has a truncated file: exports that need no
# cameras do not open it.
for state in empty short cut; do
    mkdir -p "$work/run"
    [ $state = cut ] && cp -r "$clip/." "$work/run" && head -c 500 "$clip/train_meta.json" >"$work/run/train_meta.json"
    [ $state = short ] && cp -r "$clip/." "$work/run" && rm -r "$work/run/ims"
    for to in ply:ply gltf:clip.glb spz:spz; do
        run "$bin/spin-export" "$work/moved.spin" --to ${to%:*} -o "$work/$state-${to#*:}" -q
        is "$code $(cat "$work/err" "$work/out")" "0 " "$state data set: ${to%:*} needs none"
    done
    for to in html:page.html images:images 'spz:checked --check'; do
        # shellcheck disable=SC2086
        run "$bin/spin-export" "$work/moved.spin" --to ${to%%:*} --range 0:1 -q -o "$work/$state-"${to#*:}
        is "$code" 0 "$state data set: ${to%%:*} does without"
        err_has "^warning: .*$work/run.*continuing with the cameras that the bundle keeps" "$state data set: ${to%%:*} says so"
    done
    run "$bin/spin-export" "$work/moved.spin" --to html --data "$work/run" -o "$work/never.html"
    is "$code" 1 "$state data set: --data names it"
    run "$bin/spin-eval" "$work/moved.spin"
    is "$code" 1 "$state data set: spin-eval needs it"
    rm -rf "$work/run"
done

# A complete data set of two frames, whereas the bundle has six.
cp -r "$clip" "$work/run"
chmod -R u+w "$work/run"
python3 -c 'import json, sys
for name in sys.argv[1:]:
    meta = json.load(open(name))
    json.dump({k: v[:2] if isinstance(v, list) else v for k, v in meta.items()}, open(name, "w"))' \
    "$work/run/train_meta.json" "$work/run/test_meta.json"
run "$bin/spin-export" "$work/moved.spin" --to images --size 60x40 --range 0:1 -o "$work/other"
is "$code $(find "$work/other" -name '*.png' | wc -l)" "0 2" "a data set of other frames"
err_has "^warning: .*cannot pair frames.*continuing with the cameras that the bundle keeps" "is a warning as well"
rm -r "$work/run"

run "$bin/spin-import" "$run_of" -o "$work/places.spin" --positions-only
is "$code" 0 "imports positions only"
run "$bin/spin-export" "$work/places.spin" --to ply -o "$work/never"
fails 1 spin-export "positions only"
err_has spin-retrain "positions only: says to run spin-retrain"
nothing_at "$work/never" "positions only: nothing was written"

size=$(wc -c <"$in")
for part in 1 50 99; do
    head -c $((size * part / 100)) "$in" >"$work/cut.spin"
    run "$bin/spin-export" "$work/cut.spin" --to ply -o "$work/never"
    fails 1 spin-export "a bundle cut to $part %"
    nothing_at "$work/never" "a bundle cut to $part %: nothing was written"
done

# Splats too transparent to show in any image.
{
    printf 'ply\nformat ascii 1.0\nelement vertex 3\n'
    printf 'property float %s\n' x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3
    echo end_header
    for x in 1 2 3; do echo "$x 0 0 0 0 0 -20 -3 -3 -3 1 0 0 0"; done
} >"$work/faint.ply"
run "$bin/spin-import" "$work/faint.ply" -o "$work/faint.spin"
run "$bin/spin-export" "$work/faint.spin" --to images --path orbit --repeat 1 --size 64x48 -o "$work/faint"
is "$code" 0 "images of what cannot be seen"
err_has "1 of 1 render shows only the background" "images: it is said that they are empty"
run "$bin/spin-export" "$work/faint.spin" --to spz --check -o "$work/faint-spz" --json
is "$code" 0 "--check of what cannot be seen"
err_has "no splat of frame 0 is visible to the camera: no image was compared" "--check: and that none was compared"
grep -q '"rendered": null' "$work/out"
ok $? "--check --json names no frame"
run "$bin/spin-export" "$work/faint.spin" --to video --path orbit --repeat 1 --size 64x48 -o "$work/faint.mp4"
if [ "$code" = 0 ]; then
    err_has "1 of 1 render shows only the background" "a video: it is said that it is empty"
else
    skip "a video of what cannot be seen" "$(cat "$work/err")"
fi

run "$bin/spin-import" fixtures/3dgstream -o "$work/one.spin" --range 0:1
run "$bin/spin-export" "$work/one.spin" --to splat -o "$work/one"
err_has "SH above degree 0 are dropped" "splat: SH of degree 1 is left out, and it is said"
run "$bin/spin-export" "$work/one.spin" --to splat -o "$work/one-checked" --check
rows=$(sed -n 's/^read back: 1 frame, \([0-9]*\) splats.*/\1/p' "$work/out")
out_has "lost in $rows of $rows splats, which splat does not store" "--check: of how many splats it is lost"
run "$bin/spin-export" "$work/one.spin" --to spz -o "$work/one-spz" --check --json
out_has "\"sh_lost\": 0,$" "--check: of none where the format holds it"
# Bands of SH that are 0 are not counted as lost.
run "$bin/spin-export" "$work/one.spin" --to ply --sh 0 -o "$work/flat"
run "$bin/spin-import" "$work/flat" -o "$work/flat.spin"
run "$bin/spin-export" "$work/flat.spin" --to ply --sh 2 -o "$work/zeros"
run "$bin/spin-import" "$work/zeros" -o "$work/zeros.spin" --json
is "$(member sh_degree)" 2 "a clip whose SH of degree 2 is 0"
run "$bin/spin-export" "$work/zeros.spin" --to splat -o "$work/zeros-checked" --check --json
out_has "\"sh_lost\": 0,$" "--check: of which splat loses none"

done_testing
