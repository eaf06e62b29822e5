#!/bin/sh
# K: antialias bake export splat gltf retrain eval
# --bake-antialias: lower opacities for programs that draw without antialiasing.
. tests/cli/lib.sh

run "$bin/spin-import" fixtures/court-mini -o "$work/in.spin"
run "$bin/spin-retrain" "$work/in.spin" -o "$work/anti.spin" --data $clip --device cpu --method frames \
    --refine 60 --antialias on --precision full --range 0:2
is "$code" 0 "splats trained with antialiasing"
run "$bin/spin-eval" "$work/anti.spin" --json
psnr=$(member psnr)

# The PSNR of an export that a viewer without antialiasing draws.
plain_psnr() { # NAME OPTION...
    name=$1
    shift
    run "$bin/spin-export" "$work/anti.spin" --to splat -o "$work/$name" "$@"
    is "$code" 0 "exports $name"
    grep -h '^antialiasing baked\|^warning: these splats' "$work/err" >"$work/said"
    run "$bin/spin-import" "$work/$name" --data $clip --pair order -o "$work/$name.spin"
    run "$bin/spin-eval" "$work/$name.spin" --pair order --json
    lost=$(member psnr | awk -v with="$psnr" '{ d = with - $1; print d < 0 ? -d : d }')
}
plain_psnr marked
without=$lost
cost=$(sed -n "s/.*'splat' files do not tell viewers to use it; without antialiasing, .* have a PSNR of \([0-9.]*\) dB against .* bake it with --bake-antialias/\1/p" "$work/said")
plain_psnr baked --bake-antialias auto
awk -v a="$without" -v b="$lost" 'BEGIN { exit !(b < 0.7 * a) }'
ok $? "the image is nearer to the antialiased one: $lost dB off, $without dB without baking"
awk '{ after = before = 0
       for (i = 1; i < NF; i++) if ($(i + 1) ~ /^dB/) { if (!after) after = $i; else before = $i }
       exit !(after > before + 3) }' "$work/said"
ok $? "the loss is reported: $(cat "$work/said")"
awk -v cost="$cost" '{ for (i = 1; i < NF; i++) if ($(i + 1) ~ /^dB/) before = $i
                       exit !(cost > before - 3 && cost < before + 3) }' "$work/said"
ok $? "the export that does not bake reports about the same loss, $cost dB"
grep -q "for the size of the training's images: opacities are multiplied by 0\.[0-9]* on average" "$work/said"
ok $? "with the size and the mean factor"

# Small images need lower opacities, large ones hardly any change.
factor() { # SIZE [CLIP]
    run "$bin/spin-export" "$work/${2:-anti}.spin" --to ply -o "$work/size" --force --bake-antialias "$1"
    sed -n 's/.*opacities are multiplied by \([0-9.]*\) on average.*/\1/p' "$work/err"
}
small=$(factor 20x12) large=$(factor 8000x4500)
awk -v s="$small" -v l="$large" 'BEGIN { exit !(s < 0.7 && l > 0.97 && l <= 1) }'
ok $? "the factor depends on the size: $small for 20x12, $large for 8000x4500"
"$bin/spin-retrain" "$work/in.spin" -o "$work/half.spin" --data $clip --device cpu --method frames --refine 1 \
    --antialias on --range 0:1 --scale 0.5 -q >"$work/out" 2>&1
half=$(factor auto half)
[ -n "$half" ] && [ "$half" = "$(factor 80x45 half)" ] && [ "$half" != "$(factor 160x90 half)" ]
ok $? "by default on that of the images of the training, scaled as they were: $half"
factor 8000x4500 >"$work/large"
! LC_ALL=C grep -aq '^comment antialiased' "$work/size/frame_00000.ply"
ok $? "baked splats are not marked"

run "$bin/spin-export" "$work/anti.spin" --to gltf -o "$work/still.glb" --bake-antialias auto
is "$code" 0 "one file with a clip"
grep -q "trained with antialiasing" "$work/err"
is "$?" 1 "no warning about the mark"

# Files that keep the mark to themselves; 4D splats cannot be baked.
for output in still.glb frame.usdc frame.usda frames.4dgs frames.tsog; do
    run "$bin/spin-export" "$work/anti.spin" -o "$work/$output" --force
    err_has "without antialiasing, .* dB against antialiased ones: enable it in the viewer, or bake it" "$output: the loss"
done
LC_ALL=C sed '0,/^comment ftgs_version/s//comment antialiased 1\n&/' fixtures/ftgs_ply/sh1_clamped/scene.ftgs.ply \
    >"$work/rows.ftgs.ply"
run "$bin/spin-import" "$work/rows.ftgs.ply" -o "$work/rows.spin"
for output in x.ftgs.ply x.stg.ply x.sogst x.sogst.ply x.4dgs x.tsog; do
    run "$bin/spin-export" "$work/rows.spin" -o "$work/$output"
    err_has "but .* files do not tell viewers to use it: enable it in the viewer, or write frames .* --bake-antialias" \
        "$output: a warning, without cameras"
done

run "$bin/spin-export" "$work/anti.spin" -o "$work/no.ply" --bake-antialias big
fails 2 spin-export "a size that is none"
run "$bin/spin-export" "$work/anti.spin" -o "$work/no.html" --bake-antialias auto
fails 2 spin-export "a page, which draws with antialiasing"
cp "$work/marked/frame_00000.splat" "$work/one.splat"
run "$bin/spin-import" "$work/one.splat" -o "$work/one.spin"
run "$bin/spin-export" "$work/one.spin" -o "$work/no.ply" --bake-antialias auto
fails 1 spin-export "splats without the mark"
err_has "not trained with antialiasing" "says why"
nothing_at "$work/no.ply" "nothing was written"
done_testing
