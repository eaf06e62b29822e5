#!/bin/sh
# K: datasets panoptic transforms colmap import missing images
# Images that a data set names but lacks: they are counted and left out, and the frames go on with
# the others.
. tests/cli/lib.sh
point='ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 1\n'

clip() { # FOLDER FIRST LAST: a point in each frame
    mkdir -p "$1"
    for i in $(seq "$2" "$3"); do
        # shellcheck disable=SC2059
        printf "$point" >"$1/frame_$(printf %06d "$i").ply"
    done
}

views() { # BUNDLE: lines of "number camera"
    "$bin/spin-import" --info "$1" --views | awk '$1 ~ /^[0-9]+$/ { print $1, $2 }'
}

pictures() { # BUNDLE: the last two components of their paths
    "$bin/spin-import" --info "$1" --views | sed -n 's|.*/\([a-z0-9]*/[^/]*\)$|\1|p'
}

cp -r fixtures/datasets/panoptic_mini "$work/panoptic"
images=$(find "$work/panoptic/ims" -name '*.jpg' | wc -l)
clip "$work/six" 0 5
rm "$work/panoptic/ims/3/000002.jpg" "$work/panoptic/ims/7/000004.jpg"
run "$bin/spin-import" "$work/six" --data "$work/panoptic" -o "$work/panoptic.spin"
is "$code" 0 "panoptic: a set that lacks two images is read"
err_has "2 of $images images are missing and left out, the first is '.*ims/3/000002.jpg'" "they are counted"
views "$work/panoptic.spin" >"$work/got"
is "$(wc -l <"$work/got")" $((images - 2)) "the others are used"
is "$(grep -c '^2 3$' "$work/got") $(grep -c '^2 ' "$work/got")" "0 $((images / 6 - 1))" "in their frame, too"

rm "$work"/panoptic/ims/*/000003.jpg
run "$bin/spin-import" "$work/six" --data "$work/panoptic" -o "$work/none.spin"
is "$code" 2 "a frame of the clip without any image is refused"
err_has "the data set has no images of frame 3; leave the frame out with --range" "is named"
run "$bin/spin-import" "$work/six" --data "$work/panoptic" --pair order -o "$work/none.spin"
is "$code" 2 "nor are frames paired by order then"
rm "$work/six/frame_000003.ply"
run "$bin/spin-import" "$work/six" --data "$work/panoptic" -o "$work/five.spin"
is "$code" 0 "a clip without this frame is paired by number"
is "$(pictures "$work/five.spin" | grep '^2/' | tr '\n' ' ')" \
    "2/000000.jpg 2/000001.jpg 2/000002.jpg 2/000004.jpg 2/000005.jpg " "its frames have their images"

find "$work/panoptic/ims" -path '*/[0-6]/*' -name '*.jpg' -exec rm {} +
run "$bin/spin-import" "$work/six" --data "$work/panoptic" -o "$work/none.spin"
is "$code" 1 "a set that lacks half of its images is refused"
err_has "of $images images are missing, the first is" "with their number"

cp -r fixtures/datasets/blender_mini "$work/blender"
run "$bin/spin-import" fixtures/deformable3dgs/real_small/model --data "$work/blender" -o "$work/all.spin"
pictures "$work/all.spin" | grep -v train/r_001 >"$work/want"
rm "$work/blender/train/r_001.png"
run "$bin/spin-import" fixtures/deformable3dgs/real_small/model --data "$work/blender" -o "$work/blender.spin"
is "$code" 0 "D-NeRF: a set that lacks an image is read"
err_has "1 of 9 images is missing and left out, the first is '.*train/r_001.png'" "it is counted"
is "$(pictures "$work/blender.spin")" "$(cat "$work/want")" "the others stay"

cp -r fixtures/datasets/colmap_mini "$work/colmap"
rm "$work/colmap/images/cam04.png"
# shellcheck disable=SC2059
printf "$point" >"$work/one.ply"
run "$bin/spin-import" "$work/one.ply" --data "$work/colmap" -o "$work/still.spin"
is "$code" 0 "COLMAP: a still that lacks an image is read"
err_has "1 of 9 images is missing and left out" "it is counted"
is "$(views "$work/still.spin" | tr '\n' ' ')" "0 0 0 1 0 2 0 3 0 5 0 6 0 7 0 8 " "all others are of its frame"
done_testing
