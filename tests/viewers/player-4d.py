#!/usr/bin/env python3
"""player-4d.py BIN PLAYER FILE...: compares how the player of TSOG and .ftgs.ply reads files with
how spin-import reads them.

PLAYER is a checkout of OpsiClear-4DGS/ftgs-player (AGPL, and so not fetched here), whose readers
run in Node; dwebp of Debian's package webp decodes the images. Needs NumPy. Fails if a value
differs by more than float rounding."""
import json
import os
import subprocess
import sys
import tempfile
import zipfile

import numpy as np

here = os.path.dirname(os.path.abspath(__file__))
sys.dont_write_bytecode = True
sys.path.insert(0, here + "/../../exporters/python")
import spin4d  # noqa: E402

CONTINUOUS, DISCRETE = 0, 1
MOST = 3e-6


def decode_pictures(path, to):
    os.mkdir(to)
    with zipfile.ZipFile(path) as z:
        z.extractall(to)
        for name in z.namelist():
            if name.endswith(".webp"):
                subprocess.run(["dwebp", "-quiet", "-pam", os.path.join(to, name), "-o",
                                os.path.join(to, name + ".pam")], check=True)


def their_model(player, path, work):
    pictures = work + "/pictures" if path.endswith(".tsog") else ""
    if pictures:
        decode_pictures(path, pictures)
    subprocess.run(["node", here + "/player-4d.mjs", player, path, pictures, work], check=True)
    model = json.load(open(work + "/model.json"))
    for name in ("positionTime", "velocityDuration", "covarianceA", "covarianceB", "sh", "alpha"):
        model[name] = np.fromfile(work + "/" + name, "<f4").reshape(model["count"], -1).astype(float)
    return model


def covariances(quats, log_scales):
    q = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    w, x, y, z = q.T
    r = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
                  2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                  2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], 1).reshape(-1, 3, 3)
    cov = (r * np.exp(2 * log_scales)[:, None, :]) @ r.transpose(0, 2, 1)
    return np.stack([cov[:, a, b] for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))], 1)


def off_by(is_, expected):
    return np.abs(is_ - expected) / np.maximum(1, np.abs(expected))


def compare_still(m, rows, means, quats, log_scales, opacities, sh):
    theirs = np.concatenate([m["covarianceA"], m["covarianceB"][:, :2]], 1)[rows]
    trace = theirs[:, [0, 3, 5]].sum(1, keepdims=True)
    return {"place": off_by(means, m["positionTime"][rows, :3]),
            "covariance": np.abs(covariances(quats, log_scales) - theirs) / trace,
            "opacity": np.abs(opacities.ravel() - m["alpha"][rows, 0]),
            "sh": off_by(sh.reshape(len(means), -1, 3), m["sh"][rows].reshape(len(means), -1, 4)[:, :, :3])}


def compare_rows(m, clip):
    def ours(name):
        return clip._once("source/4d/" + name).astype(float).reshape(m["count"], -1)

    off = compare_still(m, slice(None), ours("centres"), ours("quats"), ours("log_scales"),
                        1 / (1 + np.exp(-ours("logit_opacities"))), ours("sh"))
    off["time"] = np.abs(ours("times")[:, 0] - m["positionTime"][:, 3])
    off["sigma"] = np.abs(ours("sigmas")[:, 0] / m["velocityDuration"][:, 3] - 1)
    off["velocity"] = off_by(ours("paths"), m["velocityDuration"][:, :3])
    return {name: float(d.max()) for name, d in off.items()}


def compare_frames(m, clip):
    worst, n = {}, 0
    for i in range(len(clip)):
        rows, f = m["positionTime"][:, 3] == i, clip.frame(i)
        if rows.sum() != len(f.means):
            sys.exit("frame %d has %d splats, and %d for the player" % (i, len(f.means), rows.sum()))
        n += len(f.means)
        off = compare_still(m, rows, *(a.astype(float) for a in (f.means, f.quats, np.log(f.scales), f.opacities, f.sh)))
        worst = {name: max(worst.get(name, 0), float(d.max())) for name, d in off.items()}
    if n != m["count"] or len(clip) != m["nFrames"]:
        sys.exit("%d splats in %d frames, and %d in %d for the player" % (n, len(clip), m["count"], m["nFrames"]))
    return worst


def main(bin_dir, player, *paths):
    failed = False
    for path in paths:
        with tempfile.TemporaryDirectory() as work:
            m = their_model(player, path, work)
            subprocess.run([bin_dir + "/spin-import", "-q", path, "-o", work + "/clip.spin"], check=True)
            clip = spin4d.load(work + "/clip.spin")
            worst = (compare_frames if m["timelineMode"] == DISCRETE else compare_rows)(m, clip)
        print("%s: %d splats, off by at most %s" % (os.path.basename(path), m["count"],
                                                     {k: float("%.1g" % v) for k, v in worst.items()}))
        failed |= not max(worst.values()) <= MOST
    sys.exit("they are not the same" if failed else 0)


main(*sys.argv[1:])
