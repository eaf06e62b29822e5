#!/bin/sh
# K: for export spin4d usd spz ply gltf sog
# --for PROGRAM: the format, the name and the options that it sets, and those that it leaves alone.
. tests/cli/lib.sh

run "$bin/spin-import" fixtures/d3dgs/cloud -o "$work/in.spin"
is "$code" 0 "a clip with tracks"

# program, output, exporter, expected name of a file, what the line says
try() {
    program=$1 output=$2 file=$3 said=$4
    shift 4
    run "$bin/spin-export" "$work/in.spin" --for "$program" -o "$work/$output" --range 2:4 "$@"
    is "$code" 0 "--for $program -o $output"
    [ -s "$work/$file" ]
    ok $? "$program: $file"
    err_has "^for $program ($(tried "$program")): '.*'$said\$" "$program: prints what it set"
    missing=
    for pair in $(printf '%s' "$said" | sed 's/ --to [a-z-]*//; s/, .*//; s/ \(--[a-z-]*\) \([^ ]*\)/ \1=\2/g'); do
        row "$program" | grep -qe "$(printf '%s' "$pair" | tr = ' ')" || missing="$missing $pair"
    done
    is "$missing" "" "$program: docs/viewers.md has its options"
}

# The row of a program in the table of docs/viewers.md, and its last word.
row() { grep "^| [^|]* | \`$1\` | " docs/viewers.md; }
tried() { row "$1" | sed 's/.* | \([a-z ]*\) |$/\1/'; }

header() { LC_ALL=C sed '/^end_header/q' "$1"; }

try unreal ue ue/frame_00000.ply ' --to ply --start 0 --max-scale 0'
is "$(ls "$work/ue" | grep -c ply)" 2 "unreal: frames are counted from 0"
! grep -q "row i is not the same splat" "$work/err"
ok $? "unreal: no warning about rows"
try unity un un/frame_00002.ply ' --to ply --sh 3'
is "$(header "$work/un/frame_00002.ply" | grep -c f_rest)" 45 "unity: SH of degree 3, 248 bytes a splat"
for program in nuke houdini omniverse; do
    try "$program" "$program" "$program.usdc" ' --to usd'
    is "$(head -c 8 "$work/$program.usdc")" PXR-USDC "$program: one crate"
    grep -q srgb_rec709_scene "$work/$program.usdc"
    ok $? "$program: the colours are tagged"
done
try omniverse om.spz om.spz ' --to spz --spz-version 3' --range 2:3
is "$(head -c 2 "$work/om.spz" | od -An -tx1 | tr -d ' ')" 1f8b "omniverse: SPZ of version 3"
try blender bl bl/frame_00001.ply ' --to ply --start 1'
try supersplat ss ss/frame_00002.compressed.ply ' --to compressed-ply'
try spark sp sp/frame_00002.spz ' --to spz --spz-version 3'
is "$(head -c 2 "$work/sp/frame_00002.spz" | od -An -tx1 | tr -d ' ')" 1f8b "spark: SPZ of version 3"
try playcanvas pc pc/frame_00002.sog ' --to sog'
try babylon bb bb.glb ' --to gltf --axes gltf'
is "$(head -c 4 "$work/bb.glb")" glTF "babylon: one GLB"
try visionos vi vi/frame_00002.ply ' --to ply'

# Options that are given win, and so does the name of the output.
try unity given given/frame_00002.ply ' --to ply' --sh 0
is "$(header "$work/given/frame_00002.ply" | grep -c f_rest)" 0 "unity: --sh 0 wins"
try spark given4 given4/frame_00002.spz ' --to spz' --spz-version 4
is "$(head -c 4 "$work/given4/frame_00002.spz")" NGSP "spark: --spz-version 4 wins"
try babylon named/ named/frame_00002.glb ' --to gltf --axes gltf'
try nuke other.usdz other.usdz ' --to usd'
try unreal big big/frame_00000.ply ' --to ply --start 0' --max-scale 5
try babylon bag bag/frame_00002.ply ', with the options given' --to ply

# Frames that are not the same splats.
run "$bin/spin-import" fixtures/splats/spz4 -o "$work/frames.spin"
run "$bin/spin-export" "$work/frames.spin" --for unreal -o "$work/frames"
is "$code" 0 "frames for unreal"
err_has "row i is not the same splat in all frames" "warns that rows differ"

run "$bin/spin-export" "$work/in.spin" --for maya -o "$work/no"
fails 2 spin-export "an unknown program"
err_has "unknown program 'maya'; known: unreal, unity, " "names the known ones"
is "$(sed -n "s/.*; known: //p" "$work/err" | tr -d ' ' | tr , '\n')" \
    "$(sed -n '/^| program | `--for`/,/^$/s/^| [^|]* | `\([a-z]*\)` | .*/\1/p' docs/viewers.md)" "docs/viewers.md lists the same"
nothing_at "$work/no" "nothing was written"
run "$bin/spin4d" "$work/in.spin" --for maya -o "$work/no"
fails 2 spin4d "an unknown program for spin4d"

here=$PWD
case $bin in /*) ;; *) bin=$here/$bin ;; esac
mkdir "$work/run" && cd "$work/run" && cp "$work/in.spin" clip.spin
run "$bin/spin4d" clip.spin --no-retrain --for houdini
is "$code $(ls clip.usdc)" "0 clip.usdc" "spin4d: the name and the format by the program"
run "$bin/spin4d" clip.spin --no-retrain --for spark
is "$code $(head -c 2 clip-spark/frame_00000.spz | od -An -tx1 | tr -d ' ')" "0 1f8b" "spin4d: a folder beside the input"
run "$bin/spin4d" clip.spin --no-retrain --for unity -o mine
is "$code $(sed '/^end_header/q' mine/frame_00000.ply | grep -ac f_rest)" "0 45" "spin4d: a folder by its name"
cd "$here" || exit 1
done_testing
