#!/usr/bin/env python3
"""transcript.py FILE.md SECTION BIN_DIR WORK [--write]: runs the commands of a section in WORK and
prints TAP: each line that the transcript quotes must be in the output of its command. On the SIMD
path avx-512, with which the figures were taken, figures must match to the digit; elsewhere those
that depend on a training may differ. --write updates the figures in FILE."""
import os
import re
import subprocess
import sys

file, section, bin_dir, work = sys.argv[1:5]
write = "--write" in sys.argv
env = {**os.environ, "PATH": os.path.abspath(bin_dir) + ":" + os.environ["PATH"]}
lines = open(file).read().split("\n")
at = lines.index("## " + section) + 1
printed, exact, count, failed = [], True, 0, 0


def figures_out(line):
    return re.sub(r"[0-9]+([.][0-9]+)?", "N", line)


def timed_out(line):
    return re.sub(r"about [0-9].* here", "about N here", line)


while at < len(lines) and not lines[at].startswith("## "):
    line = lines[at]
    if line.startswith("$ "):
        run = subprocess.run(line[2:], shell=True, cwd=work, env=env, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                             stderr=subprocess.STDOUT, universal_newlines=True)
        printed = run.stdout.split("\n")
        exact &= not any("training and" in p and "cpu (avx-512" not in p for p in printed)
        count += 1
        failed += run.returncode != 0
        print(f"{'not ' if run.returncode else ''}ok {count} - {line}")
    elif line.startswith("```"):
        printed = []
    elif printed and line != "...":
        found = [p for p in printed if figures_out(p) == figures_out(line)]
        good = found and (write or not exact or any(timed_out(p) == timed_out(line) for p in found))
        if write and found:
            lines[at] = found[0] if timed_out(found[0]) != timed_out(line) else line
        count += 1
        failed += not good
        print(f"{'' if good else 'not '}ok {count} - {line}" + ("" if good else f"\n#   prints {found or printed}"))
    at += 1
print(f"1..{count}")
if write and not failed:
    with open(file, "w") as f:
        f.write("\n".join(lines))
sys.exit(failed > 0)
