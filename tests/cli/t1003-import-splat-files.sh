#!/bin/sh
# K: spz splat ksplat sog gltf glb import
# SPZ, .splat, .ksplat, SOG and GLB: described, imported with their options, and refused if
# malformed.
. tests/cli/lib.sh

files=fixtures/splats

# describe FOLDER IMPORTER SH_DEGREE
describe() {
    run "$bin/spin-import" --info --json "$files/$1"
    is "$code" 0 "$1 is recognised"
    is "$(member from) $(member frames) $(member sh_degree)" "$2 3 $3" "$1: from $2, 3 frames, SH degree $3"
}
describe spz2 spz 2
describe spz3 spz 2
describe spz4 spz 2
describe splat splat 0
describe ksplat ksplat 2
describe sog sog 2
describe glb gltf 2

# ---- Axes ----------------------------------------------------------------------------------------

# The bounding box of the positions in the JSON: minimum x y z, maximum x y z.
box() { tr -d ' \n' <"$work/out" | sed 's/.*"bounds":{"min":\[\([^]]*\)\],"max":\[\([^]]*\)\]}.*/\1,\2/'; }

run "$bin/spin-import" --info --json "$files/spz3"
plain=$(box)
run "$bin/spin-import" --info --json --from spz --axes rub "$files/spz3"
is "$(box)" "$(echo "$plain" | awk -F, '{ print $1 "," (-$5) "," (-$6) "," $4 "," (-$2) "," (-$3) }' OFMT=%.17g CONVFMT=%.17g)" \
    "spz: --axes rub is half a turn about x"
run "$bin/spin-import" --info --json "$files/glb"
plain=$(box)
run "$bin/spin-import" --info --json --from gltf --axes source "$files/glb"
is "$(box)" "$(echo "$plain" | awk -F, '{ print (-$4) "," (-$5) "," $3 "," (-$1) "," (-$2) "," $6 }' OFMT=%.17g CONVFMT=%.17g)" \
    "gltf: --axes source leaves out half a turn about z"
for from in spz gltf; do
    run "$bin/spin-import" --from $from --axes xyz "$files/spz3" -o "$work/never.spin"
    fails 2 spin-import "$from: other axes"
    err_has "option 'axes' is 'xyz'" "$from: they are named"
done
nothing_at "$work/never" "nothing was written"

# ---- One format or two in a folder ---------------------------------------------------------------

mkdir "$work/both"
cp "$files/spz4/frame_00000.spz" "$files/splat/frame_00000.splat" "$work/both"
run "$bin/spin-import" "$work/both" -o "$work/never.spin"
fails 1 spin-import "two formats in a folder"
err_has "'splat' and 'spz'.*--from" "and what decides"
run "$bin/spin-import" --from spz --json "$work/both" -o "$work/both.spin"
is "$code $(member frames)" "0 1" "--from does"

# ---- Refused -------------------------------------------------------------------------------------

for file in spz2/frame_00001.spz spz3/frame_00001.spz spz4/frame_00001.spz glb/frame_00001.glb \
    ksplat/frame_00001.ksplat sog/frame_00001.sog; do
    size=$(wc -c <"$files/$file")
    cut=$work/cut.${file##*.}
    for part in 0 1 20 500 999; do
        head -c $((size * part / 1000)) "$files/$file" >"$cut"
        run "$bin/spin-import" "$cut" -o "$work/bad.spin"
        fails 1 spin-import "$file cut to $part/1000"
        err_has "cut\.${file##*.}" "$file cut to $part/1000: named"
        nothing_at "$work/bad" "$file cut to $part/1000: nothing was written"
    done
done
head -c 50 "$files/splat/frame_00000.splat" >"$work/cut.splat"
run "$bin/spin-import" "$work/cut.splat" -o "$work/bad.spin"
fails 1 spin-import "a row and a half"
nothing_at "$work/bad" "nothing was written"

# A damaged frame in the middle of a clip: no output is left.
cp -r "$files/spz3" "$work/clip"
head -c 700 "$files/spz3/frame_00001.spz" >"$work/clip/frame_00001.spz"
run "$bin/spin-import" "$work/clip" -o "$work/bad.spin"
fails 1 spin-import "a damaged frame of a clip"
err_has "frame_00001.spz" "is named"
nothing_at "$work/bad" "nothing was written"

# 64 MB of zeros in a gzip stream of 64 kB, with a header that claims as many splats.
{
    printf 'NGSP\003\0\0\0\0\0\060\0\0\014\0\0'
    head -c $((20 * 3145728)) /dev/zero
} | gzip -9n >"$work/bomb.spz"
run "$bin/spin-import" "$work/bomb.spz" -o "$work/bad.spin"
fails 1 spin-import "a bomb"
err_has "cannot contain 3145728 splats" "says what it would be"
nothing_at "$work/bad" "nothing was written"

SPIN_ZSTD=/no/such.so run "$bin/spin-import" "$files/spz4" -o "$work/bad.spin"
fails 1 spin-import "SPZ 4 without libzstd"
err_has "libzstd.so.1" "says what is missing"
nothing_at "$work/bad" "nothing was written"
SPIN_ZSTD=/no/such.so run "$bin/spin-import" "$files/spz3" -o "$work/old.spin"
is "$code" 0 "SPZ 3 does without"
done_testing
