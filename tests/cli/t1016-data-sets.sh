#!/bin/sh
# K: datasets 4danyone easyvolcap colmap import retrain eval export
# Data sets of cameras with a folder of frames or a video each, from import to export: recognised,
# split as requested, trained on, measured and rendered.
. tests/cli/lib.sh

# Some splats in view of the cameras, in three frames.
mkdir "$work/splats"
for frame in 0 1 2; do
    {
        printf '%s\n' ply 'format ascii 1.0' 'element vertex 27'
        for p in x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3; do
            echo "property float $p"
        done
        echo end_header
        awk -v f="$frame" 'BEGIN { for (i = 0; i < 27; i++)
            print (i % 3 - 1) / 3 + f / 20, 1 + (int(i / 3) % 3 - 1) / 3, (int(i / 9) - 1) / 3,
                0.3, 0, -0.3, 1, -2, -2, -2, 1, 0, 0, 0 }'
    } >"$work/splats/frame_$frame.ply"
done

while read -r name folder importer note; do
    set=$fixtures/datasets4d/$folder
    [ -d "$set" ] || set=fixtures/datasets4d/$folder
    run "$bin/spin-import" "$work/splats" --data "$set" -o "$work/$name.spin" --json
    if grep -q 'need FFmpeg' "$work/err"; then
        skip "$name" "this build reads no films"
        continue
    fi
    is "$code $(member frames)" "0 3" "$name: its frames are paired with those of a clip"
    out_has "$note" "$name: what the set does not say is noted"
    run "$bin/spin-import" --info "$work/$name.spin"
    out_has "^data .*, $importer$" "$name: is known as $importer"
    run "$bin/spin-retrain" "$work/$name.spin" -o "$work/$name-better.spin" --preset paper --iterations 10 \
        --hash-log2 12 --json
    is "$code $(member iterations)" "0 10" "$name: is trained on"
    run "$bin/spin-eval" "$work/$name-better.spin" --json
    is "$code $(grep -c '"camera": 0' "$work/out") $(grep -c '"camera": [12]' "$work/out")" "0 3 0" \
        "$name: its first camera is held out"
    run "$bin/spin-eval" "$work/$name-better.spin" --json --test-cams 1,2
    is "$code $(grep -c '"camera": 0' "$work/out") $(grep -c '"camera": [12]' "$work/out")" "0 0 6" \
        "$name: or others, as asked"
    greater "$(member psnr)" 0
    ok $? "$name: their pictures are measured"
    run "$bin/spin-export" "$work/$name-better.spin" --to ply -o "$work/$name"
    is "$code $(ls "$work/$name" | grep -c '^frame_0000[012].ply$')" "0 3" "$name: goes out as PLY"
    run "$bin/spin-export" "$work/$name-better.spin" --to images --views all -o "$work/$name-images"
    is "$code $(ls "$work/$name-images" | grep -c png)" "0 9" "$name: every view of it is drawn"
done <<SETS
films 4danyone_mini/clip 4danyone points up: use spin-export --up y
folders easyvolcap_mini/scene easyvolcap its frame rate is unknown
rgba freetimegs_mini/scene colmap its frame rate is 30 per second
SETS
run "$bin/spin-eval" "$work/folders-better.spin" --json --dynamic masks
is "$code" 0 "masks are found"
done_testing
