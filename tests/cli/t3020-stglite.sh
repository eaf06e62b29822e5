#!/bin/sh
# K: 4d stglite export import
# 4D splats exported as a PLY for SuperSplat-4D and OpenSplat4D and imported again: lossless, for
# either viewer.
. tests/cli/lib.sh

exact() { # NAME
    is "$code $(python3 -c 'import json, sys
c = json.load(sys.stdin)["check"]
print(all(v["largest"] < 2e-4 for v in c.values() if isinstance(v, dict)), c["frames"])' <"$work/out")" "0 True $2" "$1"
}
header() { sed '/^end_header/q' "$1" | LC_ALL=C grep -a "$2"; }

for source in ftgs_ply/sh1_clamped/scene.ftgs.ply stglite/supersplat4d_sh1/scene.ply; do
    name=$(dirname "$source" | tr / -)
    run "$bin/spin-import" "fixtures/$source" -o "$work/$name.spin" --json
    frames=$(member frames)
    run "$bin/spin-export" "$work/$name.spin" -o "$work/$name.stg.ply" --check --json
    exact "$source: read back as it was" "$frames"
    is "$(member bytes)" "$(wc -c <"$work/$name.stg.ply")" "with its size"
    run "$bin/spin-import" "$work/$name.stg.ply" -o "$work/back.spin" --force --json
    is "$code $(member from) $(member frames)" "0 stglite $frames" "recognised, with as many frames"
    for dialect in supersplat4d opensplat4d; do
        run "$bin/spin-import" "$work/$name.stg.ply" --dialect $dialect -o "$work/$dialect.spin" --force
        is "$code" 0 "for $dialect"
    done
done
is "$(header "$work/stglite-supersplat4d_sh1.stg.ply" cfg_args)" \
    "comment cfg_args: start=0 duration=2 fps=30 sh_degree=1" "the comment that SuperSplat-4D reads"
# Both windows are equal: exp(-(d/s)^2) with s from trbf_scale, and exp(-d^2/2/s^2) with s from
# scale_t.
python3 - "$work/stglite-supersplat4d_sh1.stg.ply" <<'P'
import math, struct, sys
head, body = open(sys.argv[1], "rb").read().split(b"end_header\n", 1)
names = [l.split()[2].decode() for l in head.splitlines() if l.startswith(b"property float")]
size = 4 * len(names)
assert len(body) % size == 0 and len(names) == 30, names
for at in range(0, len(body), size):
    row = dict(zip(names, struct.unpack_from("<%df" % len(names), body, at)))
    assert row["t"] == row["trbf_center"]
    assert abs(math.exp(row["trbf_scale"]) / math.exp(row["scale_t"]) - math.sqrt(2)) < 1e-5
P
ok $? "both viewers have the same windows"

# What the format cannot store.
run "$bin/spin-import" fixtures/4dgs/birth_sh2/scene.4dgs -o "$work/cut.spin"
run "$bin/spin-export" "$work/cut.spin" -o "$work/cut.stg.ply"
fails 1 spin-export "splats that begin abruptly"
err_has "an STG-lite PLY stores Gaussian windows in time, which cannot represent splats that begin or end abruptly" \
    "are refused"
nothing_at "$work/cut.stg.ply" "nothing was written"
run "$bin/spin-import" fixtures/spacetimegs/full_techni -o "$work/cubic.spin"
run "$bin/spin-export" "$work/cubic.spin" -o "$work/cubic.stg.ply"
is "$code" 0 "paths of degree 3"
err_has "an STG-lite PLY cannot store paths of degree 3: they are approximated by degree 1" "are fitted"
done_testing
