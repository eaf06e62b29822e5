#!/bin/sh
# K: export import formats reproducible
# Files written seconds apart are identical: no format stores the time of day. (Reports contain
# measured speeds.)
. tests/cli/lib.sh

run "$bin/spin-import" "$clip" --data "$clip" -o "$work/clip.spin"
is "$code" 0 "imports"
run "$bin/spin-import" fixtures/sogst/no_segments/scene.sogst -o "$work/rows.spin"
is "$code" 0 "imports 4D splats"
videos=$([ -e "$(dirname "$bin")/lib/spin-video.so" ] && echo "mp4 webm")
write_all() { # FOLDER
    mkdir "$work/$1"
    run "$bin/spin-import" -q "$clip" --data "$clip" -o "$work/$1/clip.spin"
    is "$code" 0 "$1: a bundle"
    for to in ply compressed-ply splat spz sog gltf usd html "images --format png" "images --format exr"; do
        # shellcheck disable=SC2086
        run "$bin/spin-export" -q "$work/clip.spin" --range 0:2 --to $to -o "$work/$1/${to##* }"
        is "$code" 0 "$1: $to"
    done
    for end in tsog sogst ftgs.ply sogst.ply; do
        run "$bin/spin-export" -q "$work/rows.spin" -o "$work/$1/rows.$end"
        is "$code" 0 "$1: $end"
    done
    for end in $videos; do
        run "$bin/spin-export" -q "$work/clip.spin" --to video -o "$work/$1/clip.$end"
        is "$code" 0 "$1: $end"
    done
}
write_all one
sleep 2 # as fine as the times of ZIP are
write_all two
run diff -rq "$work/one" "$work/two"
is "$code" 0 "both are the same bytes"
done_testing
