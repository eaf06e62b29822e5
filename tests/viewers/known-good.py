#!/usr/bin/python3
"""Write frames of a retrained bundle as PLY, SPLAT and SPZ 2 with NumPy alone, to calibrate the
bench.

Usage: known-good.py BUNDLE.spin OUT FRAME...

FRAME is a frame's number. Nothing of spin4d has a part in it: the network is decoded by
tests/tools/check-export.py, which reads man/spin-bundle.5, and the formats are written from their
descriptions. OUT/ply, OUT/splat and OUT/spz hold what was written. Needs numpy."""
import gzip
import importlib.util
import json
import os
import struct
import sys

import numpy as np

TOOLS = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "tools", "check-export.py")
spec = importlib.util.spec_from_file_location("check_export", TOOLS)
check_export = importlib.util.module_from_spec(spec)
spec.loader.exec_module(check_export)

C0 = 0.28209479177387814


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def byte(x):
    return np.clip(np.rint(x), 0, 255).astype(np.uint8)


def write_ply(path, means, scale, rotation, sh, opacity):
    n = len(means)
    rest = sh[:, 1:].transpose(0, 2, 1).reshape(n, 45)
    rows = np.concatenate([means, np.zeros((n, 3)), sh[:, 0], rest, opacity[:, None], scale, rotation],
                          axis=1).astype("<f4")
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    head += [f"property float {name}" for name in check_export.ORDER] + ["end_header", ""]
    with open(path, "wb") as out:
        out.write("\n".join(head).encode() + rows.tobytes())


def write_splat(path, means, scale, rotation, sh, opacity):
    rows = np.zeros(len(means), dtype=[("f", "<f4", 6), ("b", "u1", 8)])
    rows["f"] = np.concatenate([means, np.exp(scale)], axis=1)
    rows["b"][:, 0:3] = byte(255 * (0.5 + C0 * sh[:, 0]))
    rows["b"][:, 3] = byte(255 * sigmoid(opacity))
    rows["b"][:, 4:8] = byte(128 * rotation + 128)
    with open(path, "wb") as out:
        out.write(rows.tobytes())


def write_spz(path, means, scale, rotation, sh, opacity):
    fixed = np.rint(means * 4096).astype("<i4")
    rotation = np.where(rotation[:, :1] < 0, -rotation, rotation)
    level = np.rint(sh[:, 1:] * 128)
    wide = np.where(np.arange(15) < 3, 8, 16)[None, :, None]
    streams = [
        fixed.view(np.uint8).reshape(-1, 3, 4)[:, :, :3],
        byte(255 * sigmoid(opacity)),
        byte(sh[:, 0] * 0.15 * 255 + 127.5),
        byte((scale + 10) * 16),
        byte(rotation[:, 1:] * 127.5 + 127.5),
        byte(np.rint(level / wide) * wide + 128),
    ]
    with gzip.open(path, "wb") as out:
        out.write(struct.pack("<IIIBBBB", 0x5053474E, 2, len(means), 3, 12, 0, 0))
        for stream in streams:
            out.write(np.ascontiguousarray(stream).tobytes())


WRITERS = {"ply": write_ply, "splat": write_splat, "spz": write_spz}


def main():
    bundle, out = np.load(sys.argv[1]), sys.argv[2]
    meta = json.loads(bytes(bundle["meta.json"]))
    if "trained" not in meta:
        sys.exit(f"known-good: '{sys.argv[1]}' holds no network")
    places = {frame["number"]: i for i, frame in enumerate(meta["frames"])}
    for kind in WRITERS:
        os.makedirs(os.path.join(out, kind), exist_ok=True)
    for number in map(int, sys.argv[3:]):
        values = check_export.decode(bundle, meta, places[number])
        for kind, write in WRITERS.items():
            write(os.path.join(out, kind, f"frame_{number:05d}.{kind}"), *values)


if __name__ == "__main__":
    main()
