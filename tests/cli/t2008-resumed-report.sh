#!/bin/sh
# K: retrain resume refine
# Loss and seconds of a resumed run cover all parts of the work, refinement included.
. tests/cli/lib.sh

in=$work/in.spin
run "$bin/spin-import" "$clip" --data "$clip" --range 0:3 -o "$in"
is "$code" 0 "imports a clip"
small='--device cpu --preset paper --levels 2 --hash-log2 8 --hidden 8 --scale 0.25 --refine 10 --iterations 200 --save-every 5'
run "$bin/spin-retrain" "$in" -o "$work/whole.spin" $small --json
is "$code" 0 "retrains in one stretch"
cp "$work/out" "$work/whole.json"

"$bin/spin-retrain" "$in" -o "$work/two.spin" $small >"$work/out" 2>"$work/err" &
pid=$!
while [ ! -s "$work/two.spin.part" ] && kill -0 $pid 2>/dev/null; do
    sleep 0.05
done
kill -KILL $pid 2>/dev/null
wait $pid 2>/dev/null
if [ -e "$work/two.spin" ]; then
    skip "a resumed run" "it was over before it could be stopped"
    done_testing
    exit
fi
run "$bin/spin-retrain" "$in" -o "$work/two.spin" $small --json --resume
is "$code" 0 "and in two"
is "$(member loss)" "$(member loss "$work/whole.json")" "the loss of one stretch"
awk -v all="$(member seconds)" -v refine="$(member refine_seconds)" -v each="$(member seconds_per_iteration)" \
    -v whole="$(member refine_seconds "$work/whole.json")" \
    'BEGIN { d = (all - refine) / 200 / each - 1; exit !(d < 1e-6 && d > -1e-6 && refine > whole / 10) }'
ok $? "seconds an iteration are those of all that the network took ($(member refine_seconds) s of refinement before)"
done_testing
