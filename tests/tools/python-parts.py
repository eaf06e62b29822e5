#!/usr/bin/env python3
"""Checks exporters/python/spin4d.py on bundles made here, against an implementation of
man/spin-bundle.5 as loops over single numbers. Prints TAP.

Usage: PYTHONPATH=exporters/python python-parts.py WORKING_FOLDER"""
import io
import json
import math
import os
import sys
import types
import warnings
import zipfile

import numpy as np

import spin4d

work, count, failed = sys.argv[1], 0, 0
rng = np.random.default_rng(5)
warnings.simplefilter("error")


def ok(good, name, why=""):
    global count, failed
    count += 1
    failed += not good
    print(f"{'' if good else 'not '}ok {count} - {name}" + ("" if good or why == "" else f"\n#   {why}"), flush=True)


def same(got, want, name, within=0.0):
    got, want = np.asarray(got), np.asarray(want)
    ok(got.shape == want.shape and bool(np.all(np.abs(got - want) <= within)), name, f"got {got}, want {want}")


def fails(words, name, call, *args, **more):
    try:
        call(*args, **more)
    except (ValueError, IndexError) as e:
        ok(all(w in str(e) for w in words) and "\n" not in str(e), name, str(e))
    except Exception as e:  # noqa: BLE001: anything else is what is tested for
        ok(False, name, repr(e))
    else:
        ok(False, name, "it does not")


def write(name, meta, arrays, folder=""):
    """A bundle of these arrays; meta adds to the keys that every bundle has."""
    whole = {"format": "spin bundle", "version": 1, "columns": ["means"], "static_columns": [], "sh_degree": -1,
             "frames": [{"number": 8 + 2 * i, "time": 0.5 + 0.25 * i, "n": 0} for i in range(3)], "data": None, **meta}
    path = os.path.join(work, folder, name + ".spin")
    with zipfile.ZipFile(path, "w") as z:
        z.writestr("meta.json", json.dumps(whole))
        for key, array in arrays.items():
            f = io.BytesIO()
            np.save(f, array)
            z.writestr(key + ".npy", f.getvalue())
    return path


def random(*shape):
    return rng.normal(size=shape).astype(np.float32)


def series(name, arrays):
    return {f"{name}/{i:05d}": a for i, a in enumerate(arrays)}


# ---- Splats of frames: ranges, clamps, static columns --------------------------------------------

FULL = ["means", "quats", "log_scales", "logit_opacities", "sh"]


def splats(n, k=4):
    return dict(zip(FULL, (random(n, 3), random(n, 4), random(n, 3), random(n), random(n, k, 3))))


frames = [splats(n) for n in (5, 4, 6)]
frames[1]["log_scales"][:2] = [[19.5, 25, -200], [88, 1e30, -1e30]]
frames[1]["logit_opacities"][:] = [1000, -1000, 90, -90]
frames[1]["quats"][2] = 0
frames[1]["quats"][3] = [0, 0, 1e-20, 0]
arrays = {}
for column in FULL:
    arrays.update(series("source/" + column, [f[column] for f in frames]))
clip = spin4d.load(write("source", {"columns": FULL, "sh_degree": 1}, arrays))
same(clip.times, [0.5, 0.75, 1.0], "times are those of the frames")
ok((len(clip), clip.numbers, clip.versions, clip.data, clip.cameras) == (3, [8, 10, 12], ["source"], None, []), "numbers, versions, no data set")
rows = spin4d.load(write("rows", {"columns": FULL, "sh_degree": 1, "trained_4d": {"cameras": [{"camera": 3}]}}, arrays))
ok((rows.versions, rows.cameras) == (["source"], [{"camera": 3}]), "colours of cameras that 4D splats were trained with")
for i, f in enumerate(frames):
    got = clip.frame(i)
    same(got.means, f["means"], f"frame {i}: positions")
    length = [max(math.sqrt(sum(float(v) ** 2 for v in q)), 1e-12) for q in f["quats"]]
    same(got.quats, [[float(v) / n for v in q] for q, n in zip(f["quats"], length)], "rotations of unit length, or none", 1e-6)
    same(np.log(np.maximum(got.scales, 1e-37)), [[max(min(float(v), 20), math.log(1e-37)) for v in s] for s in f["log_scales"]], "scales, to e^20", 2e-4)
    same(got.opacities, [1 / (1 + math.exp(-max(-700.0, float(v)))) for v in f["logit_opacities"]], "opacities, also of large logits", 1e-6)
    same(got.sh, f["sh"], "colours")
    ok(all(a.dtype == np.float32 for a in got) and len(got.means) == len(f["means"]), "in single precision")
for i in range(-3, 3):
    same(clip.frame(i).means, frames[i]["means"], f"frame {i}")
for i in (3, -4, 99):
    fails([f"no frame {i}", "only 3", "source.spin"], f"no frame {i}", clip.frame, i)
fails(["no retrained", "source"], "no version that is not there", clip.frame, 0, version="retrained")
fails(["no array 'source/means/00003'"], "no array that is not there", clip.values, "source/means/00003")
kept = splats(4)
arrays = {"source/" + c: kept[c] for c in ("quats", "log_scales", "means", "sh")}
arrays.update(series("source/logit_opacities", [random(4) for _ in range(3)]))
still = spin4d.load(write("still", {"columns": FULL, "static_columns": ["quats", "log_scales", "means", "sh"], "sh_degree": 1}, arrays))
first = still.frame(0)
for a in first:
    a += 1
same(still.frame(0).means, kept["means"], "a static column is not the caller's to change")
same(still.frame(2).sh, kept["sh"], "nor for other frames")
same(still.frame(2).opacities, 0.5 + 0.5 * np.tanh(0.5 * arrays["source/logit_opacities/00002"]), "beside one that is not static", 1e-6)
fake = types.ModuleType("torch")
fake.from_numpy = lambda a: ("tensor", a)
sys.modules["torch"] = fake
tensors = still.frame(1, torch=True)
ok(type(tensors) is spin4d.Frame and all(t[0] == "tensor" and t[1].flags.writeable for t in tensors), "as tensors, which may be written")
del sys.modules["torch"]
points = spin4d.load(write("points", {"columns": ["means", "rgb"]}, series("source/means", [random(2, 3)] * 3)))
ok(points.versions == [], "points are no splats")
fails(["no splats"], "and have no frame", points.frame, 0)

# ---- Invalid bundles -----------------------------------------------------------------------------

for name, meta in ("version", {"version": 6}), ("format", {"format": "spin"}), ("none", {"version": None}):
    fails(["not a bundle of version 1 to 5", name], f"another {name}", spin4d.load, write(name, meta, {}))
for version in 1, 2, 3, 4, 5:
    ok(len(spin4d.load(write(f"v{version}", {"version": version}, {}))) == 3, f"version {version}")
np.savez(os.path.join(work, "other.npz"), a=np.zeros(3))
np.save(os.path.join(work, "array.npy"), np.zeros(3))
for name in "other.npz", "array.npy":
    fails(["not a bundle of spin4d", name], name, spin4d.load, os.path.join(work, name))
with open(os.path.join(work, "text.spin"), "w") as f:
    f.write("some words, and not a zip archive")
fails(["not a bundle of spin4d"], "a text", spin4d.load, os.path.join(work, "text.spin"))

# ---- The data set's folder -----------------------------------------------------------------------

os.makedirs(os.path.join(work, "below"), exist_ok=True)
for given, want in ("../data/court", os.path.join(work, "below", "../data/court")), ("/data/court", "/data/court"):
    path = write("data", {"data": {"path": given, "from": "d3dgs"}}, {}, "below")
    ok(spin4d.load(path).data == want, f"the data set at {given} is beside the bundle", spin4d.load(path).data)
path = write("data", {"data": {"path": "../no/court", "absolute": work, "from": "d3dgs"}}, {}, "below")
ok(spin4d.load(path).data == work, "the data set of a bundle that was moved alone", spin4d.load(path).data)
path = write("data", {"data": {"path": "/data/court", "from": "d3dgs"}}, {}, "below")
os.chdir(os.path.join(work, "below"))
ok(spin4d.load("data.spin").data == "/data/court", "a bundle in the working folder")

# ---- Refined frames, versions, antialiasing ------------------------------------------------------

refined = [splats(n, 1) for n in (3, 2, 4)]
refined[0]["log_scales"][0, 0] = 40
arrays = {}
for column in FULL:
    arrays.update(series("refined/" + column, [f[column] for f in refined]))
    arrays.update(series("source/" + column, [f[column] for f in frames]))
part = {"columns": FULL, "sh_degree": 0, "antialias": True}
arrays["source/sh"] = frames[2]["sh"]
both = spin4d.load(write("both", {"columns": FULL, "static_columns": ["sh"], "sh_degree": 1, "refined": part}, arrays))
ok(both.versions == ["frames", "source"], "frames that were optimised come first")
same(both.frame(2).means, refined[2]["means"], "and are what is given when nothing is said")
same(both.frame(2, version="source").means, frames[2]["means"], "the source beside them")
same(both.frame(2).sh, refined[2]["sh"], "a column that is static in the source is not in them")
same(both.frame(0).scales[0, 0], np.exp(np.float32(20)), "their scales, to e^20", 1e3)
ok((both.antialias(), both.antialias("frames"), both.antialias("source")) == (True, True, False), "what is to be drawn antialiased")
some = {"columns": FULL, "sh_degree": 1, "antialias": True, "refined": {"columns": ["means", "rgb"], "antialias": False}}
start = spin4d.load(write("start", some, {k: v for k, v in arrays.items() if k.startswith("source/")}))
ok(start.versions == ["source"] and start.antialias() is True, "refined points are no version")
fails(["no frames"], "of them there is no frame", start.frame, 0, version="frames")
fails(["no retrained"], "nor is there a network", start.antialias, "retrained")

# ---- Packed arrays -------------------------------------------------------------------------------


def planes(words, n=4):
    return np.stack([(words >> np.uint32(8 * k)).astype(np.uint8) for k in range(n)])


def columns_last(a):
    return np.moveaxis(a.view(np.int8), 1, -1)


value = [random(6, 3), random(5, 3), random(4, 3)]
word = [v.view(np.uint32) for v in value]
apart = word[1].copy()
apart[:4] ^= word[0][:4]
meta = {"version": 3, "xor_rows": {"source/means": [0, 4, 0], "source/sh": [0, 2, 0]}, "per_unit": {"source/sh": [32, 256, 8], "trained/tracks": [4, 2]}}
for kind in "unsigned", "signed":
    to = planes if kind == "unsigned" else lambda w: columns_last(planes(w))
    packed = spin4d.load(write("packed-" + kind, meta, series("source/means", [to(word[0]), to(apart), to(word[2])])))
    for i in 2, 1, 0, 1:
        got = packed.values(f"source/means/{i:05d}")
        ok(got.dtype == np.float32 and got.tobytes() == value[i].tobytes(), f"{kind} planes, frame {i}")
whole = [np.array([[0, 1, -1], [2, -2, 70000], [-70000, 127, -128]]), np.array([[5, 6, 7], [-8, 9, 10]])]
# The codes 0, 1, 2, 3, 4 stand for 0, -1, 1, -2, 2.
folded = [np.where(w < 0, -2 * w - 1, 2 * w).astype(np.uint32) for w in whole]
change = folded[1] ^ folded[0][:2]
units = np.array([32, 256, 8], np.float32)
counts = {**series("source/sh", [columns_last(planes(folded[0], 3)), columns_last(planes(change, 3)), columns_last(planes(folded[0][:0], 1))]),
          "trained/tracks": columns_last(planes(np.array([[3, 8]], np.uint32), 1)),
          "source/quats/00000": columns_last(planes(folded[0], 3)), "trained/track/00000": planes(np.array([0, 7, 2**32 - 1], np.uint32))}
counted = spin4d.load(write("counted", meta, counts))
for i in 0, 1:
    same(counted.values(f"source/sh/{i:05d}"), (whole[i] / units).astype(np.float32), f"whole numbers of units, frame {i}")
ok(counted.values("source/sh/00002").shape == (0, 3), "of no rows")
same(counted.values("trained/tracks"), [[-2 / 4, 4 / 2]], "an array that is no series has units, too")
same(counted.values("source/quats/00000").view(np.uint32), folded[0], "bytes without units are bits")
track = counted.values("trained/track/00000")
ok(track.dtype.kind == "u" and list(track) == [0, 7, 2**32 - 1], "tracks are numbers, not floats")
for name, array, more in (
        ("five planes", np.zeros((5, 3, 2), np.int8), {}), ("no planes", np.zeros((0, 3, 2), np.int8), {}), ("one axis", np.zeros(4, np.int8), {}),
        ("three unsigned planes", np.zeros((3, 3, 2), np.uint8), {})):
    fails(["source/means/00000", "one to four planes"], name, spin4d.load(write("bad", {**meta, **more}, {"source/means/00000": array})).values, "source/means/00000")
for name, per in ("units of other columns", [1, 2]), ("units of zero", [1, 0, 1]), ("units below zero", [1, -1, 1]), ("units that are no number", [1, float("nan"), 1]):
    path = write("bad", {**meta, "per_unit": {"source/sh": per}}, {"source/sh/00000": counts["source/sh/00000"]})
    fails(["source/sh", "does not match"], name, spin4d.load(path).values, "source/sh/00000")
for name, rows, key in ("more rows of differences than rows", 6, word[0]), ("than rows of the first frame", 5, word[0][:4]), ("of other columns", 2, word[0][:, :2].copy()):
    path = write("bad", {**meta, "xor_rows": {"source/means": [0, rows, 0]}}, series("source/means", [planes(key), planes(apart)]))
    fails(["source/means/00001", f"{rows} rows of differences"], name, spin4d.load(path).values, "source/means/00001")

# ---- Tracks --------------------------------------------------------------------------------------

NONE = 0xFFFFFFFF


def tracked(same_rows, residual=True):
    """The rows of a frame, as in the manual: a splat's own row if it has one, plus that of its
    track if it has one."""
    of, moving, varying = random(5, 14), 3, 2
    number = [np.array([0, NONE, 4, 2, 3, NONE, 1, 0], np.uint32)] * 3 if same_rows else [
        np.array(t, np.uint32) for t in ([NONE, 0, 1, 2, 3, 4], [4, 3, NONE, 1], [1, 1, 0, NONE, NONE])]
    arrays, want = {"trained/tracks": of}, []
    arrays.update({"trained/track/00000": number[0]} if same_rows else series("trained/track", number))
    for i, track in enumerate(number):
        means, rest, rows = [], [], []
        for t in track:
            row = np.zeros(14)
            if t == NONE or t < moving:
                means.append(random(3))
                row[:3] += means[-1]
            if residual and (t == NONE or t < varying):
                rest.append(random(11))
                row[3:] += rest[-1]
            rows.append(row + (0 if t == NONE else of[t]))
        arrays[f"trained/means/{i:05d}"] = np.array(means, np.float32).reshape(-1, 3)
        if residual:
            arrays[f"trained/residual/{i:05d}"] = np.array(rest, np.float32).reshape(-1, 11)
        want.append(np.array(rows))
    return {"n": 5, "moving": moving, "varying": varying, "same_rows": same_rows}, arrays, want


def expect(got, rows, name):
    same(got.means, rows[:, :3], f"{name}: positions", 1e-6)
    same(np.log(got.scales), np.minimum(rows[:, 3:6], 20), "scales", 1e-5)
    same(got.quats, rows[:, 6:10] / np.linalg.norm(rows[:, 6:10], axis=1, keepdims=True), "rotations", 1e-6)
    same(got.sh, rows[:, None, 10:13], "colours", 1e-6)
    same(got.opacities, 1 / (1 + np.exp(-rows[:, 13])), "opacities", 1e-6)


for same_rows in True, False:
    tracks, arrays, want = tracked(same_rows)
    trained = {"field": None, "sh_degree": 0, "tracks": tracks, "antialias": True, "cameras": [{"camera": 3}]}
    clip = spin4d.load(write("tracks", {"trained": trained}, arrays))
    ok((clip.versions, clip.antialias(), clip.cameras) == (["retrained"], True, [{"camera": 3}]), "tracks are a version")
    for i in 2, 0, 1:
        expect(clip.frame(i), want[i], f"tracks with {'the same' if same_rows else 'other'} rows, frame {i}")
    clip.frame(0).means[:] = 9
    same(clip.frame(0).means, want[0][:, :3], "a frame is not the caller's to change", 1e-6)
free = random(4, 14)
arrays = {**series("trained/means", [free[:, :3].copy()] * 3), **series("trained/residual", [free[:, 3:].copy()] * 3)}
expect(spin4d.load(write("free", {"trained": {"field": None, "sh_degree": 0}}, arrays)).frame(1), free, "without tracks")
tracks, arrays, want = tracked(False)
trained = {"field": None, "sh_degree": 0, "tracks": tracks}
for name, words, key, array in (
        ("a track that is not there", ["frame 1", "tracks that do not exist"], "trained/track/00001", np.array([5, 3, NONE, 1], np.uint32)),
        ("a position too few", ["trained/means/00001", "(1, 3)", "(2, 3)"], "trained/means/00001", arrays["trained/means/00001"][:1]),
        ("a position too many", ["trained/means/00001", "(4, 3)"], "trained/means/00001", random(4, 3)),
        ("values of another width", ["trained/residual/00001", "(2, 10)"], "trained/residual/00001", random(2, 10))):
    fails(words + ["bad.spin"], name, spin4d.load(write("bad", {"trained": trained}, {**arrays, key: array})).frame, 1)
del arrays["trained/residual/00001"]
fails(["trained/residual/00001", "(0, 11)"], "values that are not there", spin4d.load(write("bad", {"trained": trained}, arrays)).frame, 1)

# ---- The network ---------------------------------------------------------------------------------


def grid(net, table, x):
    """Features at one point of the unit cube."""
    out = []
    for level in range(net["levels"]):
        first, end = net["offset"][level:level + 2]
        position = [np.float32(a) * np.float32(b) for a, b in zip(x, net["scale"][level])]
        cell, z = [int(p) for p in position], np.zeros(net["features"])
        for corner in range(16):
            q, weight = [], 1.0
            for axis in range(4):
                r, side = float(position[axis]) - cell[axis], corner >> axis & 1
                w = 3 * r * r - 2 * r * r * r
                weight *= w if side else 1 - w
                q.append(cell[axis] + side)
            if net["hashed"][level]:
                row = 0
                for a, prime in zip(q, (1, 2654435761, 805459861, 3674653429)):
                    row ^= a * prime & 0xFFFFFFFF
            else:
                res = net["res"][level]
                row = q[0] + res[0] * (q[1] + res[1] * (q[2] + res[2] * q[3]))
            z += weight * table[first + row % (end - first)]
        out.extend(z)
    return np.array(out)


def point(net, p, time):
    norm = net["norm"]
    p = [(float(a) - c) * norm["inv_radius"] for a, c in zip(p, norm["centre"])]
    if not norm.get("raw"):
        r = math.sqrt(sum(a * a for a in p))
        p = [((2 - 1 / r) / r * a if r > 1 else a) / 4 + 0.5 for a in p]
    span = net["time_last"] - net["time_first"]
    t = (time - net["time_first"]) / span if span > 0 else 0
    return p + [min(max(t, 0), 1)]


def head(net, weights, z, n_out, at):
    for layer, n in enumerate((net["hidden"], net["hidden"], n_out)):
        w = weights[at:at + n * len(z)].reshape(n, len(z)).astype(float)
        b = weights[at + n * len(z):at + n * len(z) + n]
        at += n * len(z) + n
        z = w @ z + b
        if layer < 2:
            z = np.array([max(v, 0) if net.get("activation") == "relu" else v * (1 + math.erf(v / math.sqrt(2))) / 2 for v in z])
    return z, at


def retrained(net, arrays, means, time):
    rows = []
    for p in means:
        x = point(net, p, time)
        inside = all(0 <= a <= 1 for a in x)
        z, at, row = grid(net, arrays["trained/table"], x) if inside else np.zeros(net["levels"] * net["features"]), 0, []
        for n_out in (3, 4, 48, 1):
            part, at = head(net, arrays["trained/heads"], z, n_out, at)
            row.append(part)
        rows.append(row)
    return rows


LEVELS = {"levels": 2, "features": 2, "hidden": 5, "scale": [[3.5, 3, 2.5, 2], [90, 80, 70, 60]], "res": [[5, 4, 4, 3], [91, 81, 71, 61]], "offset": [0, 240, 751], "hashed": [0, 1]}
size = sum(5 * 4 + 5 + 5 * 5 + 5 + n * 5 + n for n in (3, 4, 48, 1))
points = np.array([[0.3, -0.2, 0.5], [1.9, 1.1, -0.4], [5, -9, 30], [1, 2, 3], [1, -0.5, 0.25], [1.5, -0.5, 0.25]], np.float32)
unit = np.array([[0.3, 0.2, 0.5], [0, 0, 0], [1, 1, 1], [0.2, -0.01, 0.3], [0.999, 0.5, 1.01], [0.6, 0.7, 0.8]], np.float32)
ball = {"centre": [1, -0.5, 0.25], "inv_radius": 0.8}
raw = {"centre": [0, 0, 0], "inv_radius": 1, "raw": True}
for name, more, means in (
        ("GELU, contracted", {"norm": ball, "sh_degree": 3}, points), ("ReLU", {"norm": ball, "sh_degree": 2, "activation": "relu"}, points), ("raw", {"norm": raw, "sh_degree": 1}, unit),
        ("one time", {"norm": ball, "sh_degree": 0, "time_last": 0.5}, points), ("times beyond its own", {"norm": ball, "sh_degree": 0, "time_first": 0.6, "time_last": 0.7}, points)):
    net = {**LEVELS, "time_first": 0.5, "time_last": 1.0, **more}
    arrays = {"trained/table": random(751, 2), "trained/heads": 0.7 * random(size), **series("trained/means", [means] * 3)}
    arrays["trained/heads"][20:25] *= 3
    own = random(len(means), 11)
    own[0, 0] = 40
    for residual in False, True:
        if residual:
            arrays.update(series("trained/residual", [own] * 3))
        clip = spin4d.load(write("network", {"trained": {"field": net, "sh_degree": net["sh_degree"]}}, arrays))
        for i in 0, 1, 2:
            got, k = clip.frame(i), (net["sh_degree"] + 1) ** 2
            want = retrained(net, arrays, means, clip.times[i])
            add = own if residual else np.zeros((len(means), 11))
            rows = np.array([np.concatenate(w) for w in want])
            scale, rotation, sh, logit = rows[:, :3] + add[:, :3], rows[:, 3:7] + add[:, 3:7], rows[:, 7:55].copy(), rows[:, 55] + add[:, 10]
            sh[:, :3] += add[:, 7:10]
            same(got.means, means, f"{name}, frame {i}{', with values of its own' if residual else ''}: positions")
            same(np.log(got.scales), np.minimum(scale, 20), "scales", 1e-4)
            same(got.quats, rotation / np.linalg.norm(rotation, axis=1, keepdims=True), "rotations", 1e-4)
            same(got.sh, sh.reshape(-1, 16, 3)[:, :k], "colours", 1e-4)
            same(got.opacities, 1 / (1 + np.exp(-logit)), "opacities", 1e-5)
ok(clip.antialias() is False and clip.antialias("retrained") is False, "plain when nothing is said")


# ---- Damaged bundles: only the errors that the module documents are raised -----------------------


def read_all(path):
    """The error, or None."""
    try:
        clip = spin4d.load(path)
        repr(clip)
        for version in clip.versions:
            clip.antialias(version)
            clip.frame(0, version)
            clip.frame(-1, version)
    except (ValueError, OSError) as e:
        good = str(e).startswith(path + ": ") and "\n" not in str(e) and not isinstance(e, UnicodeError)
        return "refused" if good or isinstance(e, OSError) else repr(e)
    except Exception as e:  # noqa: BLE001
        return repr(e)
    return None


def damaged(path):
    """Truncated bundles, bundles with changed bytes, and meta.json with each value exchanged or
    deleted."""
    whole = open(path, "rb").read()
    for k in range(60):
        yield f"cut at {k} of 60", whole[:len(whole) * k // 60]
        at = (len(whole) * k // 60 + 7 * k) % len(whole)
        yield f"byte {at}", whole[:at] + bytes([whole[at] ^ 1 << k % 8]) + whole[at + 1:]
    with zipfile.ZipFile(path) as z:
        members = {n: z.read(n) for n in z.namelist()}
    meta = json.loads(members.pop("meta.json"))
    for lost in members:
        yield f"without {lost}", zipped({n: m for n, m in members.items() if n != lost}, meta)
    name = next(n for n in members if n.endswith(".npy"))
    for at in range(10, 70, 3):
        for mark in b"('":
            copy = members[name][:at] + bytes([mark]) + members[name][at + 1:]
            yield f"{chr(mark)} at {at} of {name}", zipped({**members, name: copy}, meta)
    for where in walk(meta):
        for value in (None, "x", -1, 10**30, [], {}, [[7]], {"path": 3}):
            copy = json.loads(json.dumps(meta))
            part = copy
            for key in where[:-1]:
                part = part[key]
            if value is None:
                del part[where[-1]]
            else:
                part[where[-1]] = value
            yield f"{where} as {value}", zipped(members, copy)


def walk(value, at=()):
    for key in value if isinstance(value, dict) else range(min(len(value), 2)) if isinstance(value, list) else ():
        yield (*at, key)
        yield from walk(value[key], (*at, key))


def zipped(members, meta):
    to = io.BytesIO()
    with zipfile.ZipFile(to, "w") as z:
        z.writestr("meta.json", json.dumps(meta))
        for name, data in members.items():
            z.writestr(name, data)
    return to.getvalue()


bad = os.path.join(work, "damaged.spin")
for name in "network", "both":
    wrong, refused = [], 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for what, data in damaged(os.path.join(work, name + ".spin")):
            with open(bad, "wb") as f:
                f.write(data)
            why = read_all(bad)
            refused += why == "refused"
            wrong += [f"{what}: {why}"] if why not in (None, "refused") else []
    ok(not wrong and refused > 200, f"{name}.spin damaged: a ValueError that names it", f"{refused} refused; " + "\n#   ".join(wrong[:5]))
for call in (lambda: clip.frame("0"), lambda: clip.slice(None), lambda: clip.values(3)):
    try:
        call()
    except (TypeError, ValueError) as e:
        ok("damaged" not in str(e), "an argument that is wrong is no damage", str(e))

# ---- write_ply -----------------------------------------------------------------------------------

n = 3
frame = spin4d.Frame(random(n, 3), np.eye(4, dtype=np.float32)[:n], np.array([[1, 1, 1], [1, 0, 1], [2, 1, 1]], np.float32),
                     np.array([0, 0.5, 1], np.float32), random(n, 4, 3))
spin4d.write_ply(os.path.join(work, "hidden.ply"), frame)
with open(os.path.join(work, "hidden.ply"), "rb") as f:
    rows = np.frombuffer(f.read().split(b"end_header\n")[1], "<f4").reshape(n, -1)
same(1 / (1 + np.exp(-rows[:, 15].astype(float))), [0, 0.5, 1], "splats that are hidden and solid are written", 1e-9)
same(np.exp(rows[:, 16:19]), frame.scales, "flat ones as well", 1e-6)
for name, more in (("NaN", {"opacities": np.array([0, np.nan, 1])}), ("an opacity below 0", {"opacities": np.array([0, -0.5, 1])}),
                   ("an infinite place", {"means": np.full((n, 3), np.inf)})):
    fails(["hidden.ply"], f"{name} is refused", spin4d.write_ply, os.path.join(work, "hidden.ply"), frame._replace(**more))
print(f"1..{count}")
sys.exit(1 if failed else 0)
