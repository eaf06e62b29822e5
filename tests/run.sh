#!/bin/sh
# run.sh BUILD_DIR [WORDS]: runs the built tests from the root of the repository, JOBS at a time.
# Prints a line with the seconds of each test as it ends, a summary, and the skipped tests with the
# reason.
#
# Runs BUILD_DIR/tests/*/t-* (programs), tests/cli/t*.sh (scripts), and BUILD_DIR/tests/fuzz/fuzz-*
# on the saved inputs in fixtures/hostile/<name>/. WORDS select the tests whose source path contains
# one of them, or whose source has one in its line of keys ("K: golden threads"). Without WORDS all
# tests run except those with the keys test-card and test-ranks, which are long trainings and run by
# these names. WORDS may be quick: all programs but those of tests/cmd and tests/emu. Tests with the
# key long start first. A crash, a non-zero exit, more than ten minutes, and a test that does not
# end its output properly are failures.
#
# SPIN_RUN runs the programs of another machine (qemu-aarch64).
# SPIN_FIXTURES: the folder of the large fixtures. SPIN_BIN and SPIN_BUILD are set for the scripts.
B=${1:?usage: run.sh BUILD_DIR [WORDS]}
LIMIT=600

# Runs one test, prints its line and the failures. Skipped parts are appended to the file
# SPIN_SKIPS.
run_one() { # NAME COMMAND...
    name=$1
    shift
    out=$(mktemp) || exit 255
    trap 'rm -f "$out"' EXIT
    trap 'exit 255' INT TERM
    start=$(date +%s)
    # LeakSanitizer sometimes crashes while a thread ends, on some machines more often than not,
    # which is no fault of the test: it is retried twice, and then once without leak detection,
    # which is reported.
    leaks=
    for attempt in 1 2 3 4; do
        [ "$attempt" = 4 ] && leaks=:detect_leaks=0
        ASAN_OPTIONS=$ASAN_OPTIONS$leaks timeout "$LIMIT" "$@" >"$out" 2>&1 </dev/null
        code=$?
        grep -q "LeakSanitizer has encountered a fatal error" "$out" || break
    done
    [ -z "$leaks" ] || echo "skip $name: leaks: LeakSanitizer died three times" >>"$SPIN_SKIPS"
    seconds=$(($(date +%s) - start))
    skipped=$(grep -c '^ok .*# SKIP' "$out")
    sed -n "s|^ok [0-9]* - \(.*\) # SKIP \(.*\)|skip $name: \1: \2|p" "$out" >>"$SPIN_SKIPS"
    passed=$(($(grep -c '^ok ' "$out") - skipped))
    failed=$(grep -c '^not ok ' "$out")
    reason=
    if [ "$code" -eq 124 ]; then
        reason=" stopped after $LIMIT s"
    elif [ "$code" -ne 0 ] && [ "$failed" -eq 0 ]; then
        reason=" exit code $code"
    elif [ $((passed + failed + skipped)) -eq 0 ]; then
        reason=" printed no test line"
    elif grep -q '^tests/.*\.sh: .*: \(command \)\?not found$' "$out"; then
        reason=" runs a command that does not exist"
    fi
    [ -n "$reason" ] && failed=$((failed + 1))
    counts="($passed passed, $failed failed, $skipped skipped) $seconds s"
    if [ "$failed" -eq 0 ]; then
        echo "ok   $name $counts"
        return
    fi
    # Printed in one piece, since other tests print at the same time.
    text=$(
        echo "FAIL $name $counts$reason"
        grep -A 3 '^not ok ' "$out" | grep -e '^not ok ' -e '^#' | sed 's/^/     /'
        echo "     ---- its last lines:"
        tail -n 20 "$out" | sed 's/^/     /'
    )
    printf '%s\n' "$text"
}

if [ "$B" = --one ]; then
    B=$2 source=$3
    program=$B/${source%.c}
    # shellcheck disable=SC2086
    case $source in
    *.sh)
        # The programs detect leaks; among the many commands of a script LeakSanitizer would crash
        # in some.
        ASAN_OPTIONS=$ASAN_OPTIONS:detect_leaks=0
        run_one "$source" sh "$source"
        ;;
    tests/fuzz/*)
        finds=fixtures/hostile/$(basename "$source" .c | sed 's/^fuzz-//')
        [ -d "$finds" ] || finds=
        run_one "$source" "$program" ${finds:+"$finds"}
        ;;
    *) run_one "$source" ${SPIN_RUN:-} "$program" ;;
    esac
    exit 0
fi

WORDS=${2:-}
if [ -z "${SPIN_FIXTURES:-}" ]; then
    SPIN_FIXTURES=fixtures
    [ -d ../shared/fixtures ] && SPIN_FIXTURES=../shared/fixtures
fi
SPIN_BIN=$B/bin
SPIN_BUILD=$B
: "${ASAN_OPTIONS:=detect_leaks=1:abort_on_error=0:allocator_may_return_null=1:exitcode=99:handle_sigill=1}"
: "${UBSAN_OPTIONS:=print_stacktrace=1}"
: "${TSAN_OPTIONS:=halt_on_error=0:exitcode=66}"
# Tests check stderr, and on a slow machine commands run long enough to print progress there.
: "${SPIN_PROGRESS:=0}"
# The Python of the scripts. The system's may have NumPy if the first one in PATH has not; a Python
# behind a pyenv script is called directly.
[ -n "${SPIN_PYTHON:-}" ] || for python in python3 /usr/bin/python3; do
    SPIN_PYTHON=$($python -c 'import sys, numpy; print(sys.executable)' 2>/dev/null) && break
done
: "${SPIN_PYTHON:=$(command -v python3)}"
export SPIN_PYTHON SPIN_PROGRESS SPIN_FIXTURES SPIN_BIN SPIN_BUILD ASAN_OPTIONS UBSAN_OPTIONS TSAN_OPTIONS

SPIN_SKIPS=$(mktemp) || exit 1
listed=$(mktemp) || exit 1
told=$(mktemp) || exit 1
left_out=$(mktemp) || exit 1
trap 'rm -f "$SPIN_SKIPS" "$listed" "$told" "$left_out"' EXIT
trap 'exit 130' INT TERM
export SPIN_SKIPS

# The selected tests that are built, long ones first.
for source in tests/*/t-*.c tests/cli/t*.sh tests/fuzz/fuzz-*.c; do
    case $source in
    *.sh) [ -f "$source" ] ;;
    *) [ -x "$B/${source%.c}" ] ;;
    esac && echo "$source"
done | WORDS=$WORDS xargs -r awk -v left_out="$left_out" '
    FNR <= 12 && /(^|[^A-Za-z0-9])K:/ { sub(/.*K:/, ""); gsub(/[^A-Za-z0-9_.-]/, " "); keys[FILENAME] = keys[FILENAME] " " $0 " " }
    function has_key(key) { return index(keys[source], " " key " ") }
    function wanted(i) {
        if (n == 0 && (has_key("test-card") || has_key("test-ranks"))) {
            print source >left_out
            return 0
        }
        if (n == 0 || ENVIRON["WORDS"] == "quick")
            return n == 0 || source !~ /^tests\/(cli|cmd|emu|fuzz)\//
        for (i = 1; i <= n; i++)
            if (index(source, word[i]) || has_key(word[i]))
                return 1
        return 0
    }
    END {
        n = split(ENVIRON["WORDS"], word)
        for (i = 1; i < ARGC; i++) {
            source = ARGV[i]
            if (wanted())
                print !has_key("long"), source
        }
    }' | sort -s -n -k 1,1 | cut -d ' ' -f 2 >"$listed"
xargs -r -P "${JOBS:-1}" -n 1 sh "$0" --one "$B" <"$listed" | tee "$told"

sed 's/$/: left out, see make test-card and make test-ranks/' "$left_out"
sort "$SPIN_SKIPS" | uniq -c | sed 's/^ *1 //; s/^ *\([0-9]*\) \(.*\)/\2 (\1 times)/'
awk -v B="$B" -v words="$WORDS" -v listed="$(wc -l <"$listed")" '
    /^(ok  |FAIL) tests\// { split(substr($0, index($0, "(") + 1), n, " "); p += n[1]; f += n[3]; s += n[5]; programs++ }
    END {
        if (listed == 0) print "nothing to run: no test was built in \047" B "\047 that matches \047" words "\047"
        else if (programs != listed) print listed - programs " of " listed " tests did not come to an end"
        print p + 0 " passed, " f + 0 " failed, " s + 0 " skipped"
        exit listed == 0 || programs != listed || f > 0
    }' "$told"
