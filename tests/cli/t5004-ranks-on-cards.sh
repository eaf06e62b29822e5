#!/bin/sh
# Several processes train on emulated GPUs: MPI sums gradients in page-locked memory, or in ordinary
# memory if none can be page-locked, and the bundle is the same. A message if a process fails while
# others wait for its gradients.
# K: ranks mpi cuda emu device retrain test-card
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
# Bytes sent through ordinary or pinned memory, summed over the ranks.
copied() { awk -v kind="$1" '{ for (i = 1; i < NF; i++) if ($i == kind) n += $(i + 1) } END { printf "%d\n", n }' "$work/copies"; }
same() { # NAME FILE FILE
    cmp -s "$work/$2.spin" "$work/$3.spin"
    ok $? "$1: the same bundle"
}

for n in 2 3; do
    batch=$((n - n / 3)) # with three ranks, one has no image
    retrain $n pinned $network --batch $batch
    is "$code" 0 "$n processes on a GPU"
    err_has "all-reduce between GPUs uses page-locked host memory$" "and -v says how gradients are summed"
    pinned=$(copied pinned)
    [ "$pinned" -gt 100000 ]
    ok $? "they went through page-locked memory ($pinned bytes)"
    SPIN_EMU_PINNED=0 retrain $n ordinary $network --batch $batch
    err_has "all-reduce between GPUs uses ordinary host memory$" "if none can be page-locked, ordinary memory"
    is "$(copied pinned)" 0 "and that alone"
    same "$n processes" pinned ordinary
    SPIN_EMU_CARDS=$n retrain $n own $network --batch $batch
    is "$code" 0 "$n processes with a GPU each"
    same "$n GPUs" pinned own
done
retrain 2 tracks $tracks --batch 2
is "$code" 0 "tracks that are densified"
[ "$(copied pinned)" -gt 100000 ]
ok $? "their sums too go through page-locked memory"
SPIN_EMU_PINNED=0 retrain 2 tracks-ordinary $tracks --batch 2
same "tracks" tracks tracks-ordinary

# The GPU of the second process is lost while the first waits for its gradients.
began=$(date +%s)
run $mpirun -n 2 sh -c '[ "$OMPI_COMM_WORLD_RANK" = 0 ] || export SPIN_EMU_LOST=300; exec "$@"' sh \
    "$bin/spin-retrain" "$in" -o "$work/fails.spin" --force --threads 1 -v --device cuda --scale 0.1 \
    --iterations 3 $network --batch 2
took=$(($(date +%s) - began))
is "$code" 1 "one process fails"
err_has "^spin-retrain: .*the GPU is lost" "its message is printed"
is "$(grep -c '^spin-retrain: ' "$work/err")" 1 "once"
[ "$took" -lt 60 ]
ok $? "within seconds ($took)"
done_testing
