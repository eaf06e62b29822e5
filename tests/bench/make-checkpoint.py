"""make-checkpoint.py OUT SPLATS [plain]: a Realtime-4DGS checkpoint as PyTorch saves it, with the
optimiser's two moments for every parameter unless it shall be plain, of random numbers and without PyTorch.
230,000 splats are 450 MB, a third of which a reader needs."""
import array
import collections
import io
import pickle
import random
import sys
import types
import zipfile

out, n = sys.argv[1], int(sys.argv[2])
random.seed(0)

# The names that a checkpoint calls, in modules that stand in for PyTorch's.
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
# A few thousand different numbers, again and again.
pools = {}


def pool(low, high):
    if (low, high) not in pools:
        pools[low, high] = array.array('f', (random.uniform(low, high) for _ in range(8191))).tobytes()
    return pools[low, high]


def parameter(low, high, *shape):
    return Tensor(shape, pool(low, high))


parameters = [
    parameter(-3, 3, n, 3), parameter(-1, 1, n, 1, 3), parameter(-0.1, 0.1, n, 47, 3),
    parameter(-6, -3, n, 3), parameter(-1, 1, n, 4), parameter(-3, 3, n, 1),
]
statistics = [Tensor((n,), pool(0, 1), False)] + [Tensor((n, 1), pool(0, 1), False) for _ in range(3)]
times = [parameter(0, 10, n, 1), parameter(-2, 1, n, 1), parameter(-1, 1, n, 4)]
state = {
    i: {'step': 30000, 'exp_avg': Tensor(p.shape, pool(-1, 1), False),
        'exp_avg_sq': Tensor(p.shape, pool(0, 1), False)}
    for i, p in enumerate([] if sys.argv[3:] else parameters + times)
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
