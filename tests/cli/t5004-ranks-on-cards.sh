#!/bin/sh
# Several processes train on emulated cards: the sums of a step go from card to card by an emulated NCCL, or through
# page-locked memory, or where there is none through ordinary memory, and the bundle of two is the same; and what is said
# when NCCL fails, or a process while others wait for its part.
# K: ranks mpi cuda emu device retrain test-card
. tests/cli/lib.sh
. tests/cli/ranks.sh

SPIN_CUDA_SHIM=$(cd "$build" && pwd)/tests/emu/spin-cuda.so
SPIN_EMU_COPIES=$work/copies
SPIN_NCCL=$(cd "$build" && pwd)/tests/emu/nccl.so
export SPIN_CUDA_SHIM SPIN_EMU_COPIES SPIN_NCCL
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

by_host='all-reduce between GPUs: through page-locked host memory: '
by_nccl='all-reduce between GPUs: with NCCL 2.0.0$'
for n in 2 3; do
    batch=$((n - n / 3)) # of three one has no image
    retrain $n staged $network --batch $batch
    is "$code" 0 "$n processes on a card"
    err_has "${by_host}ranks 0 and 1 use the same GPU$" "and -v says how sums go, and why"
    pinned=$(copied pinned)
    [ "$pinned" -gt 100000 ]
    ok $? "they went through page-locked memory ($pinned bytes)"
    SPIN_EMU_PINNED=0 retrain $n ordinary $network --batch $batch
    err_has "all-reduce between GPUs: through ordinary host memory" "where none can be page-locked, ordinary memory"
    is "$(copied pinned)" 0 "and that alone"
    same "$n processes" staged ordinary
    SPIN_EMU_CARDS=$n retrain $n linked $network --batch $batch
    is "$code" 0 "$n processes on a card each"
    err_has "$by_nccl" "and -v says that sums go by NCCL"
    is "$(copied pinned)" 0 "nothing goes through page-locked memory"
    [ $n = 3 ] || same "two processes with NCCL" staged linked
    [ $n = 3 ] || mv "$work/linked.spin" "$work/two.spin"
done
SPIN_NCCL=0 retrain 2 tracks $tracks --batch 2
is "$code" 0 "tracks that are densified"
err_has "${by_host}NCCL is disabled: SPIN_NCCL is 0$" "SPIN_NCCL=0 turns NCCL off"
[ "$(copied pinned)" -gt 100000 ]
ok $? "their sums too go through page-locked memory"
SPIN_EMU_CARDS=2 retrain 2 tracks-linked $tracks --batch 2
err_has "$by_nccl" "and with NCCL from card to card"
same "tracks" tracks tracks-linked

# ---- NCCL is not there, or fails

SPIN_EMU_CARDS=2 SPIN_NCCL=$work/none.so retrain 2 none $network --batch 2
is "$code" 0 "without libnccl"
err_has "${by_host}cannot load NCCL: .*none.so" "sums go through the host, and -v says why"
same "without libnccl" none two
for name in ncclGetUniqueId ncclCommInitRank ncclAllReduce ncclGroupEnd; do
    began=$(date +%s)
    SPIN_EMU_NCCL_FAIL=$name SPIN_EMU_CARDS=2 retrain 2 fails $network --batch 2
    took=$(($(date +%s) - began))
    is "$code" 1 "$name fails"
    err_has "^spin-retrain: .*NCCL failed in $name: unhandled system error" "and the message names it"
    is "$(grep -c '^spin-retrain: ' "$work/err")" 1 "once"
    [ "$took" -lt 60 ]
    ok $? "within seconds ($took)"
done

# fail VARIABLE=VALUE TEXT: the second process alone has it, while the first waits for its part.
fail() {
    began=$(date +%s)
    run $mpirun -n 2 sh -c '[ "$OMPI_COMM_WORLD_RANK" = 0 ] || export "$0"; exec "$@"' "$1" \
        "$bin/spin-retrain" "$in" -o "$work/fails.spin" --force --threads 1 -v --device cuda --scale 0.1 \
        --iterations 3 $network --batch 2
    took=$(($(date +%s) - began))
    is "$code" 1 "one process fails: $2"
    err_has "$by_nccl" "which were linked"
    err_has "^spin-retrain: .*$2" "its message is the one that is seen"
    is "$(grep -c '^spin-retrain: ' "$work/err")" 1 "once"
    [ "$took" -lt 60 ]
    ok $? "within seconds ($took)"
}
SPIN_EMU_CARDS=2
export SPIN_EMU_CARDS
fail SPIN_EMU_LOST=300 "the GPU is lost"
fail SPIN_EMU_NCCL_FAIL=ncclAllReduce "NCCL failed in ncclAllReduce"
done_testing
