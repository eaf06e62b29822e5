#!/bin/sh
# K: long retrain resume emu device 4d
# A trained clip as 4D splats, trained again: what is read, refused, kept and written.
. tests/cli/lib.sh

net='--preset quick --seed 3'
run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$work/in.spin"
is "$code" 0 "imports court-mini"
run "$bin/spin-retrain" "$work/in.spin" -o "$work/tracks.spin" $net --method tracks --iterations 300 --device cpu
is "$code" 0 "trains tracks"

run "$bin/spin-retrain" "$work/in.spin" -o "$work/no.spin" --method 4d
fails 1 spin-retrain "a clip that was not trained"
err_has "^spin-retrain: cannot retrain '.*in.spin': --method 4d needs a clip that was trained with --method tracks" \
    "and it says what it begins with"
nothing_at "$work/no" "and nothing is left"
run "$bin/spin-retrain" "$work/in.spin" -o "$work/network.spin" --preset paper --levels 2 --hash-log2 8 \
    --finest-resolution 16 --hidden 8 --iterations 1 --scale 0.2 --device cpu
run "$bin/spin-retrain" "$work/network.spin" -o "$work/no.spin" --method 4d
fails 1 spin-retrain "a clip that a network learned"
err_has "--method 4d needs a clip that was trained with --method tracks" "is refused by the same words"
run "$bin/spin-retrain" "$work/tracks.spin" -o "$work/no.spin" --method 4d --refine 5
fails 2 spin-retrain "--refine beside it"
run "$bin/spin-retrain" "$work/tracks.spin" --dry-run --method 4d --json
is "$code $(member preset)" "0 quick" "--method 4d implies the preset quick"

# Options that have no effect are named.
run "$bin/spin-retrain" "$work/tracks.spin" -o "$work/4d.spin" $net --method 4d --iterations 120 --device cpu \
    --densify-every 10 --hidden 16 --lr-residual 3 --json
is "$code" 0 "trains 4D splats"
err_has "warning: --densify-every has no effect with --method 4d" "densification has no effect there"
err_has "warning: --lr-residual has no effect with --method 4d" "nor have rates of frames"
is "$(member method)" 4d "the report names the method"
psnr=$(sed -n '/"test": {/,/}/s/.*"psnr": \([0-9.]*\).*/\1/p' "$work/out")
before=$(sed -n '/"before": {/,/}/s/.*"psnr": \([0-9.]*\).*/\1/p' "$work/out")
run "$bin/spin-eval" "$work/tracks.spin" --json
is "$(member psnr | cut -c1-7)" "$(echo "$before" | cut -c1-7)" "before is what the trained clip has"
run "$bin/spin-eval" "$work/4d.spin" --json
awk -v a="$(member psnr)" -v b="$psnr" 'BEGIN { d = a - b; exit !(b > 10 && d < 0.02 && d > -0.02) }'
ok $? "the bundle shows what was trained ($psnr dB, $(member psnr))"
awk -v a="$before" -v b="$psnr" 'BEGIN { exit !(b > a - 1) }'
ok $? "at most 1 dB below its clip after 120 steps ($before, $psnr)"
run "$bin/spin-retrain" "$work/tracks.spin" -o "$work/cut.spin" $net --method 4d --iterations 1 --device cpu --json
cut=$(sed -n '/"test": {/,/}/s/.*"psnr": \([0-9.]*\).*/\1/p' "$work/out")
awk -v a="$before" -v b="$cut" 'BEGIN { exit !(b > a - 0.1) }'
ok $? "cutting alone loses less than 0.1 dB ($before, $cut)"
run "$bin/spin-import" --info "$work/4d.spin"
out_has "4D splats" "--info tells of 4D splats"
out_has "^trained     4D splats, 120 iterations on cpu\$" "and how they were trained"
out_has "held-out views after: [0-9.]* dB" "and how good they are"
run "$bin/spin-import" --info "$work/4d.spin" --json
tr -d ' \n' <"$work/out" | grep -q '"trained_4d":{.*"before":{"psnr":.*"test":{"psnr":.*"iterations":120'
ok $? "also as JSON"
run "$bin/spin-eval" "$work/4d.spin" --report "$work/4d.html"
grep -q 'Trained by spin-retrain --iterations 120 --method 4d on cpu' "$work/4d.html"
ok $? "and the page of spin-eval"

# Every other command treats it as a source of 4D splats.
run "$bin/spin4d" "$work/4d.spin" -o "$work/page.html"
is "$code" 0 "spin4d makes a page of it"
grep -q -i iteration "$work/err"
is "$?" 1 "without training it again"
run "$bin/spin-export" "$work/4d.spin" -o "$work/clip.tsog" --check
is "$code" 0 "writes TSOG, read back"
run "$bin/spin-import" "$work/clip.tsog" -o "$work/back.spin"
is "$code" 0 "which can be imported"
run "$bin/spin-retrain" "$work/4d.spin" -o "$work/no.spin" --method 4d --iterations 5
fails 1 spin-retrain "4D splats are no clip of tracks"

# Splats matched from frame to frame: here the frames moved independently, so no splat keeps its
# place.
mkdir "$work/apart"
for f in 0 1 2 3 4 5; do
    rm -rf "$work/one"
    "$bin/spin-export" "$work/in.spin" --source --to ply -o "$work/one" --range $f:$((f + 1)) \
        --translate 0.00$((f * f)),0,0 -q && cp "$work"/one/frame_*.ply "$work/apart/"
done
run "$bin/spin-import" "$work/apart" --from ply --data $clip --pair order -o "$work/apart.spin"
is "$code" 0 "imports frames that share no place"
run "$bin/spin-retrain" "$work/apart.spin" -o "$work/loose.spin" $net --iterations 60 --densify-every 0 --device cpu
err_has "dynamic (matched between neighbouring frames)" "their splats are found again"
run "$bin/spin-retrain" "$work/loose.spin" -o "$work/linked.spin" $net --method 4d --iterations 1 --device cpu --json
is "$code" 0 "they become 4D splats"
rows=$(sed -n 's/^\([0-9]*\) 4D splats.*/\1/p' "$work/err")
all=$("$bin/spin-export" "$work/loose.spin" --to ply -o "$work/all" --json -q | sed -n 's/^  "splats_mean": \([0-9.]*\),*$/\1/p')
echo "# $rows of $all a frame"
cut=$(sed -n '/"test": {/,/}/s/.*"psnr": \([0-9.]*\).*/\1/p' "$work/out")
before=$(sed -n '/"before": {/,/}/s/.*"psnr": \([0-9.]*\).*/\1/p' "$work/out")
awk -v n="$rows" -v all="$all" 'BEGIN { exit !(n > 0 && n < 0.9 * 6 * all) }'
ok $? "fewer than the splats of all frames ($rows, $all a frame)"
awk -v a="$before" -v b="$cut" 'BEGIN { exit !(b > a - 0.3) }'
ok $? "and look like them ($before, $cut)"

# Identical bytes for any number of threads, and after an interruption.
small="$net --method 4d --iterations 60 --device cpu"
run "$bin/spin-retrain" "$work/tracks.spin" -o "$work/one.spin" $small --threads 1
run "$bin/spin-retrain" "$work/tracks.spin" -o "$work/three.spin" $small --threads 3
cmp "$work/one.spin" "$work/three.spin"
ok $? "the same bytes by one thread and three"
"$bin/spin-retrain" "$work/tracks.spin" -o "$work/stopped.spin" $small --save-every 10 >"$work/out" 2>"$work/err" &
pid=$!
tries=0
while [ ! -s "$work/stopped.spin.part" ] && kill -0 $pid 2>/dev/null && [ $tries -lt 600 ]; do
    sleep 0.02
    tries=$((tries + 1))
done
kill -9 $pid 2>/dev/null
wait $pid 2>/dev/null
if [ -e "$work/stopped.spin" ]; then
    skip "stopping" "the run was over before it could be stopped"
else
    run "$bin/spin-retrain" "$work/tracks.spin" -o "$work/stopped.spin" $small --resume
    is "$code" 0 "goes on after a stop"
    err_has "resuming at iteration" "from the state"
    cmp "$work/one.spin" "$work/stopped.spin"
    ok $? "to the same bytes"
fi
run "$bin/spin-retrain" "$work/tracks.spin" -o "$work/one.spin" $small --resume
err_has "is already finished" "a finished run is known again"
run "$bin/spin-retrain" "$work/tracks.spin" --method 4d --dry-run --json
is "$code" 0 "--dry-run tells what it needs"

# The emulated GPU gives the CPU's result.
card=$(cd "${SPIN_BUILD:-build/release}" && pwd)/tests/emu/spin-cuda.so
if [ -f "$card" ]; then
    SPIN_CUDA_SHIM=$card
    export SPIN_CUDA_SHIM
    tiny="$net --method 4d --iterations 4 --scale 0.2"
    run "$bin/spin-retrain" "$work/tracks.spin" -o "$work/cpu.spin" $tiny --device cpu --json
    want=$(sed -n 's/^  "loss": \([0-9.e-]*\),*$/\1/p' "$work/out")
    run "$bin/spin-retrain" "$work/tracks.spin" -o "$work/card.spin" $tiny --device cuda --json
    is "$code" 0 "trains on the emulated card"
    got=$(sed -n 's/^  "loss": \([0-9.e-]*\),*$/\1/p' "$work/out")
    awk -v a="$want" -v b="$got" 'BEGIN { d = (a - b) / a; exit !(a > 0 && d < 1e-4 && d > -1e-4) }'
    ok $? "with the losses of the CPU ($want, $got)"
else
    skip "on the emulated card" "it is not built"
fi
done_testing
