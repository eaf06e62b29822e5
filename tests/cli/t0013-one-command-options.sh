#!/bin/sh
# K: spin4d one command crop floaters size fps up
# spin4d passes --crop, --floaters, --size, --fps and --up to the export, refuses them before the
# import if the exporter lacks them, and removes the imported bundle if it fails.
. tests/cli/lib.sh
bin=$(cd "$bin" && pwd)
clip=$(pwd)/fixtures/court-mini
mkdir "$work/run"
cp $clip/params.npz "$work/run"
cd "$work" || exit 1

for how in "--crop 0,0,0,1.5" "--floaters 3" "--crop -1,-1,-1,1,1,1"; do
    rm -rf cut* same all
    # shellcheck disable=SC2086
    run "$bin/spin4d" run --to ply -o cut/ $how
    is "$code" 0 "spin4d $how"
    # shellcheck disable=SC2086
    "$bin/spin-export" cut.spin --to ply -o same/ $how -q
    "$bin/spin-export" cut.spin --to ply -o all/ -q
    diff -r cut same >/dev/null
    ok $? "writes what spin-export writes"
    diff -r cut all >/dev/null
    is $? 1 "which is not the whole clip"
done
run "$bin/spin4d" run --to spz -o up/ --up -y
"$bin/spin-export" up.spin --to spz -o same-up/ --up -y -q
diff -r up same-up >/dev/null
is "$code $?" "0 0" "--up is that of spin-export"
run "$bin/spin4d" run -o small/ --to images --size 64x48
is "$code" 0 "--size"
python3 -c 'import struct, sys
w, h = struct.unpack(">II", open(sys.argv[1], "rb").read(24)[16:])
sys.exit((w, h) != (64, 48))' "$(find small -name '*.png' | head -n 1)"
ok $? "is that of the images"
run "$bin/spin4d" run -o slow.html --fps 5 --fps 2
is "$code $(grep -o '"fps":[ 0-9.]*' slow.html | head -n 1 | tr -d ' ')" '0 "fps":2' "--fps, of which the last counts"

# ---- Refused before anything is read ------------------------------------------------------------

for wrong in --size=64 --size=64x8 --size=64x48x --fps=0 --fps=fast --up=w --crop=1,2,3 --crop=0,0,0,-1 --crop=0,0,0,1,1 \
    --crop=0,0,0,1,1,-1 --floaters=0; do
    run "$bin/spin4d" run -o never.mp4 "$wrong"
    fails 2 spin4d "$wrong"
done
run "$bin/spin4d" run -o never.ply --size 64x48
fails 2 spin4d "an exporter without --size"
err_has "'ply' has no option --size" "which is named"
nothing_at never "nothing was written"

# ---- An export that fails leaves no imported bundle ---------------------------------------------

run "$bin/spin4d" run -o never.stg.ply --no-retrain
is "$code" 1 "frames as 4D splats of another program"
is "$(ls -d never* 2>/dev/null)" "" "leave nothing beside the output"
run "$bin/spin4d" run -o up.html
is "$code $(ls -d up*import* 2>/dev/null)" "1 " "nor if the bundle's name is taken"
# Several frames do not fit in one file of a format with one frame per file. This is said before the
# training.
run "$bin/spin4d" "$clip" -o "$work/several.ply" -q
fails 2 spin4d "six frames as one PLY"
err_has "cannot write 6 frames to the single file '.*several.ply'.*--to ply" "says what to name instead"
[ -z "$(find "$work" -name 'several*')" ]
ok $? "and leaves nothing"
done_testing
