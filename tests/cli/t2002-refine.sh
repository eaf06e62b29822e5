#!/bin/sh
# K: long retrain refine threads
# Frame-by-frame training: --refine before the network, --method frames instead of it; threads, a
# kill and --resume, reuse of refined frames, and counts of splats that change.
. tests/cli/lib.sh

few='--device cpu --range 0:2 --scale 0.25 --refine 136'
one='--device cpu --range 1:2 --scale 0.25 --refine 136'
net='--levels 4 --hash-log2 10 --finest-resolution 32 --hidden 16 --iterations 30'
in=$work/in.spin
run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$in"
is "$code" 0 "imports the clip"

# splats_of BUNDLE: the splats of frame 1, as the PLY header has it.
splats_of() {
    rm -rf "$work/ply"
    "$bin/spin-export" "$1" --to ply -o "$work/ply" -q --force >/dev/null 2>"$work/err"
    sed -n 's/^element vertex //p' "$work/ply/frame_00001.ply" | head -n 1
}
same() { # FILE FILE NAME
    cmp -s "$1" "$2"
    ok $? "$3"
}

# --method frames, by its former name.
run "$bin/spin-retrain" "$in" --dry-run $few --method explicit --json
is "$code" 0 "--dry-run frame by frame"
is_json "which is one document"
run "$bin/spin-retrain" "$in" -o "$work/one.spin" $few --method frames --threads 1 --json \
    --log "$work/log.jsonl" --preview "$work/preview"
is "$code" 0 "refines two frames on one thread"
is_json "--json at the end is one document"
is "$(member method)" frames "which names the method"
out_has '"refined": {' "and has the quality of the refined frames"
told=$(member splats_mean)
splats_of "$work/one.spin" >/dev/null
is "$told" "$(grep -a -h -m 1 '^element vertex' "$work"/ply/frame_*.ply | awk '{ n += $3 } END { print n / NR }')" \
    "and how many splats a refined frame has"
is "$(grep -c '^{"refine": [0-9]*, .*"views": \[\[1, [0-9]*\]\]' "$work/log.jsonl")" 136 "--log has every iteration, a line as of any step"
grep -q '"clones": ' "$work/log.jsonl"
ok $? "and what densification did"
# shellcheck disable=SC2046
set -- $(sed -n '/\[\[1, /s/.*"clones": \([0-9]*\), "splits": \([0-9]*\), "pruned": \([0-9]*\).*/\1 \2 \3/p' "$work/log.jsonl")
is "$(sed -n '/\[\[1, /s/.*"splats": \([0-9]*\).*/\1/p' "$work/log.jsonl" | uniq | xargs)" "2940 $((2940 + $1 + $2 - $3))" \
    "and the splats before and after it"
unzip -p "$work/one.spin" meta.json | sed -n '/"per_unit"/,$p' >"$work/units"
is "$(grep -c '"refined/[a-z_]*": ' "$work/units")" 5 "all columns are packed as multiples of their steps"
ls "$work/preview"/*refined.png >/dev/null 2>&1
ok $? "--preview has pictures"
nothing_at "$work/one.spin." "nothing unfinished is left"
for n in 2 3; do
    run "$bin/spin-retrain" "$in" -o "$work/$n.spin" $few --method frames --threads $n
    same "$work/one.spin" "$work/$n.spin" "$n threads give the same bytes as one"
done
run "$bin/spin-eval" "$work/one.spin" --scale 0.25 --json
is "$(member attributes)" frames "spin-eval takes the frames' splats"
after=$(member psnr)
run "$bin/spin-eval" "$work/one.spin" --scale 0.25 --source --json
is "$(member attributes)" source "and the source's with --source"
greater "$after" "$(member psnr)"
ok $? "those are better"
n_source=$(splats_of "$in")
n_frames=$(splats_of "$work/one.spin")
[ -n "$n_frames" ] && [ "$n_frames" != "$n_source" ]
ok $? "the export has the new number of splats"
run "$bin/spin-retrain" "$in" -o "$work/still.spin" $one --method frames --densify off \
    --max-points 5
greater "$((n_source + 1))" "$(splats_of "$work/still.spin")"
ok $? "--densify off adds none"
run "$bin/spin-retrain" "$in" -o "$work/capped.spin" $one --method frames \
    --max-points "$((n_source + 7))" --refine-start source
greater "$((n_source + 8))" "$(splats_of "$work/capped.spin")"
ok $? "--max-points is kept, and frames start from the source's attributes"

# Options beyond 3DGS: other frames, identical bytes on any number of threads, and evaluation with
# the settings of the training.
for more in '--sh-increase-every 50' '--learn-exposure on --lr-exposure 1e-2' '--antialias on' '--dynamic-weight 4'; do
    # shellcheck disable=SC2086
    run "$bin/spin-retrain" "$in" -o "$work/more.spin" $few --method frames --densify off $more --force --json \
        --precision half
    is "$code" 0 "refines with $more"
    learned=$(sed -n '/"test": {/,/}/s/.*"psnr": \([0-9.]*\).*/\1/p' "$work/out")
    # shellcheck disable=SC2086
    run "$bin/spin-retrain" "$in" -o "$work/more3.spin" $few --method frames --densify off $more --force --threads 3 \
        --precision half
    same "$work/more.spin" "$work/more3.spin" "$more: the same bytes on three threads"
    run "$bin/spin-eval" "$work/more.spin" --scale 0.25 --json
    awk -v a="$learned" -v b="$(member psnr)" 'BEGIN { d = a - b; exit !(b != "" && d < 1e-3 && d > -1e-3) }'
    ok $? "$more: measured as trained"
    run "$bin/spin-retrain" "$work/more.spin" -o "$work/without.spin" $few --method frames --densify off --force
    err_has "refining 2 of 2 frames" "$more: not taken for frames refined without"
done

# The SH of a source is kept, up to --sh-degree. PLY stores f_rest channel by channel.
run "$bin/spin-retrain" "$in" -o "$work/sh.spin" $one --method frames --densify off --sh-increase-every 50 \
    --precision full
splats_of "$work/sh.spin" >/dev/null
mkdir "$work/ply.sh"
mv "$work/ply/frame_00001.ply" "$work/ply.sh/frame_00009.ply" # the data set's number
is "$(grep -a -c '^property float f_rest_' "$work/ply.sh/frame_00009.ply")" 24 "136 iterations, a degree more every 50: SH degree 2"
run "$bin/spin-import" "$work/ply.sh" --data $clip -o "$work/fromsh.spin"
for pair in '3 24' '1 9'; do
    degree=${pair% *} n=${pair#* }
    run "$bin/spin-retrain" "$work/fromsh.spin" -o "$work/$n.spin" --device cpu --scale 0.25 \
        --method frames --refine 1 --refine-start source --precision full --sh-degree "$degree"
    "$bin/spin-export" "$work/$n.spin" --to ply -o "$work/ply.$n" -q 2>"$work/err"
    is "$(grep -a -c '^property float f_rest_' "$work"/ply.$n/frame_*.ply)" $n "--sh-degree $degree: $n numbers of a source with SH go on"
done
if python3 -c 'import numpy' 2>/dev/null; then
    is "$(python3 - "$work/ply.sh/frame_00009.ply" "$work"/ply.24/frame_*.ply <<'END'
import sys
import numpy as np

def rest(path):
    head, body = open(path, "rb").read().split(b"end_header\n", 1)
    names = [line.split()[2].decode() for line in head.split(b"\n") if line.startswith(b"property")]
    rows = np.frombuffer(body, "<f4").reshape(-1, len(names))
    width = sum(name.startswith("f_rest_") for name in names) // 3
    return np.stack([rows[:, [names.index("f_rest_%d" % (c * width + k)) for c in range(3)]] for k in range(3)])

a, b = rest(sys.argv[1]), rest(sys.argv[2])
print(a.shape == b.shape and abs(a).max() > 1e-3 and abs(a - b).max() < 2e-4)
END
)" True "as they are, but for one step"
else
    skip "SH of the source" "no NumPy"
fi

# Refinement, then the network.
run "$bin/spin-retrain" "$in" -o "$work/whole.spin" $few $net
is "$code" 0 "refines, then trains the network"
is "$(splats_of "$work/whole.spin")" "$n_frames" "which has the refined frames' number of splats"
run "$bin/spin-eval" "$work/whole.spin" --scale 0.25 --json
is "$(member attributes)" retrained "spin-eval takes the network"
run "$bin/spin-retrain" "$work/whole.spin" -o "$work/again.spin" $few $net
err_has "refining 0 of 2 frames" "what a bundle keeps is not refined again"
splats_of "$work/whole.spin" >/dev/null
mv "$work/ply" "$work/ply.whole"
splats_of "$work/again.spin" >/dev/null
diff -r "$work/ply" "$work/ply.whole" >/dev/null
ok $? "and gives the same network"
run "$bin/spin-retrain" "$work/whole.spin" -o "$work/new.spin" $one $net --seed 3
err_has "refining 1 of 1 frames" "with another seed it is refined anew"
run "$bin/spin-retrain" "$work/whole.spin" -o "$work/plain.spin" --preset paper --device cpu --range 1:2 --scale 0.25 $net
is "$(splats_of "$work/plain.spin")" "$n_source" "without --refine the source's points are taken"

# Kills a run once its first frame is done, checks its output, resumes it, kills it in the network
# and resumes again.
stopped=$work/stopped.spin
kill_when() { # FILE ARGUMENTS...
    file=$1
    shift
    "$bin/spin-retrain" "$in" -o "$stopped" $few $net --threads 1 --save-every 3 "$@" \
        >"$work/out" 2>"$work/err" &
    pid=$!
    tries=0
    while [ ! -e "$file" ] && kill -0 $pid 2>/dev/null && [ $tries -lt 1200 ]; do
        sleep 0.02
        tries=$((tries + 1))
    done
    kill -KILL $pid 2>/dev/null
    wait $pid 2>/dev/null
}
kill_when "$stopped.parts/00000.spin"
if [ -e "$stopped" ] || [ -e "$stopped.parts/00001.spin" ]; then
    skip "stopped while refining" "it was over before it could be stopped"
else
    run "$bin/spin-retrain" "$in" -o "$stopped" $few $net
    fails 1 spin-retrain "unfinished frames without --resume"
    run "$bin/spin-retrain" "$in" -o "$stopped" $few $net --resume --seed 5
    is "$code" 2 "does not resume with another seed"
    err_has "the options or the images differ" "and says why"
fi
kill_when "$stopped.part" --resume
run "$bin/spin-retrain" "$in" -o "$stopped" $few $net --save-every 3 --resume
is "$code" 0 "resumes after two kills"
same "$work/whole.spin" "$stopped" "the bytes of a run never stopped"
nothing_at "$stopped." "no unfinished state is left"
run "$bin/spin-retrain" "$in" -o "$stopped" $few $net --save-every 3 --resume
err_has "already finished" "--resume of what is finished does nothing"

run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$work/bare.spin" --positions-only
run "$bin/spin-retrain" "$work/bare.spin" -o "$work/x.spin" $few --refine-start source
fails 1 spin-retrain "no attributes to start from"
run "$bin/spin-retrain" "$work/bare.spin" -o "$work/x.spin" $one --method frames
is "$code" 0 "points without colours are refined from grey"

done_testing
