#!/usr/bin/env python3
"""scale.py [--bin DIR] [--work DIR] [AXIS=VALUE[,VALUE]...]: measures how the cost of each command
grows with frames, splats, pixels and cameras, and prints the tables of docs/scale.md.

    python3 tests/bench/scale.py                       # all four tables
    python3 tests/bench/scale.py frames=10,100         # one axis, these values

Each axis varies one number of a synthetic clip (tests/bench/clip.c: eight balls, one of which
moves) and keeps the others. The images are renders of the clip itself, so their number and size
are free. A row is the processor time (user and system, one thread) and the peak memory of each
command (RssAnon, sampled every 10 ms; pages of mapped files belong to the system and are not
counted). The last row of a table is the slope between its first and last values, d log(cost) /
d log(value): 1 is linear growth, 0 none.
"""
import argparse
import math
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time

# Frames, splats per frame, width, height and cameras of each axis; the varied one is replaced.
AXES = {
    "frames": ((10, 100, 1000, 10000), dict(frames=0, splats=1000, size=(96, 54), cameras=3)),
    "splats": ((30000, 300000, 3000000), dict(frames=2, splats=0, size=(320, 180), cameras=4)),
    "pixels": ((640, 1600, 3840), dict(frames=2, splats=30000, size=None, cameras=4)),
    "cameras": ((4, 30, 100), dict(frames=2, splats=30000, size=(160, 90), cameras=0)),
}
ITERATIONS = 40  # a second run takes twice as many: the difference is the time of an iteration
FORMATS = {"html": "out.html", "tsog": "out.tsog", "gltf": "out.glb", "spz": "out", "ply": "out"}
TABLES = (
    ("import s", "import MiB", "source MB", "set-up s", "iteration ms", "train MiB", "bundle MB", "eval s"),
    (*(f"{f} {unit}" for f in FORMATS for unit in ("s", "MB")), "export MiB", "one frame s"),
)


def anonymous_mib(pid):
    try:
        with open(f"/proc/{pid}/status") as f:
            return next((int(line.split()[1]) / 1024 for line in f if line.startswith("RssAnon")), 0)
    except OSError:
        return 0


def run(command):
    """Returns the processor seconds of the command and its peak memory in MiB."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen([str(c) for c in command], stdout=log, stderr=log)
        peak = 0
        while process.poll() is None:
            peak = max(peak, anonymous_mib(process.pid))
            time.sleep(0.01)
        if process.returncode != 0:
            log.seek(0)
            sys.exit("scale.py: %s: exit code %d\n%s" % (command[0], process.returncode, log.read().decode()))
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime, peak


def megabytes(path):
    files = [path] if os.path.isfile(path) else [os.path.join(d, f) for d, _, names in os.walk(path) for f in names]
    return sum(os.path.getsize(f) for f in files) / 1e6


def measure(tools, work, frames, splats, size, cameras):
    """Returns the row of one clip, by column."""
    clip, source, trained = (os.path.join(work, name) for name in ("clip", "source.spin", "trained.spin"))
    row = {}
    run([tools["clip"], clip, frames, splats, 0, 1])
    row["import s"], row["import MiB"] = run([tools["spin-import"], clip, "-o", source])
    row["source MB"] = megabytes(source)
    renders = "renders:cameras=%d,test=1,size=%dx%d" % (cameras, *size)
    train = [tools["spin-retrain"], source, "--data", "renders", "--data-from", renders, "--threads", 1]
    short, _ = run([*train, "--iterations", ITERATIONS, "-o", trained])
    shutil.rmtree(trained, ignore_errors=True)
    long, row["train MiB"] = run([*train, "--iterations", 2 * ITERATIONS, "--force", "-o", trained])
    row["iteration ms"] = (long - short) / ITERATIONS * 1000
    row["set-up s"] = 2 * short - long
    row["bundle MB"] = megabytes(trained)
    row["eval s"], _ = run([tools["spin-eval"], trained, "--threads", 1])
    row["export MiB"] = 0
    for name, out in FORMATS.items():
        out = os.path.join(work, out)
        seconds, peak = run([tools["spin-export"], trained, "--to", name, "--threads", 1, "-o", out])
        row[f"{name} s"], row[f"{name} MB"] = seconds, megabytes(out)
        row["export MiB"] = max(row["export MiB"], peak)
        shutil.rmtree(out) if os.path.isdir(out) else os.remove(out)
    one = "%d:%d" % (frames // 2, frames // 2 + 1)
    row["one frame s"], _ = run([tools["spin-export"], trained, "--to", "ply", "--range", one, "-o", os.path.join(work, "out")])
    return row


def number(value):
    return "%.0f" % value if value >= 100 else "%.1f" % value if value >= 10 else "%.2f" % value


def print_line(*cells):
    print("| " + " | ".join(cells) + " |", flush=True)


def print_tables(axis, fixed, rows):
    kept = ", ".join("%s %s" % (k, "x".join(map(str, v)) if k == "size" else v) for k, v in fixed.items() if v)
    print("\n## By %s\n\n%s." % (axis, kept))
    for columns in TABLES:
        print()
        print_line(axis, *columns)
        print_line(*["---"] * (1 + len(columns)))
        for value, row in rows:
            print_line("{:,}".format(value), *(number(row[c]) for c in columns))
        (first, a), (last, b) = rows[0], rows[-1]
        if first < last:
            slope = lambda c: math.log(b[c] / a[c]) / math.log(last / first)  # noqa: E731
            print_line("slope", *("%.2f" % slope(c) if min(a[c], b[c]) > 0 else "" for c in columns))


def measure_axis(axis, values, tools, work):
    fixed = AXES[axis][1]
    rows = []
    for value in values:
        clip = dict(fixed, size=(value, value * 9 // 16)) if axis == "pixels" else dict(fixed, **{axis: value})
        folder = os.path.join(work, "%s-%d" % (axis, value))
        os.mkdir(folder)
        rows.append((math.prod(clip["size"]) if axis == "pixels" else value, measure(tools, folder, **clip)))
        shutil.rmtree(folder)
        print("%s %d: done" % (axis, value), file=sys.stderr)
    print_tables(axis, fixed, rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", default="build/release/bin", metavar="DIR")
    parser.add_argument("--work", metavar="DIR", help="folder for the clips (default: a temporary one)")
    parser.add_argument("axes", nargs="*", metavar="AXIS=VALUE", help=", ".join(AXES))
    a = parser.parse_args()
    wanted = {axis: values for axis, (values, _) in AXES.items()}
    if a.axes:
        named = dict(word.partition("=")[::2] for word in a.axes)
        if not set(named) <= set(AXES):
            parser.error("the axes are " + ", ".join(AXES))
        wanted = {axis: tuple(map(int, text.split(","))) if text else AXES[axis][0] for axis, text in named.items()}
    tools = {name: os.path.join(a.bin, name) for name in ("spin-import", "spin-retrain", "spin-eval", "spin-export")}
    tools["clip"] = os.path.join(a.bin, "..", "tests", "bench", "clip")
    for tool in tools.values():
        if not os.path.exists(tool):
            parser.error("%s is missing: make all test-bins" % tool)
    with tempfile.TemporaryDirectory(dir=a.work) as work:
        for axis, values in wanted.items():
            measure_axis(axis, values, tools, work)


if __name__ == "__main__":
    main()
