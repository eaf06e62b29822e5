#!/bin/sh
# K: ranks mpi refine
# Processes, and separate runs, share refined frames through a folder.
. tests/cli/lib.sh

in=$work/in.spin
run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$in" --range 0:5
is "$code" 0 "imports a clip"
explicit='--device cpu --method frames --refine 10 --threads 1'
run "$bin/spin-retrain" "$in" -o "$work/one.spin" $explicit
is "$code" 0 "one process refines the clip"
err_has '^refining 5 of 5 frames' "all of it"

# ---- A job array: each run refines some of the frames, the last one collects them

for range in 1:3 3:5; do
    run "$bin/spin-retrain" "$in" -o "$work/part-$range.spin" $explicit --range $range --cache "$work/cache"
    is "$code" 0 "refines frames $range into a folder"
done
run "$bin/spin-retrain" "$in" -o "$work/array.spin" $explicit --cache "$work/cache" --json
is "$code" 0 "then the whole clip"
err_has '^refining 1 of 5 frames' "of which one frame was left"
awk -v s="$(member refine_seconds)" -v each="$(member seconds_per_iteration)" \
    'BEGIN { d = s / 10 / each - 1; exit !(d < 1e-6 && d > -1e-6) }'
ok $? "seconds an iteration are those of that frame"
greater "$(member loss)" 0
ok $? "and so is the loss"
run "$bin/spin-retrain" "$in" -o "$work/array2.spin" $explicit --cache "$work/cache" --json
is "$(member loss) $(member seconds_per_iteration)" "null null" "where no frame is left there are none"
run "$bin/spin-retrain" "$in" -o "$work/array2.spin" $explicit --cache "$work/cache" --force
out_has '^.*array2.spin: 10 iterations in [0-9.]* s on cpu' "nor in words"
cmp -s "$work/one.spin" "$work/array.spin"
ok $? "and it is that of one run"
is "$(ls "$work/cache" | wc -l)" 5 "the folder stays"
run "$bin/spin-retrain" "$in" -o "$work/other.spin" $explicit --refine 11 --cache "$work/cache" -q
fails 2 spin-retrain "frames made with other options"

# ---- Processes

. tests/cli/ranks.sh
ranks 2 "$bin/spin-retrain" "$in" -o "$work/two.spin" $explicit
is "$code" 0 "two processes refine the clip"
cmp -s "$work/one.spin" "$work/two.spin"
ok $? "and it is that of one"
nothing_at "$work/two.spin.parts" "nothing is left beside it"
ranks 2 "$bin/spin-retrain" "$in" --dry-run --device cpu
out_has '^processes   2; each needs this amount of memory; together they send up to [0-9.]* .*B' \
    "--dry-run says what two processes send"
done_testing
