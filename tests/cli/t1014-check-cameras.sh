#!/bin/sh
# K: cameras views
# Data sets whose cameras are wrong: one bad camera among many, a duplicate, width and height
# swapped.
. tests/cli/lib.sh
if [ ! -e "$(dirname "$bin")/lib/spin-image.so" ]; then
    skip "check-cameras" "built without images"
    done_testing
fi
# LeakSanitizer often crashes where images are read: see t1012.
export LSAN_OPTIONS=use_tls=0:suppressions=tests/lsan.supp:print_suppressions=0

# variant NAME SED: the bundled clip's data set with both of its files edited.
variant() {
    mkdir "$work/$1"
    ln -s "$PWD/$clip/ims" "$work/$1/ims"
    for name in train_meta test_meta; do
        sed "$2" "$clip/$name.json" >"$work/$1/$name.json"
    done
    ! cmp -s "$clip/train_meta.json" "$work/$1/train_meta.json"
    ok $? "$1: a data set of its own"
}
# The lines of the report about one camera.
of_camera() { grep "^camera $1 " "$work/out"; }

run "$bin/spin-import" --check-cameras "$work/good" --data "$clip" "$clip"
is "$code" 0 "cameras that are right"
is "$(wc -l <"$work/err")" 0 "no warning"
is "$(sed -n 1p "$work/out" | tr -d 0-9)" "cameras fit:  % of the splats are seen" "the first line is the verdict"
is "$(grep -c '^camera [0-9]' "$work/out")" 8 "a line for every camera, not only for the four that are drawn"
! grep -q 'far fewer' "$work/out"
ok $? "none is far from the others"
out_has "^median  *9[0-9.]* % of the points in front, 6[0-9.]* % inside" "and the median"

# Camera 12 faces the other way in every frame: rows y and z of its w2c are negated.
y='-0.497227191, 0.838055296, -0.224562778, 1.069885481'
z='0.769752713, 0.545526135, 0.331484535, 3.540686501'
variant turned "s/$y/0.497227191, -0.838055296, 0.224562778, -1.069885481/g
s/$z/-0.769752713, -0.545526135, -0.331484535, -3.540686501/g"
run "$bin/spin-import" --check-cameras "$work/seen" --data "$work/turned" "$clip"
is "$code" 0 "one camera that looks the other way"
is "$(wc -l <"$work/err")" 1 "is one warning"
err_has "^warning: camera 12 has [0-9] % of the points in front and 0 % inside its image in frame 0, but the median of all views is 9[0-9] % and 6[0-9] %: check the pose of this camera" \
    "that names it"
of_camera 12 | grep -q 'far fewer'
ok $? "its line says so"
is "$(sed -n 1p "$work/out" | cut -d : -f 1)" "1 of 8 cameras does not fit" "the verdict counts it"
is "$(grep -c 'far fewer' "$work/out")" 1 "no other line does"
[ -s "$work/seen/cam_12_frame_00000.png" ]
ok $? "it is drawn, though it is none of the four"
out_has "^check .*frame 0, camera 12: " "and listed"
run "$bin/spin-import" --check-cameras "$work/seen" --data "$work/turned" "$clip" --force --json
is_json "the same as JSON"
is "$(grep -c '"apart": true' "$work/out"), $(grep -c '"apart": false' "$work/out")" "1, 7" "one is apart of eight"

# In a single frame only.
variant once "s/$y/0.497227191, -0.838055296, 0.224562778, -1.069885481/2
s/$z/-0.769752713, -0.545526135, -0.331484535, -3.540686501/2"
run "$bin/spin-import" --check-cameras "$work/once.seen" --data "$work/once" "$clip"
is "$code" 0 "a camera that is wrong in one frame"
err_has "^warning: camera 12 has .* in frame 1, " "is named with the frame"
[ -s "$work/once.seen/cam_12_frame_00001.png" ]
ok $? "and drawn"

variant twice 's/\[3, 7, 12, 19,/[7, 7, 7, 7,/g'
run "$bin/spin-import" --check-cameras "$work/both" --data "$work/twice" "$clip" --json
is "$code" 0 "a camera that is there more than once"
err_has "^warning: '$work/twice/ims/[0-9]*/000008.jpg' and '$work/twice/ims/[0-9]*/000008.jpg' are both images of camera 7 in frame 0$" \
    "is a warning"
! grep -q "ims/\([0-9]*/\)000008.jpg' and '$work/twice/ims/\1" "$work/err"
ok $? "that names two files"
for file in cam_07_2_frame_00000.png cam_07_4_frame_00000.png; do
    [ -s "$work/both/$file" ] && grep -q "\"file\": \"$file\"" "$work/out"
    ok $? "$file is drawn and listed"
done
is "$(grep -c '"file"' "$work/out")" "$(find "$work/both" -name '*.png' | wc -l)" "a picture for every line"

variant swapped 's/"w": 160, "h": 90/"w": 90, "h": 160/'
run "$bin/spin-import" --data "$work/swapped" "$clip" -o "$work/swapped.spin"
fails 1 spin-import "width and height swapped"
err_has "camera 0: image '[^']*ims/0/000008.jpg' has 160 x 90 pixels, which differ in aspect ratio from the camera's 90 x 160" \
    "camera, image and both sizes are named"
nothing_at "$work/swapped.spin" "nothing was written"
run "$bin/spin-import" --data "$clip" "$clip" -o "$work/clip.spin"
for command in "spin-retrain $work/clip.spin -o $work/net.spin" "spin-eval $work/clip.spin --source"; do
    # shellcheck disable=SC2086
    run "$bin/"$command --data "$work/swapped"
    fails 1 "${command%% *}" "width and height swapped"
    err_has "camera 0: image '[^']*ims/0/000008.jpg' has 160 x 90" "${command%% *}: names the camera"
done
nothing_at "$work/net.spin" "nothing was written"
done_testing
