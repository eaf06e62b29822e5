#!/bin/sh
# K: html gltf glb splat compressed-ply spz usd
# spin-export: the other splat formats, as a file or as a folder, and the error that each reports.
. tests/cli/lib.sh

run_of=$fixtures/d3dgs/trained
if [ ! -d "$run_of" ]; then
    skip "export" "no fixtures at $run_of"
    done_testing
fi
in=$work/in.spin
run "$bin/spin-import" "$run_of" -o "$in" --json
is "$code" 0 "imports the run"
frames=$(member frames)

for pair in gltf:glb splat:splat compressed-ply:compressed.ply spz:spz usd:usda; do
    to=${pair%%:*}
    end=${pair#*:}
    check=--check
    [ "$to" != usd ] || check=
    run "$bin/spin-export" "$in" --to "$to" -o "$work/$to" --json $check
    is "$code" 0 "exports $to"
    if [ "$to" != gltf ] && [ "$to" != usd ]; then
        python3 tests/cli/rounding.py "$work/out" "$work/err"
        ok $? "$to: says how far it is from the bundle"
    fi
    is_json "$to: --json is one document"
    is "$(find "$work/$to" -name "frame_[0-9][0-9][0-9][0-9][0-9].$end" | wc -l)" "$frames" \
        "$to: one file a frame"
    run "$bin/spin-export" "$in" --to "$to" -o "$work/$to"
    fails 1 spin-export "$to: does not overwrite"
    run "$bin/spin-export" --to "$to" --help
    out_has "pattern" "$to: --help names its options"
    run "$bin/spin-export" "$in" --to "$to" -o "$work/fps-$to" --range 0:1 --fps 12.5
    grep -q '"fps": 12.5' "$work/fps-$to/sequence.json"
    ok $? "$to: --fps is said of the sequence"
    run "$bin/spin-export" "$in" --to "$to" -o "$work/never" --pattern x
    fails 2 spin-export "$to: a pattern without a number"
    nothing_at "$work/never" "$to: nothing was written"
done

# The extension of the output chooses the format; one frame is written to a file, several need a
# folder.
for end in ply compressed.ply glb sog splat spz usda html; do
    if [ $end = sog ] && ! ldconfig -p 2>/dev/null | grep -q 'libwebp\.so\.7'; then
        skip "one .sog" "no libwebp"
        continue
    fi
    run "$bin/spin-export" "$in" -o "$work/one.$end" --range 1:2
    is "$code" 0 "one frame as .$end"
    [ -f "$work/one.$end" ]
    ok $? "is one file"
    run "$bin/spin-export" "$in" -o "$work/one.$end" --range 1:2
    fails 1 spin-export ".$end: does not overwrite"
done
cmp -s "$work/one.spz" "$work/spz/frame_00001.spz"
ok $? "and the same as in a folder"
is "$(find "$work" -maxdepth 1 -name 'sequence.json' | wc -l)" 0 "nothing lies beside it"
run "$bin/spin-export" "$in" -o "$work/many.spz"
fails 2 spin-export "several frames to one file"
err_has "name a folder ('.*/many/')" "it names a folder"
nothing_at "$work/many.spz" "and writes nothing"
run "$bin/spin-export" "$in" -o "$work/many"
fails 2 spin-export "no ending and no --to"
run "$bin/spin-export" "$in" -o "$work/one.sog" --to spz --range 1:2 --force
fails 2 spin-export "--to is not overruled by the name of another format"
run "$bin/spin-export" "$in" -o "$work/checked.spz" --range 1:2 --check --json
is "$code" 0 "one file is checked"
run "$bin/spin-export" "$in" --to usd --half -o "$work/half" --range 0:1
err_has "usd rounds values; rms error" "usd: says what half floats cost"

run "$bin/spin-export" "$in" --to gltf -o "$work/clip.glb" --range 0:3
is "$code" 0 "exports a clip to one file"
is "$(head -c 4 "$work/clip.glb")" glTF "it is a GLB"
run "$bin/spin-export" "$in" --to gltf -o "$work/clip.glb"
fails 1 spin-export "a clip: does not overwrite"

run "$bin/spin-export" "$in" --to html -o "$work/clip.html"
is "$code" 0 "exports a page"
err_has "largest errors of [0-9]* values: position .* (bound .*" "html: says how far values are off, and may be"
is "$(head -c 15 "$work/clip.html")" "<!doctype html>" "it is a page"
run "$bin/spin-export" "$in" --to html -o "$work/clip.html"
fails 1 spin-export "a page: does not overwrite"
run "$bin/spin-export" "$in" --to html -o "$work/parts.html" --split --level fine --sh 0 --bound-place 0.01 \
    --bound-colour 2 --bound-scale 3 --bound-rotation 2 --bound-sh 0.1 --key-every 2
is "$code" 0 "exports a page and its blocks"
err_has "position .* (bound 0.01), scale .* (3.00), rotation .* (2.00), opacity .* (2.00), colour .* (2.00)" \
    "html: the bounds are those asked for"
[ -s "$work/parts.bin" ]
ok $? "its blocks lie beside it"
rm "$work/parts.html"
run "$bin/spin-export" "$in" --to html -o "$work/parts.html" --split
fails 1 spin-export "blocks that are there: does not overwrite"
nothing_at "$work/parts.html" "blocks that are there: no page"

# Splats trained antialiased: formats with a flag for it store it, others cause a warning. A PLY
# that is imported again is drawn identically to the last digit, since no value is rounded to half
# precision.
run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$work/clip.spin"
run "$bin/spin-retrain" "$work/clip.spin" -o "$work/anti.spin" --device cpu --scale 0.25 --method frames \
    --refine 20 --antialias on --precision full
is "$code" 0 "refines antialiased"
for to in ply compressed-ply spz html; do
    run "$bin/spin-export" "$work/anti.spin" --to $to -o "$work/anti-$to"
    is "$code" 0 "antialiased: exports $to"
    grep -q 'trained with antialiasing' "$work/err"
    is $? 1 "antialiased: $to needs no warning"
done
grep -aq '^comment antialiased 1$' "$work/anti-ply/frame_00000.ply"
ok $? "antialiased: PLY says so"
is "$(od -An -tu1 -j14 -N1 "$work/anti-spz/frame_00000.spz" | tr -d ' ')" 1 "antialiased: SPZ has the flag"
is "$(od -An -tu1 -j14 -N1 "$work/spz/frame_00000.spz" | tr -d ' ')" 0 "and others have not"
grep -q '"antialias":true' "$work/anti-html"
ok $? "antialiased: so has the page"
for to in splat gltf; do
    run "$bin/spin-export" "$work/anti.spin" --to $to -o "$work/anti-$to" --check
    err_has 'trained with antialiasing' "antialiased: a warning with $to"
done
out_has "rendered from the file: \([0-9][0-9][0-9]\.\|the\)" "antialiased: --check draws both so"
run "$bin/spin-eval" "$work/anti.spin" --scale 0.25 --json
first=$(member psnr)
run "$bin/spin-import" --from ply "$work/anti-ply" --data $clip --pair order -o "$work/back.spin"
is "$code" 0 "antialiased: the PLY comes back"
run "$bin/spin-eval" "$work/back.spin" --pair order --scale 0.25 --json
is "$(member psnr)" "$first" "antialiased: and looks the same"
run "$bin/spin-import" --from gltf "$work/anti-gltf" --data $clip --pair order -o "$work/back-gltf.spin"
run "$bin/spin-eval" "$work/back-gltf.spin" --pair order --scale 0.25 --json
is "$(member psnr | cut -c1-5)" "$(echo "$first" | cut -c1-5)" "antialiased: a GLB comes back so, too"
run "$bin/spin-export" "$work/anti.spin" --to usd -o "$work/anti-usd"
grep -q '^        bool antialias = true$' "$work/anti-usd/clip.usda"
ok $? "antialiased: USD says so"

# One splat in one frame: messages use the singular, and "at most" holds for small files.
printf 'ply\nformat ascii 1.0\nelement vertex 1\n' >"$work/one.ply"
printf 'property float %s\n' x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3 >>"$work/one.ply"
printf 'end_header\n1 2 3 4 5 6 2 -5 -5 -5 1 0 0 0\n' >>"$work/one.ply"
run "$bin/spin-import" "$work/one.ply" -o "$work/one.spin"
for to in ply compressed-ply spz "spz --spz-version 3" sog splat gltf usd html; do
    # shellcheck disable=SC2086
    run "$bin/spin-export" "$work/one.spin" --to $to -o "$work/one-out" --force
    is "$code" 0 "one splat as $to"
    ! grep -q '\b1 \(splat\|frame\|version\)s' "$work/out" "$work/err"
    ok $? "$to: one splat, one frame"
    # The announced files are the frames, without sequence.json
    others=$(stat -c %s "$work/one-out/sequence.json" 2>/dev/null)
    awk -v others="${others:-0}" '/^writing .* at most/ { most = $NF == "kB" ? 1000 * $(NF - 1) : $(NF - 1) }
        / as .* each, / { is = $NF == "kB" ? 1000 * $(NF - 1) : $(NF - 1) } END { exit most != "" && is - others > most }' \
        FS=' ' "$work/err" "$work/out"
    ok $? "$to: at most as many bytes as it said: $(grep -h 'at most\|each' "$work/err" "$work/out" | tr '\n' ' ')"
    rm -rf "$work/one-out"
done
run "$bin/spin-export" "$work/one.spin" --to splat -o "$work/one-splat"
err_has "clamps bright and dark colours, with errors of up to 1.2 on a scale from 0 to 1" \
    "a colour that .splat cuts off is warned of"

done_testing
