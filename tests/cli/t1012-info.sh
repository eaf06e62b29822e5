#!/bin/sh
# K: d3dgs ply datasets info
# The output of --info, and the check of cameras against points.
. tests/cli/lib.sh

run "$bin/spin-import" --info "$clip"
is "$code" 0 "describes a run"
out_has "^from  *d3dgs, Dynamic 3D Gaussians" "the method and its variant"
out_has "^recognised  by the names" "how it was recognised"
out_has "^upstream  .*Dynamic3DGaussians" "whose files they are"
out_has "^static  *log_scales logit_opacities" "what does not change"
out_has "log_scales .*scales [0-9.e-]*, [0-9.e-]*, [0-9.e-]*$" "scales as logarithms and as they are"
out_has "all values are finite" "that all values are finite"
out_has "read  *6 of 6 frames" "and that every frame was read"
run "$bin/spin-import" --info --json --from d3dgs "$clip"
is_json "as JSON"
is "$(member frames_read)" 6 "frames that were read"
is "$(member recognised)" "named by --from" "what --from says needs no recognising"
tr -d ' \n' <"$work/out" | grep -q '"logit_opacities":{"min":[-0-9.e]*,"median":[-0-9.e]*,"max"'
ok $? "ranges by attribute"

# Forty frames of one point each, whose x is the frame number: 16 are sampled, 40 on request.
mkdir "$work/many"
for i in $(seq 0 39); do
    printf 'ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n' \
        >"$work/many/p$i.ply"
    printf 'end_header\n%d 0 0\n' "$i" >>"$work/many/p$i.ply"
done
run "$bin/spin-import" --info "$work/many"
out_has "16 of 40 frames, evenly" "a long clip is sampled, and it says so"
out_has "means.x  *0  *[0-9]*  *39$" "from its first frame to its last"
run "$bin/spin-import" --info --full "$work/many" --json
is "$(member frames_read)" 40 "--full reads all"

if [ ! -e "$(dirname "$bin")/lib/spin-image.so" ]; then
    skip "check-cameras" "built without images"
    done_testing
fi
run "$bin/spin-import" --check-cameras "$work/check" --data "$clip" "$clip" --json
is "$code" 0 "--check-cameras alone"
is_json "says what it saw as JSON"
is "$(grep -c '"file"' "$work/out")" 12 "four cameras of three frames"
is "$(find "$work/check" -name 'cam_*_frame_0000[025].png' | wc -l)" 12 "one picture each"
low=$(sed -n 's/^ *"inside": \([0-9.e-]*\),*/\1/p' "$work/out" | sort -g | head -n 1)
greater "$low" 0.6
ok $? "most points are inside every view: $low or more"
[ ! -s "$work/err" ]
ok $? "without a warning"
run "$bin/spin-import" --check-cameras "$work/check" --data "$clip" "$clip"
fails 1 spin-import "pictures that are there"
run "$bin/spin-import" --check-cameras "$work/check" --data "$clip" "$clip" --force --info
is "$code" 0 "are overwritten with --force"
out_has "^check  .*frame 5, camera [0-9]*: [0-9.]* % of the points in front, [0-9.]* % inside" \
    "a line for each"

# The same clip with cameras in OpenGL's axes, which therefore face the other way: rows y and z of
# w2c are negated.
if command -v python3 >/dev/null 2>&1; then
    mkdir "$work/wrong"
    ln -s "$PWD/$clip/ims" "$work/wrong/ims"
    for name in train_meta test_meta; do
        python3 -c '
import json, sys
meta = json.load(open(sys.argv[1]))
for row in meta["w2c"]:
    for m in row:
        m[1:3] = [[-x for x in r] for r in m[1:3]]
json.dump(meta, open(sys.argv[2], "w"))' "$clip/$name.json" "$work/wrong/$name.json"
    done
    # LeakSanitizer often crashes here (signal 11 while it reads the thread-local storage of a
    # library's threads), so leak detection is off.
    export LSAN_OPTIONS=use_tls=0:suppressions=tests/lsan.supp:print_suppressions=0
    run "$bin/spin-import" --check-cameras "$work/seen" --data "$work/wrong" "$clip" --json
    unset LSAN_OPTIONS
    is "$code" 0 "cameras with other axes"
    high=$(sed -n 's/^ *"inside": \([0-9.e-]*\),*/\1/p' "$work/out" | sort -g | tail -n 1)
    greater 0.2 "$high"
    ok $? "few points are inside: $high or less"
    err_has "check the axes" "and it is said"
else
    skip "cameras with other axes" "python3 is not here"
fi

run "$bin/spin-import" --check-cameras "$work/none" "$clip"
fails 2 spin-import "--check-cameras without a data set"
run "$bin/spin-import" --full "$clip" -o "$work/none.spin"
fails 2 spin-import "--full without --info"
nothing_at "$work/none" "nothing was written"
done_testing
