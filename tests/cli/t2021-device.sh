#!/bin/sh
# --device: what auto takes and why, and runs on the emulated card: as on the CPU, resumed, without a card, without
# memory, and with a card that is lost. K: cuda emu device retrain
. tests/cli/lib.sh

run_of=$fixtures/d3dgs/trained
data=$fixtures/datasets/panoptic_mini
if [ ! -d "$run_of" ] || [ ! -d "$data" ]; then
    skip "--device" "no fixtures at $run_of and $data"
    done_testing
    exit
fi
small='--levels 2 --hash-log2 8 --finest-resolution 16 --hidden 8 --seed 3'
SPIN_CUDA_SHIM=$(cd "${SPIN_BUILD:-build/release}" && pwd)/tests/emu/spin-cuda.so
export SPIN_CUDA_SHIM
in=$work/in.spin
run "$bin/spin-import" "$run_of" --data "$data" -o "$in"
is "$code" 0 "imports the run"

run "$bin/spin-retrain" "$in" --dry-run $small -v
err_has "device auto: cuda (emulated)" "auto takes the card"
out_has "^device  *cuda (emulated)" "and --dry-run says so"
SPIN_EMU_MEMORY=100000 run "$bin/spin-retrain" "$in" --dry-run $small
out_has "memory .* 91\.6 KiB available" "--dry-run reads the card's memory"
SPIN_EMU_MEMORY=100000 run "$bin/spin-retrain" "$in" -o "$work/poor.spin" $small --iterations 4
fails 1 spin-retrain "a card without memory"
err_has "memory" "and it says what is missing"
SPIN_EMU_CARDS=0 run "$bin/spin-retrain" "$in" --dry-run $small -v
err_has "device auto: the cpu, as: no CUDA device: no CUDA-capable device" "auto without a card says why"
out_has "^device  *cpu" "and takes the CPU"
SPIN_EMU_CARDS=0 run "$bin/spin-retrain" "$in" -o "$work/none.spin" $small --device cuda
fails 1 spin-retrain "cuda without a card"
err_has "no CUDA device" "and it says that there is none"
SPIN_CUDA_SHIM=$work/none.so run "$bin/spin-retrain" "$in" --dry-run $small --device cuda
fails 1 spin-retrain "cuda without its kernels"
err_has "no CUDA device: .*names '$work/none.so', which is not there" "and it says what is missing"

# The log's losses.
losses() { sed -n 's/.*"loss": \([0-9.e+-]*\), "l1".*/\1/p' "$1"; }

for device in cpu cuda; do
    run "$bin/spin-retrain" "$in" -o "$work/$device.spin" $small --iterations 2 --device $device \
        --log "$work/$device.log" --json
    is "$code" 0 "retrains on $device"
    out_has "\"device\": \"$device (" "and says so"
done
losses "$work/cuda.log" >"$work/cuda.losses"
losses "$work/cpu.log" | paste - "$work/cuda.losses" |
    awk '{ d = $1 - $2; if (d > 1e-5 || d < -1e-5) bad = 1; n++ } END { exit bad || n != 2 }'
ok $? "the losses are the CPU's to 1e-5"

for device in cpu cuda; do
    run "$bin/spin-eval" "$work/cuda.spin" --device $device --json
    is "$code" 0 "evaluates on $device"
    sed -n 's/^ *"psnr": \([0-9.]*[0-9]\),*$/\1/p' "$work/out" | head -n 1 >"$work/psnr.$device"
done
paste "$work/psnr.cpu" "$work/psnr.cuda" | awk '{ d = $1 - $2; exit !($1 > 0 && d < 1e-3 && d > -1e-3) }'
ok $? "and its PSNR is the CPU's to 0.001 dB"

SPIN_EMU_LOST=1000 run "$bin/spin-retrain" "$in" -o "$work/lost.spin" $small --iterations 3 --device cuda --save-every 1
is "$code" 1 "a card that is lost ends the training"
err_has "the CUDA device failed: emulated: the card is lost; .* go on with --resume" "and it says so"
[ ! -e "$work/lost.spin" ] && ls -d "$work"/lost.spin.part* >"$work/parts" 2>&1
ok $? "no output, and the state is kept"
run "$bin/spin-retrain" "$in" -o "$work/lost.spin" $small --iterations 3 --device cuda --save-every 1 --resume
is "$code" 0 "resumes on a card that works"
done_testing
