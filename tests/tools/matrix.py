#!/usr/bin/env python3
"""Converts clips to every format of splats and back, and compares the tables of docs/formats.md
with the result.

matrix.py check|update BIN_DIR WORK_DIR NAME=BUNDLE... -- NAME=BUNDLE...

The bundles before -- are clips: for each of them, the first table compares the middle frame of the
source with the same frame of each file, imported again. Those after it are runs of importers: the
second table has a mark for each pair of an importer and an exporter. Prints one line for each
conversion that fails without a known reason, for each loss that no message mentions, and for each
row that differs from the tables; `update` replaces the tables instead."""
import json
import os
import re
import shutil
import subprocess
import sys

import numpy as np

sys.dont_write_bytecode = True
sys.path.insert(0, "exporters/python")
import spin4d  # noqa: E402

PAGE = "docs/formats.md"
KINDS = ("position", "scale", "rotation", "opacity", "colour", "SH")
# Exporter, name of its output, whether it quantises values.
WRITERS = [("ply", "out", False), ("compressed-ply", "out", True), ("sog", "out", True),
           ("streamed-sog", "out", True), ("splat", "out", True), ("spz", "out", True), ("gltf", "out.glb", False),
           ("usd", "out.usdc", False), ("4dgs", "out.4dgs", True),
           ("ftgs", "out.ftgs.ply", False), ("sogst", "out.sogst", True), ("sogst-ply", "out.sogst.ply", False),
           ("stglite", "out.stg.ply", False), ("tsog", "out.tsog", True), ("html", "out.html", True)]
# Larger differences are a loss, which a message must mention; smaller ones are rounding. Positions
# are relative to the extent of the scene, rotations in degrees.
ROUNDING = {True: (0.002, 0.1, 3, 0.02, 0.03, 0.1), False: (1e-6, 1e-5, 1e-3, 1e-4, 1e-5, 1e-5)}
ROUNDS = "rounds values; rms error"
WORDS = {"position": ROUNDS + "|approximated by degree", "scale": ROUNDS, "rotation": ROUNDS + "|rotations that change",
         "opacity": ROUNDS + "|rounds times", "colour": ROUNDS + "|colours that change",
         "SH": "sh .*[1-9].* \\(|SH above degree|colours that change", "splats": "splats were left out", "frames": "frames",
         "fps": "frame rate", "antialias": "trained with antialiasing"}
REFUSALS = {"begin or end abruptly": "splats that begin or end abruptly", "do not fade": "splats that do not fade",
            "keep their full opacity": "splats that do not fade",
            "but this clip has frames": "frames", "no splat is the same in all": "no static splats"}
# Frames of each conversion, of which the last is compared.
N_FRAMES = 2


def command(name, *argv):
    done = subprocess.run([os.path.join(sys.argv[2], name), *argv], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    return done.returncode, done.stdout, done.stderr


def features(frame, extent):
    return np.concatenate([frame.means / extent, 0.02 * frame.sh[:, 0], 0.02 * frame.opacities[:, None],
                           0.01 * np.log(frame.scales)], axis=1)


def largest_errors(frame, other, extent):
    """Compares rows of a frame, at most 256, with the most similar rows of another, since files
    have other orders."""
    frame = spin4d.Frame(*(a[::len(a) // 256 + 1] for a in frame))
    a, b = features(frame, extent), features(other, extent)
    at = np.array([np.argmin(((b - row) ** 2).sum(1)) for row in a])
    k = max(frame.sh.shape[1], other.sh.shape[1])
    sh = [np.pad(f.sh, ((0, 0), (0, k - f.sh.shape[1]), (0, 0))) for f in (frame, other)]
    chord = np.minimum(*(np.linalg.norm(frame.quats - sign * other.quats[at], axis=1) for sign in (1, -1)))
    return [np.linalg.norm(frame.means - other.means[at], axis=1).max() / extent,
            np.abs(np.log(frame.scales / other.scales[at])).max(), np.degrees(4 * np.arcsin(np.minimum(chord / 2, 1))).max(),
            np.abs(frame.opacities - other.opacities[at]).max(), 0.282095 * np.abs(sh[0][:, 0] - sh[1][at][:, 0]).max(),
            np.abs(sh[0][:, 1:] - sh[1][at][:, 1:]).max(initial=0)]


def above(frame, opacity):
    keep = frame.opacities > opacity
    return spin4d.Frame(*(a[keep] for a in frame))


class Source:
    """Frames in the middle of a bundle."""

    def __init__(self, path):
        self.path, self.clip = path, spin4d.load(path)
        first = max(0, (len(self.clip) - N_FRAMES) // 2)
        self.numbers = self.clip.numbers[first:first + N_FRAMES]
        self.fps, self.name = self.clip.meta.get("fps"), self.clip.meta["from"]
        if self.clip.versions:
            self.frame = self.clip.frame(first + len(self.numbers) - 1)
            self.extent = float(np.ptp(self.frame.means, axis=0).max())


class Conversion:
    def __init__(self, source, writer):
        self.to, name, self.rounds = writer
        self.what, self.errors, self.lost, self.faults = f"{source.name} to {self.to}", None, {}, []
        self.n = self.fps = None
        folder = os.path.join(sys.argv[3], "conversion")
        shutil.rmtree(folder, ignore_errors=True)
        os.mkdir(folder)
        checks = ["--check"] if self.to == "html" else []
        code, said, self.said = command("spin-export", source.path, "--to", self.to, "-o", os.path.join(folder, name),
                                        "--range", f"{source.numbers[0]}:{source.numbers[-1] + 1}", "--threads", "1",
                                        "--json", *checks)
        self.refused = "" if code == 0 else next((v for k, v in REFUSALS.items() if k in self.said), None)
        if self.refused is None:
            self.faults.append(self.said.strip())
        if code != 0:
            return
        if checks:
            check = json.loads(said)["check"]
            self.errors = [check[k]["largest"] for k in ("place", "log_scale", "rotation_deg", "opacity", "colour", "sh")]
            self.errors[0] /= source.extent
        elif self.to != "usd" or os.path.exists("importers/usd.c"):
            self.read_back(source, os.path.join(folder, name), os.path.join(folder, "back.spin"))
        self.find_losses(source)

    def read_back(self, source, path, bundle):
        code, _, said = command("spin-import", path, "-o", bundle, "-q", "--threads", "1")
        if code != 0:
            self.faults.append("cannot be imported: " + said.strip())
            return
        back = spin4d.load(bundle)
        if len(back) != len(source.numbers):
            self.lost["frames"] = f"{len(source.numbers)} frames become {len(back)}"
            return
        # Rows at the limit of visibility may have no counterpart.
        a, b = above(source.frame, 0.01), above(back.frame(len(back) - 1), 0.005)
        self.n = len(a.means)
        if len(b.means) < len(above(a, 0.02).means):
            self.lost["splats"] = f"{self.n} splats become {len(b.means)}"
        self.fps = back.meta.get("fps")
        if source.fps and (not self.fps or abs(self.fps - source.fps) > 1e-4):
            self.lost["fps"] = f"the frame rate {source.fps:g} becomes {self.fps}"
        if source.clip.antialias() and not back.antialias():
            self.lost["antialias"] = "antialiasing"
        self.errors = largest_errors(above(a, 0.02), b, source.extent)

    def find_losses(self, source):
        for kind, error, most in zip(KINDS, self.errors or [], ROUNDING[self.rounds]):
            if error > most:
                self.lost[kind] = f"{kind} {error:.2g}"
        for kind, loss in self.lost.items():
            if not re.search(WORDS[kind], self.said):
                self.faults.append(f"no message mentions a loss: {loss}")

    def mark(self):
        return "-" if self.refused != "" else "!" if self.lost else "~" if self.rounds else "="


def number(x):
    return "0" if x < 1e-7 else f"{x:.2g}"


def clip_row(name, source, c):
    """Returns a row of the first table."""
    if c.refused:
        return f"| {name} | `{c.to}` | refused: {c.refused} | | | | | | | |"
    if not c.errors:
        return f"| {name} | `{c.to}` | not read back | | | | | | | |"
    lost = [k for k in c.lost if k not in KINDS]
    lost += ["SH"] if c.errors[5] > 0.1 and c.to == "splat" else []
    fps = f"{c.fps:g}" if c.fps else ""
    return " | ".join([f"| {name}", f"`{c.to}`", f"{c.n or ''}", fps, *map(number, c.errors), ", ".join(lost)]).rstrip() + " |"


def tables(clips, runs):
    faults = []
    first = ["| clip | format | splats | fps | position | scale | rotation | opacity | colour | SH | lost |",
             "|---|---|---|---|---|---|---|---|---|---|---|"]
    files = [writer for writer in WRITERS if writer[0] != "html"]
    second = ["| importer | " + " | ".join(f"`{writer[0]}`" for writer in files) + " |", "|---|" + "---|" * len(files)]
    for name, path in clips:
        source = Source(path)
        for writer in WRITERS:
            c = Conversion(source, writer)
            faults += [f"{name}: {c.what}: {f}" for f in c.faults]
            first.append(clip_row(name, source, c))
    for name, path in runs:
        source = Source(path)
        if not source.clip.versions:
            second.append(f"| {name} | positions only: needs `spin-retrain`" + " |" * len(files))
            continue
        row = [Conversion(source, writer) for writer in files]
        faults += [f"{c.what}: {f}" for c in row for f in c.faults]
        second.append(f"| {name} | " + " | ".join(c.mark() for c in row) + " |")
    return [first, second], faults


def same_cell(a, b):
    """Compares numbers to 20 percent, which compilers and processors may change."""
    try:
        return abs(float(a) - float(b)) <= 0.2 * abs(float(b)) + 1e-6
    except ValueError:
        return a == b


def same_row(a, b):
    a, b = ([cell.strip() for cell in row.split("|")] for row in (a, b))
    return len(a) == len(b) and all(map(same_cell, a, b))


def main():
    middle = sys.argv.index("--")
    clips, runs = ([word.split("=", 1) for word in words] for words in (sys.argv[4:middle], sys.argv[middle + 1:]))
    made, faults = tables(clips, runs)
    text = open(PAGE).read()
    for table in made:
        print("\n".join(table) + "\n", file=sys.stderr)
        start = text.index(table[0])
        end = text.index("\n\n", start)
        kept = text[start:end].split("\n")
        if sys.argv[1] == "update":
            text = text[:start] + "\n".join(table) + text[end:]
        elif len(kept) != len(table):
            faults.append(f"{PAGE} has {len(kept)} rows, expected {len(table)}: run tests/cli/t3021-matrix.sh update")
        else:
            faults += [f"{PAGE} has '{old}', expected '{new}'" for old, new in zip(kept, table) if not same_row(old, new)]
    if sys.argv[1] == "update":
        open(PAGE, "w").write(text)
    for fault in faults:
        print(fault)


main()
