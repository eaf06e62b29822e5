#!/usr/bin/env python3
"""changes.py BUILD [WORD...]: what the commands of this build do differently from those of another.

Runs the scripts of tests/cli, the tests of tests/cmd and every_export.sh, or those whose path
contains a WORD, with the commands of both builds, and compares what each command printed, its exit
code, and every file that it left. What varies between two runs of one build does not count. Prints
up to SHOW (5) differing lines of each test. Exit code: 1 if anything differs, so that a change that
is to alter nothing can be shown to alter nothing.

    make changes SINCE=HEAD~1 K=t3001      builds the revision in build/changes, then runs this"""
import glob
import os
import sys
from concurrent.futures import ThreadPoolExecutor

ROOT = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
sys.path.append(os.path.join(ROOT, "tests", "mutants"))
sys.dont_write_bytecode = True
import records  # noqa: E402
import run as tests  # noqa: E402
import scope  # noqa: E402

SHOW = int(os.environ.get("SHOW") or 5)
LIMIT = 1200  # seconds of a test


def record_of(test, build):
    """Its lines with the commands of a build. A failed check is a line too."""
    lines = []
    more = {"SPIN_BIN": build + "/bin", "SPIN_BUILD": build}
    tests.run_test(ROOT, (test, None), LIMIT, lines, more)
    return records.lines_of("".join(lines).replace(build + "/", ""), ROOT)


def differences(test, builds):
    """Lines that differ; in doubt each side is run again."""
    old, new = (record_of(test, b) for b in builds)
    if not records.Baseline([old]).differences(new):
        return []
    old = records.Baseline([old, record_of(test, builds[0])])
    if not old.differences(new):
        return []
    again = set(old.differences(record_of(test, builds[1])))
    return [line for line in old.differences(new) if line in again]


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    builds = [os.path.relpath(sys.argv[1], ROOT), tests.BUILD]
    chosen = glob.glob("tests/cli/t*.sh", root_dir=ROOT) + glob.glob("tests/cmd/t-*.c", root_dir=ROOT) + \
        ["tests/tools/every_export.sh"]
    chosen = [t for t in sorted(chosen) if not scope.LEFT_OUT.search(t)]
    chosen = [t for t in chosen if any(w in t for w in sys.argv[2:] or [""])]
    n = 0
    with ThreadPoolExecutor(tests.JOBS) as pool:
        for test, found in zip(chosen, pool.map(lambda t: differences(t, builds), chosen)):
            n += bool(found)
            if found:
                print("%s: %d lines" % (test, len(found)))
                print("".join("    %s\n" % line[:300] for line in found[:SHOW]), end="", flush=True)
    print("%d of %d tests show a difference" % (n, len(chosen)))
    return 1 if n or not chosen else 0


if __name__ == "__main__":
    sys.exit(main())
