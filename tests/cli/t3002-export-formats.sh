#!/bin/sh
# K: html gltf glb splat compressed-ply spz
# spin-export: the other formats of splats, a file or a folder, and what they say about their error.
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

for pair in gltf:glb splat:splat compressed-ply:compressed.ply spz:spz; do
    to=${pair%%:*}
    end=${pair#*:}
    run "$bin/spin-export" "$in" --to "$to" -o "$work/$to" --json
    is "$code" 0 "exports $to"
    [ "$to" = gltf ] || err_has "error, rms" "$to: says how far it is from the bundle"
    is_json "$to: --json is one document"
    is "$(find "$work/$to" -name "frame_[0-9][0-9][0-9][0-9][0-9].$end" | wc -l)" "$frames" \
        "$to: one file a frame"
    run "$bin/spin-export" "$in" --to "$to" -o "$work/$to"
    fails 1 spin-export "$to: does not overwrite"
    run "$bin/spin-export" --to "$to" --help
    out_has "pattern" "$to: --help names its options"
    run "$bin/spin-export" "$in" --to "$to" -o "$work/never" --pattern x
    fails 2 spin-export "$to: a pattern without a number"
    nothing_at "$work/never" "$to: nothing was written"
done

run "$bin/spin-export" "$in" --to gltf -o "$work/clip.glb" --range 0:3
is "$code" 0 "exports a clip to one file"
is "$(head -c 4 "$work/clip.glb")" glTF "it is a GLB"
run "$bin/spin-export" "$in" --to gltf -o "$work/clip.glb"
fails 1 spin-export "a clip: does not overwrite"
SPIN_GLTF_SHIM=/no/such run "$bin/spin-export" "$in" --to gltf -o "$work/never.glb"
fails 1 spin-export "without tinygltf"
nothing_at "$work/never.glb" "without tinygltf: nothing was written"

run "$bin/spin-export" "$in" --to html -o "$work/clip.html"
is "$code" 0 "exports a page"
err_has "at most .* MB" "html: says how large it will be at most"
is "$(head -c 15 "$work/clip.html")" "<!doctype html>" "it is a page"
run "$bin/spin-export" "$in" --to html -o "$work/clip.html"
fails 1 spin-export "a page: does not overwrite"

done_testing
