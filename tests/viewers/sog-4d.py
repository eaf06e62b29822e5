#!/usr/bin/env python3
"""sog-4d.py BIN CLI FILE: checks the splats of a TSOG or one-segment .sogst, each at its own time,
with another reader.

Without its times such a file is a SOG, which splat-transform reads; spin-import must read the same
values from the file."""
import json
import os
import subprocess
import sys
import tempfile
import zipfile

import numpy as np

root = os.path.dirname(os.path.abspath(__file__)) + "/../.."
sys.dont_write_bytecode = True
sys.path.insert(0, root + "/exporters/python")
import spin4d  # noqa: E402

STILL = ("means", "scales", "quats", "sh0", "shN")


def strip(path, to):
    """Rewrites the file as a SOG of version 2."""
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(to, "w") as new:
        meta = json.loads(old.read("meta.json"))
        still = {key: meta[key] for key in STILL if key in meta}
        new.writestr("meta.json", json.dumps({"version": 2, "count": meta["count"], **still}))
        for part in still.values():
            for name in part["files"]:
                new.writestr(name, old.read(name))


def read_ply(path):
    head, body = open(path, "rb").read().split(b"end_header\n", 1)
    names = [line.split()[-1].decode() for line in head.splitlines() if line.startswith(b"property")]
    return dict(zip(names, np.frombuffer(body, "<f4").reshape(-1, len(names)).T))


def main(bin_dir, cli, path):
    with tempfile.TemporaryDirectory() as work:
        strip(path, work + "/still.sog")
        subprocess.run(["node", cli, "-q", work + "/still.sog", work + "/still.ply"], check=True)
        subprocess.run([bin_dir + "/spin-import", "-q", path, "-o", work + "/clip.spin"], check=True)
        ply = read_ply(work + "/still.ply")
        clip = spin4d.load(work + "/clip.spin")
        ours = {name: clip._once("source/4d/" + name) for name in
                ("centres", "quats", "log_scales", "logit_opacities", "sh")}
    n = len(ply["x"])
    sh = ours["sh"].reshape(n, -1, 3)
    rest = [ply[key] for key in sorted((k for k in ply if k.startswith("f_rest_")), key=lambda k: int(k[7:]))]
    theirs = {name: np.stack([ply[key + str(k)] for k in range(width)], 1) for name, key, width in
              (("log_scales", "scale_", 3), ("quats", "rot_", 4), ("dc", "f_dc_", 3))}
    off = {
        "centres": np.stack([ply[c] for c in "xyz"], 1) - ours["centres"].reshape(n, 3),
        "log_scales": theirs["log_scales"] - ours["log_scales"].reshape(n, 3),
        "quats": 1 - np.abs((theirs["quats"] * ours["quats"].reshape(n, 4)).sum(1)),
        "opacities": 1 / (1 + np.exp(-ply["opacity"])) - 1 / (1 + np.exp(-ours["logit_opacities"].ravel())),
        "sh": np.concatenate([theirs["dc"].ravel() - sh[:, 0].ravel(),
                              (np.stack(rest, 1).reshape(n, 3, -1).transpose(0, 2, 1) - sh[:, 1:]).ravel()
                              if rest else []]),
    }
    worst = {name: float(np.abs(d).max()) for name, d in off.items()}
    print("%s: %d splats, off by at most %s" % (os.path.basename(path), n, worst))
    if n == 0 or sh.shape[1] > 1 and not rest or not max(worst.values()) <= 2e-6:
        sys.exit("they are not the same")


main(*sys.argv[1:])
