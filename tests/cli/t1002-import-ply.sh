#!/bin/sh
# K: ply
# PLY files and sequences: described, imported, and refused if malformed.
. tests/cli/lib.sh

files=$fixtures/ply
if [ ! -d "$files" ]; then
    skip "ply" "no fixtures at $files"
    done_testing
fi

# describe FOLDER FRAMES SH_DEGREE
describe() {
    run "$bin/spin-import" --info --json "$files/$1"
    is "$code" 0 "$1 is recognised"
    is "$(member from)" ply "$1: from ply"
    is "$(member frames)" "$2" "$1: $2 frames"
    is "$(member sh_degree)" "$3" "$1: SH degree $3"
}
describe inria_sh0_varN 6 0
describe inria_sh1 3 1
describe inria_sh3 4 3
describe gsplat_sh2 2 2
describe brush_sh1 2 1
describe variants/base.ply 1 1
describe variants/ascii.ply 1 1
describe variants/big_endian.ply 1 1

run "$bin/spin-import" "$files/inria_sh0_varN" -o "$work/sequence.spin" --json
is "$code" 0 "imports a sequence whose counts differ"
smallest=$(sed -n 's/^    "min": \([0-9]*\),*$/\1/p' "$work/out")
largest=$(sed -n 's/^    "max": \([0-9]*\),*$/\1/p' "$work/out")
greater "$largest" "$smallest"
ok $? "the counts do differ"

{
    printf 'ply\nformat ascii 1.0\nelement vertex 1\n'
    printf 'property float %s\n' x y z
    printf 'property uchar %s\n' red green blue
    printf 'end_header\n1 2 3 10 20 30\n'
} >"$work/point.ply"
run "$bin/spin-import" "$work/point.ply" -o "$work/point.spin" --positions-only
is "$code" 0 "imports positions only"
unzip -Z1 "$work/point.spin" | grep -q rgb
ok $? "of points, with their colours"
run "$bin/spin-import" --info "$work/point.spin"
is "$code" 0 "which is read again"

{
    printf 'ply\nformat ascii 1.0\nelement vertex 1\n'
    printf 'property float %s\n' x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3
    printf 'end_header\n0 0 0 0 0 0 0 -1 200 -1 1 0 0 0\n'
} >"$work/beyond.ply"
run "$bin/spin-import" "$work/beyond.ply" -o "$work/bad.spin" -q
is "$code" 1 "a scale that no float holds"
err_has "frame 0: the scale of row 0, exp(200), overflows a float" "is refused by its row"

run "$bin/spin-import" --from ply "$files/variants/truncated.ply" -o "$work/bad.spin"
fails 1 spin-import "a truncated PLY"
err_has truncated.ply "a truncated PLY is named"
nothing_at "$work/bad" "a truncated PLY: nothing was written"
size=$(wc -c <"$files/variants/base.ply")
for part in 0 1 3 100 1000; do
    head -c $((size * part / 1001)) "$files/variants/base.ply" >"$work/cut.ply"
    run "$bin/spin-import" --from ply "$work/cut.ply" -o "$work/bad.spin"
    fails 1 spin-import "a PLY cut to $part/1001"
    nothing_at "$work/bad" "a PLY cut to $part/1001: nothing was written"
done

mkdir "$work/one"
cp "$(find "$fixtures/ply/inria_sh3" -name '*.ply' | head -n 1)" "$work/one/frame_0.ply"
run "$bin/spin-import" "$work/one" -o "$work/one.spin" --frames 3
fails 2 spin-import "--frames of one stored frame"
err_has "stores 1 separate frame:" "which is said in the singular"
done_testing
