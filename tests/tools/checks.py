"""checks.py ASK ANSWER ERRORS PREAMBLE: runs the checks that `holds` of tests/cli/lib.sh writes to
the fifo ASK, in one process, since loading NumPy takes longer than most of them. A check is a line
with the number of its arguments, these, a line each, and the file of its code, which sees what the
file PREAMBLE defines. ANSWER receives 0 or 1, ERRORS the traceback."""
import sys
import traceback


def check(names, path, errors):
    with open(errors, "w") as err:
        try:
            exec(compile(open(path).read(), "check", "exec"), names)
            return 0
        except BaseException:
            traceback.print_exc(file=err)
            return 1


ask, answer, errors, preamble = sys.argv[1:]
defined = {}
with open(ask) as requests, open(answer, "w") as answers:
    exec(compile(open(preamble).read(), preamble, "exec"), defined)
    for n in requests:
        arguments = [next(requests).rstrip("\n") for _ in range(int(n))]
        sys.argv = ["check"] + arguments[1:]
        print(check(dict(defined), arguments[0], errors), file=answers, flush=True)
