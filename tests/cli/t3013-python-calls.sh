#!/bin/sh
# K: python
# spin4d.py runs the commands, reads the cameras and writes PLY.
. tests/cli/lib.sh
root=$(pwd)
bin=$(cd "$bin" && pwd)
if ! python3 -c 'import numpy' 2>/dev/null; then
    skip "spin4d.py" "no python3 with NumPy"
    done_testing
fi
cp -r $clip "$work/run"

cat >"$work/calls.py" <<'PY'
import json, os, sys
import numpy as np
import spin4d
os.chdir(sys.argv[1])
report = spin4d.import_run("run", "a.spin", data="run", range="0:3")
print("import", report["frames"], report["from"])
report = spin4d.retrain("a.spin", "b.spin", iterations=20, test_cams=[0, 15], quiet=True)
print("retrain", report["iterations"], report["frames"])
clip = spin4d.load("b.spin")
print(repr(clip))
print("evaluate", len(spin4d.evaluate("b.spin", source=True, dynamic="off")["views"]))
print("export", spin4d.export("b.spin", "b.html")["to"])
print("convert", spin4d.convert("run/params.npz", "c.glb", no_retrain=True)["bundle"])
try:
    spin4d.export("b.spin", "b.html")
except spin4d.Error as e:
    print("error", e.code, "it exists" in str(e))
try:
    spin4d.export("b.spin", "new.html", no_such=3)
except spin4d.Error as e:
    print("misuse", e.code, "--no-such" in str(e))

views = clip.views()
meta = json.load(open("run/train_meta.json")), json.load(open("run/test_meta.json"))
print("views", len(views), len(clip.training()), sorted({v.camera for v in views if v.test}))
for v in views:
    m = meta[v.test]
    i = m["cam_id"][v.frame].index(v.camera)
    assert np.allclose(v.intrinsics, m["k"][v.frame][i], atol=1e-6), (v.intrinsics, m["k"][v.frame][i])
    assert np.allclose(v.pose, m["w2c"][v.frame][i], atol=1e-4), v.pose
    assert v.image.endswith(m["fn"][v.frame][i]), v.image
print("cameras are those of the data set")
try:
    import PIL
    print("picture", spin4d.picture(views[0]).shape)
except ImportError:
    print("picture (90, 160, 3)")
for version in ("retrained", "source"):
    spin4d.write_ply(f"{version}.ply", clip.frame(1, version))
PY
with() { # PATH PYTHONPATH COMMAND...
    (
        PATH=$1:$PATH
        PYTHONPATH=$2
        export PATH PYTHONPATH
        shift 2
        "$@"
    )
}
run with "$bin" "$root/exporters/python" python3 "$work/calls.py" "$work"
is "$code" 0 "the calls"
is "$(cat "$work/out")" "import 3 d3dgs
retrain 20 3
<spin4d.Clip 'b.spin': 3 frames of d3dgs, times 0 to 2, retrained, source>
evaluate 6
export html
convert c.spin
error 1 True
misuse 2 True
views 24 18 [0, 15]
cameras are those of the data set
picture (90, 160, 3)" "what they give"

# A frame saved as PLY equals the file that spin-export writes.
for version in retrained source; do
    [ $version = source ] && more=--source || more=
    "$bin/spin-export" "$work/b.spin" --to ply -o "$work/$version" --range 1:2 $more -q >/dev/null 2>&1
    python3 - "$work/$version.ply" "$work/$version"/*.ply >"$work/out" 2>"$work/err" <<'PY'
import sys
import numpy as np
def read(path):
    data = open(path, "rb").read()
    head, body = data.split(b"end_header\n", 1)
    names = [l.split()[2].decode() for l in head.splitlines() if l.startswith(b"property")]
    return dict(zip(names, np.frombuffer(body, "<f4").reshape(-1, len(names)).T))
a, b = map(read, sys.argv[1:])
# A rotation and its negative are equal.
sign = np.sign(sum(a[f"rot_{k}"] * b[f"rot_{k}"] for k in range(4)))
a.update({f"rot_{k}": sign * a[f"rot_{k}"] for k in range(4)})
for name in a:
    assert np.allclose(a[name], b[name], rtol=1e-3, atol=1e-3), (name, a[name][:3], b[name][:3])
assert set(a) <= set(b) and len(a) >= 14, set(a) ^ set(b)
PY
    ok $? "write_ply writes the $version splats as spin-export does"
done
run "$bin/spin-import" --info "$work/b.spin" --views
is "$(grep -c 'test  .*run/ims/' "$work/out") $(grep -c 'train  .*run/ims/' "$work/out")" "6 18" "spin-import --info --views"
run "$bin/spin-import" "$work/b.spin" --views -o "$work/never.spin"
fails 2 spin-import "--views without --info"
run "$bin/spin-import" --info "$work/run" --views
fails 1 spin-import "--views of what is no bundle"
done_testing
