#!/bin/sh
# K: bundle cameras data set gone cameras.json first view
# A bundle keeps the cameras of its data set, or of the cameras.json of its run: when the data set
# is gone, pages, images and video use them as if it were there.
. tests/cli/lib.sh
cp -r "$clip" "$work/data"
run "$bin/spin-import" "$work/data" --data "$work/data" -o "$work/a.spin"
"$bin/spin-retrain" "$work/a.spin" -o "$work/b.spin" --method frames --refine 1 -q >/dev/null 2>&1
small="--size 80x60 --range 0:2"
# export_to FOLDER: pages and images of both bundles
export_to() {
    mkdir "$work/$1"
    for b in a b; do
        "$bin/spin-export" "$work/$b.spin" -o "$work/$1/$b.html" -q
        "$bin/spin-export" "$work/$b.spin" -o "$work/$1/$b-3.html" --camera 3 -q
        # shellcheck disable=SC2086
        "$bin/spin-export" "$work/$b.spin" --to images $small -o "$work/$1/$b" -q
        # shellcheck disable=SC2086
        "$bin/spin-export" "$work/$b.spin" --to images $small --camera 3 -o "$work/$1/$b-3" -q
    done 2>"$work/err"
}
export_to with
mv "$work/data" "$work/gone"
export_to without
is "$(cat "$work/err")" "" "nothing is warned of"
for name in a.html b.html a-3.html b-3.html a b a-3 b-3; do
    [ -e "$work/with/$name" ] && diff -r "$work/with/$name" "$work/without/$name" >/dev/null
    ok $? "$name: the same with the data set and without"
done
cmp -s "$work/with/a.html" "$work/with/a-3.html"
is $? 1 "--camera is another view"
run "$bin/spin-export" "$work/a.spin" -o "$work/said.html"
err_has "^'.*a.spin': the data set '.*data' does not exist: using the cameras that the bundle keeps\$" "it is said"
run "$bin/spin-export" "$work/a.spin" -o "$work/never.html" --camera 77
is "$code" 1 "a camera that there is not"
run "$bin/spin-export" "$work/a.spin" --to images -o "$work/never" --panels truth
is "$code" 2 "images of a data set that is gone"
run "$bin/spin-export" "$work/a.spin" --to ply -o "$work/never" --min-views 2
is "$code" 2 "--min-views of a data set that is gone"
run "$bin/spin-eval" "$work/b.spin"
fails 1 spin-eval "an evaluation needs the images"
err_has "the data set '.*data' does not exist, and its images are needed: give the data set with --data\$" "says what to give"
run "$bin/spin-eval" "$work/b.spin" --data "$work/gone"
is "$code" 0 "an evaluation on the data set at its new place"
run "$bin/spin-export" "$work/a.spin" --to ply -o "$work/checked" --check -q
is "$code" 0 "--check renders from a camera that was kept"

# ---- cameras.json beside a run -------------------------------------------------------------------

run_of=$work/run/point_cloud/iteration_7
mkdir -p "$run_of"
"$bin/spin-export" "$work/a.spin" --to ply -o "$work/plain" --range 0:1 -q
cp "$work/plain/frame_00000.ply" "$run_of/point_cloud.ply"
cameras() { # PYTHON: edits the cameras of frame 0, which are listed twice, and writes them
    python3 - "$work/gone/train_meta.json" "$work/run/cameras.json" "$1" <<'PY'
import json, sys
import numpy as np
meta = json.load(open(sys.argv[1]))
out = []
for k, w in zip(meta["k"][0], meta["w2c"][0]):
    c2w = np.linalg.inv(np.array(w))
    out.append({"id": len(out), "img_name": "x", "width": meta["w"], "height": meta["h"],
                "position": c2w[:3, 3].tolist(), "rotation": c2w[:3, :3].tolist(),
                "fx": k[0][0], "fy": k[1][1]})
out += out
exec(sys.argv[3])
json.dump(out, open(sys.argv[2], "w"))
PY
}
page() { # NAME
    run "$bin/spin-import" "$work/run" -o "$work/$1.spin" -v --force
    cp "$work/err" "$work/$1.err"
    run "$bin/spin-export" "$work/$1.spin" -o "$work/$1.html" --force
}
eye() { grep -o '"eye": *\[[^]]*\]' "$work/$1.html" | head -n 1; }
page bare
is "$code" 0 "a run without cameras.json"
cameras ""
page own
is "$code" 0 "a run with cameras.json"
grep -q "keeping the 6 different cameras of '.*run/cameras.json'" "$work/own.err"
ok $? "keeps each of its cameras once"
[ -n "$(eye own)" ] && [ "$(eye own)" != "$(eye bare)" ]
ok $? "and the page opens elsewhere"
run "$bin/spin-export" "$work/own.spin" --camera 3 -o "$work/three.html"
python3 - "$(eye three)" "$work/run/cameras.json" <<'PY'
import json, sys
eye = json.loads("{" + sys.argv[1] + "}")["eye"]
place = json.load(open(sys.argv[2]))[3]["position"]
sys.exit(max(abs(a - b) for a, b in zip(eye, place)) > 1e-5)
PY
ok $? "--camera 3 is the fourth of them"
for edit in 'out = {"cameras": out}' 'out[1]["rotation"][0][0] = 7' 'out[1]["position"] = [1, 2]' 'out[1]["fx"] = 0' \
    'out[1]["width"] = 0' 'out = []'; do
    cameras "$edit"
    page other
    is "$code $(eye other)" "0 $(eye bare)" "$edit: as without"
done
done_testing
