# shellcheck shell=sh
# Shared by the scripts beside this file: runs a command, checks its output and prints TAP.
#
#     . tests/cli/lib.sh
#     run "$bin/spin-import" --list
#     is "$code" 0 "lists the importers"
#     done_testing
#
# SPIN_BIN: the folder of the commands. SPIN_FIXTURES: the large fixtures.
bin=${SPIN_BIN:-build/release/bin}
fixtures=${SPIN_FIXTURES:-}
if [ -z "$fixtures" ]; then
    fixtures=fixtures
    [ -d ../shared/fixtures ] && fixtures=../shared/fixtures
fi
clip=fixtures/court-mini
work=$(mktemp -d) || exit 1
trap 'record_files "$work"; rm -rf "$work"' EXIT
trap 'exit 130' INT TERM
count=0
failed=0

# tests/run.sh looks for a Python that has NumPy.
[ -z "${SPIN_PYTHON:-}" ] || python3() { "$SPIN_PYTHON" "$@"; }

# Runs a command and sets $code, $work/out and $work/err.
run() {
    "$@" >"$work/out" 2>"$work/err" </dev/null
    code=$?
    [ -z "${SPIN_RECORD:-}" ] || {
        printf '#~ run %s: %s\n' "$*" "$code"
        sed 's/^/#~ out /' "$work/out"
        sed 's/^/#~ err /' "$work/err"
    } >&7
}

# With SPIN_RECORD=1 a test also prints what it does not check, in lines that begin with "#~".
[ -z "${SPIN_RECORD:-}" ] || exec 7>&1
record_files() { # FOLDER
    [ -z "${SPIN_RECORD:-}" ] || python3 tests/tools/record.py "$1" >&7
}

# strace OPTION... COMMAND. LeakSanitizer is off: it would need ptrace, which strace already uses.
traced() {
    ASAN_OPTIONS=${ASAN_OPTIONS:-}:detect_leaks=0 strace "$@"
}

# ok STATUS NAME: passes if STATUS, an exit status, is 0.
ok() {
    count=$((count + 1))
    if [ "$1" = 0 ]; then
        echo "ok $count - $2"
        return
    fi
    failed=$((failed + 1))
    echo "not ok $count - $2"
    [ -s "$work/err" ] && sed 's/^/#   stderr: /' "$work/err" | tail -n 12
}

is() { # GOT WANT NAME
    [ "$1" = "$2" ]
    ok $? "$3"
    [ "$1" = "$2" ] || echo "#   got '$1', want '$2'"
}

skip() { # NAME WHY
    count=$((count + 1))
    echo "ok $count - $1 # SKIP $2"
}

# holds NAME CODE ARGUMENT...: the Python code ends without an exception. One process runs all
# checks of a script, after the definitions that the script wrote to $work/preamble.
holds() {
    name=$1
    printf '%s\n' "$2" >"$work/check"
    shift 2
    if [ -z "${checks:-}" ]; then
        mkfifo "$work/ask" "$work/answer"
        python3 tests/tools/checks.py "$work/ask" "$work/answer" "$work/err" "$work/preamble" </dev/null &
        checks=$!
        exec 8>"$work/ask" 9<"$work/answer"
    fi
    printf '%s\n' $(($# + 1)) "$work/check" "$@" >&8
    read -r answer <&9
    ok "$answer" "$name"
}

out_has() { grep -q -e "$1" "$work/out"; ok $? "$2"; }
err_has() { grep -q -e "$1" "$work/err"; ok $? "$2"; }

# The last run failed properly: with this exit code, nothing on stdout, and one line on stderr that
# begins with the command's name and does not end in a full stop.
fails() { # CODE COMMAND NAME
    is "$code" "$1" "$3: exit code $1"
    [ "$(wc -l <"$work/err")" = 1 ] && grep -q "^$2: .*[^.]\$" "$work/err"
    ok $? "$3: one line on stderr"
    [ ! -s "$work/out" ]
    ok $? "$3: nothing on stdout"
}

# stdout is exactly one JSON document, checked with whatever parser this machine has.
is_json() { # NAME
    if command -v jq >/dev/null 2>&1; then
        [ "$(jq -s length "$work/out" 2>/dev/null)" = 1 ]
        ok $? "$1"
    elif command -v python3 >/dev/null 2>&1; then
        python3 -c 'import json, sys; json.load(sys.stdin)' <"$work/out" 2>/dev/null
        ok $? "$1"
    else
        skip "$1" "neither jq nor python3 is here"
    fi
}

# The value of a top-level member of our JSON, a number or a word.
member() { sed -n 's/^  "'"$1"'": "*\([^",]*\)"*,*$/\1/p' "${2:-$work/out}"; }

# True if A > B, as numbers.
greater() { awk -v a="$1" -v b="$2" 'BEGIN { exit !(a != "" && b != "" && a + 0 > b + 0) }'; }

# No file with this name or this prefix was left behind.
nothing_at() { # PATH NAME
    ! ls -d "$1"* >/dev/null 2>&1
    ok $? "$2"
}

done_testing() {
    echo "1..$count"
    [ "$failed" = 0 ]
    exit
}

# Exports the retrained frames of two bundles as PLY to a and b; fails unless both have all frames.
both_frames() { # BUNDLE BUNDLE
    rm -rf "$work/a" "$work/b"
    "$bin/spin-export" "$1" --to ply -o "$work/a" -q >/dev/null 2>"$work/err" &&
        "$bin/spin-export" "$2" --to ply -o "$work/b" -q >/dev/null 2>"$work/err" &&
        [ "$(ls "$work/a" | wc -l)" = "$(ls "$work/b" | wc -l)" ] && ls "$work/a"/frame_*.ply >/dev/null
}
same_frames() { # BUNDLE BUNDLE NAME
    both_frames "$1" "$2" && diff -r "$work/a" "$work/b" >/dev/null
    ok $? "$3"
}
other_frames() { # BUNDLE BUNDLE NAME
    both_frames "$1" "$2" && ! cmp -s "$work/a/frame_00000.ply" "$work/b/frame_00000.ply"
    ok $? "$3"
}
