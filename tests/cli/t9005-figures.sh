#!/bin/sh
# K: long figures info report eval retrain export sequence
# The numbers that commands and the report page show equal those of --json, and figures.py computes
# the main ones of --json a second time, from the bundle, the images and the files. $TAP_PART
# selects one part: PART(imports) PART(retrains) PART(pages) PART(exports).
. tests/cli/lib.sh

if ! python3 -c 'import numpy' 2>/dev/null; then
    skip "figures" "no python3 with NumPy"
    done_testing
fi
if [ ! -e "$(dirname "$bin")/lib/spin-image.so" ]; then
    skip "figures" "built without images"
    done_testing
fi
python3 tests/cli/figures.py "$bin" "$clip" "$work"
