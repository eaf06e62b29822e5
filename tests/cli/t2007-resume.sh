#!/bin/sh
# K: long retrain resume
# A training run that was killed or interrupted resumes to the same bits as one that never stopped.
. tests/cli/lib.sh

run_of=$fixtures/d3dgs/trained
data=$fixtures/datasets/panoptic_mini
if [ ! -d "$run_of" ] || [ ! -d "$data" ]; then
    skip "resuming" "no fixtures at $run_of and $data"
    done_testing
fi
bare='--preset paper --device cpu'
net='--levels 4 --hash-log2 10 --finest-resolution 32 --hidden 16'
small="$bare $net"
in=$work/in.spin
run "$bin/spin-import" "$run_of" --data "$data" -o "$in"
is "$code" 0 "imports the run"

# SIGNAL CODE [LENGTH [LENGTH resumed]]: starts a run, stops it with the signal once a checkpoint is
# beside its output, resumes it, and compares it with an uninterrupted one. LENGTH replaces
# --iterations.
stopped() {
    length=${3---iterations $steps}
    rm -f "$work/stopped.spin" "$work/stopped.spin."*
    "$bin/spin-retrain" "$in" -o "$work/stopped.spin" $small $length --save-every 10 \
        >"$work/out" 2>"$work/err" &
    pid=$!
    tries=0
    while [ ! -s "$work/stopped.spin.part" ] && kill -0 $pid 2>/dev/null && [ $tries -lt 600 ]; do
        sleep 0.05
        tries=$((tries + 1))
    done
    caught=$(sed -n 's/^SigCgt:.*\(.\)$/\1/p' /proc/$pid/status)
    kill -"$1" $pid 2>/dev/null
    wait $pid 2>/dev/null
    code=$?
    if [ -e "$work/stopped.spin" ]; then
        skip "stopping with $1" "the run was over before it could be stopped"
        return
    fi
    is "$code" "$2" "stopped by $1: exit code $2"
    [ "$1" = KILL ] ||
        err_has "^spin-retrain: interrupted; the checkpoint of iteration [0-9]* is kept in '.*stopped.spin.part': continue with --resume\$" "$1: says what is kept and how to go on"
    run "$bin/spin-export" "$work/stopped.spin.part" --range 1:2 --to ply -o "$work/as-it-was" --force
    if [ "$1" = KILL ]; then
        fails 1 spin-export "a state without its clip"
    else
        is "$code $(ls "$work/as-it-was" | tr '\n' ' ')" "0 frame_00001.ply sequence.json " "the clip as it was is exported ($1)"
        err_has "is the checkpoint of an unfinished training: reading the clip that was saved with it, '.*stopped.spin.part.spin'\$" "and called that"
    fi
    run "$bin/spin-retrain" "$in" -o "$work/stopped.spin" $small $length --save-every 10
    fails 1 spin-retrain "an unfinished run without --resume ($1)"
    run "$bin/spin-retrain" "$in" -o "$work/stopped.spin" $small ${4-$length} \
        --save-every 10 --resume --threads 1
    is "$code" 0 "resumes after $1"
    same_frames "$work/whole.spin" "$work/stopped.spin" "the bits of a run never stopped ($1)"
    nothing_at "$work/stopped.spin." "no unfinished state is left ($1)"
}
steps=200
case ${SPIN_BUILD:-} in *asan* | *tsan* | *ubsan*) steps=60 ;; esac # slower by twenty times
run "$bin/spin-retrain" "$in" -o "$work/whole.spin" $small --iterations $steps
is "$code" 0 "retrains $steps steps"
stopped KILL 137
plain=$small
cp "$work/whole.spin" "$work/plain.spin"
small="$small --residual points"
run "$bin/spin-retrain" "$in" -o "$work/whole.spin" $small --iterations $steps --force
stopped KILL 137
# Densified tracks, with a network and without; then frames that share no splats.
still=$in
"$bin/spin-export" "$in" --to ply -o "$work/apart" -q && rm "$work/apart/sequence.json"
run "$bin/spin-import" "$work/apart" --data "$data" --pair order -o "$work/apart.spin"
for more in "$net --tracks auto" '--method tracks' '--method tracks --lr-tracked 1'; do
    case $more in *lr-tracked*) in=$work/apart.spin ;; esac
    small="$bare $more --densify-every 15 --densify-threshold 1e-5 --max-points 1500 --precision half"
    run "$bin/spin-retrain" "$in" -o "$work/whole.spin" $small --iterations $steps --force
    is "$code" 0 "retrains with $more"
    stopped KILL 137
    run "$bin/spin-retrain" "$in" -o "$work/again.spin" $small --iterations 60 --force --json --precision full
    learned=$(sed -n '/"test": {/,/}/s/.*"psnr": \([0-9.]*\).*/\1/p' "$work/out")
    told=$(member splats_mean)
    run "$bin/spin-eval" "$work/again.spin" --json
    after=$(member psnr)
    awk -v a="$learned" -v b="$after" 'BEGIN { d = a - b; exit !(b != "" && d < 1e-6 && d > -1e-6) }'
    ok $? "$more: the bundle shows what was trained ($learned dB, $after)"
    run "$bin/spin-export" "$work/again.spin" --to ply -o "$work/again" --force --json
    is "$told" "$(member splats_mean)" "$more: and tells how many splats there are now"
done
# One splat per frame has no match in the next.
"$bin/spin-export" "$still" --to ply --decimate 1 -o "$work/lone" -q && rm "$work/lone/sequence.json"
run "$bin/spin-import" "$work/lone" --data "$data" --pair order -o "$work/lone.spin"
run "$bin/spin-retrain" "$work/lone.spin" -o "$work/again.spin" $small --dry-run --json
is "$(member densify_every)" 15 "frames that share no splat are densified, the plan says"
run "$bin/spin-retrain" "$work/lone.spin" -o "$work/again.spin" $small --iterations 60 --force --json
err_has "no tracks, each frame is densified independently" "the run says"
awk -v n="$(member splats_mean)" 'BEGIN { exit !(n > 1) }'
ok $? "and they are: $(member splats_mean) for one"
told=$(member splats_mean)
run "$bin/spin-export" "$work/again.spin" --to ply -o "$work/again" --force --json
is "$told" "$(member splats_mean)" "as the bundle has them"
in=$still
small=$plain
cp "$work/plain.spin" "$work/whole.spin"
stopped TERM 143
# A shell starts background jobs with SIGINT ignored; our handler overrides that.
stopped INT 130
stopped HUP 129
case $caught in [13579bdf]) true ;; *) false ;; esac
ok $? "SIGHUP is caught"
# The clip kept beside an earlier checkpoint is not mistaken for that of a later one.
clip_of_state=$work/stopped.spin.part.spin
rm -f "$work/stopped.spin"*
"$bin/spin-retrain" "$in" -o "$work/stopped.spin" $small --iterations $steps --save-every 10 2>"$work/err" &
pid=$!
while [ ! -s "$work/stopped.spin.part" ] && kill -0 $pid 2>/dev/null; do sleep 0.05; done
kill -INT $pid 2>/dev/null
wait $pid
if [ -e "$work/stopped.spin" ]; then
    skip "the clip of an earlier state" "the run was over before it could be stopped"
else
    [ -s "$clip_of_state" ]
    ok $? "a clip is there"
    "$bin/spin-retrain" "$in" -o "$work/stopped.spin" $small --iterations $steps --save-every 10 --resume 2>"$work/err" &
    pid=$!
    while [ -e "$clip_of_state" ] && kill -0 $pid 2>/dev/null; do sleep 0.02; done
    [ ! -e "$work/stopped.spin" ]
    ok $? "it goes before the training goes on"
    kill -KILL $pid 2>/dev/null
    wait $pid 2>/dev/null
fi
cp "$work/whole.spin" "$clip_of_state"
run "$bin/spin-retrain" "$in" -o "$work/stopped.spin" --device cpu --scale 0.1 --range 0:1 --method frames --refine 2 --force
is "$code" 0 "another method in place of it"
nothing_at "$work/stopped.spin." "and nothing is left"
# A run started under nohup survives its terminal.
rm -f "$work/stopped.spin"*
trap '' HUP
"$bin/spin-retrain" "$in" -o "$work/stopped.spin" $small --iterations $steps --save-every 10 2>"$work/err" &
pid=$!
trap - HUP
while [ ! -s "$work/stopped.spin.part" ] && kill -0 $pid 2>/dev/null; do sleep 0.05; done
kill -HUP $pid 2>/dev/null
wait $pid
is $? 0 "under nohup a run goes on"

# A table much larger than the splats need: each of its lines is updated only when it is used.
small='--preset paper --device cpu --levels 4 --hash-log2 15 --finest-resolution 512 --hidden 16'
run "$bin/spin-retrain" "$in" -o "$work/whole.spin" $small --iterations $steps --force --eval-every 33
is "$code" 0 "retrains with a large table"
stopped KILL 137

# The default recipe: its checkpoint records the chosen number of iterations, so the same number
# given explicitly resumes it.
small='--device cpu --scale 0.1 --range 0:1'
run "$bin/spin-retrain" "$in" -o "$work/whole.spin" $small --force
is "$code" 0 "retrains by the default recipe"
is "$(head -n 1 "$work/err" | sed 's/; about .* here$/; about ... here/')" \
    "preset quick: 1000 iterations, 1 frame; about ... here" "whose choice is the first thing said"
run "$bin/spin-import" --info --json "$work/whole.spin"
is "$(sed -n 's/.*"\(iterations\|densify_every\)": *\([0-9]*\).*/\1 \2/p' "$work/out" | tr '\n' ' ')" \
    "iterations 1000 densify_every 50 " "the bundle has the numbers"
stopped KILL 137 ""
stopped KILL 137 "" "--iterations 1000 --densify-every 50"

done_testing
