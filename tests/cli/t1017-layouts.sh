#!/bin/sh
# K: datasets colmap technicolor transforms import layouts
# The data set layouts of layouts.py, compared with the views it expects: frames, cameras, images.
. tests/cli/lib.sh

python3 tests/cli/layouts.py make "$work/sets"
ok $? "the data sets are written"

while read -r name clip order note; do
    set=$work/sets/$name
    [ "$order" = - ] && order=
    # shellcheck disable=SC2086
    run "$bin/spin-import" "$work/sets/$clip" --data "$set" $order -o "$work/$name.spin"
    is "$code" 0 "$name: is imported"
    [ -z "$note" ] || err_has "$note" "$name: what it lacks is said"
    run "$bin/spin-import" --info "$work/$name.spin" --views --json
    python3 tests/cli/layouts.py compare "$work/sets/expected.json" "$work/out" "$set"
    ok $? "$name: its views are those that Python computes"
done <<SETS
multipleview clip --pair=order
colmap_t clip -
technicolor clip -
technicolor_14 clip --pair=order
rig_cameras clip -
rig_frames clip -
rig_flat clip -
rig_all clip -
rig_folders clip -
missing clip - 1 of 9 images is missing
still still/frame_0000.ply -
beside_text still/frame_0000.ply -
beside_binary still/frame_0000.ply -
beside_images still/frame_0000.ply -
no_points still/frame_0000.ply -
SETS

# A camera that starts one frame late: it has no image in frame 0, and its first image belongs to
# frame 1.
run "$bin/spin-import" "$work/sets/clip" --data "$work/sets/rig_cameras" --offsets cam02=1 -o "$work/late.spin"
is "$code" 0 "a camera that starts late is read"
err_has "1 of 9 images is missing" "its missing image is counted"
run "$bin/spin-import" --info "$work/late.spin" --views
out_has "^ *0 *1 .*cam01/0000.png" "the other cameras have frame 0"
out_has "^ *1 *2 .*cam02/0000.png" "its first image is paired with frame 1"
is "$(grep -c cam02 "$work/out")" 2 "and its last with no frame"
run "$bin/spin-import" "$work/sets/clip" --offsets cam02=1 -o "$work/none.spin"
fails 2 spin-import "--offsets requires --data"

# Images with lens distortion are refused, as in all data sets.
sed '2s/ 0.0 0.0 0.0 / 0.0 0.125 0.0 /' "$work/sets/technicolor_14/cameras_parameters.txt" >"$work/parameters"
cp "$work/parameters" "$work/sets/technicolor_14/cameras_parameters.txt"
run "$bin/spin-import" "$work/sets/clip" --data "$work/sets/technicolor_14" --pair order -o "$work/none.spin"
fails 1 spin-import "Technicolor's distortion is refused"
err_has "line 2: there is a distortion of 0.125, 0: use the undistorted images" "with its line and its coefficients"

# A data set given as the run.
run "$bin/spin-import" "$work/sets/rig_cameras" -o "$work/none.spin"
is "$code" 1 "a data set is no run"
err_has "is a data set (colmap) of 3 cameras and 3 frames, not a run: give the folder" "says what it is and what to do"
cp -r "$work/sets/still" "$work/alone"
rm "$work"/alone/*.ply
mkdir "$work/frames"
cp -r "$work/alone" "$work/frames/frame000000"
run "$bin/spin-import" "$work/alone" -o "$work/none.spin"
err_has "is a data set (colmap) of 3 images, a static scene or the video of one camera, not a run" "nor is one of single images"
run "$bin/spin4d" "$work/alone" -o "$work/none.html"
is "$code $(grep -c 'is a data set (colmap) of 3 images' "$work/err")" "1 1" "spin4d says it once"
run "$bin/spin4d" "$work/frames" -o "$work/none.html"
is "$code" 1 "nor is one with a folder per frame"
err_has "is a data set (colmap) of 3 cameras and 1 frame, not a run" "whose cameras and frames are counted"

# One image per frame, each of another camera: reported if the clip has several frames.
run "$bin/spin-import" "$work/sets/clip" --data "$work/sets/still" -o "$work/one.spin"
is "$code" 0 "a model with as many images as frames is read as a video"
err_has "one image per frame" "with a warning"
done_testing
