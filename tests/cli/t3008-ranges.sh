#!/bin/sh
# K: long range export ply gltf glb splat compressed-ply spz sog usd html images video eval retrain
# refine
# --range in every command: of a clip whose five frames differ in counts, positions, colours and
# images, frames 2 to 4 and frames 1 and 3 give the same results as a clip that contains nothing
# else.
. tests/cli/lib.sh

bin=$(cd "$bin" && pwd)
mkdir "$work/five" "$work/set" "$work/set/ims"
for f in 1 2 3 4 5; do
    n=$((20 + 7 * f))
    {
        printf 'ply\nformat ascii 1.0\nelement vertex %s\n' $n
        printf 'property float %s\n' x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3
        echo end_header
        # the last eight are static
        awk -v f=$f -v n=$n 'BEGIN { for (i = 0; i < n; i++) {
            k = i < n - 8 ? i : i - n
            t = i < n - 8 ? f : 1
            print cos(k * t), sin(3 * k + t), cos(5 * k) / t, sin(f + i), cos(2 * f), sin(7 * f * i), f - 1,
                -2 - f / 5, -2, -1 - i / n, 1, f / 5, 0, i / n } }'
    } >"$work/five/frame_$f.ply"
done
cd "$work" || exit 1

# Four cameras, one of them held out; their images are the clip's own, of other frames.
run "$bin/spin-import" five -o alone.spin
run "$bin/spin-export" alone.spin --to images --path orbit --repeat 1 --size 64x48 -o pictures
for f in 1 2 3 4 5; do
    cp pictures/orbit_frame_0000$((f % 5)).png set/ims/a_$f.png
    cp pictures/orbit_frame_0000$(((f + 2) % 5)).png set/ims/b_$f.png
    cp pictures/orbit_frame_0000$(((f + 3) % 5)).png set/ims/c_$f.png
    cp pictures/orbit_frame_0000$(((f + 4) % 5)).png set/ims/d_$f.png
done
# make_set FOLDER FRAMES: the cameras of these frames.
make_set() {
    mkdir -p "$1"
    [ -e "$1/ims" ] || cp -r set/ims "$1"
    awk -v frames="$2" -v to="$1" 'BEGIN {
        n = split(frames, number, " ")
        for (test = 0; test < 2; test++) {
            k = w = fn = id = ""
            for (i = 1; i <= n; i++) {
                f = number[i]
                comma = i > 1 ? ", " : ""
                k = k comma "["; w = w comma "["; fn = fn comma "["; id = id comma "["
                for (c = 0; c < 3 - 2 * test; c++) {
                    more = c ? ", " : ""
                    k = k more "[[60, 0, 30], [0, 60, 25], [0, 0, 1]]"
                    w = w more "[[1, 0, 0, " test / 4 - c / 2 "], [0, 1, 0, 0], [0, 0, 1, " 3 + f / 10 "], [0, 0, 0, 1]]"
                    fn = fn more "\"" (test ? "b_" : c == 0 ? "a_" : c == 1 ? "c_" : "d_") f ".png\""
                    id = id more test + 2 * c
                }
                k = k "]"; w = w "]"; fn = fn "]"; id = id "]"
            }
            printf "{\"w\": 64, \"h\": 48, \"k\": [%s], \"w2c\": [%s], \"fn\": [%s], \"cam_id\": [%s]}\n", k, w, fn, id \
                >(to "/" (test ? "test" : "train") "_meta.json")
        }
    }'
}
make_set set '1 2 3 4 5'
run "$bin/spin-import" five --data set -o whole.spin
is "$code" 0 "imports five frames and their pictures"
run "$bin/spin-export" whole.spin --to ply -o plys
[ "$(ls plys/*.ply | wc -l)" = 5 ]
ok $? "five files"
run "$bin/spin-retrain" whole.spin -o learned.spin --device cpu --iterations 20 --scale 0.5
is "$code" 0 "retrains all"
run "$bin/spin-export" learned.spin --to ply -o learned
run "$bin/spin-eval" learned.spin --split all --images all_sheets
videos=
if "$bin/spin-export" -q whole.spin --to video -o try.mp4 2>err; then
    videos='video:clip.mp4 video:orbit.mp4:--path:orbit:--repeat:2:--size:64x48'
else
    skip "videos" "$(cat err)"
fi

# same WHAT ARGUMENT...: a command applied to whole.spin with --range prints and writes (into ours/)
# the same as applied to $other, the clip without the other frames (into theirs/). What depends on
# the clock is ignored.
same() {
    what=$1
    program=$2
    shift 2
    for side in ours theirs; do
        rm -rf $side
        mkdir $side
        if [ $side = ours ]; then clip_and="../whole.spin --range $range"; else clip_and=../$other; fi
        # shellcheck disable=SC2086
        (cd $side && "$bin/$program" $clip_and "$@" >said 2>heard </dev/null)
        code=$?
        sed -i 's/, [0-9.]* kB$//' $side/said # sequence.json counts, and has other numbers
        cp $side/heard err
        is $code 0 "$range: $what, $side"
        [ "$program" = spin-export ] ||
            find $side -type f ! -name '*.png' ! -name '*.spin' -exec sed -i '/second\|minutes\|fps\|_available\|_peak/d
                /part.spin\|fewer.spin\|whole.spin\|the file\|on disk\|whole file\|attributes per frame\|"file"\|"source"\|"measured"\|measured_per_frame/d' {} +
    done
    for bundle in ours/*.spin; do
        [ -e "$bundle" ] || continue
        for side in ours theirs; do
            (cd $side && "$bin/spin-export" ./*.spin --to ply -o plys -q && rm ./*.spin)
        done
    done
    # Each bundle names its own data set.
    find ours theirs -name sequence.json -exec sed -i '/"path"/d' {} +
    diff -r ours theirs >err
    ok $? "$range: $what is that of a clip without other frames"
    [ "$failed" = 0 ] || done_testing # one is enough
}

for range in 2:5 1:5:2; do
    case $range in 2:5) wanted='2 3 4' ;; *) wanted='1 3' ;; esac
    make_set some "$wanted"
    run "$bin/spin-import" five --data some --range $range -o fewer.spin --force
    run "$bin/spin-import" five --data set --range $range -o part.spin --force --json
    is "$(member frames)" "$(echo "$wanted" | wc -w)" "$range: imports as many frames"
    for side in whole:plys learned:learned; do
        bundle=${side%:*}
        rm -rf part
        run "$bin/spin-export" "$bundle.spin" --range $range --to ply -o part
        bad=0
        for f in $wanted; do cmp -s part/frame_0000$f.ply "${side#*:}/frame_0000$f.ply" || bad=1; done
        is "$bad $(ls part/*.ply | wc -l)" "0 $(echo "$wanted" | wc -w)" "$range: the very files of $bundle"
    done
    rm -rf part
    run "$bin/spin-export" part.spin --to ply -o part
    bad=0
    for f in $wanted; do cmp -s part/frame_0000$f.ply plys/frame_0000$f.ply || bad=1; done
    is "$bad $(ls part/*.ply | wc -l)" "0 $(echo "$wanted" | wc -w)" "$range: spin-import takes these frames"

    other=part.spin
    same "spin-eval" spin-eval --split all --json --images pictures
    other=fewer.spin
    same "spin-eval of another data set" spin-eval --split all --json
    other=part.spin
    same "spin-eval --report" spin-eval --split all --report page.html
    run "$bin/spin-eval" whole.spin --range $range --json
    sed -n '/measured_per_frame/p' out >mean
    run "$bin/spin-eval" whole.spin --json
    sed -n '/measured_per_frame/p' out | cmp -s - mean && [ -s mean ]
    ok $? "$range: spin-eval: what a frame takes is of the frames that are stored"
    rm -rf sheets
    run "$bin/spin-eval" learned.spin --split all --range $range --images sheets
    diff -r -x sequence.json sheets all_sheets | grep -v '^Only in all_sheets' >err
    is "$(find sheets -name '*.png' | wc -l) $(wc -l <err)" "$((4 * $(echo "$wanted" | wc -w))) 0" \
        "$range: spin-eval --images: truth, imported and retrained"
    same "spin-retrain" spin-retrain -o r.spin --device cpu --iterations 12 --scale 0.5 --json --preview shown \
        --eval-every 6
    same "spin-retrain --preset paper" spin-retrain -o r.spin --device cpu --iterations 4 --scale 0.5 --preset paper \
        --refine 3 --levels 4 --hash-log2 10 --finest-resolution 32 --hidden 16 --json
    same "spin-retrain --method frames" spin-retrain -o r.spin --device cpu --method frames --refine 4 --scale 0.5 --json

    other=fewer.spin
    for one in ply:o gltf:o gltf:clip.glb gltf:clip.glb:--still-apart splat:o compressed-ply:o \
        spz:o spz:o:--spz-version:3 sog:o usd:o html:page.html html:page.html:--split:--max-splats:9 images:o \
        images:o:--views:train:--panels:truth,after images:o:--path:orbit:--repeat:1:--size:64x48 images:o:--path:train:--repeat:1:--size:64x48 $videos; do
        to=${one%%:*}
        rest=$(echo "${one#*:}" | tr : ' ')
        case $to in ply | splat | compressed-ply | spz | sog | gltf) rest="$rest --check" ;; esac
        if [ "$to" = sog ] && ! ldconfig -p 2>/dev/null | grep -q 'libwebp\.so\.7'; then continue; fi
        # shellcheck disable=SC2086
        same "$to $rest" spin-export --to "$to" -o $rest
    done
    # Imported frames beside trained ones.
    rm -rf ours theirs
    run "$bin/spin-export" learned.spin --range $range --to html --only before -o ours
    counts=$(for f in $wanted; do echo $((20 + 7 * f)); done | tr '\n' ',')
    grep -q "\"splats\":\[${counts%,}\]" ours
    ok $? "$range: html --only before: $counts"
    rm -rf ours theirs
    run "$bin/spin-export" learned.spin --range $range --to images --panels before -o ours
    run "$bin/spin-export" fewer.spin --to images -o theirs
    diff -r ours theirs >err
    ok $? "$range: images --panels before"
    rm -rf stage
    run "$bin/spin-export" whole.spin --range $range --to usd -o stage
    step=$(case $range in 2:5) echo 1 ;; *) echo 2 ;; esac)
    grep -q "^    framesPerSecond = $((30 / step))\$" stage/clip.usda &&
        grep -q '^    timeCodesPerSecond = 30$' stage/clip.usda
    ok $? "$range: usd plays as fast as the whole clip"
done

done_testing
