"""deform.py make FOLDER: writes models of Deformable 3D Gaussians whose networks have other widths
and depths than the method's default, with the positions and covariances expected of them, computed
here in double precision.
deform.py compare EXPECTED FRAME.ply TIME: compares an exported frame with the expected one.
Needs only the standard library."""
import json, math, os, pickle, random, struct, sys, types, zipfile
from collections import OrderedDict

N = 6
PLAIN = ('x y z f_dc_0 f_dc_1 f_dc_2 ' + ' '.join('f_rest_%d' % i for i in range(45))
         + ' opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3').split()
TIMES = (0.0, 0.375, 1.0)
# name: layers, width, width of the time network (0: none), 6dof, frequencies of positions
MODELS = {'narrow': (8, 24, 0, False, 10), 'shallow': (3, 40, 0, True, 10),
          'deep': (12, 17, 16, False, 10), 'wide': (5, 300, 50, True, 10), 'coarse': (4, 33, 20, False, 6)}


class Storage:
    def __init__(self, name, values):
        self.name, self.values = name, values


def torch_file(path, tensors):
    """A state dict in the layout of torch.save()."""
    torch, utils = types.ModuleType('torch'), types.ModuleType('torch._utils')
    utils._rebuild_tensor_v2 = lambda *a: a
    utils._rebuild_tensor_v2.__module__, utils._rebuild_tensor_v2.__qualname__ = 'torch._utils', '_rebuild_tensor_v2'
    torch.FloatStorage = type('FloatStorage', (), {'__module__': 'torch'})
    sys.modules.update({'torch': torch, 'torch._utils': utils})

    class Tensor:
        def __init__(self, name, rows):
            self.storage = Storage(name, [v for r in rows for v in (r if isinstance(r, list) else [r])])
            self.shape = (len(rows), len(rows[0])) if isinstance(rows[0], list) else (len(rows),)

        def __reduce__(self):
            strides = (self.shape[1], 1) if len(self.shape) == 2 else (1,)
            return utils._rebuild_tensor_v2, (self.storage, 0, self.shape, strides, False, OrderedDict())

    class Pickler(pickle.Pickler):
        def persistent_id(self, obj):
            if isinstance(obj, Storage):
                return 'storage', torch.FloatStorage, obj.name, 'cpu', len(obj.values)

    os.makedirs(os.path.dirname(path))
    state = OrderedDict((key, Tensor(str(i), rows)) for i, (key, rows) in enumerate(tensors.items()))
    with zipfile.ZipFile(path, 'w') as z:
        with z.open('archive/data.pkl', 'w') as f:
            Pickler(f, 2).dump(state)
        for t in state.values():
            z.writestr('archive/data/' + t.storage.name, struct.pack('<%df' % len(t.storage.values), *t.storage.values))
        z.writestr('archive/version', '3\n')


def as_float(v):
    return struct.unpack('f', struct.pack('f', v))[0]


def layer(r, tensors, key, n_in, n_out, size=1.0):
    size *= 1 / math.sqrt(n_in)
    tensors[key + '.weight'] = [[as_float(r.uniform(-size, size)) for _ in range(n_in)] for _ in range(n_out)]
    tensors[key + '.bias'] = [as_float(r.uniform(-size, size)) for _ in range(n_out)]


def network(r, depth, width, time, screw, frequencies):
    t, n_time = OrderedDict(), 9 if time else 21
    if time:
        layer(r, t, 'timenet.0', 13, time)
        layer(r, t, 'timenet.2', time, n_time)
    n_in = 3 + 6 * frequencies + n_time
    layer(r, t, 'linear.0', n_in, width)
    for i in range(1, depth):
        layer(r, t, 'linear.%d' % i, width + (n_in if i == depth // 2 + 1 else 0), width)
    for head in ('branch_w', 'branch_v') if screw else ('gaussian_warp',):
        layer(r, t, head, width, 3)
    layer(r, t, 'gaussian_rotation', width, 4, 0.2)
    layer(r, t, 'gaussian_scaling', width, 3, 0.2)
    return t


def run_layer(t, key, x):
    return [b + sum(w * v for w, v in zip(row, x)) for row, b in zip(t[key + '.weight'], t[key + '.bias'])]


def relu(x):
    return [max(v, 0) for v in x]


def encode(v, n):
    out = list(v)
    for k in range(n):
        out += [math.sin(2 ** k * x) for x in v] + [math.cos(2 ** k * x) for x in v]
    return out


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def move(t, h, p):
    if 'gaussian_warp.weight' in t:
        return [a + b for a, b in zip(p, run_layer(t, 'gaussian_warp', h))]
    w, v = run_layer(t, 'branch_w', h), run_layer(t, 'branch_v', h)
    a = math.sqrt(sum(x * x for x in w))
    w, v = [x / a + 1e-5 for x in w], [x / a + 1e-5 for x in v]
    kp, kv = cross(w, p), cross(w, v)
    kkp, kkv = cross(w, kp), cross(w, kv)
    s, c = math.sin(a), 1 - math.cos(a)
    return [p[i] + s * kp[i] + c * kkp[i] + a * v[i] + c * kv[i] + (a - s) * kkv[i] for i in range(3)]


def covariance(scale, q):
    w, x, y, z = q
    R = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
         [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
         [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    M = [[R[i][k] * scale[k] for k in range(3)] for i in range(3)]
    return [sum(M[i][k] * M[j][k] for k in range(3)) for i in range(3) for j in range(i, 3)]


def evaluate(t, splat, time, depth, frequencies):
    p = splat[0:3]
    if 'timenet.0.weight' in t:
        e = run_layer(t, 'timenet.2', relu(run_layer(t, 'timenet.0', encode([time], 6))))
    else:
        e = encode([time], 10)
    x = encode(p, frequencies) + e
    h = x
    for i in range(depth):
        h = relu(run_layer(t, 'linear.%d' % i, h))
        if i == depth // 2:
            h = x + h
    rot, norm = splat[-4:], math.sqrt(sum(v * v for v in splat[-4:]))
    q = [v / norm + d for v, d in zip(rot, run_layer(t, 'gaussian_rotation', h))]
    s = [math.exp(v) + d for v, d in zip(splat[-7:-4], run_layer(t, 'gaussian_scaling', h))]
    return move(t, h, p) + covariance(s, q)


def make(root):
    expected = {}
    for name, (depth, width, time, screw, frequencies) in MODELS.items():
        r = random.Random(name)
        t = network(r, depth, width, time, screw, frequencies)
        cloud = [[as_float(r.uniform(-1, 1)) for _ in PLAIN] for _ in range(N)]
        folder = '%s/%s/point_cloud/iteration_9000' % (root, name)
        os.makedirs(folder)
        with open(folder + '/point_cloud.ply', 'wb') as f:
            f.write(('ply\nformat binary_little_endian 1.0\nelement vertex %d\n' % N
                     + ''.join('property float %s\n' % p for p in PLAIN) + 'end_header\n').encode())
            for row in cloud:
                f.write(struct.pack('<%df' % len(PLAIN), *row))
        torch_file('%s/%s/deform/iteration_9000/deform.pth' % (root, name), t)
        expected[name] = [[evaluate(t, s, time_, depth, frequencies) for s in cloud] for time_ in TIMES]
    json.dump(expected, open(root + '/expected.json', 'w'))


def read(path):
    header, body = open(path, 'rb').read().split(b'end_header\n', 1)
    names = [line.split()[2].decode() for line in header.splitlines() if line.startswith(b'property')]
    for v in struct.iter_unpack('<%df' % len(names), body):
        row = dict(zip(names, v))
        yield [row[c] for c in 'xyz'] + covariance([math.exp(row['scale_%d' % i]) for i in range(3)],
                                                   [row['rot_%d' % i] for i in range(4)])


def compare(root, name, frames):
    worst = 0
    for want, file in zip(json.load(open(root + '/expected.json'))[name], sorted(os.listdir(frames))):
        got = list(read(frames + '/' + file))
        worst = max([worst, abs(len(got) - N)]
                    + [abs(a - b) / (1 + abs(a)) for x, y in zip(want, got) for a, b in zip(x, y)])
    print('# %s: largest difference %.2g' % (name, worst))
    sys.exit(not worst < 1e-5)


if sys.argv[1] == 'make':
    make(sys.argv[2])
else:
    compare(*sys.argv[2:])
