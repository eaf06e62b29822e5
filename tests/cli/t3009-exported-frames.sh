#!/bin/sh
# K: sequence pair import export
# Exports of spin-export can be imported again with their times, and are paired with the data set of
# the original clip.
. tests/cli/lib.sh

mkdir "$work/named" "$work/far"
f=8
for name in a b c d e f; do
    {
        printf 'ply\nformat ascii 1.0\nelement vertex 9\n'
        printf 'property float %s\n' x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3
        echo end_header
        for i in 1 2 3 4 5 6 7 8 9; do echo "$i.$f 0.$f 0 0.$f 0 0 1 0 -1 -1 1 0 0 0"; done
    } >"$work/named/$name.ply"
    cp "$work/named/$name.ply" "$work/far/frame_$((90 + f)).ply"
    f=$((f + 1))
done

# again FOLDER [OPTION...]: frames 2 to 4 of the clip and the export of them have the same metrics.
again() {
    from=$1
    shift
    run "$bin/spin-import" "$work/$from" --data "$clip" "$@" -o "$work/$from.spin"
    is "$code" 0 "$from: imports"
    case $from in named) range=2:5 ;; *) range=100:103 ;; esac
    run "$bin/spin-eval" "$work/$from.spin" --split all --range $range --json
    sed -n '/"views"/,$ p' "$work/out" >"$work/wanted"
    run "$bin/spin-export" "$work/$from.spin" --to ply --range $range -o "$work/$from-out"
    is "$code" 0 "$from: exports three frames"
    run "$bin/spin-import" "$work/$from-out" --data "$clip" -o "$work/$from-again.spin" --json
    is "$code" 0 "$from: imports them again"
    grep -A2 '"times"' "$work/out" | tr -d ' \n' | grep -q '"times":\[2,4'
    ok $? "$from: with their times"
    run "$bin/spin-eval" "$work/$from-again.spin" --split all --json
    sed -n '/"views"/,$ p' "$work/out" | cmp -s - "$work/wanted" && [ -s "$work/wanted" ]
    ok $? "$from: and beside the same pictures"
}

# Names without numbers count from 0, the data set's files from 8; numbers that the data set lacks.
again named
again far --pair order

# A mismatched sequence.json is not trusted.
for fault in 's/"source_index": 3/"source_index": 6/' 's/"frame": 3/"frame": 30/' 's/"time": 3/"time": "x"/'; do
    cp -r "$work/named-out" "$work/bad"
    sed -i "$fault" "$work/bad/sequence.json"
    run "$bin/spin-import" "$work/bad" -o "$work/bad.spin" --json
    is "$code" 0 "$fault: imports"
    err_has "warning: .*sequence.json' does not match" "$fault: says that it does not fit"
    grep -A2 '"times"' "$work/out" | tr -d ' \n' | grep -q '"times":\[0,2'
    ok $? "$fault: times are counted"
    rm -r "$work/bad" "$work/bad.spin"
done
cp -r "$work/named-out" "$work/other"
sed -i 's/"generator": "spin4d [^"]*"/"generator": "other"/; s/"frame": 3/"frame": 30/' "$work/other/sequence.json"
run "$bin/spin-import" "$work/other" -o "$work/other.spin" --json
is "$code" 0 "a sequence.json of others: imports"
grep -A2 '"times"' "$work/out" | tr -d ' \n' | grep -q '"times":\[0,2'
ok $? "a sequence.json of others: times are counted"
! grep -q 'sequence.json' "$work/err"
ok $? "a sequence.json of others: nothing is said"

# --force removes the remains of a longer export, but no file that only another program's
# sequence.json names.
files() { ls "$1" | tr '\n' ' '; }
run "$bin/spin-export" "$work/named.spin" --to ply -o "$work/long"
cp -r "$work/long" "$work/failed"
cp -r "$work/long" "$work/hostile"
run "$bin/spin-export" "$work/named.spin" --to ply --range 1:3 -o "$work/long" --force
is "$code $(files "$work/long")" "0 frame_00001.ply frame_00002.ply sequence.json " "the frames of a longer export go"
err_has "removed 4 files of the previous export from '$work/long'" "and are counted"
! grep -q warning "$work/err"
ok $? "without a warning"
run "$bin/spin-export" "$work/named.spin" --to spz --range 1:3 -o "$work/long" --force
is "$code $(files "$work/long")" "0 frame_00001.spz frame_00002.spz sequence.json " "so do those of another format"
run "$bin/spin-export" "$work/named.spin" --to usd --range 1:3 -o "$work/long" --force
is "$code $(files "$work/long")" "0 clip.usda frame_00001.usda frame_00002.usda manifest.usda sequence.json still.usda " \
    "a stage with what is the same in all frames"
run "$bin/spin-export" "$work/named.spin" --to usd --range 1:2 -o "$work/long" --force
is "$code $(files "$work/long")" "0 clip.usda frame_00001.usda manifest.usda sequence.json " "a shorter stage has all of it in its layer"
err_has "removed 2 files of the previous export" "and what the longer one had beside its layers goes"
run "$bin/spin-export" "$work/named.spin" --to ply --range 1:2 -o "$work/long" --force
is "$code $(files "$work/long")" "0 frame_00001.ply sequence.json " "so do stage and manifest for another format"
run "$bin/spin-export" "$work/named.spin" --to gltf -o "$work/long" --force
run "$bin/spin-export" "$work/named.spin" --to gltf --range 1:3 -o "$work/long" --force
is "$code $(files "$work/long")" "0 frame_00001.glb frame_00002.glb sequence.json " "and numbered .glb"
rm "$work/failed/frame_00002.ply"
mkdir "$work/failed/frame_00002.ply"
run "$bin/spin-export" "$work/named.spin" --to ply --range 1:3 -o "$work/failed" --force
is "$code $(ls "$work/failed" | wc -l)" "1 7" "an export that fails removes nothing"
mkdir "$work/hostile/sub0"
for name in up_0 hostile/sub0/0 hostile/mine; do echo mine >"$work/$name.ply"; done
ln -s ../up_0.ply "$work/hostile/link_0.ply"
for name in "../up_0.ply" "sub0/0.ply" "$work/up_0.ply" mine.ply link_0.ply sub0 FRAME_00001.ply; do
    sed -i "s|\"frames\": \[|&{\"file\": \"$name\", \"frame\": 0},|" "$work/hostile/sequence.json"
done
run "$bin/spin-export" "$work/named.spin" --to ply --range 1:3 -o "$work/hostile" --force
is "$code $(files "$work/hostile")" "0 frame_00001.ply frame_00002.ply link_0.ply mine.ply sequence.json sub0 " \
    "files that no export has written stay"
[ -s "$work/up_0.ply" ] && [ -s "$work/hostile/sub0/0.ply" ]
ok $? "and those of other folders"

# Frames without splats are counted, and imported again.
for to in ply splat spz; do
    run "$bin/spin-export" "$work/named.spin" --to $to --crop 0,0,-1,99,0.105,1 -o "$work/empty" --force --json
    is "$code $(member frames)" "0 6" "$to: an export of frames without splats"
    err_has "warning: 5 of 6 frames are written without any splat" "$to: says how many"
    run "$bin/spin-import" "$work/empty" -o "$work/empty.spin" --force --json
    is "$code $(member frames) $(grep -c '"min": 0,' "$work/out")" "0 6 1" "$to: and they import again"
done
run "$bin/spin-export" "$work/named.spin" -o "$work/empty.tsog" --crop 0,0,-1,99,0.105,1 --json
is "$code $(grep -c "warning: 5 of 6 frames are written without any splat" "$work/err")" "0 1" "tsog: says how many"

# 4D splats: what --min-opacity keeps is counted as in the file.
if [ -d "$fixtures/freetimegs/newer_sh1_clamped" ]; then
    run "$bin/spin-import" "$fixtures/freetimegs/newer_sh1_clamped" -o "$work/4d.spin"
    for to in .ftgs.ply .tsog .html; do
        run "$bin/spin-export" "$work/4d.spin" -o "$work/4d$to" --json --min-opacity 0.9
        case $(member splats_mean) in 49.5*) true ;; *) false ;; esac
        ok $? "$to: the mean of what is written: $(member splats_mean)"
    done
    run "$bin/spin-import" "$work/4d.ftgs.ply" -o "$work/4d-again.spin" --json
    grep -q '"mean": 49.51' "$work/out"
    ok $? "and of what is read again"
fi

# Two comments with the same content become one note; rendered images are counted.
cp -r "$work/named" "$work/mip"
sed -i 's/^format.*/&\ncomment antialiased 1\ncomment SplatRenderMode: mip/' "$work"/mip/*.ply
run "$bin/spin-import" "$work/mip" -o "$work/mip.spin"
is "$(grep -c 'antialiasing rasteriser' "$work/out")" 1 "antialiasing is noted once"
run "$bin/spin-export" "$work/mip.spin" --to images --path orbit --size 20x20 --duration 1 -o "$work/images" --json
is "$(member frames) $(member images) $(ls "$work/images" | wc -l)" "6 30 31" "images that are drawn are counted"
run "$bin/spin-export" "$work/mip.spin" --to images --path orbit --size 20x20 --duration 1 -o "$work/images" --force
! grep -q warning "$work/err"
ok $? "and replaced without a warning"
out_has "6 frames as images (30 images)" "in words too"

# Images of a previous export are removed too: of another camera path, of more frames, and those of
# spin-eval.
run "$bin/spin-export" "$work/mip.spin" --to images --path orbit --size 20x20 --repeat 1 --range 0:2 -o "$work/images" --force
is "$code $(files "$work/images")" "0 orbit_frame_00000.png orbit_frame_00001.png sequence.json " "fewer images replace more"
err_has "removed 28 files of the previous export from '$work/images'" "and those that go are counted"
run "$bin/spin-import" "$work/images" -o "$work/never.spin"
err_has "it is a folder of images, not of splats" "a folder of images is named as such, with its sequence.json"
run "$bin/spin-eval" "$work/named.spin" --split all --images "$work/images" --force
is "$code $(ls "$work/images" | grep -c orbit)" "0 0" "spin-eval --images --force: an export's images go"
n=$(ls "$work/images" | wc -l)
echo mine >"$work/images/cam_notes.png"
run "$bin/spin-eval" "$work/named.spin" --split all --range 3:5 --images "$work/images" --force
is "$code $(ls "$work/images" | wc -l)" "0 $(((n - 1) / 3 + 2))" "spin-eval --images --force: so do those of other frames"
err_has "removed $(((n - 1) / 3 * 2)) files of the previous export" "and are counted"
err_has "warning: folder '$work/images' was not empty" "and what no run has listed stays with a warning"

# A part of the exported frames.
run "$bin/spin-eval" "$work/named.spin" --split all --range 3:5 --json
sed -n '/"views"/,$ p' "$work/out" >"$work/wanted"
run "$bin/spin-import" "$work/named-out" --data "$clip" --range 3:5 -o "$work/some.spin"
is "$code" 0 "some of them: imports"
run "$bin/spin-eval" "$work/some.spin" --split all --json
sed -n '/"views"/,$ p' "$work/out" | cmp -s - "$work/wanted" && [ -s "$work/wanted" ]
ok $? "some of them: beside the same pictures"

# The data set, and the fact that rows are persistent splats, are restored automatically.
run "$bin/spin-import" --from d3dgs "$clip" --data "$clip" -o "$work/d.spin" --range 0:3
run "$bin/spin-eval" "$work/d.spin" --split all --json
views() { sed -n '/"views"/,$ s/\([.][0-9]\{6\}\)[0-9]*/\1/p' "$work/out"; } # to what floats hold
views >"$work/wanted"
run "$bin/spin-export" "$work/d.spin" --to ply -o "$work/d-out"
run "$bin/spin-import" "$work/d-out" -o "$work/d-again.spin" --json
is "$code" 0 "what was exported imports alone"
out_has "using the data set of the exported clip" "with its data set, and says so"
run "$bin/spin-eval" "$work/d-again.spin" --split all --json
views | cmp -s - "$work/wanted" && [ -s "$work/wanted" ]
ok $? "and is measured as it was"
grep -aq '"identity": true' "$work/d-again.spin"
ok $? "rows are the same splats"
run "$bin/spin-export" "$work/d.spin" --to ply -o "$work/turned" --up -y
run "$bin/spin-import" "$work/turned" -o "$work/turned.spin" --json
is "$code $(grep -c "of the exported clip" "$work/out")" "0 0" "a scene that was turned has lost its cameras"
for how in 'false sog' 'true splat' 'false splat --order size' 'false compressed-ply' \
    'true compressed-ply --order source' 'false gltf'; do
    # shellcheck disable=SC2086
    run "$bin/spin-export" "$work/d.spin" -o "$work/order" --force --to ${how#* }
    grep -q "\"identity\": ${how%% *}" "$work/order/sequence.json"
    ok $? "rows are the same splats where their order is the source's: $how"
done
cp -r "$work/d-out" "$work/gone"
sed -i 's/"path": "[^"]*"/"path": "nowhere"/' "$work/gone/sequence.json"
run "$bin/spin-import" "$work/gone" -o "$work/gone.spin" --json
is "$code $(grep -c "of the exported clip" "$work/out")" "0 0" "a data set that is gone is not missed"
mkdir "$work/gone/empty"
sed -i 's/"path": "nowhere"/"path": "empty"/' "$work/gone/sequence.json"
run "$bin/spin-import" "$work/gone" -o "$work/gone2.spin"
is "$code" 0 "one that is none any more does not stop the import"
err_has "not using the data set of the exported clip" "but is warned of"

done_testing
