#!/bin/sh
# export.sh [frame|clip|all]: speed and size of exports, as tables for tests/bench/README.md.
#
# frame: one frame of a million splats with SH of degree 3, to PLY, GLB, compressed PLY and SPZ,
#        alternating with splat-transform on the same frame.
# clip:  150 frames of 100,000 splats to PLY, alternating with cp of the same files, with and
# without
#        waiting until the data has reached the disk.
#
# RUNS=5: runs of each; the tables have the median. FRAMES=150: of the clip. WORK: a folder with 3
# GB of free space for the frame and 12 GB for the clip (a temporary one). BIN: the commands
# (build/release/bin). SPLAT_TRANSFORM: its cli.mjs (that of tests/viewers/node_modules, which make
# test-viewers fetches); without it and Node its rows are omitted. Needs Debian's package time.
what=${1:-all}
runs=${RUNS:-5}
frames=${FRAMES:-150}
bin=${BIN:-build/release/bin}
clip=$(dirname "$bin")/tests/bench/clip
peer=${SPLAT_TRANSFORM:-tests/viewers/node_modules/@playcanvas/splat-transform/bin/cli.mjs}
work=${WORK:-}
[ -n "$work" ] || { work=$(mktemp -d) && trap 'rm -rf "$work"' EXIT; } || exit 1
trap 'exit 130' INT TERM
[ -x /usr/bin/time ] || { echo "export: no /usr/bin/time (Debian: time)" >&2; exit 1; }
make -s "$clip" "$bin/spin-import" "$bin/spin-export" || exit 1

# measure LOG COMMAND...: appends wall, user and system seconds and peak kB as a line to LOG.
measure() {
    log=$1
    shift
    /usr/bin/time -a -o "$log" -f '%e %U %S %M' "$@" >"$work/out" 2>&1 || {
        cat "$work/out" >&2
        exit 1
    }
}

# median LOG EXPRESSION: the median of an awk expression of the fields.
median() {
    awk "{ print $2 }" "$1" | sort -g | awk '{ v[NR] = $1 } END { print v[int((NR + 1) / 2)] }'
}

machine() {
    echo "$(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc) threads;" \
        "load $(cut -d' ' -f1 /proc/loadavg) at the start; $(date +%F)"
}

frame() {
    "$clip" "$work/frame" 1 1000000 3 >"$work/out" 2>&1 || exit 1
    "$bin/spin-import" -q "$work/frame" -o "$work/frame.spin" >/dev/null || exit 1
    [ -f "$peer" ] && command -v node >/dev/null 2>&1 || peer=
    for pair in ply:ply gltf:glb compressed-ply:compressed.ply spz:spz; do
        to=${pair%%:*}
        i=0
        rm -f "$work/$to.ours" "$work/$to.peer"
        while [ $i -lt "$runs" ]; do
            i=$((i + 1))
            rm -rf "$work/out-$to"
            measure "$work/$to.ours" "$bin/spin-export" -q "$work/frame.spin" --to "$to" \
                -o "$work/out-$to"
            [ -n "$peer" ] && measure "$work/$to.peer" node "$peer" -q -w \
                "$work/frame/frame_00000.ply" "$work/peer.${pair#*:}"
        done
    done
    echo "One frame, 1,000,000 splats, SH 3; median of $runs; $(machine)"
    [ -n "$peer" ] && sed -n 's/^ *"version": "\(.*\)".*/Peer: splat-transform \1/p' \
        "$(dirname "$peer")/../package.json"
    echo
    echo "| format | wall s | CPU s | peak MB | peer wall s | CPU s | peak MB | wall | CPU | memory |"
    echo "|---|---|---|---|---|---|---|---|---|---|"
    for to in ply gltf compressed-ply spz; do
        {
            median "$work/$to.ours" '$1'
            median "$work/$to.ours" '$2 + $3'
            median "$work/$to.ours" '$4 / 1000'
            [ -n "$peer" ] && median "$work/$to.peer" '$1'
            [ -n "$peer" ] && median "$work/$to.peer" '$2 + $3'
            [ -n "$peer" ] && median "$work/$to.peer" '$4 / 1000'
        } | awk -v to="$to" '{ v[NR] = $1 } END {
            printf "| %s | %.2f | %.2f | %.0f |", to, v[1], v[2], v[3]
            if (NR == 6)
                printf " %.2f | %.2f | %.0f | %.1fx | %.1fx | %.0f %% |", v[4], v[5], v[6],
                    v[4] / v[1], v[5] / v[2], 100 * v[3] / v[6]
            printf "\n" }'
    done
    echo
}

clip() {
    "$clip" "$work/clip" "$frames" 100000 3 >"$work/out" 2>&1 || exit 1
    "$bin/spin-import" -q "$work/clip" -o "$work/clip.spin" >/dev/null || exit 1
    rm -rf "$work/clip" "$work"/clip.*.log
    i=0
    while [ $i -lt "$runs" ]; do
        i=$((i + 1))
        rm -rf "$work/frames" && sync
        measure "$work/clip.wait.log" "$bin/spin-export" -q "$work/clip.spin" --to ply --sync \
            -o "$work/frames"
        rm -rf "$work/frames" && sync
        measure "$work/clip.ours.log" "$bin/spin-export" -q "$work/clip.spin" --to ply \
            -o "$work/frames"
        rm -rf "$work/copy" && sync
        measure "$work/clip.cp.log" cp -r "$work/frames" "$work/copy"
        rm -rf "$work/copy" && sync
        measure "$work/clip.sync.log" sh -c 'cp -r "$1" "$2" && sync "$2"/*' sh "$work/frames" \
            "$work/copy"
        rm -rf "$work/copy"
    done
    bytes=$(cat "$work/frames"/*.ply | wc -c)
    echo "$frames frames, 100,000 splats each, SH 3, $bytes bytes of PLY; median of $runs; $(machine)"
    echo
    echo "| | wall s | CPU s | peak MB | GB/s |"
    echo "|---|---|---|---|---|"
    for row in "ours:spin-export --to ply" "cp:cp" "wait:spin-export --to ply --sync" \
        "sync:cp, then sync"; do
        log=$work/clip.${row%%:*}.log
        awk -v name="${row#*:}" -v wall="$(median "$log" '$1')" -v cpu="$(median "$log" '$2 + $3')" \
            -v peak="$(median "$log" '$4 / 1000')" -v bytes="$bytes" 'BEGIN {
            printf "| %s | %.2f | %.2f | %.0f | %.2f |\n", name, wall, cpu, peak, bytes / wall / 1e9 }'
    done
    echo
}

case $what in
frame) frame ;;
clip) clip ;;
all)
    frame
    clip
    ;;
*)
    echo "usage: export.sh [frame|clip|all]" >&2
    exit 2
    ;;
esac
