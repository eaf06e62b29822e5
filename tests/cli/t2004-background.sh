#!/bin/sh
# K: transforms datasets eval
# Images with alpha are composited over the colour that shows behind the splats.
. tests/cli/lib.sh

set=$fixtures/datasets/blender_mini
if [ ! -d "$set" ]; then
    skip "background" "no fixtures at $set"
    done_testing
fi

# One splat that no camera sees, in as many frames as the data set has: renders are pure background.
rows=$(grep -ho '"time": *[0-9.e-]*' "$set"/transforms_train.json "$set"/transforms_test.json |
    sort -u | wc -l)
mkdir "$work/far"
for i in $(seq -w 1 "$rows"); do
    {
        printf '%s\n' ply 'format ascii 1.0' 'element vertex 1'
        for p in x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3; do
            echo "property float $p"
        done
        printf '%s\n' end_header '1e4 1e4 1e4 0 0 0 -9 -5 -5 -5 1 0 0 0'
    } >"$work/far/f$i.ply"
done
run "$bin/spin-import" "$work/far" --data "$set" --pair order -o "$work/far.spin"
is "$code" 0 "a clip of $rows frames with nothing to see"
for colour in black white; do
    run "$bin/spin-eval" "$work/far.spin" --split all --pair order --background $colour --json
    is "$code" 0 "measured over $colour"
    member psnr >"$work/$colour"
done
# Most of each image is transparent, so a render of the same background is close. White composited
# before an image over black would give about 1 dB.
greater "$(cat "$work/white")" 7
ok $? "white is close to the images over white: $(cat "$work/white") dB"
greater "$(cat "$work/black")" 7
ok $? "black is close to the images over black: $(cat "$work/black") dB"
done_testing
