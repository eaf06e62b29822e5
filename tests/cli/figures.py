"""figures.py BIN CLIP WORK: the checks of t9005-figures.sh. Numbers that a command or the report
page prints must equal those of --json. The numbers of --json are computed a second time with NumPy
from the source, the bundle, the images and the output: counts, bounds, ranges, shares of points in
view, bytes, losses, PSNR, dynamic regions and the errors of a format."""
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


# ---- TAP -----------------------------------------------------------------------------------------


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
    """Compares two texts line by line and reports the lines that differ."""
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


# ---- Commands ------------------------------------------------------------------------------------


def path(name):
    return os.path.join(WORK, name)


def run(command, *args, code=0):
    """Returns stdout; stderr is kept in `said`."""
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
    """The report as text and as JSON."""
    text = run(command, *args)
    return text, json.loads(run(command, *args, "--force", "--json"))


# ---- Formatting of figures -----------------------------------------------------------------------


def size(n):
    """Bytes in powers of 1000, with three significant digits."""
    u = 0
    while n >= 999.5:
        n, u = n / 1000, u + 1
    return "%.3g %s" % (math.floor(n) if u == 0 else n, ["bytes", "kB", "MB", "GB", "TB"][u])


def leaves(j):
    """All scalars in a JSON value."""
    return [x for v in (j.values() if isinstance(j, dict) else j) for x in leaves(v)] if isinstance(j, (dict, list)) else [j]


NUMBER = r"(?<![\w.-])-?\d[\d.]*(?:e[-+]\d+)?(?!\w)"


def shown(text, j, name, *more):
    """Every number of at least two digits in the text occurs in the JSON: rounded, as a percentage,
    as bytes in another unit, as minutes, as the exponential or the sigmoid of a logarithm, or
    inside a string."""
    have = {n for x in leaves(j) if isinstance(x, str) for n in re.findall(NUMBER, x)}
    for x in [x for x in leaves(j) if isinstance(x, (int, float)) and not isinstance(x, bool)] + list(more):
        of = [x, 100 * x, x / 1e3, x / 1e6, x / 1e9, x / 60]
        of += [math.exp(x), 1 / (1 + math.exp(-x))] if abs(x) < 50 else []
        have |= {pattern % y for y in of for pattern in
                 ("%.0f", "%.1f", "%.2f", "%.3f", "%.4f", "%.3g", "%.4g", "%.5g", "%.6g", "%.10g", "%.15g")}
    odd = [n for n in re.findall(NUMBER, re.sub(r"'[^']*'|/\S*", "", text)) if len(n.strip("-.")) > 1 and
           n not in have and n.rstrip(".") not in have]
    ok(not odd, name, odd, text)


# ---- Readers of the source, the images and the bundle, independent of the product ----------------

FRAMES = [8, 9, 10, 12, 13]  # numbers of the data set's frames; 11 is missing
NAMES = ["x", "y", "z"] + ["f_dc_%d" % i for i in range(3)] + ["f_rest_%d" % i for i in range(9)] + [
    "opacity"] + ["scale_%d" % i for i in range(3)] + ["rot_%d" % i for i in range(4)]


def make_source():
    """The PLY frames of the clip, with SH degree 1; both splats and counts differ from frame to
    frame."""
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
    """An 8-bit image as [h][w][3]; colour or greyscale, not interlaced."""
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
    """{(frame, camera): images} of what spin-eval --images wrote: n side by side, 4 pixels
    apart."""
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
    """How many of the eight neighbours of each pixel are set."""
    p = np.pad(map.astype(int), 1)
    h, w = map.shape
    return sum(p[1 + y:1 + y + h, 1 + x:1 + x + w] for y in (-1, 0, 1) for x in (-1, 0, 1)) - map


def moving(truth, median):
    """The dynamic region: pixels that differ from the median, without isolated ones, dilated by one
    pixel."""
    mask = np.abs(truth.astype("f4") / np.float32(255) - median.astype("f4") / np.float32(255)).max(2) > np.float32(20 / 255)
    kept = mask & (around(mask) >= 4)
    return kept | (around(kept) > 0)


def sizes_of_parts(bundle):
    """Packed and unpacked bytes of each part, by the names of the zip members."""
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


# ---- spin-import ---------------------------------------------------------------------------------


def counts_are(j, frames, name):
    n = [len(f) for f in frames]
    ok(j["splats"] == {"min": min(n), "mean": np.mean(n), "max": max(n)}, name, j["splats"], n)


def check_import(frames):
    text, j = both("import", "--info", path("run"))
    shown(text, j, "--info of a run: the text has the figures of --json")
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
        # The median of at most 65536 values, taken evenly from all frames and all components.
        steps = [-(-v.size // (65536 // 5)) for v in values]
        steps = [next(k for k in range(step, step + 60) if k == 1 or k % 2 and k % 3 and k % 5) for step in steps]
        some_of = np.sort(np.concatenate([v.ravel()[::k] for k, v in zip(steps, values)]))
        near([r["min"], r["median"], r["max"]], [min(v.min() for v in values), some_of[len(some_of) // 2],
                                                 max(v.max() for v in values)], 1e-6, name)

    source = ["import", path("run"), "--data", CLIP, "--force"]
    text, j = both(*source, "-o", path("all.spin"))
    shown(text, j, "an import: the text has the figures of --json")
    counts_are(j, frames, "splats of what was imported")
    text, j = both(*source, "--range", "9:14", "-o", path("in.spin"))
    shown(text, j, "an import of a range")
    counts_are(j, frames[1:], "splats of that range")
    near([j["bounds"]["min"], j["bounds"]["max"]], [np.concatenate(frames[1:])[:, :3].min(0),
                                                    np.concatenate(frames[1:])[:, :3].max(0)], 0, "and its bounds")
    ok(j["numbers"] == [9, 13] and j["times"] == [1, 4], "its numbers and times", j["numbers"], j["times"])


def check_cameras(frames):
    """The shares of points in front of each camera and inside its image, for a moving rig."""
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
    shown(text, j, "--check-cameras: the text has the figures of --json")

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


# ---- --info of a bundle --------------------------------------------------------------------------


def reported_options(stage):
    """The entries reported of a stage in meta.json; a network only if one was trained."""
    network = ("levels features hash_log2 hidden base_resolution finest_resolution residual init_log_scale hash_init_range "
               "lr_table lr_sh lr_scale lr_rotation lr_opacity lr_head_factor relu activation normalise normalise_centre "
               "normalise_radius network_start").split()
    return {k: v for k, v in stage["options"].items() if stage.get("field") or "tracks" not in stage or k not in network}


def check_bundle(name, source, stages):
    """stages: the splats of every frame, by stage."""
    bundle = path(name)
    text, j = both("import", "--info", bundle)
    meta = meta_of(bundle)
    with zipfile.ZipFile(bundle) as z:
        has_table = "trained/table.npy" in z.namelist()
    for stage in stages:
        ok(j[stage]["options"] == reported_options(meta[stage]) and j[stage]["antialias"] == meta[stage].get("antialias", False),
           "%s: settings of %s" % (name, stage))
        n = stages[stage]
        ok(j[stage]["splats"] == {"min": min(n), "mean": np.mean(n), "max": max(n)}, "%s: splats of %s" % (name, stage),
           j[stage]["splats"], n)
    shown(text, j, "--info of %s: the text has the figures of --json" % name)
    ok(j["numbers"] == [FRAMES[-len(source)], FRAMES[-1]], "%s: numbers of the frames" % name, j["numbers"])
    counts_are(j, source, "%s: splats of the source" % name)
    packed, unpacked = sizes_of_parts(bundle)
    if has_table:
        field = meta["trained"]["field"]
        ok(j["trained"]["field"]["rows"] == field["offset"][field["levels"]], "%s: rows of its table" % name)
    ok(j["bytes"] == packed, "%s: bytes of its parts" % name, j["bytes"], packed)
    ok(j["bytes_unpacked"] == unpacked, "%s: unpacked" % name, j["bytes_unpacked"], unpacked)
    return j


# ---- spin-retrain --------------------------------------------------------------------------------


def quality(name, q):
    return "%-10s  %8.3f  %7.4f" % (name, q["psnr"], q["ssim"]) if q else "%-10s  %8s  %7s" % (name, "-", "-")


def check_retrain(name, frames, *args):
    """Retrains with these options and returns the JSON and the log."""
    out, log = path(name), path(name + ".log")
    j = json.loads(run("retrain", path("all.spin"), "-o", out, "--device", "cpu", "--log", log, "--json", "-v", *args))
    lines, by_frame = read_log(log), j["method"] == "frames"
    check_said(name, said, j, lines, [len(f) for f in frames])
    refine, steps = j.get("refine_seconds", 0), [x for x in lines if "loss" in x and "iteration" in x]
    tests = [x for x in lines if "test_psnr" in x]
    per = j["frames"] * j["iterations"] if by_frame else j["iterations"]
    near((j["seconds"] - (0 if by_frame else refine)) / per, j["seconds_per_iteration"], 1e-9, "%s: seconds each" % name)
    if by_frame:
        return j, lines
    ok([x["iteration"] for x in steps] == list(range(1, j["iterations"] + 1)), "%s: a line of the log for every step" % name)
    ok(steps[-1]["seconds"] - 0.002 <= j["seconds"] <= tests[-1]["seconds"] + 0.002 and j["seconds"] >= refine,
       "%s: seconds are those of the log" % name, j["seconds"], steps[-1], tests)
    smooth = 0
    for x in steps:
        smooth = 0.98 * smooth + 0.02 * x["loss"] if smooth > 0 else x["loss"]
    near(j["loss"], smooth, 1e-5, "%s: the loss is the log's, smoothed" % name)
    near([x["loss"] for x in steps], [0.8 * x["l1"] + 0.2 * (1 - x["ssim"]) for x in steps], 2e-3,
         "%s: the loss of a step is made of its L1 and SSIM" % name)
    near([tests[-1]["test_psnr"], tests[-1]["test_ssim"]], [j["test"]["psnr"], j["test"]["ssim"]], 1e-6,
         "%s: the last measurement of the log" % name)
    views = {tuple(v) for x in steps for v in x["views"]}
    ok({f for f, _ in views} <= set(FRAMES) and {c for _, c in views} <= {3, 7, 12, 19, 23, 27},
       "%s: the log names frames and cameras by their numbers" % name, views)
    return j, lines


def check_said(name, told, j, lines, sizes):
    """The lines of a -v run on stderr: refined frames, and the numbers of splats and views."""
    became = re.findall(r"^frame (\d+): (\d+) splats became (\d+), loss ([0-9.]+) became ([0-9.]+)$", told, re.M)
    ok(sorted((int(f), int(n)) for f, n, _, _, _ in became) == (list(zip(FRAMES, sizes)) if j["refine"] else []),
       "%s: a line for every refined frame, with its number and its splats" % name, told)
    for f, _, n, first, last in became:
        of = [x for x in lines if "refine" in x and x["views"][0][0] == int(f)]
        ok([x["refine"] for x in of] == list(range(1, j["refine"] + 1)) and (first, last, int(n)) == (
            "%.4f" % of[0]["loss"], "%.4f" % of[-1]["loss"], of[-1]["splats"]), "%s: the log of frame %s" % (name, f), became)
    ok("5 frames, %.0f splats a frame, 30 training and 10 test views" % (
        j["splats_mean"] if j["refine"] else np.mean(sizes)) in told, "%s: says what it works on" % name, told)


def check_text(frames):
    """What a training prints without --json."""
    text = run("retrain", path("all.spin"), "-o", path("text.spin"), "--device", "cpu", "--refine", "2", *"--method frames".split())
    j = json.loads(run("retrain", path("all.spin"), "-o", path("text.spin"), "--device", "cpu", "--refine", "2", "--method",
                       "frames", "--json", "--force"))
    seconds = re.search(r" in ([0-9.]+) s \(([0-9.e-]+) s each\)", text)
    shown(text, j, "a retraining: the text has the figures of --json", *map(float, seconds.groups()))
    same(re.sub(r".*\n.*\n", "", text, 1), quality("before", j["before"]) + "\n" + quality("after", j["test"]), "its table")


def read_log(log):
    with open(log) as f:
        return [json.loads(line) for line in f]


# ---- spin-eval and the page ----------------------------------------------------------------------


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
        what = ("alpha", "the alpha of the splats differs from that of the images") if j["alpha_known"] else \
            ("holes", "the splats are transparent in places")
        t += ["%s    PSNR %.3f over the opposite background: %s" % (what[0], j["psnr_opposite"], what[1])]
    t += ["speed    %s frames per second with decoding, %s without" % fps]
    return "\n".join(t + ["size     %s on disk, %s unpacked; %s for the measured attributes, %s per frame" % (
        size(j["storage"]["file"]), size(j["storage_unpacked"]["file"]), size(j["storage"]["measured"]),
        size(j["storage"]["measured_per_frame"]))])


def check_means(j, name, n_frames):
    """Averages the views by frame, by camera and over all. The bundle has n_frames, whichever are
    measured."""
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
    """The JSON of the retrained clip and of its source against measurements of the images; then the
    page."""
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
    packed, unpacked = sizes_of_parts(bundle)
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


def read_charts(page):
    """{title: {line: [(x, y)]}} of the points; checks that points lie on their axes and lines."""
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
        " Dynamic regions: pixels that differ from the median of their camera's images over time.") in text, name + ": the page's first line",
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
        ok(json.loads(re.search(r"<pre>(.*?)</pre>", text, re.S).group(1).replace("&quot;", '"')) == reported_options(stage), name + ": its options")

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

    # Images: whole views, among them the worst, and crops of views in which something moves.
    worst = min(j["views"], key=lambda v: v["psnr"])
    rows, whole = re.findall(
        r'<p>Frame (\d+), camera (\d+): ([0-9.-]+) dB(?:, before ([0-9.-]+))?</p>\n<div class="row"[^>]*>\n(.*?)</div>', page,
        re.S), set()
    for f, c, a, b, body in rows:
        at = [(v["frame"], v["camera"]) for v in j["views"]].index((int(f), int(c)))
        ok((a, b) == tuple("%.2f" % r["views"][at]["psnr"] for r in (j, before)), "%s: figures of %s, %s" % (name, f, c), a, b)
        got = [read_png(base64.b64decode(data)) for data in re.findall(r"base64,([^\"]*)", body)]
        photo, source, after = seen[int(f), int(c)]
        h, w = got[0].shape[:2]
        x, y = next(((x, y) for y in range(91 - h) for x in range(161 - w)
                     if np.array_equal(photo[y:y + h, x:x + w], got[0])), (0, 0))
        want = [p[y:y + h, x:x + w] for p in (photo, source, after, np.minimum(255, 4 * np.abs(after - photo)))]
        ok(len(got) == 4 and all(g.shape == p.shape and np.abs(g - p).max() <= most for g, p, most in zip(
            got, want, (0, 1, 1, 5))), "%s: pictures of frame %s, camera %s" % (name, f, c), [g.shape for g in got])
        whole |= {(int(f), int(c))} if w == 160 else set()
    ok((worst["frame"], worst["camera"]) in whole and len(rows) > len(whole), name + ": the worst view, and sections")

    # The file.
    packed, unpacked = sizes_of_parts(bundle)
    want = [["part", "in the file, MB", "unpacked, MB"]] + [
        [label, "%.2f" % (packed[k] / 1e6), "%.2f" % (unpacked[k] / 1e6)] for label, k in (
            ("source", "source"), ("refined frames", "refined"), ("per-frame values", "positions"), ("tracks", "tracks"),
            ("table", "table"), ("heads", "heads"), ("whole file", "file")) if unpacked[k]]
    ok(table_of(text, "Storage") == want, name + ": the table of storage", table_of(text, "Storage"), want)


# ---- spin-export ---------------------------------------------------------------------------------

PARTS = ["place", "log_scale", "rotation_deg", "opacity", "colour"]


def count_in(file):
    """The number of splats in a file, as its own format counts them."""
    with open(file, "rb") as f:
        data = f.read()
    if file.endswith(".ply"):
        return int(re.search(rb"element vertex (\d+)", data).group(1))
    if file.endswith(".splat"):
        return len(data) // 32
    if file.endswith(".spz"):
        return struct.unpack("<I", data[8:12])[0]
    if file.endswith(".glb"):
        j = json.loads(data[20:20 + struct.unpack("<I", data[12:16])[0]])
        return j["accessors"][j["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]["count"]
    with zipfile.ZipFile(file) as z:
        return json.loads(z.read("meta.json"))["count"]


def check_folder(name, fmt, frames, counts, retrained, *args):
    """frames: the [(number, time)] written, with their counts of splats."""
    out = path("out-" + fmt)
    if fmt == "sog" and "libwebp" in subprocess.run([os.path.join(BIN, "spin-export"), path(name), "--to", "sog", "-o", out,
                                                     *args], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, universal_newlines=True).stderr:
        return
    text, j = both("export", path(name), "--to", fmt, "-o", out, "--check", "--fps", "12.5", "--force", *args)
    shown(text, j, "%s: the text has the figures of --json" % fmt)
    with open(os.path.join(out, "sequence.json")) as f:
        s = json.load(f)
    files = [os.path.join(out, f["file"]) for f in s["frames"]]
    ok(sorted(os.listdir(out)) == sorted([f["file"] for f in s["frames"]] + ["sequence.json"]), fmt + ": every file is named")
    ok([(f["frame"], f["time"]) for f in s["frames"]] == frames and all(
        f["file"].startswith("frame_%05d." % f["frame"]) for f in s["frames"]), fmt + ": with number and time", s["frames"])
    ok([f["splats"] for f in s["frames"]] == [count_in(f) for f in files] == counts, fmt + ": and the splats that it holds",
       s["frames"], counts)
    ok((s["format"], s["source"], s["retrained"], s["fps"]) == (fmt, "ply", retrained, 12.5), fmt + ": what is said of all")
    ok(j["bytes"] == sum(os.path.getsize(os.path.join(out, f)) for f in os.listdir(out)), fmt + ": bytes", j["bytes"])
    near([j["frames"], j["splats_mean"], j["check"]["frames"], j["check"]["splats"], j["check"]["rendered"]],
         [len(frames), np.mean(counts), len(frames), sum(counts), frames[len(frames) // 2][0]], 1e-9,
         fmt + ": frames and splats, written and read back, and the frame rendered")


def unit(q):
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def check_errors(frames):
    """The losses of .splat, computed from its bytes."""
    j = json.loads(run("export", path("all.spin"), "--to", "splat", "-o", path("lost"), "--check", "--json"))
    parts = {k: [] for k in PARTS}
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
    """kept: the splats of the retrained frames."""
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
    for name, n, *args in ("clip.html", 5), ("clip.glb", 3, "--range", "10:14"):
        text, j = both("export", path("tracks.spin"), "-o", path(name), *args)
        shown(text, j, name + ": the text has the figures of --json")
        ok(j["bytes"] == os.path.getsize(path(name)) and j["frames"] == n, name + ": bytes and frames", j)


# ---- All -----------------------------------------------------------------------------------------


def main():
    only, tracks = os.environ.get("TAP_PART"), path("tracks.spin")
    of_tracks = "--iterations 9 --eval-every 4 --scale 0.5".split()
    small = "--levels 2 --hash-log2 18 --hidden 16 --finest-resolution 48,48,48,8 --scale 0.5"
    frames = make_source()
    run("import", path("run"), "--data", CLIP, "-o", path("all.spin"))
    if only in (None, "imports"):
        check_import(frames)
        check_cameras(frames)
        check_bundle("in.spin", frames[1:], {})
    if only in (None, "retrains"):
        check_text(frames)
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
