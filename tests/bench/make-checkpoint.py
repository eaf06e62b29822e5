"""Writes a Realtime-4DGS checkpoint in the layout of PyTorch, without PyTorch.

make-checkpoint.py OUT SPLATS [plain]: of random numbers, with the optimiser's two moments for every
parameter, or with plain without them. 230,000 splats are 450 MB, of which a reader needs a third.

make-checkpoint.py OUT PARAMS.npz [SPAN [sh]]: 4D Gaussians that replace the tracks of a Dynamic 3D
Gaussians run. A track within 3 cm of its mean becomes one Gaussian for all times; any other becomes
one for every SPAN frames (2), on the straight line nearest to the track there. Times are 0 to 1. SH
beyond the colour are 0, or with sh random with the spread of trained runs. Needs NumPy."""
import array
import collections
import io
import pickle
import random
import sys
import types
import zipfile

out, tracks = sys.argv[1], sys.argv[2].endswith('.npz')
random.seed(0)

# The names that a checkpoint calls, in modules that replace PyTorch's.
torch = types.ModuleType('torch')
utils = types.ModuleType('torch._utils')
sys.modules.update({'torch': torch, 'torch._utils': utils})


def named(module, name):
    function = lambda *args: None
    function.__module__, function.__qualname__, function.__name__ = module.__name__, name, name
    setattr(module, name, function)
    return function


class FloatStorage:
    pass


FloatStorage.__module__ = 'torch'
torch.FloatStorage = FloatStorage
rebuild_tensor = named(utils, '_rebuild_tensor_v2')
rebuild_parameter = named(utils, '_rebuild_parameter')


class Storage:
    def __init__(self, key, count):
        self.key, self.count = key, count


class Tensor:
    def __init__(self, shape, values, parameter=True):
        count = 1
        for side in shape:
            count *= side
        self.storage, self.shape, self.parameter = Storage(str(len(storages)), count), shape, parameter
        storages.append((values, count))

    def __reduce__(self):
        strides, step = [], 1
        for side in reversed(self.shape):
            strides.insert(0, step)
            step *= side
        plain = (self.storage, 0, tuple(self.shape), tuple(strides), False, collections.OrderedDict())
        if not self.parameter:
            return rebuild_tensor, plain
        inner = Tensor.__new__(Tensor)
        inner.storage, inner.shape, inner.parameter = self.storage, self.shape, False
        return rebuild_parameter, (inner, True, collections.OrderedDict())


class Pickler(pickle._Pickler):
    def persistent_id(self, thing):
        if isinstance(thing, Storage):
            return ('storage', FloatStorage, thing.key, 'cuda:0', thing.count)
        return None


storages = []
# A few thousand different values, repeated.
pools = {}


def pool(low, high):
    if (low, high) not in pools:
        pools[low, high] = array.array('f', (random.uniform(low, high) for _ in range(8191))).tobytes()
    return pools[low, high]


def parameter(low, high, *shape):
    return Tensor(shape, pool(low, high))


# ---- Gaussians of tracks -------------------------------------------------------------------------

def isoclinic(l, r):
    """The 4D rotations of pairs of quaternions, [n][4][4], axes x y z t."""
    import numpy as np
    a, b, c, d = l
    p = np.array([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]])
    a, b, c, d = r
    q = np.array([[a, b, c, d], [-b, a, -d, c], [-c, d, a, -b], [-d, -c, b, a]])
    return (p @ q)[::-1, ::-1]


def of_tracks(file, span):
    """xyz, rgb, log scales, left, right, logits, times, log scales of time: of 4D Gaussians,
    float32."""
    import numpy as np
    run = np.load(file)
    means, n_frames = run['means3D'].astype(float), len(run['means3D'])
    still = np.abs(means - means.mean(0)).max((0, 2)) < 0.03
    step = 1 / max(1, n_frames - 1)
    pieces = [(0, n_frames, still)] + [(a, min(a + span, n_frames), ~still) for a in range(0, n_frames, span)]
    columns = []
    for number, (first, end, which) in enumerate(pieces):
        which, always = np.flatnonzero(which), number == 0
        t = step * np.arange(first, end)
        at = means[first:end, which]
        middle, dt = t.mean(), t - t.mean()
        velocity = np.zeros((len(which), 3))
        if not always:  # of the nearest straight line
            velocity = np.einsum('f,fnc->nc', dt, at) / max(1e-12, (dt * dt).sum())
        # A weight above 0.05 half a frame beyond both ends: sigma is that distance over sqrt(-2 ln
        # 0.05).
        sigma = 100.0 if always else step * (end - first) / 2 / 2.4477
        size = np.exp(2.0 * run['log_scales'][which])
        # The covariance of x y z t: at a given time an ellipsoid of that size, whose centre is on
        # the line.
        cov = np.zeros((len(which), 4, 4))
        cov[:, :3, :3] = size[:, :, None] * np.eye(3) + sigma ** 2 * velocity[:, :, None] * velocity[:, None]
        cov[:, :3, 3] = cov[:, 3, :3] = sigma ** 2 * velocity
        cov[:, 3, 3] = sigma ** 2
        value, vector = np.linalg.eigh(cov)
        vector[:, :, 0] *= np.sign(np.linalg.det(vector))[:, None]
        # A rotation is the sum of l_a r_b times 16 matrices that are orthogonal to each other.
        basis = np.array([[isoclinic(l, r) for r in np.eye(4)] for l in np.eye(4)])
        u, s, v = np.linalg.svd(np.einsum('abij,nij->nab', basis, vector) / 4)
        columns.append([at.mean(0), run['rgb_colors'][first:end, which].mean(0), 0.5 * np.log(value), u[:, :, 0],
                        s[:, :1] * v[:, 0], run['logit_opacities'][which], np.full((len(which), 1), middle)])
    return [np.concatenate(c).astype('<f4') for c in zip(*columns)]


# ---- The parameters ------------------------------------------------------------------------------

if tracks:
    import numpy
    xyz, rgb, scales, left, right, logits, t = of_tracks(sys.argv[2], int(sys.argv[3]) if sys.argv[3:] else 2)
    n = len(xyz)
    rest = numpy.zeros((n, 47, 3))
    if sys.argv[4:]:
        wide = numpy.repeat([0.06, 0.04, 0.03], [3, 5, 7])  # bands 1 to 3
        wide = numpy.concatenate([wide, *[f * numpy.concatenate([[0.15], wide]) for f in (0.3, 0.2)]])
        rest = numpy.random.default_rng(0).standard_normal((n, 47, 3)) * wide[:, None]
    given = [xyz, (rgb - 0.5) / 0.28209479177387814, rest, scales[:, :3], left, logits, t, scales[:, 3:], right]
    shapes = [(n, 3), (n, 1, 3), (n, 47, 3), (n, 3), (n, 4), (n, 1), (n, 1), (n, 1), (n, 4)]
    made = [Tensor(s, numpy.ascontiguousarray(g, '<f4').tobytes()) for s, g in zip(shapes, given)]
    parameters, times = made[:6], made[6:]
else:
    n = int(sys.argv[2])
    parameters = [
        parameter(-3, 3, n, 3), parameter(-1, 1, n, 1, 3), parameter(-0.1, 0.1, n, 47, 3),
        parameter(-6, -3, n, 3), parameter(-1, 1, n, 4), parameter(-3, 3, n, 1),
    ]
    times = [parameter(0, 10, n, 1), parameter(-2, 1, n, 1), parameter(-1, 1, n, 4)]
statistics = [Tensor((n,), pool(0, 1), False)] + [Tensor((n, 1), pool(0, 1), False) for _ in range(3)]
state = {
    i: {'step': 30000, 'exp_avg': Tensor(p.shape, pool(-1, 1), False),
        'exp_avg_sq': Tensor(p.shape, pool(0, 1), False)}
    for i, p in enumerate([] if tracks or sys.argv[3:] else parameters + times)
}
model = (3, *parameters, *statistics, {'state': state, 'param_groups': []}, 5.0, *times, True, None, 2)

text = io.BytesIO()
Pickler(text, protocol=2).dump((model, 30000))
with zipfile.ZipFile(out, 'w', zipfile.ZIP_STORED, allowZip64=True) as archive:
    archive.writestr('archive/data.pkl', text.getvalue())
    archive.writestr('archive/byteorder', 'little')
    for key, (values, count) in enumerate(storages):
        with archive.open('archive/data/%d' % key, 'w', force_zip64=True) as member:
            left = 4 * count
            while left > 0:
                left -= member.write(values[:left])
    archive.writestr('archive/version', '3\n')
