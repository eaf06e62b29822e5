#!/usr/bin/env python3
"""draw.py [--seed N] [--room PATH]... (comments | messages | help | manual) COUNT ...: prints
random samples of the prose, with file, line and context, for a reader who did not write it to
judge.

tests/tools/draw.py --seed 7 comments 40 messages 20 manual 20

Comments are those of src, importers and exporters; messages are their errors, warnings, notes and
log lines; help is all other prose in their strings. The same seed gives the same sample of the same
tree. --room limits the sample to paths with this prefix."""
import argparse
import os
import random
import sys
import textwrap

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
sys.dont_write_bytecode = True
import prose  # noqa: E402

KINDS = {"comments": prose.comments, "messages": prose.messages, "help": prose.help_texts, "manual": prose.manual}


def candidates(kind, rooms):
    start = ("man/",) if kind == "manual" else prose.PRODUCT
    found = []
    for path in prose.files():
        if path.startswith(start) and path.startswith(rooms or ("",)):
            found += [(path, *piece) for piece in KINDS[kind](path)]
    # Comments of one or two words are labels and units.
    return [f for f in found if kind != "comments" or len(f[3].split()) > 2]


def show(number, kind, path, first, last, words):
    lines = prose.read(path).split("\n")
    # Comments need the code after them as context, messages the code before.
    before, after = (2, 6) if kind == "comments" else (6, 2) if kind == "messages" else (2, 1)
    print("---- %d. %s:%d" % (number, path, first))
    if kind in ("messages", "manual"):
        print(textwrap.fill(words, 110, initial_indent="   >> ", subsequent_indent="      "))
    for n in range(max(1, first - before), min(len(lines), last + after) + 1):
        print("%s%6d  %s" % (">" if first <= n <= last else " ", n, lines[n - 1]))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--room", action="append", default=[], metavar="PATH")
    parser.add_argument("wanted", nargs="+", metavar="KIND COUNT")
    a = parser.parse_args()
    if len(a.wanted) % 2:
        parser.error("a kind and a count, in pairs")
    os.chdir(os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", ".."))
    for kind, count in zip(a.wanted[::2], a.wanted[1::2]):
        if kind not in KINDS or not count.isdigit():
            parser.error("'%s %s' is none of: %s, with a count" % (kind, count, ", ".join(KINDS)))
        all_of = candidates(kind, tuple(a.room))
        drawn = random.Random("%d %s" % (a.seed, kind)).sample(all_of, min(int(count), len(all_of)))
        print("==== %s: %d of %d, seed %d" % (kind, len(drawn), len(all_of), a.seed))
        for number, piece in enumerate(drawn, 1):
            show(number, kind, *piece)


if __name__ == "__main__":
    main()
