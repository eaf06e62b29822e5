#!/bin/sh
# K: retrain refine sound memory
# Faults that used to be silent: a single camera per frame or in all, nothing in view, an image
# cache sized for all images, too many pairs of splats and tiles, nothing to resume, a result worse
# than the source.
. tests/cli/lib.sh

if [ ! -d "$clip" ]; then
    skip "sound" "no fixture at $clip"
    done_testing
fi
small='--preset paper --device cpu --scale 0.25 --batch 1 --levels 2 --hash-log2 8 --finest-resolution 16 --hidden 8'

# Line N of the K 3 x 3 or 4 x 4 matrices: the court's training cameras, six per frame.
matrix() { # SIZE N
    row='\[[^][]*\]'
    rows=$row
    for _ in $(seq 2 "$1"); do rows="$rows, $row"; done
    grep -o "\[$rows\]" "$clip/train_meta.json" | sed -n "$2p"
}
camera_name() { echo "3 7 12 19 23 27" | cut -d ' ' -f "$1"; }

# one_view FOLDER CAMERA... (1 to 6): a data set of six frames, each with one camera, which has
# number 0.
one_view() {
    folder=$1
    shift
    mkdir -p "$folder"
    cp -r "$clip/ims" "$folder/ims"
    k='' w2c='' fn='' id='' t=8
    for c in "$@"; do
        k="$k$k_comma[$(matrix 3 "$c")]"
        w2c="$w2c$k_comma[$(matrix 4 "$c")]"
        fn="$fn$k_comma[\"$(camera_name "$c")/$(printf %06d $t).jpg\"]"
        id="$id$k_comma[0]"
        k_comma=', '
        t=$((t + 1))
    done
    k_comma=
    echo "{\"w\": 160, \"h\": 90, \"k\": [$k], \"w2c\": [$w2c], \"fn\": [$fn], \"cam_id\": [$id]}" \
        >"$folder/train_meta.json"
}
k_comma=
one_view "$work/moving" 1 2 3 4 5 6
one_view "$work/single" 2 2 2 2 2 2
one_view "$work/away" 2 2 2 2 2 2
in=$work/in.spin
run "$bin/spin-import" "$clip/params.npz" --data "$work/moving" -o "$in"
is "$code" 0 "imports a clip that one moving camera sees"

# The scene extent that a bundle's network was trained with; meta.json is stored uncompressed.
extent_of() { tr -d ' \n' <"$1" | LC_ALL=C grep -a -o '"spatial_extent":[0-9.e+-]*' | sed 's/.*://; q'; }
run "$bin/spin-retrain" "$in" -o "$work/moving.spin" $small --iterations 12
is "$code" 0 "one view a time: retrains"
extent=$(extent_of "$work/moving.spin")
greater "$extent" 0.1
ok $? "with the extent of the camera's way ($extent)"
grep -q "one place" "$work/err"
is $? 1 "and nothing is said of one place"
run "$bin/spin-retrain" "$in" -o "$work/refined.spin" $small --iterations 3 --refine 12
is "$code" 0 "one view a time: frames can be refined"

run "$bin/spin-retrain" "$in" --data "$work/single" -o "$work/single.spin" $small --iterations 12
is "$code" 0 "one camera in one place: retrains"
err_has "are at one position" "and says where the extent comes from"
extent=$(extent_of "$work/single.spin")
greater "$extent" 0.1
ok $? "which is that of the distance to the points ($extent)"
run "$bin/spin-eval" "$work/single.spin" --data "$clip" --json
greater "$(member psnr)" 3
ok $? "the network draws pictures"
run "$bin/spin-retrain" "$in" --data "$work/single" -o "$work/refined.spin" $small --iterations 3 \
    --refine 12 --force
is "$code" 0 "one camera in one place: frames can be refined"

# Cameras that face away from the scene: all of them, or one.
far='\[0.0, 0.0, 0.0, 1.0\]'
sed "s/, [-0-9.]*\], $far/, -1e4], [0.0, 0.0, 0.0, 1.0]/g" "$work/single/train_meta.json" \
    >"$work/away/train_meta.json"
run "$bin/spin-retrain" "$in" --data "$work/away" -o "$work/away.spin" $small --iterations 12
fails_late() { # NAME: the last line is the error
    is "$code" 1 "$1: exit code 1"
    tail -n 1 "$work/err" | grep -q "^spin-retrain: .*no splat was visible in any view"
    ok $? "$1: says so"
    [ ! -e "$work/away.spin" ]
    ok $? "$1: no output"
}
fails_late "nothing in view"
run "$bin/spin-retrain" "$in" --data "$work/away" -o "$work/away.spin" $small --method frames --refine 5 --force
fails_late "nothing in view of any frame"
sed "s/, [-0-9.]*\], $far/, -1e4], [0.0, 0.0, 0.0, 1.0]/" "$work/single/train_meta.json" \
    >"$work/away/train_meta.json"
run "$bin/spin-retrain" "$in" --data "$work/away" -o "$work/away.spin" $small --iterations 12 --force
is "$code" 0 "nothing in view of one frame of six: retrains"
grep -c 'no splat was visible' "$work/err" >"$work/times"
err_has "^warning: in 2 of 12 iterations, no splat was visible in any view (first in iteration [1-6]): these iterations learned nothing$" \
    "and says in how many steps"
is "$(cat "$work/times")" 1 "once"
run "$bin/spin-retrain" "$in" --data "$work/away" -o "$work/away.spin" $small --method frames --refine 5 \
    --force
is "$code" 0 "nothing in view of one frame of six: refines"
is "$(grep 'no splat was visible' "$work/err")" \
    "warning: no splat was visible in 5 of 30 iterations of the refinement: these iterations learned nothing" "and says so"

# Nine megapixels, 2000 cameras, six frames: a third of a terabyte of images, which may fill at most
# a third of the memory.
awk 'BEGIN {
    printf "{\"w\": 4000, \"h\": 2250"
    n = split("k w2c fn cam_id", key, " ")
    for (i = 1; i <= n; i++) {
        printf ", \"%s\": [", key[i]
        for (t = 0; t < 6; t++) {
            printf "%s[", t ? ", " : ""
            for (c = 0; c < 2000; c++) {
                printf "%s", c ? ", " : ""
                if (i == 1) printf "[[4000, 0, 2000], [0, 4000, 1125], [0, 0, 1]]"
                if (i == 2) printf "[[1, 0, 0, %d], [0, 1, 0, 0], [0, 0, 1, 9], [0, 0, 0, 1]]", c
                if (i == 3) printf "\"3/%06d.jpg\"", 8 + t % 6
                if (i == 4) printf "%d", c
            }
            printf "]"
        }
        printf "]"
    }
    print "}"
}' >"$work/away/train_meta.json"
run "$bin/spin-retrain" "$in" --data "$work/away" --pair order --dry-run --json --device cpu --levels 2 \
    --hash-log2 8 --finest-resolution 16
is "$code" 0 "plans a run with a third of a terabyte of images"
available=$(member bytes_available)
needed=$(member bytes_needed)
[ "$needed" -gt "$((available / 4))" ] && [ "$needed" -lt "$available" ] ||
    [ "$available" -lt 8000000000 ] || [ "$available" -gt 400000000000 ]
ok $? "of which it counts what is kept ($needed of $available)"

# Splats that cover all tiles of a large image: more pairs than the limit.
printf '{"w": 16384, "h": 9216, "k": [[[[1e4, 0, 8192], [0, 1e4, 4608], [0, 0, 1]]]],
"w2c": [[[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]]], "fn": [["3/000008.jpg"]],
"cam_id": [[0]]}\n' >"$work/away/train_meta.json"
{
    printf 'ply\nformat ascii 1.0\nelement vertex 540\n'
    for name in x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3; do
        printf 'property float %s\n' "$name"
    done
    printf 'end_header\n'
    for _ in $(seq 540); do echo "0 0 5 0 0 0 9 5 5 5 1 0 0 0"; done
} >"$work/wide.ply"
run "$bin/spin-import" "$work/wide.ply" --data "$work/away" -o "$work/wide.spin"
is "$code" 0 "imports splats as large as the picture"
run "$bin/spin-export" "$work/wide.spin" --to images -o "$work/wide" --views all
fails 1 spin-export "more pairs than there may be"
err_has "318504960 pairs of splats and tiles exceed the limit of" "they are counted"
nothing_at "$work/wide/" "no picture"

# Nothing to resume is not an error, since scripts may always pass --resume; but it is reported.
run "$bin/spin-retrain" "$in" --data "$clip" -o "$work/new.spin" $small --iterations 2 --resume
is "$code" 0 "--resume with nothing to resume starts anew"
err_has "nothing to resume" "and says so"
err_has "worse than the source" "a result worse than the source is told"
err_has "try more --iterations" "with what to try"
run "$bin/spin-retrain" "$in" --data "$clip" -o "$work/new.spin" $small --iterations 2 --force
grep -q "nothing to resume" "$work/err"
is $? 1 "without --resume there is nothing to say"
run "$bin/spin-retrain" "$in" --data "$clip" -o "$work/new.spin" $small --iterations 2 --method frames \
    --refine 150 --refine-start source --force
grep -q "worse than the source" "$work/err"
is $? 1 "what is better is not"
done_testing
