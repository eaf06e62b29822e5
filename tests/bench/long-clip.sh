#!/bin/sh
# long-clip.sh [FRAMES [SPLATS]]: the cost of a long clip, as tables for tests/bench/README.md.
#
# A synthetic clip (900 frames of 100,000 splats with different positions in each: 6.1 GB of PLY) is
# imported and exported as a page and as one GLB, first a ninth of its frames, then all. Then a
# synthetic run of Realtime-4DGS (200,000 rows) is imported as 4D splats of 900 frames, of which one
# is exported. Measures for each command: seconds, bytes written and peak memory of its own
# (RssAnon, sampled every 20 ms; the pages of mapped files are the system's).
#
# Needs 13 GB in WORK (a temporary folder) and python3. BIN: the commands (build/release/bin).
frames=${1:-900}
splats=${2:-100000}
bin=${BIN:-build/release/bin}
clip=$(dirname "$bin")/tests/bench/clip
work=${WORK:-}
[ -n "$work" ] || { work=$(mktemp -d) && trap 'rm -rf "$work"' EXIT; } || exit 1
trap 'exit 130' INT TERM
make -s "$clip" "$bin/spin-import" "$bin/spin-export" || exit 1

now() { date +%s.%N; }

# row NAME FILE COMMAND...: runs it; prints a row with its seconds, the bytes of FILE and its peak.
row() {
    name=$1
    file=$2
    shift 2
    from=$(now)
    "$@" >"$work/out" 2>&1 &
    pid=$!
    peak=0
    while kill -0 "$pid" 2>/dev/null; do
        kb=$(sed -n 's/^RssAnon:[^0-9]*\([0-9]*\).*/\1/p' "/proc/$pid/status" 2>/dev/null)
        [ "${kb:-0}" -gt "$peak" ] && peak=$kb
        sleep 0.02
    done
    wait "$pid" || {
        cat "$work/out" >&2
        exit 1
    }
    echo "$name $(now) $from $(stat -c %s "$file") $peak" |
        awk '{ printf "| %s | %.1f | %.1f | %.1f |\n", $1, $2 - $3, $4 / 1e6, $5 / 1024 }'
}

echo "$(sed -n 's/^model name[^:]*: //p' /proc/cpuinfo | head -n 1), $(nproc) threads"
echo "| | seconds | MB | peak of its own, MiB |"
echo "|---|---|---|---|"
"$clip" "$work/frames" "$frames" "$splats" 0 >"$work/out" 2>&1 || exit 1
for n in $((frames / 9)) "$frames"; do
    mkdir "$work/$n"
    ls "$work/frames"/frame_*.ply | head -n "$n" | while read -r file; do ln "$file" "$work/$n" || exit 1; done
    row "$n-frames-import" "$work/clip.spin" "$bin/spin-import" -q "$work/$n" --force -o "$work/clip.spin"
    row "$n-frames-html" "$work/clip.html" "$bin/spin-export" -q "$work/clip.spin" --force -o "$work/clip.html"
    row "$n-frames-glb" "$work/clip.glb" "$bin/spin-export" -q "$work/clip.spin" --force -o "$work/clip.glb"
    rm -f "$work/clip.html" "$work/clip.glb" "$work/clip.spin"
done
python3 tests/bench/make-checkpoint.py "$work/run.pth" $((2 * splats)) plain || exit 1
last=$(awk "BEGIN { printf \"%.6f\", ($frames - 1) / 30 }")
row "$((2 * splats))-rows-import" "$work/run.spin" "$bin/spin-import" -q "$work/run.pth" --time-duration "0,$last" \
    --force -o "$work/run.spin"
row "$((2 * splats))-rows-one-frame" "$work/one.ply" "$bin/spin-export" -q "$work/run.spin" \
    --range "$((frames / 2)):$((frames / 2 + 1))" --force -o "$work/one.ply"
