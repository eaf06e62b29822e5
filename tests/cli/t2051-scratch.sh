#!/bin/sh
# K: long retrain scratch
# A training whose frames do not fit into memory keeps them in temporary files (--scratch), and ends
# with the same bytes as one in memory.
. tests/cli/lib.sh

case ${SPIN_BUILD:-} in
*asan* | *tsan*)
    skip "temporary files" "sanitisers reserve more memory than ulimit -d allows"
    done_testing
    ;;
esac
in=$work/in.spin
mkdir "$work/out.d" "$work/scratch"
run "$SPIN_BUILD/tests/bench/clip" "$work/frames" 40 4000 0 2
run "$bin/spin-import" "$work/frames" -o "$in"
is "$code" 0 "imports a clip of 40 frames"
small='--data renders --data-from renders:cameras=3,test=1,size=96x54 --device cpu --threads 1
    --iterations 60 --track-iterations 40 --densify-every 8 --save-every 10'

# Runs a command whose own memory, without mapped files, is limited to this number of KiB.
limited() {
    kb=$1
    shift
    (ulimit -d "$kb" && run "$@" && exit "$code")
    code=$?
}

run "$bin/spin-retrain" "$in" --dry-run --json $small
needed=$(member bytes_needed)
is "$(member bytes_scratch)" 0 "with enough memory, no temporary files"
limited 4000000 "$bin/spin-retrain" "$in" --dry-run --json $small
used=$((4000000 * 1024 - $(member bytes_available)))
greater "$used" 0 && greater 1e9 "$used"
ok $? "ulimit -d limits the available memory ($used bytes are in use)"
limited $(((used + needed) / 1024 - 6000)) "$bin/spin-retrain" "$in" --dry-run --json $small
scratch=$(member bytes_scratch)
kb=$(((used + needed - scratch / 4) / 1024))

limited $kb "$bin/spin-retrain" "$in" --dry-run --json $small
is "$(member fits) $(member fits_disk)" "true true" "with less, the training fits"
greater "$scratch" 1000000 && greater "$needed" "$(($(member bytes_needed) + scratch / 2))"
ok $? "since $scratch bytes are in temporary files: $(member bytes_needed) instead of $needed bytes in memory"
limited $kb "$bin/spin-retrain" "$in" --dry-run $small
out_has "^ *and [0-9.]* [kM]B in temporary files (--scratch), since memory is short\$" "the plan says so"

run "$bin/spin-retrain" "$in" -o "$work/out.d/whole.spin" $small
is "$code" 0 "trains in memory"
limited $kb "$bin/spin-retrain" "$in" -o "$work/out.d/files.spin" $small
is "$code" 0 "trains in temporary files"
err_has "^the state of the training, [0-9.]* MB, does not fit into the [0-9.]* MB of memory that are free: it is kept in temporary files in '$work/out.d'\$" "says where they are"
cmp -s "$work/out.d/whole.spin" "$work/out.d/files.spin"
ok $? "to the same bytes"
is "$(ls -A "$work/out.d" | tr '\n' ' ')" "files.spin whole.spin " "no temporary file is left"

# The files are in the chosen folder, have no name, and are all there is at an interrupt.
limited $kb strace -f -qq -e trace=openat,mmap,madvise -o "$work/trace" "$bin/spin-retrain" "$in" \
    -o "$work/out.d/chosen.spin" --scratch "$work/scratch" $small
if [ -s "$work/trace" ]; then
    grep -q "\"$work/scratch/" "$work/trace" && ! grep -q "\"$work/out.d/.spin4d-" "$work/trace"
    ok $? "--scratch chooses the folder"
    greater "$(grep -c "PROT_READ|PROT_WRITE, MAP_SHARED, [0-9]" "$work/trace")" 120
    ok $? "the arrays of each frame are pages of files"
    greater "$(grep -c "MADV_WILLNEED" "$work/trace")" 50
    ok $? "which are read ahead of the iteration"
else
    skip "--scratch chooses the folder" "strace is not here"
fi
rm -f "$work/out.d/chosen.spin"*
(
    ulimit -d $kb
    exec "$bin/spin-retrain" "$in" -o "$work/out.d/stopped.spin" --scratch "$work/scratch" $small \
        >"$work/out" 2>"$work/err"
) &
pid=$!
while [ ! -s "$work/out.d/stopped.spin.part" ] && kill -0 $pid 2>/dev/null; do sleep 0.02; done
kill -INT $pid 2>/dev/null
wait $pid
is "$(ls -A "$work/scratch")" "" "an interrupt leaves no temporary file"
if [ -e "$work/out.d/stopped.spin" ]; then
    skip "resuming" "the run was over before it could be stopped"
else
    limited $kb "$bin/spin-retrain" "$in" -o "$work/out.d/stopped.spin" --resume $small
    is "$code" 0 "resumes in temporary files"
    err_has "^resuming at iteration" "from the checkpoint"
    cmp -s "$work/out.d/whole.spin" "$work/out.d/stopped.spin"
    ok $? "to the same bytes, too"
fi

# A checkpoint after the last densification has no statistics, and resumes to the same bytes.
if command -v unzip >/dev/null; then
    long="$small --iterations 200"
    "$bin/spin-retrain" "$in" -o "$work/late.spin" $long >"$work/out" 2>"$work/err" &
    pid=$!
    seen=1
    while [ $seen != 0 ] && kill -0 $pid 2>/dev/null; do
        sleep 0.02
        unzip -l "$work/late.spin.part" >"$work/list" 2>/dev/null &&
            grep -q "frames/00000/track" "$work/list" && ! grep -q "gradient" "$work/list"
        seen=$?
    done
    ok $seen "checkpoints after the last densification contain no statistics"
    kill -INT $pid 2>/dev/null
    wait $pid
    rm -f "$work/late.spin"
    run "$bin/spin-retrain" "$in" -o "$work/late.spin" $long --resume
    run "$bin/spin-retrain" "$in" -o "$work/late-whole.spin" $long
    cmp -s "$work/late-whole.spin" "$work/late.spin"
    ok $? "and resume to the same bytes"
else
    skip "checkpoints after the last densification" "unzip is not here"
fi

limited $kb "$bin/spin-retrain" "$in" -o "$work/out.d/no.spin" --scratch off $small -q
fails 1 spin-retrain "--scratch off"
err_has "the training needs about [0-9.]* MB of memory, but only" "and says what is lacking"
run "$bin/spin-retrain" "$in" -o "$work/no.spin" --scratch "$work/missing" $small
fails 1 spin-retrain "a folder that does not exist"
err_has "cannot keep 8.19 kB in a temporary file in '$work/missing': No such file or directory; give another folder with --scratch\$" "and says which"
run "$bin/spin-retrain" "$in" -o "$work/no.spin" --scratch "$in" $small
fails 1 spin-retrain "a file instead of a folder"
nothing_at "$work/no.spin" "no output"
if [ -w /dev/shm ]; then
    run "$bin/spin-retrain" "$in" --dry-run --scratch /dev/shm $small
    err_has "'/dev/shm' is in memory, not on a disk: --scratch saves no memory there\$" "a folder in memory is of no use"
fi
done_testing
