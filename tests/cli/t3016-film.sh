#!/bin/sh
# K: export images image film exr depth path
# spin-export --to images for film work: EXR with alpha that composites correctly, depth, 16 bits,
# cameras from a file.
. tests/cli/lib.sh

# OpenImageIO takes a fifth of a second to load: it is loaded only for formats other than PNG and
# JPEG, or for kinds of JPEG that libjpeg refuses.
shims_of() { # COMMAND...: what it loads for pictures
    rm -f "$work"/loads.*
    run env LD_DEBUG=libs LD_DEBUG_OUTPUT="$work/loads" "$@"
    sed -n 's|.*calling init: .*/\(spin-image.*\)\.so$|\1|p' "$work"/loads.* | sort -u | tr '\n' ' '
}
is "$(shims_of "$bin/spin-import" "$clip" --data "$clip" -o "$work/court.spin")" "spin-image-plain " "JPEG is read without OpenImageIO"
is "$(shims_of "$bin/spin-export" "$work/court.spin" --range 2:3 --to images -o "$work/some")" "spin-image-plain " "PNG is written without it"
is "$(shims_of "$bin/spin-export" "$work/court.spin" --range 2:3 --to images --format exr -o "$work/film")" \
    "spin-image spin-image-plain " "EXR is written by it"
if ! python3 -c 'import numpy' 2>/dev/null; then
    skip "films" "no python3 with numpy"
    done_testing
fi
export PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=tests/tools
cat >"$work/preamble" <<'P'
import sys
import numpy as np
from pictures import exr, exr_head, png
P

draw() { # OUT OPTION...
    out=$work/$1
    shift
    run "$bin/spin-export" "$work/court.spin" --range 2:3 --camera 0 --to images -o "$out" "$@"
    is "$code" 0 "draws $*"
}
of=cam_00_frame_00002

draw white --bits 16 --background white
draw black --bits 16
draw over --format exr --background none --transfer srgb
holds "over a checkerboard, an EXR with alpha is what is drawn over each of its colours" '
e, white, black = exr(sys.argv[1]), png(sys.argv[2]), png(sys.argv[3])
colour = np.stack([e[c] for c in "RGB"], -1)
y, x = np.mgrid[:colour.shape[0], :colour.shape[1]]
board = ((x // 8 + y // 8) % 2)[..., None]
got = colour + (1 - e["A"])[..., None] * board
want = np.where(board == 1, white, black)
assert (e["A"] < .9).sum() > 200 and (e["A"] > .99).sum() > 5000
assert np.abs(np.minimum(got, 1) - want).max() < 1e-3, np.abs(got - want).max()' \
    "$work/over/$of.exr" "$work/white/$of.png" "$work/black/$of.png"
draw light --format exr --background none
holds "an EXR holds light: the picture of the screen by the curve of sRGB, multiplied by alpha" '
e, s = exr(sys.argv[1]), exr(sys.argv[2])
a = e["A"]
assert np.array_equal(a, s["A"])
for c in "RGB":
    v = s[c] / a
    light = np.where(v <= .04045, v / 12.92, ((v + .055) / 1.055) ** 2.4) * a
    assert np.abs(light - e[c]).max() < 2e-3' "$work/light/$of.exr" "$work/over/$of.exr"
draw half --format exr
draw whole --format exr --bits 32
holds "half floats by default, floats with --bits 32, no alpha where there is a background" '
h, w = exr(sys.argv[1]), exr(sys.argv[2])
assert set(h) == set(w) == set("RGB")
for c in "RGB":
    assert np.array_equal(w[c].astype(np.float16), h[c]) and not np.array_equal(w[c], h[c])' "$work/half/$of.exr" "$work/whole/$of.exr"
draw png --background none
holds "a PNG with alpha is not multiplied by it" '
p, e = png(sys.argv[1]), exr(sys.argv[2])
assert p.shape[2] == 4 and np.abs(p[..., 3] - e["A"]).max() < 3e-3
for k, c in enumerate("RGB"):
    assert np.abs(p[..., k] - np.minimum(e[c] / e["A"], 1)).max() < 4e-3' "$work/png/$of.png" "$work/over/$of.exr"
draw eight
holds "16 bits are finer than 8, and the same picture" '
a, b = png(sys.argv[1]), png(sys.argv[2])
assert a.shape == b.shape and np.abs(a - b).max() < .51 / 255 and len(np.unique(b)) > 2 * len(np.unique(a))' "$work/eight/$of.png" "$work/black/$of.png"

# The header's colour space and frame rate, and the absence of the time of day.
draw rate --format exr --fps 29.97
draw rate2 --format exr --fps 12.5 --transfer srgb
holds "the header has the primaries, the curve and the rate, but no time" '
import struct
a, b, c = (exr_head(p)[0] for p in sys.argv[1:])
rec709 = (.64, .33, .3, .6, .15, .06, .3127, .329)
assert np.allclose(struct.unpack("<8f", a["chromaticities"]), rec709) and a["chromaticities"] == b["chromaticities"]
assert b"decoded to linear light" in a["comments"] and b"encoded with the sRGB curve" in b["comments"]
assert struct.unpack("<iI", a["framesPerSecond"]) == (30000, 1001)
assert struct.unpack("<iI", b["framesPerSecond"]) == (12500, 1000) and "framesPerSecond" not in c
assert not [k for h in (a, b, c) for k in h if "date" in k.lower() or "utc" in k.lower()]' \
    "$work/rate/$of.exr" "$work/rate2/$of.exr" "$work/half/$of.exr"
run "$bin/spin-export" "$work/court.spin" --to images --fps 24 -o "$work/never"
fails 2 spin-export "--fps where no file has it"

# Names by a pattern, numbered from a given number, of one camera.
names() { # WHAT WANT OPTION...
    what=$1 want=$2
    shift 2
    rm -rf "$work/named"
    run "$bin/spin-export" "$work/court.spin" --range 2:5 --to images "$@"
    is "$code $(ls "$work/named" | grep -v sequence | tr '\n' ' ')" "0 $want " "$what"
}
names "the output as a pattern, EXR by its ending" "shot.1001.exr shot.1002.exr shot.1003.exr" \
    --camera 3 --start 1001 -o "$work/named/shot.####.exr"
names "--pattern, by the clip's numbers" "a_02.v3.png a_03.v3.png a_04.v3.png" \
    --camera 3 --pattern a_%02d.v3.png -o "$work/named"
names "--start without a pattern" "cam_03_frame_00007.png cam_03_frame_00008.png cam_03_frame_00009.png" \
    --camera 3 --start 7 -o "$work/named"
names "of a moving camera" "o.05.png o.06.png" --path orbit --duration 1 --fps 2 --start 5 -o "$work/named/o.##.png"
for wrong in '--views all --pattern %d.png' '--pattern %d.tif --camera 3' '--pattern %d.exr --format png --camera 3' '--clamp' \
    '--camera 3 --views all' '--camera 3 --path train' '--camera 3 --up y' '--rotate 1,2,3'; do
    # shellcheck disable=SC2086
    run "$bin/spin-export" "$work/court.spin" --to images $wrong -o "$work/never"
    fails 2 spin-export "$wrong"
done
run "$bin/spin-export" "$work/court.spin" --to images --camera 77 -o "$work/never"
fails 1 spin-export "a camera that is not there"

# Without OpenImageIO, as in the package of `make portable`: no EXR. With OpenImageIO alone: the
# same pixels in PNG.
for without in IMAGE IMAGE_PLAIN; do
    run env SPIN_${without}_SHIM=/none "${SPIN_BUILD:-build/release}/tests/io/t-image"
    is "$code" 0 "what is tested of pictures, without SPIN_${without}_SHIM: $(grep -c '^ok' "$work/out") tests"
done
run env SPIN_IMAGE_SHIM=/none "$bin/spin-export" "$work/court.spin" --range 2:3 --to images -o "$work/no" --format exr
fails 1 spin-export "an EXR without OpenImageIO"
export SPIN_IMAGE_PLAIN_SHIM=/none
draw oiio-black --bits 16
draw oiio-png --background none
draw oiio-eight
unset SPIN_IMAGE_PLAIN_SHIM
for kind in black png eight; do
    holds "by OpenImageIO, $kind: the same pixels" '
a, b = png(sys.argv[1]), png(sys.argv[2])
assert np.array_equal(a, b), np.abs(a - b).max()' "$work/$kind/$of.png" "$work/oiio-$kind/$of.png"
done

# Our own reader converts an EXR to the image that a screen shows.
compare=${SPIN_BUILD:-build/release}/tests/tools/compare-images
if [ -x "$compare" ]; then
    run "$compare" "$work/half/$of.exr" "$work/eight/$of.png" "$work/light/$of.exr" "$work/eight/$of.png"
    [ "$code" = 0 ] && [ "$(cut -d' ' -f1 "$work/out")" -le 1 ]
    ok $? "an EXR is read as the PNG is, with alpha over black as well: $(cat "$work/out")"
else
    skip "an EXR is read as the PNG is" "$compare is not built"
fi

# The depth of two walls, 5 and 7 in front of a camera from a file: the first absorbs nine tenths of
# the light.
{
    printf 'ply\nformat ascii 1.0\nelement vertex 2\n'
    printf 'property float %s\n' x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3
    echo end_header
    echo "0 0 0 1 1 1 2.1972246 5 5 -6 1 0 0 0"
    echo "0 0 2 1 1 1 -1.0986123 5 5 -6 1 0 0 0"
} >"$work/walls.ply"
run "$bin/spin-import" "$work/walls.ply" -o "$work/walls.spin"
cat >"$work/list.txt" <<'E'
# camera to world: x right, y down, z ahead
1 0 0 0  0 1 0 0  0 0 1 -5
1 0 0 0  0 1 0 0  0 0 1 5
E
run "$bin/spin-export" "$work/walls.spin" --to images --path "$work/list.txt" --size 64x48 --format exr --depth -o "$work/walls"
is "$code $(ls "$work/walls" | tr '\n' ' ')" "0 path_frame_00000.exr path_frame_00001.exr sequence.json " "a picture for each camera of a file"
err_has "1 of 2 renders shows only" "and what is behind the camera is not drawn"
holds "expected and median depth, in world units; 1e10 where there is none" '
e, none = exr(sys.argv[1]), exr(sys.argv[2])
assert np.abs(e["Z"] - (.9 * 5 + .1 * .25 * 7) / (.9 + .1 * .25)).max() < 2e-3, e["Z"].max()
assert np.abs(e["ZMedian"] - 5).max() < 1e-5
assert none["Z"].min() == none["ZMedian"].min() == np.float32(1e10)' "$work/walls/path_frame_00000.exr" "$work/walls/path_frame_00001.exr"
run "$bin/spin-export" "$work/walls.spin" --to images --path "$work/list.txt" --size 64x48 --format exr --depth --translate 0,0,1 --scale 2 -o "$work/walls2"
holds "of a scene of another size" '
assert np.abs(exr(sys.argv[1])["ZMedian"] - 6).max() < 1e-5' "$work/walls2/path_frame_00000.exr"

# One camera from a file for the whole clip; one splat twice as bright as white.
run "$bin/spin-export" "$work/walls.spin" --to images --camera "$work/list.txt" --size 64x48 --format exr --depth -o "$work/one"
is "$code $(ls "$work/one" | tr '\n' ' ')" "0 camera_frame_00000.exr sequence.json " "a camera of a file"
run cmp "$work/one/camera_frame_00000.exr" "$work/walls/path_frame_00000.exr"
is "$code" 0 "is the first of the file"
sed '/^0 0 2/d; s/vertex 2/vertex 1/; s/^0 0 0 1 1 1/0 0 0 5 5 5/' "$work/walls.ply" >"$work/bright.ply"
run "$bin/spin-import" "$work/bright.ply" -o "$work/bright.spin"
bright() { # OPTION...
    run "$bin/spin-export" "$work/bright.spin" --to images --camera "$work/list.txt" --size 64x48 --format exr -o "$work/bright$*" "$@"
}
bright
err_has "3072 pixels are brighter than white: their values, before conversion to linear light, are up to 1.7.* times that of white; --clamp limits them to white" "fireflies are counted"
bright --clamp
is "$code $(grep -c brighter "$work/err")" "0 0" "--clamp"
bright --background none
err_has "3072 pixels are brighter" "with alpha too"
holds "limits them to white" '
a, b = exr(sys.argv[1]), exr(sys.argv[2])
assert a["R"].min() > 3 and b["R"].min() == b["R"].max() == 1' "$work/bright/camera_frame_00000.exr" "$work/bright--clamp/camera_frame_00000.exr"
bright --clamp --background none
holds "of the pixel, not above its alpha" '
e = exr(sys.argv[1])
assert e["A"].max() < .95 and np.abs(e["R"] - e["A"]).max() < 1e-3' "$work/bright--clamp --background none/camera_frame_00000.exr"

# The poster of a page is an image of its first view.
run "$bin/spin-import" "$clip" -o "$work/bare.spin"
echo '-.7457 .2022 -.6353 1.84  0 .9535 .3035 -1.88  .6663 .2263 -.7110 2.08' >"$work/court.txt"
first="--camera $work/court.txt"
# shellcheck disable=SC2086
run "$bin/spin-export" "$work/bare.spin" $first --size 1200x630 --range 2:3 --to images -o "$work/view"
# shellcheck disable=SC2086
run "$bin/spin-export" "$work/bare.spin" $first --range 2:4 --poster -o "$work/a page.html"
is "$code" 0 "a page with a poster"
holds "which is drawn from the first view" '
a, b = png(sys.argv[1]), png(sys.argv[2])
assert a.shape == (630, 1200, 3) and a.std() > .05 and np.abs(a - b).max() < 1.5 / 255' "$work/a page.png" "$work/view/camera_frame_00000.png"
is "$(grep -c '<meta property="og:image" content="a%20page.png">' "$work/a page.html")" 1 "previews of links find it beside the page"
rm "$work/a page.html"
run "$bin/spin-export" "$work/court.spin" --split --poster -o "$work/a page.html"
fails 1 spin-export "a poster that exists"
nothing_at "$work/a page.html" "and no page was written"
nothing_at "$work/a page.bin" "nor its frames"
run "$bin/spin-export" "$work/court.spin" --range 2:3 -o "$work/plain.html"
is "$code $(grep -c og:image "$work/plain.html") $(find "$work" -name 'plain.*' | wc -l)" "0 0 1" "no poster unless asked for"

# The same pose from a file of nerfstudio and from a JSON list; malformed lists.
cat >"$work/studio.json" <<'E'
{"camera_type": "perspective", "render_height": 48, "render_width": 96, "fps": 12, "seconds": 1,
 "camera_path": [{"camera_to_world": [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, -5, 0, 0, 0, 1], "fov": 60, "aspect": 2},
                 {"camera_to_world": [1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, -3, 0, 0, 0, 1], "fov": 60, "aspect": 2}]}
E
echo '[[[1,0,0,0],[0,1,0,0],[0,0,1,-5],[0,0,0,1]], [1,0,0,0, 0,1,0,0, 0,0,1,-3]]' >"$work/list.json"
for file in studio list; do
    run "$bin/spin-export" "$work/walls.spin" --to images --path "$work/$file.json" --format exr --depth -o "$work/$file"
    is "$code $(ls "$work/$file" | wc -l)" "0 3" "$file.json: two cameras"
done
holds "both name the same places; the file of nerfstudio its size" '
a, b, c, d = (exr(p) for p in sys.argv[1:])
assert a["Z"].shape == (48, 96) and c["Z"].shape == (720, 1280)
assert abs(a["ZMedian"].mean() - 5) + abs(b["ZMedian"].mean() - 3) < 1e-4
assert abs(c["ZMedian"].mean() - 5) + abs(d["ZMedian"].mean() - 3) < 1e-4' "$work"/studio/*.exr "$work"/list/*.exr
# The rate in EXR files is that of --fps, else of the file of --path, else of the clip. A file of
# --camera has one still camera, whose images follow the clip.
"$bin/spin-export" -q "$work/walls.spin" --to ply --fps 25 -o "$work/paced" &&
    "$bin/spin-import" -q "$work/paced" -o "$work/paced.spin"
ok $? "a clip with a frame rate"
rate() { # WANT CLIP OPTION...
    want=$1 of=$2
    shift 2
    rm -rf "$work/rates"
    run "$bin/spin-export" "$work/$of.spin" --to images --format exr -o "$work/rates" "$@"
    is "$code" 0 "draws $of $(echo "$*" | sed 's|/[^ ]*/||g')"
    holds "which has the rate $want" '
import struct
head = exr_head(sys.argv[1])[0]
got = struct.unpack("<iI", head["framesPerSecond"])[0] if "framesPerSecond" in head else 0
assert got == int(sys.argv[2]), got' "$(find "$work/rates" -name '*00000.exr')" "$want"
}
rate 12 paced --path "$work/studio.json"
rate 25 paced --path "$work/list.json"
rate 25 paced --camera "$work/studio.json"
rate 48 paced --camera "$work/studio.json" --fps 48
rate 0 walls --camera "$work/studio.json"
bad() { # TEXT MESSAGE OPTION...
    printf '%s\n' "$1" >"$work/bad.txt"
    text=$2
    shift 2
    run "$bin/spin-export" "$work/walls.spin" --to images --path "$work/bad.txt" -o "$work/never" "$@"
    fails 1 spin-export "a path: $text"
    err_has "$text" "it is said"
    nothing_at "$work/never" "and nothing was written"
}
bad '1 0 0 0 0 1 0 0 0 0 1' 'matrix 1 has 11 numbers'
bad '1 0 0 0 0 1 0 0 0 0 2 0' 'matrix 1 is not a rotation'
bad '1 0 0 0 0 1 0 0 0 0 -1 0' 'matrix 1 is not a rotation'
bad '1 -0.2 0 0 0 0.98 0 0 0 0 1 0' 'matrix 1 is not a rotation'
bad '1 0 -0.2 0 0 1 0 0 0 0 0.98 0' 'matrix 1 is not a rotation'
bad '1 0 0 0 0 1 -0.2 0 0 0 0.98 0' 'matrix 1 is not a rotation'
bad '1 0 0 0 0 1 0 0 0 0 1 nan' 'matrix 1 has a value'
bad '1 0 0 0 0 1 0 0 0 0 1 x' "'x' is not a number"
bad '# nothing' 'the file contains no cameras'
bad '{"camera_path": []}' 'the file contains no cameras'
bad '{"frames": []}' "the list 'camera_path' is missing"
bad '{"camera_type": "fisheye", "camera_path": []}' "'camera_type' is 'fisheye'"
bad '[[1,0,0,0,0,1,0,0,0,0,1,null]]' 'matrix 1 has values that are not numbers'
bad '[[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1,7]]' 'matrix 1 has 17 numbers, expected 12 or 16'
bad '{"camera_path": [{"camera_to_world": [1,0,0,0,0,1,0,0,0,0,1,0], "fov": 0}]}' 'camera 1 has a field of view of 0'
run "$bin/spin-export" "$work/walls.spin" --to images --path circle -o "$work/never"
fails 2 spin-export "a path that is none"
run "$bin/spin-export" "$work/walls.spin" --to images --path "$work/list.txt" --repeat 2 -o "$work/never"
fails 2 spin-export "--repeat of a file's cameras"
for wrong in '--depth' '--transfer srgb' '--bits 32' '--format exr --bits 8' '--format exr --depth --panels truth,after'; do
    # shellcheck disable=SC2086
    run "$bin/spin-export" "$work/court.spin" --to images $wrong -o "$work/never"
    fails 2 spin-export "$wrong"
done
for to in html:page.html ply:ply video:a.mp4; do
    run "$bin/spin-export" "$work/court.spin" --to "${to%:*}" --background none -o "$work/${to#*:}"
    fails 2 spin-export "--background none with --to ${to%:*}"
done
done_testing
