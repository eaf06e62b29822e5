#!/bin/sh
# K: d3dgs panoptic
# Runs of Dynamic 3D Gaussians: described, imported, and refused if malformed.
. tests/cli/lib.sh

runs=$fixtures/d3dgs
if [ ! -d "$runs" ]; then
    skip "d3dgs" "no fixtures at $runs"
    done_testing
fi

for name in cloud trained; do
    for input in "$runs/$name/params.npz" "$runs/$name"; do
        run "$bin/spin-import" --info --json "$input"
        is "$code" 0 "$input is recognised"
        is_json "$input: --info --json is one document"
        is "$(member from)" d3dgs "$input: from d3dgs"
        for key in frames splats min max mean times sh_degree attributes variant bounds notes \
            numbered; do
            out_has "\"$key\":" "$input: has '$key'"
        done
        [ ! -s "$work/err" ]
        ok $? "$input: nothing on stderr"
    done
done
frames=$(member frames)

run "$bin/spin-import" "$runs/trained" -o "$work/run.spin" --json
is "$code" 0 "imports a run"
is_json "an import with --json prints one document"
cp "$work/run.spin" "$work/keep"
run "$bin/spin-import" "$runs/trained" -o "$work/run.spin"
fails 1 spin-import "does not overwrite"
cmp -s "$work/run.spin" "$work/keep"
ok $? "what was there is as it was"
run "$bin/spin-import" "$runs/trained" -o "$work/run.spin" --force -q
is "$code" 0 "overwrites with --force"
[ ! -s "$work/out" ] && [ ! -s "$work/err" ]
ok $? "says nothing with -q"
cmp -s "$work/run.spin" "$work/keep"
ok $? "the same input gives the same bytes"

run "$bin/spin-import" "$runs/trained" -o "$work/two.spin" --range 1:3 --json
is "$(member frames)" 2 "--range 1:3 keeps two frames"
run "$bin/spin-import" "$runs/trained" -o "$work/step.spin" --range 0:"$frames":2 --json
is "$(member frames)" $(((frames + 1) / 2)) "--range with a step keeps every second"
run "$bin/spin-import" "$runs/trained" -o "$work/none.spin" --range 1000:1001
fails 1 spin-import "a range without frames"
err_has "no frame has a number in 1000:1001" "a range without frames is named"
nothing_at "$work/none" "a range without frames writes nothing"
run "$bin/spin-import" "$runs/trained" -o "$work/places.spin" --positions-only --json
is "$code" 0 "imports positions only"
[ "$(wc -c <"$work/places.spin")" -lt "$(wc -c <"$work/run.spin")" ]
ok $? "positions only take less room"
run "$bin/spin-import" "$runs/trained" -o "$work/sampled.spin" --frames 3
fails 2 spin-import "--frames for a run that stores its frames"

data=$fixtures/datasets/panoptic_mini
run "$bin/spin-import" "$runs/trained" --data "$data" -o "$work/data.spin"
is "$code" 0 "takes the data set along"
run "$bin/spin-import" "$runs/trained" --data "$work" -o "$work/bad.spin"
fails 1 spin-import "a data set that is none"
nothing_at "$work/bad" "a data set that is none: nothing was written"

run "$bin/spin-import" --info --json "$runs/variants/deflated.npz"
is "$code" 0 "reads compressed members"
for name in truncated missing_log_scales zero_gaussians; do
    run "$bin/spin-import" --from d3dgs "$runs/variants/$name.npz" -o "$work/bad.spin"
    fails 1 spin-import "$name"
    nothing_at "$work/bad" "$name: nothing was written"
done
run "$bin/spin-import" --from d3dgs "$runs/variants/missing_log_scales.npz" --info
err_has log_scales "a missing array is named"

touch -d '2 minutes ago' "$work/swept.spin.tmp.999999999"
run "$bin/spin-import" "$runs/trained" -o "$work/swept.spin"
is "$(ls "$work" | grep -c swept)" 1 "an import removes what a killed one has left"

size=$(wc -c <"$runs/trained/params.npz")
for part in 0 1 3 100 1000; do
    head -c $((size * part / 1001)) "$runs/trained/params.npz" >"$work/params.npz"
    run "$bin/spin-import" --from d3dgs "$work/params.npz" -o "$work/bad.spin"
    fails 1 spin-import "cut to $part/1001"
    nothing_at "$work/bad" "cut to $part/1001: nothing was written"
done

done_testing
