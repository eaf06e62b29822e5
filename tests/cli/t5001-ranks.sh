#!/bin/sh
# K: ranks mpi
# Several processes share the work of one command, and their outputs are those of one.
. tests/cli/lib.sh

. tests/cli/ranks.sh

in=$work/in.spin
run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$in" --range 0:5
is "$code" 0 "imports a clip"

# Without what differs from run to run.
timeless() { grep -v '"fps\|"seconds' "$1"; }

# ---- Evaluation

run "$bin/spin-eval" "$in" --source --json --images "$work/images-1"
timeless "$work/out" >"$work/eval-1"
for n in 2 3; do
    ranks $n "$bin/spin-eval" "$in" --source --json --images "$work/images-$n"
    is "$code" 0 "$n ranks evaluate"
    is_json "with one report"
    timeless "$work/out" >"$work/eval-$n"
    cmp -s "$work/eval-1" "$work/eval-$n"
    ok $? "which is that of one, to the last digit"
    diff -r "$work/images-1" "$work/images-$n" >/dev/null
    ok $? "and so are the pictures"
done
done_testing
