#!/bin/sh
# K: examples figures transcript
# tests/clean-debian.md quotes the current output of its commands. `make pictures` updates it.
. tests/cli/lib.sh
if ! command -v python3 >/dev/null || [ ! -e "$(dirname "$bin")/lib/spin-image-plain.so" ]; then
    skip "a transcript" "no python3, or built without images"
    done_testing
fi
mkdir "$work/output" "$work/data"
ln -s "$PWD/fixtures/4dgaussian/coarse_and_fine/model" "$work/output/balls"
ln -s "$PWD/fixtures/datasets/blender_mini" "$work/data/balls"
python3 tests/tools/transcript.py tests/clean-debian.md "A run of one's own" "$bin" "$work"
