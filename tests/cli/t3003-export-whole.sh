#!/bin/sh
# K: export ply gltf glb splat compressed-ply spz sog html images video
# shellcheck disable=SC2046 # to_of gives several words
# spin-export writes complete outputs or none: --check, bad values, a full disk, Ctrl-C.
. tests/cli/lib.sh

run_of=$fixtures/d3dgs/trained
if [ ! -d "$run_of" ]; then
    skip "export" "no fixtures at $run_of"
    done_testing
fi
in=$work/in.spin
run "$bin/spin-import" "$run_of" -o "$in" --range 0:4 --json
is "$code" 0 "imports the run"
frames=$(member frames)
formats='gltf:glb ply:ply splat:splat compressed-ply:compressed.ply spz:spz spz3:spz'
if ldconfig -p 2>/dev/null | grep -q 'libwebp\.so\.7'; then
    formats="$formats sog:sog"
else
    skip "sog" "no libwebp"
fi

# to_of NAME: the exporter of that name, with its options.
to_of() {
    case $1 in
    spz3) echo "spz --spz-version 3" ;;
    *) echo "$1" ;;
    esac
}

# ---- Read back -----------------------------------------------------------------------------------

# checked NAME LEAST: the last --check --json found every frame, and its images reach LEAST dB.
checked() {
    is "$(sed -n '/"check"/,$ s/^    "frames": \([0-9]*\),*$/\1/p' "$work/out")" "$frames" \
        "$1: every frame was read back"
    psnr=$(sed -n 's/^    "psnr": \([0-9.a-z]*\),*$/\1/p' "$work/out")
    [ "$psnr" = null ] || greater "$psnr" "$2"
    ok $? "$1: a frame rendered from its file is the bundle's ($psnr dB)"
}

for pair in $formats; do
    to=${pair%%:*}
    limit=30
    case $to in ply | gltf) limit=90 ;; esac
    run "$bin/spin-export" "$in" --to $(to_of "$to") -o "$work/$to" --check --json
    is "$code" 0 "$to: --check"
    is_json "$to: --check --json is one document"
    checked "$to" "$limit"
    [ -s "$work/$to/sequence.json" ] && grep -q '"frame": 3' "$work/$to/sequence.json"
    ok $? "$to: sequence.json names the frames"
done
run "$bin/spin-export" "$in" --to gltf -o "$work/clip.glb" --check --json
checked "one GLB" 90
run "$bin/spin-export" "$in" --to gltf -o "$work/apart.glb" --still-apart --check --json
checked "one GLB, what stands apart" 90
run "$bin/spin-export" "$in" --to ply -o "$work/turned" --up -y --rotate 10,20,30 --check --json
checked "turned" 80
run "$bin/spin-export" "$in" --to spz -o "$work/rub" --axes rub --check --json
checked "spz, turned" 30
run "$bin/spin-export" "$in" --to ply -o "$work/up" --up z
head -c 400 "$work/up/frame_00000.ply" | grep -q '^comment Vertical axis: y'
ok $? "--up is written into a PLY"
run "$bin/spin-export" "$in" --to ply -o "$work/never" --up w
fails 2 spin-export "an axis that is none"
if [ -d "$fixtures/datasets/panoptic_mini" ]; then
    run "$bin/spin-export" "$in" --to images --data "$fixtures/datasets/panoptic_mini" -o "$work/never" --check
    fails 2 spin-export "images cannot be checked"
fi

run "$bin/spin-export" "$in" --to usd -o "$work/never" --check
fails 2 spin-export "usd cannot be checked"

# ---- Bad values ----------------------------------------------------------------------------------

{
    printf 'ply\nformat ascii 1.0\nelement vertex 12\n'
    for name in x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3; do
        echo "property float $name"
    done
    echo end_header
    awk 'BEGIN { for (i = 0; i < 12; i++) print i, i % 3, i % 2, "0 0 0 1",
        i == 4 ? 9 : -3, "-3", i == 5 ? 60 : -3, "1 0 0 0" }'
} >"$work/bad.ply"
run "$bin/spin-import" "$work/bad.ply" -o "$work/bad.spin"
is "$code" 0 "imports splats that cannot be drawn"
for pair in $formats; do
    to=${pair%%:*}
    run "$bin/spin-export" "$work/bad.spin" --to $(to_of "$to") -o "$work/bad-$to" --check --json
    is "$(member left_out)" 2 "$to: two splats are left out"
    err_has "2 of 12 splats left out: 2 larger than the scene" "$to: and it says why"
    is "$(sed -n '/"check"/,$ s/^    "splats": \([0-9]*\),*$/\1/p' "$work/out")" 10 "$to: ten are there"
done
run "$bin/spin-export" "$work/bad.spin" --to ply -o "$work/large" --max-scale 0 --json
is "$(member left_out)" 1 "--max-scale 0 lets a large one through"
run "$bin/spin-export" "$work/bad.spin" --to html -o "$work/bad.html" --json
is "$(member left_out)" 2 "html: two splats are left out"
err_has "2 of 12 splats left out: 2 larger than the scene" "html: and it says why"
run "$bin/spin-export" "$in" --to html -o "$work/some.html" --every 3 --json
is "$(member frames)" 2 "html: every third of four frames is two"
is "$(member bytes)" "$(wc -c <"$work/some.html")" "html: says how large the page is"

# ---- Full disk -----------------------------------------------------------------------------------

# nothing_half FOLDER NAME: no incomplete file under its final name, and no temporary file.
nothing_half() {
    is "$(find "$1" -type f 2>/dev/null | wc -l)" 0 "$2: nothing is left"
}

for pair in $formats; do
    to=${pair%%:*}
    (ulimit -f 16 && exec "$bin/spin-export" -q "$in" --to $(to_of "$to") -o "$work/full-$to" \
        >"$work/out" 2>"$work/err")
    code=$?
    fails 1 spin-export "$to: a limit on files"
    nothing_half "$work/full-$to" "$to: a limit on files"
done
(ulimit -f 16 && exec "$bin/spin-export" -q "$in" --to gltf -o "$work/full.glb" \
    >"$work/out" 2>"$work/err")
code=$?
fails 1 spin-export "one GLB: a limit on files"
nothing_at "$work/full.glb" "one GLB: a limit on files"

# Formats that render need a clip with cameras; the images circle the scene.
run "$bin/spin-import" "$clip" --data "$clip" -o "$work/seen.spin"
is "$code" 0 "imports a clip with cameras"
around='--path orbit --repeat 100 --size 160x90'
videos=
if "$bin/spin-export" -q "$work/seen.spin" --to video -o "$work/try.mp4" 2>"$work/err"; then
    videos='mp4 webm'
else
    skip "videos" "$(cat "$work/err")"
fi

# whole_images FOLDER NAME: every file in the folder is a complete PNG.
whole_images() {
    printf 'IEND\256B`\202' >"$work/iend"
    bad=0
    for file in $(find "$1" -type f ! -name sequence.json 2>/dev/null); do
        tail -c 8 "$file" | cmp -s - "$work/iend" || bad=1
    done
    is "$bad" 0 "$2: every picture there is whole"
    is "$(find "$1" -type f ! -name '*.png' ! -name sequence.json 2>/dev/null | wc -l)" 0 "$2: nothing else is there"
}

# draw TO OUT [LIMIT]: images or a video of the clip with cameras, with a limit on file sizes.
draw() {
    # shellcheck disable=SC2086
    (ulimit -f "${3:-unlimited}" && exec "$bin/spin-export" -q "$work/seen.spin" --to "$1" $around \
        -o "$2" >"$work/out" 2>"$work/err")
    code=$?
}

draw images "$work/full-images" 1
fails 1 spin-export "images: a limit on files"
nothing_half "$work/full-images" "images: a limit on files"
for end in $videos; do
    draw video "$work/full.$end" 16
    fails 1 spin-export "$end: a limit on files"
    nothing_at "$work/full.$end" "$end: a limit on files"
done
(ulimit -f 16 && exec "$bin/spin-export" -q "$in" --to usd -o "$work/full-usd" \
    >"$work/out" 2>"$work/err")
code=$?
fails 1 spin-export "usd: a limit on files"
nothing_half "$work/full-usd" "usd: a limit on files"
(ulimit -f 16 && exec "$bin/spin-export" -q "$in" --to html -o "$work/full.html" \
    >"$work/out" 2>"$work/err")
code=$?
fails 1 spin-export "html: a limit on files"
nothing_at "$work/full.html" "html: a limit on files"

# Outputs of two files, or with two checks: space for the smaller part only.
both='html:split.html:--split gltf:apart.glb:--still-apart'
for one in $both; do
    name=${one%:*}
    name=${name#*:}
    (ulimit -f 50 && exec "$bin/spin-export" -q "$in" --to "${one%%:*}" "${one##*:}" -o "$work/full-$name" \
        >"$work/out" 2>"$work/err")
    code=$?
    fails 1 spin-export "$name: a limit on files"
    nothing_at "$work/full-${name%.*}" "$name: a limit on files"
done

mkdir "$work/small"
if [ "$(id -u)" = 0 ] && mount -t tmpfs -o size=16k tmpfs "$work/small" 2>/dev/null; then
    trap 'umount "$work/small"; rm -rf "$work"' EXIT
    for pair in $formats; do
        to=${pair%%:*}
        run "$bin/spin-export" -q "$in" --to $(to_of "$to") -o "$work/small/$to"
        is "$code" 1 "$to: a full disk: exit code 1"
        case $to in spz* | sog) ;; *) err_has "has only .* free" "$to: a full disk: warns before" ;; esac
        err_has "^spin-export: .*No space left" "$to: a full disk: says so"
        nothing_half "$work/small/$to" "$to: a full disk"
        rm -rf "$work/small/${to:?}"
    done
    # For several frames only an upper bound of the size is known, so a single one is written.
    run "$bin/spin-export" -q "$in" --to gltf --range 0:1 -o "$work/small/clip.glb"
    is "$code" 1 "one GLB: a full disk: exit code 1"
    err_has "has only .* free" "one GLB: a full disk: warns before"
    exporter=$(cd "$bin" && pwd)/spin-export
    run sh -c 'cd "$1/small" && exec "$2" -q "$1/in.spin" --to gltf --range 0:1 -o ../beside.glb' sh "$work" "$exporter"
    is "$code" 0 "one GLB: only the working folder is full"
    is "$(cat "$work/err")" "" "one GLB: and there is no warning"
    nothing_at "$work/small/clip.glb" "one GLB: a full disk"
    run "$bin/spin-export" -q "$in" --to usd -o "$work/small/usd"
    is "$code" 1 "usd: a full disk: exit code 1"
    err_has "^spin-export: .*No space left" "usd: a full disk: says so"
    nothing_half "$work/small/usd" "usd: a full disk"
    rm -rf "$work/small/usd"
    run "$bin/spin-export" -q "$in" --to html -o "$work/small/clip.html"
    is "$code" 1 "html: a full disk: exit code 1"
    err_has "^spin-export: .*No space left" "html: a full disk: says so"
    nothing_at "$work/small/clip.html" "html: a full disk"
    for one in $both; do
        name=${one%:*}
        name=${name#*:}
        run "$bin/spin-export" -q "$in" --to "${one%%:*}" "${one##*:}" -o "$work/small/$name"
        is "$code" 1 "$name: a full disk: exit code 1"
        err_has "^spin-export: .*No space left" "$name: a full disk: says so"
        nothing_at "$work/small/${name%.*}" "$name: a full disk"
    done
    draw images "$work/small/images"
    is "$code" 1 "images: a full disk: exit code 1"
    err_has "^spin-export: .*No space left" "images: a full disk: says so"
    whole_images "$work/small/images" "images: a full disk"
    rm -rf "$work/small/images"
    for end in $videos; do
        draw video "$work/small/clip.$end"
        is "$code" 1 "$end: a full disk: exit code 1"
        err_has "^spin-export: .*No space left" "$end: a full disk: says so"
        nothing_at "$work/small/clip.$end" "$end: a full disk"
    done
else
    skip "a full disk" "not root, or no tmpfs can be mounted"
fi

# ---- Ctrl-C --------------------------------------------------------------------------------------

# A clip long enough to be interrupted: one frame, many times.
mkdir "$work/many"
i=100
while [ $i -lt 400 ]; do
    ln "$work/up/frame_00000.ply" "$work/many/f_$i.ply"
    i=$((i + 1))
done
run "$bin/spin-import" "$work/many" -o "$work/many.spin"
is "$code" 0 "imports a long clip"
for pair in $formats; do
    to=${pair%%:*}
    end=${pair#*:}
    "$bin/spin-export" -q "$work/many.spin" --to $(to_of "$to") -o "$work/stop-$to" 2>"$work/err" &
    pid=$!
    while kill -0 $pid 2>/dev/null && ! ls "$work/stop-$to"/*."$end" >/dev/null 2>&1; do :; done
    kill -INT $pid 2>/dev/null
    wait $pid
    code=$?
    if [ "$code" = 0 ]; then
        skip "$to: Ctrl-C" "it was done before"
        continue
    fi
    is "$code" 130 "$to: Ctrl-C: exit code 130"
    is "$(find "$work/stop-$to" -name '*.tmp.*' | wc -l)" 0 "$to: Ctrl-C: nothing half-written"
done
"$bin/spin-export" -q "$work/many.spin" --to gltf -o "$work/stop.glb" 2>"$work/err" &
pid=$!
while kill -0 $pid 2>/dev/null && ! ls "$work"/stop.glb* >/dev/null 2>&1; do :; done
kill -INT $pid 2>/dev/null
wait $pid
code=$?
if [ "$code" = 0 ]; then
    skip "one GLB: Ctrl-C" "it was done before"
else
    is "$code" 130 "one GLB: Ctrl-C: exit code 130"
    nothing_at "$work/stop.glb" "one GLB: Ctrl-C leaves none"
fi
is "$(find "$work" -name 'stop.glb.tmp*' | wc -l)" 0 "one GLB: Ctrl-C: nothing half-written"

# stopped COMMAND...: starts it, waits for the first file at $1, and sends Ctrl-C.
stopped() {
    place=$1
    shift
    "$@" >"$work/out" 2>"$work/err" &
    pid=$!
    while kill -0 $pid 2>/dev/null && [ -z "$(find "$work" -path "$place*" -type f)" ]; do :; done
    kill -INT $pid 2>/dev/null
    wait $pid
    code=$?
}

# shellcheck disable=SC2086
stopped "$work/stop-images" "$bin/spin-export" -q "$work/seen.spin" --to images $around \
    -o "$work/stop-images"
is "$code" 130 "images: Ctrl-C: exit code 130"
whole_images "$work/stop-images" "images: Ctrl-C"
for end in $videos; do
    # shellcheck disable=SC2086
    stopped "$work/stop.$end" "$bin/spin-export" -q "$work/seen.spin" --to video $around \
        -o "$work/stop.$end"
    is "$code" 130 "$end: Ctrl-C: exit code 130"
    nothing_at "$work/stop.$end" "$end: Ctrl-C"
done
stopped "$work/stop.html" "$bin/spin-export" -q "$work/many.spin" --to html -o "$work/stop.html"
is "$code" 130 "html: Ctrl-C: exit code 130"
nothing_at "$work/stop.html" "html: Ctrl-C"

done_testing
