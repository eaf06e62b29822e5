#!/usr/bin/env python3
"""run.py [WORD]: insert faults into copies of the tree, one by one, and check that a test fails.

Without WORD and SEMANTIC, N faults (default 50) are drawn by SEED (default 1) from the sources:
faults.py generates them, scope.py chooses the tests of each.

    N=200 SEED=7    the same draw on every machine, whatever JOBS is
    IN=src/train    only files below this folder, or this file
    SINCE=rev       only lines that differ from a revision
    JOBS=n          trees in build/mutants in which faults are tried in parallel
    PART=2/9        every ninth fault, from the second on
    MINUTES=9       starts no further fault after this time, and reports how many were tried
    LENIENT=1       a survivor is a warning: the exit code is 0
    WIDE=1          all other tests are run too before a fault counts as survived
    DRY=1           check both lists and print the draw; build nothing

With WORD (make mutants M=word) the faults of semantic.list are tried instead whose name or file
contains it; M=all takes all of them. These are faults that the generator cannot make.

A fault that does not compile is replaced by another one. A fault is killed when one of its tests
fails or does not end, and survives when all pass. A test counts only if it passes without the
fault. Exit code: 0 if every fault was killed, 1 if one survived, 2 if a list has a mistake.

Lists are records of `key: value`, separated by empty lines; a line that begins with white space
continues the value:

    name: no-shuffling             semantic.list only
    file: src/train/some.c
    old: size_t j = random();      text of the file, in which line breaks and indents do not count
    nth: 2                         which of several places, from 1
    new: size_t j = i;             the text in its place; may be empty
    tests: train/t-some cli/t9001  semantic.list only: parts of the paths of tests, cheapest first;
                                   train/t-some:part is one PART() of a long test
    reason: why no test fails      accepted.list only: such a fault is not drawn

A test that skips for want of a fixture detects nothing: see SPIN_FIXTURES in tests/run.sh."""
import functools
import glob
import hashlib
import json
import os
import queue
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time

sys.dont_write_bytecode = True
import faults as generator  # noqa: E402
import relink  # noqa: E402
import scope as scopes  # noqa: E402

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(os.path.dirname(HERE))
WORK = os.path.join(ROOT, "build", "mutants")
JOBS = int(os.environ.get("JOBS") or os.cpu_count() or 2)
# Processor seconds of tests after which a drawn fault counts as survived: those most likely to
# detect it run first, and `make mutants SINCE=HEAD~20` is to take ten minutes.
MOST_SECONDS = 60
WIDE = os.environ.get("WIDE") or ""
MOST_WIDE_SECONDS = 400
LEAST_LIMIT, UNTIMED_LIMIT = 20, 120  # seconds a test may take
BUILD = "build/release"
PRODUCT = ("src/", "importers/", "exporters/")
ENDINGS = (".c", ".h", ".def", ".cu")
# A header that more objects than this include would cost minutes per fault.
MOST_OBJECTS = 12
RUN_COMMANDS = ("tests/cli/", "tests/cmd/")  # the other rooms need programs of their own only
KEYS = {"name", "file", "nth", "old", "new", "tests", "reason"}
say_lock = threading.Lock()
running = set()  # tests


def say(text):
    with say_lock:
        print(text, flush=True)


class Mistake(Exception):
    pass


# ---- The lists -----------------------------------------------------------------------------------


def read_records(path):
    """The records of a list, each with the place where it stands."""
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
                    raise Mistake("%s:%d: '%s' is not a key, or is there twice" % (path, number, key))
                record.setdefault("at", "%s:%d" % (os.path.relpath(path, ROOT), number))
                record[key] = value.strip()


def read_list(name, needed):
    """All records of a list, which must have these keys."""
    records, names = [], set()
    for r in read_records(os.path.join(HERE, name)):
        missing = needed - set(r)
        if missing:
            raise Mistake("%s: no %s" % (r["at"], ", ".join(sorted(missing))))
        if "name" in needed and r["name"] in names:
            raise Mistake("%s: a second '%s'" % (r["at"], r["name"]))
        names.add(r.get("name"))
        records.append(r)
    return records


def place_of(fault, text):
    """The position of the old text; all white space counts as one space."""
    words = [re.escape(w) for w in fault["old"].split()]
    found = [m.span() for m in re.finditer(r"\s+".join(words), text)]
    nth = int(fault.get("nth", 0))
    if not found:
        raise Mistake("%s: its text is not in %s" % (fault["at"], fault["file"]))
    if (nth == 0 and len(found) > 1) or nth > len(found):
        raise Mistake("%s: its text is %d times in %s" % (fault["at"], len(found), fault["file"]))
    return found[nth - 1 if nth else 0]


def text_of(fault, tree):
    try:
        with open(os.path.join(tree, fault["file"])) as f:
            return f.read()
    except OSError:
        raise Mistake("%s: no file %s" % (fault["at"], fault["file"]))


def changed(fault, text):
    first, last = place_of(fault, text)
    return text[:first] + fault["new"] + text[last:]


def has_part(test, part):
    with open(os.path.join(ROOT, test)) as f:
        return re.search(r"PART\(%s[,)]" % part, f.read()) is not None


def tests_of(fault):
    """(path, part or None) of each test that a record names."""
    there = sorted(glob.glob("tests/*/t-*.c", root_dir=ROOT) + glob.glob("tests/cli/t*.sh", root_dir=ROOT))
    tests = []
    for word in fault["tests"].split():
        word, _, part = word.partition(":")
        found = [(t, part or None) for t in there if word in t and (not part or has_part(t, part))]
        if not found:
            raise Mistake("%s: no test '%s'%s" %
                          (fault["at"], word, " with a part '%s'" % part if part else ""))
        tests += [t for t in found if t not in tests]
    return tests


# ---- Faults --------------------------------------------------------------------------------------


class Trial:
    """One fault with its tests."""

    def __init__(self, name, file, tests, change, shown, kind="semantic", others=()):
        self.name, self.file, self.tests, self.change, self.shown, self.kind = name, file, tests, change, shown, kind
        self.others = others  # tests to run if all of `tests` pass


def semantic_trials(word):
    trials, mistakes = [], []
    for r in read_list("semantic.list", {"name", "file", "old", "new", "tests"}):
        if word != "all" and word not in r["name"] and word not in r["file"]:
            continue
        try:
            changed(r, text_of(r, ROOT))
            trials.append(Trial(r["name"], r["file"], tests_of(r), lambda text, r=r: changed(r, text),
                                "%s: '%s'" % (r["at"], r["name"])))
        except Mistake as mistake:
            mistakes.append(str(mistake))
    return trials, mistakes


def accepted_texts():
    """file -> whole texts of the file with an accepted fault, and the mistakes of the list."""
    texts, mistakes = {}, []
    for r in read_list("accepted.list", {"file", "old", "new", "reason"}):
        try:
            texts.setdefault(r["file"], set()).add(squeeze(changed(r, text_of(r, ROOT))))
        except Mistake as mistake:
            mistakes.append(str(mistake))
    return texts, mistakes


def squeeze(text):
    """For the comparison of C texts: white space beside punctuation does not count."""
    return re.sub(r"\s*([^\w\s])\s*", r"\1", re.sub(r"\s+", " ", text))


def product_files(below):
    out = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"] + list(PRODUCT),
                         cwd=ROOT, stdout=subprocess.PIPE, check=True).stdout.decode()
    files = [f for f in sorted(out.split("\0")) if f.endswith(ENDINGS) and os.path.exists(os.path.join(ROOT, f))]
    return [f for f in files if f == below or f.startswith(below.rstrip("/") + "/")] if below else files


def changed_lines(since):
    """file -> set of the numbers of lines that differ from a revision."""
    out = subprocess.run(["git", "diff", "-U0", "--no-color", "--no-ext-diff", since, "--"] + list(PRODUCT), cwd=ROOT,
                         stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    if out.returncode != 0:
        raise Mistake(out.stderr.decode(errors="replace").strip())
    lines, file = {}, None
    for line in out.stdout.decode(errors="replace").splitlines():
        if line.startswith("+++ "):
            file = line[6:] if line.startswith("+++ b/") else None
        hunk = re.match(r"^@@ -\S+ \+(\d+)(?:,(\d+))? @@", line)
        if hunk and file:
            first, n = int(hunk.group(1)), int(hunk.group(2) or 1)
            lines.setdefault(file, set()).update(range(first, first + n))
    return lines


def draw(rng, below, since):
    """All faults of the chosen files in a random order: first a line, then a kind, then a fault of
    it."""
    only = changed_lines(since) if since else None
    accepted, mistakes = accepted_texts()
    by_line, texts = {}, {}
    for file in product_files(""):
        generator.add_zeros(read(file))
    for file in product_files(below):
        if only is not None and file not in only:
            continue
        texts[file] = text = read(file)
        faults = generator.faults_of(file, text)
        for fault, line in zip(faults, generator.lines_of(faults, text)):
            if only is None or line in only[file]:
                by_line.setdefault((file, line), []).append(fault)
    lines = sorted(by_line)
    rng.shuffle(lines)
    faults = [one_of(rng, by_line[line]) for line in lines]
    return [f for f in faults if f.file not in accepted or
            squeeze(generator.apply(f, texts[f.file])) not in accepted[f.file]], texts, mistakes


def one_of(rng, faults):
    kind = rng.choice(sorted({f.kind for f in faults}))
    return rng.choice([f for f in faults if f.kind == kind])


def read(file):
    with open(os.path.join(ROOT, file)) as f:
        return f.read()


def drawn_trial(fault, text, scope):
    line = generator.line_of(fault, text)
    return Trial("%s:%d %s" % (fault.file, line, fault.kind), fault.file, [(t, None) for t in scope.tests_of(fault.file)],
                 lambda whole: generator.apply(fault, whole), generator.show(fault, text), fault.kind,
                 [(t, None) for t in scope.others(fault.file)] if WIDE else ())


# ---- Records of earlier runs ---------------------------------------------------------------------


class Memory:
    """Seconds of each test, which tests killed faults of a file, and which pass without a fault."""

    def __init__(self, path, key):
        self.path, self.lock = path, threading.Lock()
        try:
            with open(path) as f:
                self.all = json.load(f)
        except (OSError, ValueError):
            self.all = {}
        for name in ("seconds", "killers"):
            self.all.setdefault(name, {})
        if self.all.get("key") != key:
            self.all.update(key=key, passes={})

    def save(self):
        with self.lock, open(self.path, "w") as f:
            json.dump(self.all, f, indent=0, sort_keys=True)

    def seconds(self, test):
        return self.all["seconds"].get(label(test))

    def timed(self, test, seconds):
        with self.lock:
            self.all["seconds"][label(test)] = round(seconds, 1)

    def passes(self, test):
        return self.all["passes"].get(label(test))

    def set_passes(self, test, passes):
        with self.lock:
            self.all["passes"][label(test)] = passes

    def killed(self, file, test):
        with self.lock:
            for place in (file, os.path.dirname(file)):
                counts = self.all["killers"].setdefault(place, {})
                counts[label(test)] = counts.get(label(test), 0) + 1

    def order(self, file, tests):
        """Orders tests by the faults that they probably kill per second: first those that killed
        others of this file or folder, or that scope.py prefers."""
        own, near = (self.all["killers"].get(place, {}) for place in (file, os.path.dirname(file)))
        worth = {label(t): (own.get(label(t), 0) + near.get(label(t), 0) / 8 + 0.85 ** i) /
                 (1 + (self.seconds(t) or scopes.guess(t[0]))) for i, t in enumerate(tests)}
        return sorted(tests, key=lambda t: -worth[label(t)])

    def limit(self, test):
        seconds = self.seconds(test)
        return max(LEAST_LIMIT, 10 * seconds) if seconds is not None else UNTIMED_LIMIT + scopes.guess(test[0]) * 10


def label(test):
    return test[0] + (":" + test[1] if test[1] else "")


# ---- One tree ------------------------------------------------------------------------------------


def run(command, cwd):
    """Exit code and output."""
    p = subprocess.run(command, cwd=cwd, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                       stderr=subprocess.STDOUT, env=environment())
    return p.returncode, p.stdout.decode(errors="replace")


def limit_resources():
    """A fault may allocate or write without an end. Tests may raise these limits again."""
    for what, most in ((resource.RLIMIT_AS, 64 << 30), (resource.RLIMIT_FSIZE, 4 << 30)):
        resource.setrlimit(what, (most, resource.getrlimit(what)[1]))


def run_test(tree, test, limit, record=None, more=None):
    """Runs a test until its first line that is not ok. Returns why it failed, or None if it passed,
    and its processor seconds. With `record`, a list that receives all of the output, it runs to its
    end and also prints what it does not check. `more` is added to the environment."""
    path, part = test
    more = dict(more or {}, **({"TAP_PART": part} if part else {}))
    errors = subprocess.DEVNULL if record is None else tempfile.TemporaryFile()
    if record is not None:
        more["SPIN_RECORD"] = "1"
    command = [os.path.join(tree, binary(test))] if binary(test) else ["sh", path]
    room = tempfile.mkdtemp(prefix="mutant")
    p = subprocess.Popen(command, cwd=tree, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                         stderr=errors, start_new_session=True, preexec_fn=limit_resources,
                         env=dict(environment(), TMPDIR=room, **more))
    late = threading.Timer(limit, end, [p])
    n, why = 0, None
    running.add(p)
    late.start()
    for line in p.stdout:
        n += 1
        if record is not None:
            record.append(line.decode(errors="replace"))
        elif line.startswith(b"not ok"):
            why = line.decode(errors="replace").strip()
            end(p)
    used = wait_for(p)
    if record is not None:
        errors.seek(0)
        record.append(errors.read().decode(errors="replace"))
        errors.close()
    if not late.is_alive() and not why:
        why = "did not end within %.0f s" % limit
    late.cancel()
    running.discard(p)
    clean_up(room)
    return why or ("exit code %d" % p.returncode if p.returncode or n == 0 else None), used


def clean_up(room):
    """Removes what a killed test leaves in its temporary folder, file systems included."""
    with open("/proc/mounts") as f:
        mounted = [line.split()[1] for line in f]
    for path in mounted:
        if path.startswith(room + "/"):
            subprocess.run(["umount", path], stderr=subprocess.DEVNULL)
    shutil.rmtree(room, ignore_errors=True)


def wait_for(p):
    """Processor seconds of a process and all those that it waited for."""
    _, status, usage = os.wait4(p.pid, 0)
    p.returncode = os.waitstatus_to_exitcode(status)
    return usage.ru_utime + usage.ru_stime


def end(p):
    """With all of its child processes."""
    try:
        os.killpg(p.pid, signal.SIGKILL)
    except ProcessLookupError:
        pass


@functools.lru_cache(None)
def python_with_numpy():
    for python in ("python3", "/usr/bin/python3"):
        p = subprocess.run([python, "-c", "import sys, numpy; print(sys.executable)"], stdout=subprocess.PIPE,
                           stderr=subprocess.DEVNULL)
        if p.returncode == 0:
            return p.stdout.decode().strip()
    return sys.executable


def environment():
    env = dict(os.environ)
    for name in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS", "K", "M", "N", "IN", "SEED", "SINCE", "DRY", "PART", "MINUTES",
                 "LENIENT", "WIDE"):
        env.pop(name, None)
    beside = os.path.join(ROOT, "..", "shared", "fixtures")
    if not env.get("SPIN_FIXTURES"):
        env["SPIN_FIXTURES"] = os.path.abspath(beside) if os.path.isdir(beside) else "fixtures"
    env.setdefault("SPIN_PYTHON", python_with_numpy())
    env.setdefault("SPIN_PROGRESS", "0")
    env["SPIN_BUILD"] = BUILD
    env["SPIN_BIN"] = BUILD + "/bin"
    return env


def binary(test):
    return BUILD + "/" + test[0][:-2] if test[0].endswith(".c") else None


def build(tree, targets, drawn=False):
    # A drawn fault that causes a type error is found by the compiler, not by a test.
    strict = ["CFLAGS=-Werror=int-conversion -Werror=incompatible-pointer-types"] if drawn else []
    return run(["make", "--no-print-directory", "CONFIG=release", "CUDA=0", "-j2"] + strict + sorted(targets), tree)


def targets_of(tree, tests):
    """The programs of tests, and the commands that they run."""
    wanted = {binary(t) for t in tests if binary(t)}
    for t in tests:
        if t[0].startswith(RUN_COMMANDS):
            wanted.add("all")
        if "tests/emu" in open(os.path.join(tree, t[0])).read():
            wanted |= {"test-tools", *(BUILD + "/tests/emu/%s.so" % so for so in
                                       ("spin-cuda", "spin-cuda-race", "faults", "faults-race"))}
        if "bench" in t[0]:
            wanted.add("test-bins")
    return wanted


def listed_files():
    out = subprocess.run(["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"], cwd=ROOT,
                         stdout=subprocess.PIPE, check=True).stdout.decode()
    return sorted(name for name in set(out.split("\0")) if name and os.path.isfile(os.path.join(ROOT, name)))


def copy_tree(tree, files):
    """Copies the sources. The first copy of a file keeps its time, since the build is copied
    too."""
    keep = set(files)
    for folder, _, names in os.walk(tree):
        inside = os.path.relpath(folder, tree)
        if inside.split(os.sep)[0] == "build":
            continue
        for name in names:
            if os.path.normpath(os.path.join(inside, name)) not in keep:
                os.remove(os.path.join(folder, name))
    for name in files:
        source, copy = os.path.join(ROOT, name), os.path.join(tree, name)
        if not os.path.exists(copy):
            os.makedirs(os.path.dirname(copy), exist_ok=True)
            shutil.copy2(source, copy)
        elif not same(source, copy):
            shutil.copyfile(source, copy)
            shutil.copymode(source, copy)


def copy_build(source, tree):
    for part in ("release", "race", "shims"):
        there, here = os.path.join(source, "build", part), os.path.join(tree, "build", part)
        if os.path.isdir(there) and not os.path.isdir(here):
            os.makedirs(os.path.dirname(here), exist_ok=True)
            subprocess.run(["cp", "-a", "--reflink=auto", there, here], check=True)


def make_trees(n):
    """Tree 0, which never has a fault, and n others."""
    code, out = build(ROOT, {"all", "test-bins"})
    if code != 0:
        raise Mistake("the tree does not build without a fault:\n" + out[-2000:])
    files, commands = listed_files(), relink.read_commands(ROOT, BUILD, environment())
    trees = [relink.Tree(os.path.join(WORK, str(i)), ROOT, BUILD, commands) for i in range(n + 1)]
    for tree in trees:
        copy_tree(tree.path, files)
        tree.link_farm()
    return trees


def make_real_tree(tree):
    """A copy of sources and build, for faults in files that only make compiles: CUDA, scripts,
    pages, shims."""
    path = tree.path + ".real"
    if os.path.exists(path + ".fault"):  # left by an interrupted run
        shutil.rmtree(path)
    copy_tree(path, listed_files())
    copy_build(ROOT, path)
    code, out = build(path, {"all", "test-bins"})
    if code != 0:
        raise Mistake("a copy of the tree does not build:\n" + out[-2000:])
    return path


def key_of(files):
    """A value that changes when a file does."""
    digest = hashlib.sha256()
    for name in files:
        with open(os.path.join(ROOT, name), "rb") as f:
            digest.update(name.encode() + b"\0" + hashlib.sha256(f.read()).digest())
    return digest.hexdigest()


def same(a, b):
    try:
        with open(a, "rb") as f, open(b, "rb") as g:
            return f.read() == g.read()
    except OSError:
        return False


CHECKS = {  # of files that are not compiled
    ".py": [sys.executable, "-c", "import sys; compile(open(sys.argv[1]).read(), sys.argv[1], 'exec')"],
    ".js": ["node", "--check"],
    ".sh": ["sh", "-n"],
    ".vert .frag": ["node", "--input-type=module", "-e", "import fs from 'node:fs'; import { compile } from "
                    "'./tests/viewers/lib/glsl.mjs'; compile(fs.readFileSync(process.argv[1], 'utf8'));"],
}


def check(tree, path):
    """The exit code and output of a syntax check of a script."""
    for endings, command in CHECKS.items():
        if os.path.splitext(path)[1] in endings.split() and shutil.which(command[0]):
            return run(command + [path], tree)
    return 0, ""


class Inserted:
    """A fault in a tree. At the end the file and the objects compiled from it are as before; only
    the objects are newer, so that all that links them is linked again."""

    def __init__(self, tree, trial, objects):
        self.path, self.trial, self.mark = os.path.join(tree, trial.file), trial, tree + ".fault"
        self.objects = [os.path.join(tree, BUILD, o) for o in objects]
        self.restores = not trial.file.endswith(".cu") and self.objects

    def __enter__(self):
        with open(self.path) as f:
            self.whole = f.read()
        self.times = os.stat(self.path).st_atime_ns, os.stat(self.path).st_mtime_ns
        if self.restores:
            self.kept = tempfile.mkdtemp(prefix="mutant")
            for i, o in enumerate(self.objects):
                shutil.copyfile(o, os.path.join(self.kept, str(i)))
        open(self.mark, "w").close()
        with open(self.path, "w") as f:
            f.write(self.trial.change(self.whole))

    def __exit__(self, *_):
        if self.restores:
            for i, o in enumerate(self.objects):
                shutil.copyfile(os.path.join(self.kept, str(i)), o)
            shutil.rmtree(self.kept)
        with open(self.path, "w") as f:
            f.write(self.whole)
        if self.restores:
            os.utime(self.path, ns=self.times)
        os.remove(self.mark)


class Judge:
    def __init__(self, trees, scope, memory):
        self.clean, self.scope, self.memory, self.lock, self.real = trees[0].path, scope, memory, threading.RLock(), {}

    def try_fault(self, tree, trial):
        """The result: killed, survived or mistake, and the reason."""
        objects = self.scope.objects_of(trial.file)
        if trial.kind != "semantic" and len(objects) > MOST_OBJECTS:
            return "mistake", "%d objects would be compiled" % len(objects)
        if trial.file.endswith((".c", ".h", ".def")) and objects and \
                all(BUILD + "/" + o in tree.commands for o in objects):
            return self.try_relinked(tree, trial, objects)
        return self.try_made(self.real_tree(tree), trial, objects)

    def real_tree(self, tree):
        with self.lock:
            if tree.path not in self.real:
                self.real[tree.path] = make_real_tree(tree)
            return self.real[tree.path]

    def try_relinked(self, tree, trial, objects):
        path = os.path.join(tree.path, trial.file)
        whole = read(trial.file)
        try:
            with open(path, "w") as f:
                f.write(trial.change(whole))
            code, out = tree.compile(objects)
            if code != 0:
                return "mistake", "does not compile:\n" + out[-1500:]
            return self.try_tests(tree.path, trial, lambda test, _: tree.link_for(test[0], read(test[0]), binary(test)))
        finally:
            with open(path, "w") as f:
                f.write(whole)
            tree.restore()

    def try_made(self, tree, trial, objects):
        built = set()

        def prepare(test, after):
            if targets_of(tree, [test]) <= built:
                return 0, ""
            more = targets_of(tree, [test] + (self.next_programs(after) if built else []))
            built.update(more)
            return build(tree, more, trial.kind != "semantic")

        with Inserted(tree, trial, objects):
            code, out = check(tree, trial.file)
            if code != 0:
                return "mistake", "is not of its language:\n" + out[-1500:]
            return self.try_tests(tree, trial, prepare)

    def try_tests(self, tree, trial, prepare):
        spent, passed, most = 0, [], MOST_WIDE_SECONDS if trial.others else MOST_SECONDS
        tests = self.memory.order(trial.file, trial.tests) + self.memory.order(trial.file, trial.others)
        for i, test in enumerate(tests):
            if trial.kind != "semantic" and spent > most:
                break
            code, out = prepare(test, tests[i + 1:])
            if code != 0:
                return "mistake", "does not build:\n" + out[-1500:]
            start = time.time()
            why, used = run_test(tree, test, self.memory.limit(test))
            spent += used
            if not why:
                passed.append(label(test))
                self.memory.timed(test, time.time() - start)
            elif self.passes_without(test):
                self.memory.killed(trial.file, test)
                return "killed", "%s: %s" % (label(test), why)
        return "survived", "passed: " + " ".join(passed)

    def next_programs(self, tests):
        """The tests to build together after the first one, since a call of make takes as long as a
        link."""
        programs = [t for t in tests if binary(t) and not t[0].startswith(RUN_COMMANDS)]
        return programs[:2]

    def passes_without(self, test):
        with self.lock:
            if self.memory.passes(test) is None:
                start = time.time()
                why, _ = run_test(self.clean, test, 900)
                if why:  # a limit on time may be exceeded once on a busy machine
                    why, _ = run_test(self.clean, test, 900)
                self.memory.set_passes(test, not why)
                if why:
                    say("%s fails without a fault and is not counted: %s" % (label(test), why))
                else:
                    self.memory.timed(test, time.time() - start)
            return self.memory.passes(test)


# ---- All faults ----------------------------------------------------------------------------------


class Report:
    def __init__(self, n):
        self.n, self.start, self.survivors, self.mistakes, self.kinds, self.killed = n, time.time(), [], [], {}, 0
        self.end = self.start + 60 * float(os.environ.get("MINUTES") or "inf")

    def done(self):
        return self.killed + len(self.survivors) + len(self.mistakes)

    def add(self, trial, what, how, seconds):
        survived, all_ = self.kinds.get(trial.kind, (0, 0))
        self.kinds[trial.kind] = (survived + (what == "survived"), all_ + 1)
        if what == "killed":
            self.killed += 1
        else:
            (self.survivors if what == "survived" else self.mistakes).append(trial)
        left = (time.time() - self.start) / self.done() * (self.n - self.done())
        say("%4d/%d %-8s %s (%.0f s, %s) %d min left" %
            (self.done(), self.n, what.upper() if what != "killed" else what, trial.name, seconds, how, round(left / 60)))
        if what == "survived":
            say(trial.shown)

    def summary(self, words):
        tried = self.killed + len(self.survivors)
        if self.survivors:
            say("\nsurvivors:\n" + "\n".join(t.shown for t in self.survivors))
        say("\n" + ", ".join("%s %d of %d" % (kind, *self.kinds[kind]) for kind in sorted(self.kinds)))
        if self.done() < self.n:
            say("%d of %d faults were tried in MINUTES=%s" % (self.done(), self.n, os.environ["MINUTES"]))
        say("%d of %d faults survived (%.1f %%), %s, %.0f s, %.1f s per fault" %
            (len(self.survivors), tried, 100 * len(self.survivors) / max(tried, 1), words,
             time.time() - self.start, (time.time() - self.start) / max(tried, 1)))


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


def judge_all(slots, words):
    """Each slot is a list of trials, of which the first that compiles counts."""
    start = time.time()
    trees = make_trees(min(JOBS, len(slots)))
    memory = Memory(os.path.join(WORK, "memory.json"), key_of(listed_files()))
    judge = Judge(trees, scopes.Scope(ROOT, BUILD), memory)
    say("%d faults, %d trees after %.0f s" % (len(slots), len(trees) - 1, time.time() - start))
    report = Report(len(slots))

    def work(tree, slot):
        began = time.time()
        if began > report.end:
            return
        for make in slot:
            trial = make(judge.scope)
            what, how = judge.try_fault(tree, trial)
            if what != "mistake":
                break
        report.add(trial, what, how, time.time() - began)
        memory.save()

    in_parallel(trees[1:], slots, work)
    report.summary(words)
    return report


def drawn_slots(n, seed, below, since):
    faults, texts, mistakes = draw(random.Random(seed), below, since)
    for mistake in mistakes:
        say("accepted.list is not up to date: " + mistake)
    if not faults and not since:
        raise Mistake("no fault can be made in '%s'" % below)
    n = min(n, len(faults))
    # A fault that does not compile is replaced by one of the faults behind the n drawn.
    return [[lambda scope, f=f: drawn_trial(f, texts[f.file], scope) for f in faults[k::n][:6]] for k in range(n)], \
        [(f, texts[f.file]) for f in faults[:n]]


def main():
    env = {name: os.environ.get(name) or "" for name in ("N", "SEED", "IN", "SINCE", "PART", "DRY")}
    word = sys.argv[1] if len(sys.argv) > 1 else ""
    part, _, of = (env["PART"] or "1/1").partition("/")
    mine = slice(int(part) - 1, None, int(of))
    seed = int(env["SEED"] or 1)
    words = "seed %d" % seed
    _, mistakes = semantic_trials("all")
    mistakes += accepted_texts()[1]
    if mistakes and (word or env["DRY"]):
        raise Mistake("\n".join(mistakes))
    if word:
        trials, _ = semantic_trials(word)
        slots, shown, words = [[lambda scope, t=t: t] for t in trials], [t.shown for t in trials], "semantic.list"
    else:
        slots, faults = drawn_slots(int(env["N"] or 50), seed, env["IN"], env["SINCE"])
        shown = [generator.show(*f) for f in faults]
    if env["DRY"]:
        say("\n".join(shown[mine]))
        say("%d faults; semantic.list and accepted.list have no mistake" % len(shown[mine]))
        return 0
    if not slots[mine]:
        if word:
            raise Mistake("no fault is called '%s'" % word)
        say("no fault to try: no code has changed since %s" % env["SINCE"])
        return 0
    report = judge_all(slots[mine], words)
    if report.survivors and os.environ.get("LENIENT"):
        say("warning: no test detects the faults above; see CONTRIBUTING.md")
        return 0
    return 2 if word and report.mistakes else 1 if report.survivors else 0


def stop(*_):
    raise KeyboardInterrupt


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, stop)
    try:
        sys.exit(main())
    except Mistake as mistake:
        say(str(mistake))
        sys.exit(2)
    except KeyboardInterrupt:
        for process in list(running):
            end(process)
        sys.exit(130)
