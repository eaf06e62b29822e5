#!/bin/sh
# On the emulated GPU: refinement with densification, the default recipe, evaluation and export,
# each compared with the CPU; Ctrl-C and --resume; and out of memory or a lost GPU: a message, and
# no half-written output.
# K: cuda emu device refine export resume test-card
. tests/cli/lib.sh

build=${SPIN_BUILD:-build/release}
SPIN_CUDA_SHIM=$(cd "$build" && pwd)/tests/emu/spin-cuda.so
export SPIN_CUDA_SHIM
in=$work/in.spin
run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$in"
is "$code" 0 "imports a clip"

# retrain OUTPUT DEVICE OPTION...
retrain() {
    out=$work/$1.spin
    device=$2
    shift 2
    run "$bin/spin-retrain" "$in" -o "$out" --device "$device" --scale 0.1 --force "$@"
}
# Compares the logs of cpu and cuda: the losses of the first N iterations of one frame, or of all,
# within LIMIT.
same_losses() { # NAME N LIMIT [FRAME]
    for device in cpu cuda; do
        grep -e "$4" "$work/$1-$device.log" | sed -n 's/^[^}]*"loss": \([0-9.e+-]*\), "[ls].*/\1/p' | head -n "$2" \
            >"$work/$device.losses"
    done
    paste "$work/cpu.losses" "$work/cuda.losses" |
        awk -v n="$2" -v most="$3" '{ d = $1 - $2; if (d > most || d < -most) bad = NR } END { exit bad || NR != n }'
    ok $? "$1: the losses of $2 steps are the CPU's to $3"
}
# Two numbers differ by no more than that.
near() { # A B LIMIT NAME
    awk -v a="$1" -v b="$2" -v most="$3" 'BEGIN { d = a - b; exit !(a != "" && b != "" && d <= most && d >= -most) }'
    ok $? "$4 ($1, $2)"
}
# The sum of one number of the log over all lines.
total() { sed -n 's/.*"'"$1"'": \([0-9]*\).*/\1/p' "$2" | awk '{ n += $1 } END { print n + 0 }'; }
learned() { sed -n '/"test": {/,/}/s/.*"psnr": \([0-9.]*\).*/\1/p' "$work/out"; }

# ---- Refinement. After a densification runs diverge, on two kinds of CPU too: here by up to 0.4 dB

frames='--method frames --refine 136 --range 0:2 --test-cams 0'
for device in cpu cuda; do
    retrain "refined-$device" $device $frames --log "$work/refined-$device.log" --json
    is "$code" 0 "refines two frames on $device"
    learned >"$work/psnr-$device"
    for what in clones splits; do
        total $what "$work/refined-$device.log" >"$work/$what-$device"
    done
done
same_losses refined 100 2e-4 '"views": \[\[1,'
for what in clones splits; do
    n=$(cat "$work/$what-cpu")
    [ "$n" -gt 0 ]
    ok $? "refining: there are $what"
    near "$(cat "$work/$what-cuda")" "$n" $((n / 50 + 1)) "refining: as many $what as on the CPU, to 2 %"
done
near "$(cat "$work/psnr-cuda")" "$(cat "$work/psnr-cpu")" 0.8 "refining: PSNR within 0.8 dB of the CPU's"
run "$bin/spin-retrain" "$in" --dry-run --json --device cuda --scale 0.1 $frames
is "$(member iterations)" 136 "--dry-run: the iterations of a frame"
needed=$(member bytes_needed)
SPIN_EMU_MEMORY=$((needed * 16 / 15 + 16))
export SPIN_EMU_MEMORY
retrain just cuda $frames -q
is "$code" 0 "refines with what --dry-run wants"
unset SPIN_EMU_MEMORY
run "$bin/spin-retrain" "$in" --dry-run --device cuda $frames
out_has "^work  *136 iterations on each frame, 2 frames, " "which says what is done"
out_has "^time  *not known on a GPU$" "and that the time is not known"

# ---- The default recipe, preceded by refinement whose splats it uses

tracks='--range 0:2 --test-cams 0 --iterations 40 --densify-every 20 --densify-threshold 1e-4'
for device in cpu cuda; do
    retrain "tracks-$device" $device $tracks --log "$work/tracks-$device.log" --json
    is "$code" 0 "the default recipe on $device"
    learned >"$work/psnr-$device"
    member splats_mean >"$work/splats-$device"
done
same_losses tracks 20 1e-4 ''
greater "$(cat "$work/splats-cuda")" 3500
ok $? "the default recipe: splats are added"
near "$(cat "$work/splats-cuda")" "$(cat "$work/splats-cpu")" 100 "the default recipe: about as many as on the CPU"
near "$(cat "$work/psnr-cuda")" "$(cat "$work/psnr-cpu")" 0.5 "the default recipe: PSNR within 0.5 dB of the CPU's"

network='--preset paper --levels 2 --hash-log2 8 --finest-resolution 16 --hidden 8 --iterations 3 --residual source'
retrain net cuda $network --range 0:2 --test-cams 0 --refine 10
is "$code" 0 "refines, then trains a network"

# ---- Evaluation and export

for bundle in net tracks-cuda refined-cuda; do
    for device in cpu cuda; do
        run "$bin/spin-eval" "$work/$bundle.spin" --device $device --scale 0.1 --json
        is "$code" 0 "$bundle: evaluates on $device"
        sed -n 's/^ *"\(psnr\|ssim\)": \([0-9.]*[0-9]\),*$/\2/p' "$work/out" | head -n 2 >"$work/eval-$device"
    done
    paste "$work/eval-cpu" "$work/eval-cuda" |
        awk '{ d = $1 - $2; if (!($1 > 0 && d < 1e-3 && d > -1e-3)) bad = 1 } END { exit bad || NR != 2 }'
    ok $? "$bundle: PSNR and SSIM are the CPU's to 0.001"
done

# The numbers of a PLY without its header, one a line.
numbers() {
    tail -c "+$(($(grep -a -b -o -m 1 end_header "$1" | cut -d : -f 1) + 12))" "$1" | od -An -v -tf4 -w4
}
for device in cpu cuda; do
    run "$bin/spin-export" "$work/net.spin" --to ply -o "$work/ply-$device" --device $device --check --json
    is "$code" 0 "exports the network's splats on $device"
done
for frame in 0 1; do
    for device in cpu cuda; do
        numbers "$work/ply-$device/frame_0000$frame.ply" >"$work/$device.numbers"
    done
    paste "$work/cpu.numbers" "$work/cuda.numbers" | awk '
        { d = $1 - $2; a = $1 < 0 ? -$1 : $1; if (!(d < 1e-5 + 1e-5 * a && d > -1e-5 - 1e-5 * a)) bad = NR }
        END { exit bad || NR < 1000 }'
    ok $? "frame $frame: the numbers of the PLY are the CPU's to 1e-5"
done

# compare_images NAME LIMIT MEAN A B...: no value differs by more than LIMIT of 255, nor by more
# than MEAN on average
compare_images() {
    name=$1
    most=$2
    mean=$3
    shift 3
    run "$build/tests/tools/compare-images" "$@"
    awk -v most="$most" -v mean="$mean" '{ exit !($1 <= most && $2 <= mean) }' "$work/out" && [ "$code" = 0 ]
    ok $? "$name: the CPU's to $most of 255, $mean on average ($(cat "$work/out"))"
}
for device in cpu cuda; do
    run "$bin/spin-export" "$work/net.spin" --to images -o "$work/images-$device" --device $device
    is "$code" 0 "exports images on $device"
done
pairs=
for file in $(cd "$work/images-cpu" && find . -name '*.png'); do
    pairs="$pairs $work/images-cpu/$file $work/images-cuda/$file"
done
[ -n "$pairs" ] && compare_images "images" 2 0.01 $pairs
ok $? "there are images"
run "$bin/spin-export" "$work/net.spin" --to video -o "$work/try.mp4" --device cpu
if [ "$code" = 0 ]; then
    run "$bin/spin-export" "$work/net.spin" --to video -o "$work/card.mp4" --device cuda
    is "$code" 0 "exports a video"
    pictures "a video" 4 0.1 "$work/try.mp4#0" "$work/card.mp4#0" "$work/try.mp4#1" "$work/card.mp4#1"
    video=yes
else
    skip "a video" "$(cat "$work/err")"
    video=
fi

# ---- Ctrl-C

long='--range 0:2 --test-cams 0 --iterations 60 --densify-every 20 -q'
retrain whole cuda $long
is "$code" 0 "trains without a stop"
"$bin/spin-retrain" "$in" -o "$work/stopped.spin" --device cuda --scale 0.1 $long --save-every 10 \
    >"$work/out" 2>"$work/err" &
pid=$!
tries=0
while [ ! -s "$work/stopped.spin.part" ] && kill -0 $pid 2>/dev/null && [ $tries -lt 1200 ]; do
    sleep 0.05
    tries=$((tries + 1))
done
kill -INT $pid 2>/dev/null
wait $pid
code=$?
if [ -e "$work/stopped.spin" ]; then
    skip "Ctrl-C" "the run was over before it could be stopped"
else
    is $code 130 "Ctrl-C: exit code 130"
    run "$bin/spin-retrain" "$in" -o "$work/stopped.spin" --device cuda --scale 0.1 $long --save-every 10 --resume
    is "$code" 0 "the run goes on"
    same_frames "$work/whole.spin" "$work/stopped.spin" "and ends where the one without a stop did"
fi

# ---- Out of memory, and a lost GPU

# gone NAME FILE: the last run failed with one line and left no output.
gone() {
    fails 1 spin-retrain "$1"
    [ ! -e "$2" ]
    ok $? "$1: no output"
}
short='--method frames --refine 12 --range 0:1 --test-cams 0 -q'
found=0
for n in 3 20 34 47 52; do # from the splats to what a verb wants for itself
    SPIN_EMU_FULL=$n retrain full cuda $short
    gone "refining, block $n is too much" "$work/full.spin"
    err_has "frame 0: .*out of memory" "refining, block $n is too much: it says so"
    nothing_at "$work/full.spin" "refining, block $n is too much: nothing is left"
    grep -q "an operation needs" "$work/err" && found=1
done
is $found 1 "one of these blocks is what a verb wants for itself"
found=0
for n in 58 62 54 66 50 70 46 42 38; do # some of these blocks are for the splats that densification adds
    SPIN_EMU_FULL=$n retrain full cuda --method frames --refine 136 --range 0:1 --test-cams 0 -q --log "$work/full.log"
    grep -q '"refine": 99, ' "$work/full.log" && grep -q "frame 0: .*out of memory" "$work/err" && found=1 && break
done
is $found 1 "memory that runs out with a densification"
gone "memory that runs out with a densification" "$work/full.spin"

for n in 3 400 1000 1500; do
    rm -rf "$work"/lost.spin*
    SPIN_EMU_LOST=$n retrain lost cuda --method frames --refine 30 --range 0:2 --test-cams 0 -q
    gone "refining, lost at $n" "$work/lost.spin"
    err_has "frame [01]: the CUDA device failed: emulated: the GPU is lost" "refining, lost at $n: it says so"
done
err_has "frame 1: .*; the frames refined so far are kept in .*lost.spin.parts': continue with --resume" "one frame is kept"
run "$bin/spin-retrain" "$in" -o "$work/lost.spin" --device cuda --scale 0.1 --method frames --refine 30 --range 0:2 \
    --test-cams 0 --resume
is "$code" 0 "the run goes on"
err_has "refining 1 of 2 frames" "with the other frame"
retrain never cuda --method frames --refine 30 --range 0:2 --test-cams 0 -q
same_frames "$work/never.spin" "$work/lost.spin" "and ends as if the card had never been lost"

for to in ply images gltf html ${video:+video}; do
    [ $to = video ] && end=.mp4 || end=
    for n in 1 60 110; do
        SPIN_EMU_LOST=$n run "$bin/spin-export" "$work/net.spin" --to $to -o "$work/lost-$to$end" --device cuda -q
        [ "$code" = 0 ] && break # it had done all by then
        fails 1 spin-export "$to, lost at $n"
        err_has "the CUDA device failed: emulated: the GPU is lost" "$to, lost at $n: it says so"
        if [ $to = images ]; then # pictures that were done stay
            is "$(find "$work" -path "*lost-images*" -type f ! -name '*.png' | wc -l)" 0 "$to, lost at $n: nothing half written"
        else
            nothing_at "$work/lost-$to" "$to, lost at $n: nothing is left"
        fi
        rm -rf "$work/lost-$to"*
    done
    [ $n != 1 ]
    ok $? "$to: the card was lost at more than one place"
done
SPIN_EMU_LOST=60 run "$bin/spin-eval" "$work/net.spin" --device cuda --scale 0.1 -q
fails 1 spin-eval "a card that is lost while it measures"
err_has "the CUDA device failed: emulated: the GPU is lost" "and it says so"
SPIN_EMU_FULL=6 run "$bin/spin-export" "$work/net.spin" --to ply -o "$work/poor" --device cuda -q
fails 1 spin-export "no memory for an export"
nothing_at "$work/poor" "no memory for an export: nothing is left"
done_testing
