"""first_view.py PAGE.html BUNDLE.spin: projects the dynamic splats of a bundle, in all of its
frames, into the first image of a page. For windows of three sizes, prints the median position, in
half widths and half heights from the centre of the window, and the share of these splats that are
inside the window."""
import json
import math
import re
import struct
import sys
import zipfile

SIZES = [(1280, 720), (844, 390), (390, 844)]


def read_npy(data):
    """The values of a float array in a NPY file of version 1."""
    start = 10 + struct.unpack_from("<H", data, 8)[0]
    assert b"'<f4'" in data[:start]
    return struct.unpack(f"<{(len(data) - start) // 4}f", data[start:])


def dynamic_splats(path):
    """Positions, in all frames, of the opaque splats that move further than a tenth of the extent
    of the scene."""
    with zipfile.ZipFile(path) as file:
        names = sorted(n for n in file.namelist() if re.match(r"source/means/\d+\.npy$", n))
        frames = [read_npy(file.read(n)) for n in names]
        opacity = next(n for n in sorted(file.namelist()) if n.startswith("source/logit_opacities"))
        opaque = [v > 0 for v in read_npy(file.read(opacity))]
    points = [[f[i:i + 3] for i in range(0, len(f), 3)] for f in frames]
    n = len(opaque)
    extent = max(sorted(p[c] for p in points[0])[n * 9 // 10] - sorted(p[c] for p in points[0])[n // 10] for c in range(3))
    moved = (max(math.dist(points[0][i], p[i]) for p in points) for i in range(n))
    moves = [o and m > 0.1 * extent for o, m in zip(opaque, moved)]
    return [p for f in points for p, m in zip(f, moves) if m]


def unit(v):
    return [x / math.hypot(*v) for x in v]


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def main():
    page = open(sys.argv[1], encoding="utf-8").read()
    clip = json.loads(re.search(r'<script type="application/json" id="clip">(.*?)</script>', page, re.S)[1])
    points = dynamic_splats(sys.argv[2])
    forward = unit([t - e for t, e in zip(clip["target"], clip["eye"])])
    right = unit(cross(forward, clip["up"]))
    down = cross(forward, right)
    tan = math.tan(math.radians(clip["fovy"] / 2))
    for w, h in SIZES:
        # as camera() of the page, for a scene that is higher than the window
        crop = w / 2 / clip["keep"] if clip.get("keep") else math.inf
        focal = min(h / 2 / tan, max(w / 2 / (tan * clip["aspect"]), crop))
        at, inside = [], 0
        for p in points:
            v = [a - b for a, b in zip(p, clip["eye"])]
            depth = dot(v, forward)
            x, y = (2 * focal * dot(v, a) / depth / s if depth > 0 else math.inf for a, s in ((right, w), (down, h)))
            at.append((x, y))
            inside += abs(x) < 1 and abs(y) < 1
        x, y = (sorted(v[k] for v in at)[len(at) // 2] for k in (0, 1))
        print(f"{w}x{h} {x:.2f} {y:.2f} {inside / len(points):.2f} of {len(points)}")


main()
