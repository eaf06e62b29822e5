#!/bin/sh
# K: ranks mpi
# Several processes share the work of one command, and write the same output as a single one.
. tests/cli/lib.sh

. tests/cli/ranks.sh

in=$work/in.spin
run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$in" --range 0:5
is "$code" 0 "imports a clip"

# The report without values that differ from run to run.
timeless() { grep -v '"fps\|"seconds' "$1"; }

# ---- Evaluation

run "$bin/spin-eval" "$in" --source --temporal --json --images "$work/images-1"
timeless "$work/out" >"$work/eval-1"
for n in 2 3; do
    ranks $n "$bin/spin-eval" "$in" --source --temporal --json --images "$work/images-$n"
    is "$code" 0 "$n ranks evaluate"
    is_json "with one report"
    timeless "$work/out" >"$work/eval-$n"
    cmp -s "$work/eval-1" "$work/eval-$n"
    ok $? "which is that of one, to the last digit"
    diff -r "$work/images-1" "$work/images-$n" >/dev/null
    ok $? "and so are the pictures"
done

# ---- Import and export: the files equal those of a single process

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

# ---- Progress of rank 0: its own views, and the frames of all ranks

# ends_whole WORDS NAME: the last line of progress is complete
ends_whole() {
    sed -n "s/^$1  \([0-9]*\)\/\([0-9]*\)  .*%.*/\1 \2/p" "$work/err" | sort -n | tail -n 1 >"$work/last"
    awk '$1 == $2 { found = 1 } END { exit !found }' "$work/last"
    ok $? "$2: progress comes to 100 % ($(cat "$work/last"))"
}
SPIN_PROGRESS=1e-9
export SPIN_PROGRESS
for n in 1 2 3; do
    ranks $n "$bin/spin-eval" "$in" --source --split all
    ends_whole '[a-z ]*' "$n ranks evaluate"
    ranks $n "$bin/spin-export" "$in" --to ply -o "$work/progress-$n"
    ends_whole exporting "$n ranks export"
    ranks $n "$bin/spin-import" --from d3dgs $clip --data $clip -o "$work/progress-$n.spin" --range 0:5
    ends_whole importing "$n ranks import"
    ranks $n "$bin/spin-retrain" "$in" -o "$work/refined-$n.spin" --device cpu --method frames --refine 2 --scale 0.25
    ends_whole refining "$n ranks refine"
done
done_testing
