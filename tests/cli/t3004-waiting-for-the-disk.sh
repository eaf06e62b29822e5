#!/bin/sh
# K: import export retrain sync
# Which commands wait until their output has reached the disk: trainings always, imports and exports
# with --sync.
. tests/cli/lib.sh

in=$work/in.spin

# syncs COMMAND...: the number of its calls of fsync.
syncs() {
    traced -f -qq -e trace=fsync,fdatasync -o "$work/strace" "$@" >"$work/out" 2>"$work/err"
    grep -c 'sync([0-9]' "$work/strace"
}
if ! strace -f -o "$work/strace" true 2>/dev/null; then
    skip "who waits for the disk" "no strace"
    done_testing
fi
run "$bin/spin-import" "$clip" --data "$clip" -o "$in" --json
frames=$(member frames)

is "$(syncs "$bin/spin-import" "$clip" --data "$clip" -o "$work/a.spin")" 0 "an import does not wait"
is "$(syncs "$bin/spin-import" "$clip" --data "$clip" -o "$work/b.spin" --sync)" 1 "but with --sync"
is "$(syncs "$bin/spin-export" "$in" --to ply -o "$work/wait-a")" 0 "an export does not wait"
is "$(syncs "$bin/spin-export" "$in" --to ply -o "$work/wait-b" --sync)" $((frames + 1)) \
    "but with --sync: for every frame and sequence.json"
for to in gltf:glb html:html; do
    is "$(syncs "$bin/spin-export" "$in" --to "${to%%:*}" -o "$work/wait.${to#*:}" --sync)" 1 \
        "${to#*:}: --sync"
done
n=$(syncs "$bin/spin-export" "$in" --to images --path orbit --repeat 1 --size 64x48 -o "$work/wait-c" --sync)
is "$n" "$(find "$work/wait-c" -type f | wc -l)" "images: --sync"
if "$bin/spin-export" -q "$in" --to video -o "$work/try.mp4" 2>"$work/err"; then
    is "$(syncs "$bin/spin-export" "$in" --to video -o "$work/wait.mp4" --sync)" 1 "video: --sync"
else
    skip "video: --sync" "$(cat "$work/err")"
fi
n=$(syncs "$bin/spin-retrain" "$in" -o "$work/wait.spin" --preset paper --device cpu --iterations 6 \
    --save-every 2 --levels 2 --hash-log2 8 --hidden 8)
is "$n" 3 "a retraining waits for every state that it saves and for its output"

done_testing
