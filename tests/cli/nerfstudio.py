"""nerfstudio.py make FOLDER: writes the same splats in the world of nerfstudio, in that of
transforms.json and in that of COLMAP, transformed here, with a data set of both kinds and
dataparser_transforms.json.
nerfstudio.py compare A.ply B.ply: compares two exported files."""
import json, math, os, random, struct, sys

from layouts import Camera, H, W, model_text, png, text

NAMES = ('x y z f_dc_0 f_dc_1 f_dc_2 ' + ' '.join('f_rest_%d' % i for i in range(9))
         + ' opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3').split()


def product(R, v):
    return [sum(R[i][k] * v[k] for k in range(3)) for i in range(3)]


def matmul(A, B):
    return [[sum(A[i][k] * B[k][j] for k in range(3)) for j in range(3)] for i in range(3)]


def transpose(R):
    return [list(c) for c in zip(*R)]


def matrix(q):
    w, x, y, z = q
    return [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]


def join(a, b):
    """The quaternion of rotation b followed by a."""
    return [a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]]


def place(splats, q, scale, shift):
    """Rotates, scales and shifts. The coefficients of SH degree 1 are a vector (-c3, -c1, c2)."""
    R, out = matrix(q), []
    for s in splats:
        rest = [0] * 9
        for c in range(3):
            x, y, z = product(R, [-s['rest'][3 * c + 2], -s['rest'][3 * c], s['rest'][3 * c + 1]])
            rest[3 * c:3 * c + 3] = [-y, z, -x]
        out.append(dict(s, p=[scale * v + t for v, t in zip(product(R, s['p']), shift)], rest=rest,
                        scales=[v + math.log(scale) for v in s['scales']], q=join(q, s['q'])))
    return out


def write(path, splats):
    text(path, 'ply\nformat ascii 1.0\nelement vertex %d\n' % len(splats)
         + ''.join('property float %s\n' % n for n in NAMES) + 'end_header\n'
         + ''.join(' '.join(map(repr, s['p'] + s['dc'] + s['rest'] + [s['o']] + s['scales'] + s['q'])) + '\n'
                   for s in splats))


def unit(r):
    q = [r.uniform(-1, 1) for _ in range(4)]
    n = math.sqrt(sum(v * v for v in q))
    return [v / n for v in q]


def make(root):
    r = random.Random(5)
    original = [dict(p=[r.uniform(-3, 3) for _ in range(3)], dc=[r.uniform(-1, 1) for _ in range(3)],
                     rest=[r.uniform(-1, 1) for _ in range(9)], o=1.0,
                     scales=[r.uniform(-3, -1) for _ in range(3)], q=unit(r)) for _ in range(50)]
    # D: to nerfstudio's world. A: applied_transform, COLMAP's y down to z up.
    qD, tD, scale = unit(r), [0.5, -1.5, 2.5], 0.25
    A, applied = [[1, 0, 0], [0, 0, 1], [0, -1, 0]], 2.0
    qA = [math.sqrt(0.5), -math.sqrt(0.5), 0, 0]
    D = matrix(qD)
    nerfstudio = place(original, qD, scale, [scale * v for v in tD])
    # p' = scale/applied (D A^-1 p + t), inverted for the world of transforms.json
    inverse = [qD[0]] + [-v for v in qD[1:]]
    M = matmul(A, transpose(D))
    saved = place(nerfstudio, join(qA, inverse), applied / scale, [-v for v in product(M, tD)])
    write(root + '/run/exports/splat.ply', nerfstudio)
    write(root + '/original.ply', original)
    write(root + '/saved.ply', saved)
    text(root + '/run/dataparser_transforms.json',
         json.dumps(dict(transform=[a + [b] for a, b in zip(D, tD)], scale=scale)))
    cameras, names = [Camera(s) for s in range(3)], ['c%d.png' % s for s in range(3)]
    for kind in 'colmap', 'transforms':
        for n in names:
            png('%s/%s/images/%s' % (root, kind, n))
    model_text(root + '/colmap/sparse/0', cameras, names)
    text(root + '/transforms/transforms.json', json.dumps(dict(
        applied_transform=[a + [0] for a in A], applied_scale=applied, w=W, h=H, fl_x=9, fl_y=9,
        frames=[dict(file_path='images/' + n, transform_matrix=c.c2w()) for c, n in zip(cameras, names)])))


def read(path):
    data = open(path, 'rb').read()
    header, body = data.split(b'end_header\n', 1)
    names = [line.split()[2].decode() for line in header.splitlines() if line.startswith(b'property')]
    rows = [dict(zip(names, v)) for v in struct.iter_unpack('<%df' % len(names), body)]
    for row in rows:  # q and -q are the same rotation
        sign = -1 if row['rot_0'] < 0 else 1
        row.update({'rot_%d' % i: sign * row['rot_%d' % i] for i in range(4)})
    return rows


def compare(a, b):
    a, b = read(a), read(b)
    worst = {n: max(abs(x[n] - y[n]) for x, y in zip(a, b)) for n in NAMES}
    print('#', max(worst, key=worst.get), max(worst.values()))
    sys.exit(not (len(a) == len(b) == 50 and max(worst.values()) < 2e-5))


if sys.argv[1] == 'make':
    make(sys.argv[2])
else:
    compare(sys.argv[2], sys.argv[3])
