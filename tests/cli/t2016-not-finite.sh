#!/bin/sh
# K: finite
# Splats with nonfinite values are not drawn, and their number is reported once. Network weights
# with such values are refused.
. tests/cli/lib.sh
CC=${CC:-gcc}

# The example importer with nonfinite values in every attribute: 3 splats of frame 8 and 2 of frame
# 11. The infinities of the others can be drawn: an opacity of 1, a scale of 0.
{
    sed 's/^    return SPIN_OK;$/&@/' man/example-plugin/points-csv.c | awk '
        /^static spin_status csv_frame/ { here = 1 }
        here && /@$/ {
            print "    bool first = run->numbers[frame] == 8;"
            print "    if (first && out->quats) out->quats[1] = NAN;"
            print "    if (first && out->sh) out->sh[3 + 2] = INFINITY;"
            print "    if (first && out->logit_opacities) out->logit_opacities[2] = NAN;"
            print "    if (run->numbers[frame] == 11 && out->log_scales) out->log_scales[0] = NAN, out->log_scales[5] = INFINITY;"
            print "    if (out->logit_opacities) out->logit_opacities[3] = INFINITY;"
            print "    if (out->log_scales) out->log_scales[3 * 4] = -INFINITY;"
            here = 0
        }
        { sub(/@$/, ""); print }'
} >"$work/holes.c"
$CC -std=gnu11 -Isrc -fPIC -shared -w -o "$work/holes.so" "$work/holes.c"
ok $? "an importer with holes"
awk 'BEGIN {
    print "frame,x,y,z,red,green,blue"
    for (f = 8; f < 14; f++)
        for (i = 0; i < 30; i++)
            printf "%d,%g,%g,%g,200,%d,90\n", f, i % 5 / 5 - 0.5, int(i / 5) % 3 / 3 - 0.3, i / 30 - 0.5, 8 * i
}' >"$work/points.csv"
SPIN_PLUGIN_PATH="$work/holes.so" "$bin/spin-import" "$work/points.csv" --size 0.1 --data "$clip" -q \
    -o "$work/holes.spin" 2>"$work/err"
ok $? "a bundle with holes"
run env SPIN_PLUGIN_PATH="$work/holes.so" "$bin/spin-import" --info "$work/points.csv" --size 0.1
is "$(sed -n 's/ *\(sh.dc\|quats\|logit_opacities\|log_scales\) .*   \([0-9.e-]*\) % not finite$/\1 \2/p' "$work/out")" \
    "quats 0.139
log_scales 1.48
logit_opacities 3.89
sh.dc 0.185" "--info: the share of such values, of each attribute"
said="^warning: '$work/holes.spin': 5 splats in 2 of its frames have values that are not finite, and are not drawn"

run "$bin/spin-eval" "$work/holes.spin" --source --json --split all
is "$code" 0 "it is measured"
is "$(wc -l <"$work/err")" 1 "one line"
err_has "$said" "says how many splats are not drawn"
is "$(member left_out)" 5 "and so does the JSON"
run "$bin/spin-eval" "$work/holes.spin" --source --json --range 8:11
is "$(member left_out)" 3 "of the frames that were measured"
for to in images ply; do
    run "$bin/spin-export" "$work/holes.spin" --to $to -o "$work/$to" --json
    is "$code" 0 "it is exported to $to"
    ! grep -q 'are not drawn' "$work/err"
    ok $? "$to: says it by frames"
    is "$(member left_out)" "$(sed -n 's/^warning: frame [0-9]*: \([0-9]*\) of 30 splats left out.*/\1/p' "$work/err" |
        awk '{ n += $1 } END { print n }')" "$to: and in the JSON"
done
run "$bin/spin-retrain" "$work/holes.spin" -o "$work/net.spin" --preset paper --iterations 2 --batch 1 \
    --levels 2 --hash-log2 8 --hidden 16 --scale 0.5 --device cpu --precision full --preview "$work/preview"
is "$code" 0 "it is retrained"
is "$(grep -c "$said\|in [12] of its frames have values" "$work/err")" 1 "with one line about its source"
run "$bin/spin-eval" "$work/net.spin" --scale 0.5 --json
is "$code, $(wc -l <"$work/err"), $(member left_out)" "0, 0, 0" "the network has no holes"

command -v python3 >/dev/null || {
    skip "a table with a NaN" "no python3"
    done_testing
    exit
}
# spoil CLIP ARRAY: the first value becomes NaN, one byte of it in each of the four byte planes.
spoil() {
    python3 -c 'import sys, zipfile
with zipfile.ZipFile(sys.argv[1]) as z:
    members = {i.filename: z.read(i) for i in z.infolist()}
name = "trained/%s.npy" % sys.argv[2]
table = bytearray(members[name])
head = 10 + table[8] + 256 * table[9]
plane = (len(table) - head) // 4
table[head::plane] = b"\0\0\xc0\x7f"
members[name] = bytes(table)
with zipfile.ZipFile(sys.argv[1], "w", zipfile.ZIP_DEFLATED) as z:
    for name in members:
        z.writestr(name, members[name])' "$1" "$2"
}
cp "$work/net.spin" "$work/hole.spin"
spoil "$work/hole.spin" means/00000
run "$bin/spin-eval" "$work/hole.spin" --scale 0.5 --json --range 8:9
is "$code, $(member left_out)" "0, 1" "a splat without a position"
err_has "^warning: '$work/hole.spin': 1 splat in 1 of its frames has values that are not finite, and is not drawn" "is reported"
spoil "$work/net.spin" table
for command in "spin-eval $work/net.spin --scale 0.5" "spin-export $work/net.spin --to ply -o $work/bad"; do
    # shellcheck disable=SC2086
    run "$bin/"$command
    fails 1 "${command%% *}" "${command%% *} of a table with a NaN"
    err_has "array 'trained/table' has 1 values that are not finite" "${command%% *}: says so"
done
nothing_at "$work/bad" "nothing was exported"
done_testing
