"""Generates faults from C and CUDA sources: small changes that a test should detect.

The generator reads tokens and matches brackets; it does not parse C. It relies on the layout of
clang-format: a binary operator has white space on both sides, a unary one has none behind it. A
fault that does not compile is the caller's to discard.

`python3 tests/mutants/faults.py FILE...` lists the faults of files."""
import bisect
import re
import sys
from collections import namedtuple

Token = namedtuple("Token", "kind text start end")
Fault = namedtuple("Fault", "file start end new kind")

TOKEN = re.compile(
    r"(?P<comment>/\*.*?\*/|//[^\n]*)"
    r"|(?P<macro>(?m:^)[ \t]*#(?:\\\n|/\*.*?\*/|[^\n])*)"
    r"|(?P<string>(?:u8|[uUL])?\"(?:\\.|[^\"\\\n])*\")"
    r"|(?P<char>'(?:\\.|[^'\\\n])+')"
    r"|(?P<number>\.?\d(?:[eEpP][+-]|[\w.'])*)"
    r"|(?P<word>[A-Za-z_]\w*)"
    r"|(?P<op>\.\.\.|<<=|>>=|->|\+\+|--|<<|>>|<=|>=|==|!=|&&|\|\||[-+*/%&|^]=|[-+*/%&|^~!<>=?:;,.(){}\[\]])",
    re.S)

PRECEDENCE = {op: rank for rank, ops in enumerate(
    ("||", "&&", "|", "^", "&", "== !=", "< > <= >=", "<< >>", "+ -", "* / %")) for op in ops.split()}
ASSIGN = set("= += -= *= /= %= &= |= ^= <<= >>=".split())
OTHER = {  # the operator in its place
    "+": "-", "-": "+", "*": "/", "/": "*", "%": "/", "&&": "||", "||": "&&", "&": "|", "|": "&", "^": "|",
    "<<": ">>", ">>": "<<", "+=": "-=", "-=": "+=", "*=": "/=", "/=": "*=", "|=": "&=", "&=": "|="}
COMPARE = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "=="}
TYPES = set("const static struct enum union unsigned signed int char short long float double void bool volatile "
            "extern inline FILE __shared__ register".split())
CONTROL = set("if for while switch".split())
JUMPS = set("return break continue goto".split())

# ---- Faults that are certainly equivalent, or that tests cannot detect ---------------------------

# Calls with nothing in their arguments to change. Tests compare messages only where a reader
# depends on them, and an argument of a message changes nothing else.
SILENT_CALLS = re.compile(
    r"^(spin_(log|warn|note|fail\w*|malformed|unsupported|misuse|not_found|args_misuse|video_fail|progress\w*)"
    r"|fail\w*|bad|complain\w*|assert|static_assert|_Static_assert|perror|say|SPIN_PRINTF|__attribute__|sizeof|alignof"
    # The size of an allocation: too small is undefined behaviour, which the sanitisers of .ci/run
    # detect and the release build of these tests does not; too large has no effect.
    r"|\w*alloc|\w*reserve|spin_grow|spin_array_grow|spin_scratch_need|spin_arena_take|realloc|SPIN_LEAVES"
    # Times of stages, in the log.
    r"|SPIN_CPU_CLOCK|cuda_clocked|clocked"
    # Hints to the system, and locks, whose absence only ThreadSanitizer detects (CONFIG=tsan).
    r"|\w*prefetch\w*|\w*advise|\w*fadvise|pthread_\w+|spin_lock\w*|spin_unlock\w*|fflush|setvbuf|\w+_forget)$")
# Calls whose removal leaks memory or handles, which LeakSanitizer detects and these tests do not.
RELEASING_CALLS = re.compile(
    r"^(\w*_)?(free|freed|close|closed|destroy|release|drop|discard|unmap|munmap|end)(_\w+)?$|^fclose$"
    r"|^SPIN_ALIGNED_FREE$")
# Statements without an effect that a test could see: structures are cleared before their fields are
# set, and where one is not set, memory is mostly zero; `make valgrind` detects the rest.
SILENT_STATEMENTS = re.compile(r"^\(void\)|^memset\([\w>.-]+, 0, sizeof")
# Lines of which no fault is made, and why.
SILENT_LINES = [re.compile(p) for p in (
    r"(spin_no_memory|SPIN_E_MEMORY|SPIN_E_NOMEM|\bENOMEM\b)",  # allocation fails in few tests (tests/*/t-no_memory.c)
    r"capacity\b|\bn_threads\b",  # of a buffer, and of the pool: any gives the same result
    r"\b(grain|GRAIN|chunk_rows|PER_TASK|AHEAD)\b",  # rows per task of the thread pool
    r"\b(spin_log_level|isatty|getenv|EINTR|EAGAIN)\b",  # the terminal and the environment
    r"\bstatic bool (said|warned|told)\b|\b(said|warned|told) = true\b",  # a message is printed once
    r"SPIN_ARG\(\"[\w-]+\", 0,",  # no short name
    r"\b[A-Z_]*ABI[A-Z_]*\b|\bSPIN_VERSION\b",
    r"\bclock->",  # times of stages, in the log
    r"&one == 1",  # the byte order, of which there is one here
    r"\batexit\b",  # memory is released at the exit
    r"\b(EAGER|nap)\b",  # pauses between two polls
)]
# A column that was not asked for may be filled: this takes time only. Without memory for it the
# program crashes.
FILLS_COLUMN = re.compile(r"^columns & SPIN_COL_\w+$")
# Files with code for systems that these tests do not run on, or tables of text.
SILENT_FILES = re.compile(
    r"^src/(base/windows|web|packaging)/|^src/cmd/help|/gpu\.cu$|^src/spin\w*\.h$|_shim\.h$|^man/")
# Both sides may be exchanged.
COMMUTATIVE = re.compile(
    r"^(\w*_)?(max|min|dot|hypot|equal|same|gcd)[a-z]?$|^f(max|min)f?$|^(str|mem)n?(case)?cmp$|^hypotf?$")
PAIRS = [("fmax", "fmin"), ("fmaxf", "fminf"), ("spin_maxf", "spin_minf"), ("max", "min"), ("sin", "cos"),
         ("sinf", "cosf"), ("floor", "ceil"), ("floorf", "ceilf"), ("true", "false"), ("spin_max", "spin_min"), ("INT_MAX", "INT_MIN"),
         ("strchr", "strrchr"), ("SEEK_SET", "SEEK_CUR"),
         ("fx", "fy"), ("cx", "cy"), ("width", "height"), ("before", "after"), ("first", "last"), ("mins", "maxs"),
         ("rows", "columns"), ("source", "refined"), ("centre", "scale")]
# The value 0 under another name: the first constants of the sources' enumerations, too.
ZEROS = {"0", "false", "NULL", "0.0", "0.0f"}
COUNTERPART = {a: b for pair in PAIRS for a, b in (pair, pair[::-1])}
# Calls that may be replaced by their argument.
WRAPPERS = re.compile(
    r"^(fabsf?|sqrtf?|floorf?|ceilf?|l?l?roundf?|expf?|logf?|log2f?|exp2f?|is(nan|finite)"
    r"|spin_(sigmoid|logit|scale|swap|clamp)\w*)$")


def add_zeros(text):
    """Adds the first constants of the public enumerations in a source."""
    text = re.sub(r"/\*.*?\*/|//[^\n]*", "", text, flags=re.S)
    ZEROS.update(re.findall(r"\benum\s*\w*\s*\{\s*(SPIN_\w+)\s*(?:=\s*0\s*)?[,}]", text))


# ---- Tokens --------------------------------------------------------------------------------------


def read_tokens(text):
    """Tokens without comments and preprocessor lines; values of `#define NAME number` are kept."""
    tokens, defines = [], []
    for m in TOKEN.finditer(text):
        kind = m.lastgroup
        if kind == "macro":
            value = re.match(r"[ \t]*#define \w+ (\(?-?)([\d.][\w.]*)\)?\s*$", m.group())
            if value:
                at = m.start() + value.start(2)
                defines.append(Token("number", value.group(2), at, at + len(value.group(2))))
        elif kind != "comment":
            tokens.append(Token(kind, m.group(), m.start(), m.end()))
    return tokens, defines


def match_brackets(tokens):
    """Index of the partner of every bracket, or nothing for one without."""
    partner, open_ = {}, []
    for i, t in enumerate(tokens):
        if t.kind != "op":
            continue
        if t.text in "([{":
            open_.append(i)
        elif t.text in ")]}" and open_:
            j = open_.pop()
            partner[i], partner[j] = j, i
    return partner


class Source:
    """One file, and all faults that can be made in it."""

    def __init__(self, file, text):
        self.file, self.text = file, text
        self.tokens, self.defines = read_tokens(text)
        self.partner = match_brackets(self.tokens)
        self.faults, self.silent = [], self.find_silent()

    # ---- Inspection of tokens --------------------------------------------------------------------

    def is_(self, i, *texts):
        return 0 <= i < len(self.tokens) and self.tokens[i].kind != "string" and self.tokens[i].text in texts

    def kind(self, i):
        return self.tokens[i].kind if 0 <= i < len(self.tokens) else ""

    def of(self, first, last):
        """The text of tokens first to last, inclusive."""
        return self.text[self.tokens[first].start:self.tokens[last].end]

    def is_binary(self, i):
        t = self.tokens[i]
        return t.kind == "op" and t.text in PRECEDENCE and self.text[t.start - 1:t.start].isspace() and \
            self.text[t.end:t.end + 1].isspace()

    def right_operand(self, i, rank):
        """Index of the last token of the operand that begins at i."""
        j = i
        while j < len(self.tokens):
            t = self.tokens[j]
            if t.kind == "op":
                if t.text in "([{":
                    j = self.partner.get(j, j)
                elif t.text in ")]},;?:" or t.text in ASSIGN or (self.is_binary(j) and PRECEDENCE[t.text] <= rank):
                    break
            j += 1
        return j - 1

    def left_operand(self, i, rank):
        """Index of the first token of the operand that ends at i."""
        j = i
        while j >= 0:
            t = self.tokens[j]
            if t.kind == "op":
                if t.text in ")]}":
                    j = self.partner.get(j, j)
                elif t.text in "([{,;?:" or t.text in ASSIGN or (self.is_binary(j) and PRECEDENCE[t.text] <= rank):
                    break
            elif t.text in ("return", "case", "else"):
                break
            j -= 1
        return j + 1

    def arguments(self, i):
        """(first, last) of each argument inside the bracket at i."""
        end, first, found = self.partner.get(i), i + 1, []
        if end is None or end == i + 1:
            return []
        j = first
        while j <= end:
            if j == end or self.is_(j, ","):
                if j > first:
                    found.append((first, j - 1))
                first = j + 1
            elif self.is_(j, "(", "[", "{"):
                j = self.partner.get(j, j)
            j += 1
        return found

    def find_silent(self):
        """Indices of tokens inside of calls whose arguments have no effect."""
        silent = set()
        for i, t in enumerate(self.tokens):
            if t.kind == "word" and SILENT_CALLS.match(t.text):
                if self.is_(i + 1, "("):
                    silent.update(range(i, self.partner.get(i + 1, i) + 1))
                elif t.text == "sizeof":
                    silent.update(range(i, self.right_operand(i + 1, 99) + 1))
        return silent

    # ---- Faults ----------------------------------------------------------------------------------

    def add(self, kind, first, last, new):
        if any(k in self.silent for k in range(first, last + 1)) and kind not in ("delete", "branch"):
            return
        self.add_at(kind, self.tokens[first].start, self.tokens[last].end, new)

    def add_at(self, kind, start, end, new):
        line = self.text[self.text.rfind("\n", 0, start) + 1:(self.text + "\n").find("\n", end)]
        if not any(p.search(line) for p in SILENT_LINES) and self.text[start:end] != new:
            self.faults.append(Fault(self.file, start, end, new, kind))

    def generate(self):
        if SILENT_FILES.search(self.file):
            return []
        for t in self.defines:
            self.change_number(t)
        if self.file.endswith(".def"):
            self.change_rows()
            return self.faults
        i = 0
        while i < len(self.tokens):
            if self.is_(i, "{") and self.is_(i - 1, ")") and i in self.partner:
                self.read_function(i)
                i = self.partner[i]
            elif self.kind(i) == "number" and not self.is_(i - 1, "["):
                self.change_constant(i)
            i += 1
        return self.faults

    def change_rows(self):
        """Rows of an X macro: numbers, and the named defaults."""
        for i, t in enumerate(self.tokens):
            if t.kind == "number":
                self.change_constant(i)
            elif t.kind == "word" and re.match(r"^(ALL|PAPER|SHORT|NETWORK|THREE|EACH)(_NAMED)?$", t.text) and \
                    self.is_(i + 1, "("):
                args = self.arguments(i + 1)
                for a, b in zip(args, args[1:]):
                    if self.of(*a) != self.of(*b):
                        self.add("swap", a[0], b[1], self.of(*b) + ", " + self.of(*a))
                if t.text.endswith("_NAMED"):
                    self.change_named(i, args)

    def change_named(self, i, args):
        names = [x.text for x in self.tokens[max(0, i - 12):i] if x.kind == "string" and "|" in x.text]
        for first, last in args if names else []:
            for name in names[-1].strip('"').split("|"):
                if name != self.of(first, last) and re.match(r"^\w+$", name):
                    self.add("constant", first, last, name)

    # ---- Functions -------------------------------------------------------------------------------

    def return_type(self, body):
        """bool, status, void or value, of the function whose body begins at this brace."""
        i = self.partner.get(body - 1, body) - 1
        before = []
        while i > 0 and not self.is_(i - 1, ";", "}") and len(before) < 12:
            i -= 1
            before.append(self.tokens[i].text)
        for name in ("bool", "spin_status"):
            if name in before and "*" not in before:
                return name
        return "void" if "void" in before and "*" not in before else "value"

    def read_function(self, body):
        end, returns = self.partner[body], self.return_type(body)
        self.statements(body + 1, end, returns)
        for i in range(body + 1, end):
            t = self.tokens[i]
            if i in self.silent:
                continue
            if t.kind == "number":
                self.change_constant(i)
            elif t.kind == "word":
                self.change_word(i)
            elif t.kind == "op":
                self.change_operator(i)

    def statements(self, i, end, returns):
        while i < end:
            i = self.statement(i, end, returns) + 1

    def statement(self, i, end, returns):
        """Makes the faults of the statement at i; returns the index of its last token."""
        t = self.tokens[i]
        if self.is_(i, "{"):
            last = self.partner.get(i, end)
            self.statements(i + 1, last, returns)
            return last
        if self.is_(i, ";"):
            return i
        if t.text in CONTROL:
            return self.control(i, end, returns)
        if t.text == "else" or t.text == "do":
            return self.statement(i + 1, end, returns)
        if t.text in ("case", "default") or (t.kind == "word" and self.is_(i + 1, ":")):
            while i < end and not self.is_(i, ":"):
                i += 1
            return i
        last = self.semicolon(i, end)
        if last < end:
            self.simple_statement(i, last, returns)
        return last

    def semicolon(self, i, end):
        while i < end and not self.is_(i, ";"):
            if self.is_(i, "(", "[", "{"):
                i = self.partner.get(i, i)
            i += 1
        return i

    def control(self, i, end, returns):
        word, open_ = self.tokens[i].text, i + 1
        if not self.is_(open_, "("):
            return i
        close = self.partner.get(open_, end)
        if word == "if" and self.is_failed_allocation(i, open_, close):
            end_of = self.semicolon(close + 1, end)
            return self.partner.get(close + 1, end_of) if self.is_(close + 1, "{") else end_of
        if word == "if":
            self.force_condition(open_, close)
        elif word == "for":
            self.bound_loop(open_, close)
        if self.is_(close + 1, ";"):
            return close + 1
        return self.statement(close + 1, end, returns)

    def is_failed_allocation(self, i, open_, close):
        """Whether `if (!p)` follows the allocation of p, which fails in few tests."""
        first = i - 1
        while first > 0 and not self.is_(first - 1, ";", "{", "}"):
            first -= 1
        return self.is_(open_ + 1, "!") and self.is_(i - 1, ";") and re.match(
            r"%s = \w*(alloc|need|take)\(" % re.escape(self.of(open_ + 2, close - 1)), self.of(first, i - 1)) is not None

    def force_condition(self, open_, close):
        body = close + 2 if self.is_(close + 1, "{") else close + 1
        only_says = self.kind(body) == "word" and body in self.silent and self.tokens[body].text != "return"
        if only_says or any(k in self.silent for k in range(open_, close)):
            return
        self.add("branch", open_ + 1, close - 1, "0")
        if not FILLS_COLUMN.match(self.of(open_ + 1, close - 1)):
            self.add("branch", open_ + 1, close - 1, "1")

    def bound_loop(self, open_, close):
        first = self.semicolon(open_ + 1, close)
        second = self.semicolon(first + 1, close)
        for i in range(first + 1, second):
            if self.is_(i, "<") and self.is_binary(i):
                last = self.right_operand(i + 1, PRECEDENCE["<"])
                self.add("bound", i + 1, last, self.of(i + 1, last) + " - 1")

    def simple_statement(self, i, last, returns):
        word = self.tokens[i].text
        if word == "return":
            self.change_return(i, last, returns)
        elif word in ("break", "continue"):
            self.add("delete", i, last, ";")
        elif word == "goto" or SILENT_STATEMENTS.match(self.of(i, last)):
            return
        elif not self.is_declaration(i):
            call = self.kind(i) == "word" and self.is_(i + 1, "(")
            if not (call and (SILENT_CALLS.match(word) or RELEASING_CALLS.match(word))):
                self.add("delete", i, last, ";")
            if not (call and RELEASING_CALLS.match(word)):
                self.exchange(i, last)

    def exchange(self, i, last):
        """Two statements in the other order, if the second one names what the first one assigns
        to."""
        j = last + 1
        if self.kind(j) != "word" or self.tokens[j].text in CONTROL | JUMPS | {"else", "do", "case", "default"} or \
                self.is_declaration(j) or not self.is_(i - 1, ";", "{", "}"):
            return
        end = self.semicolon(j, min(j + 80, len(self.tokens) - 1))
        written = [self.tokens[k + 1].text for k in range(i, last) if self.is_(k, "&") and not self.is_binary(k)]
        written += [self.of(i, k - 1) for k in range(i + 1, last) if self.tokens[k].text in ASSIGN]
        second = self.of(j, end)
        if any(re.search(r"(?<![\w.>])%s(?!\w)" % re.escape(w), second) for w in written) and self.is_(end, ";"):
            between = self.text[self.tokens[last].end:self.tokens[j].start]
            self.add("order", i, end, second + between + self.of(i, last))

    def is_declaration(self, i):
        if self.tokens[i].text in TYPES or (self.kind(i) == "word" and self.kind(i + 1) == "word"):
            return True
        if self.kind(i) == "word" and self.tokens[i].text.endswith("_t") and not self.is_(i + 1, "("):
            return True
        star = i + 1
        return self.kind(i) == "word" and self.is_(star, "*") and not self.is_binary(star)

    def change_return(self, i, last, returns):
        if last == i + 1:
            self.add("delete", i, last, ";")
            return
        value = self.of(i + 1, last - 1)
        if returns == "bool" and value not in ("true", "false"):
            self.add("return", i + 1, last - 1, "true")
            self.add("return", i + 1, last - 1, "false")
        elif returns == "spin_status" and value != "SPIN_OK" and i + 1 not in self.silent:
            self.add("return", i + 1, last - 1, "SPIN_OK")
        elif returns == "value" and value not in ZEROS and value != "1":
            self.add("return", i + 1, last - 1, "0")

    # ---- Within an expression --------------------------------------------------------------------

    def change_constant(self, i):
        t = self.tokens[i]
        # {0} clears a variable; [300] and [N + 1] are capacities.
        if (self.is_(i - 1, "{") and self.is_(i + 1, "}")) or self.in_capacity(i):
            return
        if t.text in ("1.0f", "1.0") and self.is_(i + 1, "}"):
            return
        # memset(p, 0, n) clears a structure, most of whose fields are set anyway.
        if i not in self.silent and not (self.is_(i - 1, ",") and self.of(max(0, i - 6), i).find("memset") >= 0):
            self.change_number(t)

    def in_capacity(self, i):
        """Whether i is inside the brackets of a declaration."""
        j = i - 1
        while j >= 0 and not self.is_(j, "[", "(", "{", ";", ","):
            j = self.partner.get(j, j) - 1 if self.is_(j, ")", "]", "}") else j - 1
        return self.is_(j, "[") and self.in_declarator(j + 1)

    def in_declarator(self, i):
        """Whether the [ before i belongs to a declaration, as in `char text[300]`."""
        j = i - 2
        while j >= 0 and self.is_(j, "]"):
            j = self.partner.get(j, j) - 1
        before = self.tokens[j - 1].text if j > 0 else ""
        return self.kind(j) == "word" and (before in TYPES or self.kind(j - 1) == "word" and before not in JUMPS or
                                           before == "," and self.is_(i + 1, "]") and self.is_(i + 2, ";", ","))

    def change_number(self, t):
        text = t.text
        if re.match(r"^\d+$", text):
            n = int(text)
            news = [str(n + 1)] + ([str(n - 1)] if n > 0 else [])
        elif re.match(r"^0[xX]|^0[bB]|.*[uUlL]$", text):
            digits = re.match(r"^(0[xX][0-9a-fA-F]+|\d+)([uUlL]*)$", text)
            if not digits:
                return
            n = int(digits.group(1), 0) if digits.group(1) != "0" else 0
            news = [(hex(n ^ 1) if text[:2] in ("0x", "0X") else str(n + 1)) + digits.group(2)]
        else:
            m = re.match(r"^([\d.]+(?:[eE][-+]?\d+)?)(f?)$", text)
            if not m:
                return
            x = float(m.group(1))
            news = [("%.9g" % (x * 2 if x else 1.0)), ("%.9g" % (x / 2 if x else 0.5))]
            news = [(v if re.search(r"[.e]", v) else v + ".0") + m.group(2) for v in news]
        for new in news:
            self.add_at("constant", t.start, t.end, new)

    def change_word(self, i):
        t = self.tokens[i]
        if t.text in COUNTERPART and self.kind(i - 1) != "word":
            self.add("name", i, i, COUNTERPART[t.text])
        if not self.is_(i + 1, "(") or t.text in CONTROL or t.text in TYPES or t.text in ("return", "SPIN_TRY"):
            return
        args = self.arguments(i + 1)
        if len(args) == 1 and WRAPPERS.match(t.text):
            self.add("call", i, self.partner[i + 1], "(" + self.of(*args[0]) + ")")
        if COMMUTATIVE.match(t.text):
            return
        for a, b in zip(args, args[1:]):
            x, y = self.of(*a), self.of(*b)
            if x != y and '"' not in x + y and self.looks_alike(a, b):
                self.add("swap", a[0], b[1], y + self.text[self.tokens[a[1]].end:self.tokens[b[0]].start] + x)

    def looks_alike(self, a, b):
        """Whether two arguments may have one type; a constant and a variable rarely have."""
        def shape(first, last):
            if self.is_(first, "&"):
                return "address"
            if first == last and (self.kind(first) == "number" or self.tokens[first].text.isupper()):
                return "constant"
            return "text" if self.kind(first) == "string" else "value"
        return shape(*a) == shape(*b) and a[1] - a[0] < 16 and b[1] - b[0] < 16

    def change_operator(self, i):
        t = self.tokens[i]
        if self.is_binary(i):
            self.change_binary(i)
        elif t.text in ("+=", "-=", "*=", "/=", "|=", "&="):
            self.add("operator", i, i, OTHER[t.text])
            self.add("operator", i, i, "=")
        elif t.text == "-" and not self.is_(i - 1, "[") and self.kind(i + 1) != "":
            self.add("sign", i, i + 1, self.tokens[i + 1].text)
        elif t.text == "!":
            self.add("condition", i, i + 1, self.tokens[i + 1].text)
        elif t.text == "?":
            self.force_ternary(i)
        elif t.text == "[":
            self.index_zero(i)
        elif t.text == "=" and not self.is_declared_here(i):
            self.zero_assigned(i)
        elif t.text == "." and self.is_(i - 1, "{", ",") and self.is_(i + 2, "="):
            self.drop_field(i)
        elif t.text in ("++", "--") and not self.is_(i + 1, ")"):
            self.add("operator", i, i, "--" if t.text == "++" else "++")

    def change_binary(self, i):
        op, rank = self.tokens[i].text, PRECEDENCE[self.tokens[i].text]
        if op in COMPARE:
            if not self.is_extremum(i):
                self.add("compare", i, i, COMPARE[op])
            return
        self.add("operator", i, i, OTHER[op])
        right, left = self.right_operand(i + 1, rank), self.left_operand(i - 1, rank)
        if right > i and op != "%":
            self.add("term", i - 1, right, self.tokens[i - 1].text)
        if op in ("+", "*", "&&", "||", "&", "|", "-") and left < i and not (
                self.is_binary(left - 1) and PRECEDENCE[self.tokens[left - 1].text] == rank):
            self.add("term", left, i + 1, ("-" if op == "-" else "") + self.tokens[i + 1].text)

    def is_extremum(self, i):
        """`a > b ? a : b`, and `if (a > b) b = a`: with equal values the result is the same."""
        rank = PRECEDENCE[self.tokens[i].text]
        left, right = self.left_operand(i - 1, rank), self.right_operand(i + 1, rank)
        x, y, after = self.of(left, i - 1), self.of(i + 1, right), right + 1
        if self.tokens[i].text in ("==", "!="):
            return False
        if self.is_(after, "?"):
            a_end = self.right_operand(after + 1, -1)
            values = {self.of(after + 1, a_end), self.of(a_end + 2, self.right_operand(a_end + 2, -1))} \
                if self.is_(a_end + 1, ":") and a_end + 2 < len(self.tokens) else set()
            return values == {x, y}
        if self.is_(after, ")"):
            end = self.semicolon(after + 1, min(after + 40, len(self.tokens) - 1))
            return end > after + 1 and self.of(after + 1, end - 1) in (x + " = " + y, y + " = " + x)
        return False

    def force_ternary(self, i):
        colon, depth = i + 1, 0
        while colon < len(self.tokens) and (depth or not self.is_(colon, ":")):
            if self.is_(colon, "(", "[", "{"):
                colon = self.partner.get(colon, colon)
            elif self.is_(colon, ")", "]", "}", ";"):
                return
            depth += self.is_(colon, "?") - (self.is_(colon, ":") and depth > 0)
            colon += 1
        first, end = self.left_operand(i - 1, -1), colon + 1
        while end < len(self.tokens) and not self.is_(end, ")", "]", "}", ";", ",", ":"):
            end = self.partner.get(end, end) + 1 if self.is_(end, "(", "[", "{") else end + 1
        if any(self.kind(k) == "string" for k in range(i, end)):
            return  # chooses the words of a message
        self.add("branch", first, end - 1, self.of(i + 1, colon - 1))
        self.add("branch", first, end - 1, self.of(colon + 1, end - 1))

    def index_zero(self, i):
        close = self.partner.get(i)
        if close is None or close < i + 2 or self.kind(i + 1) == "number" or self.in_declarator(i + 1):
            return
        self.add("index", i + 1, close - 1, "0")

    def is_declared_here(self, i):
        j = i
        while j > 0 and not self.is_(j - 1, ";", "{", "}", "(", ")"):
            j -= 1
        return self.is_declaration(j)

    def zero_assigned(self, i):
        end = self.right_operand(i + 1, -1)
        if (end > i + 1 or self.kind(end) == "word") and self.of(i + 1, end) not in ZEROS:
            self.add("value", i + 1, end, "0")

    def drop_field(self, i):
        if self.kind(i + 3) == "string":
            return
        end = self.right_operand(i + 3, -1)
        last = end + 1 if self.is_(end + 1, ",") else end
        if self.is_(last + 1, ".", "}") and not (self.is_(i - 1, "{") and last == end):
            self.add("field", i, last, "")


def faults_of(file, text):
    """All faults of one file, ordered by place."""
    found = {(f.start, f.end, f.new): f for f in Source(file, text).generate()}
    return [found[key] for key in sorted(found)]


def lines_of(faults, text):
    """The line number of each fault."""
    ends = [m.start() for m in re.finditer("\n", text)]
    return [bisect.bisect_left(ends, f.start) + 1 for f in faults]


def apply(fault, text):
    return text[:fault.start] + fault.new + text[fault.end:]


def line_of(fault, text):
    return text.count("\n", 0, fault.start) + 1


def show(fault, text):
    """The fault as the changed lines of a diff, without context."""
    first = text.rfind("\n", 0, fault.start) + 1
    last = (text + "\n").find("\n", fault.end)
    old, new = text[first:last], text[first:fault.start] + fault.new + text[fault.end:last]
    join = lambda lines: " ".join(lines.split())
    return "%s:%d: %s\n-    %s\n+    %s" % (fault.file, line_of(fault, text), fault.kind, join(old), join(new))


def main():
    for path in sys.argv[1:]:
        with open(path) as f:
            text = f.read()
        for fault in faults_of(path, text):
            print(show(fault, text))


if __name__ == "__main__":
    main()
