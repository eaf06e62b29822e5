#!/usr/bin/env python3
"""splat-fixtures.py OUT: writes splat files in the formats of other programs, and the values that
these programs read from them.

npm install @playcanvas/splat-transform@3.7.0 PATH=node_modules/.bin:$PATH python3
tests/tools/splat-fixtures.py fixtures/splats

splat-transform, which must be in PATH, converts a synthetic cloud of 40 splats with SH degree 2, in
three frames, to SPZ 4 and 3, SOG and GLB. Formats that it cannot write are written here from their
descriptions: SPZ 2, .splat and .ksplat (levels 0, 1 and 2, one frame each). expected.npz holds what
splat-transform reads from each file, by way of a PLY; it cannot read GLB, which is compared with
the cloud itself. Its rotations of .splat differ by half a quantisation step from those of the
format's author, which the manifest allows for."""
import gzip
import json
import os
import shutil
import struct
import subprocess
import sys
import tempfile

import numpy as np

N, DEGREE, REST, FRAMES = 40, 2, 8, 3
NAMES = (["x", "y", "z", "nx", "ny", "nz"] + [f"f_dc_{c}" for c in range(3)] +
         [f"f_rest_{k}" for k in range(3 * REST)] + ["opacity"] +
         [f"scale_{c}" for c in range(3)] + [f"rot_{k}" for k in range(4)])
PROGRAM = "splat-transform 3.7.0"


def cloud(frame):
    """Columns by name; some values exceed the range of the formats."""
    rng = np.random.default_rng(5)
    c = {name: np.zeros(N, np.float32) for name in NAMES}
    for axis in "xyz":
        c[axis][:] = rng.uniform(-3, 3, N) + 0.25 * frame
    for k in range(3):
        c[f"f_dc_{k}"][:] = rng.normal(0, 1.2, N)
        c[f"scale_{k}"][:] = rng.uniform(-8, 0, N)
    for k in range(3 * REST):
        c[f"f_rest_{k}"][:] = rng.normal(0, 0.3, N)
    c["opacity"][:] = rng.normal(0, 3, N)
    q = rng.normal(0, 1, (N, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    for k in range(4):
        c[f"rot_{k}"][:] = q[:, k]
    c["x"][0], c["scale_0"][1], c["opacity"][2], c["f_rest_0"][3] = 30, -12, 40, 2
    return c


def write_ply(path, c):
    with open(path, "wb") as f:
        f.write(f"ply\nformat binary_little_endian 1.0\nelement vertex {N}\n".encode())
        f.write("".join(f"property float {name}\n" for name in NAMES).encode() + b"end_header\n")
        f.write(np.stack([c[name] for name in NAMES], 1).astype("<f4").tobytes())


def read_ply(path):
    data = open(path, "rb").read()
    head, body = data.split(b"end_header\n", 1)
    names = [line.split()[2].decode() for line in head.splitlines() if line.startswith(b"property float")]
    rows = np.frombuffer(body, "<f4").reshape(-1, len(names))
    return {name: rows[:, k] for k, name in enumerate(names)}


def finished(c):
    """In the layout of expected.npz of the ply fixtures."""
    n_rest = sum(name.startswith("f_rest_") for name in c) // 3
    stack = lambda names: np.stack([c[name] for name in names], 1).astype(np.float32)
    q = stack([f"rot_{k}" for k in range(4)]).astype(np.float64)
    rest = [[c[f"f_rest_{channel * n_rest + k}"] for channel in range(3)] for k in range(n_rest)]
    return {
        "means": stack("xyz"),
        "quats_wxyz": (q / np.linalg.norm(q, axis=1, keepdims=True)).astype(np.float32),
        "scales": np.exp(stack([f"scale_{k}" for k in range(3)])),
        "opacities": (1 / (1 + np.exp(-c["opacity"].astype(np.float64)))).astype(np.float32),
        "sh_dc": stack([f"f_dc_{k}" for k in range(3)]),
        "sh_rest": np.array(rest, np.float32).transpose(2, 0, 1) if n_rest else np.zeros((N, 0, 3), np.float32),
    }


def byte(x):
    return np.clip(np.floor(np.asarray(x, np.float64) + 0.5), 0, 255).astype(np.uint8)


def unit(c):
    q = np.stack([c[f"rot_{k}"] for k in range(4)], 1).astype(np.float64)
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def alphas(c):
    return byte(255 / (1 + np.exp(-c["opacity"].astype(np.float64))))


def write_spz2(path, c):
    place = np.round(np.stack([c[a] for a in "xyz"], 1).astype(np.float64) * 4096).astype(np.int64) & 0xFFFFFF
    q = unit(c)
    q *= np.where(q[:, :1] < 0, -1, 1)
    rest = np.stack([c[f"f_rest_{channel * REST + k}"] for k in range(REST) for channel in range(3)], 1)
    size = np.where(np.arange(3 * REST) < 9, 8, 16)
    steps = np.round(rest.astype(np.float64) * 128) + 128
    sh = np.clip(np.floor((steps + size / 2) / size) * size, 0, 255).astype(np.uint8)
    streams = [
        np.stack([place >> 8 * b & 255 for b in range(3)], 2).astype(np.uint8),
        alphas(c),
        byte(np.stack([c[f"f_dc_{k}"] for k in range(3)], 1) * 0.15 * 255 + 127.5),
        byte((np.stack([c[f"scale_{k}"] for k in range(3)], 1) + 10) * 16),
        byte(q[:, 1:] * 127.5 + 127.5),
        sh,
    ]
    head = struct.pack("<IIIBBBB", 0x5053474E, 2, N, DEGREE, 12, 0, 0)
    with open(path, "wb") as f:
        f.write(gzip.compress(head + b"".join(s.tobytes() for s in streams), mtime=0))


def write_splat(path, c):
    with open(path, "wb") as f:
        colour = byte((0.5 + 0.28209479177387814 * np.stack([c[f"f_dc_{k}"] for k in range(3)], 1)) * 255)
        rotation = byte(unit(c) * 128 + 128)
        scale = np.exp(np.stack([c[f"scale_{k}"] for k in range(3)], 1))
        for i in range(N):
            f.write(struct.pack("<6f", c["x"][i], c["y"][i], c["z"][i], *scale[i]))
            f.write(bytes(colour[i]) + bytes([alphas(c)[i]]) + bytes(rotation[i]))


def write_ksplat(path, c):
    """The level equals the frame's number. Buckets of 16 splats; the last holds the rest."""
    level, bucket, width, steps = int(path[-8:-7]), 16, 70.0, 32767
    real = "<f4" if level == 0 else "<f2"
    place = np.stack([c[a] for a in "xyz"], 1).astype(np.float64)
    n_buckets = -(-N // bucket) if level else 0
    centres = np.array([[0.5 * b, 0, -0.25 * b] for b in range(n_buckets)], "<f4").reshape(-1, 3)
    lengths = np.array([N % bucket] if level else [], "<u4")
    order = [channel * REST + k for l in range(1, DEGREE + 1) for channel in range(3)
             for k in range(l * l - 1, l * l + 2 * l)]
    rest = np.stack([c[f"f_rest_{k}"] for k in order], 1).astype(np.float64)
    if level:
        place = np.round((place - centres[np.arange(N) // bucket]) / width * 2 * steps) + steps
    rows = [place.astype("<f4" if level == 0 else "<u2"),
            np.exp(np.stack([c[f"scale_{k}"] for k in range(3)], 1)).astype(real), unit(c).astype(real),
            byte((0.5 + 0.28209479177387814 * np.stack([c[f"f_dc_{k}"] for k in range(3)], 1)) * 255),
            alphas(c)[:, None], byte((rest + 2) / 4 * 255) if level == 2 else rest.astype(real)]
    rows = b"".join(a[i].tobytes() for i in range(N) for a in rows)
    section = struct.pack("<IIIIfHxxIIIIH", N, N, bucket if level else 0, n_buckets, width if level else 0,
                          12 if level else 0, steps if level else 0,
                          len(rows) + 12 * n_buckets + 4 * len(lengths), n_buckets - len(lengths), len(lengths), DEGREE)
    head = struct.pack("<BBxxIIIIHxx3fff", 0, 1, 1, 1, N, N, level, 0, 0, 0, -2, 2)
    with open(path, "wb") as f:
        f.write(head.ljust(4096, b"\0") + section.ljust(1024, b"\0"))
        f.write(lengths.tobytes() + centres.tobytes() + rows)


def convert(source, target, *options):
    subprocess.run(["splat-transform", "-q", "-w", source, *options, target], check=True)


def manifest(folder, made, files, quats):
    entry = {"what": made, "files": files, "gaussians": [N] * len(files), "expected": "expected.npz",
             "tolerance": {"abs": 2e-6, "rel": 2e-5, "quats": quats}}
    with open(os.path.join(folder, "manifest.json"), "w") as f:
        f.write(json.dumps(entry, indent=1) + "\n")


def make(out, name, ending, write, made, quats=2e-6):
    """One folder: its files, and their expected contents."""
    folder, files, arrays = os.path.join(out, name), [], {}
    os.makedirs(folder)
    with tempfile.TemporaryDirectory() as work:
        for frame in range(FRAMES):
            path = os.path.join(folder, f"frame_{frame:05d}.{ending}")
            c = cloud(frame)
            write(path, c, work)
            if ending != "glb":
                back = os.path.join(work, "back.ply")
                convert(path, back)
                c = read_ply(back)
            arrays.update({f"{frame:04d}_{key}": value for key, value in finished(c).items()})
            files.append(os.path.basename(path))
    np.savez_compressed(os.path.join(folder, "expected.npz"), **arrays)
    manifest(folder, made, files, quats)


def by_program(*options):
    def write(path, c, work):
        source = os.path.join(work, "in.ply")
        write_ply(source, c)
        convert(source, path, *options)
    return write


def main():
    out = sys.argv[1]
    shutil.rmtree(out, ignore_errors=True)
    make(out, "spz4", "spz", by_program(), f"written and read by {PROGRAM}")
    make(out, "spz3", "spz", by_program("--spz-version", "3"), f"written and read by {PROGRAM}")
    make(out, "glb", "glb", by_program(), f"written by {PROGRAM}, which turns the cloud half about z")
    make(out, "spz2", "spz", lambda path, c, work: write_spz2(path, c),
         f"written by tests/tools/splat-fixtures.py, read by {PROGRAM}")
    make(out, "splat", "splat", lambda path, c, work: write_splat(path, c),
         f"written by tests/tools/splat-fixtures.py, read by {PROGRAM}", 0.006)
    make(out, "ksplat", "ksplat", lambda path, c, work: write_ksplat(path, c),
         f"levels 0, 1 and 2, written by tests/tools/splat-fixtures.py, read by {PROGRAM}")
    make(out, "sog", "sog", by_program("-g", "cpu"), f"written and read by {PROGRAM}")


main()
