"""language.py [SINCE]: the checks of language.sh. SINCE: check the subjects of the commits after
this one (default: the commit that added this file)."""
import os
import re
import subprocess
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(HERE, "..", "tools"))
sys.dont_write_bytecode = True
import prose  # noqa: E402

COLUMNS, SUBJECT = 100, 72
# Files that quote the words, or are not ours.
NEVER = ("tests/lint/language.", "fixtures/", "src/packaging/copyright", "LICENSE", "tests/tools/draw.py")
faults = []


def read_list(name):
    lines = prose.read(os.path.join("tests/lint", name)).split("\n")
    return [line.strip() for line in lines if line.strip() and not line.startswith("#")]


def read_words():
    words = []
    for line in read_list("language.list"):
        word, arrow, instead = line.partition(" -> ")
        if not arrow:
            sys.exit("language: tests/lint/language.list: no ' -> ' in '%s'" % line)
        # A phrase may be broken across lines; look-behinds need a fixed width.
        word = re.sub(r"\(\?<!.*?\)| ", lambda m: r"\s+" if m.group() == " " else m.group().replace(" ", r"\s"), word)
        words.append((re.compile(r"(?<![\w/.=`'-])(?:%s)(?![\w/=`'-]|\.\w)" % word, re.I), instead))
    return words


def texts(path):
    """(first line, text) of everything in a file that people read."""
    if path.endswith((".md", ".html")) or prose.is_manual(path) or path in ("README", "CHANGELOG.md"):
        return [(1, prose.read(path))]
    found = [(n, t) for n, _, t in prose.comments(path)]
    return found + [(n, t) for pieces in (prose.messages, prose.help_texts) for n, _, t in pieces(path)]


def check_words(path, words):
    for first, text in texts(path):
        if path == "docs/architecture.md":  # the glossary quotes them
            text = re.sub(r"^## Words$.*?(?=^## )", lambda m: "\n" * m.group().count("\n"), text, flags=re.M | re.S)
        # Code in documents and arguments of mdoc macros are names: mask them.
        if path.endswith(".md"):
            text = re.sub(r"```.*?```|`[^`\n]*`|^    .*$|\]\([^)]*\)", lambda m: re.sub(r"[^\n]", "x", m.group()), text, flags=re.M | re.S)
        # Keys of report templates (io/template.h) are those of --json.
        text = re.sub(r"\{\{[#^*/]?[\w.]+", lambda m: "x" * len(m.group()), text)
        if prose.is_manual(path):
            text = re.sub(r"^\.(Fl|It|Ar|Pa|Xr|Sx|Nm|Ev|D1|Dl|Va|Cm|Li|\\).*$", "x", text, flags=re.M)
        for word, instead in words:
            for m in word.finditer(text):
                faults.append("%s:%d: '%s': write: %s" %
                         (path, first + text.count("\n", 0, m.start()), " ".join(m.group().split()), instead))


def check_columns(path):
    if not path.endswith(prose.C_LIKE + prose.SLASH) and not prose.is_hash(path):
        return
    lines = prose.read(path).split("\n")
    for first, last, _ in prose.comments(path):
        for n in range(first, last + 1):
            if len(lines[n - 1]) > COLUMNS:
                faults.append("%s:%d: a comment reaches column %d, past %d" % (path, n, len(lines[n - 1]), COLUMNS))


def check_subjects(since):
    """The number of subjects checked, or None without git history."""
    def git(*args):
        return subprocess.run(["git", *args], capture_output=True, text=True)
    if not os.path.exists(".git") or git("rev-parse", "-q", "--verify", "HEAD").returncode != 0:
        return None
    if not since:
        since = git("log", "--diff-filter=A", "--format=%H", "--", "tests/lint/language.py").stdout.split()[-1:]
        since = since[0] if since else "HEAD"
    log = git("log", "--no-merges", "--format=%h %s", since + "..HEAD")
    if log.returncode != 0:
        return None
    subjects = log.stdout.splitlines()
    for line in subjects:
        commit, _, subject = line.partition(" ")
        if len(subject) > SUBJECT:
            faults.append("commit %s: a subject of %d letters, at most %d: %s" % (commit, len(subject), SUBJECT, subject))
    return len(subjects)


def main():
    words = read_words()
    paths = [p for p in prose.files() if not p.startswith(NEVER) and os.path.getsize(p) < 1 << 20 and
             (p.endswith(prose.C_LIKE + prose.SLASH + (".md", ".html", ".1", ".5", ".7")) or prose.is_hash(p))]
    for path in paths:
        check_columns(path)
        check_words(path, words)
    subjects = check_subjects(sys.argv[1] if len(sys.argv) > 1 else None)
    for fault in faults:
        print("language: " + fault)
    if faults:
        sys.exit(1)
    print("language: %d files, %s" %
          (len(paths), "no history, subjects not compared" if subjects is None else "%d subjects of commits" % subjects))


if __name__ == "__main__":
    main()
