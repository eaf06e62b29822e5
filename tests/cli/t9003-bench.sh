#!/bin/sh
# K: bench speed
# The benchmark program links and times every stage; the times themselves are not tested.
. tests/cli/lib.sh

run "$SPIN_BUILD/tests/bench/bench" --gaussians 500 --table 12 --rounds 1 --json
is "$code" 0 "bench runs"
for mode in grid mlp project lists blend loss blend_back mlp_back grid_back adam step step_lazy; do
    grep -q "\"$mode\"" "$work/out"
    ok $? "$mode is among its rows"
done
done_testing
