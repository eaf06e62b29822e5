#!/bin/sh
# run.sh [1] [2] [3]: tests a GPU with the kit that tests/card/pack.sh made, in three parts of at
# most nine minutes each (default: all three). Nothing is installed, and only PATH and HOME are
# taken from the environment. Each line names the verdict, the test and its criterion; the last
# line counts the verdicts. All output goes to card-out in the current folder: send it back,
# together with the screen output.
#
# Part 1: the tests of every operation against golden values and the CPU, with timings.
# Part 2: the same under NVIDIA's compute-sanitizer, if installed: memory, races, barriers,
# uninitialised memory.
# Part 3: kernel metrics by NVIDIA's ncu, if installed; trainings compared with the CPU's;
# determinism.
#
# CARD_SHORT=1: small sizes, for the emulation; CARD_SHIM: another spin-cuda.so.
here=$(cd "$(dirname "$0")" && pwd)
out=$PWD/card-out
LIMIT=540 # seconds per part

if [ -z "$CARD_CLEAN" ]; then
    exec env -i CARD_CLEAN=1 CARD_SHORT="$CARD_SHORT" CARD_SHIM="$CARD_SHIM" HOME="${HOME:-/tmp}" \
        PATH="$PATH:/usr/local/cuda/bin:/usr/bin:/bin" LD_LIBRARY_PATH="$here/lib" SPIN_FIXTURES="$here/fixtures" \
        SPIN_BUILD="$here" SPIN_TEST_DEVICE=cuda SPIN_CUDA_SHIM="${CARD_SHIM:-$here/lib/spin-cuda.so}" \
        SPIN_IMAGE_PLAIN_SHIM="$here/lib/spin-image-plain.so" SPIN_PROGRESS=0 /bin/sh "$0" "$@"
fi
mkdir -p "$out" && cd "$here" || exit 1
passed=0 failed=0 left=0

verdict() { # ok|FAIL|left WHAT
    case $1 in
    ok) passed=$((passed + 1)) ;;
    FAIL) failed=$((failed + 1)) ;;
    *) left=$((left + 1)) ;;
    esac
    printf '%-6s %s\n' "$1" "$2" | tee -a "$out/verdicts.txt"
}

# check NAME WHAT COMMAND...: the command must end with exit code 0 within the remaining time of
# the part.
check() {
    name=$1 what=$2
    shift 2
    rest=$((begin + LIMIT - $(date +%s)))
    if [ $rest -lt 5 ]; then
        verdict left "$what: no time is left in this part"
        return 1
    fi
    timeout -k 5 $rest "$@" >"$out/$name.txt" 2>&1
    code=$?
    case $code in
    0) verdict ok "$what" ;;
    124 | 137) verdict left "$what: not done in the time of this part ($out/$name.txt)" ;;
    *)
        verdict FAIL "$what: exit code $code ($out/$name.txt)"
        grep -e '^not ok' -e '^# ' -e failed "$out/$name.txt" | head -n 5 | sed 's/^/         /'
        ;;
    esac
    return $code
}

# program NAME ARGUMENTS: runs one of the tests.
program() {
    name=$1
    shift
    check "$name" "$name $*: no line says 'not ok'" "$here/bin/$name" "$@" || return 1
    grep -v SKIP "$out/$name.txt" | grep -q '^ok' || verdict FAIL "$name: nothing ran"
}

parts=${*:-1 2 3}
{
    uname -a
    nvidia-smi
    nvidia-smi -q -d CLOCK,POWER
    ldd --version
} >"$out/machine.txt" 2>&1

card=20000 large='450000 640 360' small='2000 100 60' sizes=10000,200000,450000 tables=19,21 steps=2000 size='--hash-log2 17'
if [ -n "$CARD_SHORT" ]; then
    card='300 48 40' large='300 48 40' small='300 48 40' sizes=200 tables=10 steps=2
    size='--levels 2 --hash-log2 8 --finest-resolution 16 --hidden 8 --scale 0.1'
fi

part_1() {
    # shellcheck disable=SC2086
    program t-card $card || {
        cat "$out/t-card.txt"
        verdict FAIL "no operation runs: the rest is left out"
        exit 1
    }
    while read -r name; do
        program "$name" </dev/null
    done <"$here/programs"
    # shellcheck disable=SC2086
    [ -n "$CARD_SHORT" ] || program t-card $large
    check bench "bench at $sizes splats: wall ms of each stage, beside tests/bench/README.md" \
        "$here/bin/bench" --device cuda --gaussians $sizes --table $tables --rounds $((CARD_SHORT ? 1 : 7))
}

part_2() {
    if ! command -v compute-sanitizer >/dev/null; then
        verdict left "compute-sanitizer is not here (it comes with the CUDA toolkit)"
        return
    fi
    for tool in memcheck racecheck synccheck initcheck; do
        # shellcheck disable=SC2086
        check $tool "compute-sanitizer $tool: 0 errors in every operation" \
            compute-sanitizer --tool $tool --error-exitcode 3 "$here/bin/t-card" $small
    done
    check memcheck-strict "compute-sanitizer memcheck: 0 errors in t-strict" \
        compute-sanitizer --tool memcheck --error-exitcode 3 "$here/bin/device-t-strict"
}

# The test PSNR of a bundle, on the CPU.
psnr_of() { "$here/bin/spin-eval" "$1" --device cpu --json | sed -n 's/^ *"psnr": \([0-9.]*\),*$/\1/p' | head -n 1; }

part_3() {
    if command -v ncu >/dev/null; then
        # shellcheck disable=SC2086
        check ncu "ncu: time, and the shares of arithmetic, L2 and memory of each kernel" ncu --csv --metrics \
            gpu__time_duration.sum,sm__throughput.avg.pct_of_peak_sustained_elapsed,lts__throughput.avg.pct_of_peak_sustained_elapsed,dram__throughput.avg.pct_of_peak_sustained_elapsed,launch__registers_per_thread,sm__warps_active.avg.pct_of_peak_sustained_active \
            "$here/bin/t-card" $large
    else
        verdict left "ncu is not here (it comes with the CUDA toolkit)"
    fi
    check import "imports fixtures/court-mini" "$here/bin/spin-import" --from d3dgs "$here/fixtures/court-mini" \
        --data "$here/fixtures/court-mini" -o "$out/court.spin" || return
    recipe="--preset paper $size --iterations $steps --seed 3 -q"
    # shellcheck disable=SC2086
    for run in 'cuda cuda' 'cpu cpu' 'first cuda --deterministic' 'second cuda --deterministic'; do
        set -- $run
        to=$1 device=$2
        shift 2
        rm -rf "$out/$to".spin*
        check "train-$to" "$steps steps of the paper's recipe on $device $*" \
            "$here/bin/spin-retrain" "$out/court.spin" -o "$out/$to.spin" $recipe --device "$device" "$@"
    done
    if [ -f "$out/cuda.spin" ] && [ -f "$out/cpu.spin" ]; then
        a=$(psnr_of "$out/cuda.spin") b=$(psnr_of "$out/cpu.spin")
        # Two SIMD paths of the CPU differ by 0.075 dB here.
        if awk -v a="$a" -v b="$b" 'BEGIN { exit !(a > 0 && b > 0 && a - b < 0.15 && b - a < 0.15) }'; then
            verdict ok "test PSNR on the GPU $a, on the CPU $b: within 0.15 dB"
        else
            verdict FAIL "test PSNR on the GPU $a, on the CPU $b: more than 0.15 dB apart"
        fi
    fi
    if [ -f "$out/first.spin" ] && [ -f "$out/second.spin" ]; then
        if cmp "$out/first.spin" "$out/second.spin"; then
            verdict ok "--deterministic twice: the same bytes"
        else
            verdict FAIL "--deterministic twice: not the same bytes"
        fi
    fi
}

for part in $parts; do
    case $part in
    1 | 2 | 3)
        echo "part $part"
        begin=$(date +%s)
        part_"$part"
        ;;
    *)
        echo "usage: run.sh [1] [2] [3]" >&2
        exit 2
        ;;
    esac
done
echo "$passed passed, $failed failed, $left left out; send back $out"
[ "$failed" = 0 ] && [ "$passed" != 0 ]
