"""Reads frames of a *.spin bundle as arrays, with NumPy only, and runs the commands.

    import spin4d
    spin4d.import_run("output/balls", "balls.spin", data="data/balls")
    spin4d.retrain("balls.spin", "better.spin")
    clip = spin4d.load("better.spin")
    for i in range(len(clip)):
        means, quats, scales, opacities, sh = clip.frame(i)
    spin4d.export("better.spin", "better.html")

The calls run spin-import and so on. They take the options as keywords (test_cams=[0, 15] is
--test-cams 0,15; force=True is --force), return what --json prints, and raise spin4d.Error with the
command's message.

A frame has the inputs of gsplat's rasterization(): means [n,3]; quats [n,4], unit, w x y z;
scales [n,3], standard deviations; opacities [n], 0 to 1; sh [n,k,3], k = (degree + 1)^2.
frame(i, torch=True) returns tensors. The file format is described in spin-bundle(5).

If the scene is far from 0, frame() returns means and views() returns poses as float64, in the
coordinates of the source. To render such a scene in float32, pass relative=True to both functions:
means and poses are then relative to clip.shift, as they are stored.

A file that cannot be opened raises OSError. A file that is not a bundle, is damaged, or lacks what
is requested raises ValueError, whose text begins with the path. A frame beyond the clip raises
IndexError.
"""
import collections
import contextlib
import json
import operator
import os
import secrets
import shutil
import struct
import subprocess
import sys
import tokenize
import zipfile
import zlib

import numpy as np

Frame = collections.namedtuple("Frame", "means quats scales opacities sh")
NO_TRACK = 0xFFFFFFFF
PRIMES = np.array([1, 2654435761, 805459861, 3674653429], np.uint32)
# The exceptions that NumPy, zipfile and json raise for damaged files. NumPy parses the headers of
# arrays as Python code, which can raise SyntaxError and TokenError.
DAMAGE = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, EOFError, RuntimeError, SyntaxError,
          tokenize.TokenError, zipfile.BadZipFile, zlib.error, struct.error)


def load(path):
    """Opens the bundle at path, without reading any frame yet."""
    return Clip(path)


class Error(RuntimeError):
    """Raised if a command failed. The text is the command's message, `code` the command's exit
    code."""

    def __init__(self, message, code):
        super().__init__(message)
        self.code = code


def convert(run, output=None, **options):
    """Converts a run to a clip that viewers play: spin4d(1)."""
    return _run("spin4d", run, output, options)


def import_run(run, output, **options):
    """Imports a run of another method into a bundle: spin-import(1)."""
    return _run("spin-import", run, output, options)


def retrain(bundle, output, **options):
    """Retrains the attributes of a bundle: spin-retrain(1)."""
    return _run("spin-retrain", bundle, output, options)


def evaluate(bundle, **options):
    """Measures PSNR and SSIM of the held-out views: spin-eval(1)."""
    return _run("spin-eval", bundle, None, options)


def export(bundle, output, **options):
    """Exports a bundle to a format that the extension of `output` or an option such as to="ply"
    chooses: spin-export(1)."""
    return _run("spin-export", bundle, output, options)


def _command(name):
    """Returns the path of a command. If Python runs in a virtual environment into which pip has
    installed the command, this is the path in the environment; otherwise PATH is searched."""
    beside = os.path.join(os.path.dirname(sys.executable), name)
    own = sys.prefix != sys.base_prefix and os.access(beside, os.X_OK)
    found = beside if own else shutil.which(name)
    if not found:
        raise FileNotFoundError(f"{name} is not in PATH")
    return found


def _run(name, word, output, options):
    """Runs a command and returns the JSON that it prints; its messages are copied to stderr."""
    word = os.fspath(word)
    argv = [_command(name), os.path.join(".", word) if word.startswith("-") else word, "--json"]
    if output is not None:
        argv += ["--output", os.fspath(output)]
    for key, value in options.items():
        option = "--" + key.strip("_").replace("_", "-")
        if value is True:
            argv.append(option)
        elif value is not None and value is not False:
            many = isinstance(value, (list, tuple, np.ndarray))
            argv.append(f"{option}={','.join(map(str, value)) if many else value}")
    with subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        said, last = _listen(child)
    if child.returncode != 0:
        raise Error(last or f"{name} exited with {child.returncode}", child.returncode)
    return json.loads(said) if said.strip() else None


def _listen(child):
    """Returns the standard output of a command, and the command's last message. Ctrl-C also reaches
    the command, which then saves its work and ends."""
    import threading
    printed, last = [], [""]
    reader = threading.Thread(target=lambda: printed.append(child.stdout.read()))
    reader.start()
    while True:
        try:
            line = child.stderr.readline()
        except KeyboardInterrupt:
            continue
        if not line:
            break
        last[0] = line.decode(errors="replace").strip()
        sys.stderr.write(last[0] + "\n")
    reader.join()
    return (printed or [b""])[0], last[0]


View = collections.namedtuple("View", "frame camera test intrinsics pose width height image mask")
View.__doc__ = """An image of the data set. frame: index in range(len(clip)). camera: its number. test: whether it
is held out. intrinsics: [3,3], pixels. pose: [4,4], world to camera, with x right, y down, z forward.
image, mask: paths."""


def picture(view):
    """Returns the image of a view as bytes [height, width, 3 or 4], read with Pillow."""
    from PIL import Image
    with Image.open(view.image) as image:
        return np.array(image if image.mode == "RGBA" else image.convert("RGB"))


def write_ply(path, frame):
    """Writes a frame as the PLY of 3DGS, which splat viewers open. Means of float64 are written as
    doubles."""
    n, k = len(frame.means), frame.sh.shape[1]
    opacities, scales = np.asarray(frame.opacities), np.asarray(frame.scales)
    if np.any(opacities < 0) or np.any(scales < 0):
        raise ValueError(f"{path}: a splat has an opacity or a scale below 0")
    # Invisible splats may have an opacity or a scale of 0, whose logit or logarithm is infinite.
    logits = np.log(np.maximum(opacities, 1e-12) / np.maximum(1 - opacities, 1e-12))
    log_scales = np.log(np.maximum(scales, np.finfo(np.float32).tiny))
    rest = np.moveaxis(np.asarray(frame.sh)[:, 1:], 1, 2).reshape(n, -1)
    names = ["x", "y", "z", *(f"f_dc_{i}" for i in range(3)), *(f"f_rest_{i}" for i in range(3 * (k - 1))),
             "opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    means = np.asarray(frame.means)
    wide = means.dtype == np.float64
    others = np.concatenate([np.asarray(frame.sh)[:, 0], rest, np.asarray(logits)[:, None], log_scales,
                             frame.quats], axis=1).astype("<f4")
    if not (np.all(np.isfinite(means)) and np.all(np.isfinite(others))):
        raise ValueError(f"{path}: a splat has a value that is not finite")
    rows = np.empty(n, [("means", "<f8" if wide else "<f4", 3), ("others", "<f4", others.shape[1])])
    rows["means"], rows["others"] = means, others
    head = "".join(["ply\nformat binary_little_endian 1.0\n", f"element vertex {n}\n",
                    *(f"property {'double' if wide and name in 'xyz' else 'float'} {name}\n" for name in names),
                    "end_header\n"])
    part = f"{os.fspath(path)}.tmp.{os.getpid()}.{secrets.token_hex(8)}"
    with open(part, "wb") as out:
        out.write(head.encode() + rows.tobytes())
    os.replace(part, path)


class Clip:
    """An open bundle.

    times      times of the frames, in the source's unit
    numbers    the source's frame numbers
    cameras    learned colours of the training cameras: dicts of "camera", its number in the data
               set, "log_gain" and "offset", each of r, g and b; empty without --learn-exposure
    data       the data set's folder, or None
    versions   versions that frame() can return, the default first: "retrained", "frames", "source"
    splats_4d  metadata of the source's 4D splats, which slice() evaluates at any time; None if the
               source consists of frames
    shift      [3], added to all stored positions; zeros unless the scene is far from 0
    meta       meta.json
    """

    def __init__(self, path):
        self._path = os.fspath(path)
        with self._reading("not a bundle of spin4d"):
            self._zip = np.load(self._path, allow_pickle=False)
            self.meta = json.loads(bytes(self._zip["meta.json"]))
            known = self.meta.get("format") == "spin bundle" and self.meta.get("version") in (1, 2, 3, 4, 5)
        if not known:
            raise ValueError(f"{self._path}: not a bundle of version 1 to 5")
        with self._reading():
            self._read_meta()

    def _read_meta(self):
        self._was = "trained/"
        if "network" in self.meta:
            self._modernise()
        self._trained = self.meta.get("trained")
        self.splats_4d = self.meta.get("splats_4d")
        self._field = (self._trained or {}).get("field")
        self._refined = self.meta.get("refined")
        self._kept = {}
        whole = {"means", "quats", "log_scales", "logit_opacities", "sh"}
        self.versions = [name for name, there in (
            ("retrained", self._trained is not None),
            ("frames", whole <= set((self._refined or {}).get("columns", []))),
            ("source", whole <= set(self.meta["columns"]))) if there]
        self.times = np.array([f["time"] for f in self.meta["frames"]], np.float64)
        self.numbers = [f["number"] for f in self.meta["frames"]]
        self.shift = np.array(self.meta.get("shift", [0, 0, 0]), np.float64)
        if self.shift.shape != (3,) or not np.all(np.isfinite(self.shift)):
            raise ValueError("'shift' is not three numbers")
        if not self.numbers:
            raise ValueError("no frames")
        self.cameras = (self._trained or self.meta.get("trained_4d") or {}).get("cameras", [])
        data = self.meta.get("data")
        self.data = data and os.path.join(os.path.dirname(self._path), data["path"])
        if data and "absolute" in data and not os.path.exists(self.data):
            self.data = data["absolute"]

    @contextlib.contextmanager
    def _reading(self, what="damaged bundle"):
        """Converts exceptions of damaged files to a ValueError that begins with the path."""
        try:
            yield
        except DAMAGE as e:
            if isinstance(e, ValueError) and str(e).startswith(f"{self._path}: "):
                raise
            text = " ".join(f"{type(e).__name__} {e}".split())
            raise ValueError(f"{self._path}: {what} ({text})") from e

    def __len__(self):
        return len(self.meta["frames"])

    def __repr__(self):
        return (f"<spin4d.Clip {self._path!r}: {len(self)} frames of {self.meta.get('from')}, "
                f"times {self.times[0]:g} to {self.times[-1]:g}, {', '.join(self.versions) or 'positions only'}>")

    def views(self, data=None, relative=False):
        """Returns a list with a View, which has intrinsics and a pose, for each image of the data
        set. Runs spin-import --info --views. relative: the poses are relative to `shift`."""
        out = []
        for v in _run("spin-import", self._path, None, {"info": True, "views": True, "quiet": True, "data": data}):
            intrinsics = np.array([[v["fx"], 0, v["cx"]], [0, v["fy"], v["cy"]], [0, 0, 1]])
            pose = np.array(v["w2c"] + [0, 0, 0, 1], float).reshape(4, 4)
            if not relative:
                pose[:3, 3] -= pose[:3, :3] @ self.shift
            out.append(View(v["frame"], v["camera"], v["test"], intrinsics, pose, v["width"], v["height"],
                            v["image"], v["mask"]))
        return out

    def training(self, data=None, relative=False):
        """Returns the training views, which are the views that are not held out."""
        return [view for view in self.views(data, relative) if not view.test]

    def antialias(self, version=None):
        """Whether the splats of this version were trained with antialiasing."""
        version = self._version(version)
        with self._reading():
            part = {"retrained": self._trained, "frames": self._refined}
            return bool(part.get(version, self.meta).get("antialias", False))

    def frame(self, index, version=None, torch=False, relative=False):
        """Returns frame `index` of range(len(self)); negative numbers count from the end. relative:
        the means are relative to `shift`."""
        version, index = self._version(version), operator.index(index)
        if not -len(self) <= index < len(self):
            raise IndexError(f"{self._path}: no frame {index}, only {len(self)}")
        index %= len(self)
        with self._reading():
            if version == "source" and self.splats_4d:
                return self._slice(self.times[index], torch, relative)
            if version == "retrained":
                means, log_scales, quats, sh, logits = self._retrained(index)
            else:
                group = "source" if version == "source" else "refined"
                means, log_scales, quats, sh, logits = (
                    self._column(group, name, index)
                    for name in ("means", "log_scales", "quats", "sh", "logit_opacities"))
            return self._finished(means, quats, log_scales, logits, sh, torch, relative)

    def slice(self, time, torch=False, relative=False):
        """Returns the frame of the source's 4D splats at `time`, in the unit of `times`; see
        spin-bundle(5). relative: the means are relative to `shift`."""
        if not self.splats_4d:
            raise ValueError(f"{self._path}: the source is frames, not 4D splats")
        time = float(time)
        with self._reading():
            return self._slice(time, torch, relative)

    def _slice(self, time, torch, relative):
        s = {name: self._once(f"source/4d/{name}").astype(np.float64) for name in
             ["centres", "times", "quats", "log_scales", "logit_opacities", "sigmas", "sh"]
             + ["paths"] * (self.splats_4d["degree"] > 0) + self.splats_4d["arrays"]}
        n = len(s["times"])
        d = time - s["times"][:, 0]
        sigma = s["sigmas"][:, 0]
        lo, hi, after = s["plateaus"].T if "plateaus" in s else (s["times"][:, 0],) * 2 + (sigma,)
        x = np.where(time < lo, (time - lo) / sigma, np.where(time > hi, (time - hi) / after, 0))
        w = np.exp(-0.5 * x * x)
        if "gates" in s:
            w = s["gates"][:, 0] + (1 - s["gates"][:, 0]) * w
        if "cuts" in s:
            w = w * ((time >= s["cuts"][:, 0]) & (time < s["cuts"][:, 1]))
        opacity = w / (1 + np.exp(-s["logit_opacities"][:, 0]))
        seen = (w >= self.splats_4d["least_weight"]) & (opacity >= self.splats_4d["least_opacity"])
        if "cuts" in s:
            seen &= w > 0
        means = s["centres"].copy()
        for k in range(self.splats_4d["degree"]):
            means += s["paths"].reshape(n, -1, 3)[:, k] * d[:, None] ** (k + 1)
        quats = s["quats"] + (s["spins"] * d[:, None] if "spins" in s else 0)
        sh = s["sh"].reshape(n, -1, 3)
        if "sh_cos" in s:
            turn = 2 * np.pi * d[:, None, None] / self.splats_4d["period"]
            cosines = s["sh_cos"].reshape(n, 2, -1, 3)
            sh = sh + np.cos(turn) * cosines[:, 0] + np.cos(2 * turn) * cosines[:, 1]
        opacity = np.clip(opacity, 1e-6, 1 - 1e-6)
        means, quats, scales, logits, sh = (a[seen].astype(np.float32) for a in (
            means, quats, s["log_scales"], np.log(opacity / (1 - opacity)), sh))
        return self._finished(means, quats, scales, logits, sh, torch, relative)

    def _finished(self, means, quats, log_scales, logits, sh, torch, relative):
        if np.any(self.shift) and not relative:
            means = means + self.shift
        length = np.linalg.norm(quats, axis=1, keepdims=True)
        out = Frame(means, (quats / np.maximum(length, 1e-12)).astype(np.float32),
                    np.exp(np.minimum(log_scales, 20)).astype(np.float32),
                    (0.5 + 0.5 * np.tanh(0.5 * logits)).astype(np.float32), sh.astype(np.float32))
        if torch:
            import torch as t
            out = Frame(*(t.from_numpy(np.array(a)) for a in out))
        return out

    def values(self, name):
        """Decodes the array `name`, such as "source/means/00003"."""
        name = os.fspath(name)
        with self._reading():
            return self._values(name)

    def _values(self, name):
        if self._there(name) not in self._zip:
            raise ValueError(f"{self._path}: no array '{name}'")
        a = self._zip[self._there(name)]
        if a.dtype not in (np.uint8, np.int8):
            return a
        words, units = self._words(name, a)
        if units is not None:
            whole = (words >> np.uint32(1)).view("<i4") ^ -(words & np.uint32(1)).view("<i4")
            return whole.astype("<f4") / units.reshape(words.shape[1:])
        return words if name.startswith("trained/track/") else words.view("<f4")

    def _words(self, name, a):
        """Returns the 32-bit words of a packed array, and the number of quantisation units per 1.0.
        The latter is None if the array is not quantised."""
        series, _, index = name.rpartition("/")
        if not index.isdigit():
            series = name
        if a.ndim < 2 or not 0 < a.shape[0] <= 4 or (a.dtype == np.uint8 and a.shape[0] != 4):
            raise ValueError(f"{self._path}: array '{name}' does not have one to four planes")
        units = None
        if a.dtype == np.int8:
            a = np.moveaxis(a, -1, 1)
            units = self.meta.get("per_unit", {}).get(series)
        if units is not None:
            units = np.array(units, np.float32)
            if units.shape != (np.prod(a.shape[2:], dtype=int),) or not np.all(units > 0):
                raise ValueError(f"{self._path}: 'per_unit' of '{series}' does not match the array")
        words = np.zeros(a.shape[1:], "<u4")
        for k, plane in enumerate(a.view(np.uint8)):
            words |= plane.astype("<u4") << np.uint32(8 * k)
        rows = self.meta.get("xor_rows", {}).get(series) if series != name else None
        if rows and rows[int(index)] > 0:
            n, key = rows[int(index)], self._key(series)
            if n > min(len(words), len(key)) or words.shape[1:] != key.shape[1:]:
                raise ValueError(f"{self._path}: array '{name}', with {n} rows of differences, does not match the first frame")
            words[:n] ^= key[:n]
        return words, units

    def _key(self, series):
        name = series + "/00000"
        if ("words", name) not in self._kept:
            self._kept["words", name] = self._words(name, self._zip[self._there(name)])[0]
        return self._kept["words", name]

    # ---- Older bundles ------------------------------------------------------------------------

    def _modernise(self):
        """Converts the metadata of versions 1 to 3, in which "trained" was called "network" and
        contained the field's parameters directly."""
        net = self.meta.pop("network")
        self._was = "network/"
        self.meta["trained"] = {**net, "field": None if net.get("explicit") else net}
        for key in {"per_unit", "xor_rows"} & set(self.meta):
            self.meta[key] = {f"trained/{k[8:]}" if k.startswith("network/") else k: v
                              for k, v in self.meta[key].items()}

    def _there(self, name):
        """Returns the name that an array has in this file: older bundles use other names."""
        return self._was + name[8:] if name.startswith("trained/") else name

    # ---- Parts of a frame ---------------------------------------------------------------------

    def _version(self, version):
        version = "frames" if version == "explicit" else version  # its name before version 4
        if version is None and self.versions:
            return self.versions[0]
        if version not in self.versions:
            raise ValueError(f"{self._path}: no {version or 'splats'}, only {self.versions}")
        return version

    def _once(self, name):
        if name not in self._kept:
            self._kept[name] = self._values(name)
        return self._kept[name]

    def _column(self, group, name, index):
        if group == "source" and name in self.meta["static_columns"]:
            return self._once(f"source/{name}").copy()
        return self._values(f"{group}/{name}/{index:05d}")

    def _retrained(self, index):
        """Returns the means of a frame, and its log scales, rotations, SH and logits before
        activation."""
        means, rows = self._own_values(index)
        if self._field is None:
            return means, rows[:, :3], rows[:, 3:7], rows[:, None, 7:10], rows[:, 10]
        scale, rotation, sh, logit = self._heads(self._encode(means, index))
        if rows is not None:
            scale, rotation = scale + rows[:, :3], rotation + rows[:, 3:7]
            sh[:, :3] += rows[:, 7:10]
            logit = logit + rows[:, 10:]
        k = (self._trained["sh_degree"] + 1) ** 2
        return means, scale, rotation, sh.reshape(len(sh), 16, 3)[:, :k], logit[:, 0]

    def _own_values(self, index):
        """Returns the positions of a frame and its residuals, which are added to the values of the
        field; None if there are no residuals. With tracks, positions and residuals are sums of the
        frame's and the tracks' values."""
        tracks = self._trained.get("tracks")
        means, residual = (f"trained/{name}/{index:05d}" for name in ("means", "residual"))
        if not tracks:
            return self._values(means), self._values(residual) if self._there(residual) in self._zip else None
        of = self._once("trained/tracks")
        if tracks["same_rows"]:
            track = self._once("trained/track/00000")
        else:
            track = self._values(f"trained/track/{index:05d}")
        free = track == NO_TRACK
        if np.any(track[~free] >= len(of)):
            raise ValueError(f"{self._path}: frame {index} refers to tracks that do not exist")
        out = np.zeros((len(track), 14), np.float32)
        for name, first, end, some in ((means, 0, 3, "moving"), (residual, 3, 14, "varying")):
            own = free | (track < tracks[some])
            own_values = self._there(name) in self._zip
            values = self._values(name) if own_values else np.zeros((0, end - first), "<f4")
            if values.shape != (own.sum(), end - first):
                raise ValueError(f"{self._path}: array '{name}' has shape {values.shape}, expected "
                                 f"{(int(own.sum()), end - first)}")
            out[own, first:end] = values
        out[~free] += of[track[~free]]
        return out[:, :3].copy(), out[:, 3:]

    # ---- The network ----------------------------------------------------------------------------

    def _encode(self, means, index):
        """Returns the features of the hash grid at these positions."""
        net = self._field
        norm = net["norm"]
        p = (means - np.array(norm["centre"], np.float32)) * np.float32(norm["inv_radius"])
        if not norm.get("raw"):
            r = np.maximum(np.linalg.norm(p, axis=1, keepdims=True), np.float32(1))
            p = np.clip((2 - 1 / r) / r * p / 4 + np.float32(0.5), 0, 1)
        span = net["time_last"] - net["time_first"]
        t = (self.times[index] - net["time_first"]) / span if span > 0 else 0.0
        x = np.empty((len(p), 4), np.float32)
        x[:, :3], x[:, 3] = p, min(max(t, 0.0), 1.0)
        inside = np.all((x >= 0) & (x <= 1), axis=1)
        x[~inside] = 0
        table, n = self._once("trained/table"), net["features"]
        z = np.zeros((len(x), net["levels"] * n), np.float32)
        for level in range(net["levels"]):
            rows = table[net["offset"][level]:net["offset"][level + 1]]
            res = np.array(net["res"][level], np.int64)
            pos = x * np.array(net["scale"][level], np.float32)
            cell = pos.astype(np.int64)
            w = pos - cell
            w = w * w * (3 - 2 * w)
            if net["hashed"][level]:
                step, top = PRIMES, np.full(4, 2**31 - 1)
            else:
                step, top = np.cumprod([1, *res[:3]]).astype(np.uint32), res - 1
            at = [np.minimum(cell + k, top).astype(np.uint32) * step for k in (0, 1)]
            to = z[:, level * n:(level + 1) * n]
            for corner in range(16):
                side = [corner >> axis & 1 for axis in range(4)]
                part = [at[s][:, axis] for axis, s in enumerate(side)]
                weight = np.prod([w[:, a] if s else 1 - w[:, a] for a, s in enumerate(side)], axis=0)
                row = (part[0] ^ part[1] ^ part[2] ^ part[3] if net["hashed"][level]
                       else part[0] + part[1] + part[2] + part[3])
                to += weight[:, None] * rows[row % np.uint32(len(rows))]
        z[~inside] = 0
        return z

    def _heads(self, z):
        """Returns scales, rotations, SH and opacities before activation."""
        net, weights, at, out = self._field, self._once("trained/heads"), 0, []
        activation = _relu if net.get("activation") == "relu" else _gelu
        for n_out in (3, 4, 48, 1):
            y = z
            for layer, n in enumerate((net["hidden"], net["hidden"], n_out)):
                m = y.shape[1]
                w, b = weights[at:at + n * m], weights[at + n * m:at + n * m + n]
                at += n * m + n
                y = y @ w.reshape(n, m).T + b
                if layer < 2:
                    y = activation(y)
            out.append(y)
        return out


def _relu(x):
    return np.maximum(x, 0)


def _gelu(x):
    """Returns x times the cumulative normal distribution at x, whose error function is approximated
    by formula 7.1.26 of Abramowitz and Stegun."""
    a = np.abs(x) * np.float32(0.5**0.5)
    t = 1 / (1 + np.float32(0.3275911) * a)
    s = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    e = 1 - s * np.exp(-a * a)
    return (0.5 * x * (1 + np.sign(x) * e)).astype(np.float32)
