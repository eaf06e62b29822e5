#!/bin/sh
# K: end
# The bundled clip from another program's run to PLY frames: retraining must improve its images.
. tests/cli/lib.sh

run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$work/court.spin" --json
is "$code" 0 "imports the clip"
is "$(member frames)" 6 "six frames"
cp "$work/out" "$work/import.json"
run "$bin/spin-eval" --source --json "$work/court.spin"
is "$code" 0 "measures the source"
is_json "spin-eval --json is one document"
out_has '"camera": 15' "names the held-out cameras"
out_has '"frame": 5' "names the frames by the source's numbers"
is "$(grep -c '"camera":' "$work/out")" 12 "six frames times two cameras"
before=$(member psnr)
is "$(member dynamic_from)" images "what moves is found in the images"
greater "$(member psnr_static)" 0 && greater "$(member psnr_dynamic)" 0
ok $? "and measured apart"
is "$(grep -c '"id":' "$work/out")" 2 "means of two cameras"
greater "$(member fps_draw)" "$(member fps)"
ok $? "frames per second, with and without decoding"
run "$bin/spin-eval" --source "$work/court.spin" -v
is "$(grep -c '^ *[0-9]' "$work/out")" 18 "text: a line a view and a line a frame"
is "$(grep -c '^ *all *[0-9]' "$work/out")" 2 "and a line a camera"
out_has '^size .* on disk, .* per frame' "and what it weighs"
speed=$(sed -n 's/^speed *\([0-9.]*\) frames per second with decoding, \([0-9.]*\) without$/\1 \2/p' "$work/out")
greater "${speed#* }" "${speed% *}"
ok $? "and how fast it is: decoding takes time"
run "$bin/spin-eval" --source "$work/court.spin" --dynamic off --json
is "$(member psnr_dynamic)" "" "or not at all"
run "$bin/spin-eval" --source "$work/court.spin" --dynamic masks
fails 1 spin-eval "masks that are not there"
run "$bin/spin-eval" --source "$work/court.spin" --lpips-lin x.pth
fails 2 spin-eval "half of the weights of LPIPS"
run "$bin/spin-eval" --source "$work/court.spin" --lpips "$work"
fails 1 spin-eval "LPIPS without weights"
err_has 'contains no LPIPS weights' "says what is missing"
run "$bin/spin-eval" --source "$work/court.spin" --lpips-backbone x.pth --lpips-lin x.pth
fails 1 spin-eval "weights that are not there"
err_has "x.pth" "says which"

run "$bin/spin-retrain" "$work/court.spin" -o "$work/better.spin" --preset paper --device cpu --iterations 300 \
    --levels 8 --hash-log2 15 --finest-resolution 128,128,128,8 \
    --sh-degree 1 --head-lr-factor 8 --residual points --eval-every 150 --log "$work/log" --json
is "$code" 0 "retrains"
is_json "spin-retrain --json is one document"
cp "$work/out" "$work/retrain.json"
is "$(member frames)" 6 "of all frames"

run "$bin/spin-eval" --json "$work/better.spin" --images "$work/pictures"
is "$code" 0 "measures the result"
after=$(member psnr)
greater "$after" "$(awk -v b="$before" 'BEGIN { print b + 0.5 }')"
ok $? "the PSNR of held-out views rises by half a decibel at least"
echo "#   psnr_before $before psnr_after $after"
is "$(find "$work/pictures" -name '*.png' | wc -l | tr -d ' ')" 12 "a picture for every view"
awk -v a="$after" '/"test": {/ { t = 1 } t && /"psnr":/ { gsub(/[^0-9.]/, "");
    d = $0 - a; exit !(d < 0.02 && d > -0.02) }' "$work/retrain.json"
ok $? "spin-retrain measured the same"

run "$bin/spin-eval" "$work/better.spin" --report "$work/report.html" --log "$work/log" --dynamic off
is "$code" 0 "writes a report"
is "$(grep -c '<svg class="chart"' "$work/report.html")" 4 "with four curves"
greater "$(grep -c 'src="data:image/png;base64,' "$work/report.html")" 15
ok $? "and pictures"
sed 's/base64,[^"]*//g' "$work/report.html" >"$work/text.html"
grep -q 'Trained by spin-retrain --iterations [0-9]* .* in [0-9.]* minutes' "$work/text.html"
ok $? "how it was trained, and how long, is on top"
! grep -q -i -e 'http' -e '[^a-z]nan[^a-z]' "$work/text.html" && grep -q '</html>' "$work/text.html"
ok $? "nothing from outside, nothing that is not a number"
run "$bin/spin-eval" "$work/better.spin" --report "$work/report.html"
fails 1 spin-eval "a report that is there already"
run "$bin/spin-eval" "$work/better.spin" --log "$work/log"
fails 2 spin-eval "a log without a report"

run "$bin/spin-eval" --source --json "$work/better.spin"
awk -v a="$(member psnr)" -v b="$before" 'BEGIN { d = a - b; exit !(d < 0.001 && d > -0.001) }'
ok $? "the source's attributes are still in the bundle"

run "$bin/spin-export" "$work/better.spin" --to ply -o "$work/ply"
is "$code" 0 "exports"
is "$(ls "$work/ply" | tr '\n' ' ')" \
    "frame_00000.ply frame_00001.ply frame_00002.ply frame_00003.ply frame_00004.ply frame_00005.ply sequence.json " \
    "frames are numbered as the source's"
grep -q '"retrained": true' "$work/ply/sequence.json"
ok $? "sequence.json says that they are retrained"
is "$(head -c 2000 "$work/ply/frame_00000.ply" | grep -ac '^property float f_rest_')" 9 \
    "with the network's degree of SH, not the source's"

done_testing
