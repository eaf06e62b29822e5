#!/bin/sh
# --device: what auto chooses and why, unusable GPUs, GPU memory and what would fit into it.
# Trainings are in t2024.
# K: cuda emu device retrain
. tests/cli/lib.sh

run_of=$fixtures/d3dgs/trained
data=$fixtures/datasets/panoptic_mini
if [ ! -d "$run_of" ] || [ ! -d "$data" ]; then
    skip "--device" "no fixtures at $run_of and $data"
    done_testing
    exit
fi
small='--preset paper --levels 2 --hash-log2 8 --finest-resolution 16 --hidden 8 --seed 3'
SPIN_CUDA_SHIM=$(cd "${SPIN_BUILD:-build/release}" && pwd)/tests/emu/spin-cuda.so
export SPIN_CUDA_SHIM
in=$work/in.spin
run "$bin/spin-import" "$run_of" --data "$data" -o "$in"
is "$code" 0 "imports the run"

run "$bin/spin-retrain" "$in" --dry-run $small -v
err_has "device auto: cuda (emulated)" "auto takes the card"
out_has "^device  *cuda (emulated)" "and --dry-run says so"
SPIN_EMU_MEMORY=100000 run "$bin/spin-retrain" "$in" --dry-run $small
out_has "memory .* 93\.8 kB available" "--dry-run reads the card's memory"
SPIN_EMU_MEMORY=100000 run "$bin/spin-retrain" "$in" -o "$work/poor.spin" $small --iterations 4
fails 1 spin-retrain "a card without memory"
err_has "memory" "and it says what is missing"
SPIN_EMU_FULL=20 run "$bin/spin-retrain" "$in" -o "$work/poor.spin" $small --iterations 4 -q
fails 1 spin-retrain "a card whose memory others take"
err_has "out of memory on the CUDA device (emulated): [0-9]* bytes requested, [0-9]* free" "and it says how much"
[ ! -e "$work/poor.spin" ]
ok $? "and leaves nothing"

# ---- What would fit

larger='--preset paper -q --device cuda --levels 4 --hash-log2 18 --hidden 8 --iterations 2'
run "$bin/spin-retrain" "$in" --dry-run --json $larger
is "$(member fits)" true "--dry-run: it fits"
is "$(member fitting)" "" "and no other options are named"
needed=$(member bytes_needed)
export SPIN_EMU_MEMORY
SPIN_EMU_MEMORY=$((needed / 2))
run "$bin/spin-retrain" "$in" --dry-run $larger
out_has "^ *it does not fit: --hash-log2 1[67] would fit$" "with half of that, --dry-run names what fits"
run "$bin/spin-retrain" "$in" --dry-run --json $larger
is "$(member fits)" false "and so does its JSON"
fitting=$(member fitting)
run "$bin/spin-retrain" "$in" -o "$work/not.spin" $larger
fails 1 spin-retrain "half of the memory"
err_has "needs about [1-9][0-9.]* MB of memory, but only [1-9][0-9.]* MB are free: use $fitting, which fits" "and it says both and what fits"
run "$bin/spin-retrain" "$in" --dry-run --json $larger $fitting
is "$(member fits)" true "which is true"
SPIN_EMU_MEMORY=1000 run "$bin/spin-retrain" "$in" --dry-run $larger
out_has "it does not fit: no smaller setting was found that would" "next to nothing: no options are named"
SPIN_EMU_MEMORY=0 run "$bin/spin-retrain" "$in" --dry-run --json $larger
is "$(member fits)" true "an amount that is not known is no reason to refuse"
SPIN_EMU_MEMORY=0 run "$bin/spin-retrain" "$in" -o "$work/any.spin" $small --iterations 1 -q
is "$code" 0 "by a run either"
run "$bin/spin-retrain" "$in" --dry-run --json $small # here pictures and splats of many frames are most of it
SPIN_EMU_MEMORY=$(($(member bytes_needed) * 16 / 15 + 16))
run "$bin/spin-retrain" "$in" -o "$work/just.spin" $small --iterations 1 -q
is "$code" 0 "a run has enough with what --dry-run wants"
unset SPIN_EMU_MEMORY
run "$bin/spin-retrain" "$in" --dry-run --json --preset paper --device cpu --features 8 --hash-log2 26
if greater "$(member bytes_needed)" "$(member bytes_available)"; then
    is "$(member fits)" false "more than the machine has does not fit"
    run "$bin/spin-retrain" "$in" --dry-run --json --preset paper --device cpu --features 8 --hash-log2 26 $(member fitting)
    is "$(member fits)" true "and what it names does"
else
    skip "more than the machine has" "it has a lot"
fi

SPIN_EMU_CARDS=0 run "$bin/spin-retrain" "$in" --dry-run $small -v
err_has "device auto: using the CPU: no CUDA device: no CUDA-capable device" "auto without a card says why"
out_has "^device  *cpu" "and takes the CPU"
SPIN_EMU_OLD=1 SPIN_EMU_CARDS=2 run "$bin/spin-retrain" "$in" --dry-run $small -v
err_has "device auto: cuda (emulated)" "of two cards the first has no code: auto takes the other"
SPIN_EMU_OLD=1 run "$bin/spin-retrain" "$in" --dry-run $small
err_has "device auto: using the CPU: no CUDA device: GPU 0: no kernel image" "a card that is left idle is told without -v"
out_has "^device  *cpu" "and auto takes the CPU"
SPIN_EMU_CARDS=old run "$bin/spin-retrain" "$in" --dry-run $small
err_has "device auto: using the CPU: no CUDA device: .*driver version is insufficient" "and so is a driver that is too old"
SPIN_EMU_CARDS=0 run "$bin/spin-retrain" "$in" --dry-run $small
grep -q "device auto" "$work/err"
is $? 1 "where there is no card, nothing is said"
SPIN_EMU_CARDS=0 run "$bin/spin-retrain" "$in" -o "$work/none.spin" $small --device cuda
fails 1 spin-retrain "cuda without a card"
err_has "no CUDA device" "and it says that there is none"
SPIN_CUDA_SHIM=$work/none.so run "$bin/spin-retrain" "$in" --dry-run $small --device cuda
fails 1 spin-retrain "cuda without its kernels"
err_has "no CUDA device: .*is '$work/none.so', which does not exist" "and it says what is missing"

done_testing
