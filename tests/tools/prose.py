"""Extracts the prose of the sources: comments, messages, help texts and sentences of the manual.
Shared by draw.py, same_objects.py and tests/lint/language.py."""
import functools
import os
import re
import subprocess

C_LIKE = (".c", ".h", ".cpp", ".cu", ".cuh", ".def")
HASH = (".sh", ".py", ".awk", ".budget")
SLASH = (".js", ".mjs", ".ts", ".frag", ".vert", ".css")
PRODUCT = ("src/", "importers/", "exporters/")
# Names of functions whose string arguments are messages.
MESSAGE = re.compile(r"fail|misuse|not_found|malformed|unsupported|warn|log\b|note|fault|TRY_IN|refuse|complain|"
                     r"progress|usage|lacks|\bbad|wrong|reject")
TOKEN = re.compile(r"""
    (?P<comment>/\*.*?\*/|//(?:\\\n|[^\n])*)
  | (?P<string>(?:\b(?:u8|u|U|L))?R"(?P<raw>[^\s()\\]*)\(.*?\)(?P=raw)"|"(?:\\.|[^"\\\n])*")
  | (?P<char>'(?:\\.|[^'\\\n])+')
  | (?P<word>[A-Za-z_]\w*)
  | (?P<number>\.?\d(?:[eEpP][+-]|'\w|[\w.])*)
  | (?P<continued>\\\n)
  | (?P<newline>\n)
  | (?P<space>[^\S\n]+)
  | (?P<other><<=|>>=|\.\.\.|->|\+\+|--|<<|>>|[-+*/%&|^<>=!]=|&&|\|\||::|\#\#|.)
""", re.X | re.S)


def files(root="."):
    """Paths of all sources: from git, or in a tarball from the disk without build outputs."""
    git = subprocess.run(["git", "-C", root, "ls-files", "-co", "--exclude-standard"], capture_output=True, text=True)
    if git.returncode == 0 and os.path.exists(os.path.join(root, ".git")):
        return sorted(p for p in git.stdout.split("\n") if p and os.path.isfile(os.path.join(root, p)))
    found = []
    for folder, inner, names in os.walk(root):
        inner[:] = [d for d in inner if d not in ("build", "bin", ".git", "__pycache__", "demo-out")]
        found += [os.path.relpath(os.path.join(folder, n), root) for n in names]
    return sorted(found)


def read(path):
    with open(path, encoding="utf-8", errors="replace") as f:
        return f.read()


def is_hash(path):
    """Scripts and makefiles, whose comments begin with #."""
    name = os.path.basename(path)
    return path.endswith(HASH) or name == "Makefile" or "." not in name and os.path.isfile(path) and read(path)[:2] == "#!"


@functools.lru_cache(2)
def tokens(text):
    """(kind, text, line) of C, C++ or CUDA, with spaces and newlines."""
    line, found = 1, []
    for m in TOKEN.finditer(text):
        found.append((m.lastgroup if m.lastgroup != "raw" else "string", m.group(), line))
        line += m.group().count("\n")
    return found


def plain(comment):
    """The text of a comment without its markers; line breaks are kept."""
    lines = re.sub(r"^/\*+|\*/$", "", comment).split("\n")
    return "\n".join(re.sub(r"^\s*(\*|//+|#+)? ?", "", line).rstrip() for line in lines).strip()


def comments(path, text=None):
    """(first line, last line, text) of each comment; consecutive // or # lines are one comment."""
    text = read(path) if text is None else text
    found, last = [], None
    if path.endswith(C_LIKE):
        pieces = [(n, t) for kind, t, n in tokens(text) if kind == "comment"]
        alone = {n for n, t in enumerate(text.split("\n"), 1) if t.lstrip().startswith("//")}
    else:
        slash = path.endswith(SLASH)
        if not slash and not is_hash(path):
            return []
        line_of = re.compile(r"^\s*//" if slash else r"^\s*#(?!!)")
        pieces = [(n, t) for n, t in enumerate(text.split("\n"), 1) if line_of.match(t)]
        alone = {n for n, t in pieces}
        if slash:
            pieces += [(text.count("\n", 0, m.start()) + 1, m.group())
                       for m in re.finditer(r"^[ \t]*/\*.*?\*/", text, re.M | re.S)]
        elif path.endswith(".py"):
            pieces += [(text.count("\n", 0, m.start()) + 1, m.group().strip().strip('"'))
                       for m in re.finditer(r'^[ \t]*""".*?"""', text, re.M | re.S)]
        pieces.sort()
    for n, t in pieces:
        end = n + t.count("\n")
        if last and n in alone and n == last[1] + 1 and last[1] in alone:
            last[1], last[2] = end, last[2] + "\n" + plain(t)
        else:
            last = [n, end, plain(t)]
            found.append(last)
    return [tuple(f) for f in found]


def strings(text):
    """(line, text, names of the enclosing calls) of each C string; adjacent strings are joined."""
    calls, word, found, open_string = [], "", [], None
    for kind, t, n in tokens(text):
        if kind in ("space", "newline", "comment", "continued"):
            continue
        if kind == "string" and t.startswith('"'):
            if open_string is not None:
                open_string[1] += t[1:-1]
            else:
                open_string = [n, t[1:-1], " ".join(calls)]
                found.append(open_string)
            continue
        if not (kind == "word" and open_string is not None and t.startswith(("PRI", "SPIN_"))):
            open_string = None
        if t == "(":
            calls.append(word)
        elif t == ")" and calls:
            calls.pop()
        word = t if kind == "word" else ""
    return [tuple(f) for f in found]


def is_prose(words):
    return len(re.findall(r"[A-Za-z]{2,}", re.sub(r"%[-+ #0-9.*a-z]*[a-zA-Z]", " ", words))) >= 3 and " " in words.strip()


def messages(path, text=None):
    """(line, line, text) of errors, warnings, notes and log lines."""
    if not path.endswith(C_LIKE) or not path.startswith(PRODUCT):
        return []
    return [(n, n + t.count("\\n"), t) for n, t, calls in strings(read(path) if text is None else text)
            if MESSAGE.search(calls) and is_prose(t)]


def help_texts(path, text=None):
    """(line, line, text) of all other strings that are prose: options, summaries, templates."""
    if not path.endswith(C_LIKE) or not path.startswith(PRODUCT):
        return []
    return [(n, n, t) for n, t, calls in strings(read(path) if text is None else text)
            if not MESSAGE.search(calls) and is_prose(t)]


def is_manual(path):
    return re.fullmatch(r"man/[\w-]+\.[157]", path) is not None


def manual(path, text=None):
    """(first line, last line, text) of each sentence of a manual page, with macro arguments."""
    if not is_manual(path):
        return []
    found, words, first = [], "", 0
    code = False
    for n, line in enumerate((read(path) if text is None else text).split("\n"), 1):
        if line.startswith(".Bd"):
            code = True
        if line.startswith(".Ed"):
            code = False
        if code or re.match(r'\.\\"|\.(Sh|Ss|It|El|Bl|Pp|Bd|Ed|Dd|Dt|Os|Nd|Sy|D1|Dl)\b', line) or not line.strip():
            if words:
                found.append((first, n - 1, words))
            words = ""
            continue
        line = re.sub(r"^\.(\S+) ?", "", line)
        line = re.sub(r"\b(Ar|Fl|Pa|Cm|Xr|Ev|Nm|Ql|Pq|Em|Li|Ns|No|Op)\b ?", "", line).replace("\\&", "")
        line = re.sub(r" ([.,;:)])(?= |$)", r"\1", line)
        first = first if words else n
        words = (words + " " + line).strip()
        if re.search(r"[.?!:]\)?$", line):
            found.append((first, n, words))
            words = ""
    return [f for f in found if is_prose(f[2]) and not f[2].startswith("Default: ")]
