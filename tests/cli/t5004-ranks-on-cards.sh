#!/bin/sh
# Several processes train on emulated cards: the messages of a step go through page-locked memory, and through ordinary
# memory where there is none; the bundle is the same, and that of the run again.
# K: ranks mpi cuda emu device retrain
. tests/cli/lib.sh
. tests/cli/ranks.sh

SPIN_CUDA_SHIM=$(cd "$build" && pwd)/tests/emu/spin-cuda.so
SPIN_EMU_COPIES=$work/copies
export SPIN_CUDA_SHIM SPIN_EMU_COPIES
in=$work/in.spin
run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$in" --range 0:4
is "$code" 0 "imports a clip"
network='--preset paper --levels 3 --hash-log2 8 --finest-resolution 16 --hidden 8 --residual points'
tracks='--densify-every 2 --densify-threshold 1e-6'

# retrain N OUTPUT OPTION...
retrain() {
    n=$1
    out=$work/$2.spin
    shift 2
    rm -f "$work/copies"
    ranks "$n" "$bin/spin-retrain" "$in" -o "$out" --force --threads 1 -v --device cuda --deterministic --scale 0.1 \
        --iterations 3 "$@"
}
# Bytes that went by way of ordinary or pinned memory, all ranks together.
copied() { awk -v kind="$1" '{ for (i = 1; i < NF; i++) if ($i == kind) n += $(i + 1) } END { printf "%d\n", n }' "$work/copies"; }
same() { # NAME FILE FILE
    cmp -s "$work/$2.spin" "$work/$3.spin"
    ok $? "$1: the same bundle"
}

for n in 2 3; do
    retrain $n staged $network --batch $((n - n / 3))
    is "$code" 0 "$n processes on a card"
    err_has "messages between processes go through page-locked host memory" "and -v says how messages go"
    pinned=$(copied pinned)
    [ "$pinned" -gt 100000 ]
    ok $? "they went through page-locked memory ($pinned bytes)"
    SPIN_EMU_PINNED=0 retrain $n ordinary $network --batch $((n - n / 3))
    err_has "messages between processes go through ordinary host memory" "where none can be page-locked, ordinary memory"
    is "$(copied pinned)" 0 "and that alone"
    same "$n processes" staged ordinary
done
retrain 2 tracks $tracks --batch 2
is "$code" 0 "tracks that are densified"
[ "$(copied pinned)" -gt 100000 ]
ok $? "their messages too go through page-locked memory"
done_testing
