#!/bin/sh
# K: retrain export interrupt ctrl-c resume
# The first Ctrl-C saves the work and ends; a second one during this time ends at once. Neither
# leaves an output that looks whole, and the same command starts over or goes on.
. tests/cli/lib.sh
in=$work/in.spin
run "$bin/spin-import" -q "$clip" --data "$clip" -o "$in"
is "$code" 0 "imports the clip"

# interrupted_twice READY COMMAND...: starts a command, waits until READY is there, and sends SIGINT
# twice. The second signal may come too late, when the command has ended; then it is tried again.
# Sets $code, and $late to whether all tries came too late.
interrupted_twice() {
    ready=$1 late=1 tries=0
    shift
    while [ $late = 1 ] && [ $tries -lt 5 ]; do
        tries=$((tries + 1))
        "$@" >"$work/out" 2>"$work/err" </dev/null &
        pid=$!
        waits=0
        while ! ls -d $ready >/dev/null 2>&1 && kill -0 $pid 2>/dev/null && [ $waits -lt 1200 ]; do
            sleep 0.05
            waits=$((waits + 1))
        done
        kill -INT $pid
        kill -INT $pid
        # Two signals that are pending at the same time are one: send more, as impatient users do.
        while kill -INT $pid 2>/dev/null; do :; done
        wait $pid 2>/dev/null
        code=$?
        grep -q interrupted "$work/err" || late=0
    done
}

training="$bin/spin-retrain $in --preset paper --levels 8 --hash-log2 18 --save-every 5"
# shellcheck disable=SC2086
interrupted_twice "$work/out.spin.part" $training --iterations 100000 -o "$work/out.spin"
is "$code $late" "130 0" "spin-retrain: the second Ctrl-C ends it at once"
[ ! -e "$work/out.spin" ]
ok $? "no output looks like a whole bundle"
run "$bin/spin-import" --info "$work/out.spin"
fails 1 spin-import "the bundle that was not written"
# shellcheck disable=SC2086
run $training --iterations 100000 -o "$work/out.spin"
fails 1 spin-retrain "the checkpoint of before is still there"
err_has "resume" "and the command says how to go on"
# shellcheck disable=SC2086
run $training --iterations 20 -o "$work/out.spin" --force
is "$code" 0 "the command can start over"
nothing_at "$work/out.spin." "and leaves nothing of the first try"

images="$bin/spin-export $in --to images --path orbit --size 1280x720 --repeat 40"
# shellcheck disable=SC2086
interrupted_twice "$work/images*" $images -o "$work/images"
is "$code $late" "130 0" "spin-export: the second Ctrl-C ends it at once"
whole=0
for image in "$work"/images/*.png; do
    [ -e "$image" ] || continue
    [ "$(tail -c 8 "$image" | od -An -tx1 | tr -d ' \n')" = 49454e44ae426082 ] || whole=1
done
ok $whole "each image that is there is whole"
page="$bin/spin-export $in -o $work/page.html"
for i in 1 2 3 4 5 6; do
    $page --force >/dev/null 2>&1 &
    pid=$!
    sleep 0.0$i
    kill -INT $pid 2>/dev/null
    while kill -INT $pid 2>/dev/null; do :; done
    wait $pid 2>/dev/null
    [ ! -e "$work/page.html" ] || grep -q '</html>' "$work/page.html" || whole=1
done
ok $whole "a page is whole or not there"
# shellcheck disable=SC2086
run $page --force
is "$code" 0 "the export can be repeated"
is "$(ls -a "$work" | grep -c 'page.html')" 1 "and leaves nothing of the first tries"
done_testing
