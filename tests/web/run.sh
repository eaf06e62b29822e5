#!/bin/sh
# run.sh BUILD BIN_DIR: compares the page of `make web` with the commands of BIN_DIR: a run of every
# importer listed in tests/runs.sh becomes the same bytes, as PLY (or what the bundle has), GLB and
# SPZ. Then opens the page in Chromium, if that and the packages of tests/viewers are installed.
BUILD=${1:?usage: run.sh BUILD BIN_DIR}
bin=${2:?usage: run.sh BUILD BIN_DIR}
root=$(cd "$(dirname "$0")/../.." && pwd)
large=${SPIN_FIXTURES:-$root/../shared/fixtures}
out=$(realpath -m "$BUILD")/web/test
. "$root/tests/runs.sh"
failed=0

fail() {
    echo "web: $*" >&2
    failed=1
}

command -v node >/dev/null || {
    echo "web: skipped: no Node (Debian: nodejs)"
    exit 0
}
rm -rf "$out"
mkdir -p "$out/native"
for name in $(importers_of_runs "$bin") court-mini; do
    run=$(run_of "$name")
    from=$large/$run
    [ "$name" = court-mini ] && from=$root/fixtures/court-mini
    [ -n "$run" ] && [ ! -e "$from" ] && from=$root/fixtures/$run
    [ "$name" = court-mini ] || [ -n "$run" ] || { echo "  left  $name: tests/runs.sh has no run of it"; continue; }
    mkdir -p "$out/native/$name"
    for frames in '' 3; do # a continuous method does not say how many
        "$bin/spin-import" -q "$from" ${frames:+--frames $frames} -o "$out/native/$name/clip.spin" 2>"$out/native/$name/err" && break
    done
    [ -e "$out/native/$name/clip.spin" ] || { fail "$name: $(cat "$out/native/$name/err")"; continue; }
    for to in ply gltf spz; do
        "$bin/spin-export" -q "$out/native/$name/clip.spin" --to $to -o "$out/native/$name/$to" 2>/dev/null ||
            rm -rf "$out/native/$name/$to"
    done
    node "$root/tests/web/compare.cjs" "$BUILD/web" "$name" "$from" "$out/native/$name" $frames || fail "$name"
done
if [ -d "$root/tests/viewers/node_modules/playwright-core" ] && command -v "${CHROMIUM:-chromium}" >/dev/null; then
    node "$root/tests/viewers/web.mjs" "$BUILD/web/spin4d.html" "$root/fixtures/court-mini" "$out/native/court-mini" "$out" ||
        fail "the page in Chromium"
else
    echo "web: the page is not opened: no Chromium, or no packages (make test-viewers fetches them)"
fi
exit $failed
