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

# ---- Import and export: the files are those of one

ranks 2 "$bin/spin-import" --from d3dgs $clip --data $clip -o "$work/in-2.spin" --range 0:5
is "$code" 0 "2 ranks import"
is "$(grep -c '^written' "$work/out")" 1 "with one report"
cmp -s "$in" "$work/in-2.spin"
ok $? "and the same bundle"
for to in ply gltf; do
    run "$bin/spin-export" "$in" --to $to -o "$work/$to-1"
    ranks 2 "$bin/spin-export" "$in" --to $to -o "$work/$to-2"
    is "$code" 0 "2 ranks export to $to"
    diff -r "$work/$to-1" "$work/$to-2" >/dev/null && [ -e "$work/$to-1" ]
    ok $? "the same files"
done
done_testing
