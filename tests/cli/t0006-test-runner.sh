#!/bin/sh
# The test runner counts tests, runs the selected ones, and treats a test that did not finish as
# failed.
. "$(dirname "$0")/lib.sh"

# Two builds compared: one with links to the same commands, then one command that says more, but
# what no test checks.
old=$work/old
mkdir -p "$old/bin"
ln -s "$(cd "$bin" && pwd)"/* "$old/bin/"
ln -s "$(cd "$bin/../lib" && pwd)" "$old/lib"
changes() { run env -u SPIN_RECORD JOBS=1 python3 tests/tools/changes.py "$old" t3025; }
changes
is "$code $(cat "$work/out")" "0 0 of 1 tests show a difference" "a build does what it does"
rm "$old/bin/spin-import"
printf '#!/bin/sh\necho "a second of 0.5 s, 7 cameras" >&2\nexec "%s/spin-import" "$@"\n' "$(cd "$bin" && pwd)" >"$old/bin/spin-import"
chmod +x "$old/bin/spin-import"
changes
is "$code" 1 "a line on stderr is a difference"
out_has '^    -.*a second of T, 7 cameras$' "which is shown, without the time"
run env SPIN_RECORD=1 sh tests/cli/t3025-programs.sh
out_has '^#~ file frames.spin/source/means/00000.npy: [0-9a-f]*$' "files that a test leaves are recorded, by member"
# A number that varies between two runs does not count, another one does.
echo 'import sys' >"$work/preamble"
holds "what varies without a change" '
sys.path.insert(0, "tests/tools")
import records
runs = [records.lines_of("ok 3 - a\n#~ out bytes 1%d, splats 7\n#~ out degree %d" % (i, 3), "/x") for i in range(3)]
base = records.Baseline(runs[:2])
assert not base.differences(runs[2])
assert base.differences(runs[2] - records.Counter(["#~ out degree 3"])) == ["-#~ out degree 3"]
assert records.Baseline(runs[:1]).differences(runs[0] + records.Counter(["ok b"])) == ["+ok b"]'

runner=$PWD/tests/run.sh
mkdir -p "$work/tree/tests/cli" "$work/tree/tests/room" "$work/tree/tests/fuzz"
mkdir -p "$work/tree/build/tests/room" "$work/tree/build/tests/fuzz" "$work/tree/fixtures/hostile/door"
cd "$work/tree" || exit 1

script() { # NAME LINES: a test of these lines
    printf '%b\n' "$2" >"tests/cli/$1.sh"
}
program() { # PATH LINES
    printf '%b\n' "$3" >"build/tests/$1"
    chmod +x "build/tests/$1"
    printf '/* K: %s */\n' "$2" >"tests/$1.c"
}
tests() { run env JOBS="$jobs" sh "$runner" build "$1"; }

script t1-good 'echo ok 1 - a; echo "ok 2 - b # SKIP no door"'
script t2-also 'echo ok 1 - a'
program room/t-program 'golden' '#!/bin/sh\necho ok 1 - a'
program fuzz/fuzz-door 'fuzz' '#!/bin/sh\n[ "$1" = fixtures/hostile/door ] && echo ok 1 - finds'
for jobs in 1 3; do
    tests ''
    is "$code $(tail -n 1 "$work/out")" "0 4 passed, 0 failed, 1 skipped" "$jobs at a time: all are counted"
    out_has '^ok   tests/cli/t1-good.sh (1 passed, 0 failed, 1 skipped) [0-9]* s$' "$jobs: a line for each"
    out_has '^skip tests/cli/t1-good.sh: b: no door$' "$jobs: what was skipped, and why"
    tests 'golden t2-also'
    is "$code $(tail -n 1 "$work/out")" "0 2 passed, 0 failed, 0 skipped" "$jobs: those with a key or a path of two words"
done
printf '#!/bin/sh\n# K: test-card\necho ok 1 - a\n' >tests/cli/t2-card.sh
printf '#!/bin/sh\n# K: ranks test-ranks\necho ok 1 - a\n' >tests/cli/t2-ranks.sh
printf '#!/bin/sh\n\n\n\n\n\n\n\n\n\n\n\n# K: test-card\necho ok 1 - a\n' >tests/cli/t2-text.sh
jobs=1
tests ''
is "$code $(tail -n 1 "$work/out")" "0 5 passed, 0 failed, 1 skipped" "long trainings are left out"
is "$(grep 'left out' "$work/out" | cut -d: -f1 | tr '\n' ' ')" "tests/cli/t2-card.sh tests/cli/t2-ranks.sh " \
    "which is said, and a test that has the word in its text is none"
for word in test-card test-ranks ranks; do
    tests $word
    is "$code $(tail -n 1 "$work/out")" "0 1 passed, 0 failed, 0 skipped" "but not by name: $word"
done
rm tests/cli/t2-card.sh tests/cli/t2-ranks.sh tests/cli/t2-text.sh
tests no-such
is "$code $(tail -n 1 "$work/out")" "1 0 passed, 0 failed, 0 skipped" "no test is a failure"

fails_as() { # NAME LINES SUMMARY REASON
    script t3-bad "$2"
    tests t3-bad
    is "$code $(tail -n 1 "$work/out")" "1 $3" "$1 is a failure"
    out_has "$4" "$1: the reason"
    tests ''
    is "$code" 1 "$1 is a failure beside tests that pass"
}
fails_as "a check" 'echo not ok 1 - wrong; exit 1' "0 passed, 1 failed, 0 skipped" '^     not ok 1 - wrong$'
fails_as "an exit code" 'echo ok 1 - a; exit 3' "1 passed, 1 failed, 0 skipped" ' s exit code 3$'
fails_as "an unknown check" 'echo ok 1 - a; no_such_check; true' "1 passed, 1 failed, 0 skipped" ' runs a command that does not exist$'
fails_as "silence" 'true' "0 passed, 1 failed, 0 skipped" ' printed no test line$'
# The parent of this process is timeout, whose parent is the runner.
# shellcheck disable=SC2016
fails_as "a runner that is killed" 'kill -9 $(cut -d" " -f4 /proc/$PPID/stat)' "0 passed, 0 failed, 0 skipped" \
    '1 of 1 tests did not come to an end'
done_testing
