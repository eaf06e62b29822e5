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
    member psnr_opposite >"$work/not-$colour"
done
# Most of each image is transparent, so a render of the same background is close. White composited
# before an image over black would give about 1 dB.
greater "$(cat "$work/white")" 7
ok $? "white is close to the images over white: $(cat "$work/white") dB"
greater "$(cat "$work/black")" 7
ok $? "black is close to the images over black: $(cat "$work/black") dB"
# Their alpha is known everywhere, so the opposite background must give what the other colour gives.
paste "$work/white" "$work/not-black" "$work/black" "$work/not-white" |
    awk '{ exit !($1 != "" && ($1 - $2) ^ 2 < 1e-4 && ($3 - $4) ^ 2 < 1e-4) }'
ok $? "over the opposite background: $(cat "$work/not-black") dB and $(cat "$work/not-white") dB"

# The alpha of these images is learned by default.
is "$(member alpha_known)" true "their alpha is known"
run "$bin/spin-import" fixtures/4dgaussian/coarse_and_fine/model --data fixtures/datasets/blender_mini -o "$work/balls.spin"
learn() {
    run "$bin/spin-retrain" "$work/balls.spin" -o "$work/learnt.spin" --force --device cpu --iterations 20 "$@"
    is "$code" 0 "trains with ${*:-default options}"
    learnt=$("$bin/spin-import" --info --json "$work/learnt.spin" | sed -n 's/.*"learn_alpha": *\([a-z]*\).*/\1/p')
}
learn
err_has '^learning the alpha of the subject from the alpha of the images$' "says that their alpha is learned"
is "$learnt" true "and notes it"
psnr=$("$bin/spin-eval" "$work/learnt.spin" --json | sed -n '1,/"psnr"/s/.*"psnr": \([0-9.]*\).*/\1/p')
learn --learn-alpha off
is "$learnt" "" "--learn-alpha off does not"
differs=$("$bin/spin-eval" "$work/learnt.spin" --json | sed -n '1,/"psnr"/s/.*"psnr": \([0-9.]*\).*/\1/p')
[ -n "$psnr" ] && [ "$psnr" != "$differs" ]
ok $? "which is another training: $psnr dB, $differs dB"
learn --learn-exposure on
is "$learnt" "" "nor is it learned with exposures"
done_testing
