#!/bin/sh
# K: 4dgaussian deformable3dgs motiongs ex4dgs ed3dgs spacetimegs datasets
# The times at which a continuous method is sampled if a data set has frame numbers only.
. tests/cli/lib.sh

times_are() { # TIMES NAME
    tr -d ' \n' <"$work/out" | grep -q -e "\"times\":\\[$1\\]"
    ok $? "$2"
}

model=$fixtures/4dgaussian/coarse_and_fine/model
if [ ! -d "$model" ]; then
    skip "frame times" "no fixtures at $model"
    done_testing
fi

# court-mini has six frames and no times.
run "$bin/spin-import" "$model" --data "$clip" -o "$work/auto.spin" --json
is "$code" 0 "4dgaussian with a data set that counts its frames"
times_are "0,0.83333[0-9]*" "takes i/n, as its own reader does"
out_has "i/n of the range (see --frame-times)" "and a note says so"
run "$bin/spin-import" "$model" --data "$clip" --frame-times unit -o "$work/unit.spin" --json
times_are "0,1" "unit: i/(n-1)"
run "$bin/spin-import" "$model" --data "$clip" --frame-times count -o "$work/count.spin" --json
times_are "0,0.83333[0-9]*" "count: i/n"
run "$bin/spin-import" "$model" --data "$clip" --frame-times data -o "$work/data.spin" --json
times_are "0,5" "data: as the data set counts them"

other=
for dir in "$fixtures"/deformable3dgs/*/model "$fixtures"/deformable3dgs/*; do
    [ -d "$dir/deform" ] && other=$dir && break
done
if [ -n "$other" ]; then
    run "$bin/spin-import" "$other" --data "$clip" -o "$work/other.spin" --json
    times_are "0,1" "deformable3dgs: i/(n-1) by itself"
    run "$bin/spin-import" "$other" --data "$clip" --frame-times count -o "$work/oc.spin" --json
    times_are "0,0.83333[0-9]*" "and i/n when asked"
else
    skip "deformable3dgs" "no fixture at hand"
fi

# These two runs define their own number of frames: 20 and 300, with frame i at i/20 and i/300.
for one in spacetimegs/full_techni/model:0.95 ed3dgs/annealed_early/model:0.99666; do
    path=$fixtures/${one%:*}
    if [ ! -d "$path" ]; then
        skip "${one%%/*}" "no fixture at hand"
        continue
    fi
    run "$bin/spin-import" "$path" --data "$clip" -o "$work/${one%%/*}.spin" --json
    times_are "0,${one#*:}[0-9]*" "${one%%/*}: from its first frame to its last"
    run "$bin/spin-import" "$path" --frames 5 -o "$work/${one%%/*}-5.spin" --json
    times_are "0,${one#*:}[0-9]*" "and so with --frames"
done
# Ex4DGS counts frames: its times come from the data set's file names, relative to the first.
run_in=fixtures/ex4dgs/small/model
run "$bin/spin-import" "$run_in" --data "$clip" -o "$work/ex.spin" --json
is "$code" 0 "ex4dgs with a data set of frames 8 to 13"
times_are "0,5" "samples at 0 to 5"
mini=fixtures/datasets/blender_mini
run "$bin/spin-import" "$run_in" --data "$mini" -o "$work/ex2.spin" --json
times_are "0,6" "so it does where the data set's seven times are 0 to 1"
out_has "instead of their own (to keep their own, give --frame-times data)" "and a note says so"
out_has "are 0 to 6, but those of the method are 0 to 29" "and that these are not all 30 frames"
run "$bin/spin-import" "$run_in" --data "$mini" --frame-times data -o "$work/ex3.spin" --json
times_are "0,1" "data: its own times, if asked for"
run "$bin/spin-import" "$run_in" --data "$mini" --frame-times unit -o "$work/ex4.spin" --json
times_are "0,29" "unit: over the whole clip"

# Times in seconds and in the unit interval cannot be told apart for certain: a warning suffices.
motion=$work/motiongs
mkdir "$motion"
cp -R fixtures/deformable3dgs/real_small/model/. "$motion"
echo "Namespace(is_6dof=False, use_depth_and_flow=True, scene_format='plenopticVideo')" >"$motion/cfg_args"
run "$bin/spin-import" "$motion" --data fixtures/datasets/dynerf_mini -o "$work/motion.spin" --json
is "$code" 0 "MotionGS in seconds, a data set of times below 1"
out_has "check that their units agree" "is doubted"
run "$bin/spin-import" "$motion" --data fixtures/datasets/dynerf_mini --data-from dynerf:time=0.6 \
    -o "$work/motion2.spin" --json
grep -q "units agree" "$work/out"
is $? 1 "and is not where the data set's times are the method's"

run "$bin/spin-import" "$model" --frames 3 --frame-times unit -o "$work/none.spin"
fails 2 spin-import "--frame-times without a data set"
run "$bin/spin-import" "$clip/params.npz" --data "$clip" --frame-times unit -o "$work/none.spin"
fails 2 spin-import "--frame-times for stored frames"
run "$bin/spin-import" "$model" --data "$clip" --frame-times half -o "$work/none.spin"
fails 2 spin-import "a rule that there is none of"
nothing_at "$work/none" "nothing was written"
done_testing
