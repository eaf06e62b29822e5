#!/bin/sh
# K: hostile bundle network emu
# A network whose levels contradict its other numbers is refused before a device sees it: on the CPU
# and on the (emulated) GPU.
. tests/cli/lib.sh
SPIN_CUDA_SHIM=$(cd "${SPIN_BUILD:-build/release}" && pwd)/tests/emu/spin-cuda.so
export SPIN_CUDA_SHIM
bad=fixtures/hostile/bundle

for device in cpu cuda; do
    run "$bin/spin-export" $bad/network.spin --to ply -o "$work/$device" --device $device -q
    is "$code" 0 "$device: a network as it should be"
    for name in network-hashed-is-not-said network-level-without-rows; do
        run "$bin/spin-export" $bad/$name.spin --to ply -o "$work/bad" --device $device -q
        fails 1 spin-export "$device, $name"
        err_has "$name.spin': meta.json: .* of 'trained.field' contradict each other in level 1" "$device, $name: which level"
        nothing_at "$work/bad" "$device, $name: nothing is written"
    done
done
done_testing
