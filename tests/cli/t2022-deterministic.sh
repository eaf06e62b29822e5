#!/bin/sh
# --deterministic on the emulated GPU: the same bits for any thread order, also after the GPU was
# lost, whereas without it they differ; and the memory it takes. The CPU needs no such option.
# K: cuda emu device retrain resume test-card
. tests/cli/lib.sh

SPIN_CUDA_SHIM=$(cd "${SPIN_BUILD:-build/release}" && pwd)/tests/emu/spin-cuda.so
export SPIN_CUDA_SHIM
in=$work/in.spin
# A table of which an iteration needs few lines: lazy Adam
small='--preset paper --levels 2 --hash-log2 18 --finest-resolution 512 --hidden 8 --iterations 5 --batch 1 --scale 0.2 -q'
run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$in" --range 0:3
is "$code" 0 "imports a clip"

# retrain ORDER OUTPUT OPTION...
retrain() {
    SPIN_EMU_ORDER=$1
    export SPIN_EMU_ORDER
    out=$2
    shift 2
    run "$bin/spin-retrain" "$in" -o "$work/$out.spin" $small "$@"
}
retrain forward forward --device cuda
is "$code" 0 "retrains on a card"
retrain reverse reverse --device cuda
! cmp -s "$work/forward.spin" "$work/reverse.spin"
ok $? "by default another order of threads shows in the last bits"
retrain forward one --device cuda --deterministic
is "$code" 0 "retrains with --deterministic"
for order in reverse shuffle:5; do
    retrain $order other --device cuda --deterministic --force
    cmp -s "$work/one.spin" "$work/other.spin"
    ok $? "with --deterministic the bundle is the same, $order"
done
SPIN_EMU_LOST=700 retrain reverse lost --device cuda --deterministic --save-every 1
is "$code" 1 "a card is lost, and says so"
err_has "the GPU is lost; the checkpoint of iteration [1-9] is kept" "with a state kept"
grep -q 'table/last' "$work/lost.spin.part"
ok $? "that has the steps of the table's lines"
retrain shuffle:9 lost --device cuda --deterministic --save-every 1 --resume
cmp -s "$work/one.spin" "$work/lost.spin"
ok $? "and the run that goes on ends in the same bundle"

retrain forward cpu --device cpu
retrain forward cpu-too --device cpu --deterministic
is "$code" 0 "the cpu takes --deterministic"
cmp -s "$work/cpu.spin" "$work/cpu-too.spin"
ok $? "and gives the same bundle with it"

# needed DEVICE OPTION...
needed() {
    device=$1
    shift
    run "$bin/spin-retrain" "$in" --dry-run --json --preset paper --levels 4 --hash-log2 18 --device "$device" "$@"
    sed -n 's/^ *"bytes_needed": \([0-9]*\).*/\1/p' "$work/out"
}
plain=$(needed cuda)
more=$(needed cuda --deterministic)
is $((more - plain)) $((8 * 4 * (4096 + 3 * 262144))) "on a card it takes 8 bytes more for a parameter of the table"
is "$(needed cpu --deterministic)" "$(needed cpu)" "on the cpu nothing"
done_testing
