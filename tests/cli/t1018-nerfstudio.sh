#!/bin/sh
# K: nerfstudio transforms colmap import
# dataparser_transforms.json: nerfstudio's centring and scaling are undone for a data set, compared
# with splats that nerfstudio.py transformed itself.
. tests/cli/lib.sh

python3 tests/cli/nerfstudio.py make "$work/n"
ok $? "splats in three worlds are written"
splat=$work/n/run/exports/splat.ply

export_ply() { # NAME
    "$bin/spin-export" "$work/$1.spin" --to ply -o "$work/$1" -q --force
    find "$work/$1" -name '*.ply'
}
run "$bin/spin-import" "$work/n/original.ply" -o "$work/original.spin"
run "$bin/spin-import" "$work/n/saved.ply" -o "$work/saved.spin"
for kind in colmap:original transforms:saved; do
    set=${kind%:*}
    run "$bin/spin-import" "$splat" --data "$work/n/$set" -o "$work/$set.spin"
    is "$code" 0 "$set: a run of nerfstudio is imported"
    out_has "moved to the world of the data set: nerfstudio's centring and scale of .*run/dataparser_transforms.json') are undone" \
        "$set: this is said"
    python3 tests/cli/nerfstudio.py compare "$(export_ply "$set")" "$(export_ply "${kind#*:}")"
    ok $? "$set: the splats are in the world of its cameras"
done

# 4D splats move as their frames do: rows that are exported and read again have the same bounds.
rows=fixtures/ftgs_ply/sh1_clamped/scene.ftgs.ply
cp $rows "$work/n/run/exports/rows.ftgs.ply"
lowest() { "$bin/spin-import" "$1" --data "$work/n/colmap" -o "$work/rows.spin" --force 2>&1 | sed -n 's/^bounds *\[[^,]*, \([^]]*\).*/\1/p'; }
placed=$(lowest "$work/n/run/exports/rows.ftgs.ply")
run "$bin/spin-export" "$work/rows.spin" --to ftgs -o "$work/placed.ftgs.ply"
is "$code $(lowest "$work/placed.ftgs.ply")" "0 $placed" "4D splats are moved"
[ "$placed" != "$(lowest $rows)" ]
ok $? "from where they were"
rm "$work/n/run/exports/rows.ftgs.ply"

# Without a data set, the splats keep their coordinates.
run "$bin/spin-import" "$splat" -o "$work/alone.spin"
out_has "nerfstudio centred and scaled the scene .*give the data set with --data" "without cameras, a note"
cp -r "$work/n/run/exports" "$work/plain"
run "$bin/spin-import" "$work/plain/splat.ply" -o "$work/bare.spin"
is "$(grep -c nerfstudio "$work/out")" 0 "no note without the file"
python3 tests/cli/nerfstudio.py compare "$(export_ply alone)" "$(export_ply bare)"
ok $? "and nothing moves"

# The file may be in the folder of the data set.
cp "$work/n/run/dataparser_transforms.json" "$work/n/colmap"
run "$bin/spin-import" "$work/plain/splat.ply" --data "$work/n/colmap" -o "$work/beside.spin"
python3 tests/cli/nerfstudio.py compare "$(export_ply beside)" "$(export_ply original)"
ok $? "the file is found in the data set"

# A bundle exported beside the file is already in the world of the data set.
run "$bin/spin-export" "$work/colmap.spin" --to ply -o "$work/n/run/again"
run "$bin/spin-import" "$work/n/run/again" --data "$work/n/colmap" -o "$work/again.spin"
is "$(grep -c "are undone" "$work/out")" 0 "exported frames are not moved again"

echo '{"transform": [[2,0,0,0],[0,2,0,0],[0,0,2,0]], "scale": 1}' >"$work/n/run/dataparser_transforms.json"
run "$bin/spin-import" "$splat" --data "$work/n/transforms" -o "$work/none.spin"
fails 1 spin-import "a transform that is no rotation"
err_has "run/dataparser_transforms.json': 'transform' is not a rotation with a shift" "names the file"
done_testing
