#!/bin/sh
# K: long retrain outputs resume
# Outputs and images are checked before the first iteration; a failure after training loses nothing;
# files that changed are not reused; only one run at a time writes an output.
. tests/cli/lib.sh

data=$work/data
cp -R "$clip" "$data"
chmod -R u+w "$data"
in=$work/in.spin
run "$bin/spin-import" --from d3dgs "$data" --data "$data" -o "$in"
is "$code" 0 "imports the clip"
small='--preset paper --device cpu --threads 1 --range 0:2 --scale 0.25 --levels 2 --hash-log2 8 --finest-resolution 32
    --hidden 8'
out=$work/out.spin
steps=60

# shellcheck disable=SC2086
retrain() { run "$bin/spin-retrain" "$in" -o "$out" $small --iterations $steps "$@"; }
same() { # FILE FILE NAME
    cmp -s "$1" "$2"
    ok $? "$3"
}
steps_of() { grep -c '"step_s"' "$1"; }

# Starts a run in the background; its log, which is flushed in blocks, shows when it is under way.
start() { # ARGUMENTS...
    rm -f "$work/log"
    # shellcheck disable=SC2086
    "$bin/spin-retrain" "$in" -o "$out" $small --log "$work/log" "$@" >"$work/out" 2>"$work/err" &
    pid=$!
    await "$work/log"
}
await() { # FILE
    tries=0
    while [ ! -s "$1" ] && kill -0 $pid 2>/dev/null && [ $tries -lt 1200 ]; do
        sleep 0.02
        tries=$((tries + 1))
    done
}
finish() {
    wait $pid
    code=$?
}

killed() { # ARGUMENTS...
    rm -rf "$out"*
    start --iterations 150 --save-every 20 "$@"
    await "$out.part"
    kill -KILL $pid 2>/dev/null
    wait $pid 2>/dev/null
}
retrain
is "$code" 0 "retrains"
mv "$out" "$work/whole.spin"

# ---- Before the first iteration: one line, and nothing was begun ----

touch "$work/file"
mkdir "$work/folder"
for bad in "$work/none/x.spin:no such file" "$work/file/x.spin:Not a directory" "$work/folder:it is a folder"; do
    run "$bin/spin-retrain" "$in" -o "${bad%%:*}" $small --iterations $steps
    fails 1 spin-retrain "output '${bad##*/}'"
    err_has "'${bad%%:*}': ${bad#*:}" "and says why"
done
rmdir "$work/folder"
retrain --preview "$work/file"
fails 1 spin-retrain "--preview is a file"
mkdir "$work/mine" && echo mine >"$work/mine/picture.png"
retrain --preview "$work/mine"
fails 1 spin-retrain "--preview where files are"
err_has "not empty; use --force" "and names --force"
run "$bin/spin-eval" "$in" --images "$work/mine" --range 0:1
fails 1 spin-eval "--images where files are"
err_has "not empty; use --force" "and names --force"
is "$(ls "$work/mine")" picture.png "both leave the folder as it was"
run "$bin/spin-eval" "$in" --images "$work/mine" --range 0:1 --force
is "$code" 0 "--images with --force"
is "$(cat "$work/mine/picture.png")" mine "what has another name stays"
retrain --preview "$work/file/below"
fails 1 spin-retrain "--preview below a file"
retrain --log "$work/none/log"
fails 1 spin-retrain "no folder for --log"
err_has "none/log': No such file" "and says why"
mkdir "$out.part"
retrain
fails 1 spin-retrain "a folder where the state goes"
rmdir "$out.part"
touch "$out.parts"
retrain --refine 10 --force
fails 1 spin-retrain "a file where the refined frames go"
rm "$out.parts"
nothing_at "$out" "nothing is written"

"$bin/spin-eval" "$in" --range 0:1 --images "$work/pictures" -q >/dev/null 2>&1
image=$data/ims/0/000009.jpg
unread=$(find "$data/ims/0" -name '*.jpg' | sort | tail -n 1)
cp "$unread" "$work/unread.jpg"
retrain --log "$unread" --force
fails 1 spin-retrain "a log that would replace an image of the data set, which is not read"
err_has "'$unread': it is an input" "and says so"
same "$unread" "$work/unread.jpg" "which stays as it was"
cp "$image" "$work/image.jpg"
for camera in "$data"/ims/*; do
    file=$(find "$camera" -name '*.jpg' | sort | head -n 1)
    cp "$file" "$work/kept.jpg"
    n=$(wc -c <"$file")
    head -c $((n - 1)) "$work/kept.jpg" >"$file"
    retrain
    is "$code" 1 "camera ${camera##*/}: an image that is a byte short is found"
    [ "$(wc -l <"$work/err")" = 1 ] && grep -q "'$file': the file is cut short" "$work/err"
    ok $? "before the first step, and named"
    cp "$work/kept.jpg" "$file"
done
rm "$image"
retrain
is "$code" 0 "goes on without a missing image"
err_has "1 of 48 images is missing and left out, the first is '$image'" "and says which"
rm "$out"
echo "no image" >"$image"
retrain
fails 1 spin-retrain "what is no image"
cp "$(find "$work/pictures" -name '*.png' | head -n 1)" "$image"
retrain
fails 1 spin-retrain "an image of another shape"
err_has "differ in aspect ratio" "and says so"
cp "$work/image.jpg" "$image"
nothing_at "$out" "nothing is written"

# ---- Dangling links are not replaced without --force ----

ln -s nowhere "$out"
retrain
fails 1 spin-retrain "the output is a link to nothing"
run "$bin/spin-import" --from d3dgs "$data" -o "$out"
fails 1 spin-import "the bundle is a link to nothing"
run "$bin/spin-export" "$in" --to gltf -o "$out"
fails 1 spin-export "a folder is a link to nothing"
ln -s nowhere "$work/x.glb"
run "$bin/spin-export" "$in" --to gltf -o "$work/x.glb"
fails 1 spin-export "a file is a link to nothing"
ln -s nowhere "$work/x.html"
run "$bin/spin-eval" "$in" --range 0:1 --scale 0.25 --report "$work/x.html"
fails 1 spin-eval "the report is a link to nothing"
mkdir "$work/check"
run "$bin/spin-import" --from d3dgs "$data" --data "$data" --check-cameras "$work/check"
is "$code" 0 "draws cameras"
for file in "$work/check"/*.png; do
    rm "$file"
    ln -s nowhere "$file"
done
run "$bin/spin-import" --from d3dgs "$data" --data "$data" --check-cameras "$work/check"
fails 1 spin-import "an overlay is a link to nothing"
[ ! -e "$work/nowhere" ] && [ ! -e "$work/check/nowhere" ] && [ -L "$out" ] && [ -L "$work/x.glb" ] &&
    [ -L "$work/x.html" ]
ok $? "they all stay"
retrain --force
same "$out" "$work/whole.spin" "with --force the link is replaced"
rm "$out"

# ---- The other commands, before their work ----

for bad in "$work/none/x.html" "$work/file/x.html"; do
    run "$bin/spin-eval" "$in" --report "$bad" --lpips "$work/none"
    fails 1 spin-eval "report '$bad'"
    err_has "$bad" "is said before anything else is read"
done
run "$bin/spin-eval" "$in" --images "$work/file" --range 0:1
fails 1 spin-eval "--images is a file"
run "$bin/spin-import" "$work/none" -o "$work/none/x.spin"
fails 1 spin-import "no folder for the bundle"
err_has "none/x.spin'" "is said before the input is read"

# ---- After training ----

start --iterations 150
touch "$out"
finish
if [ "$(steps_of "$work/log")" -lt 150 ]; then
    skip "output made meanwhile" "it was not made in time"
fi
is "$code" 1 "the output was made meanwhile by somebody else"
err_has "exists; use --force.*iteration 150 is kept in '$out.part': continue with --resume" \
    "the error says what is kept"
[ ! -s "$out" ]
ok $? "theirs is not touched"
steps=150
retrain --resume
fails 1 spin-retrain "nor by --resume without --force"
rm "$out"
retrain --resume --log "$work/log2"
is "$code" 0 "--resume writes the output"
is "$(steps_of "$work/log2")" 0 "without a step"
nothing_at "$out." "no state is left"
mv "$out" "$work/long.spin"
retrain
same "$out" "$work/long.spin" "the bytes of a run that did not fail"
rm "$out"

start --iterations 150 --eval-every 60 --preview "$work/preview"
rm -r "$work/preview"
touch "$work/preview"
finish
is "$code" 1 "the preview folder went away meanwhile"
is "$(grep -c "^warning: .*$work/preview/.*; the training continues" "$work/err")" 1 "is said once"
tail -n 1 "$work/err" | grep -q "'$out' is complete, but an additional output is not: .*$work/preview/"
ok $? "and at the end"
same "$out" "$work/long.spin" "the training does not suffer"
nothing_at "$out." "and is finished"
rm "$out"

# A full disk, simulated by a limit on file sizes that the checkpoint meets and the output exceeds:
# its source has SH of degree 3.
"$bin/spin-export" "$work/whole.spin" --to ply -o "$work/heavy" -q
run "$bin/spin-import" "$work/heavy" --data "$data" --pair order -o "$work/heavy.spin"
is "$code" 0 "a larger input"
steps=60
light=$in
in=$work/heavy.spin
retrain --pair order
mv "$out" "$work/large.spin"
killed --pair order
part=$(wc -c <"$out.part")
rm -f "$out"*
whole=$(wc -c <"$work/large.spin")
limit=$(((part + whole) / 2 / 512))
if [ "$part" -gt 0 ] && [ "$part" -lt $((limit * 512)) ] && [ "$whole" -gt $((limit * 512)) ]; then
    (
        ulimit -f $limit
        # shellcheck disable=SC2086
        exec "$bin/spin-retrain" "$in" -o "$out" $small --pair order --iterations 60 >"$work/out" 2>"$work/err"
    )
    is $? 1 "no room for the output"
    err_has "cannot write '$out'.*iteration 60 is kept" "the training is kept"
    nothing_at "$out.tmp" "and nothing is half-written"
    retrain --pair order --resume --log "$work/log3"
    is "$(steps_of "$work/log3")" 0 "--resume only writes"
    same "$out" "$work/large.spin" "the same bytes"
    rm -f "$out"
else
    ok 1 "a limit between state ($part) and output ($whole)"
fi
in=$light

# Refined frames.
start --refine 150 --method frames
touch "$out"
finish
is "$code" 1 "refined, and the output was made meanwhile"
err_has "refined so far are kept in '$out.parts': continue with --resume" "the frames are kept"
rm "$out"
run "$bin/spin-retrain" "$in" -o "$out" $small --refine 150 --method frames --resume
is "$code" 0 "--resume writes the output"
err_has "refining 0 of 2 frames" "without a step"
rm "$out"

# ---- Free disk space ----

# If the disk is too small for the final checkpoint and output, nothing is lost: the training stops
# while its checkpoint still fits.
grows="--device cpu --threads 1 --scale 0.25 --iterations 80 --densify-every 10 --backdrop off"
mkdir "$work/small" "$work/large"
if [ "$(id -u)" = 0 ] && mount -t tmpfs -o size=7m tmpfs "$work/small" 2>/dev/null; then
    trap 'umount "$work/small"; rm -rf "$work"' EXIT
    # shellcheck disable=SC2086
    run "$bin/spin-retrain" "$in" -o "$work/large/grown.spin" $grows
    # shellcheck disable=SC2086
    run "$bin/spin-retrain" "$in" -o "$work/small/grown.spin" $grows
    is "$code" 1 "splats outgrow the disk"
    err_has "grown.spin.part': .* is free, but the checkpoint may grow to .*; free some space; the checkpoint of iteration [0-9]* is kept in" \
        "it stops while the state fits"
    mount -o remount,size=40m "$work/small"
    # shellcheck disable=SC2086
    run "$bin/spin-retrain" "$in" -o "$work/small/grown.spin" $grows --resume
    same "$work/small/grown.spin" "$work/large/grown.spin" "with more room --resume gives the same bytes"
    mount -o remount,size=700k "$work/small"
    rm -f "$work/small"/*
    for how in "--method frames" "--method frames --cache $work/small/cache" "--iterations 5 --cache $work/small/cache"; do
        to=$work/small/refined.spin
        case $how in *cache*) to=$work/large/refined.spin ;; esac
        # shellcheck disable=SC2086
        run "$bin/spin-retrain" "$in" -o "$to" --device cpu --threads 1 --scale 0.25 --refine 5 $how
        fails 1 spin-retrain "the refined frames do not fit on the disk: ${how%%$work*}"
        err_has "cannot write '$work/small/.*refined frames.* need at least .* free\$" "which is noticed before the first iteration"
        is "$(find "$work/small" "$work/large" -name '*.spin*' | grep -v grown)" "" "and writes nothing"
    done
    umount "$work/small"
    trap 'rm -rf "$work"' EXIT
else
    skip "splats that outgrow the disk" "not root, or no tmpfs can be mounted"
fi

# ---- Inputs and existing outputs ----

# kept FILE NAME COMMAND...: the command fails, and the file is unchanged.
kept() {
    file=$1
    name=$2
    shift 2
    cp "$file" "$work/kept"
    run timeout 60 "$@"
    is "$code" "${refusal:-1}" "$name: is refused"
    same "$file" "$work/kept" "$name: stays"
}
try="$bin/spin-retrain $in -o $out $small --iterations 1"
echo "mine" >"$work/mine.txt"
# shellcheck disable=SC2086
kept "$work/mine.txt" "a file as the log" $try --log "$work/mine.txt"
err_has "mine.txt': it exists; use --force" "and names --force"
# shellcheck disable=SC2086
kept "$work/mine.txt" "a file as the log of a resume" $try --log "$work/mine.txt" --resume
err_has "not a log of spin-retrain" "and says why"
for force in "" --force "--force --resume"; do
    # shellcheck disable=SC2086
    kept "$in" "the input as the log $force" $try --log "$in" $force
    err_has "'$in': it is an input" "and says so"
done
# shellcheck disable=SC2086
kept "$image" "an image as the log" $try --log "$image" --force
# shellcheck disable=SC2086
kept "$in" "the input as the output" "$bin/spin-retrain" "$in" -o "$in" $small --iterations 1 --force
ln "$in" "$work/link.spin"
# shellcheck disable=SC2086
kept "$in" "under another name" "$bin/spin-retrain" "$in" -o "$work/link.spin" $small --iterations 1 --force
rm "$work/link.spin"
cp "$in" "$out.part.spin"
kept "$out.part.spin" "what an interrupt left, as the input" "$bin/spin-retrain" "$out.part.spin" -o "$out" $small \
    --iterations 1 --pair order
rm "$out.part.spin"
refusal=2
kept "$in" "the input as the report" "$bin/spin-eval" "$in" --report "$in" --force
kept "$in" "the second input as the report" "$bin/spin-eval" "$work/whole.spin" "$in" --report "$in" --force
refusal=1
for to in html gltf ply usd tsog spz; do
    kept "$in" "the input as $to" "$bin/spin-export" "$in" --to $to -o "$in" --force
done
kept "$in" "the input as the page" "$bin/spin4d" "$in" --no-retrain --to html -o "$in" --force
kept "$in" "the input as the bundle" "$bin/spin-import" "$in" -o "$in" --force
"$bin/spin-export" "$in" --to ply --range 0:1 -o "$work/one" -q
for ply in "$work/one"/*.ply; do
    kept "$ply" "the PLY that is read" "$bin/spin4d" "$work/one" --to ply -o "$work/one" --force
done
mkfifo "$work/fifo"
# shellcheck disable=SC2086
run timeout 60 $try --log "$work/fifo" --force
fails 1 spin-retrain "a fifo as the log"
err_has "fifo': it is not an ordinary file" "and says so"
# shellcheck disable=SC2086
run $try --log "$out"
fails 2 spin-retrain "the output as the log"
err_has "two outputs would be '$out'" "and says so"
# shellcheck disable=SC2086
run $try --watch "$work/page" --log "$work/page/now.js"
is "$code" 2 "the page as the log"
run "$bin/spin-eval" "$in" --report "$work/both" --images "$work/both"
fails 2 spin-eval "one name for report and pictures"
nothing_at "$out" "nothing is written"
retrain --iterations 2 --log "$work/log4"
is "$(steps_of "$work/log4")" 2 "a log"
rm "$out"
retrain --iterations 2 --log "$work/log4" --force
is "$(steps_of "$work/log4")" 2 "replaced with --force"
rm "$out"

# ---- The log ----

if [ -w /dev/full ]; then
    retrain --log /dev/full
    is "$code" 1 "a log on a full disk"
    tail -n 1 "$work/err" | grep -q "'$out' is complete, but the log '/dev/full' is not: No space"
    ok $? "is said at the end"
    is "$(grep -c "^warning: cannot write the log '/dev/full'" "$work/err")" 1 "and once before"
    same "$out" "$work/whole.spin" "the work is not lost"
    rm "$out"
    run "$bin/spin-retrain" "$in" -o "$out" $small --refine 150 --method frames --log /dev/full
    is "$code" 1 "the same of frames that are refined"
    is "$(grep -c "^warning: cannot write the log '/dev/full'" "$work/err")" 1 "said once"
    rm "$out"
    retrain --log /dev/full --iterations 1
    is "$code" 1 "a log of one line"
    rm -f "$out"
else
    skip "a log on a full disk" "no /dev/full"
fi

# ---- Changed files are not reused ----

cameras=$("$bin/spin-eval" "$in" --range 0:1 --scale 0.25 --split train --json 2>/dev/null |
    sed -n 's/.*"camera": \([0-9]*\).*/\1/p')
held=$("$bin/spin-eval" "$in" --range 0:1 --scale 0.25 --split test --json 2>/dev/null |
    sed -n 's/.*"camera": \([0-9]*\).*/\1/p' | head -n 1)
learned=$(echo "$cameras" | head -n 1)
swap() { # CAMERA: its first image becomes another one
    file=$(find "$data/ims/$1" -name '*.jpg' | sort | head -n 1)
    cp "$file" "$work/kept.jpg"
    cp "$(find "$data/ims/$1" -name '*.jpg' | sort | tail -n 1)" "$file"
}
steps=150
killed
swap "$learned"
cp "$out.part" "$work/part"
retrain --resume
is "$code" 2 "--resume refuses when a training image has changed"
err_has "the images differ from" "and says so"
same "$out.part" "$work/part" "the state stays"
cp "$work/kept.jpg" "$file"
swap "$held"
touch "$data/ims/$learned"/*
retrain --resume
is "$code" 0 "not when a test image has, nor times of files"
cp "$work/kept.jpg" "$file"
mv "$out" "$work/other.spin"
run "$bin/spin-retrain" "$in" -o "$out" $small --refine 12 --iterations 1
cp "$out" "$work/refined.spin"
rm "$out"
run "$bin/spin-retrain" "$work/refined.spin" -o "$out" $small --refine 12 --iterations 1
err_has "refining 0 of 2 frames" "refined frames are used again"
swap "$learned"
run "$bin/spin-retrain" "$work/refined.spin" -o "$out" $small --refine 12 --iterations 1 --force
err_has "refining 1 of 2 frames" "but not the one whose image has changed"
cp "$work/kept.jpg" "$file"

# Dynamic pixels, from the images of all frames or from masks.
run "$bin/spin-retrain" "$in" -o "$work/moving.spin" $small --refine 12 --iterations 1 --dynamic-weight 3
is "$code" 0 "weighs what moves"
file=$(find "$data/ims/$learned" -name '*.jpg' | sort | tail -n 1)
cp "$file" "$work/kept.jpg"
cp "$(find "$data/ims/$learned" -name '*.jpg' | sort | head -n 1)" "$file"
run "$bin/spin-retrain" "$work/moving.spin" -o "$out" $small --refine 12 --iterations 1 --dynamic-weight 3 --force
err_has "refining 2 of 2 frames" "an image of another frame has changed, which the medians are taken of"
run "$bin/spin-retrain" "$work/refined.spin" -o "$out" $small --refine 12 --iterations 1 --force
err_has "refining 0 of 2 frames" "which does not matter without weights"
cp "$work/kept.jpg" "$file"
mask=$(find "$work/pictures" -name '*.png' | sort | head -n 1)
for camera in "$data"/ims/*; do
    mkdir -p "$data/seg/${camera##*/}"
    for file in "$camera"/*.jpg; do
        cp "$mask" "$data/seg/${camera##*/}/$(basename "$file" .jpg).png"
    done
done
run "$bin/spin-retrain" "$in" -o "$work/moving.spin" $small --refine 12 --iterations 1 --dynamic-weight 3 --force
file=$(find "$data/seg/$learned" -name '*.png' | sort | head -n 1)
cp "$(find "$work/pictures" -name '*.png' | sort | tail -n 1)" "$file"
run "$bin/spin-retrain" "$work/moving.spin" -o "$out" $small --refine 12 --iterations 1 --dynamic-weight 3 --force
err_has "refining 1 of 2 frames" "a mask has changed"
: >"$file"
run "$bin/spin-retrain" "$work/moving.spin" -o "$work/y.spin" $small --refine 12 --iterations 1 --dynamic-weight 3
fails 1 spin-retrain "an empty mask"
rm -r "$data/seg"

# ---- The processor's SIMD path ----

now=$("$bin/spin-retrain" "$in" --dry-run $small --json 2>/dev/null | sed -n 's/.*"device": "cpu (\([^,]*\),.*/\1/p')
if [ "$now" = portable ]; then
    skip "another code path" "this processor has one only"
else
    SPIN_CPU=base
    export SPIN_CPU
    killed
    unset SPIN_CPU
    retrain --resume
    is "$code" 0 "goes on with another code path"
    is "$(grep -c '^warning: .*in the last bits' "$work/err")" 1 "and says once what that means"
    unzip -p "$out" meta.json 2>/dev/null | grep -q '"path": "v[34]+base"' ||
        python3 -c 'import json, sys, zipfile
sys.exit(json.loads(zipfile.ZipFile(sys.argv[1]).read("meta.json"))["trained"]["path"] not in ("v3+base", "v4+base"))' "$out"
    ok $? "the output has both"
    killed
    retrain --resume
    is "$(grep -c '^warning: .*in the last bits' "$work/err")" 0 "with the same code path nothing is said"
    same "$out" "$work/long.spin" "and the bytes are those of an unbroken run"
    rm "$out"
    SPIN_CPU=base
    export SPIN_CPU
    start --refine 150
    await "$out.parts/00000.spin"
    kill -KILL $pid
    wait $pid 2>/dev/null
    unset SPIN_CPU
    run "$bin/spin-retrain" "$in" -o "$out" $small --refine 150 --iterations 1 --resume
    is "$(grep -c '^warning: .*in the last bits' "$work/err")" 1 "refined frames as well"
fi

# ---- One run at a time ----

rm -rf "$out"*
steps=150
start --iterations 150
kill -STOP $pid # a busy machine must not let it end before the others try
cp "$out.lock" "$work/lock" 2>/dev/null
ok $? "a run holds a lock"
retrain --force
fails 1 spin-retrain "a second run with the same output"
err_has "'$out': another run is writing it" "names it"
retrain --force --resume
is "$code" 1 "nor does --resume"
kill -CONT $pid
finish
is "$code" 0 "the first goes on"
same "$out" "$work/long.spin" "unharmed"
nothing_at "$out." "and leaves no lock"
killed
[ -e "$out.lock" ]
ok $? "a killed run leaves its lock's file"
retrain --resume
is "$code" 0 "which holds nobody up"
same "$out" "$work/long.spin" "the bytes of an unbroken run"
nothing_at "$out." "and nothing is left"

done_testing
