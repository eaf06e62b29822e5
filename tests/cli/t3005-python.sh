#!/bin/sh
# K: python bundle numpy
# exporters/python/spin4d.py and the decoder in the manual read the output of spin-retrain as
# spin-export does: networks, tracks and refined frames, at every precision.
. tests/cli/lib.sh
if ! python3 -c 'import numpy' 2>/dev/null; then
    skip "bundles in Python" "no python3 with numpy"
    done_testing
    exit
fi
export PYTHONDONTWRITEBYTECODE=1 PYTHONPATH="$PWD/exporters/python"

in=$work/in.spin
run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$in" --range 0:3
is "$code" 0 "imports a clip"
cat >"$work/compare.py" <<'E'
import glob, sys
import numpy as np
import spin4d

def read(path):
    raw = open(path, "rb").read()
    end = raw.index(b"end_header\n") + 11
    names = [l.split()[2] for l in raw[:end].decode().splitlines() if l.startswith("property")]
    v = np.frombuffer(raw, "<f4", -1, end).reshape(-1, len(names))
    return lambda *some: np.stack([v[:, names.index(s)] for s in some], 1) if some else v[:, :0]

clip = spin4d.load(sys.argv[1])
version = sys.argv[3]
files = sorted(glob.glob(sys.argv[2] + "/*.ply"))
assert len(clip) == len(clip.times) == len(clip.numbers) == len(files) == 3, files
assert version in clip.versions, clip.versions
for i, path in enumerate(files):
    f, ply = clip.frame(i, version=version), read(path)
    quats = ply(*("rot_%d" % k for k in range(4)))
    quats = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    rest = f.sh.shape[1] - 1
    high = ply(*("f_rest_%d" % k for k in range(3 * rest)))
    for name, got, want in (
            ("means", f.means, ply("x", "y", "z")),
            ("quats", f.quats * np.sign((f.quats * quats).sum(1, keepdims=True)), quats),
            ("scales", np.log(f.scales), ply(*("scale_%d" % k for k in range(3)))),
            ("opacities", f.opacities, 1 / (1 + np.exp(-ply("opacity")[:, 0]))),
            ("base colour", f.sh[:, 0], ply(*("f_dc_%d" % k for k in range(3)))),
            ("sh", f.sh[:, 1:], high.reshape(len(high), 3, rest).transpose(0, 2, 1))):
        assert got.shape == want.shape, (name, got.shape, want.shape)
        assert got.dtype == np.float32 and np.allclose(got, want, rtol=1e-5, atol=1e-5), \
            (path, name, np.abs(got - want).max())
E

# same BUNDLE VERSION NAME [OPTION...]
same() {
    bundle=$1
    version=$2
    name=$3
    shift 3
    rm -rf "$work/ply"
    "$bin/spin-export" "$bundle" --to ply -o "$work/ply" -q "$@" 2>"$work/err"
    python3 "$work/compare.py" "$bundle" "$work/ply" "$version" 2>"$work/err"
    ok $? "$name: as spin-export has it"
}
same "$in" source "an imported bundle"
small='--scale 0.25 --test-cams 0 --device cpu -q'
net='--preset paper --levels 4 --hash-log2 12 --finest-resolution 64,64,64,16 --hidden 16 --lr-table 0.5 --warmup 0'
for precision in compact half full; do
    for kind in "tracks:retrained:--preset quick --iterations 40 --densify-every 10" \
        "network:retrained:$net --iterations 3" \
        "plain:retrained:$net --iterations 3 --activation relu --scene-normalise none --sh-degree 1 --residual source" \
        "both:retrained:$net --iterations 3 --tracks auto --learn-exposure on" \
        "frames:frames:--method frames --refine 5"; do
        name=${kind%%:*}
        options=${kind#*:}
        # shellcheck disable=SC2086
        run "$bin/spin-retrain" "$in" -o "$work/$precision-$name.spin" $small ${options#*:} --precision $precision
        is "$code" 0 "$precision, $name: retrains"
        same "$work/$precision-$name.spin" "${options%%:*}" "$precision, $name"
    done
done
same "$work/half-tracks.spin" source "the source beside it" --source

# Frames with unrelated positions: each has tracks of its own, and its splats are in their order.
mkdir "$work/apart"
for f in 0 1 2; do
    rm -rf "$work/one"
    "$bin/spin-export" "$in" --to ply -o "$work/one" --range $f:$((f + 1)) --translate 0.00$((f * 2)),0,0 -q &&
        cp "$work"/one/*.ply "$work/apart/"
done
"$bin/spin-import" "$work/apart" --from ply --data fixtures/court-mini --pair order -o "$work/apart.spin" -q 2>"$work/err"
# shellcheck disable=SC2086
# Point clouds: positions are rounded, colours are exact.
run "$bin/spin-retrain" "$work/apart.spin" -o "$work/own-tracks.spin" $small --iterations 40 --densify-every 10
is "$code" 0 "frames that share no place: retrains"
same "$work/own-tracks.spin" retrained "their tracks"
python3 -c '
import sys, spin4d
clip = spin4d.load(sys.argv[1])
rows = [clip.values("trained/track/%05d" % f).astype("i8") for f in range(3)]
assert all((r[1:] >= r[:-1]).all() and len(set(r)) > 2000 for r in rows)
assert rows[0].tobytes() != rows[1].tobytes()' "$work/own-tracks.spin" 2>"$work/err"
ok $? "in the order of the tracks"

# Of points the positions are rounded, and colours stay as they are.
mkdir "$work/points"
python3 -c '
import sys, numpy, spin4d
clip = spin4d.load(sys.argv[1])
for f in range(3):
    rows = "".join("%.6f %.6f %.6f %d %d %d\n" % (*p, f, i % 256, 77) for i, p in enumerate(clip.frame(f).means))
    head = "".join("property float %s\n" % c for c in "xyz") + "".join("property uchar %s\n" % c for c in ("red", "green", "blue"))
    open("%s/%d.ply" % (sys.argv[2], f), "w").write(
        "ply\nformat ascii 1.0\nelement vertex %d\n%send_header\n%s" % (rows.count("\n"), head, rows))' "$in" "$work/points"
"$bin/spin-import" "$work/points" --from ply --data fixtures/court-mini --pair order -o "$work/points.spin" -q 2>"$work/err"
# shellcheck disable=SC2086
run "$bin/spin-retrain" "$work/points.spin" -o "$work/coloured.spin" $small --iterations 5
is "$code" 0 "points: retrains"
python3 -c '
import sys, spin4d
a, b = (spin4d.load(path) for path in sys.argv[1:])
colours = [clip.values("source/rgb/00002") for clip in (a, b)]
assert len(colours[0]) > 2000 and colours[0].tobytes() == colours[1].tobytes()
places = [clip.values("source/means/00002") for clip in (a, b)]
off = abs(places[0] - places[1])
assert (places[1] % 2.0**-13 == 0).all() and 0 < off.max() <= 2.0**-14 + 2.0**-15, off.max()' \
    "$work/points.spin" "$work/coloured.spin" 2>"$work/err"
ok $? "their colours are those of the source, their positions nearly"
# shellcheck disable=SC2086
run "$bin/spin-retrain" "$work/points.spin" -o "$work/refined-points.spin" $small $net --iterations 1 --refine 2
python3 -c '
import sys, spin4d
a, b = (spin4d.load(path).values("source/means/00002") for path in sys.argv[1:])
assert a.tobytes() == b.tobytes()' "$work/points.spin" "$work/refined-points.spin" 2>"$work/err"
ok $? "which refined frames can be found again by"

# Positions far from the origin: absolute as doubles, or relative to the shift as floats; cameras
# follow.
mkdir "$work/far"
python3 -c '
import sys, numpy as np, spin4d
f = spin4d.load(sys.argv[1]).frame(0)
spin4d.write_ply(sys.argv[2], f._replace(means=f.means.astype(float) + [448262.5, 5411932, 120]))' "$in" "$work/far/0.ply"
run "$bin/spin-import" "$work/far/0.ply" -o "$work/far.spin"
is "$code" 0 "imports UTM coordinates"
python3 -c '
import sys, numpy as np, spin4d
near, far = (spin4d.load(path) for path in sys.argv[1:3])
a, b, c = near.frame(0), far.frame(0), far.frame(0, relative=True)
assert not near.shift.any() and a.means.dtype == c.means.dtype == np.float32 and b.means.dtype == np.float64
assert abs(far.shift - [448262.5, 5411932, 120]).max() < 10
def sort(m): return m[np.lexsort(np.round(m, 4).T)]
off = np.abs(sort(b.means - [448262.5, 5411932, 120]) - sort(a.means)).max()
assert off < 1e-5, off
assert np.array_equal(c.means + far.shift, b.means)
spin4d.write_ply(sys.argv[3], b)
assert b"property double x" in open(sys.argv[3], "rb").read(200)' "$in" "$work/far.spin" "$work/far/1.ply" 2>"$work/err"
ok $? "means are those of the source, and relative on request"
PATH="$bin:$PATH" python3 -c '
import sys, numpy as np, spin4d
clip = spin4d.load(sys.argv[1])
clip.shift = np.array([1e6, -2e5, 30])
point = np.array([.1, .2, .3])
for a, b in zip(clip.views(), clip.views(relative=True)):
    assert np.allclose(a.pose @ [*(point + clip.shift), 1], b.pose @ [*point, 1], atol=1e-6)
assert len(clip.training(relative=True)) == 18' "$in" 2>"$work/err"
ok $? "and so are the poses of the views"
run "$bin/spin-import" "$work/far/1.ply" -o "$work/far1.spin"
python3 -c '
import sys, numpy as np, spin4d
a, b = (spin4d.load(path).frame(0).means for path in sys.argv[1:])
assert np.array_equal(a, b)' "$work/far.spin" "$work/far1.spin" 2>"$work/err"
ok $? "write_ply() keeps their digits"

# 4D splats: slices equal those of spin-export, at the bundle's frames and between them.
for kind in rot4d_noshfs rot4d_sht; do
    [ -d "$fixtures/realtime4dgs/$kind" ] || continue
    "$bin/spin-import" "$fixtures/realtime4dgs/$kind" -o "$work/4d.spin" --range 0:60:20 -q --force
    same "$work/4d.spin" source "4D splats of $kind"
done
[ -e "$work/4d.spin" ] && python3 -c '
import sys, spin4d
clip = spin4d.load(sys.argv[1])
a, b, c = (clip.slice(t) for t in (clip.times[0], (clip.times[0] + clip.times[1]) / 2, clip.times[1]))
assert len(a.means) and len(b.means) and clip.frame(1).means.shape == c.means.shape
assert not (a.means.shape == b.means.shape and (a.means == b.means).all())' "$work/4d.spin"
ok $? "and at any time between"

# Bundles of version 3 give the same values as current ones.
cat >"$work/older.py" <<'E'
import json, sys, zipfile

with zipfile.ZipFile(sys.argv[1]) as now, zipfile.ZipFile(sys.argv[2], "w", zipfile.ZIP_DEFLATED) as then:
    meta = json.loads(now.read("meta.json"))
    trained = meta.pop("trained")
    meta.update(version=3, network={"explicit": True, **trained})
    if trained["field"]:
        meta["network"].update(trained["field"], explicit=False)
    del meta["network"]["field"]
    for key in "per_unit", "xor_rows":
        meta[key] = {k.replace("trained/", "network/"): v for k, v in meta.get(key, {}).items()}
    for name in now.namelist():
        then.writestr(name.replace("trained/", "network/"),
                      json.dumps(meta) if name == "meta.json" else now.read(name))
E
for kind in tracks network both; do
    python3 "$work/older.py" "$work/compact-$kind.spin" "$work/older.spin"
    rm -rf "$work/today"
    "$bin/spin-export" "$work/compact-$kind.spin" --to ply -o "$work/today" -q
    same "$work/older.spin" retrained "version 3, $kind"
    diff -r "$work/today" "$work/ply" >"$work/err" 2>&1
    ok $? "version 3, $kind: as the bundle of today"
    for file in older "compact-$kind"; do
        "$bin/spin-import" --info --json "$work/$file.spin" |
            sed '/"bytes": {/,/}/d; /"version"/d; /"file"/d; /"bundle"/d' >"$work/$file.info"
    done
    diff "$work/older.info" "$work/compact-$kind.info" >"$work/err" 2>&1
    ok $? "version 3, $kind: described as the bundle of today"
done
rm "$work/older.spin"

# The example of the manual is the complete decoder that it claims to be.
python3 - "$work/full-tracks.spin" "$work/half-tracks.spin" "$work/compact-tracks.spin" man/spin-bundle.5 \
    "$work/half-both.spin" "$work/compact-frames.spin" <<'E' 2>"$work/err"
import json, re, sys
import numpy
import spin4d

text = re.search(r"\ndef words.*?(?=\n\.Ed)", open(sys.argv[4]).read(), re.S).group(0)
scope = {"numpy": numpy}
exec(text, scope)
full, half, compact = (spin4d.load(path) for path in sys.argv[1:4])
for path in sys.argv[5], sys.argv[1], sys.argv[3]:
    clip, zipped = spin4d.load(path), numpy.load(path)
    meta = json.loads(zipped["meta.json"])
    for name in set(zipped.files) - {"meta.json"}:
        a, b = scope["values"](zipped, meta, name), clip.values(name)
        assert a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes(), name
assert list(meta["per_unit"]) == ["trained/means", "trained/residual", "trained/tracks"], meta
for name in "means/00000", "residual/00000", "tracks":
    assert zipped["trained/" + name].dtype == numpy.int8, name
frames = spin4d.load(sys.argv[6])
for name in "means", "quats", "log_scales", "logit_opacities", "sh":
    assert frames.meta["per_unit"]["refined/" + name][0] >= 32, name
for name, step in ("quats", 1 / 64), ("log_scales", 1 / 32), ("logit_opacities", 1 / 32), ("sh", 1 / 128):
    assert numpy.load(sys.argv[6])["refined/" + name + "/00001"].dtype == numpy.int8, name
    assert numpy.all(frames.values("refined/" + name + "/00001") % step == 0), name
zipped = numpy.load(sys.argv[1])
meta = json.loads(zipped["meta.json"])
assert any(sum(rows) > 0 for rows in meta["xor_rows"].values())
for name in zipped.files:
    if name == "meta.json":
        continue
    b, small = full.values(name), compact.values(name)
    rounded = half.values(name)
    if name.startswith("source/") or name.startswith("trained/track/"):
        assert rounded.tobytes() == b.tobytes() == small.tobytes(), name
        continue
    if "means" in name:
        bound, step = numpy.maximum(numpy.abs(b) * 2.0**-16, 2.0**-14), numpy.full(3, 2.0**-13)
    else:
        bound = numpy.maximum(numpy.abs(b) * 2.0**-11, 2.0**-11)
        step = numpy.array([1 / 32] * 3 + [1 / 64] * 4 + [1 / 128] * 3 + [1 / 32])
    assert numpy.all(numpy.abs(b - rounded) <= bound), name
    own, small, bound = (a[:, -len(step):] for a in (b, small, bound))
    assert numpy.all(small % step == 0) and numpy.all(numpy.abs(own - small) <= bound + 0.5 * step), name
    assert b.size == 0 or rounded.tobytes() != b.tobytes(), name
E
ok $? "the manual's decoder; half and compact within their bounds, the source to the bit"

# Test views of a data set that lacks the held-out cameras.
python3 - "$work/compact-tracks.spin" "$work/other-rig.spin" <<'E'
import json, sys, zipfile

with zipfile.ZipFile(sys.argv[1]) as now, zipfile.ZipFile(sys.argv[2], "w") as then:
    for name in now.namelist():
        text = now.read(name)
        then.writestr(name, json.dumps({**json.loads(text), "held_out": [0, 99]}) if name == "meta.json" else text)
E
run "$bin/spin-eval" "$work/other-rig.spin" --device cpu
is "$code" 0 "held-out cameras that the data set lacks: measures"
err_has "lacks cameras that the training held out: using the test views of the data set instead" "and says on which views"

# ---- What the class refuses

python3 - "$work/half-tracks.spin" "$in" "$clip/params.npz" "$work" \
    "$work/half-both.spin" <<'E' 2>"$work/err"
import json, sys, zipfile
import numpy as np
import spin4d

def fails(word, call, *args, **more):
    try:
        call(*args, **more)
    except (ValueError, IndexError) as e:
        assert word in str(e), e
    else:
        raise AssertionError(word)

clip = spin4d.load(sys.argv[1])
fails("no frame 3", clip.frame, 3)
fails("frames", clip.frame, 0, version="frames")
fails("no array", clip.values, "network/none")
fails("not a bundle", spin4d.load, sys.argv[3])
assert np.array_equal(clip.frame(-1).means, clip.frame(2).means) and clip.antialias()
colours = spin4d.load(sys.argv[5]).cameras
assert len(colours) == 7 and all(len(c["log_gain"]) == 3 == len(c["offset"]) for c in colours), colours
assert clip.cameras == [] and not spin4d.load(sys.argv[2]).antialias()
with zipfile.ZipFile(sys.argv[1]) as z:
    members = {n: z.read(n) for n in z.namelist()}
meta = json.loads(members["meta.json"])
meta["xor_rows"]["source/means"][1] = 10**6
members["meta.json"] = json.dumps(meta).encode()
path = sys.argv[4] + "/lie.spin"
with zipfile.ZipFile(path, "w") as z:
    for name, data in members.items():
        z.writestr(name, data)
fails("source/means/00001", spin4d.load(path).frame, 1, version="source")
try:
    import torch
except ImportError:
    sys.exit(0)
assert isinstance(clip.frame(0, torch=True).sh, torch.Tensor)
E
ok $? "frames and arrays that are not there"
run "$bin/spin-export" "$work/lie.spin" --source --to ply -o "$work/lie"
fails 1 spin-export "more rows of differences than there are"
err_has "lie.spin.*source/means/00001" "names file and array"
rm "$work/lie.spin"

# ---- The manual describes every key of meta.json and every array, and no others

# shellcheck disable=SC2086
run "$bin/spin-retrain" "$in" -o "$work/refined.spin" $small $net --iterations 2 --refine 2
is "$code" 0 "a network on refined frames"
run "$bin/spin-import" --from d3dgs $clip --data $clip --pair order -o "$work/paired.spin" --range 0:1
is "$code" 0 "a pairing of its own"
# shellcheck disable=SC2086
run "$bin/spin-retrain" "$work/full-tracks.spin" -o "$work/learned-4d.spin" --preset quick $small --method 4d --iterations 2
is "$code" 0 "4D splats that were trained"
"$bin/spin-retrain" --help all | sed -n 's/^  \(-., \|    \)--\([a-z0-9-]*\).*/\2/p' | tr - _ >"$work/options"
python3 - man/spin-bundle.5 "$work/options" "$work"/*.spin <<'E' 2>"$work/err"
import json, re, sys, zipfile

page = open(sys.argv[1]).read()
arrays = {re.sub("/<index>.npy$|.npy$", "", a) for a in
          re.findall(r"(?:trained|source|refined)/[a-z<>_/]+[.]npy", page)}
part = page[page.index(".Ss meta.json"):page.index(".Sh SECURITY")]
words = lambda lines: {word for line in lines for word in re.findall("[a-z_0-9]+", line)}
named = words(re.findall(r"^[.](?:It )?(?:Va|Ql|Li|Cm) (.*)", part, re.M))
listed = words(re.findall(r"^[.]It Va (.*)", part, re.M))
options = set(open(sys.argv[2]).read().split())
seen = set()

def walk(value, inside):
    for item in value if isinstance(value, list) else []:
        walk(item, inside)
    for key, item in value.items() if isinstance(value, dict) else []:
        seen.add(key)
        assert key in named or (inside == "options" and key in options), (key, inside)
        assert key == "key" or not isinstance(item, str) or not re.fullmatch("-?[0-9.]+", item), (key, item)
        if key not in ("xor_rows", "per_unit"):
            walk(item, "options" if "options" in (key, inside) else key)

for path in sys.argv[3:]:
    with zipfile.ZipFile(path) as z:
        walk(json.loads(z.read("meta.json")), "")
        for name in z.namelist():
            series = re.sub("(/[0-9]{5})?[.]npy$", "", name)
            series = re.sub("^(source|refined)/.*", r"\1/<column>", series)
            assert name == "meta.json" or series in arrays, (name, series, arrays)
# No bundle of this test has these: those with a sound track are tested in t3023.
optional = {"fps", "absolute", "cov2d", "shift", "up", "sound", "name", "type", "bytes", "gain"}
assert listed <= seen | optional, listed - seen
E
ok $? "keys and arrays are those of the manual"
done_testing
