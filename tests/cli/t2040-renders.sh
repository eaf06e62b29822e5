#!/bin/sh
# K: long retrain renders flipbook 4d
# Frames without images: a data set rendered from the clip itself, and 4D splats trained on it.
. tests/cli/lib.sh

run "$bin/spin-import" --from d3dgs $clip -o "$work/run.spin"
run "$bin/spin-export" "$work/run.spin" --to ply -o "$work/frames"
is "$code" 0 "writes a folder of frames"
rm -f "$work/frames/sequence.json"
run "$bin/spin-import" --from ply "$work/frames" -o "$work/clip.spin"
is "$code" 0 "imports it"

# ---- The data set ------------------------------------------------------------------------------

views=renders:cameras=9,test=4,size=96x64
run "$bin/spin-eval" "$work/clip.spin" --data renders --data-from $views --json
is "$code $(member psnr | awk '{ print ($1 > 55) }')" "0 1" "the clip looks like its own renders"
run "$bin/spin-retrain" "$work/clip.spin" -o "$work/a.spin" --data renders --data-from $views --iterations 20 \
    --residual source --threads 1
is "$code" 0 "trains on renders"
err_has "54 training and 24 test views" "of nine and four cameras"
run "$bin/spin-retrain" "$work/clip.spin" -o "$work/b.spin" --data-from $views --iterations 20 \
    --residual source --threads 2
cmp -s "$work/a.spin" "$work/b.spin"
ok $? "--data may be left out, and threads do not change the result"
run "$bin/spin-eval" "$work/a.spin" --json
is "$code $(member psnr | awk '{ print ($1 > 20) }')" "0 1" "the bundle names its renders"
run "$bin/spin-eval" "$work/a.spin" --data "$work/clip.spin" --data-from renders:cameras=8,test=1,size=64x48 --json
is "$code" 0 "and others may be drawn from a bundle"
for wrong in size=9 up=w cameras=0 colour=1; do
    run "$bin/spin-eval" "$work/clip.spin" --data renders --data-from renders:$wrong
    fails 2 spin-eval "renders:$wrong"
done

# ---- Cameras of the source -----------------------------------------------------------------------

mkdir "$work/kept"
run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$work/rig.spin"
run "$bin/spin-export" "$work/rig.spin" --data renders --to images --views all --transforms -o "$work/kept/teacher" --json
is "$code $(ls "$work/kept/teacher" | grep -c png)" "0 48" "views from the eight cameras that the bundle keeps"
err_has "8 of the 8 cameras that the clip keeps" "and a note"
run "$bin/spin-eval" "$work/rig.spin" --data "$work/kept/teacher" --pair order --json
is "$code $(member psnr | awk '{ print ($1 > 55) }')" "0 1" "images and --transforms are a data set with the same cameras"
run "$bin/spin-export" "$work/rig.spin" --data renders --data-from renders:cameras=3,test=1 --to images --views train \
    -o "$work/kept/three"
is "$code $(ls "$work/kept/three" | grep -c png)" "0 18" "three of them for training"
run "$bin/spin-export" "$work/rig.spin" --data renders --data-from renders:cameras=3,test=2,up=y --to images \
    --views all -o "$work/kept/placed"
is "$code $(ls "$work/kept/placed" | grep -c png)" "0 30" "an option of placed cameras places cameras"
err_has "around the subject" "as the note says"
run "$bin/spin-export" "$work/rig.spin" --data renders --to images --transforms --format exr -q -o "$work/kept/exr"
fails 2 spin-export "--transforms needs PNG"

mkdir "$work/kept/far"
python3 - "$work/frames" "$work/kept/far" <<'EOF'
import os, struct, sys
for name in os.listdir(sys.argv[1]):
    data = open(os.path.join(sys.argv[1], name), 'rb').read()
    at = data.index(b'end_header\n') + 11
    head = data[:at].decode()
    n = head.count('property float')
    for c in 'xyz':
        head = head.replace('property float %s\n' % c, 'property double %s\n' % c)
    with open(os.path.join(sys.argv[2], name), 'wb') as f:
        f.write(head.encode())
        for v in struct.iter_unpack('<%df' % n, data[at:]):
            f.write(struct.pack('<3d%df' % (n - 3), v[0] + 448262.75, v[1] + 5411932.5, v[2] + 120, *v[3:]))
EOF
run "$bin/spin-import" --from ply "$work/kept/far" -o "$work/far.spin"
is "$code" 0 "imports frames in UTM coordinates"
run "$bin/spin-eval" "$work/far.spin" --data renders --data-from $views --json
is "$code $(member psnr | awk '{ print ($1 > 55) }')" "0 1" "their renders are drawn where their splats are"

# ---- Pairing -----------------------------------------------------------------------------------

mkdir "$work/five"
for i in 1 2 3 4 5; do
    cp "$work/frames/frame_0000$i.ply" "$work/five/frame_$((i + 100008)).ply"
done
rename() { for f in "$work"/five/*; do mv "$f" "$(echo "$f" | sed 's/frame_1/frame_0/')"; done; }
rename
run "$bin/spin-import" --from ply "$work/five" -o "$work/five.spin"
run "$bin/spin-import" --from ply "$work/five" -o "$work/paired.spin" --data "$work/five.spin" --pair order
is "$code" 0 "a bundle is a data set of renders, paired by order"
run "$bin/spin-eval" "$work/paired.spin" --data $clip --json
is "$code" 0 "another data set is paired anew, by number"

# ---- One command -------------------------------------------------------------------------------

cd "$work" || exit 1
case $bin in /*) ;; *) bin=$OLDPWD/$bin ;; esac
run "$bin/spin4d" frames -o moves.tsog --iterations 60 --json
is "$code" 0 "frames become 4D splats"
err_has "static and stored once" "what stands still is stored once"
is "$(echo $(ls -d moves.*))" "moves.import.spin moves.spin moves.tracks.spin moves.tsog" "what is kept"
is "$(python3 -c 'import json,sys,zipfile
print(json.load(zipfile.ZipFile(sys.argv[1]).open("meta.json"))["trained"]["options"]["densify_threshold"])' moves.tracks.spin)" 1 \
    "no splats are added to those of the frames"
flicker=$(python3 -c 'import json,sys; e = json.load(open(sys.argv[1]))["eval"]; print(e["flicker"] < 1 and e["psnr"] > 20)' "$work/out")
is "$flicker" True "it is measured in held-out views"
is "$(python3 -c 'import json,sys; print(json.load(open(sys.argv[1]))["input_bytes"])' "$work/out")" \
    "$(cat frames/*.ply | wc -c)" "and the size of the frames is reported"
run "$bin/spin4d" frames -o page.html --iterations 20
is "$code $(echo $(ls -d page.*))" "0 page.html page.import.spin page.spin" "and a page of frames without shared rows"
run "$bin/spin4d" run.spin -o shared.html --iterations 20
is "$code" 0 "a page of frames that share their rows"
is "$(grep -c "renders of the clip itself" "$work/err")" 0 "is not retrained"
static_and_dynamic() { sed -n 's/^of .* per frame, \([0-9]*\) are static and stored once, and \([0-9]*\) are dynamic.*/\1 \2/p' "$work/err"; }
# Ends the training as soon as it states the number of its iterations: 85 % of 1500 + 6 x 100.
"$bin/spin4d" frames -o share.tsog --data renders --data-from $views 2>share.err &
pid=$! waits=0
while ! grep -q "preset quick" share.err && kill -0 $pid 2>/dev/null && [ $waits -lt 600 ]; do
    sleep 0.1
    waits=$((waits + 1))
done
kill -KILL $pid 2>/dev/null
wait $pid 2>/dev/null
is "$(sed -n 's/^preset quick: \([0-9]*\) iterations.*/\1/p' share.err)" 1785 "tracks need fewer iterations before 4D splats"
run "$bin/spin4d" frames -o all.tsog --data renders --data-from $views --iterations 2
sizes=$(sed -n 's/.* the clip will have about \(.*\) kB/\1/p' "$work/err")
is "$(echo "$sizes $(stat -c %s all.tsog)" | awk '{ print ($2 / 1000 / $1 > 0.5 && $2 / 1000 / $1 < 2) }')" 1 "the size is estimated"
whole=$(static_and_dynamic)
run "$bin/spin4d" frames -o half.tsog --data renders --data-from $views --iterations 2 --splats 50%
is "$code $(echo "$whole $(static_and_dynamic)" | awk '{ print ($3 / $1 > 0.45 && $3 / $1 < 0.55 && $4 / $2 > 0.45 && $4 / $2 < 0.55) }')" \
    "0 1" "--splats keeps a share"
run "$bin/spin4d" frames -o auto.tsog --data renders --data-from $views --iterations 2 --splats auto
is "$code $(echo "$whole $(static_and_dynamic)" | awk '{ print ($3 / $1 > 0.55 && $3 / $1 < 0.65 && $4 / $2 > 0.35 && $4 / $2 < 0.45) }')" \
    "0 1" "auto keeps fewer of what moves"
run "$bin/spin4d" frames -o most.tsog --data renders --data-from $views --iterations 2 --splats 1000
is "$code $(static_and_dynamic | awk '{ print ($1 + $2 > 950 && $1 + $2 < 1050) }')" "0 1" "a number is that of a frame"
for wrong in 0 101% half 2.5; do
    run "$bin/spin4d" frames -o wrong.tsog --splats $wrong
    fails 2 spin4d "--splats '$wrong': expected"
done

python3 "$OLDPWD/tests/cli/stage.py" stage
run "$bin/spin4d" stage -o stage.tsog --data renders --data-from renders:cameras=9,test=4,size=192x128 --iterations 2
is "$(grep -c "worse than" "$work/err")" 0 "no warning that the result is worse than its own renders"
is "$code $(static_and_dynamic)" "0 861 125" "a ball moves before a wall, although cameras behind the wall do not see it"

# ---- Frames of points with images ----------------------------------------------------------------

# Prints 1 if about 861 of the points are static and about 125 dynamic.
points_settle() { static_and_dynamic | awk '{ print ($1 > 845 && $1 < 875 && $2 >= 125 && $2 < 145) }'; }
run "$bin/spin-import" stage -o stage.spin
run "$bin/spin-export" stage.spin --data renders --data-from renders:cameras=9,test=4,size=192x128 --to images --views all \
    --transforms -o images
python3 "$OLDPWD/tests/cli/stage.py" points points
run "$bin/spin4d" points --data images -o points.html --iterations 2
is "$code $(points_settle)" "0 1" "the images show which points are static"
is "$(echo $(ls -d points.*))" "points.html points.spin" "what is kept"
run "$bin/spin-eval" points.spin --json
is "$code" 0 "the bundle names its images"
run "$bin/spin-import" points --data images -o given.spin
run "$bin/spin4d" given.spin -o named.html --iterations 2
is "$code $(points_settle)" "0 1" "also those that a bundle names"
run "$bin/spin4d" stage --data images -o same.html --iterations 2
is "$code $(static_and_dynamic)" "0 " "not needed if frames share positions"
run "$bin/spin-export" stage.spin --data renders --data-from renders:cameras=3,test=1,size=96x64 --to images --views all \
    --transforms -o three
run "$bin/spin4d" points --data three -o three.html --iterations 2
err_has "stored in every frame: there are fewer than 4 cameras" "three cameras show too little"
cp -r points seven
rm seven/frame_00003.ply
run "$bin/spin4d" seven --data images -o seven.html --iterations 2
is "$code $(static_and_dynamic)" "0 " "not done for seven frames"
run "$bin/spin4d" points --data images -o splats.html --splats auto
fails 2 spin4d "frames that consist of different splats"
cp -r images moved
python3 -c 'import json
t = json.load(open("moved/transforms_train.json"))
t["frames"][-1]["transform_matrix"][0][3] += .01
json.dump(t, open("moved/transforms_train.json", "w"))'
run "$bin/spin4d" points --data moved -o moved.html --iterations 2
is "$code $(static_and_dynamic)" "0 " "with a camera that moves, nothing is shared"
err_has "stored in every frame: the cameras move" "and a line says why"

run "$bin/spin4d" run.spin -o shared.tsog --splats auto
fails 2 spin4d "frames that consist of different splats"
run "$bin/spin4d" frames -o plain.tsog --no-retrain
is "$code $(ls -d plain.*.spin 2>/dev/null)" "0 " "--no-retrain converts"
mkdir one && cp "$(ls -d frames/*.ply | head -n 1)" one
run "$bin/spin4d" one -o one.tsog --data renders
fails 1 spin4d "one frame"
err_has "two or more frames" "is refused"
run "$bin/spin4d" one -o one.ply.d --to ply
is "$code" 0 "and converted without --data renders"
done_testing
