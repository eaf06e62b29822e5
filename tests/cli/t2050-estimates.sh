#!/bin/sh
# K: long retrain estimates
# The estimates of --dry-run are those of runs on court-mini within a factor of 2: processor time,
# which other programs hardly disturb, and peak memory. The constants are those of a machine with
# 200 GFLOP/s on one thread; slower machines may take as much longer as they are slower.
. tests/cli/lib.sh

if [ ! -d "$clip" ]; then
    skip "estimates" "no fixture at $clip"
    done_testing
fi
case ${SPIN_BUILD:-} in
*asan* | *tsan* | *ubsan* | *debug* | *cov*)
    skip "estimates" "only an optimised build is as fast as they say"
    done_testing
    ;;
esac
in=$work/in.spin
run "$bin/spin-import" "$clip/params.npz" --data "$clip" -o "$in"
is "$code" 0 "imports the clip"
run "$SPIN_BUILD/tests/bench/bench" --gaussians 500 --table 12 --rounds 1 --mode loss --json
slower=$(awk '/gflop_per_s/ { n = 200 / $2; print (n > 1 ? n : 1) }' "$work/out")
[ -n "$slower" ]
ok $? "measures the machine ($slower times slower than that of the constants)"

# within A B [FACTOR]: A is at most twice B, and B at most 2 FACTOR times A.
within() { awk -v a="$1" -v b="$2" -v f="${3:-1}" 'BEGIN { exit !(a > 0 && b > 0 && a <= 2 * b && b <= 2 * f * a) }'; }

# estimate NAME IN OPTION...: a dry run and a run, and compares.
estimate() {
    name=$1
    from=$2
    shift 2
    run "$bin/spin-retrain" "$from" --dry-run --json --device cpu --threads 1 "$@"
    said=$(member seconds_estimated)
    needed=$(member bytes_needed)
    (
        run "$bin/spin-retrain" "$from" -o "$work/$name.spin" --json --device cpu --threads 1 "$@"
        times >"$work/times"
    )
    spent=$(awk -F '[ms ]+' 'NR == 2 { print 60 * $1 + $2 + 60 * $3 + $4 }' "$work/times")
    within "$said" "$spent" "$slower"
    ok $? "$name: the time ($said s estimated, $spent s spent)"
    within "$needed" "$(member bytes_peak)"
    ok $? "$name: the memory ($needed bytes estimated, $(member bytes_peak) at the peak)"
}

estimate tracks "$in"
estimate 4d "$work/tracks.spin" --method 4d --iterations 150
estimate frames "$in" --method frames --refine 600 --range 0:2
estimate network "$in" --preset short --iterations 15 --hash-log2 16

# The estimates include the splats that densification adds, up to --max-points.
needed() {
    run "$bin/spin-retrain" "$in" --dry-run --json --device cpu "$@"
    member bytes_needed
}
some=$(needed --densify-every 0)
[ "$(needed)" -gt "$((some * 3 / 2))" ]
ok $? "densification needs more memory"
[ "$(needed --max-points 3000)" -lt "$((some * 11 / 10))" ]
ok $? "but not with --max-points"
some=$(needed --method frames --refine 1000 --densify off)
[ "$(needed --method frames --refine 1000)" -gt "$((some * 2))" ]
ok $? "so does the densification of frames"
[ "$(needed --method frames --refine 1000 --max-points 3000)" -lt "$((some * 11 / 10))" ]
ok $? "within the same limit"

# Pixels of the background colour are quick to render: here many are black.
run "$bin/spin-export" "$in" --to images --transforms --views all --decimate 0.3% -o "$work/dark" -q
is "$code" 0 "exports images of a few splats"
for background in black white; do
    run "$bin/spin-retrain" "$in" --data "$work/dark" --dry-run --json --device cpu --background $background
    member seconds_estimated >"$work/over-$background"
done
greater "$(cat "$work/over-white")" "$(cat "$work/over-black")"
ok $? "an empty background takes less time"
done_testing
