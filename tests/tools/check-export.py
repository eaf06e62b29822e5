#!/usr/bin/python3
"""Decodes a retrained bundle with NumPy alone and compares exported PLY frames with it.

Usage: check-export.py BUNDLE.spin FOLDER_OF_PLY

An independent implementation of man/spin-bundle.5 that uses nothing of spin4d. Prints the largest
deviation of each attribute, checks the names and the order of the 62 properties, and exits with 1
if a value is off by more than 2e-3 plus four times the effect of one float32 step of the position.
A network of SH degree below 3 must have been exported with --sh 3. Needs numpy."""
import glob
import json
import math
import os
import sys

import numpy as np

PRIMES = np.array([1, 2654435761, 805459861, 3674653429], dtype=np.uint32)
ORDER = (["x", "y", "z", "nx", "ny", "nz"] + [f"f_dc_{i}" for i in range(3)] +
         [f"f_rest_{i}" for i in range(45)] + ["opacity"] + [f"scale_{i}" for i in range(3)] +
         [f"rot_{i}" for i in range(4)])
erf = np.vectorize(math.erf)


def encode(table, net, x):
    """x [n,4] in the unit cube -> z [n, levels * features], in double except for the vertex
    positions."""
    n, out = len(x), []
    for l in range(net["levels"]):
        scale = np.array(net["scale"][l], np.float32)
        res = np.array(net["res"][l]).astype(np.uint32)
        first, rows = (int(net["offset"][l]), int(net["offset"][l + 1] - net["offset"][l]))
        pos = (x * scale).astype(np.float32)
        cell = np.floor(pos)
        r = (pos - cell).astype(np.float64)
        w = r * r * (3 - 2 * r)
        cell = cell.astype(np.uint32)
        z = np.zeros((n, net["features"]))
        for corner in range(16):
            bits = np.array([corner >> d & 1 for d in range(4)], np.uint32)
            q = cell + bits
            weight = np.prod(np.where(bits == 1, w, 1 - w), axis=1)
            if net["hashed"][l]:
                row = np.bitwise_xor.reduce(q * PRIMES, axis=1)
            else:
                row = q[:, 0] + res[0] * (q[:, 1] + res[1] * (q[:, 2] + res[2] * q[:, 3]))
            z += weight[:, None] * table[int(first) + (row % np.uint32(rows)).astype(np.int64)]
        out.append(z)
    return np.concatenate(out, axis=1)


def heads(params, net, z):
    hidden, n_in, at, out = net["hidden"], z.shape[1], 0, []

    def take(*shape):
        nonlocal at
        n = int(np.prod(shape))
        at += n
        return params[at - n:at].astype(np.float64).reshape(shape)

    def gelu(a):
        return 0.5 * a * (1 + erf(a / math.sqrt(2)))

    for n_out in (3, 4, 48, 1):
        w1, b1 = take(hidden, n_in), take(hidden)
        w2, b2 = take(hidden, hidden), take(hidden)
        w3, b3 = take(n_out, hidden), take(n_out)
        out.append(gelu(gelu(z @ w1.T + b1) @ w2.T + b2) @ w3.T + b3)
    return out


def decode(bundle, meta, frame, nudge=0):
    """The attributes of a frame; nudge 1 or -1 takes each grid coordinate one float32 step
    further."""
    net = {**meta["trained"], **meta["trained"]["field"]}
    means = bundle[f"trained/means/{frame:05d}"]
    p = (means.astype(np.float64) - net["norm"]["centre"]) * net["norm"]["inv_radius"]
    r = np.linalg.norm(p, axis=1, keepdims=True)
    p = np.where(r > 1, (2 - 1 / np.maximum(r, 1e-30)) / np.maximum(r, 1e-30) * p, p)
    span = net["time_last"] - net["time_first"]
    t = (meta["frames"][frame]["time"] - net["time_first"]) / span if span > 0 else 0.0
    x = np.concatenate([p / 4 + 0.5, np.full((len(p), 1), t)], axis=1).astype(np.float32)
    if nudge:
        x = np.nextafter(x, np.float32(2 * nudge))
    x = np.clip(x, 0, 1)
    table = bundle["trained/table"].astype(np.float64)
    scale, rotation, sh, opacity = heads(bundle["trained/heads"], net, encode(table, net, x))
    own = f"trained/residual/{frame:05d}"
    if own in bundle:  # raw values of every splat, to which the network adds
        own = bundle[own].astype(np.float64)
        scale, rotation, opacity = scale + own[:, :3], rotation + own[:, 3:7], opacity + own[:, 10:]
        sh[:, :3] += own[:, 7:10]
    rotation /= np.maximum(np.linalg.norm(rotation, axis=1, keepdims=True), 1e-12)
    sh = sh.reshape(-1, 16, 3)
    sh[:, (net["sh_degree"] + 1) ** 2:] = 0  # unused by a network of a lower degree
    return means, np.minimum(scale, 20), rotation, sh, opacity[:, 0]


def read_ply(path):
    raw = open(path, "rb").read()
    end = raw.index(b"end_header\n") + 11
    header = raw[:end].decode().splitlines()
    names = [line.split()[2] for line in header if line.startswith("property")]
    n = next(int(line.split()[2]) for line in header if line.startswith("element vertex"))
    return names, np.frombuffer(raw, "<f4", n * len(names), end).reshape(n, len(names))


def attributes(v, decoded):
    """{name: (columns of the PLY, the same from the bundle)}, quaternions with the same sign."""
    means, scale, rotation, sh, opacity = decoded
    rotation = np.where((v[:, 58:62] * rotation).sum(axis=1, keepdims=True) < 0, -rotation, rotation)
    return {
        "means": (v[:, 0:3], means),
        "normals": (v[:, 3:6], np.zeros((len(v), 3))),
        "f_dc": (v[:, 6:9], sh[:, 0]),
        "f_rest": (v[:, 9:54], sh[:, 1:].transpose(0, 2, 1).reshape(len(v), 45)),
        "opacity (logit)": (v[:, 54], opacity),
        "scale (log)": (v[:, 55:58], scale),
        "rot": (v[:, 58:62], rotation),
    }


def main():
    bundle, good = np.load(sys.argv[1]), True
    meta = json.loads(bytes(bundle["meta.json"]))
    files = sorted(glob.glob(os.path.join(sys.argv[2], "*.ply")))
    numbers = {f["number"]: i for i, f in enumerate(meta["frames"])}
    worst = {}
    for path in files:
        names, v = read_ply(path)
        if names != ORDER:
            sys.exit(f"{path}: not the 62 properties in INRIA's order: {names}")
        number = int("".join(c for c in os.path.basename(path) if c.isdigit()))
        found, further, back = (attributes(v, decode(bundle, meta, numbers[number], nudge))
                                for nudge in (0, 1, -1))
        for name, (ours, theirs) in found.items():
            step = np.maximum(np.abs(further[name][1] - theirs), np.abs(back[name][1] - theirs))
            limit = 0 if name in ("means", "normals") else 2e-3 + 4 * step
            deviation = np.abs(ours - theirs)
            was = worst.get(name, (0, 0))
            worst[name] = (max(was[0], float(deviation.max())), was[1] + int((deviation > limit).sum()))
    for name, (deviation, n_off) in worst.items():
        good = good and n_off == 0
        print(f"{name:16s} worst deviation {deviation:.3g}, {n_off} beyond their limit")
    print(f"{len(files)} frames compared: {'all well' if good and files else 'OFF'}")
    sys.exit(0 if good and files else 1)


if __name__ == "__main__":
    main()
