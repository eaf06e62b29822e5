#!/bin/sh
# K: python bundle numpy
# exporters/python/spin4d.py on bundles made with NumPy, compared with the manual value by value:
# ranges, clamps, static columns, packed arrays, tracks whose rows differ, networks, and what it
# refuses.
. tests/cli/lib.sh
if ! python3 -c 'import numpy' 2>/dev/null; then
    skip "bundles made by NumPy" "no python3 with numpy"
    done_testing
    exit
fi
PYTHONDONTWRITEBYTECODE=1 PYTHONPATH="$PWD/exporters/python" python3 tests/tools/python-parts.py "$work"
