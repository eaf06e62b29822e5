#!/usr/bin/env python3
"""same_objects.py [OPTIONS] [BEFORE [AFTER]] [-- FILE...]: proves that only comments changed.

    tests/tools/same_objects.py --quick                 # HEAD against the working tree, seconds
    tests/tools/same_objects.py                         # the same, by object code
    tests/tools/same_objects.py HEAD~3 HEAD             # two commits
    tests/tools/same_objects.py HEAD~1 HEAD -- src/run  # only these files

Object mode lays both trees out in build/same_objects and compiles every object that a changed file
contributes to, directly or through headers, as `make CONFIG=release CUDA=0` does: product, tests,
CUDA kernels in their emulation, and shared objects that are linked in one go. It compares the
bytes after `objcopy --strip-debug`, lists the objects that differ, and exits with 1 if any does.
Line numbers are kept out of the objects: __LINE__ is defined as 0, since asserts would store it,
and the emulation is built without -fsanitize=bounds, whose tables contain source locations.
ccache is used if installed. --cflags=-O0 is several times faster and proves the same.

Quick mode compares the changed files themselves: for C, C++ and CUDA the tokens without comments,
with adjacent strings joined; for Python the syntax tree without docstrings; for shell, JavaScript
and others all lines that are neither blank nor a comment. It prints the first difference of each
file. Equal tokens imply equal objects, except for __LINE__ and for macro arguments that are turned
into strings (#) and contain a comment."""
import argparse
import ast
import os
import re
import shutil
import subprocess
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
sys.dont_write_bytecode = True
import prose  # noqa: E402

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..")
WORK = "build/same_objects"
# The Makefile turns these pages into C strings.
PAGES = {"exporters/html/": "exporters/html_page", "src/eval/report/page.html": "src/eval/report/page",
         "src/eval/report/compare.html": "src/eval/report/compare_html", "src/run/watch.html": "src/run/watch_html"}
# Sources that are compiled and linked in one go.
LINKED = {"src/io/image_oiio.cpp": "lib/spin-image.so", "src/formats/glb_tiny.cpp": "lib/spin-gltf.so",
          "src/io/image_plain.c": "lib/spin-image-plain.so", "src/io/ranks_mpi.c": "lib/spin-mpi.so",
          "src/io/video_ffmpeg.c": "lib/spin-video.so", "src/io/video_encode_ffmpeg.c": "lib/spin-video.so",
          "tests/tools/make-video.c": "tests/tools/make-video",
          "tests/tools/read-sound.c": "tests/tools/read-sound"}
# Built by other compilers only (emscripten, MinGW, nvcc) or outside this Makefile.
ELSEWHERE = re.compile(r"src/web/|src/base/windows/|src/device/cuda/gpu\.cu|man/|tests/card/")


def git(*args):
    return subprocess.run(["git", *args], check=True, capture_output=True, text=True).stdout


def changed_files(before, after):
    """Paths that differ; for the working tree this includes untracked files."""
    found = git("diff", "--name-only", "--no-renames", before, *([after] if after else []), "--").split("\n")
    if not after:
        found += git("ls-files", "-o", "--exclude-standard").split("\n")
    return sorted({f for f in found if f})


def text_of(revision, path):
    if not revision:
        return prose.read(path) if os.path.isfile(path) else None
    shown = subprocess.run(["git", "show", revision + ":" + path], capture_output=True)
    return shown.stdout.decode("utf-8", "replace") if shown.returncode == 0 else None


# ---- Tokens


def c_tokens(text):
    """(token, line) without comments; directives end with a newline, adjacent strings join."""
    found, directive, begins, spaced = [], False, True, False
    for kind, token, line in prose.tokens(text):
        if kind == "newline":
            if directive:
                found.append(["\n", line])
            directive, begins = False, True
        elif kind in ("space", "comment", "continued"):
            spaced = True
            continue
        else:
            if begins and token == "#":
                directive = True
            # "#define F (x)" and "#define F(x)" are different macros.
            if token == "(" and spaced and len(found) > 1 and found[-2][0] == "define":
                token = " ("
            last = found[-1][0] if found else ""
            if kind == "string" and token[0] == '"' and last[:1] == '"' and not re.search(r"\\(x[0-9a-fA-F]+|[0-7]+)$", last[:-1]):
                found[-1][0] = last[:-1] + token[1:]
            else:
                found.append([token, line])
            begins = False
        spaced = False
    return found


def bare(path, text):
    """(piece, line) of everything in a file except comments."""
    if path.endswith(prose.C_LIKE):
        return c_tokens(text)
    if path.endswith(".py"):
        tree = ast.parse(text)
        for node in ast.walk(tree):
            body = getattr(node, "body", None)
            if isinstance(body, list) and body and isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant):
                body[0].value.value = ""
        return [[line, 0] for line in ast.dump(tree, indent=0).split("\n")]
    mark = r"\s*(//|$)" if path.endswith(prose.SLASH) else r"\s*(#(?!!)|$)"
    return [[line, n] for n, line in enumerate(text.split("\n"), 1) if not re.match(mark, line)]


def quick(before, after, paths):
    differ = 0
    for path in paths:
        old, new = text_of(before, path), text_of(after, path)
        if old is None or new is None:
            print("%s: %s" % (path, "is new" if old is None else "is gone"))
            differ += 1
            continue
        a, b = bare(path, old), bare(path, new)
        if [t for t, _ in a] == [t for t, _ in b]:
            continue
        differ += 1
        at = next((i for i, (x, y) in enumerate(zip(a, b)) if x[0] != y[0]), min(len(a), len(b)))
        piece = [" ".join(t for t, _ in x[max(0, at - 6):at + 6]).replace("\n", "\\n") for x in (a, b)]
        line = b[min(at, len(b) - 1)][1] if b else 0
        print("%s:%d: was '%s', is '%s'" % (path, line, *piece))
    print("same_objects: %d of %d files differ in more than comments" % (differ, len(paths)))
    return differ == 0


# ---- Objects


def lay_out(revision, folder):
    shutil.rmtree(folder, ignore_errors=True)
    os.makedirs(folder)
    if revision:
        archive = subprocess.Popen(["git", "archive", revision], stdout=subprocess.PIPE)
        subprocess.run(["tar", "-xf", "-", "-C", folder], stdin=archive.stdout, check=True)
        if archive.wait() != 0:
            sys.exit("same_objects: git archive %s" % revision)
        return
    for path in prose.files():
        os.makedirs(os.path.dirname(os.path.join(folder, path)) or ".", exist_ok=True)
        shutil.copy2(path, os.path.join(folder, path))


def included_by(folder):
    """For each file the set of files that include it, directly or indirectly."""
    direct = {}
    sources = [p for p in prose.files(folder) if p.endswith(prose.C_LIKE)]
    for path in sources:
        for name in re.findall(r'^\s*#\s*include\s*"([^"]+)"', prose.read(os.path.join(folder, path)), re.M):
            for base in (os.path.dirname(path), "src", "", "tests/emu"):
                target = os.path.normpath(os.path.join(base, name))
                if os.path.isfile(os.path.join(folder, target)):
                    direct.setdefault(target, set()).add(path)
                    break
    deep = {}
    for target in direct:
        seen, queue = set(), [target]
        while queue:
            for path in direct.get(queue.pop(), ()):
                if path not in seen:
                    seen.add(path)
                    queue.append(path)
        deep[target] = seen
    return deep


def objects_of(path, paths_of_cpu):
    """The make targets of a source, relative to build/release."""
    if path in LINKED:
        return [LINKED[path]]
    for page, stem in PAGES.items():
        if path.startswith(page):
            return [stem + ".o"]
    stem, ending = os.path.splitext(path)
    if ELSEWHERE.match(path):
        return []
    if path.startswith("src/device/cpu/") and ending == ".c":
        return ["%s.%s.o" % (stem, p) for p in paths_of_cpu]
    if ending == ".cu":
        return [stem + ".emu.o"]
    if ending == ".c" and path.startswith(prose.PRODUCT + ("tests/",)) or ending == ".cpp" and path.startswith("tests/emu/"):
        return [stem + ".o"]
    return []


def wanted_objects(folder, paths, paths_of_cpu):
    by = included_by(folder)
    sources = set(paths)
    for path in paths:
        sources |= by.get(path, set())
    for path in list(sources):
        if path.startswith("exporters/html/") and path.endswith(".h"):
            sources.add("exporters/html/head.html")
    sources = {s for s in sources if os.path.isfile(os.path.join(folder, s))}
    none = sorted(s for s in sources if s.endswith((".c", ".cpp", ".cu")) and not objects_of(s, paths_of_cpu))
    return sorted({o for s in sources for o in objects_of(s, paths_of_cpu)}), none


def build(folder, objects, a):
    no_lines = " -D__LINE__=0 -w"
    cache = "ccache " if shutil.which("ccache") else ""
    env = dict(os.environ, CCACHE_BASEDIR=os.path.abspath(WORK), CCACHE_NOHASHDIR="1")
    for name in ("MAKEFLAGS", "MFLAGS", "BUILD", "B", "CONFIG", "CUDA"):
        env.pop(name, None)
    flags = ["CC=" + cache + a.cc + no_lines, "CXX=" + cache + a.cxx + no_lines, "CUDA=0", "EMU_BOUND=", "CFLAGS=-g0 " + a.cflags,
             "CXXFLAGS=-g0 " + a.cflags]
    for first in range(0, len(objects), 300):
        run = subprocess.run(["make", "-s", "--no-print-directory", "-C", folder, "-j%d" % a.jobs, *flags,
                              *("build/release/" + o for o in objects[first:first + 300])], env=env, stdout=subprocess.DEVNULL)
        if run.returncode != 0:
            sys.exit("same_objects: %s does not build" % folder)


def stripped(path):
    out = path + ".stripped"
    subprocess.run(["objcopy", "--strip-debug", path, out], check=True)
    with open(out, "rb") as f:
        return f.read()


def by_objects(before, after, paths, a):
    folders = [os.path.join(WORK, name) for name in ("before", "after")]
    for revision, folder in zip((before, after), folders):
        lay_out(revision, folder)
    machine = subprocess.run([*a.cc.split(), "-dumpmachine"], capture_output=True, text=True).stdout
    cpu = ["base", "v3", "v4"] if machine.startswith("x86_64") else ["base"]
    (old, _), (new, none) = (wanted_objects(f, paths, cpu) for f in folders)
    objects = [o for o in new if o in old]
    for folder in folders:
        build(folder, objects, a)
    differ = ["only one has " + o for o in sorted(set(old) ^ set(new))]
    for o in objects:
        one, two = (stripped(os.path.join(f, "build/release", o)) for f in folders)
        if one != two:
            differ.append(o)
    for o in differ:
        print(o)
    for source in none:
        print("not compiled here: %s; its tokens:" % source)
    same = quick(before, after, none) if none else True
    print("same_objects: %d of %d objects differ, of %d files" % (len(differ), len(objects), len(paths)))
    return same and not differ


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--cflags", default="")
    parser.add_argument("--cc", default="gcc")
    parser.add_argument("--cxx", default="g++")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 2)
    parser.add_argument("revisions", nargs="*", metavar="REVISION")
    argv, only = sys.argv[1:], []
    if "--" in argv:
        only = argv[argv.index("--") + 1:]
        argv = argv[:argv.index("--")]
    a = parser.parse_args(argv)
    os.chdir(ROOT)
    if len(a.revisions) > 2:
        parser.error("two revisions at most; files come after --")
    before, after = (a.revisions + ["HEAD", None])[0], a.revisions[1] if len(a.revisions) > 1 else None
    paths = changed_files(before, after)
    if only:
        paths = [p for p in paths if any(p == o or p.startswith(o.rstrip("/") + "/") for o in only)]
    def has_comments(path):
        return path.endswith(prose.C_LIKE + prose.SLASH) or prose.is_hash(path)
    known = tuple(p for p in paths if p.endswith(prose.C_LIKE) or any(p.startswith(page) for page in PAGES))
    if a.quick:
        same = quick(before, after, [p for p in paths if has_comments(p)])
    else:
        others = [p for p in paths if p not in known and has_comments(p)]
        same = by_objects(before, after, list(known), a)
        same = (quick(before, after, others) if others else True) and same
    left = [p for p in paths if not has_comments(p) and p not in known]
    if left:
        print("not looked at: " + " ".join(left))
    sys.exit(0 if same else 1)


if __name__ == "__main__":
    main()
