"""Chooses the tests for a fault: those that most probably detect it first, then a wider set.

Nothing is measured for it. The symbols of the objects tell how far a test program is from the
changed object: distance 1 calls it, distance 2 calls one that does. Command tests link everything,
so they are chosen by the words of the file's name in their text, and by ROOM_TESTS."""
import glob
import os
import re
import subprocess
from collections import defaultdict

# Tests of whole commands for each room, as beginnings of their paths below tests/; the longest
# matching room counts.
ROOM_TESTS = {
    "src/base": "base/ cli/t0001 cli/t0002 cli/t1001 cli/t9006",
    "src/io": "io/ scene/t-bundle importers/t-golden cli/t1001 cli/t3001",
    "src/formats": "formats/ exporters/t-readback cli/t1003 cli/t3002",
    "src/math": "math/ model/t-field importers/t-golden exporters/t-readback",
    "src/scene": "scene/ importers/t-golden run/t-spin cli/t1015 cmd/t-cameras",
    "src/scene/clip": "scene/ run/t-spin cmd/t-eval cmd/t-cameras cli/t2040",
    "src/scene/dataset": "scene/ importers/t-golden cli/t1015 cli/t2005 cmd/t-cameras",
    "src/scene/renders": "scene/t-renders cli/t2040",
    "src/model": "model/ importers/t-golden cli/t1001",
    "src/render": "run/t-spin exporters/t-readback importers/t-golden run/t-export cmd/t-export cli/t2002",
    "src/train": "train/t-train cmd/t-retrain cli/t2001 cli/t2007",
    "src/eval": "eval/ cmd/t-eval cli/t2030",
    "src/run": "run/ cmd/t-export cmd/t-eval cli/t0010 cli/t9001 cli/t9005",
    "src/base/shim": "cli/t0007 cli/t0003",
    "src/cmd": "cli/t0002 cli/t0010 cli/t1012 cli/t9005",
    "src/cmd/spin-import.c": "cmd/t-cameras cli/t1001 cli/t1010 cli/t1012 cli/t1015 cli/t9005",
    "src/cmd/spin-export.c": "cmd/t-export cli/t3001 cli/t3008 cli/t3015 cli/t9005",
    "src/cmd/spin-eval.c": "cmd/t-eval cli/t2030 cli/t9005",
    "src/cmd/spin-retrain.c": "train/t-defaults cmd/t-retrain cli/t2001 cli/t9005",
    "src/cmd/spin4d.c": "cli/t0002 cli/t0010 cli/t0013 cli/t9005",
    "src/cmd/args.c": "cli/t0002 cli/t0001 cli/t0005 cli/t1012 cli/t1016 cli/t2001 cli/t3008 cmd/t-eval",
    "src/device": "device/ train/t-train cmd/t-retrain cli/t2021",
    "src/device/cuda": "emu/t-emu cli/t2020",
    "src/eval/report": "eval/ cmd/t-eval cli/t2030 cli/t9005",
    "src/train/step": "train/t-train cli/t2001 cli/t5002",
    "src/train/loop": "train/t-train cli/t2001 cli/t2002 cli/t2007 cmd/t-retrain",
    "src/train/refinement": "train/t-refine cli/t2002 cmd/t-retrain",
    "src/train/rows_4d": "train/t-train scene/t-splats_4d cli/t2025 cmd/t-retrain",
    "src/train/backdrop": "cli/t2004 cli/t2009 cmd/t-retrain",
    "src/train/trained_output": "train/t-train cmd/t-retrain cli/t2001 cli/t2005 cli/t9005",
    "src/formats/usd": "importers/t-usd importers/t-golden importers/t-variants cli/t3022",
    "src/formats/sog": "formats/t-sog importers/t-tsog cli/t3011 cli/t3010",
    "src/run/export": "run/t-export cmd/t-export cli/t1026 cli/t3012 cli/t3001 cli/t3015 cli/t3002 cli/t9005",
    "src/run/data_hint": "scene/t-dataset cli/t1025 cmd/t-cameras run/",
    "src/run/decimate": "run/t-decimate cli/t3012 cli/t3015",
    "src/run/convert": "cli/t0010 cli/t0013 cli/t2040 cli/t9001 cli/t9005",
    "src/run/endings": "cli/t0002",
    "src/run/settle": "run/t-settle cli/t2040",
    "src/run/eval": "cmd/t-eval cli/t2030 cmd/t-retrain cli/t9005",
    "src/run/describe": "cli/t1012 cli/t1015 cli/t1017-l cli/t1024 cli/t2025 cli/t9005",
    "src/run/row_filter": "run/ cmd/t-export cli/t3015",
    "src/run/retrain": "cmd/t-retrain cli/t2025 cli/t2007 cli/t9006 cli/t9001",
    "src/run/import": "run/t-spin importers/t-golden cli/t1003 cli/t1022 cli/t1017 cli/t1001 cli/t1010 cli/t1011 cli/t1012 cli/t3009 cli/t9006",
    "src/io/ranks": "cli/t5002",
    "src/geometry": "geometry/ exporters/t-camera_path cli/t1026 cli/t3016",
    "src/geometry/camera_rig": "geometry/ scene/t-outer_cameras scene/t-dataset exporters/t-camera_path cli/t1026",
    "importers": "importers/t-detect importers/t-golden importers/t-rows cli/t1001 cli/t1010 cli/t9006",
    "importers/lib/views": "importers/t-colmap importers/t-transforms cli/t1024 cli/t1016 cli/t1017-l cli/t9006",
    "importers/lib/sog_levels": "cli/t1021 cli/t3027",
    "importers/lib/video_rows": "importers/t-dynerf cli/t9011",
    "importers/splats": "importers/t-splat_files cli/t1003 cli/t1021 cli/t3009",
    "importers/views": "importers/t-detect importers/t-golden importers/t-4danyone importers/t-panoptic cli/t1010 cli/t9006",
    "importers/usd": "importers/t-usd importers/t-golden cli/t3022",
    "exporters/sog_4d": "exporters/t-check cli/t3011 cli/t3010",
    "exporters/ply_4d": "exporters/t-check cli/t3010",
    "exporters/lib/time_windows": "cli/t3010 cli/t3011",
    "exporters/lib/quant": "exporters/t-quant cli/t3002 cli/t3011",
    "exporters/lib/frames": "run/t-export cmd/t-export cli/t3002 cli/t3003 cli/t9005",
    "exporters/images": "exporters/t-images cli/t3016 cli/t3009",
    "exporters/lib/camera_path": "exporters/t-camera_path cli/t3016",
    "exporters/lib/initial_view": "exporters/t-camera_path cmd/t-export cli/t3006 cli/t1026",
    "exporters/lib/path_file": "cli/t3016 cli/t3017",
    "exporters": "exporters/t-readback run/t-export cmd/t-export cli/t3002 cli/t3009",
    "exporters/html": "cli/t3006",
    "exporters/lib/usd": "exporters/t-usd importers/t-usd cli/t3022",
    "exporters/usd": "exporters/t-usd importers/t-usd cli/t3022",
}
GENERIC_WORDS = {"spin", "file", "text", "rows", "views", "model", "output", "table", "state", "math", "base", "image",
                 "frames", "import", "export", "eval", "data", "args", "step", "loop", "plan", "lib", "values", "check"}
# Tests that take minutes and detect nothing that others do not, unless ROOM_TESTS names them.
LEFT_OUT = re.compile(r"cli/t(0004|0006|0008|2020|2023|2024|3005|3007|3013|3017|500\d|9002|9003|9004|9007|9008|9010)|t-hostile|card/")
MOST_UNIT, MOST_NEAR, MOST_COMMAND, MOST_PLUGINS = 5, 3, 3, 4
# Seconds of a test that has not been timed yet.
GUESS = [("tests/cmd/", 30.0), ("tests/cli/t2", 40.0), ("tests/cli/t9", 30.0), ("tests/cli/", 8.0), ("tests/emu/", 20.0),
         ("tests/importers/t-hostile", 30.0), ("", 1.5)]


def guess(test):
    return next(s for start, s in GUESS if test.startswith(start))


class Scope:
    def __init__(self, root, build):
        self.root, self.build = root, os.path.join(root, build)
        self.tests = [t for t in sorted(glob.glob("tests/*/t-*.c", root_dir=root) + glob.glob("tests/cli/t*.sh", root_dir=root))
                      if not self.is_left_out(t)]
        self.unit = [t for t in self.tests if not t.startswith(("tests/cli/", "tests/cmd/"))]
        self.command = [t for t in self.tests if t.startswith(("tests/cli/", "tests/cmd/"))]
        self.text = {t: self.read(t) for t in self.tests}
        self.read_symbols()
        self.read_dependencies()
        self.chosen = {}

    def read(self, path):
        with open(os.path.join(self.root, path), errors="replace") as f:
            return f.read()

    def is_left_out(self, test):
        """`make test` omits these, and other fixtures or a network are not here. Tests of ranks are
        used where ROOM_TESTS names them."""
        head = "".join(self.read(test).splitlines(True)[:12])
        return bool(re.search(r"K:.*\btest-card\b", head)) or test.startswith("tests/card/")

    # ---- Objects ---------------------------------------------------------------------------------

    def read_symbols(self):
        objects = [o for o in glob.glob("**/*.o", root_dir=self.build, recursive=True) if ".race." not in o]
        self.defines, self.needs, self.refers = {}, {}, defaultdict(set)
        out = subprocess.run(["nm", "-A", "--format=posix"] + objects, cwd=self.build, stdout=subprocess.PIPE,
                             stderr=subprocess.DEVNULL).stdout.decode(errors="replace")
        for line in out.splitlines():
            name, _, rest = line.partition(": ")
            symbol, kind = rest.split(" ")[:2]
            if kind == "U":
                self.needs.setdefault(name, set()).add(symbol)
            elif kind.isupper():
                self.defines.setdefault(name, set()).add(symbol)
        users = defaultdict(set)
        for o, symbols in self.needs.items():
            for s in symbols:
                users[s].add(o)
        for o, symbols in self.defines.items():
            for s in symbols:
                self.refers[o] |= users[s] - {o}

    def read_dependencies(self):
        """Which objects are compiled from a file."""
        self.compiled = defaultdict(set)
        for path in glob.glob("**/*.d", root_dir=self.build, recursive=True):
            with open(os.path.join(self.build, path)) as f:
                rule = f.read().replace("\\\n", " ").split("\n", 1)[0]
            for word in rule.partition(":")[2].split():
                self.compiled[os.path.normpath(word)].add(path[:-2] + ".o")

    def objects_of(self, file):
        return {o for o in self.compiled.get(file, ()) if os.path.exists(os.path.join(self.build, o))}

    def distances(self, objects):
        """Test program -> (distance, -number of symbols it needs of these objects)."""
        found, seen, edge = {}, set(objects), set(objects)
        symbols = set().union(*(self.defines.get(o, set()) for o in objects)) if objects else set()
        for distance in (1, 2, 3):
            edge = set().union(*(self.refers[o] for o in edge)) - seen if edge else set()
            seen |= edge
            for o in edge:
                if o.startswith("tests/"):
                    found.setdefault(o[:-2] + ".c", (distance, -len(symbols & self.needs.get(o, set()))))
            edge = {o for o in edge if not o.startswith("tests/") and o not in ("importers/importers.o", "exporters/exporters.o")}
        return found

    def plugins_of(self, objects):
        """Names of the importers and exporters that call these objects, if they are few."""
        seen, edge = set(objects), set(objects)
        for _ in range(2):
            edge = set().union(*(self.refers[o] for o in edge)) - seen if edge else set()
            seen |= edge
        found = {m.group(1) for o in seen for m in [re.match(r"(?:im|ex)porters/(\w+)\.o$", o)] if m}
        found -= {"importers", "exporters"}
        return found if len(found) <= MOST_PLUGINS else set()

    # ---- Tests -----------------------------------------------------------------------------------

    def tests_of(self, file):
        """The tests for a fault in this file, in order of preference."""
        if file not in self.chosen:
            self.chosen[file] = self.choose(file)
        return self.chosen[file]

    def others(self, file):
        """All tests that tests_of() leaves out, the cheapest first."""
        return sorted((t for t in self.tests if t not in self.tests_of(file) and not LEFT_OUT.search(t)), key=guess)

    def choose(self, file):
        stem = os.path.splitext(os.path.basename(file))[0]
        words = [w for w in [stem] + stem.split("_") if len(w) > 3 and w not in GENERIC_WORDS] or [stem]
        near = self.distances(self.objects_of(file)) if not file.endswith((".cu", ".js", ".frag", ".vert", ".html")) else {}
        if file.startswith("tests/"):
            near = {}
        chosen = [t for t in self.unit if os.path.basename(t) == "t-%s.c" % stem]

        def add(tests, most, also=lambda t: not LEFT_OUT.search(t)):
            chosen.extend([t for t in tests if t not in chosen and also(t)][:most])

        def score(t):
            named = any(w in os.path.basename(t) for w in words)
            return (-named, near.get(t, (9, 0)), guess(t))

        add(sorted((t for t in self.unit if any(w in os.path.basename(t) for w in words)), key=score), MOST_UNIT)
        add(sorted((t for t in near if near[t][0] == 1 and t in self.text), key=score), MOST_UNIT)
        add(sorted((t for t in near if near[t][0] == 2 and t in self.text), key=score), MOST_NEAR)
        counts = {t: sum(self.text[t].count(w) for w in words) + 20 * any(w in os.path.basename(t) for w in words)
                  for t in self.command
                  if not LEFT_OUT.search(t)}
        add(sorted((t for t in counts if counts[t] > 1), key=lambda t: -counts[t]), MOST_COMMAND)
        for name in sorted(self.plugins_of(self.objects_of(file))) if "/lib/" in file else []:
            name = name.replace("_", "-")
            uses = {t: self.text[t].count(name) + 20 * (name in os.path.basename(t)) for t in counts}
            add(sorted((t for t in uses if uses[t] > 1), key=lambda t: -uses[t]), 1)
        room = max((r for r in ROOM_TESTS if file.startswith(r)), key=len, default=None)
        for start in ROOM_TESTS[room].split() if room else []:
            found = [t for t in self.tests if t.startswith("tests/" + start)]
            add(sorted(found, key=score), 6, lambda t: True)
        return chosen
