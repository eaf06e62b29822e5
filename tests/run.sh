#!/bin/sh
# run.sh BUILD_DIR [WORD]: run the built tests from the root of the repository; prints a summary, and
# what was skipped with the reason.
#
# Runs BUILD_DIR/tests/*/t-* (programs), tests/cli/t*.sh (scripts) and BUILD_DIR/tests/fuzz/fuzz-*
# on the saved finds in fixtures/hostile/<name>/. With WORD only those whose source path contains
# it, or whose source has WORD in its line of keys ("K: golden threads"). A crash, a non-zero exit
# and more than ten minutes are failures.
#
# SPIN_RUN runs the programs of another machine (qemu-aarch64).
# SPIN_FIXTURES says where the large fixtures are; SPIN_BIN and SPIN_BUILD are set for the scripts.
B=${1:?usage: run.sh BUILD_DIR [WORD]}
WORD=${2:-}
LIMIT=600

if [ -z "${SPIN_FIXTURES:-}" ]; then
    SPIN_FIXTURES=fixtures
    [ -d ../shared/fixtures ] && SPIN_FIXTURES=../shared/fixtures
fi
SPIN_BIN=$B/bin
SPIN_BUILD=$B
: "${ASAN_OPTIONS:=detect_leaks=1:abort_on_error=0:allocator_may_return_null=1:exitcode=99}"
: "${UBSAN_OPTIONS:=print_stacktrace=1}"
: "${TSAN_OPTIONS:=halt_on_error=0:exitcode=66}"
# Tests look at what stands on stderr, and a slow machine may take a minute for them.
: "${SPIN_PROGRESS:=0}"
export SPIN_PROGRESS SPIN_FIXTURES SPIN_BIN SPIN_BUILD ASAN_OPTIONS UBSAN_OPTIONS TSAN_OPTIONS

out=$(mktemp) || exit 1
skips=$(mktemp) || exit 1
trap 'rm -f "$out" "$skips"' EXIT
trap 'exit 130' INT TERM
total_passed=0 total_failed=0 total_skipped=0 programs=0

# matches SOURCE
matches() {
    [ -z "$WORD" ] && return 0
    case $1 in
    *"$WORD"*) return 0 ;;
    esac
    grep -E "(^|[^A-Za-z0-9])K:" "$1" 2>/dev/null | sed 's/.*K://; s/[^A-Za-z0-9_.-]/ /g' |
        tr ' ' '\n' | grep -Fqx -e "$WORD"
}

# run NAME COMMAND...
run() {
    name=$1
    shift
    programs=$((programs + 1))
    timeout "$LIMIT" "$@" >"$out" 2>&1 </dev/null
    code=$?
    skipped=$(grep -c '^ok .*# SKIP' "$out")
    sed -n "s|^ok [0-9]* - \(.*\) # SKIP \(.*\)|skip $name: \1: \2|p" "$out" >>"$skips"
    passed=$(($(grep -c '^ok ' "$out") - skipped))
    failed=$(grep -c '^not ok ' "$out")
    reason=
    if [ "$code" -eq 124 ]; then
        reason=" stopped after $LIMIT s"
    elif [ "$code" -ne 0 ] && [ "$failed" -eq 0 ]; then
        reason=" exit code $code"
    elif [ $((passed + failed + skipped)) -eq 0 ]; then
        reason=" printed no test line"
    fi
    [ -n "$reason" ] && failed=$((failed + 1))
    total_passed=$((total_passed + passed))
    total_failed=$((total_failed + failed))
    total_skipped=$((total_skipped + skipped))
    if [ "$failed" -eq 0 ]; then
        echo "ok   $name ($passed passed, $failed failed, $skipped skipped)"
        return
    fi
    echo "FAIL $name ($passed passed, $failed failed, $skipped skipped)$reason"
    grep -A 3 '^not ok ' "$out" | grep -e '^not ok ' -e '^#' | sed 's/^/     /'
    echo "     ---- its last lines:"
    tail -n 20 "$out" | sed 's/^/     /'
}

for source in tests/*/t-*.c; do
    program=$B/${source%.c}
    # shellcheck disable=SC2086
    [ -x "$program" ] && matches "$source" && run "$source" ${SPIN_RUN:-} "$program"
done
for source in tests/cli/t*.sh; do
    [ -f "$source" ] && matches "$source" && run "$source" sh "$source"
done
for source in tests/fuzz/fuzz-*.c; do
    program=$B/${source%.c}
    name=$(basename "$source" .c)
    finds=fixtures/hostile/${name#fuzz-}
    [ -x "$program" ] && matches "$source" || continue
    if [ -d "$finds" ]; then
        run "$source" "$program" "$finds"
    else
        run "$source" "$program"
    fi
done

if [ "$programs" -eq 0 ]; then
    echo "nothing to run: no test was built in '$B' that matches '$WORD'"
fi
sort "$skips" | uniq -c | sed 's/^ *1 //; s/^ *\([0-9]*\) \(.*\)/\2 (\1 times)/'
echo "$total_passed passed, $total_failed failed, $total_skipped skipped"
[ "$programs" -gt 0 ] && [ "$total_failed" -eq 0 ]
