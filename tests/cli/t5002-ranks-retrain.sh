#!/bin/sh
# K: ranks mpi retrain test-ranks
# Several processes train one clip, each rendering its share of the images of an iteration. The
# result equals that of a single process except for the order of sums, and is reproducible for one
# number of processes, also after an interruption.
. tests/cli/lib.sh
. tests/cli/ranks.sh

in=$work/in.spin
small='--preset paper --device cpu --levels 8 --hash-log2 10 --finest-resolution 64 --hidden 16'
run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$in" --range 0:5
is "$code" 0 "imports a clip"

psnr() { sed -n '/"test"/,/}/s/.*"psnr": \([0-9.]*\),*$/\1/p' "$work/out"; }
# alike NAME N DB OPTION...: trains with N processes twice, and with one. The PSNR of their test
# views differs by at most DB.
alike() {
    name=$1
    n=$2
    most=$3
    shift 3
    run "$bin/spin-retrain" "$in" -o "$work/one.spin" --force --threads 2 --json "$@"
    is "$code" 0 "$name: one process"
    one=$(psnr)
    ranks "$n" "$bin/spin-retrain" "$in" -o "$work/many.spin" --force --threads 1 --json "$@"
    is "$code" 0 "$name: $n processes"
    many=$(psnr)
    awk -v a="$one" -v b="$many" -v most="$most" 'BEGIN { exit !(a > 0 && (a - b) ^ 2 <= most ^ 2) }'
    ok $? "$name: as good, to $most dB ($one, $many)"
    ranks "$n" "$bin/spin-retrain" "$in" -o "$work/again.spin" --force --threads 2 -q "$@"
    cmp -s "$work/many.spin" "$work/again.spin"
    ok $? "$name: the same bundle again"
}
alike "network" 2 1e-4 $small --iterations 12
alike "network without lazy Adam" 3 1e-4 --preset paper --device cpu --levels 7 --hash-log2 19 \
    --finest-resolution 512 --hidden 16 --iterations 8 --batch 3
alike "residual values, exposures and more views of a frame" 4 1e-3 $small --iterations 8 \
    --residual source --learn-exposure on --batch 6 --views-per-frame 2
alike "more ranks than images of a step, with values of their own" 6 1e-3 $small --iterations 6 \
    --residual points --lr-residual 2 --batch 4 --preview "$work/preview"
alike "several frames of a process, with values of their own" 2 1e-3 $small --iterations 6 \
    --residual points --lr-residual 2 --batch 4
alike "tracks that are densified, with a network" 2 0.01 $small --iterations 12 --tracks auto \
    --densify-every 3 --densify-threshold 1e-6 --densify-until 0.4 --batch 5 --eval-every 5
tracks='--device cpu --scale 0.5 --densify-every 3 --densify-threshold 1e-6 --lr-tracked 1'
for n in 3 4; do
    alike "tracks without a network, several views of a frame" $n 0.01 $tracks --iterations 9 --batch 5 \
        --views-per-frame 2 --preview "$work/preview"
done
together=$in
"$bin/spin-import" fixtures/d3dgs/trained -o "$work/move.spin" -q
"$bin/spin-export" "$work/move.spin" --to ply -o "$work/apart" -q && rm "$work/apart/sequence.json"
run "$bin/spin-import" "$work/apart" --data fixtures/datasets/panoptic_mini --pair order -o "$work/apart.spin"
in=$work/apart.spin
alike "splats that are linked from frame to frame, and densified" 3 0.01 $tracks --iterations 9 --batch 5
run "$bin/spin-retrain" "$in" -o "$work/one.spin" --force -v $tracks --iterations 9 --batch 5
err_has "^iteration 3: .*[1-9][0-9]* splits, .*; now [1-9][0-9]* tracks$" "they are"
in=$together

ranks 3 "$bin/spin-retrain" "$in" --dry-run --device cpu --batch 2
err_has "^warning: an iteration has 2 images (--batch 2), so only 2 of 3 processes work: give --batch 3, or start fewer" \
    "a step of fewer images than processes is said"
ranks 3 "$bin/spin-retrain" "$in" --dry-run --device cpu --batch 3
is "$(grep -c 'processes draw' "$work/err")" 0 "one of as many is not"

# ---- Resume

# start_ranks N OUTPUT SIGNAL RANK: N processes write a checkpoint, then one of them gets the
# signal.
start_ranks() {
    rm -f "$work"/pid.* "$2".part
    $mpirun -n "$1" sh -c 'echo $$ >"$0.$OMPI_COMM_WORLD_RANK" && exec "$@"' "$work/pid" \
        "$bin/spin-retrain" "$in" -o "$2" -q --threads 1 $small $own --save-every 5 \
        >"$work/out" 2>"$work/err" </dev/null &
    job=$!
    waited=0
    until [ -f "$2.part" ] || [ $waited = 100 ]; do
        sleep 0.1
        waited=$((waited + 1))
    done
    began=$(date +%s)
    kill "-$3" "$(cat "$work/pid.$4")"
    wait $job
    code=$?
    took=$(($(date +%s) - began))
}

go_on() { # N OUTPUT NAME
    [ -f "$2.part" ]
    ok $? "$3: the state is there"
    ranks "$1" "$bin/spin-retrain" "$in" -o "$2" --threads 1 $small $own --save-every 5 --resume
    is "$code" 0 "$3: $1 processes go on"
    err_has 'resuming at iteration [1-9]' "$3: from that state"
    cmp -s "$work/whole.spin" "$2"
    ok $? "$3: to the same bundle"
}

own='--residual points --iterations 120'
ranks 2 "$bin/spin-retrain" "$in" -o "$work/whole.spin" -q --threads 1 $small $own
is "$code" 0 "two processes without a stop"
ranks 2 timeout 60 "$bin/spin-retrain" "$in" -o "$work/whole.spin" --threads 1 $small $own --resume
is "$code" 0 "both end if there is nothing left to do"
err_has "whole.spin' is already finished" "and one says so"
start_ranks 2 "$work/signal.spin" INT 1
is "$code" 130 "SIGINT to the second of two ends both"
is "$(grep -c '^spin-retrain' "$work/err")" 1 "with one message"
err_has "^spin-retrain: interrupted; the checkpoint of iteration [0-9]* is kept in '.*signal.spin.part': continue with --resume\$" "which says what happened"
[ "$took" -lt 10 ]
ok $? "within seconds ($took)"
go_on 2 "$work/signal.spin" "interrupted"
start_ranks 2 "$work/kill.spin" KILL 1
[ "$code" != 0 ] && [ "$took" -lt 10 ]
ok $? "a killed one ends all, within seconds ($took)"
is "$(grep -c '^spin-retrain' "$work/err")" 0 "mpirun says so, and nobody else"
go_on 2 "$work/kill.spin" "killed"

own='--tracks auto --densify-every 20 --densify-threshold 5e-4 --densify-until 0.7 --batch 2 --iterations 60'
ranks 3 "$bin/spin-retrain" "$in" -o "$work/whole.spin" --force -q --threads 1 $small $own
is "$code" 0 "with tracks, three processes without a stop"
ranks 3 "$bin/spin-retrain" "$in" -o "$work/saved.spin" -q --threads 1 $small $own --save-every 5
cmp -s "$work/whole.spin" "$work/saved.spin"
ok $? "that keep states on their way learn the same"
start_ranks 3 "$work/tracks.spin" INT 0
is "$code" 130 "SIGINT to the first of three ends all"
go_on 3 "$work/tracks.spin" "tracks"

# ---- A full disk for one of the processes: files of at most 512 bytes, or 20 KB

# full RANK BLOCKS COMMAND...
full() {
    rank=$1
    blocks=$2
    shift 2
    began=$(date +%s)
    run $mpirun --mca btl tcp,self -n 2 sh -c '[ "$OMPI_COMM_WORLD_RANK" != "$0" ] || ulimit -f "$1"; shift; exec "$@"' \
        "$rank" "$blocks" "$@"
    took=$(($(date +%s) - began))
}
full 0 8 "$bin/spin-retrain" "$in" -o "$work/full.spin" -q --threads 1 $small --iterations 120 --save-every 20
is "$code" 1 "no room for the state: exit code 1"
is "$(grep -c '^spin-retrain: .*full.spin.*' "$work/err")" 1 "one message says which file"
[ "$took" -lt 20 ] && [ ! -e "$work/full.spin" ]
ok $? "within seconds ($took), and nothing is half-written"
full 1 1 "$bin/spin-eval" "$in" --source --images "$work/pictures"
is "$code" 1 "no room for the pictures of the second: exit code 1"
is "$(grep -c '^spin-eval: .*pictures/.*png' "$work/err")" 1 "one message says which file"
[ "$took" -lt 20 ]
ok $? "within seconds ($took)"
done_testing
