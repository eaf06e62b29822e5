"""figures.py BIN CLIP WORK: for t9005-figures.sh. What a command prints for people is made here once more, from
what it prints with --json, and must be the same line for line. What --json says is worked out here once more as
well, with NumPy, from the source, the bundle, the pictures and the files."""
import base64
import json
import math
import os
import re
import struct
import subprocess
import sys
import time
import zipfile
import zlib

import numpy as np

BIN, CLIP, WORK = sys.argv[1:4]
count, failed = 0, 0


# ---- TAP ------------------------------------------------------------------------------------------


def ok(good, name, *why):
    global count, failed
    count += 1
    print("%s %d - %s" % ("ok" if good else "not ok", count, name))
    if not good:
        failed += 1
        for line in why:
            print("#   " + str(line).replace("\n", "\n#   "))
    sys.stdout.flush()


def same(got, want, name):
    """Two texts, line for line; says which lines differ."""
    got, want = got.rstrip("\n").split("\n"), want.rstrip("\n").split("\n")
    lines = ["line %d: got  '%s'\n        want '%s'" % (i + 1, g, w)
             for i, (g, w) in enumerate(zip(got, want)) if g != w]
    if len(got) != len(want):
        lines.append("%d lines, want %d" % (len(got), len(want)))
    ok(not lines, name, *lines[:8])


def near(got, want, tolerance, name):
    got, want = np.asarray(got, float), np.asarray(want, float)
    good = got.shape == want.shape and bool(np.all(np.abs(got - want) <= tolerance))
    ok(good, name, "got %s" % got, "want %s, tolerance %g" % (want, tolerance))


# ---- Commands -------------------------------------------------------------------------------------


def path(name):
    return os.path.join(WORK, name)


def run(command, *args, code=0):
    """What stood on stdout; stderr is kept in said."""
    global said, took
    start = time.time()
    p = subprocess.run([os.path.join(BIN, "spin-" + command)] + [str(a) for a in args], stdin=subprocess.DEVNULL,
                       stdout=subprocess.PIPE, stderr=subprocess.PIPE, universal_newlines=True)
    said, took = p.stderr, time.time() - start
    if p.returncode != code:
        ok(False, "spin-%s %s" % (command, " ".join(map(str, args))), "exit code %d" % p.returncode, said)
        print("1..%d" % count)
        sys.exit(1)
    return p.stdout


def both(command, *args):
    """As text and as JSON."""
    text = run(command, *args)
    return text, json.loads(run(command, *args, "--force", "--json"))


# ---- How figures are written ----------------------------------------------------------------------


def size(n):
    """Bytes in powers of 1000, with three digits."""
    u = 0
    while n >= 999.5:
        n, u = n / 1000, u + 1
    return "%.3g %s" % (math.floor(n) if u == 0 else n, ["bytes", "kB", "MB", "GB", "TB"][u])


def mean(x):
    return ("%.0f" if x == math.floor(x) else "%.1f") % x


def some(n, noun):
    return "%d %s%s" % (n, noun, "" if n == 1 else "s")


def splats(s):
    return "%d a frame" % s["min"] if s["min"] == s["max"] else "%d to %d a frame, mean %.1f" % (
        s["min"], s["max"], s["mean"])


def number(x):
    return "%.10g" % x


def nan(x):
    return math.nan if x is None else x


# ---- The source, the pictures and the bundle, read apart -------------------------------------------

FRAMES = [8, 9, 10, 12, 13]  # numbers of the data set's frames; 11 is missing
NAMES = ["x", "y", "z"] + ["f_dc_%d" % i for i in range(3)] + ["f_rest_%d" % i for i in range(9)] + [
    "opacity"] + ["scale_%d" % i for i in range(3)] + ["rot_%d" % i for i in range(4)]


def make_source():
    """PLY frames of the clip with SH of degree 1; each has other splats, and other counts."""
    z, rng, frames = np.load(os.path.join(CLIP, "params.npz")), np.random.default_rng(7), []
    os.mkdir(path("run"))
    for k, n in enumerate(FRAMES):
        q = (3 * k + 1) % 5  # so that neither the first nor the last frame has the most or the least
        f, keep = n - 8, np.arange(2940) % (17 + 3 * q) > q
        rows = np.concatenate([z["means3D"][f], (z["rgb_colors"][f] - 0.5) / 0.28209479177387814,
                               rng.normal(0, 0.1, (2940, 9)), z["logit_opacities"], z["log_scales"],
                               z["unnorm_rotations"][f]], 1)[keep].astype("<f4")
        frames.append(rows)
        write_ply(path("run/%06d.ply" % n), rows)
    return frames


def write_ply(to, rows):
    with open(to, "wb") as f:
        f.write(("ply\nformat binary_little_endian 1.0\nelement vertex %d\n" % len(rows) + "".join(
            "property float %s\n" % n for n in NAMES) + "end_header\n").encode() + rows.tobytes())


def read_png(data):
    """[h][w][3] of 8 bits; colours or grey without interlacing."""
    at, packed = 8, b""
    while at < len(data):
        n, kind = struct.unpack(">I4s", data[at:at + 8])
        if kind == b"IHDR":
            w, h, _, colour = struct.unpack(">IIBB", data[at + 8:at + 18])
        if kind == b"IDAT":
            packed += data[at + 8:at + 8 + n]
        at += n + 12
    c = {0: 1, 2: 3, 4: 2, 6: 4}[colour]
    raw = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(h, 1 + w * c)
    line, kind = raw[:, 1:].reshape(h, w, c).astype(int), raw[:, :1].astype(int)
    out = np.zeros((h + 1, w + 1, c), int)  # with a row above and a column before
    for s in range(h + w - 1):  # from corner to corner: what a pixel needs lies before and above
        y = np.arange(max(0, s - w + 1), min(h, s + 1))
        x, k = s - y, kind[y]
        a, b, d = out[y + 1, x], out[y, x + 1], out[y, x]
        p, q, r = abs(b - d), abs(a - d), abs(a + b - 2 * d)
        paeth = np.where((p <= q) & (p <= r), a, np.where(q <= r, b, d))
        guess = np.where(k == 4, paeth, np.where(k == 3, (a + b) // 2, a * (k == 1) + b * (k == 2)))
        out[y + 1, x + 1] = (line[y, x] + guess) & 255
    return np.repeat(out[1:, 1:], 3, 2) if c < 3 else out[1:, 1:, :3]


def sheets(folder, width, n):
    """{(frame, camera): pictures} of what spin-eval --images wrote: n side by side, 4 pixels between them."""
    out = {}
    for name in sorted(n for n in os.listdir(folder) if n != "sequence.json"):
        camera, frame = map(int, re.fullmatch(r"cam_(\d+)_frame_(\d+)\.png", name).groups())
        with open(os.path.join(folder, name), "rb") as f:
            all = read_png(f.read())
        out[frame, camera] = [all[:, k * (width + 4):k * (width + 4) + width] for k in range(n)]
    return out


def psnr_of(a, b, where=None):
    squares = ((a - b) / 255.0) ** 2
    return -10 * math.log10(np.mean(squares if where is None else squares[where]))


def around(map):
    """How many of the eight neighbours are set."""
    p = np.pad(map.astype(int), 1)
    h, w = map.shape
    return sum(p[1 + y:1 + y + h, 1 + x:1 + x + w] for y in (-1, 0, 1) for x in (-1, 0, 1)) - map


def moving(truth, median):
    """Pixels that differ from the median, less specks, one pixel wider."""
    mask = np.abs(truth.astype("f4") / np.float32(255) - median.astype("f4") / np.float32(255)).max(2) > np.float32(20 / 255)
    kept = mask & (around(mask) >= 4)
    return kept | (around(kept) > 0)


def weigh(bundle):
    """Bytes of the parts by the names of the members, packed and unpacked."""
    where = [("source/", "source"), ("refined/", "refined"), ("trained/means/", "positions"),
             ("trained/residual/", "positions"), ("trained/track", "tracks"), ("trained/table", "table"),
             ("trained/", "heads")]
    file = os.path.getsize(bundle)
    packed = dict({"file": file}, **{k: 0 for _, k in where})
    unpacked = dict(packed)
    with zipfile.ZipFile(bundle) as z:
        for m in z.infolist():
            part, full = next((k for w, k in where if m.filename.startswith(w)), None), m.file_size
            if m.filename.endswith(".npy"):
                with z.open(m) as f:
                    a = np.lib.format.read_array(f)
                if a.dtype.itemsize == 1 and a.dtype.kind == "i" and a.ndim >= 2 and a.shape[0] <= 4:
                    full += a.size // a.shape[0] * (4 - a.shape[0])  # planes of bytes that would be 0
            unpacked["file"] += full - m.compress_size
            if part:
                packed[part] += m.compress_size
                unpacked[part] += full
    return packed, unpacked


def array_in(bundle, name):
    with zipfile.ZipFile(bundle) as z, z.open(name) as f:
        return np.lib.format.read_array(f)


def meta_of(bundle):
    with zipfile.ZipFile(bundle) as z:
        return json.loads(z.read("meta.json"))


# ---- spin-import ----------------------------------------------------------------------------------


def text_import(j, info, check=None):
    t = ["from        %s%s%s" % (j["from"], ", " if j["variant"] else "", j["variant"])]
    if info:
        t += ["recognised  " + j["recognised"], "upstream    " + j["upstream"]]
    t += ["frames      %d, numbers %d to %d%s, times %s to %s" % (
        j["frames"], *j["numbers"], "" if j["numbered"] else " (counted)", *map(number, j["times"]))]
    t += ["splats      " + splats(j["splats"])]
    t += ["attributes  " + " ".join(j["attributes"]) + (
        "" if j["sh_degree"] is None else " (SH degree %d)" % j["sh_degree"])]
    if info and j["static"]:
        t += ["static      " + " ".join(j["static"])]
    t += ["bounds      [%g, %g, %g] to [%g, %g, %g]" % (*j["bounds"]["min"], *j["bounds"]["max"])]
    if "ranges" in j:
        t += ["read        %d of %d frames%s" % (j["frames_read"], j["frames"], ", evenly (--full reads all)" if
                                                 j["frames_read"] < j["frames"] else "")]
        t += ["            %-16s %12s %12s %12s" % ("attribute", "least", "median", "largest")]
        for name, r in j["ranges"].items():
            three = [r["min"], r["median"], r["max"]]
            line = "            %-16s %12.5g %12.5g %12.5g" % (name, *three)
            if name == "log_scales":
                line += "   scales %.4g, %.4g, %.4g" % tuple(map(math.exp, three))
            if name == "logit_opacities":
                line += "   opacities %.4g, %.4g, %.4g" % tuple(1 / (1 + math.exp(-x)) for x in three)
            t += [line + ("   %.3g %% not finite" % (100 * r["not_finite"]) if r["not_finite"] else "")]
        if not any(r["not_finite"] for r in j["ranges"].values()):
            t += ["            all values are finite"]
    t += ["note        " + n for n in j["notes"]]
    if check:
        t += ["check       frame %d, camera %d: %.1f %% of the points in front, %.1f %% inside, %s/%s" % (
            c["frame"], c["camera"], 100 * c["in_front"], 100 * c["inside"], check, c["file"]) for c in j["cameras"]]
        t += ["camera %-4d at least %.1f %% of the points in front, %.1f %% inside%s" % (
            c["camera"], 100 * c["least_in_front"], 100 * c["least_inside"],
            ": far fewer than others" if c["apart"] else "") for c in j["shares"]["cameras"]]
        t += ["median      %.1f %% of the points in front, %.1f %% inside, of all views" % (
            100 * j["shares"]["in_front"], 100 * j["shares"]["inside"])]
    if "output" in j:
        t += ["written     " + j["output"]]
    return "\n".join(t)


def counts_are(j, frames, name):
    n = [len(f) for f in frames]
    ok(j["splats"] == {"min": min(n), "mean": np.mean(n), "max": max(n)}, name, j["splats"], n)


def check_import(frames):
    text, j = both("import", "--info", path("run"))
    same(text, text_import(j, True), "--info of a run: the text has the figures of --json")
    counts_are(j, frames, "splats of its frames, least, mean and most")
    ok(j["frames"] == j["frames_read"] == 5 and j["numbers"] == [8, 13] and j["times"] == [0, 4],
       "frames, numbers and times", j)
    all = np.concatenate(frames)
    near([j["bounds"]["min"], j["bounds"]["max"]], [all[:, :3].min(0), all[:, :3].max(0)], 0, "bounds of all frames")
    for name, first, end in (("means.x", 0, 1), ("means.y", 1, 2), ("means.z", 2, 3), ("sh.dc", 3, 6), ("sh.rest", 6, 15),
                             ("logit_opacities", 15, 16), ("log_scales", 16, 19), ("quats", 19, 23)):
        values, r = [f[:, first:end] for f in frames], j["ranges"][name]
        if name == "quats":
            values = [unit(v.astype(float)) for v in values]
        if name == "sh.rest":  # a splat's coefficients, each of three channels
            values = [v.reshape(-1, 3, 3).transpose(0, 2, 1).reshape(-1, 9) for v in values]
        # The median of at most 65536 values, evenly from every frame.
        some_of = np.sort(np.concatenate([v.ravel()[::-(-v.size // (65536 // 5))] for v in values]))
        near([r["min"], r["median"], r["max"]], [min(v.min() for v in values), some_of[len(some_of) // 2],
                                                 max(v.max() for v in values)], 1e-6, name)

    # More frames than are read.
    os.mkdir(path("many"))
    many = [np.repeat(frames[0][:40 + k], 1, 0) for k in range(20)]
    for k, f in enumerate(many):
        f[:, 1] += k
        write_ply(path("many/%06d.ply" % (100 + k)), f)
    text, j = both("import", "--info", path("many"))
    same(text, text_import(j, True), "--info of a long clip")
    read = [many[i * 19 // 15] for i in range(16)]
    ok(j["frames"] == 20 and j["frames_read"] == 16 and j["numbers"] == [100, 119], "16 of 20 frames are read", j)
    near(j["ranges"]["means.y"]["median"], np.sort(np.concatenate(read)[:, 1])[sum(map(len, read)) // 2], 0, "evenly")
    counts_are(j, many, "and all are counted")

    source = ["import", path("run"), "--data", CLIP, "--force"]
    text, j = both(*source, "-o", path("all.spin"))
    same(text, text_import(j, False), "an import: the text has the figures of --json")
    counts_are(j, frames, "splats of what was imported")
    text, j = both(*source, "--range", "9:14", "-o", path("in.spin"))
    same(text, text_import(j, False), "an import of a range")
    counts_are(j, frames[1:], "splats of that range")
    near([j["bounds"]["min"], j["bounds"]["max"]], [np.concatenate(frames[1:])[:, :3].min(0),
                                                    np.concatenate(frames[1:])[:, :3].max(0)], 0, "and its bounds")
    ok(j["numbers"] == [9, 13] and j["times"] == [1, 4], "its numbers and times", j["numbers"], j["times"])


def check_cameras(frames):
    """Shares of the points in front of every camera and inside its image, of a rig that moves."""
    cameras, least, all = {}, {}, []
    os.mkdir(path("moved"))
    os.symlink(os.path.abspath(os.path.join(CLIP, "ims")), path("moved/ims"))
    for name in ("train", "test"):
        with open(os.path.join(CLIP, name + "_meta.json")) as f:
            m = json.load(f)
        for f, (files, ids) in enumerate(zip(m["fn"], m["cam_id"])):
            for c, camera in enumerate(ids):
                m["w2c"][f][c][0][3] += 0.05 * ((5 * f + camera) % 7)
                cameras[8 + f, camera] = np.array(m["k"][f][c]), np.array(m["w2c"][f][c]), m["w"], m["h"]

        with open(path("moved/%s_meta.json" % name), "w") as f:
            json.dump(m, f)
    text, j = both("import", path("run"), "--data", path("moved"), "--range", "9:14", "--check-cameras", path("over"),
                   "--force")
    same(text, text_import(j, False, path("over")), "--check-cameras: the text has the figures of --json")

    def share(frame, camera, points):
        k, w2c, w, h = cameras[frame, camera]
        p = w2c[:3, :3] @ points.T.astype(float) + w2c[:3, 3:]
        front = p[2] > 0
        u, v = k[0, 0] * p[0] / p[2] + k[0, 2], k[1, 1] * p[1] / p[2] + k[1, 2]
        return front.mean(), (front & (u >= 0) & (v >= 0) & (u < w) & (v < h)).mean()

    for c in j["cameras"]:
        near([c["in_front"], c["inside"]], share(c["frame"], c["camera"], frames[FRAMES.index(c["frame"])][:, :3]),
             1e-9, "frame %d, camera %d" % (c["frame"], c["camera"]))
    ok(sorted({c["frame"] for c in j["cameras"]}) == [9, 10, 13], "first, middle and last frame are drawn")
    last = frames[-1][:, :3]  # the points of the last frame that was drawn stand for all
    for (frame, camera) in cameras:
        if frame in FRAMES[1:]:
            all.append(share(frame, camera, last))
            least[camera] = min(least.get(camera, (2, 2)), all[-1], key=lambda s: s[1])
    near([j["shares"]["in_front"], j["shares"]["inside"]], np.median(all, 0), 1e-9, "medians of all views")
    near([[c["camera"], c["least_in_front"], c["least_inside"]] for c in j["shares"]["cameras"]],
         [[c, *least[c]] for c in sorted(least)], 1e-9, "the least of every camera")
    near([share(c["frame"], c["camera"], last)[1] for c in j["shares"]["cameras"]],
         [c["least_inside"] for c in j["shares"]["cameras"]], 1e-9, "in the frame that is named")


# ---- --info of a bundle ----------------------------------------------------------------------------


def text_options(options):
    """Without quotes, in lines that break behind commas."""
    text, out, column = json.dumps(options, separators=(",", ":")), "            settings: ", 0
    for c in text[1:-1]:
        if c == '"':
            continue
        out += c
        if c == ",":
            column += 1
        if c == "," and column > 80:
            out, column = out + "\n            ", 0
        elif c in ",:":
            out += " "
        column += 1
    return out


def text_bundle(j, has_table):
    t = ["bundle      %s, by %s" % (j["bundle"], j["generator"])]
    t += ["from        %s%s%s" % (j["from"], ", " if j["variant"] else "", j["variant"]), "upstream    " + j["upstream"]]
    if j["data"]:
        t += ["data        %s, %s%s" % (j["data"], j["data_from"], "" if j["data_there"] else ": not found")]
    t += ["frames      %d of the source's %d, numbers %d to %d%s, times %s to %s" % (
        j["frames"], j["source_frames"], *j["numbers"], "" if j["numbered"] else " (counted)", *map(number, j["times"]))]

    def columns(j):
        return " ".join(j["attributes"]) + ("" if j["sh_degree"] is None else " (SH degree %d)" % j["sh_degree"])

    t += ["splats      " + splats(j["splats"]), "attributes  " + columns(j)]
    if j["static"]:
        t += ["static      " + " ".join(j["static"])]
    for name in ("refined", "trained"):
        if name not in j:
            continue
        s = j[name]
        line = "%-12s%s, %d iterations" % (name, splats(s["splats"]), s["options"]["iterations"])
        if name == "refined":
            line += " each"
        elif s["field"]:
            line += " on %s; %d levels of %d features, %d rows, hidden width %d" % (
                s["device"], s["field"]["levels"], s["field"]["features"], s["field"]["rows"], s["field"]["hidden"])
        else:
            line += " on %s, no network" % s["device"]
        t += [line, "            attributes: " + columns(s)]
        for when, key in (("before", "before"), ("after", "test")):
            if s[key]:
                t += ["            held-out views %s: %.2f dB, SSIM %.4f" % (when, s[key]["psnr"], s[key]["ssim"])]
        t += text_options(s["options"]).split("\n")
    line = "size        " + size(j["bytes"]["file"])
    for key, name in (("source", "source"), ("refined", "refined"), ("positions", "values of frames"),
                      ("tracks", "tracks"), ("table", "table"), ("heads", "heads")):
        if j["bytes"][key]:
            line += ", %s %s" % (name, size(j["bytes"][key]))
    return t + [line + ("; unpacked " + size(j["bytes_unpacked"]["file"]) if j["bytes_unpacked"]["file"] !=
                        j["bytes"]["file"] else "")]


def told_options(stage):
    """Those that are told of a stage of meta.json: of a network only where one was trained."""
    network = ("levels features hash_log2 hidden base_resolution finest_resolution residual init_log_scale hash_init_range "
               "lr_table lr_sh lr_scale lr_rotation lr_opacity lr_head_factor relu activation normalise normalise_centre "
               "normalise_radius network_start").split()
    return {k: v for k, v in stage["options"].items() if stage.get("field") or "tracks" not in stage or k not in network}


def check_bundle(name, source, stages):
    """stages: splats of every frame, by stage."""
    bundle = path(name)
    text, j = both("import", "--info", bundle)
    meta = meta_of(bundle)
    with zipfile.ZipFile(bundle) as z:
        has_table = "trained/table.npy" in z.namelist()
    for stage in stages:
        ok(j[stage]["options"] == told_options(meta[stage]), "%s: settings of %s" % (name, stage))
        n = stages[stage]
        ok(j[stage]["splats"] == {"min": min(n), "mean": np.mean(n), "max": max(n)}, "%s: splats of %s" % (name, stage),
           j[stage]["splats"], n)
    same(text, "\n".join(text_bundle(j, has_table)), "--info of %s: the text has the figures of --json" % name)
    ok(j["numbers"] == [FRAMES[-len(source)], FRAMES[-1]], "%s: numbers of the frames" % name, j["numbers"])
    counts_are(j, source, "%s: splats of the source" % name)
    packed, unpacked = weigh(bundle)
    if has_table:
        field = meta["trained"]["field"]
        ok(j["trained"]["field"]["rows"] == field["offset"][field["levels"]], "%s: rows of its table" % name)
    ok(j["bytes"] == packed, "%s: bytes of its parts" % name, j["bytes"], packed)
    ok(j["bytes_unpacked"] == unpacked, "%s: unpacked" % name, j["bytes_unpacked"], unpacked)
    return j


# ---- spin-retrain ---------------------------------------------------------------------------------


def quality(name, q):
    return "%-10s  %8.3f  %7.4f" % (name, q["psnr"], q["ssim"]) if q else "%-10s  %8s  %7s" % (name, "-", "-")


def text_plan(j):
    t = ["device      " + j["device"], "preset      " + j["preset"]]
    t += ["work        %s%s, %s, %s splats each" % (
        some(j["iterations"], "iteration"), " on each frame" if j["method"] == "frames" else "",
        some(j["frames"], "frame"), mean(j["splats_mean"]))]
    if j["densify_every"] > 0:
        t += ["densify     every %d iterations" % j["densify_every"]]
    t += ["memory      %s needed, %s available" % (size(j["bytes_needed"]), size(j["bytes_available"]))]
    if not j["fits"]:
        t += ["            it does not fit: " + (j["fitting"] + " would fit" if j["fitting"] else
                                                 "no smaller setting was found that would")]
    s = j["seconds_estimated"]
    return "\n".join(t + ["time        about " + (
        "%.1f s" % s if s < 100 else "%.0f min" % (s / 60) if s < 5970 else
        "%.0f h %02.0f min" % (s // 3600, s % 3600 // 60) if s < 48 * 3600 else "%.1f days" % (s / 86400))])



def available(text):
    """What is free changes from run to run."""
    return re.sub(r", [0-9.]* .B available", "", text)


def check_plans(frames):
    n, bundle = np.mean([len(f) for f in frames]), path("all.spin")
    for more in ("", "--preset best --batch 2 --scale 0.25", "--method frames --refine 70 --scale 0.5",
                 "--refine 1 --iterations 1",
                 "--preset paper --iterations 200000 --threads 1", "--preset paper --iterations 3000000"):
        text, j = both("retrain", bundle, "--dry-run", "--device", "cpu", *more.split())
        same(available(text), available(text_plan(j)), "--dry-run %s: the text has the figures of --json" % more)
        near(j["splats_mean"], n, 1e-9, "splats of a frame")

    def seconds(*args):
        return json.loads(run("retrain", bundle, "--dry-run", "--json", "--device", "cpu", "--threads", "1",
                              "--iterations", "1000", *args))

    one = seconds()
    ok(one["iterations"] == 1000 and one["frames"] == 5, "what was asked for")
    near(seconds("--iterations", "3000", "--densify-every", one["densify_every"])["seconds_estimated"],
         3 * one["seconds_estimated"], 1e-6, "the time grows with the iterations")
    near(seconds("--threads", "4")["seconds_estimated"], one["seconds_estimated"] / 4, 1e-6, "and falls with the threads")
    near(seconds("--preset", "paper", "--refine", "40")["seconds_estimated"] -
         seconds("--preset", "paper")["seconds_estimated"],
         5 * 40 * (n * 0.6e-6 + 160 * 90 * 0.25e-6), 1e-6, "refining takes every frame's iterations")
    a, b = (seconds("--scene-normalise", how, "--preset", "paper")["outside_ball"] for how in ("none", "0.5,0,0,2"))
    all = np.concatenate(frames)[:, :3].astype(float)
    near([a, b], [(np.linalg.norm(all, axis=1) > 1).mean(), (np.linalg.norm(all - (0.5, 0, 0), axis=1) > 2).mean()],
         2e-4, "points outside the unit ball")


def check_retrain(name, frames, *args):
    """A bundle retrained with these options, once as text and once as JSON."""
    out, log, sizes = path(name), path(name + ".log"), [len(f) for f in frames]
    command = ["retrain", path("all.spin"), "-o", out, "--device", "cpu", "--log", log, *args]
    text, told, first = run(*command, "-v"), said, read_log(log)
    j = json.loads(run(*command, "--force", "--json"))
    lines = read_log(log)
    got = re.match(r"(.*): (.*) in ([0-9.]+) s \(([0-9.e-]+) s each\) on (.*)\n", text)
    by_frame = j["method"] == "frames"
    if not got:
        return ok(False, "%s: the text" % name, text)
    # Of two runs: what is measured is the same, but for times.
    want = "%s: %s in %s s (%s s each) on %s, %s, %s splats each\n%-10s  %8s  %7s\n" % (
        out, some(j["iterations"], "iteration"), got.group(3), got.group(4), j["device"], some(j["frames"], "frame"),
        mean(j["splats_mean"]), "test views", "PSNR", "SSIM") + quality("before", j["before"]) + "\n"
    if j.get("refined") and not by_frame:
        want += quality("refined", j["refined"]) + "\n"
    same(text, want + quality("after", j["test"]), "%s: the text has the figures of --json" % name)
    refine, steps = j.get("refine_seconds", 0), [x for x in lines if "loss" in x and "iteration" in x]
    tests = [x for x in lines if "test_psnr" in x]
    per = j["frames"] * j["iterations"] if by_frame else j["iterations"]
    near((j["seconds"] - (0 if by_frame else refine)) / per, j["seconds_per_iteration"], 1e-9, "%s: seconds each" % name)
    if not by_frame:
        ok(len(steps) == j["iterations"] and [x["iteration"] for x in steps] == list(range(1, len(steps) + 1)),
           "%s: a line of the log for every step" % name)
        ok(steps[-1]["seconds"] - 0.002 <= j["seconds"] <= tests[-1]["seconds"] + 0.002 and j["seconds"] >= refine,
           "%s: seconds are those of the log" % name, j["seconds"], steps[-1], tests)
        ok(sum(x["step_s"] for x in steps) + refine <= j["seconds"] + 0.01, "%s: no fewer than those of its steps" % name)
        smooth = 0
        for x in steps:
            smooth = 0.98 * smooth + 0.02 * x["loss"] if smooth > 0 else x["loss"]
        near(j["loss"], smooth, 1e-5, "%s: the loss is the log's, smoothed" % name)
        near([x["loss"] for x in steps], [0.8 * x["l1"] + 0.2 * (1 - x["ssim"]) for x in steps], 2e-3,
             "%s: the loss of a step is made of its L1 and SSIM" % name)
        near([tests[-1]["test_psnr"], tests[-1]["test_ssim"]], [j["test"]["psnr"], j["test"]["ssim"]], 1e-6,
             "%s: the last measurement of the log" % name)
        begin = next(x["seconds"] - x["step_s"] for x in first if "step_s" in x and "iteration" in x)  # after refining
        end, last = [x for x in first if "step_s" in x and "iteration" in x][-1]["seconds"], first[-1]["seconds"]
        ok(end - 0.06 <= float(got.group(3)) <= last + 0.06, "%s: seconds of the text are those of its log" % name)
        ok(0.94 * (end - begin) <= float(got.group(4)) * j["iterations"] <= 1.01 * last, "%s: and those of an iteration" % name,
           got.group(4), begin, end, last)
        views = {tuple(v) for x in steps for v in x["views"]}
        ok({f for f, _ in views} <= set(FRAMES) and {c for _, c in views} <= {3, 7, 12, 19, 23, 27},
           "%s: the log names frames and cameras by their numbers" % name, views)
    check_said(name, told, j, first, sizes)
    return j, lines


def read_log(log):
    with open(log) as f:
        return [json.loads(line) for line in f]


def check_said(name, told, j, lines, sizes):
    """Lines on stderr of a run with -v."""
    def line(pattern):
        found = re.findall("^" + pattern + "$", told, re.M)
        return found[0] if len(found) == 1 else None

    iterations, by_frame = some(j["iterations"], "iteration"), j["method"] == "frames"
    about = "a second|[0-9]+ seconds"
    if j["refine"]:
        want = "preset %s: %s on each frame%s, %s; about (%s) here" % (
            j["preset"], some(j["refine"], "iteration"), "" if by_frame else ", then " + iterations,
            some(j["frames"], "frame"), about)
        ok(line(r"refining %d of %d frames, %s each" % (len(sizes), len(sizes), some(j["refine"], "iteration"))) is not None,
           "%s: says how many frames it refines" % name, told)
        became = re.findall(r"^frame (\d+): (\d+) splats became (\d+), loss ([0-9.]+) became ([0-9.]+)$", told, re.M)
        ok(sorted((int(f), int(n)) for f, n, _, _, _ in became) == list(zip(FRAMES, sizes)),
           "%s: a line for every refined frame, with its number and its splats" % name, told)
        ok(line(r"refined: %.0f splats per frame, test PSNR %.3f dB, SSIM %.4f" % (
            np.mean([int(n) for _, _, n, _, _ in became]), j["refined"]["psnr"], j["refined"]["ssim"])) is not None,
           "%s: and how good they are" % name, told)
        for f, _, n, first, last in became:
            of = [x for x in lines if "refine" in x and x["views"][0][0] == int(f)]
            ok([x["refine"] for x in of] == list(range(1, j["refine"] + 1)) and (first, last, int(n)) == (
                "%.4f" % of[0]["loss"], "%.4f" % of[-1]["loss"], of[-1]["splats"]), "%s: and what the log has of frame %s" % (
                    name, f), became, of)
    else:
        want = "preset %s: %s, %s; about (%s) here" % (j["preset"], iterations, some(j["frames"], "frame"), about)
    ok(line(want.replace("(", "(?:")) is not None, "%s: says what it chose" % name, want, told)
    n = j["splats_mean"] if j["refine"] else np.mean(sizes)
    ok(line(r"%s, %.0f splats a frame, 30 training and 10 test views, %s" % (
        some(j["frames"], "frame"), n, re.escape(j["device"]))) is not None, "%s: says what it works on" % name, told)
    ok(line(r"before retraining: test PSNR %.3f dB, SSIM %.4f" % (j["before"]["psnr"], j["before"]["ssim"])) is not None,
       "%s: says how good the source is" % name, told)
    if j["method"] == "network":
        table = meta_of(path(name))["trained"]["field"]
        ok(line(r"the hash table has %.1f million parameters; %.1f %% of the points are outside the unit ball" % (
            table["offset"][table["levels"]] * table["features"] / 1e6, 100 * j["outside_ball"])) is not None,
           "%s: says how large the table is" % name, told)
    tracks = meta_of(path(name)).get("trained", {}).get("tracks")
    if tracks:
        ok(line(r"%d tracks, %d dynamic(?: \(matched between neighbouring frames\))?, %d with attributes per frame" % (
            tracks["n"], tracks["moving"], tracks["varying"])) is not None, "%s: says how many tracks" % name, told, tracks)
    if not by_frame:
        want = ["iteration %d: test PSNR %.3f dB, SSIM %.4f" % (x["iteration"], x["test_psnr"], x["test_ssim"])
                for x in lines if "test_psnr" in x]
        same("\n".join(re.findall(r"^iteration \d+: test .*$", told, re.M)), "\n".join(want),
             "%s: says every measurement of its log" % name)
        timed = [x["ops_s"] for x in lines if "ops_s" in x and "iteration" in x]
        ops = {op: sum(x[op] for x in timed) for op in timed[0]}
        shown = {op: (float(s), float(share)) for op, s, share in re.findall(
            r"^  (\w+) +([0-9.]+) s +([0-9.]+) %", told, re.M)}
        wall = line(r"  together +[0-9.]+ s +[0-9.]+ % of ([0-9.]+) s in iterations")
        wall = float(wall) if wall else math.nan
        near([shown[op][0] for op in ops], list(ops.values()), 0.0006 + 1e-6 * len(lines), "%s: seconds of operations" % name)
        near([shown[op][1] for op in ops], [100 * s / wall for s in ops.values()], 0.06 + 100 * 0.0006 / wall,
             "%s: and their shares" % name)
        near(shown["together"], [sum(ops.values()), 100 * sum(ops.values()) / wall], 1 + 100 * 0.001 / wall,
             "%s: and their sum" % name)
        near(wall, sum(x["step_s"] for x in lines if "step_s" in x and "iteration" in x), 0.002, "%s: seconds in steps" % name)


# ---- spin-eval and the page -------------------------------------------------------------------------


def parts_of(j, attributes):
    s = j["storage"]
    return {"retrained": s["positions"] + s["tracks"] + s["table"] + s["heads"], "frames": s["refined"],
            "source": s["source"]}[attributes]


def text_eval(j, verbose, quiet, fps):
    dynamic = j["dynamic_from"] != "off"

    def cell(x, width, digits):
        return "  %*s" % (width, "-") if x is None else "  %*.*f" % (width, digits, x)

    def row(frame, camera, q):
        return "%6s  %6s" % (frame, camera) + cell(q["psnr"], 8, 3) + cell(q["ssim"], 7, 4) + (
            cell(q["psnr_dynamic"], 8, 3) if dynamic else "")

    t = ["%6s  %6s  %8s  %7s" % ("frame", "camera", "PSNR", "SSIM") + ("  %8s" % "dynamic" if dynamic else "")]
    t += [row(v["frame"], v["camera"], v) for v in j["views"] if verbose]
    t += [] if quiet else [row(f["frame"], "all", f) for f in j["frames"]]
    t += [] if quiet else [row("all", c["id"], c) for c in j["cameras"]]
    t += [row("all", "all", j) + "   %d views, %s attributes" % (len(j["views"]), j["attributes"])]
    if quiet:
        return "\n".join(t)
    if dynamic:
        t += ["dynamic  %.2f %% of the pixels, from %s: PSNR %.3f there, %.3f elsewhere" % (
            100 * j["dynamic"], {"masks": "foreground masks", "images": "the images"}[j["dynamic_from"]],
            j["psnr_dynamic"], j["psnr_static"])]
    if j["background_shows"]:
        t += ["holes    PSNR %.3f over the opposite background: the splats are transparent in places" %
              j["psnr_opposite"]]
    t += ["speed    %s frames per second with decoding, %s without" % fps]
    return "\n".join(t + ["size     %s on disk, %s unpacked; %s for the measured attributes, %s per frame" % (
        size(j["storage"]["file"]), size(j["storage_unpacked"]["file"]), size(j["storage"]["measured"]),
        size(j["storage"]["measured_per_frame"]))])


def check_means(j, name, n_frames):
    """Means of frames, cameras and all, from the views. The bundle has n_frames, whichever are measured."""
    keys = ["psnr", "ssim", "psnr_channel_mean"] + (
        ["psnr_dynamic", "psnr_static", "dynamic"] if j["dynamic_from"] != "off" else [])

    def mean_of(views):
        return [np.mean([v[k] for v in views if v[k] is not None]) for k in keys]

    near([j[k] for k in keys], mean_of(j["views"]), 1e-9, name + ": means of all views")
    for f in j["frames"]:
        near([f[k] for k in keys], mean_of([v for v in j["views"] if v["frame"] == f["frame"]]), 1e-9,
             "%s: means of frame %d" % (name, f["frame"]))
    for c in j["cameras"]:
        near([c[k] for k in keys], mean_of([v for v in j["views"] if v["camera"] == c["id"]]), 1e-9,
             "%s: means of camera %d" % (name, c["id"]))
    near([1 / j["fps"], 1 / j["fps_draw"]], [j["seconds_decode"] + j["seconds_draw"], j["seconds_draw"]], 1e-9,
         name + ": frames per second from the seconds of one")
    near(j["storage"]["measured_per_frame"] * n_frames, j["storage"]["measured"], 1e-6, name + ": bytes a frame")


def check_eval(name, truth, attributes, n_frames, log, *args):
    """JSON of what was retrained and of its source, as measured apart from pictures; the page."""
    bundle, pictures, page = path(name), path(name + ".pictures"), path(name + ".html")
    text = run("eval", bundle, "-v", "--report", page, "--log", log, "--force", *args)
    fps = tuple(re.search(r"^speed +([0-9.]+) .*, ([0-9.]+) without$", text, re.M).groups())
    shown = re.search(r"<b>([0-9.]+)</b>frames per second", open(page).read()).group(1)
    ok(shown == fps[0] and float(fps[1]) > float(fps[0]), name + ": text and page have the same speed", fps, shown)
    j = json.loads(run("eval", bundle, "--json", "--images", pictures, "--report", page, "--log", log, "--force", *args))
    ok(took > j["seconds_draw"] * len(j["views"]) + j["seconds_decode"] * len(j["frames"]),
       name + ": no more seconds than there were")
    same(text, text_eval(j, True, False, fps), name + ": the text has the figures of --json")
    same(run("eval", bundle, "-q", *args), text_eval(j, False, True, fps), name + ": with -q")
    check_means(j, name, n_frames)
    packed, unpacked = weigh(bundle)
    ok(all(j["storage"][k] == packed[k] and j["storage_unpacked"][k] == unpacked[k] for k in packed), name + ": bytes")
    ok(j["attributes"] == attributes and j["storage"]["measured"] == parts_of(j, attributes), name + ": bytes of " + attributes)
    before = json.loads(run("eval", bundle, "--json", "--source", *args))
    seen, median = sheets(pictures, 160, 3), {}
    ok(sorted(seen) == sorted((v["frame"], v["camera"]) for v in j["views"]), name + ": pictures of all views")
    for camera in {v["camera"] for v in j["views"]}:
        photos = [truth[key][0] for key in sorted(truth) if key[1] == camera]
        median[camera] = np.sort(np.stack(photos), 0)[len(photos) // 2]
    for v, w in zip(j["views"], before["views"]):
        key = v["frame"], v["camera"]
        photo, source, after = seen[key]
        where = moving(truth[key][0], median[v["camera"]])
        near(np.abs(photo - truth[key][0]).max(), 0, 0, "%s: the photograph of %s" % (name, key))
        near([v["psnr"], w["psnr"]], [psnr_of(after, photo), psnr_of(source, photo)], 0.03, "%s: PSNR of %s" % (name, key))
        near(v["psnr_channel_mean"], np.mean([psnr_of(after[..., c], photo[..., c]) for c in range(3)]), 0.03,
             "%s: of its channels" % name)
        near(v["dynamic"], where.mean(), 1e-9, "%s: dynamic share of %s" % (name, key))
        near([v["psnr_dynamic"], v["psnr_static"]], [psnr_of(after, photo, where), psnr_of(after, photo, ~where)], 0.05,
             "%s: PSNR there and elsewhere" % name)
    return j, before, seen


def fast_windows(truth, views):
    """The windows of fast motion as motion_crops.h says, of the frames of the clip."""
    order = sorted({f for f, _ in views})
    found = []
    for i, (frame, camera) in enumerate(views):
        k = order.index(frame)
        if k == 0 or k == len(order) - 1:
            continue
        now, a, b = (truth[order[q], camera][0] / 255.0 for q in (k, k - 1, k + 1))
        v = np.minimum(np.abs(now - a).max(2), np.abs(now - b).max(2)) - np.abs(a - b).max(2)
        speed = np.where(v > 20 / 255, v, 0)
        h, w = speed.shape
        core, best = max(8, h // 9), (0, 0, 0)
        area = np.pad(speed.cumsum(0).cumsum(1), ((1, 0), (1, 0)))

        def inside(x, y, side):
            x0, y0, x1, y1 = x.clip(0), y.clip(0), (x + side).clip(0, w), (y + side).clip(0, h)
            return area[y1, x1] - area[y1, x0] - area[y0, x1] + area[y0, x0]

        y, x = np.mgrid[0:h - core + 1:2, 0:w - core + 1:2]
        inner = inside(x, y, core)
        score = inner - 0.25 * (inside(x - core, y - core, 3 * core) - inner)
        at = np.unravel_index(np.argmax(score), score.shape)
        if score[at] > 0:
            best = score[at], int(np.clip(x[at] - core, 0, w - 3 * core)), int(np.clip(y[at] - core, 0, h - 3 * core))
        if best[0] > 0:
            found.append((best[0], i, best[1], best[2], 3 * core, k, camera))
    chosen = []
    for f in sorted(found, key=lambda f: -f[0]):
        if len(chosen) < 6 and not any(c[6] == f[6] and abs(c[5] - f[5]) <= 1 for c in chosen):
            chosen.append(f)
    return [(i, x, y, side, side) for _, i, x, y, side, _, _ in chosen]


def worst_views(views):
    out, order = [], sorted(range(len(views)), key=lambda i: views[i]["psnr"])
    for once in (True, False):
        for i in order:
            if len(out) < 4 and i not in out and not (once and any(
                    views[o]["camera"] == views[i]["camera"] for o in out)):
                out.append(i)
    return out


def read_charts(page):
    """{title: {line: [(x, y)]}} of the points; sees that points lie on their axes and lines."""
    out = {}
    for title, body in re.findall(r"<figcaption>(.*?)</figcaption>\n(.*?)</svg></figure>", page, re.S):
        ticks = {axis: [(float(at), float(value)) for at, value in re.findall(pattern, body)] for axis, pattern in (
            ("y", r'<line class="grid"[^>]* y2="([0-9.-]+)"/><text[^>]*>([0-9.e+-]+)</text>'),
            ("x", r'<line class="tick" x1="([0-9.-]+)"[^>]*/><text[^>]*>([0-9.e+-]+)</text>'))}
        lines, good = {}, True
        legend = re.findall(r'class="line (line-\d(?: dashed)?)" d="M1 5L25 5"/></svg> (.*?)</span>', body)
        paths = re.findall(r'<path class="line (line-\d(?: dashed)?)" d="(M\d\d[^"]*)"', body)
        for style, x, y, name, vx, vy in re.findall(
                r'<circle class="dot (line-\d)" cx="([0-9.-]+)" cy="([0-9.-]+)" r="3"><title>(.*): ([^,]*), (.*)</title>',
                body):
            lines.setdefault(name, []).append((vx, vy))
            at = len(lines[name]) - 1
            for axis, place, value in (("x", x, vx), ("y", y, vy)):
                (p, a), (q, b) = ticks[axis][0], ticks[axis][-1]
                scale = (q - p) / (b - a) if b != a else 0
                good = good and abs(p + (float(value) - a) * scale - float(place)) < 0.16 + abs(scale) * 1e-4 * abs(float(value))
            style_of, d = paths[list(lines).index(name)]
            if name.startswith(("after", "before")):  # in two colours, what is of dynamic regions dashed
                good = good and style_of == "line-%d%s" % (name[0] == "b", " dashed" * ("dynamic" in name))
            good = good and style_of.split()[0] == style and re.split("[ML]", d)[1:][at] == x + " " + y
        if legend:
            good = good and [n for _, n in legend] == list(lines) and [s for s, _ in legend] == [s for s, _ in paths]
        ok(good, "chart '%s': its points lie on its axes and lines" % title)
        out[title] = lines
    return out


def table_of(page, title):
    body = re.search("<h2>%s</h2>\n.*?<table>(.*?)</table>" % title, page, re.S).group(1)
    return [re.findall(r"<t[hd][^>]*>([^<]*)</t[hd]>", row) for row in body.split("</tr>")[:-1]]


def storage_tile(j):
    return "<div><b>%s</b>attributes per frame</div>" % size(j["storage"]["measured_per_frame"])


def check_page(name, j, before, seen, log, split="test"):
    page, meta, bundle = open(path(name + ".html")).read(), meta_of(path(name)), path(name)
    text = re.sub(r"base64,[^\"]*", "", page)
    stage = meta["trained"] if j["attributes"] == "retrained" else None
    ok("<p>%s attributes, %d %s views of %d frames. From %s.%s</p>" % (
        j["attributes"], len(j["views"]), split, len(j["frames"]), meta["variant"],
        " Dynamic regions: pixels that differ from their camera's median over time.") in text, name + ": the page's first line",
       text[text.index("<h1>"):][:300])
    seconds = log[-1]["seconds"] if log else 0
    if stage:
        o = stage["options"]
        ok("<p>Trained by spin-retrain --iterations %d%s on %s%s; all options are at the end.</p>" % (
            o["iterations"], " --method " + o["method"] if "method" in o else "", stage["device"],
            " in %.1f minutes" % (seconds / 60) if log else "") in text, name + ": how it was trained",
           re.findall("<p>Trained.*", text))
        same(re.search(r"<h2>Options of the run</h2>\n<p>(.*?)</p>", text).group(1),
             ", ".join("%s %.10g" % (k, (stage["field"] or stage)[k]) for k in ("levels", "features", "hidden", "sh_degree")
                       if k in (stage["field"] or {}) or k == "sh_degree") +
             "; trained on " + stage["device"], name + ": its network")
        ok(json.loads(re.search(r"<pre>(.*?)</pre>", text, re.S).group(1).replace("&quot;", '"')) == told_options(stage), name + ": its options")

    # Tiles.
    tiles = [("PSNR", "psnr", 2, " dB"), ("SSIM", "ssim", 4, ""), ("PSNR, dynamic regions", "psnr_dynamic", 2, " dB"),
             ("PSNR, static regions", "psnr_static", 2, " dB")]
    want = ["<div><b>%.*f%s</b>%s%s</div>" % (digits, j[key], unit, label, "<br><span>before %.*f</span>" % (
        digits, before[key]) if before else "") for label, key, digits, unit in tiles]
    if j["background_shows"]:
        want += ["<div><b>%.2f dB</b>PSNR over the opposite background</div>" % j["psnr_opposite"]]
    want += ["<div><b>%.2f</b>frames per second</div>" % j["fps"], storage_tile(j)]
    same("\n".join(re.findall(r"<div><b>.*", text)), "\n".join(want), name + ": the tiles")

    # Curves.
    charts = read_charts(text)
    curves = {}
    for label, r in (("after", j), ("before", before)):
        for more, key in (("", "psnr"), (", dynamic", "psnr_dynamic")):
            if r:
                curves[label + more] = [("%.7g" % f["frame"], "%.5g" % f[key]) for f in r["frames"]]
    ok(charts.get("PSNR over the frames") == curves, name + ": curves over the frames", charts.get("PSNR over the frames"), curves)
    tests, steps = ([x for x in log or () if key in x] for key in ("test_psnr", "loss"))
    if log:
        want = {"Test PSNR over the iterations": {"test PSNR": [("%.7g" % x["iteration"], "%.5g" % x["test_psnr"]) for x in tests]},
                "Test PSNR over time": {"test PSNR": [("%.7g" % (x["seconds"] / 60), "%.5g" % x["test_psnr"]) for x in tests]},
                "Training loss, averaged over intervals": {"loss": [("%.7g" % x["iteration"], "%.5g" % x["loss"]) for x in steps]}}
        for title in want:
            ok(charts.get(title) == want[title], "%s: %s" % (name, title), charts.get(title), want[title])

    # The cameras.
    two = [r for r in (before, j) if r]
    table = [["camera", "PSNR", "SSIM", "PSNR, dynamic"]]
    table += [["", "before", "after", "gain"] + ["before", "after"] * 2] if before else []
    for k, c in enumerate(j["cameras"] + [dict(j, id="all")]):
        of = [(r["cameras"] + [r])[k] for r in two]
        table += [[str(c["id"])] + ["%.2f" % q["psnr"] for q in of] + (
            ["%+.2f" % (of[1]["psnr"] - of[0]["psnr"])] if before else []) + ["%.4f" % q["ssim"] for q in of] + [
            "%.2f" % q["psnr_dynamic"] for q in of]]
    ok(table_of(text, "Cameras") == table, name + ": the table of cameras", table_of(text, "Cameras"), table)

    # Pictures.
    views = [(v["frame"], v["camera"]) for v in j["views"]]
    want = fast_windows(seen, views)
    ok(len(want) > 0, name + ": something moves")
    want += [(i, 0, 0, 160, 90) for i in worst_views(j["views"])]
    rows = re.findall(r'<p>Frame (\d+), camera (\d+): ([0-9.-]+) dB(?:, before ([0-9.-]+))?</p>\n<div class="row"[^>]*>\n(.*?)</div>',
                      page, re.S)
    ok([(int(f), int(c), a, b) for f, c, a, b, _ in rows] == [
        (*views[i], "%.2f" % j["views"][i]["psnr"], "%.2f" % before["views"][i]["psnr"] if before else "") for i, *_ in want],
       name + ": the rows of pictures and their figures", [r[:4] for r in rows], want)
    for (f, c, _, _, body), (i, x, y, w, h) in zip(rows, want):
        photo, source, after = (p[y:y + h, x:x + w] for p in seen[views[i]])
        pictures = [photo] + ([source] if before else []) + [after, np.minimum(255, 4 * np.abs(after - photo))]
        got = [read_png(base64.b64decode(data)) for data in re.findall(r"base64,([^\"]*)", body)]
        sides = [tuple(map(int, s)) for s in re.findall(r'width="(\d+)" height="(\d+)"', body)]
        ok(sides == [(w, h)] * len(pictures) and len(got) == len(pictures) and all(
            g.shape == p.shape and np.abs(g - p).max() <= most for g, p, most in zip(
                got, pictures, [0] + [1] * (len(pictures) - 2) + [5])),
           "%s: pictures of frame %s, camera %s" % (name, f, c), sides, [g.shape for g in got])

    # The file.
    packed, unpacked = weigh(bundle)
    want = [["part", "in the file, MB", "unpacked, MB"]] + [
        [label, "%.2f" % (packed[k] / 1e6), "%.2f" % (unpacked[k] / 1e6)] for label, k in (
            ("source", "source"), ("refined frames", "refined"), ("per-frame values", "positions"), ("tracks", "tracks"),
            ("table", "table"), ("heads", "heads"), ("whole file", "file")) if unpacked[k]]
    ok(table_of(text, "Storage") == want, name + ": the table of storage", table_of(text, "Storage"), want)


# ---- spin-export ----------------------------------------------------------------------------------

PARTS = [("position", "place"), ("log scale", "log_scale"), ("rotation (degrees)", "rotation_deg"), ("opacity", "opacity"),
         ("colour", "colour"), ("sh", "sh")]


def text_export(j):
    t = ["%s: %s as %s, %s splats each%s%s" % (
        j["output"], some(j["frames"], "frame"), j["to"], mean(j["splats_mean"]),
        ", " + size(j["bytes"]) if j["bytes"] else "", "".join(
            ", %d splats %s" % (j[k], word) for k, word in (("filtered", "filtered out"), ("left_out", "left out")) if j[k]))]
    c = j["check"]
    if c:
        t += ["read back: %s, %d splats; bounding boxes differ by %.3g at most" % (some(c["frames"], "frame"), c["splats"], c["bounds"])]
        t += ["  %-20s error %.3g rms, %.3g at most" % (label, c[key]["rms"], c[key]["largest"]) for label, key in PARTS]
        if c["place_sizes"]:
            pixels = ", %.3g pixels of the data set's cameras" % c["place_pixels"] if c["place_pixels"] else ""
            t.insert(-5, "                       %.3g of the splat's size at most%s" % (c["place_sizes"], pixels))
        if c["sh_lost"]:
            t += ["  sh                   lost in %d of %d splats, which %s does not store" % (c["sh_lost"], c["splats"], j["to"])]
        t += ["frame %d rendered from the file: %s the bundle's own render" % (
            c["rendered"], "%.2f dB against" % c["psnr"] if c["psnr"] is not None else "")]
    return "\n".join(t).replace(":  the", ": the")


def count_in(file):
    """Splats of a file, as its own format counts them."""
    with open(file, "rb") as f:
        data = f.read()
    if file.endswith(".ply"):
        return int(re.search(rb"element vertex (\d+)", data).group(1))
    if file.endswith(".splat"):
        return len(data) // 32
    if file.endswith(".spz"):
        return struct.unpack("<I", zlib.decompress(data, 31)[8:12])[0]
    if file.endswith(".glb"):
        j = json.loads(data[20:20 + struct.unpack("<I", data[12:16])[0]])
        return j["accessors"][j["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]["count"]
    with zipfile.ZipFile(file) as z:
        return json.loads(z.read("meta.json"))["count"]


def check_folder(name, fmt, frames, counts, retrained, *args):
    """frames: [(number, time)] that are written, with these counts of splats."""
    out = path("out-" + fmt)
    if fmt == "sog" and "libwebp" in subprocess.run([os.path.join(BIN, "spin-export"), path(name), "--to", "sog", "-o", out,
                                                     *args], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, universal_newlines=True).stderr:
        return None
    text = run("export", path(name), "--to", fmt, "-o", out, "--check", "--fps", "12.5", "--force", *args)
    told, j = said, json.loads(run("export", path(name), "--to", fmt, "-o", out, "--check", "--fps", "12.5", "--force",
                                   "--json", *args))
    same(text, text_export(j), "%s: the text has the figures of --json" % fmt)
    with open(os.path.join(out, "sequence.json")) as f:
        s = json.load(f)
    files = [os.path.join(out, f["file"]) for f in s["frames"]]
    ok(sorted(os.listdir(out)) == sorted([f["file"] for f in s["frames"]] + ["sequence.json"]), fmt + ": every file is named")
    ok([(f["frame"], f["time"]) for f in s["frames"]] == frames and all(
        f["file"].startswith("frame_%05d." % f["frame"]) for f in s["frames"]), fmt + ": with number and time", s["frames"])
    ok([f["splats"] for f in s["frames"]] == [count_in(f) for f in files] == counts, fmt + ": and the splats that it holds",
       s["frames"], counts)
    ok((s["format"], s["source"], s["retrained"], s["fps"], s["turned_by"]) == (
        fmt, "ply", retrained, 12.5, {"gltf": [0, 0, 0, 1], "spz": s["turned_by"], "sog": s["turned_by"]}.get(
            fmt, [1, 0, 0, 0])), fmt + ": what sequence.json says of all", {k: s[k] for k in s if k != "frames"})
    of_frames = sum(map(os.path.getsize, files))  # what is announced
    written = of_frames + os.path.getsize(os.path.join(os.path.dirname(files[0]), "sequence.json"))
    ok(j["bytes"] == written, fmt + ": bytes", j["bytes"], written)
    near([j["frames"], j["splats_mean"]], [len(frames), np.mean(counts)], 1e-9,
         fmt + ": frames and splats")
    ok((j["check"]["frames"], j["check"]["splats"]) == (len(frames), sum(counts)), fmt + ": what was read back", j["check"])
    ok(j["check"]["rendered"] == frames[len(frames) // 2][0], fmt + ": and rendered", j["check"]["rendered"])
    got = re.search(r"^writing (.*) to '(.*)': (at most )?(.*)$", told, re.M)
    ok(got and got.group(1) == some(len(frames), "frame") and got.group(2) == out, fmt + ": says what it writes", told)
    if got and not got.group(3):
        of_json = 2048 * len(frames) if fmt == "gltf" else 0
        ok(got.group(4) in [size(of_frames + n) for n in range(0, of_json + 1, 64)], fmt + ": and how much",
           got.group(4), size(written))
    elif got:
        most, unit = got.group(4).split()
        most = float(most) * {"bytes": 1, "kB": 1e3, "MB": 1e6}[unit]
        ok(0.4 * most < written < 1.005 * most, fmt + ": and how much at most", got.group(4), size(written))
    rounds = re.search("^%s rounds values; rms error \\(largest error in parentheses\\): (.*)$" % fmt, told, re.M)
    if rounds:
        pairs = re.findall(r"(position|log scale|rotation|opacity|colour|sh) ([0-9.e-]+)(?: deg)? \(([0-9.e-]+)(?: deg)?\)",
                           rounds.group(1))
        ok(len(pairs) == 6 and all(
            abs(float(g) - j["check"][k][w]) <= 0.06 * j["check"][k][w] + 1e-6 for (_, a, b), (_, k) in zip(pairs, PARTS)
            for g, w in ((a, "rms"), (b, "largest"))), fmt + ": its errors", rounds.group(1), j["check"])
    return j


def unit(q):
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def check_errors(frames):
    """What .splat loses, worked out from its bytes."""
    j = json.loads(run("export", path("all.spin"), "--to", "splat", "-o", path("lost"), "--check", "--json"))
    parts = {k: [] for _, k in PARTS[:5]}
    for n, rows in zip(FRAMES, frames):
        raw = np.fromfile(path("lost/frame_%05d.splat" % n), np.uint8).reshape(-1, 32)
        place, scale = raw[:, :12].copy().view("<f4"), raw[:, 12:24].copy().view("<f4")
        turn = unit(raw[:, 28:].astype(float) - 128)
        rows = rows.astype(float)
        key = np.lexsort(rows[:, :3].T), np.lexsort(place.T)  # the format may sort
        a, b = key
        cos = np.abs((unit(rows[a, 19:]) * turn[b]).sum(1)).clip(0, 1)
        parts["place"] += [np.abs(rows[a, :3] - place[b]).ravel()]
        parts["log_scale"] += [np.abs(rows[a, 16:19] - np.log(scale[b])).ravel()]
        parts["rotation_deg"] += [np.degrees(2 * np.arccos(cos))]
        parts["opacity"] += [np.abs(1 / (1 + np.exp(-rows[a, 15])) - raw[b, 27] / 255)]
        parts["colour"] += [np.abs((0.5 + 0.28209479177387814 * rows[a, 3:6]).clip(0, 1) - raw[b, 24:27] / 255).ravel()]
    for key in parts:
        e = np.concatenate(parts[key])
        near([j["check"][key]["rms"], j["check"][key]["largest"]], [math.sqrt(np.mean(e * e)), e.max()],
             0.01 * e.max() + 1e-5, "splat: error of %s" % key)


def check_export(frames, kept):
    """kept: splats of the retrained frames."""
    times = {n: k for k, n in enumerate(FRAMES)}
    for fmt in ("ply", "compressed-ply", "splat", "spz", "gltf", "sog"):
        check_folder("tracks.spin", fmt, [(n, times[n]) for n in FRAMES[1:]], kept[1:], True, "--range", "9:14")
    part = [(n, times[n]) for n in (10, 12)]
    for fmt in ("ply", "splat"):
        subprocess.run(["rm", "-r", path("out-" + fmt)])
        check_folder("tracks.spin", fmt, part, [len(frames[times[n]]) for n, _ in part], False, "--source", "--range", "10:13:2")
    subprocess.run(["rm", "-r", path("out-ply")])
    solid = [int((1 / (1 + np.exp(-f[:, 15].astype(float))) >= 0.6).sum()) for f in frames]
    check_folder("tracks.spin", "ply", part, [solid[times[n]] for n, _ in part], False, "--source", "--range", "10:13:2",
                 "--min-opacity", "0.6")
    check_errors(frames)
    text = run("export", path("tracks.spin"), "-o", path("clip.html"))
    told, j = said, json.loads(run("export", path("tracks.spin"), "-o", path("clip.html"), "--force", "--json"))
    same(text, text_export(j), "html: the text has the figures of --json")
    near([j["frames"], j["splats_mean"]], [5, np.mean(kept)], 1e-9, "html: frames and splats")
    ok(j["bytes"] == os.path.getsize(path("clip.html")), "html: bytes", j["bytes"])
    ok("html: %d splats of 5 frames and 2 versions, " % (sum(kept) + sum(map(len, frames))) in told,
       "html: says what is in the page", told)
    text = run("export", path("tracks.spin"), "-o", path("clip.glb"), "--range", "10:14")
    j = json.loads(run("export", path("tracks.spin"), "-o", path("clip.glb"), "--range", "10:14", "--force", "--json"))
    same(text, text_export(j), "glb: the text has the figures of --json")
    most = re.findall(r"^writing 3 frames to '.*': at most ([0-9.]+) kB$", said, re.M)
    ok(most and 1000 * (float(most[0]) + 0.5) >= j["bytes"], "glb: says how much at most", said)
    ok(j["bytes"] == os.path.getsize(path("clip.glb")) and j["frames"] == 3, "glb: bytes and frames", j)


def check_lists():
    text, j = run("import", "--list"), json.loads(run("import", "--list", "--json"))
    t = []
    for i in j:
        t += ["%-16s %-6s %s" % (i["name"], "tracks" if i["tracks"] else "views", i["summary"])]
        t += ["%-16s %-6s %s" % ("", "", i["upstream"])] if i["upstream"] else []
    same(text, "\n".join(t), "spin-import --list: the text is that of --json")
    same(run("export", "--list"), "\n".join("%-16s %s" % (i["name"], i["summary"]) for i in
                                            json.loads(run("export", "--list", "--json"))), "spin-export --list")


# ---- All ------------------------------------------------------------------------------------------


def main():
    only, tracks = os.environ.get("TAP_PART"), path("tracks.spin")
    of_tracks = "--iterations 9 --eval-every 4 --scale 0.5".split()
    small = "--levels 2 --hash-log2 18 --hidden 16 --base-resolution 24,24,24,2 --finest-resolution 48,48,48,2 --scale 0.5"
    frames = make_source()
    run("import", path("run"), "--data", CLIP, "-o", path("all.spin"))
    if only in (None, "imports"):
        check_import(frames)
        check_cameras(frames)
        check_bundle("in.spin", frames[1:], {})
        check_lists()
    if only in (None, "plans"):
        check_plans(frames)
    if only in (None, "retrains"):
        check_retrain("tracks.spin", frames, *of_tracks)
        check_retrain("net.spin", frames, "--preset", "paper", "--iterations", "5", "--eval-every", "2", "--refine", "4",
                      "--sh-degree", "1", *small.split())
        check_retrain("apart.spin", frames, "--method", "frames", "--refine", "5", "--scale", "0.5")
        refined = {n: [f["n"] for f in meta_of(path(n))["refined"]["frames"]] for n in ("net.spin", "apart.spin")}
        check_bundle("net.spin", frames, {"refined": refined["net.spin"], "trained": refined["net.spin"]})
        check_bundle("apart.spin", frames, {"refined": refined["apart.spin"]})
    else:
        run("retrain", path("all.spin"), "-o", tracks, "--device", "cpu", "--log", tracks + ".log", *of_tracks)
    kept = [int(n) for n in meta_of(tracks)["trained"]["splats"]]
    if only in (None, "retrains"):
        check_bundle("tracks.spin", frames, {"trained": kept})
    if only in (None, "pages"):
        run("import", CLIP, "--data", CLIP, "-o", path("court.spin"))  # with all frames of the data set, counted from 0
        run("eval", path("court.spin"), "--images", path("photos"))
        truth = {(8 + f, c): pictures for (f, c), pictures in sheets(path("photos"), 160, 2).items()}
        log = read_log(tracks + ".log")
        for x in log:
            x["seconds"] = 700 * x["seconds"]  # minutes that show
        with open(path("hours.log"), "w") as f:
            f.writelines(json.dumps(x) + "\n" for x in log)
        j, before, seen = check_eval("tracks.spin", truth, "retrained", len(frames), path("hours.log"), "--range", "9:14")
        check_page("tracks.spin", j, before, seen, log)
        net, page = path("small.spin"), path("small.html")
        run("retrain", path("all.spin"), "-o", net, "--device", "cpu", "--preset", "paper", "--iterations", "1",
            *"--levels 2 --hash-log2 8 --hidden 16 --finest-resolution 16 --scale 0.5".split())
        j = json.loads(run("eval", net, "--report", page, "--json"))
        ok(j["storage"]["heads"] > j["storage"]["measured"] / 200 and storage_tile(j) in open(page).read() and
           j["storage"]["measured"] == parts_of(j, "retrained"), "small.spin: the tile of a network's storage")
    if only in (None, "exports"):
        check_export(frames, kept)
    print("1..%d" % count)
    sys.exit(failed > 0)


main()
