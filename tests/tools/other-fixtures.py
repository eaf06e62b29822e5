#!/usr/bin/env python3
"""other-fixtures.py FROM TO: writes a second set of golden fixtures in the layout of FROM (a folder
with core/ and hash4d/), with other sizes, rates and thresholds, so that tests fail if they contain
a number of the first set:

python3 tests/tools/other-fixtures.py fixtures /tmp/other && SPIN_FIXTURES=/tmp/other make test
K=golden

Values with a closed form are computed again in double precision from other random numbers. Whole
images and whole runs are those of FROM, transformed in a way whose effect on the result is known
exactly: Gaussians in another order, views in another order, a scene of twice the size."""
import json
import math
import os
import sys

import numpy as np

SOURCE, TARGET = sys.argv[1:3]
rng = np.random.default_rng(7)
files = {}


def load(name):
    return dict(np.load(f"{SOURCE}/core/{name}.npz"))


def tell(name, arrays, like=None, meta=None):
    """Writes core/NAME.npz; tolerances are those of LIKE, meta overrides its meta data."""
    entry = json.loads(json.dumps(manifest["files"][(like or name) + ".npz"]))
    if meta:
        entry.setdefault("meta", {}).update(meta)
    entry.pop("arrays", None)
    files[name + ".npz"] = entry
    np.savez(f"{TARGET}/core/{name}.npz", **arrays)


def f32(x):
    return np.float32(x).astype(np.float64)


# ---- Optimiser -----------------------------------------------------------------------------------


class Adam:
    def __init__(self, p):
        self.p, self.m, self.v, self.step = p.copy(), 0 * p, 0 * p, 0

    def move(self, g, lr):
        self.step += 1
        self.m = 0.9 * self.m + 0.1 * g
        self.v = 0.999 * self.v + 0.001 * g * g
        m, v = self.m / (1 - 0.9**self.step), self.v / (1 - 0.999**self.step)
        self.p = self.p - lr * m / (np.sqrt(v) + 1e-15)


def adam():
    steps, n = 17, 43
    p0, grad = f32(rng.normal(size=n)), f32(rng.normal(size=(steps, n)) * 10.0 ** rng.integers(-4, 3, n))
    grad[:, 5], grad[4:, 6], grad[:, 11] = 0, 0, f32(1e-20)
    lr, a, p = np.linspace(3e-3, 4e-2, steps), Adam(p0), []
    for i in range(steps):
        a.move(grad[i], lr[i])
        p.append(a.p)
    tell("adam", {"p0": p0, "grad": grad, "lr": lr, "p": np.array(p)})


def adam_lazy():
    steps, frames, n, lr = 9, 4, 7, 3.7e-3
    p0, grad = f32(rng.normal(size=(frames, n))), f32(rng.normal(size=(steps, frames, n)))
    visited = (rng.random((steps, frames)) < 0.5).astype(np.uint8)
    visited[0] = [0, 1, 1, 0]
    a, p = [Adam(x) for x in p0], []
    for i in range(steps):
        for f in np.flatnonzero(visited[i]):
            a[f].move(grad[i, f], lr)
        p.append([x.p for x in a])
    tell("adam_lazy", {"p0": p0, "grad": grad, "visited": visited, "p": np.array(p)})


def rates():
    last, warmup, end = 7000, 300, 2e-6
    lr0 = {"encoder": 5e-3, "sh": 2e-3, "scale": 7e-4, "rot": 9e-5, "opacity": 4e-4, "position": 3.3e-4}
    at = np.array([1, 7, 150, 299, 300, 301, 1000, 3500, 6000, 6999, 7000])
    arrays = {"iteration": at.astype(np.int32)}
    for name, lr in lr0.items():
        wave = end + (lr - end) * (1 + np.cos(np.pi * (at - warmup) / (last - warmup))) / 2
        arrays["lr_" + name] = np.where(at <= warmup, lr * at / warmup, wave)
    arrays["lr_position_exp"] = 2.4e-4 * (3e-6 / 2.4e-4) ** (at / last)
    refine = np.arange(1, 2000, 211)
    arrays["iteration_refine"] = refine.astype(np.int32)
    arrays["lr_position_refine"] = 1.1e-3 * (4e-6 / 1.1e-3) ** (refine / 2000)
    tell("lr", arrays, meta={"iterations": last, "warmup": warmup, "lr_end": end, "lr0": lr0})


# ---- The network ---------------------------------------------------------------------------------


def contract():
    n = 61
    mu = f32(rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-1, 2, (n, 1)))
    v = f32(rng.normal(size=(n, 3)))
    r = np.linalg.norm(mu, axis=1, keepdims=True)
    s = np.where(r > 1, (2 - 1 / r) / r, 1)
    slope = np.where(r > 1, (2 / r**3 - 2 / r**2) / r, 0)  # ds/dr / r
    grad = (v * s + mu * slope * (mu * v).sum(1, keepdims=True)) / 4
    tell("contract", {"mu": mu, "v": v, "contracted": mu * s, "normalised": mu * s / 4 + 0.5, "grad_mu": grad})


erf = np.vectorize(math.erf)


def gelu_both(x):
    phi = np.exp(-x * x / 2) / np.sqrt(2 * np.pi)
    cdf = (1 + erf(x / np.sqrt(2))) / 2
    return x * cdf, cdf + x * phi


def gelu():
    x = f32(np.concatenate([np.linspace(-9, 14, 91), rng.normal(size=30)]))
    y, dy = gelu_both(x)
    tell("gelu", {"x": x, "y": y, "dy": dy})


def finish(shat, rhat, ohat):
    """The attributes of raw rows, and the backward pass through them."""
    scale = np.exp(np.minimum(shat, 20))
    length = np.maximum(np.linalg.norm(rhat, axis=1, keepdims=True), 1e-12)
    rot, opacity = rhat / length, 1 / (1 + np.exp(-ohat))

    def back(vs, vr, vo):
        return vs * scale, (vr - rot * (rot * vr).sum(1, keepdims=True)) / length, vo * opacity * (1 - opacity)

    return (scale, rot, opacity), back


def activations():
    n = 27
    raw = [f32(rng.normal(size=(n, k)) * 3) for k in (3, 4, 1)]
    raw[0][:2] = 24
    v = [f32(rng.normal(size=(n, k))) for k in (3, 4, 1)]
    out, back = finish(*raw)
    grads = back(*v)
    names = "shat rhat ohat vs vr vo scale rot opacity grad_shat grad_rhat grad_ohat".split()
    tell("activations", dict(zip(names, [*raw, *v, *out, *grads])))


def layers(n_in, hidden, n_out):
    shapes = [(hidden, n_in), (hidden,), (hidden, hidden), (hidden,), (n_out, hidden), (n_out,)]
    return [f32(rng.normal(size=s) / np.sqrt(s[-1])) for s in shapes]


def head(z, p, both):
    """The output, and the gradients of z and of the six segments."""
    w1, b1, w2, b2, w3, b3 = p
    h1, d1 = both(z @ w1.T + b1)
    h2, d2 = both(h1 @ w2.T + b2)

    def back(g):
        g2 = g @ w3 * d2
        g1 = g2 @ w2 * d1
        return g1 @ w1, [g1.T @ z, g1.sum(0), g2.T @ h1, g2.sum(0), g.T @ h2, g.sum(0)]

    return h2 @ w3.T + b3, back


PIECES = ["w1", "b1", "w2", "b2", "w3", "b3"]


def decoder():
    n, n_in, hidden = 29, 24, 40
    z, arrays, raw, backs = f32(rng.normal(size=(n, n_in))), {}, {}, {}
    for name, width in {"scale": 3, "rot": 4, "sh": 48, "opacity": 1}.items():
        p = layers(n_in, hidden, width)
        raw[name], backs[name] = head(z, p, gelu_both)
        arrays.update({f"{name}_{k}": x for k, x in zip(PIECES, p)})
        arrays[f"v_{name}"] = f32(rng.normal(size=(n, width)))
        arrays[f"raw_{name}"] = raw[name]
    _, back = finish(raw["scale"], raw["rot"], raw["opacity"])
    up = dict(zip(["scale", "rot", "opacity"], back(*[arrays["v_" + k] for k in ("scale", "rot", "opacity")])))
    up["sh"] = arrays["v_sh"]
    grad_z = 0
    for name in raw:
        g, pieces = backs[name](up[name])
        grad_z = grad_z + g
        arrays.update({f"grad_{name}_{k}": x for k, x in zip(PIECES, pieces)})
    tell("decoder", {"z": z, **arrays, "grad_z": grad_z})


def head_relu():
    n, n_in, hidden = 33, 20, 28
    z, v, p = f32(rng.normal(size=(n, n_in))), f32(rng.normal(size=(n, 3))), layers(n_in, hidden, 3)
    y, back = head(z, p, lambda x: (np.maximum(x, 0), (x > 0) * 1.0))
    tell("head_relu", {"z": z, "v": v, **dict(zip(PIECES, p)), "y": y, "grad_z": back(v)[0]})


# ---- The grid ------------------------------------------------------------------------------------

PRIMES = [1, 2654435761, 805459861, 3674653429]


def row_of(q, res, rows):
    product = math.prod(int(r) for r in res)
    if product <= rows:
        index = q[0] + int(res[0]) * (q[1] + int(res[1]) * (q[2] + int(res[2]) * q[3]))
    else:
        index = 0
        for k in range(4):
            index ^= q[k] * PRIMES[k] & 0xFFFFFFFF
    return index % rows


def encode(x, table, scale, res, offset, v, position):
    """The outputs, the gradients of x and of the table, and the rows of all corners, point by
    point."""
    levels, width = len(scale), table.shape[1]
    y, grad_x, grad_table = np.zeros((len(x), levels * width)), np.zeros((len(x), 4)), np.zeros(table.shape)
    corners = np.zeros((levels, len(x), 16), np.int32)
    for i, point in enumerate(x):
        outside = (point < 0).any() or (point > 1).any()
        for level in range(levels):
            at = position(point * scale[level])
            cell = np.floor(at)
            r = at - cell
            w, dw = r * r * (3 - 2 * r), 6 * r * (1 - r)
            up = v[i, level * width : (level + 1) * width]
            for k in range(16):
                bit = np.array([k >> d & 1 for d in range(4)])
                q = [max(0, int(c)) for c in cell + bit]
                row = row_of(q, res[level], int(offset[level + 1] - offset[level]))
                corners[level, i, k] = row
                if outside:
                    continue
                parts = np.where(bit, w, 1 - w)
                entry = table[offset[level] + row]
                y[i, level * width : (level + 1) * width] += parts.prod() * entry
                grad_table[offset[level] + row] += parts.prod() * up
                for d in range(4):
                    slope = (dw[d] if bit[d] else -dw[d]) * np.delete(parts, d).prod()
                    grad_x[i, d] += scale[level, d] * slope * (entry @ up)
    return y, grad_x, grad_table, corners


def encode_core():
    n, width, most = 37, 2, 600
    base, growth = np.array([3.0, 4, 3, 2]), np.array([1.8, 1.6, 2.0, 1.5])
    scale = np.array([f32(base * growth**level - 1) for level in range(3)])
    res = (np.ceil(scale) + 1).astype(np.int32)
    size = np.minimum(res.astype(np.int64).prod(1), most)
    offset = np.concatenate([[0], np.cumsum(size)]).astype(np.int32)
    x, table = f32(rng.random((n, 4))), f32(rng.normal(size=(offset[-1], width)))
    x[2], x[3] = [1.5, 0.2, 0.2, 0.2], [0.2, -0.1, 0.2, 0.2]
    v = f32(rng.normal(size=(n, 3 * width)))
    y, grad_x, grad_table, _ = encode(x, table, scale, res, offset, v, lambda p: p)
    tell(
        "encode_z",
        dict(x=x, table=table, v=v, scale=scale, res=res, size=size, offset=offset, base=base, growth=growth,
             y=y, grad_x=grad_x, grad_table=grad_table),
        like="encode_a",
        meta={"L": 3, "F": width, "log2_T": 0},
    )


def hash4d():
    levels, width, most, n = 5, 4, 1 << 9, 40
    base, finest = np.float32([3, 4, 5, 2]), np.array([20, 24, 28, 7])
    growth = np.float32((finest / base) ** (1 / (levels - 1)))
    lg = np.float32(np.log2(growth.astype(np.float64)))
    scale = np.zeros((levels, 4), np.float32)
    for level in range(levels):
        e = np.float32(np.exp2(np.float32(np.float32(level) * lg).astype(np.float64)))
        scale[level] = np.float32(e.astype(np.float64) * base - 1)
    res = (np.ceil(scale) + 1).astype(np.uint32)
    product = res.astype(np.int64).prod(1)
    offsets = np.concatenate([[0], np.cumsum(np.minimum(product, most))]).astype(np.int32)
    x, table = f32(rng.random((n, 4))), f32(rng.uniform(-1, 1, (offsets[-1], width)))
    x[-1] = [0.5, 0.5, 1.25, 0.5]
    v = f32(rng.normal(size=(n, levels * width)))
    y, grad_x, grad_table, corners = encode(x, table, scale.astype(np.float64), res, offsets, v, f32)
    folder = f"{TARGET}/hash4d/other"
    os.makedirs(folder)
    np.savez(
        folder + "/vectors.npz", inputs=np.float32(x), table=np.float32(table), offsets=offsets,
        per_level_scale=growth, base_resolution=base, level_scale=scale, level_resolution=res,
        level_hashed=(product > most).astype(np.uint8), corner_index=corners[:, :9], outputs=np.float32(y),
        grad_outputs=np.float32(v), grad_table=np.float32(grad_table), grad_inputs=np.float32(grad_x))
    with open(folder + "/manifest.json", "w") as file:
        json.dump({"tolerance": {"outputs": "abs 6e-6", "grad_table": "abs 2e-5",
                                 "grad_inputs": "abs 2e-4 relative to max|grad_inputs|"}}, file)
    coords = rng.integers(0, 1 << 20, (50, 4))
    hashed = np.array([row_of([int(c) for c in q], [1 << 20] * 4, 1 << 32) for q in coords], np.uint32)
    os.makedirs(f"{TARGET}/hash4d/hash_index")
    np.savez(f"{TARGET}/hash4d/hash_index/vectors.npz", coords=coords.astype(np.uint32), hash32=hashed,
             mod_2e11=hashed % (1 << 11), mod_777=hashed % 777)


# ---- Images --------------------------------------------------------------------------------------


def sh():
    """The first 31 splats, with other weights: gradients are linear in the weight of a splat's
    colour."""
    a, n = load("sh"), 31
    k = f32(rng.uniform(0.25, 2, (48, 1)))
    for name in list(a):
        if name != "campos":
            a[name] = a[name][:n]
    a["v"] = a["v"] * k[:n]
    for degree in range(4):
        a[f"grad_sh{degree}"] = a[f"grad_sh{degree}"] * k[:n, :, None]
        a[f"grad_means{degree}"] = a[f"grad_means{degree}"] * k[:n]
    for name in ("color3", "grad_sh3", "grad_means3"):
        del a[name]
    tell("sh", a)


def loss():
    """Mirrored images, with the pairs in another order and one fewer, and another weight of
    SSIM."""
    a, share = load("loss"), 0.35
    out, pairs = {}, [5, 3, 2, 1, 0]
    for new, old in enumerate(pairs):
        one = {k[2:]: v for k, v in a.items() if k.startswith(f"{old}_")}
        slope = (one["grad"].astype(np.float64) + 0.2 * one["grad_ssim"]) / 0.8  # of l1
        one["grad"] = (1 - share) * slope - share * one["grad_ssim"]
        one["loss"] = (1 - share) * one["l1"] + share * (1 - one["ssim"])
        for name, value in one.items():
            out[f"{new}_{name}"] = value[:, :, ::-1] if value.ndim == 3 else value
    tell("loss", {k: np.ascontiguousarray(v) for k, v in out.items()}, meta={"lambda_dssim": share})


def render():
    """Splats in another order, unless two are at the same distance, where the order matters."""
    for new, old in {"render_x": "render_b", "render_y": "render_d"}.items():
        a = load(old)
        n = len(a["means"])
        turn = rng.permutation(n)
        place = np.argsort(turn)
        size = a["cam_size"]
        whole = ("bg", "cam_size", "cam_intr", "cam_R", "cam_t", "cam_pos", "order")
        for name, value in a.items():
            if name not in whole and value.shape[:1] == (n,) and value.shape[-2:] != (size[1], size[0]):
                a[name] = value[turn]
        a["order"] = place[a["order"]].astype(np.int32)
        tell(new, a, like=old)


# ---- Points --------------------------------------------------------------------------------------


def knn():
    n = 77
    points, colour = f32(rng.normal(size=(n, 3)) * 3), rng.integers(0, 256, (n, 3)).astype(np.uint8)
    far = ((points[:, None] - points[None]) ** 2).sum(2)
    np.fill_diagonal(far, np.inf)
    dist2 = np.sort(far, axis=1)[:, :3].mean(1)
    dc = (colour / 255 - 0.5) / 0.28209479177387814
    tell("knn_init", dict(points=points, color_u8=colour, mean_dist2=dist2,
                          log_scale=np.log(np.sqrt(np.maximum(dist2, 1e-7))), sh_dc=dc))


def turn_of(q):
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    return np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
                     2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                     2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1).reshape(-1, 3, 3)


def densify():
    n, extent, dense, threshold, prune = 85, 7.5, 0.02, 6e-4, 0.02
    xyz, quat = f32(rng.normal(size=(n, 3)) * 2), rng.normal(size=(n, 4))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    scale, opacity = np.exp(rng.uniform(-5, -1, (n, 3))), rng.uniform(0.03, 0.9, (n, 1))
    opacity[rng.permutation(n)[:12]] = 0.01
    denom = rng.integers(0, 9, n).astype(np.float64)
    accum = f32(rng.exponential(threshold, n) * np.maximum(denom, 1))
    mean = np.where(denom > 0, accum / np.maximum(denom, 1), 0)
    large = scale.max(1) > dense * extent
    clone, split = (mean >= threshold) & ~large, (mean >= threshold) & large
    c, s = np.flatnonzero(clone), np.flatnonzero(split)
    noise = f32(rng.normal(size=(2 * len(s), 3)))
    twice = np.concatenate([s, s])
    children = xyz[twice] + np.einsum("nij,nj->ni", turn_of(quat[twice]), noise * scale[twice])
    source = np.concatenate([np.flatnonzero(~split), c, twice])
    after = dict(
        xyz_after=np.concatenate([xyz[~split], xyz[c], children]),
        scale_after=np.concatenate([scale[~split], scale[c], scale[twice] / 1.6]),
        opacity_after=opacity[source])
    pruned = after["opacity_after"][:, 0] < prune
    assert len(c) > 2 and len(s) > 2 and pruned.any()
    mask = np.concatenate([split, np.zeros(len(c), bool)])
    tell("densify",
         dict(xyz=xyz, scale=scale, quat=quat, opacity=opacity, grad_accum=accum, denom=denom,
              clone=clone.astype(np.uint8), split_after_clone=mask.astype(np.uint8), noise=noise, **after,
              source=source.astype(np.int32), prune_opacity=pruned.astype(np.uint8)),
         meta={"extent": extent, "percent_dense": dense, "threshold": threshold})


# ---- Whole runs ----------------------------------------------------------------------------------


def other_cameras(a, turn):
    """cam<k> becomes the former cam<turn[k]>."""
    moved = {f"cam{k}_{part}": a[f"cam{old}_{part}"] for k, old in enumerate(turn)
             for part in ("size", "intr", "R", "t", "pos")}
    return {**a, **moved}


def refine():
    """A scene of twice the size, which floats represent exactly, with the views in another
    order."""
    turn = [2, 0, 1]
    a = other_cameras(load("refine"), turn)
    a["gt"] = a["gt"][turn]
    a["order"] = np.argsort(turn)[a["order"]].astype(np.int32)
    for name in ("xyz0", "final_xyz"):
        a[name] = 2 * a[name]
    for k in range(len(turn)):
        for part in ("t", "pos"):
            a[f"cam{k}_{part}"] = 2 * a[f"cam{k}_{part}"]
    a["mean_dist2"], a["final_scaling"] = 4 * a["mean_dist2"], a["final_scaling"] + np.log(2)
    meta = manifest["files"]["refine.npz"]["meta"]
    tell("refine", a, meta={
        "extent": 2 * meta["extent"],
        "lr": {**meta["lr"], "xyz": "1.6e-4*4 -> 1.6e-6*4 log-linear over 40"},
        "float32_p95": {**meta["float32_p95"], "xyz": 2 * meta["float32_p95"]["xyz"]}})


def e2e():
    """Exchanged cameras, points in another order, and the images of a batch in another order."""
    a = other_cameras(load("e2e"), [1, 0])
    a["gt"] = a["gt"][:, [1, 0]]
    a["order"][:, :, 1] = 1 - a["order"][:, :, 1]
    keep = a["order"][0, 0].copy()
    a["order"], a["loss_each"] = a["order"][:, ::-1].copy(), a["loss_each"][:, ::-1]
    a["order"][0], a["loss_each"][0] = a["order"][0][::-1], a["loss_each"][0][::-1]  # image0 is of the first
    assert (a["order"][0, 0] == keep).all()
    for k in range(3):
        turn = rng.permutation(len(a[f"pos0_{k}"]))
        for name in ("pos0_", "g1_pos", "final_pos"):
            a[f"{name}{k}"] = a[f"{name}{k}"][turn]
    tell("e2e", a)


with open(f"{SOURCE}/core/manifest.json") as file:
    manifest = json.load(file)
os.makedirs(f"{TARGET}/core")
for make in (adam, adam_lazy, rates, contract, gelu, activations, decoder, head_relu, encode_core, hash4d, sh,
             loss, render, knn, densify, refine, e2e):
    make()
with open(f"{TARGET}/core/manifest.json", "w") as file:
    json.dump({"files": files}, file, indent=1)
