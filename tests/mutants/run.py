#!/usr/bin/env python3
"""run.py [WORD]: put one deliberate fault after the other into a copy of the tree, build it, and see
whether a test fails. With WORD only those that have it in their name or in the path of their file.

The faults stand in the files *.list beside this one, as records with empty lines between:

    name: no-shuffling            how it is called
    file: src/train/some.c         where it goes
    old: size_t j = random();     text that stands there once; how it is broken into lines does not count
    nth: 2                        or which of several places, from 1
    new: size_t j = i;            what comes instead; may be empty
    tests: train/t-some cli/t9001  pieces of the paths of tests that should see it, the cheapest first;
                                  train/t-some:part is one PART() of a long test
    survives: why                 it may pass all its tests; at most two may

A fault is killed when one of its tests fails or does not end, and survives when all pass. A text that is
not there, or more than once, a test that is not there and a fault that does not compile, or that is not of
its language, are mistakes in the list. The exit code is 0 when there are none and nothing survived that
should not.

JOBS: trees worked on at a time, in build/mutants. PART=2/9: every ninth fault from the second on, for what takes hours
in a whole. DRY=1: only look for mistakes in the list. A test that
skips for want of a fixture sees nothing: see SPIN_FIXTURES in tests/run.sh."""
import glob
import os
import queue
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(os.path.dirname(HERE))
WORK = os.path.join(ROOT, "build", "mutants")
JOBS = int(os.environ.get("JOBS") or os.cpu_count() or 2)
MOST_SURVIVORS = 2
LEAST_LIMIT = 120  # seconds a test may take at least
BUILD = "build/release"
RUN_COMMANDS = ("tests/cli/", "tests/cmd/")  # the other rooms need programs of their own only
KEYS = {"name", "file", "nth", "old", "new", "tests", "survives"}
say_lock = threading.Lock()
running = set()  # tests


def say(text):
    with say_lock:
        print(text, flush=True)


class Mistake(Exception):
    pass


# ---- The list -------------------------------------------------------------------------------------


def read_records(path):
    """Records of `key: value` with empty lines between; a line that begins with a blank goes on."""
    record, key = {}, None
    with open(path) as f:
        for number, line in enumerate(list(f) + ["\n"], 1):
            line = line.rstrip("\n")
            if line.startswith("#"):
                continue
            if not line.strip():
                if record:
                    yield record
                record, key = {}, None
            elif line[0] in " \t" and key:
                record[key] += "\n" + line.strip()
            else:
                key, _, value = line.partition(":")
                if key not in KEYS or key in record:
                    raise Mistake("%s:%d: '%s' is no key, or there twice" % (path, number, key))
                record.setdefault("at", "%s:%d" % (os.path.relpath(path, ROOT), number))
                record[key] = value.strip()


def read_list(word):
    faults, names = [], set()
    for path in sorted(glob.glob(os.path.join(HERE, "*.list"))):
        for r in read_records(path):
            missing = {"name", "file", "old", "new", "tests"} - set(r)
            if missing or r["name"] in names:
                raise Mistake("%s: %s" % (r["at"], "no " + ", ".join(sorted(missing)) if missing else
                                          "a second '%s'" % r["name"]))
            names.add(r["name"])
            if word in r["name"] or word in r["file"]:
                faults.append(r)
    return faults


def place_of(fault, text):
    """Where the old text stands; runs of blanks and line ends count as one."""
    words = [re.escape(w) for w in fault["old"].split()]
    found = [m.span() for m in re.finditer(r"\s+".join(words), text)]
    nth = int(fault.get("nth", 0))
    if not found:
        raise Mistake("%s: '%s': its text is not in %s" % (fault["at"], fault["name"], fault["file"]))
    if (nth == 0 and len(found) > 1) or nth > len(found):
        raise Mistake("%s: '%s': its text is %d times in %s" %
                      (fault["at"], fault["name"], len(found), fault["file"]))
    return found[nth - 1 if nth else 0]


def text_of(fault, tree):
    try:
        with open(os.path.join(tree, fault["file"])) as f:
            return f.read()
    except OSError:
        raise Mistake("%s: '%s': no file %s" % (fault["at"], fault["name"], fault["file"]))


def changed(fault, text):
    first, last = place_of(fault, text)
    return text[:first] + fault["new"] + text[last:]


def has_part(test, part):
    with open(os.path.join(ROOT, test)) as f:
        return re.search(r"PART\(%s[,)]" % part, f.read()) is not None


def tests_of(fault):
    """(path, part or None) of words as for `make test K=`, of paths only; a part comes behind a colon."""
    there = sorted(glob.glob("tests/*/t-*.c", root_dir=ROOT) + glob.glob("tests/cli/t*.sh", root_dir=ROOT))
    tests = []
    for word in fault["tests"].split():
        word, _, part = word.partition(":")
        found = [(t, part or None) for t in there if word in t and (not part or has_part(t, part))]
        if not found:
            raise Mistake("%s: '%s': no test '%s'%s" %
                          (fault["at"], fault["name"], word, " with a part '%s'" % part if part else ""))
        tests += [t for t in found if t not in tests]
    return tests


# ---- One tree -------------------------------------------------------------------------------------


def run(command, cwd):
    """Exit code and output."""
    p = subprocess.run(command, cwd=cwd, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                       stderr=subprocess.STDOUT, env=environment())
    return p.returncode, p.stdout.decode(errors="replace")


def run_test(tree, test, limit):
    """None when it passes, else why not: the first line that is not ok ends it."""
    test, part = test
    more = {"TAP_PART": part} if part else {}
    command = [os.path.join(tree, binary(test))] if binary(test) else ["sh", test]
    room = tempfile.mkdtemp(prefix="mutant")
    p = subprocess.Popen(command, cwd=tree, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                         stderr=subprocess.DEVNULL, start_new_session=True,
                         env=dict(environment(), TMPDIR=room, **more))
    late = threading.Timer(limit, end, [p])
    n, why = 0, None
    running.add(p)
    late.start()
    for line in p.stdout:
        n += 1
        if line.startswith(b"not ok"):
            why = line.decode(errors="replace").strip()
            end(p)
    p.wait()
    if not late.is_alive() and not why:
        why = "did not end"
    late.cancel()
    running.discard(p)
    shutil.rmtree(room, ignore_errors=True)  # a test that is ended does not clean up
    return why or ("exit code %d" % p.returncode if p.returncode or n == 0 else None)


def end(p):
    """With all that it started."""
    try:
        os.killpg(p.pid, signal.SIGKILL)
    except ProcessLookupError:
        pass


def environment():
    env = dict(os.environ)
    for name in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS", "K", "M"):
        env.pop(name, None)
    beside = os.path.join(ROOT, "..", "shared", "fixtures")
    if not env.get("SPIN_FIXTURES"):
        env["SPIN_FIXTURES"] = os.path.abspath(beside) if os.path.isdir(beside) else "fixtures"
    env["SPIN_BUILD"] = BUILD
    env["SPIN_BIN"] = BUILD + "/bin"
    return env


def binary(test):
    return BUILD + "/" + test[:-2] if test.endswith(".c") else None


def build(tree, tests):
    """The commands and shims where a test runs them, and the programs named."""
    wanted = sorted({binary(t) for t, _ in tests if binary(t)})
    if any(t.startswith(RUN_COMMANDS) for t, _ in tests):
        wanted.append("all")
    if any("tests/emu" in open(os.path.join(tree, t)).read() for t, _ in tests):
        wanted.append("test-bins")  # the emulation, and programs of others
    return run(["make", "--no-print-directory", "CONFIG=release", "-j2"] + wanted, tree)


def make_trees(n, tests):
    """n copies of the files that git knows or would know, the first one built, the others like it."""
    first = os.path.join(WORK, "1")
    listed = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT,
                            stdout=subprocess.PIPE, check=True).stdout.decode().split("\0")
    keep = {name for name in listed if name and os.path.exists(os.path.join(ROOT, name))}
    for folder, _, files in os.walk(first):
        inside = os.path.relpath(folder, first)
        if inside.split(os.sep)[0] == "build":
            continue
        for name in files:
            if os.path.normpath(os.path.join(inside, name)) not in keep:
                os.remove(os.path.join(folder, name))
    for name in sorted(keep):
        source, copy = os.path.join(ROOT, name), os.path.join(first, name)
        os.makedirs(os.path.dirname(copy), exist_ok=True)
        if not same(source, copy):
            shutil.copyfile(source, copy)
            shutil.copymode(source, copy)
    code, out = build(first, tests)
    if code != 0:
        raise Mistake("the tree does not build without a fault:\n" + out[-2000:])
    for i in range(2, n + 1):
        shutil.rmtree(os.path.join(WORK, str(i)), ignore_errors=True)
        subprocess.run(["cp", "-a", first, os.path.join(WORK, str(i))], check=True)
    return [os.path.join(WORK, str(i)) for i in range(1, n + 1)]


def same(a, b):
    try:
        with open(a, "rb") as f, open(b, "rb") as g:
            return f.read() == g.read()
    except OSError:
        return False


# ---- All faults -----------------------------------------------------------------------------------


def in_parallel(trees, items, work):
    todo = queue.Queue()
    for item in items:
        todo.put(item)

    def hand(tree):
        while True:
            try:
                item = todo.get_nowait()
            except queue.Empty:
                return
            work(tree, item)

    hands = [threading.Thread(target=hand, args=(tree,), daemon=True) for tree in trees]
    for h in hands:
        h.start()
    for h in hands:
        h.join()


def time_tests(trees, tests):
    """What each takes without a fault; it must pass, or it would kill everything."""
    seconds, failed = {}, []

    def work(tree, test):
        start = time.time()
        why = run_test(tree, test, 900)
        seconds[test] = time.time() - start
        if why:
            failed.append("%s fails without a fault: %s" % (test[0], why))

    in_parallel(trees, tests, work)
    if failed:
        raise Mistake("\n".join(failed))
    return seconds


CHECKS = {  # of what no compiler sees
    ".py": [sys.executable, "-c", "import sys; compile(open(sys.argv[1]).read(), sys.argv[1], 'exec')"],
    ".js": ["node", "--check"],
    ".sh": ["sh", "-n"],
    ".vert .frag": ["node", "--input-type=module", "-e", "import fs from 'node:fs'; import { compile } from "
                    "'./tests/viewers/lib/glsl.mjs'; compile(fs.readFileSync(process.argv[1], 'utf8'));"],
}


def check(tree, path):
    """Exit code and output of a look at a script's grammar."""
    for endings, command in CHECKS.items():
        if os.path.splitext(path)[1] in endings.split() and shutil.which(command[0]):
            return run(command + [path], tree)
    return 0, ""


def try_fault(tree, fault, seconds):
    """What became of it, and how that was seen."""
    path = os.path.join(tree, fault["file"])
    tests = sorted(fault["run"], key=lambda t: seconds[t])
    whole = text_of(fault, tree)
    try:
        with open(path, "w") as f:
            f.write(changed(fault, whole))
        code, out = check(tree, fault["file"])
        if code != 0:
            return "mistake", "is not of its language:\n" + out[-1500:]
        for i, test in enumerate(tests):
            code, out = build(tree, tests[i:i + 1])
            if code != 0:
                return "mistake", "does not build:\n" + out[-1500:]
            why = run_test(tree, test, max(LEAST_LIMIT, 10 * seconds[test]))
            if why:
                return "killed", "%s: %s" % (test[0], why)
        return "survived", "passed: " + " ".join(t for t, _ in tests)
    finally:
        with open(path, "w") as f:
            f.write(whole)


def main():
    word = sys.argv[1] if len(sys.argv) > 1 else ""
    part, _, of = os.environ.get("PART", "1/1").partition("/")
    faults, mistakes = read_list(word)[int(part) - 1::int(of)], []
    tests = []
    for fault in faults:
        try:
            changed(fault, text_of(fault, ROOT))
            fault["run"] = tests_of(fault)
            tests += [t for t in fault["run"] if t not in tests]
        except Mistake as mistake:
            mistakes.append(str(mistake))
    if mistakes or not faults:
        sys.exit("\n".join(mistakes) or "no fault is called '%s'" % word)
    if os.environ.get("DRY"):
        say("%d faults, %d tests, the list has no mistake" % (len(faults), len(tests)))
        return 0
    start = time.time()
    trees = make_trees(min(JOBS, len(faults)), tests)
    say("%d faults, %d tests, %d trees built after %.0f s" % (len(faults), len(tests), len(trees), time.time() - start))
    seconds = time_tests(trees, tests)
    say("all pass without a fault, after %.0f s" % (time.time() - start))
    came = {}

    def work(tree, fault):
        began = time.time()
        what, how = try_fault(tree, fault, seconds)
        came[fault["name"]] = what
        if what == "survived":
            say("SURVIVED %s, as the list has it: %s" % (fault["name"], fault["survives"])
                if "survives" in fault else "SURVIVED %s (%s)" % (fault["name"], how))
        else:
            say("%s %s (%.0f s, %s)" % ("killed  " if what == "killed" else "MISTAKE ", fault["name"],
                                        time.time() - began, how))
        if what == "killed" and "survives" in fault:
            say("         the list need not let %s survive any more" % fault["name"])

    in_parallel(trees, faults, work)
    survivors = [f for f in faults if came[f["name"]] == "survived"]
    wrong = [f["name"] for f in faults if came[f["name"]] == "mistake"]
    unwanted = [f["name"] for f in survivors if "survives" not in f]
    say("%d faults: %d killed, %d survived, %d mistakes in the list, %.0f s" %
        (len(faults), len(faults) - len(survivors) - len(wrong), len(survivors), len(wrong), time.time() - start))
    if unwanted:
        say("survived without a reason: " + " ".join(unwanted))
    if len(survivors) > MOST_SURVIVORS:
        say("more than %d survived" % MOST_SURVIVORS)
    return 1 if unwanted or wrong or len(survivors) > MOST_SURVIVORS else 0


try:
    sys.exit(main())
except Mistake as mistake:
    sys.exit(str(mistake))
except KeyboardInterrupt:
    for process in list(running):
        end(process)
    sys.exit(130)
