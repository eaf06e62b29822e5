#!/bin/sh
# same_exports.sh BIN BIN [WORD]: imports a run of each importer (whose name contains WORD) with the
# commands of two builds, exports it in every format with both, and lists the files that differ. It
# shows what a change of filters or formats alters. Exit code: 0 if all are equal.
#
#     git worktree add ../old COMMIT && make -C ../old all
#     sh tests/tools/same_exports.sh ../old/build/release/bin build/release/bin
. tests/runs.sh
old=${1:?usage: same_exports.sh BIN BIN [WORD]}
new=${2:?usage: same_exports.sh BIN BIN [WORD]}
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
n=0
refused=0
: >"$work/differences"

# compare COMMAND OUT ARGUMENT...: runs the command of both builds, with OUT in two folders.
compare() {
    command=$1 out=$2
    shift 2
    for side in old new; do
        bin=$old
        [ $side = old ] || bin=$new
        rm -rf "${work:?}/$side"
        mkdir "$work/$side"
        "$bin/$command" "$@" -q -o "$work/$side/$out" >/dev/null 2>&1
        echo $? >"$work/$side/exit-code"
    done
    n=$((n + 1))
    grep -qx 0 "$work/new/exit-code" || refused=$((refused + 1))
    diff -rq "$work/old" "$work/new" | sed "s|^|$command $*: |; s|$work/||g" >>"$work/differences"
}

for name in $(importers_of_runs "$new" | grep -e "${3:-}"); do
    run=fixtures/$(run_of "$name")
    [ "$run" != fixtures/ ] && [ -e "$run" ] || continue
    # Methods that are defined at any time need a number of frames; of long clips a few are enough.
    for frames in '' '--frames 3' '--range 0:24:8'; do
        # shellcheck disable=SC2086
        "$old/spin-import" "$run" -q -o "$work/$name.spin" --force $frames 2>/dev/null || continue
        [ "$("$old/spin-import" --info "$work/$name.spin" --json | sed -n 's/^  "frames": \([0-9]*\),*$/\1/p')" -gt 30 ] || break
    done
    # shellcheck disable=SC2086
    compare spin-import clip.spin "$run" $frames
    for format in $("$new/spin-export" --list | sed -n 's/^\([a-z0-9][^ ]*\) .*/\1/p' | grep -vx 'images\|video'); do
        compare spin-export "out-$format" "$work/$name.spin" --to "$format"
    done
    compare spin-export images "$work/$name.spin" --to images --path orbit --duration 0.1 --size 64x48
done
cat "$work/differences"
echo "$n commands of two builds, $refused refused: $(wc -l <"$work/differences") differences"
[ ! -s "$work/differences" ]
