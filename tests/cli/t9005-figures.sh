#!/bin/sh
# K: long figures info report eval retrain export sequence
# Every figure that the commands and the report page show to people, against --json; and --json against sums
# that figures.py makes apart, from the bundle, the images and the files.
# $TAP_PART runs one alone: PART(imports) PART(plans) PART(retrains) PART(pages) PART(exports).
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
