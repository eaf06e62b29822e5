#!/bin/sh
# K: 4d 4dgs export import
# 4D splats and frames exported as .4dgs and imported again: valid by the specification, within its
# quantisation, with every loss reported.
. tests/cli/lib.sh

# The largest errors over all frames: a Python expression of "check" in the report.
within() { # NAME EXPRESSION
    python3 -c 'import json, sys
c = json.load(open(sys.argv[1]))["check"]
at = {k: v["largest"] for k, v in c.items() if isinstance(v, dict)}
sys.exit(not eval("(" + sys.argv[2] + ")"))' "$work/out" "$2"
    ok $? "$1"
}
obeys() { # FILE CONTENTS
    is "$(python3 tests/tools/check_4dgs.py "$1" 2>&1 | tail -1)" "$2" "$(basename "$1"): obeys the rules for writers"
}

# The largest errors are half a quantisation step; that of opacities follows from the rounding of
# window times.
for source in ftgs_ply/sh1_clamped/scene.ftgs.ply stglite/supersplat4d_sh1/scene.ply 4dgs/birth_sh2/scene.4dgs \
    4dgs/keyframe_chained/scene.4dgs; do
    name=$(dirname "$source" | tr / -)
    run "$bin/spin-import" "fixtures/$source" -o "$work/$name.spin"
    is "$code" 0 "$source: imported"
    run "$bin/spin-export" "$work/$name.spin" -o "$work/$name.4dgs" --fps 30 --check --json
    is "$code $(member to) $(member bytes)" "0 4dgs $(wc -c <"$work/$name.4dgs")" "exported by its extension"
    within "read back within the steps of the file" "at['log_scale'] < 0.004 and at['rotation_deg'] < 0.2 and
        at['opacity'] < 0.02 and at['sh'] < 0.0158 and c['place_sizes'] < 0.2"
    case $source in
    4dgs/*)
        within "colours as well" "at['colour'] < 0.001"
        stated=$(sed -n 's/.* rounds values; .*: position \([0-9.e-]*\) .*/\1/p' "$work/err")
        within "the stated error of positions is that of the file" "abs($stated / c['place']['rms'] - 1) < 0.1"
        ;;
    *) err_has "stores colours of 0 to 1: those of [0-9]* splats are clamped" "clamped colours are counted" ;;
    esac
done
run "$bin/spin-export" "$work/ftgs_ply-sh1_clamped.spin" -o "$work/short.4dgs" --range 0:1
fails 1 spin-export "windows in time in one frame"
err_has "a .4dgs needs a clip of two or more frames" "which a .4dgs cannot store"
nothing_at "$work/short.4dgs" "nothing was written"
obeys "$work/ftgs_ply-sh1_clamped.4dgs" "342 splats, 2 chunks, 1 windows, SH degree 1, 6.03333 s"
obeys "$work/stglite-supersplat4d_sh1.4dgs" "150 splats, 2 chunks, 1 windows, SH degree 1, 2 s"
obeys "$work/4dgs-birth_sh2.4dgs" "400 splats, 8 chunks, 4 windows, SH degree 2, 4 s"
obeys "$work/4dgs-keyframe_chained.4dgs" "627 splats, 6 chunks, 28 windows, SH degree 0, 2.4 s"

# Options of all formats of splats.
run "$bin/spin-export" "$work/4dgs-birth_sh2.spin" -o "$work/turned.4dgs" --rotate 90,30,0 --sh 1 --check --json
within "rotated, with fewer SH coefficients" "at['rotation_deg'] < 0.2 and c['place_sizes'] < 0.2"
obeys "$work/turned.4dgs" "400 splats, 8 chunks, 4 windows, SH degree 1, 4 s"
run "$bin/spin-export" "$work/4dgs-birth_sh2.spin" -o "$work/up.4dgs" --up z --range 30:60 --fps 15
obeys "$work/up.4dgs" "$(python3 tests/tools/check_4dgs.py "$work/up.4dgs" | sed 's/, [0-9.]* s$/, 2 s/')"

# The flag for antialiased splats.
LC_ALL=C sed '0,/^comment ftgs_version/s//comment antialiased 1\n&/' fixtures/ftgs_ply/sh1_clamped/scene.ftgs.ply \
    >"$work/anti.ftgs.ply"
for bundle in anti anti-back; do
    "$bin/spin-import" "$work/anti.ftgs.ply" -o "$work/anti.spin" --force -q
    "$bin/spin-export" "$work/anti.spin" -o "$work/anti.4dgs" --force -q 2>/dev/null
    [ $bundle = anti ] || "$bin/spin-import" "$work/anti.4dgs" -o "$work/anti-back.spin" -q
    is "$(python3 -c 'import json, sys, zipfile
print(json.load(zipfile.ZipFile(sys.argv[1]).open("meta.json"))["antialias"])' "$work/$bundle.spin")" True \
        "$bundle: marked for antialiasing"
done

# Frames become keyframes and deltas: for tracks, for frames without persistent rows, for SH that
# changes, and where most splats are new.
frames() { # SOURCE CONTENTS OPTION...
    source=$1 contents=$2
    shift 2
    name=$(echo "$source" | tr / -)
    run "$bin/spin-import" "fixtures/$source" -o "$work/$name.spin" --force
    [ "$code" = 0 ] || run "$bin/spin-import" "fixtures/$source" -o "$work/$name.spin" --force --frames 3
    run "$bin/spin-export" "$work/$name.spin" --to 4dgs -o "$work/$name.4dgs" --force --check --json "$@"
    is "$code $(member to) $(member bytes)" "0 4dgs $(wc -c <"$work/$name.4dgs")" "$source: frames are exported"
    within "read back within the steps of the file" "at['log_scale'] < 0.004 and at['rotation_deg'] < 0.2 and
        at['opacity'] < 0.001 and at['sh'] < 0.0158 and c['place_sizes'] < 1"
    obeys "$work/$name.4dgs" "$contents"
}
frames d3dgs/trained "1032 splats, 3 keyframes, 3 deltas, SH degree 0, 3 s" --fps 2
frames d3dgs/trained "1032 splats, 1 keyframes, 5 deltas, SH degree 0, 0.2 s" --fps 30 --rotate 90,30,0
frames ply/inria_sh3 "270 splats, 1 keyframes, 3 deltas, SH degree 3, 0.133333 s" --fps 30
frames ed3dgs/annealed_early/model "100 splats, 3 keyframes, 0 deltas, SH degree 3, 0.1 s" --fps 30
frames 3dgstream "1120 splats, 4 keyframes, 0 deltas, SH degree 1, 0.133333 s" --fps 30
frames 3dgstream "320 splats, 1 keyframes, 0 deltas, SH degree 1, 0.0333333 s" --fps 30 --range 0:1
run "$bin/spin-import" "$work/d3dgs-trained.4dgs" -o "$work/again.spin" --json
is "$(member frames)" 6 "as many frames"
run "$bin/spin-export" "$work/again.spin" --to ply -o "$work/again" --json
is "$(sed -n 's/ *"fps": \([0-9.]*\),/\1/p' "$work/again/sequence.json") $(member splats_mean)" "30 1032" \
    "with the rate and the splats that were written"

# The splats of tracks keep their ids after a retraining, also those that densification added.
run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$work/clip.spin"
run "$bin/spin-retrain" "$work/clip.spin" -o "$work/tracks.spin" --device cpu --scale 0.25 --iterations 60 --range 0:3
run "$bin/spin-export" "$work/tracks.spin" -o "$work/tracks.4dgs" --fps 30 --json
obeys "$work/tracks.4dgs" "$(member splats_mean) splats, 1 keyframes, 2 deltas, SH degree 0, 0.1 s"
run "$bin/spin-export" "$work/tracks.spin" --to ply -o "$work/tracks"
grep -q '"identity": true' "$work/tracks/sequence.json"
ok $? "and an import of their PLY files knows that rows are tracks"

# Empty frames before the first splat, and a clip without splats.
python3 - "$work/late" <<'P'
import os, struct, sys
os.mkdir(sys.argv[1])
names = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split()
for i in range(4):
    with open("%s/%d.ply" % (sys.argv[1], i), "wb") as f:
        f.write(("ply\nformat binary_little_endian 1.0\nelement vertex 2\n"
                 + "".join("property float %s\n" % n for n in names) + "end_header\n").encode())
        for k in range(2):
            f.write(struct.pack("<14f", i + k, 0, 0, 0, 0, 0, 1, -3, -3, -3, 1, 0, 0, 0))
P
run "$bin/spin-import" "$work/late" -o "$work/late.spin"
run "$bin/spin-export" "$work/late.spin" -o "$work/late.4dgs" --crop 1.5,-1,-1,9,9,9 --fps 30 --check --json
is "$code" 0 "frames without splats"
obeys "$work/late.4dgs" "3 splats, 2 keyframes, 2 deltas, SH degree 0, 0.133333 s"
run "$bin/spin-export" "$work/late.spin" -o "$work/none.4dgs" --crop 50,50,50,60,60,60 --fps 30
is "$code" 1 "no splat at all"
nothing_at "$work/none.4dgs" "nothing was written"

# What the format cannot store.
run "$bin/spin-import" fixtures/spacetimegs/full_techni -o "$work/cubic.spin"
run "$bin/spin-export" "$work/cubic.spin" -o "$work/cubic.4dgs"
is "$code" 0 "paths of degree 3"
err_has "a .4dgs cannot store paths of degree 3: they are approximated by degree 1, with errors of up to" "are fitted"
err_has "a .4dgs cannot represent rotations that change" "without their rotation"

# Windows that are not Gaussian: keyframes and deltas.
for source in "ex4dgs/small/model plateaus keep.their.full.opacity" "freetimegspp/gated_sh3 gates do.not.fade.to.0"; do
    # shellcheck disable=SC2086
    set -- $source
    "$bin/spin-import" "fixtures/$1" -o "$work/windows.spin" --force -q 2>/dev/null
    run "$bin/spin-export" "$work/windows.spin" -o "$work/windows.4dgs" --fps 30 --range 0:4 --force --check --json
    is "$code $(member frames)" "0 4" "$2: written as frames, and read back"
    err_has "writing 4 frames as keyframes and deltas: .*$3" "$2: says why"
    run "$bin/spin-import" --info "$work/windows.4dgs"
    out_has "keyframe-delta" "$2: the model of the file"
done

if [ -d "$fixtures/4dgs/conformance" ]; then
    mkdir "$work/corpus"
    for file in $(grep -l '"gaussian-birth"' "$fixtures"/4dgs/conformance/*.json) "$fixtures"/4dgs/conformance/keyframe/*.json; do
        name=$(basename "$file" .json)
        case $name in NoData* | *Objects*) continue ;; esac
        "$bin/spin-import" "${file%.json}.4dgs" -o "$work/corpus/$name.spin" -q 2>/dev/null && cp "$file" "$work/corpus"
    done
    is "$(python3 tests/tools/corpus_4dgs.py "$work/corpus" "$work"/corpus/*.spin 2>&1 | tail -1)" 49 \
        "49 files of the format's own corpus are read to its values"
    bad=
    for file in "$fixtures"/4dgs/conformance/*-Quantized-*.4dgs; do
        run "$bin/spin-import" "$file" -o "$work/corpus.spin" --force
        [ "$code" = 0 ] || continue
        run "$bin/spin-export" "$work/corpus.spin" -o "$work/corpus.4dgs" --fps 30 --force --check
        [ "$code" = 0 ] && python3 tests/tools/check_4dgs.py "$work/corpus.4dgs" >/dev/null 2>"$work/err" ||
            bad="$bad $(basename "$file"): $(tail -1 "$work/err")"
    done
    is "$bad" "" "the files of the format's own corpus, once read, are written by its rules"
fi
done_testing
