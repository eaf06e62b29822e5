"""What a test of commands prints with SPIN_RECORD=1, beside its checks: the output of each command,
and a hash of each file that it left. Two runs of one program differ in times and temporary names;
whatever else differs between two programs is a change of behaviour."""
import re
from collections import Counter

TEMPORARY = re.compile(r"/[\w./-]*?/(?:(?:tmp\.|spin-test-|mutant)\w{6,10}/?)+")
# Of the bundle that a training began with, whose path and time count.
INPUT = re.compile(r'\\"input\\":\\"[0-9a-f]{16}')
# Times, the share of a time behind it, available memory, and the sizes of files, which contain
# times; the hashes of files show what else changes a size.
TIME = re.compile(r'("\w*(?:seconds|_s|rate|peak\w*|memory\w*|available|bytes|file)": )[\d.e+-]+|'
                  r'\b[\d.]+ (?:ms|s|min|h|\w?B available)\b(?: +[\d.]+ %)?')
PASSED = re.compile(r"^ok \d+ - ")
HASH = re.compile(r"\b[0-9a-f]{16}\b")
NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[-+]\d+)?")


def lines_of(output, tree):
    """The lines of a test's output without what differs from run to run by design."""
    text = TIME.sub(r"\1T", INPUT.sub("", output.replace(tree + "/", "")))
    return Counter(PASSED.sub("ok ", TEMPORARY.sub("TMP/", line)) for line in text.splitlines())


def shape(line):
    return NUMBER.sub("#", HASH.sub("#", line))


class Baseline:
    """Several runs without a change."""

    def __init__(self, runs):
        self.always, self.ever = runs[0], runs[0]
        for r in runs[1:]:
            self.always, self.ever = self.always & r, self.ever | r
        self.varying = {shape(line) for line in self.ever - self.always}

    def differences(self, lines):
        """Lines that are missing or new, except those that vary without a change."""
        found = ["-" + line for line in self.always - lines if shape(line) not in self.varying]
        found += ["+" + line for line in lines - self.ever if shape(line) not in self.varying]
        return found
