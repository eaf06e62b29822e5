#!/bin/sh
# K: deformable3dgs import
# Networks of Deformable 3D Gaussians with other widths and depths, compared with values that
# deform.py computes.
. tests/cli/lib.sh

python3 tests/cli/deform.py make "$work/d"
ok $? "the models are written"
for name in narrow shallow deep wide coarse; do
    run "$bin/spin-import" "$work/d/$name" --from deformable3dgs --times 0,0.375,1 -o "$work/$name.spin"
    is "$code" 0 "$name: is imported"
    "$bin/spin-export" "$work/$name.spin" --to ply -o "$work/$name" -q
    rm -f "$work/$name/sequence.json"
    python3 tests/cli/deform.py compare "$work/d" "$name" "$work/$name"
    ok $? "$name: positions and covariances are those that Python computes"
done
done_testing
