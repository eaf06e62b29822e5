#!/bin/sh
# Trainings on the emulated GPU: equal to the CPU's, resumed, with the memory that --dry-run
# estimates, out of memory, and with a lost GPU; the golden training and the device operations in
# thread orders that t2020 lacks. Also the kit for a machine with a GPU, packed and run from an
# empty environment.
# K: long golden cuda emu device retrain resume test-card
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

kept=0
for n in 25 30 35 40 45 50 55 60 65 70; do # in a verb, which wants memory for itself
    rm -f "$work"/poor.spin*
    SPIN_EMU_FULL=$n run "$bin/spin-retrain" "$in" -o "$work/poor.spin" $small --iterations 4
    grep -q "emulated: out of memory: an operation needs [0-9]* bytes of scratch memory" "$work/err" && [ "$code" = 1 ] &&
        kept=1 && break
done
is $kept 1 "a verb without memory ends the run with a message"

larger='--preset paper -q --device cuda --levels 4 --hash-log2 18 --hidden 8 --iterations 2'
run "$bin/spin-retrain" "$in" --dry-run --json $larger
needed=$(member bytes_needed)
SPIN_EMU_MEMORY=$((needed * 16 / 15 + 16))
export SPIN_EMU_MEMORY
run "$bin/spin-retrain" "$in" -o "$work/just.spin" $larger
is "$code" 0 "a run has enough with what --dry-run wants"
SPIN_EMU_MEMORY=$((needed / 2))
run "$bin/spin-retrain" "$in" --dry-run --json $larger
fitting=$(member fitting)
run "$bin/spin-retrain" "$in" -o "$work/fits.spin" $larger $fitting
is "$code" 0 "with half of that, what --dry-run names does run"
unset SPIN_EMU_MEMORY

# The losses in the log.
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
err_has "the CUDA device failed: emulated: the GPU is lost; .* continue with --resume" "and it says so"
named=0
for n in 600 603 800 803; do # in a verb, and not in a copy to the host
    SPIN_CUDA_SYNC=1 SPIN_EMU_LOST=$n run "$bin/spin-retrain" "$in" -o "$work/sync.spin" $small --iterations 3 --device cuda
    grep -q "the GPU is lost (in [a-z_]*)" "$work/err" && named=1 && break
    rm -f "$work"/sync.spin*
done
is $named 1 "SPIN_CUDA_SYNC=1: and in which operation"
[ ! -e "$work/lost.spin" ] && ls -d "$work"/lost.spin.part* >"$work/parts" 2>&1
ok $? "no output, and the state is kept"
run "$bin/spin-retrain" "$in" -o "$work/lost.spin" $small --iterations 3 --device cuda --save-every 1 --resume
is "$code" 0 "resumes on a card that works"

# ---- The golden training

build=${SPIN_BUILD:-build/release}
golden() { # ORDER HEADS
    SPIN_TEST_DEVICE=cuda SPIN_EMU_ORDER=$1 SPIN_CUDA_MLP=$2 "$build/tests/train/t-e2e" >"$work/said" 2>&1
    is $? 0 "the golden training, $1, heads by $2: $(grep -c '^ok' "$work/said") tests"
}
golden shuffle:11 tf32
golden shuffle:11 fp32
for source in tests/device/t-*.c; do
    program=${source#tests/}
    program=${program%.c}
    case $program in */t-no_memory) continue ;; esac # it counts launches
    SPIN_TEST_DEVICE=cuda SPIN_EMU_ORDER=reverse "$build/tests/$program" >"$work/said" 2>&1
    is $? 0 "$program, reverse: $(grep -c '^ok' "$work/said") tests"
done

# ---- The kit

if [ ! -f "$build/lib/spin-cuda.so" ]; then
    skip "the kit for a card" "it needs nvcc"
    done_testing
    exit
fi
run sh tests/card/pack.sh "$build" "$work"
is "$code" 0 "the kit is packed, within its 24 MiB"
mkdir "$work/elsewhere" && tar -C "$work/elsewhere" -xf "$work/spin4d-card.tar.xz"
(cd "$work/elsewhere" && env -i CARD_SHORT=1 CARD_SHIM="$SPIN_CUDA_SHIM" PATH=/usr/bin:/bin \
    sh spin4d-card/run.sh 1 2 3) >"$work/said" 2>&1
is $? 0 "and runs from an empty environment: $(tail -n 1 "$work/said")"
grep -q '^ok .*--deterministic twice: the same bytes' "$work/said" && grep -q '^ok .*within 0.15 dB' "$work/said"
is $? 0 "trainings included"
grep '^FAIL' "$work/said" | sed 's/^/#   /'
done_testing
