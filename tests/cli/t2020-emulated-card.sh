#!/bin/sh
# The CUDA kernels, emulated on the host: the tests of device operations in one thread order, the
# golden training in another, and once more with the race detector, as far as that is quick. t2024
# runs other orders.
# K: long golden cuda emu kernels device
. "$(dirname "$0")/lib.sh"

build=${SPIN_BUILD:-build/release}
emulated=$(cd "$build" && pwd)/tests/emu
export SPIN_TEST_DEVICE=cuda

# on OBJECT ORDER PROGRAM ARGUMENTS
on() {
    SPIN_CUDA_SHIM=$emulated/$1 SPIN_EMU_ORDER=$2 "$build/tests/$3" $4 >"$work/said" 2>&1
    code=$?
    [ $code = 0 ]
    ok $? "$3 on $1, $2: $(grep -c '^ok' "$work/said") tests"
    [ $code = 0 ] || grep -A 3 -e '^not ok' -e '^emu:' -e ERROR "$work/said" | head -20 | sed 's/^/#   /'
}

for source in tests/device/t-*.c; do
    program=${source#tests/}
    program=${program%.c}
    on spin-cuda.so shuffle:11 "$program"
    case $program in
    */t-blend | */t-no_memory) ;; # t-strict draws smaller pictures
    */t-mlp) TAP_PART=rows_are_compact on spin-cuda-race.so forward "$program" ;;
    *) on spin-cuda-race.so forward "$program" ;;
    esac
done
on spin-cuda.so shuffle:11 card/t-card '300 48 40'
on spin-cuda.so reverse train/t-e2e
for program in t-rows t-tracks t-densify_stats; do # as on a card, whose memory the strict device cannot make
    SPIN_EMU_NAME=H100 on spin-cuda.so shuffle:11 device/$program
done
export SPIN_CUDA_MLP=fp32
on spin-cuda.so shuffle:11 device/t-mlp
unset SPIN_CUDA_MLP
on spin-cuda.so shuffle:11 train/t-lazy_adam
TAP_PART=few_steps on spin-cuda-race.so forward train/t-lazy_adam
done_testing
