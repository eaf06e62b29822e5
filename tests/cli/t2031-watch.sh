#!/bin/sh
# K: watch page
# The page of spin-retrain --watch: the contents of its folder during a training, after Ctrl-C and
# at the end; the result of the training is unchanged.
. tests/cli/lib.sh

"$bin/spin-import" $clip --data $clip --range 0:3 -o "$work/a.spin" -q >/dev/null
short="--iterations 40 --scale 0.5 --threads 1"
# shellcheck disable=SC2086
run "$bin/spin-retrain" "$work/a.spin" -o "$work/plain.spin" $short
# shellcheck disable=SC2086
run "$bin/spin-retrain" "$work/a.spin" -o "$work/b.spin" $short --watch "$work/page" --eval-every 10
is "$code" 0 "a training with a page"
cmp -s "$work/plain.spin" "$work/b.spin"
ok $? "has the same bytes as without"
is "$(ls "$work/page" | tr '\n' ' ')" "clip.html index.html log.jsonl now.js pictures state.spin " "what is in the folder"
is "$(find "$work/page/pictures" -name '*.png' | wc -l)" 8 "a picture of each of two test cameras, four times"
sed -e 's/^show(//' -e 's/)$//' "$work/page/now.js" >"$work/out"
is_json "now.js calls show() with JSON"
for what in '"iteration": *40,' '"iterations": *40,' '"done": *true' 'iteration_0000040.png"' 'PSNR of the test views' \
    'Loss, averaged over intervals of iterations'; do
    out_has "$what" "which has $what"
done
! grep -q 'iteration_0000030' "$work/out"
ok $? "and no older picture"
grep -q 'script.src = "now.js?"' "$work/page/index.html" && grep -q 'clip.html?' "$work/page/index.html"
ok $? "the page asks for it, and plays the clip"
grep -q '"fps":[0-9]' "$work/page/clip.html"
ok $? "the clip is a page"
same_frames "$work/b.spin" "$work/page/state.spin" "state.spin is the last state, as splats"
# shellcheck disable=SC2086
run "$bin/spin-retrain" "$work/a.spin" -o "$work/c.spin" $short --watch "$work/page"
fails 1 spin-retrain "a folder with a page in it"

# ---- The folder of an earlier training -----------------------------------------------------------

touch "$work/page/pictures/cam_mine.png"
# shellcheck disable=SC2086
run "$bin/spin-retrain" "$work/a.spin" -o "$work/e.spin" $short --iterations 10 --watch "$work/page" --eval-every 10 --force
is "$code" 0 "--force replaces the page"
err_has "removed 8 previews of an earlier training from '.*/page/pictures'" "and says how many pictures it removed"
is "$(ls "$work/page/pictures" | tr '\n' ' ')" \
    "cam_00_frame_00001_iteration_0000010.png cam_15_frame_00001_iteration_0000010.png cam_mine.png " "and keeps other files"
mkdir "$work/few" && cp "$work/page/pictures"/*.png "$work/few"
# shellcheck disable=SC2086
run "$bin/spin-retrain" "$work/a.spin" -o "$work/e.spin" $short --iterations 20 --preview "$work/few" --eval-every 20 --force
err_has "removed 2 previews of an earlier training from '.*/few'" "--preview --force does the same"
is "$(ls "$work/few" | tr '\n' ' ')" \
    "cam_00_frame_00001_iteration_0000020.png cam_15_frame_00001_iteration_0000020.png cam_mine.png " "the previews of this run"
cp "$work/page/state.spin" "$work/input.spin"
# shellcheck disable=SC2086
run "$bin/spin-retrain" "$work/page/state.spin" -o "$work/f.spin" $short --watch "$work/page" --force
fails 1 spin-retrain "to train the clip of a page into the same page"
cmp -s "$work/input.spin" "$work/page/state.spin"
ok $? "which stays as it is"
is "$(ls "$work/page/pictures" | wc -l)" 3 "as do its pictures"

# ---- A page that cannot be written ---------------------------------------------------------------

# shellcheck disable=SC2086
"$bin/spin-retrain" "$work/a.spin" -o "$work/d.spin" $short --iterations 40 --eval-every 10 --watch "$work/gone" \
    >"$work/out" 2>"$work/err" &
pid=$!
for _ in $(seq 600); do
    [ -e "$work/gone/log.jsonl" ] && break
    sleep 0.01
done
rm -r "$work/gone" && touch "$work/gone"
wait $pid
is "$?" 1 "the page's folder went away meanwhile"
is "$(grep -c '^warning: .*; the training continues' "$work/err")" 1 "is said once"
cmp -s "$work/plain.spin" "$work/d.spin"
ok $? "the training does not suffer"

# ---- An interrupted training ---------------------------------------------------------------------

"$bin/spin-retrain" "$work/a.spin" -o "$work/cut.spin" --iterations 100000 --scale 0.5 --eval-every 20 --watch "$work/cut" >"$work/out" 2>"$work/err" &
pid=$!
for _ in $(seq 300); do
    grep -q '"iteration"' "$work/cut/now.js" 2>/dev/null && break
    sleep 0.1
done
kill -INT $pid
wait $pid
is "$?" 130 "Ctrl-C"
err_has "is kept in '.*cut.spin.part': continue with --resume" "says what is kept"
run "$bin/spin-export" "$work/cut/state.spin" --to ply -o "$work/ply"
is "$code $(find "$work/ply" -name '*.ply' | wc -l)" "0 3" "the state can be exported"
run "$bin/spin-export" "$work/cut.spin.part" --to ply -o "$work/too"
is "$code $(find "$work/too" -name '*.ply' | wc -l)" "0 3" "and so can the unfinished state itself"
rm "$work/cut.spin.part.spin"
run "$bin/spin-export" "$work/cut.spin.part" --to ply -o "$work/none"
fails 1 spin-export "without its clip"
err_has "checkpoint of an unfinished training: continue it with spin-retrain --resume" "says what it is"
grep -q '"done": *false' "$work/cut/now.js"
ok $? "the page does not say that it is done"
done_testing
