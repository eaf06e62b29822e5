#!/bin/sh
# K: still
# A static clip may store each column once: to all commands it equals the same clip with a copy for
# every frame.
. tests/cli/lib.sh
# On a busy machine LeakSanitizer sometimes crashes in a process that has opened a plug-in.
ASAN_OPTIONS=${ASAN_OPTIONS:-}:detect_leaks=0
export ASAN_OPTIONS
CC=${CC:-gcc}

# The example importer unchanged, and a variant that declares all columns static.
example=man/example-plugin/points-csv.c
sed 's/sequence->sh_degree = 0;/&\n    sequence->static_columns = sequence->columns;/' "$example" >"$work/still.c"
for name in plain still; do
    [ $name = plain ] && cp "$example" "$work/plain.c"
    $CC -std=gnu11 -Isrc -fPIC -shared -w -o "$work/$name.so" "$work/$name.c"
    ok $? "the importer $name builds"
done

# 60 points in the six frames of the bundled clip.
awk 'BEGIN {
    print "frame,x,y,z,red,green,blue"
    for (f = 8; f < 14; f++) {
        x = 7
        for (i = 0; i < 60; i++) {
            printf "%d", f
            for (c = 0; c < 6; c++) {
                x = (x * 1103 + 12345) % 65536
                printf c < 3 ? ",%.4f" : ",%d", c < 3 ? x / 32768 - 1 : x % 256
            }
            print ""
        }
    }
}' >"$work/points.csv"

# measured NAME: the report of the last spin-eval, without what depends on the file's size or the
# clock.
measured() { grep '"\(psnr\|ssim\|frame\|camera\)"' "$work/out" >"$work/$1"; }

for name in plain still; do
    mkdir "$work/$name"
    export SPIN_PLUGIN_PATH="$work/$name.so"
    for columns in whole positions; do
        option=
        [ $columns = positions ] && option=--positions-only
        run "$bin/spin-import" "$work/points.csv" --size 0.05 --data "$clip" --data-from panoptic $option \
            -o "$work/$name/$columns.spin" --json
        is "$code" 0 "$name: imports $columns"
        sed '/"static"/d; /"output"/d' "$work/out" >"$work/$name/$columns.import"
        run "$bin/spin-retrain" "$work/$name/$columns.spin" -o "$work/$name/$columns.net" --preset paper \
            --iterations 4 --batch 1 --levels 2 --hash-log2 8 --hidden 16 --scale 0.5 --device cpu
        is "$code" 0 "$name: retrains $columns"
        run "$bin/spin-eval" "$work/$name/$columns.net" --json --device cpu
        is "$code" 0 "$name: measures the network of $columns"
        measured "$name/$columns.network"
    done
    run "$bin/spin-eval" "$work/$name/whole.spin" --source --json --device cpu
    is "$code" 0 "$name: measures the source"
    measured "$name/source"
    run "$bin/spin-retrain" "$work/$name/whole.spin" -o "$work/$name/whole.own" --method frames \
        --refine 3 --refine-start source --scale 0.5 --device cpu
    is "$code" 0 "$name: refines every frame on its own"
    run "$bin/spin-eval" "$work/$name/whole.own" --json --device cpu
    measured "$name/explicit"
    for format in ply spz splat gltf compressed-ply images; do
        run "$bin/spin-export" "$work/$name/whole.spin" --to $format -o "$work/$name/to-$format"
        is "$code" 0 "$name: exports to $format"
    done
    run "$bin/spin-export" "$work/$name/whole.spin" --to gltf -o "$work/$name/clip.glb"
    is "$code" 0 "$name: exports a clip in one .glb"
    run "$bin/spin-export" "$work/$name/whole.spin" --to html -o "$work/$name/clip.html"
    is "$code" 0 "$name: exports a page"
    run "$bin/spin-export" "$work/$name/whole.net" --source --to ply -o "$work/$name/beside"
    is "$code" 0 "$name: exports the source beside the network"
    rm -f "$work/$name"/*.own "$work/$name"/*.net
done
unset SPIN_PLUGIN_PATH

is "$(member frames "$work/still/whole.import")" 6 "all frames are there"
[ "$(wc -c <"$work/still/whole.spin")" -lt "$(($(wc -c <"$work/plain/whole.spin") / 3))" ]
ok $? "columns that are the same are there once"
rm "$work/plain"/*.spin "$work/still"/*.spin
for what in whole.network positions.network source explicit; do
    [ -s "$work/still/$what" ]
    ok $? "something was measured: $what"
done
diff -r "$work/plain" "$work/still" >"$work/err" 2>&1
ok $? "measurements and exports are those of the same clip with a copy for every frame"

# An importer that declares columns static although counts differ between frames.
{
    grep -v '^13,' "$work/points.csv"
    grep '^13,' "$work/points.csv" | head -n 20
} >"$work/fewer.csv"
sed 's/sequence->sh_degree = 0;/&\n    sequence->static_columns = SPIN_COL_SH;/' "$example" >"$work/lying.c"
$CC -std=gnu11 -Isrc -fPIC -shared -w -o "$work/lying.so" "$work/lying.c"
SPIN_PLUGIN_PATH=$work/lying.so
export SPIN_PLUGIN_PATH
run "$bin/spin-import" "$work/fewer.csv" -o "$work/lying.spin"
fails 1 spin-import "a column that is the same in frames of 60 and 20 splats"
err_has "provides 20 splats in frame 5 but 60 in frame 0" "says so"
nothing_at "$work/lying.spin" "nothing was written"
done_testing
