#!/bin/sh
# K: matrix 4d import export formats
# Every importer combined with every exporter of splats, and imported again. `sh
# tests/cli/t3021-matrix.sh update` writes the tables of docs/formats.md.
. tests/cli/lib.sh
. tests/runs.sh

if ! python3 -c 'import numpy' 2>/dev/null; then
    skip "conversions" "no python3 with numpy"
    done_testing
fi

# A bundle of each importer's run, with frames at three times if the method is defined at any time.
runs=
for name in $(importers_of_runs "$bin"); do
    in=fixtures/$(run_of "$name")
    [ "$in" != fixtures/ ] && [ -e "$in" ] || continue
    "$bin/spin-import" "$in" -o "$work/$name.spin" -q 2>/dev/null ||
        run "$bin/spin-import" "$in" -o "$work/$name.spin" -q --frames 3
    runs="$runs $name=$work/$name.spin"
done

# Three clips: antialiased 4D splats, three frames of them, and tracks.
LC_ALL=C sed '0,/^comment ftgs_version/s//comment antialiased 1\n&/' fixtures/ftgs_ply/sh1_clamped/scene.ftgs.ply \
    >"$work/rows.ftgs.ply"
run "$bin/spin-import" "$work/rows.ftgs.ply" -o "$work/rows.spin"
is "$code" 0 "4D splats"
"$bin/spin-export" "$work/rows.spin" --to ply -o "$work/frames" --range 90:93 -q 2>/dev/null
run "$bin/spin-import" "$work/frames" -o "$work/frames.spin"
is "$code" 0 "frames"
run "$bin/spin-import" fixtures/d3dgs/trained -o "$work/tracks.spin"
is "$code" 0 "tracks"

# shellcheck disable=SC2086
python3 tests/tools/matrix.py "${1:-check}" "$bin" "$work" frames="$work/frames.spin" tracks="$work/tracks.spin" \
    rows="$work/rows.spin" -- $runs >"$work/faults" 2>"$work/err"
is "$?" 0 "all conversions"
is "$(cat "$work/faults")" "" "nothing is lost without a message, and docs/formats.md has the result"
[ -z "${1:-}" ] || sed 's/^/# /' "$work/err"
done_testing
