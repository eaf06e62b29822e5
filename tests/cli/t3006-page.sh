#!/bin/sh
# K: html page viewers node
# The page of --to html, its worker and its shaders, in Node without a browser: numbers, images,
# buttons and keys.
. tests/cli/lib.sh
if ! node -e 'process.exit(parseInt(process.versions.node) < 18 ? 1 : 0)' 2>/dev/null; then
    skip "the page in Node" "no node of version 18 or later"
    done_testing
    exit
fi
node tests/viewers/page-in-node.mjs "$bin" "$work"
