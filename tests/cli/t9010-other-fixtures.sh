#!/bin/sh
# K: fixtures
# The golden tests pass with other fixtures of the same layout: they do not depend on numbers of the
# usual fixtures.
. tests/cli/lib.sh

if ! python3 -c 'import numpy' 2>/dev/null; then
    skip "other fixtures" "no python3 with numpy"
    done_testing
fi
run python3 tests/tools/other-fixtures.py fixtures "$work/other"
is "$code" 0 "makes another set"
for source in $(grep -l 'check_\(files\|tolerance\|setting\)(' tests/*/t-*.c); do
    run env SPIN_FIXTURES="$work/other" "${SPIN_BUILD:-build/release}/${source%.c}"
    is "$code" 0 "$source passes on it"
    [ "$code" = 0 ] || grep -A 1 '^not ok' "$work/out" | sed 's/^/#   /' | head -n 6
done
done_testing
