#!/usr/bin/env python3
"""Compares splats of .4dgs files that spin-import read with the values that the format's corpus
lists for 16 splats of each file, or for the states of keyframes and deltas at some times. Prints
the number of files.

corpus_4dgs.py FOLDER_OF_VALUES BUNDLE..., where the values of NAME.spin are in NAME.json"""
import json
import os
import sys

import numpy as np

sys.dont_write_bytecode = True
sys.path.insert(0, "exporters/python")
import spin4d  # noqa: E402

C0 = 0.28209479177387814


def compare_states(path, values, clip):
    for state in values["states"]:
        if state["t"] >= values["durationSec"]:
            continue
        frame, n = clip.slice(state["t"], relative=True), int(state["liveCount"])
        have = np.concatenate([frame.means, frame.scales], axis=1)
        want = np.concatenate([state["sample"]["positions"], state["sample"]["scales"]], axis=1)
        worst = max(np.abs(have - row).max(1).min() for row in want)
        off = abs(frame.opacities.sum() - state["aggregate"]["opacitySum"])
        if len(have) != n or worst > 2e-5 or off > 1e-5 * n:
            sys.exit(f"{path}: at {state['t']}: {len(have)} of {n} splats, positions {worst:.2g}, opacities {off:.2g}")


def compare_splats(path, values, clip):
    sample = {k: np.array(v, dtype=float) for k, v in values["sample"].items()}
    least = max(clip.splats_4d["least_weight"], clip.splats_4d["least_opacity"])
    for i, centre in enumerate(sample["muT"]):
        # The time in its window at which the splat is most opaque.
        time = min(max(centre, sample["winLo"][i]), sample["winHi"][i] - 1e-4)
        sigma, d = sample["sigmaT"][i], time - centre
        opacity = sample["colors"][i, 3] * (np.exp(-0.5 * (d / sigma) ** 2) if 0 < sigma < 1e3 else 1)
        if opacity < least + 1e-3:
            continue
        frame = clip.slice(time, relative=True)
        want = np.concatenate([sample["positions"][i] + d * sample["motions"][i], sample["scales"][i],
                               sample["colors"][i, :3], [opacity]])
        have = np.concatenate([frame.means, frame.scales, 0.5 + C0 * frame.sh[:, 0], frame.opacities[:, None]], axis=1)
        quat = np.roll(sample["rotations"][i], 1)  # listed as x y z w
        turns = np.minimum(*(np.abs(frame.quats - sign * quat).max(1) for sign in (1, -1)))
        errors = np.maximum(np.abs(have - want).max(1), turns)
        if errors.min() > 2e-5:
            k = errors.argmin()
            sys.exit(f"{path}: splat {i}: {want} {quat}, read {have[k]} {frame.quats[k]}")


for bundle in sys.argv[2:]:
    name = os.path.join(sys.argv[1], os.path.basename(bundle)[:-5] + ".json")
    listed = json.load(open(name))
    (compare_states if "states" in listed else compare_splats)(name, listed, spin4d.load(bundle))
print(len(sys.argv) - 2)
