#!/bin/sh
# K: long retrain renders flipbook 4d
# Frames without images: a data set rendered from the clip itself, and 4D splats trained on it.
. tests/cli/lib.sh

run "$bin/spin-import" --from d3dgs $clip -o "$work/run.spin"
run "$bin/spin-export" "$work/run.spin" --to ply -o "$work/frames"
is "$code" 0 "writes a folder of frames"
rm -f "$work/frames/sequence.json"
run "$bin/spin-import" --from ply "$work/frames" -o "$work/clip.spin"
is "$code" 0 "imports it"

# ---- The data set ------------------------------------------------------------------------------

views=renders:cameras=9,test=4,size=96x64
run "$bin/spin-eval" "$work/clip.spin" --data renders --data-from $views --json
is "$code $(member psnr | awk '{ print ($1 > 55) }')" "0 1" "the clip looks like its own renders"
run "$bin/spin-retrain" "$work/clip.spin" -o "$work/a.spin" --data renders --data-from $views --iterations 20 \
    --residual source --threads 1
is "$code" 0 "trains on renders"
err_has "54 training and 24 test views" "of nine and four cameras"
run "$bin/spin-retrain" "$work/clip.spin" -o "$work/b.spin" --data-from $views --iterations 20 \
    --residual source --threads 2
cmp -s "$work/a.spin" "$work/b.spin"
ok $? "--data may be left out, and threads do not change the result"
run "$bin/spin-eval" "$work/a.spin" --json
is "$code $(member psnr | awk '{ print ($1 > 20) }')" "0 1" "the bundle names its renders"
run "$bin/spin-eval" "$work/a.spin" --data "$work/clip.spin" --data-from renders:cameras=8,test=1,size=64x48 --json
is "$code" 0 "and others may be drawn from a bundle"
for wrong in size=9 up=w cameras=0 colour=1; do
    run "$bin/spin-eval" "$work/clip.spin" --data renders --data-from renders:$wrong
    fails 2 spin-eval "renders:$wrong"
done

# ---- Pairing -----------------------------------------------------------------------------------

mkdir "$work/five"
for i in 1 2 3 4 5; do
    cp "$work/frames/frame_0000$i.ply" "$work/five/frame_$((i + 100008)).ply"
done
rename() { for f in "$work"/five/*; do mv "$f" "$(echo "$f" | sed 's/frame_1/frame_0/')"; done; }
rename
run "$bin/spin-import" --from ply "$work/five" -o "$work/five.spin"
run "$bin/spin-import" --from ply "$work/five" -o "$work/paired.spin" --data "$work/five.spin" --pair order
is "$code" 0 "a bundle is a data set of renders, paired by order"
run "$bin/spin-eval" "$work/paired.spin" --data $clip --json
is "$code" 0 "another data set is paired anew, by number"

# ---- One command -------------------------------------------------------------------------------

cd "$work" || exit 1
case $bin in /*) ;; *) bin=$OLDPWD/$bin ;; esac
run "$bin/spin4d" frames -o moves.tsog --iterations 60 --json
is "$code" 0 "frames become 4D splats"
err_has "static and stored once" "what stands still is stored once"
is "$(echo $(ls -d moves.*))" "moves.import.spin moves.spin moves.tracks.spin moves.tsog" "what is kept"
flicker=$(python3 -c 'import json,sys; e = json.load(open(sys.argv[1]))["eval"]; print(e["flicker"] < 1 and e["psnr"] > 20)' "$work/out")
is "$flicker" True "it is measured in held-out views"
run "$bin/spin4d" frames -o page.html --data renders --data-from $views --iterations 20
is "$code $(echo $(ls -d page.*))" "0 page.html page.import.spin page.spin" "--data renders retrains for a page too"
run "$bin/spin4d" frames -o plain.tsog --no-retrain
is "$code $(ls -d plain.*.spin 2>/dev/null)" "0 " "--no-retrain converts"
mkdir one && cp "$(ls -d frames/*.ply | head -n 1)" one
run "$bin/spin4d" one -o one.tsog --data renders
fails 1 spin4d "one frame"
err_has "two or more frames" "is refused"
run "$bin/spin4d" one -o one.ply.d --to ply
is "$code" 0 "and converted without --data renders"
done_testing
