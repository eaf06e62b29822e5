#!/bin/sh
# --device: what auto takes and why, and runs on the emulated card: as on the CPU, resumed, without a card, without
# memory, and with a card that is lost. K: long cuda emu device retrain
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
err_has "out of memory on the CUDA device (emulated): [0-9]* bytes are wanted, [0-9]* are free" "and it says how much"
[ ! -e "$work/poor.spin" ]
ok $? "and leaves nothing"
kept=0
for n in 55 60 65 70 75 80 85 90; do # in a verb, which wants memory for itself
    rm -f "$work"/poor.spin*
    SPIN_EMU_FULL=$n run "$bin/spin-retrain" "$in" -o "$work/poor.spin" $small --iterations 4
    grep -q "emulated: out of memory: an operation wants [0-9]* bytes for itself" "$work/err" && [ "$code" = 1 ] &&
        kept=1 && break
done
is $kept 1 "a verb without memory ends the run with a message"

# ---- What would fit

larger='--preset paper -q --device cuda --levels 4 --hash-log2 18 --hidden 8 --iterations 2'
run "$bin/spin-retrain" "$in" --dry-run --json $larger
is "$(member fits)" true "--dry-run: it fits"
is "$(member fitting)" "" "and no other options are named"
needed=$(member bytes_needed)
SPIN_EMU_MEMORY=$((needed * 16 / 15 + 16))
export SPIN_EMU_MEMORY
run "$bin/spin-retrain" "$in" -o "$work/just.spin" $larger
is "$code" 0 "a run has enough with what --dry-run wants"
SPIN_EMU_MEMORY=$((needed / 2))
run "$bin/spin-retrain" "$in" --dry-run $larger
out_has "^ *it does not fit: --hash-log2 1[67] fits$" "with half of that, --dry-run names what fits"
run "$bin/spin-retrain" "$in" --dry-run --json $larger
is "$(member fits)" false "and so does its JSON"
fitting=$(member fitting)
run "$bin/spin-retrain" "$in" -o "$work/not.spin" $larger
fails 1 spin-retrain "half of the memory"
err_has "needs about [1-9][0-9.]* MB of memory and [1-9][0-9.]* MB are free: $fitting fits" "and it says both and what fits"
run "$bin/spin-retrain" "$in" --dry-run --json $larger $fitting
is "$(member fits)" true "which is true"
run "$bin/spin-retrain" "$in" -o "$work/fits.spin" $larger $fitting
is "$code" 0 "and does run"
SPIN_EMU_MEMORY=1000 run "$bin/spin-retrain" "$in" --dry-run $larger
out_has "it does not fit: nothing smaller was found that does" "next to nothing: no options are named"
SPIN_EMU_MEMORY=0 run "$bin/spin-retrain" "$in" --dry-run --json $larger
is "$(member fits)" true "an amount that is not known is no reason to refuse"
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
