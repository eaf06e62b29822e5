#!/bin/sh
# K: first view page html up axis blender dnerf subject cameras
# The view that a page opens with: upright, and with the subject in its middle, in wide and in
# narrow windows.
. tests/cli/lib.sh
. tests/runs.sh

page_up() { grep -o '"up": *\[[^]]*\]' "$1" | head -n 1 | sed 's/.*\[//; s/\]//; s/ //g'; }

# ---- The up axis of a run without a data set -----------------------------------------------------

cp -r fixtures/deformable3dgs/real_small/model "$work/model"
chmod -R u+w "$work/model"
up_of() { # CFG_ARGS [OPTION...]: imports the run, exports a page and prints its up vector
    echo "Namespace($1)" >"$work/model/cfg_args"
    shift
    "$bin/spin-import" "$work/model" --from deformable3dgs --frames 2 -q --force -o "$work/up.spin" >/dev/null 2>&1
    "$bin/spin-export" "$work/up.spin" --force -q -o "$work/up.html" "$@" 2>/dev/null
    page_up "$work/up.html"
}
for cfg in "is_blender=True, source_path='/data/mine'" "source_path='/data/D-NeRF/mine', is_blender=False" \
    "source_path='data/standup/'" "source_path='C:\\\\data\\\\jumpingjacks'" "configs='arguments/dnerf/mine.py'" \
    "model_path='output/dnerf/mine', source_path='x'" "source_path='/data/nerf_synthetic/chair'"; do
    is "$(up_of "$cfg")" "0,0,1" "$cfg: z points up"
done
for cfg in "source_path='/data/mydnerf/mine'" "source_path='/data/mine', is_blender=False" "source_path='/data/mutant/mine'" \
    "source_path=''" "sh_degree=3"; do
    is "$(up_of "$cfg")" "0,-1,0" "$cfg: unknown, so -y points up"
done
is "$(up_of "is_blender=True" --up y)" "0,1,0" "--up wins"
run "$bin/spin-import" --info "$work/up.spin"
is "$code" 0 "a bundle with an up vector"
cat >"$work/edit.py" <<'PY'
import json, sys, zipfile
old, new, text = sys.argv[1:]
with zipfile.ZipFile(old) as a, zipfile.ZipFile(new, "w") as b:
    for entry in a.infolist():
        data = a.read(entry)
        if entry.filename == "meta.json":
            meta = json.loads(data)
            meta["up"] = json.loads(text)
            data = json.dumps(meta)
        b.writestr(entry, data)
PY
for up in '[0, 0, 2]' '[0, 1]' '"z"'; do
    python3 "$work/edit.py" "$work/up.spin" "$work/bad.spin" "$up"
    run "$bin/spin-import" --info "$work/bad.spin"
    fails 1 spin-import "up: $up"
    err_has "'up'" "is named"
done
python3 "$work/edit.py" "$work/up.spin" "$work/x.spin" '[1, 0, 0]'
"$bin/spin-export" "$work/x.spin" -q -o "$work/x.html" 2>/dev/null
is "$(page_up "$work/x.html")" "1,0,0" "any axis can be that of the bundle"
python3 - "$work/model/cameras.json" <<'PY'
import json, sys
json.dump([{"id": 0, "img_name": "x", "width": 160, "height": 90, "position": [0, 0, -4],
            "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "fx": 100, "fy": 100}], open(sys.argv[1], "w"))
PY
is "$(up_of "is_blender=True")" "0,-1,0" "cameras.json wins"
is "$(up_of "is_blender=True" --up x)" "1,0,0" "and --up wins over it"

# ---- The subject ---------------------------------------------------------------------------------

# in_the_middle NAME LEAST: of the windows that first_view.py lists, each has the median in its
# middle half and at least this share of the dynamic splats inside; narrow windows only need the
# median inside, and a share of 0.5, if `narrow` is set.
in_the_middle() {
    python3 tests/cli/first_view.py "$work/page.html" "$work/clip.spin" >"$work/shown"
    is "$(wc -l <"$work/shown")" 3 "$1: three windows"
    while read -r window x y share _; do
        half=0.5 least=$2
        [ "$window $3" = "390x844 narrow" ] && half=0.9 least=0.5
        awk -v x="$x" -v y="$y" -v s="$share" -v h=$half -v l="$least" \
            'BEGIN { exit !(x < h && x > -h && y < h && y > -h && s >= l) }'
        ok $? "$1: $window: median at $x $y, $share inside"
    done <"$work/shown"
}
"$bin/spin-import" "$clip" --data "$clip" -q -o "$work/clip.spin"
"$bin/spin-export" "$work/clip.spin" -q -o "$work/page.html"
in_the_middle "with a data set" 0.9
"$bin/spin-import" "$clip" -q --force -o "$work/clip.spin"
"$bin/spin-export" "$work/clip.spin" -q --force -o "$work/page.html" 2>/dev/null
in_the_middle "without a data set" 0.9
for importer in 4dgaussian d3dgs dash deformable3dgs ed3dgs grid4d scgs shapeofmotion; do
    path=fixtures/$(run_of $importer)
    "$bin/spin4d" "$path" --no-retrain -q --force -o "$work/clip.html" >/dev/null 2>&1
    mv "$work/clip.html" "$work/page.html"
    in_the_middle "$importer" 0.7 narrow
done

# A still: the camera whose image shows the point at which all cameras look.
"$bin/spin-import" "$clip" --data "$clip" --range 0:1 -q --force -o "$work/clip.spin"
"$bin/spin-export" "$work/clip.spin" -q --force -o "$work/page.html"
grep -q '"keep":' "$work/page.html"
ok $? "a still has a subject that narrow windows keep"
done_testing
