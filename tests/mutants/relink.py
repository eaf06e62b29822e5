"""A tree in which a fault costs one compilation and the links of what a test runs.

The sources are copied, the build is a farm of symbolic links to that of the repository. An object
that is compiled from a faulty source replaces its link; commands are linked with it in front of the
library, so that nothing is archived, and make does not run. Test programs are copies, which load
the tree's own shared library, so that only this library is linked again. The commands are those
that make would run."""
import os
import re
import shlex
import shutil
import subprocess

COMMANDS = "spin4d spin-import spin-retrain spin-export spin-eval".split()
NAMES = re.compile(r"\b(spin4d|spin-(?:import|retrain|export|eval))\b")


def read_commands(root, build, env):
    """Output -> command of the compiler, as words, of every object and program."""
    out = subprocess.run(["make", "-nB", "--no-print-directory", "CONFIG=release", "CUDA=0", "all", "test-bins"], cwd=root, env=env,
                         stdout=subprocess.PIPE, stderr=subprocess.DEVNULL).stdout.decode(errors="replace")
    found = {}
    for line in out.replace("\\\n", " ").splitlines():
        if re.match(r"\S*(gcc|cc|clang)[\w.-]* .* -o " + re.escape(build) + "/", " ".join(line.split()[-1000:])) or \
                (" -o " + build + "/" in line and " -c " in line):
            words = shlex.split(line.split(" && ")[0])
            if "-o" in words:
                found[words[words.index("-o") + 1]] = words
    return found


class Tree:
    def __init__(self, path, root, build, commands):
        self.path, self.root, self.build, self.commands, self.touched = path, root, build, commands, []

    def link_farm(self):
        """Links to all files of the build."""
        for part in (self.build, "build/shims"):
            there, here = os.path.join(self.root, part), os.path.join(self.path, part)
            if os.path.isdir(there):
                subprocess.run(["rm", "-rf", here], check=True)
                os.makedirs(os.path.dirname(here), exist_ok=True)
                subprocess.run(["cp", "-as", os.path.abspath(there), here], check=True)
        for output in self.commands:
            if self.is_test_program(output):
                self.take_over(output)

    def is_test_program(self, output):
        return self.test_library() in self.commands[output] and output != self.test_library() and \
            os.path.exists(os.path.join(self.root, output))

    def test_library(self):
        return self.build + "/tests/libspin-tests.so"

    def own(self, output):
        """Replaces a link to a file that is about to be written."""
        path = os.path.join(self.path, output)
        if os.path.lexists(path):
            os.remove(path)
        self.touched.append(output)

    def run(self, words):
        p = subprocess.run(words, cwd=self.path, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        return p.returncode, p.stdout.decode(errors="replace")

    def compile(self, objects):
        """Exit code and output. -O1 takes half the time of -O3; device/cpu is slow without."""
        self.objects = [self.build + "/" + o for o in sorted(objects)]
        for o in self.objects:
            self.own(o)
            level = ["-O1"] if "/device/cpu/" not in o else []
            # A drawn fault that causes a type error is found by the compiler, not by a test; GCC
            # does not report it with -w.
            code, out = self.run([w for w in self.commands[o] if w not in ("-MMD", "-MP", "-Werror")] + level +
                                 ["-Werror=int-conversion", "-Werror=incompatible-pointer-types"])
            if code != 0:
                return code, out
        return 0, ""

    def link(self, output):
        words, library = list(self.commands[output]), self.build + "/libspin.a"
        self.own(output)
        if library in words:
            at = words.index(library)
            words[at:at] = [o for o in self.objects if "/tests/" not in o and "/src/cmd/" not in o]
        return self.run(words)

    def link_for(self, test, text, program):
        """Links what a test runs, unless it was linked already."""
        wanted = [self.test_library()]
        if program and any("/tests/" in o for o in self.objects):
            wanted += [program]
        if not program or test.startswith("tests/cmd/"):
            wanted += [self.build + "/bin/" + name for name in sorted(set(NAMES.findall(text))) or COMMANDS]
        if re.search(r"libspin|import spin4d|SPIN_BUILD", text):
            wanted += [o for o in self.commands if o.startswith(self.build + "/libspin.so")]
        for output in wanted:
            if output not in self.touched and output in self.commands:
                code, out = self.link(output)
                if code != 0:
                    return code, out
        return 0, ""

    def restore(self):
        for output in self.touched:
            self.take_over(output)
        self.touched = []

    def take_over(self, output):
        """The file of the repository's build again: test programs as copies, others as links."""
        path, there = os.path.join(self.path, output), os.path.abspath(os.path.join(self.root, output))
        if os.path.lexists(path):
            os.remove(path)
        if self.is_test_program(output):
            shutil.copy(there, path)
        else:
            os.symlink(there, path)
