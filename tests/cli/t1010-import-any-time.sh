#!/bin/sh
# K: realtime4dgs rotor4dgs omg4
# Methods that are defined at any time are sampled evenly, at given times, or at those of a data
# set.
. tests/cli/lib.sh
. tests/runs.sh

# The first and the last time of the imported clip.
times_are() { # TIMES NAME
    tr -d ' \n' <"$work/out" | grep -q -e "\"times\":\\[$1\\]"
    ok $? "$2"
}

runs=$fixtures/realtime4dgs
run_in=$runs/rot4d_noshfs
if [ ! -d "$run_in" ]; then
    skip "any time" "no fixtures at $run_in"
    done_testing
fi

run "$bin/spin-import" --info --json "$run_in"
is "$code" 0 "a run is described without a word on where to sample it"
is "$(member from)" realtime4dgs "from realtime4dgs"
out_has "assumed the one used since September 2024" "the notes say what was assumed"
run "$bin/spin-import" "$run_in" -o "$work/any.spin" --json
is "$code $(member frames)" "0 61" "4D splats are kept for any time, and frames are shown"
out_has "the run does not store its number of frames" "of which a note says that their number is a guess"
run "$bin/spin-import" "$run_in" -o "$work/sampled.spin" --frames 61 --json
out_has "stores the sampled frames instead of the 4D splats" "with --frames they are sampled, and a note says so"
for kept in any sampled; do
    "$bin/spin-export" "$work/$kept.spin" --to ply -o "$work/$kept" -q
done
is "$(ls "$work/any"/*.ply | wc -l)" 61 "a frame of slices for each"
for ply in "$work/any"/*.ply; do
    cmp -s "$ply" "$work/sampled/${ply##*/}" || break
done
ok $? "the same bytes as those of sampled frames"
"$bin/spin-import" --info "$work/any.spin" | grep -q "^4D splats   [0-9]* *, paths of degree 1"
ok $? "a bundle of them says so"
is "$("$bin/spin-import" --info "$work/any.spin" --json | tr -d ' \n' | grep -c '"splats_4d":{"n":')" 1 "as JSON too"
is "$("$bin/spin-import" --info "$work/sampled.spin" --json | tr -d ' \n' | grep -c '"splats_4d":null')" 1 \
    "and one of frames does not"
run "$bin/spin-import" "$run_in" -o "$work/places.spin" --positions-only --json
is "$code $(member frames) $(grep -c '4D splats cover' "$work/out")" "0 61 0" "places alone are sampled there too"
run "$bin/spin-import" fixtures/deformable3dgs/real_small/model -o "$work/none.spin"
fails 2 spin-import "a network's import needs to know where"
err_has "continuous in time, from 0 to 1, and .* with --frames, --times or --data" "and says how to tell, and the range"
nothing_at "$work/none" "nothing was written"

mkdir -p "$work/beside/court"
cp -r "$run_in" "$work/beside/run"
cp -r "$clip/ims" "$clip"/*_meta.json "$work/beside/court"
run "$bin/spin-import" "$work/beside/run" -o "$work/beside.spin" --json
is "$code $(member frames)" "0 6" "but for the only data set beside it, whose frames say where"
out_has "sampled at the times of the 6 frames of the data set '$work/beside/court'" "a note says so"
run "$bin/spin-import" --info "$work/beside.spin"
! grep -q "^data " "$work/out"
ok $? "and its images are not taken for the run's"
run "$bin/spin-import" "$work/beside/run" -o "$work/beside4.spin" --frames 4 --json
is "$(member frames) $(grep -c 'sampled at the times' "$work/out")" "4 0" "--frames wins"
run "$bin/spin-import" "$work/beside/run" -o "$work/beside1.spin" --times 0.5 --json
is "$(member frames) $(grep -c 'sampled at the times' "$work/out")" "1 0" "so does --times"
! grep -q fl_x "$work/out"
ok $? "not a word on focal lengths"
mkdir -p "$work/fov/clip"
cp -r "$run_in" "$work/fov/run"
cp -r fixtures/datasets/blender_mini/. "$work/fov/clip"
run "$bin/spin-import" --info "$work/fov/run"
! grep -q "stores focal" "$work/out"
ok $? "a data set of angles is as it should be"
for json in "$work/fov/clip"/transforms_*.json; do
    sed '1s/{/{ "fl_x": 46.08, "fl_y": 46.08, "w": 60, "h": 60,/' "$json" >"$work/json" && cp "$work/json" "$json"
done
run "$bin/spin-import" --info "$work/fov/run"
out_has "clip' stores focal lengths as fl_x, which Realtime-4DGS reads as a field of view of -1" \
    "a data set beside it that its training misread is noticed"
run "$bin/spin-import" --info "$run_in" --data "$work/fov/clip"
out_has "stores focal lengths as fl_x" "so is one that is given"
run "$bin/spin-import" --info fixtures/omg4/comp_xz --data "$work/fov/clip"
is "$code $(grep -c "stores focal" "$work/out")" "0 0" "no other method's run is meant"
cp -r "$work/beside/court" "$work/beside/court2"
run "$bin/spin-import" "$work/beside/run" -o "$work/two.spin" --json
is "$code $(member frames)" "0 61" "two data sets beside it tell nothing"
run "$bin/spin-import" fixtures/ex4dgs/small/model -o "$work/own.spin" --json
is "$code $(member frames)" "0 30" "a run that counts its frames"
is "$(sed -n 's/.*sampled at the times of the \([0-9]*\) frames that the run contains.*/\1/p' "$work/out")" "$(member frames)" \
    "is sampled at those"
counts() { tr -d ' \n' <"$1" | sed 's/.*"splats":{\([^}]*\)}.*/\1/'; }
counts "$work/out" >"$work/counts"
run "$bin/spin-import" --info --json "$work/own.spin"
is "$(counts "$work/out")" "$(cat "$work/counts")" "and counts the splats that its 4D splats show"
"$bin/spin-import" --info "$work/own.spin" | grep -q "^4D splats .* paths of degree 3, with spins plateaus cuts"
ok $? "which are pieces of paths"
run "$bin/spin-import" fixtures/spacetimegs/full_techni/model --colour base -o "$work/own.spin" --json --force
is "$code $(member frames)" "0 20" "a run that says how many frames it has"
"$bin/spin-import" --info "$work/own.spin" | grep -q "^4D splats .* paths of degree 3, with spins:"
ok $? "without its network it is 4D splats"
run "$bin/spin-import" fixtures/spacetimegs/full_techni/model --camera 0,0,0 -o "$work/own.spin" --json --force
is "$code $(member frames) $(grep -c '"splats_4d": null' "$work/out")" "0 20 1" "with it, frames"

run "$bin/spin-import" "$run_in" -o "$work/five.spin" --frames 6 --json
is "$code" 0 "--frames 6"
is "$(member frames)" 6 "are six frames"
times_are 0,1 "are spread over the whole time, both ends included"
run "$bin/spin-import" "$run_in" -o "$work/times.spin" --times 0.865,0.5 --json
is "$(member frames)" 2 "--times with two of them"
times_are 0.865,0.5 "in their order"
run "$bin/spin-import" "$run_in" -o "$work/twice.spin" --times 0.25,0.5,0.25
fails 2 spin-import "a time that comes twice"
err_has "frames 0 and 2 have the same time, 0.25" "the frames are named"
nothing_at "$work/twice" "nothing was written"
run "$bin/spin-import" "$run_in" -o "$work/part.spin" --frames 6 --range 1:3 --json
times_are 0.2,0.4 "--range leaves out some of those sampled"

# A data set of three times, with the same arbitrary image in each view.
stand_in "$work/data" "$clip/ims/0/000008.jpg"
cameras "$work/data" 7 0.75
run "$bin/spin-import" "$run_in" --data "$work/data" --data-from transforms:ending=.jpg \
    -o "$work/data.spin" --json
is "$code" 0 "--data alone"
is "$(member frames)" 3 "samples at the data set's three times"
times_are 0,0.75 "as they are"
run "$bin/spin-import" "$run_in" --data "$work/data" --data-from transforms:ending=.jpg \
    -o "$work/cut.spin" --range 1:3 --json --pair order
is "$(member frames)" 2 "whose frame numbers --range picks from"

for path in "$fixtures"/rotor4dgs/*/; do
    name=$(basename "$path")
    run "$bin/spin-import" "$path" --frames 3 -o "$work/$name.spin" --json
    is "$code" 0 "rotor4dgs/$name is imported"
    is "$(member from)" rotor4dgs "rotor4dgs/$name: by its importer"
done
for name in comp_xz ftgs_xz; do
    run "$bin/spin-import" "$fixtures/omg4/$name" --frames 3 -o "$work/$name.spin" --json
    is "$code" 0 "omg4/$name is imported"
    is "$(member from)" omg4 "omg4/$name: by its importer"
done

# A data set with frame numbers only: they are spread over the whole time range, and a note says so.
mini=$fixtures/datasets/panoptic_mini
if [ -d "$mini" ]; then
    run "$bin/spin-import" "$fixtures/rotor4dgs/old_names" --time-range 0,1 --from rotor4dgs \
        --data "$mini" -o "$work/mini.spin" --json
    is "$code" 0 "a data set without times"
    out_has "evenly spaced over the times 0 to 1" "is spread over the range"
fi

run "$bin/spin-import" "$run_in" --from realtime4dgs --convention wrong -o "$work/bad.spin" --frames 2
fails 2 spin-import "an option's value that is none"
nothing_at "$work/bad" "nothing was written"
done_testing
