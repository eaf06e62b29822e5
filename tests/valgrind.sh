#!/bin/sh
# valgrind.sh BIN_DIR: runs each command once on the bundled clip under valgrind; fails on any leak
# at exit or invalid access. Takes a few minutes, so `make test` omits it.
bin=${1:-build/release/bin}
here=$(dirname "$0")
clip=fixtures/court-mini
tmp=$(mktemp -d) || exit 1
trap 'rm -rf "$tmp"' EXIT
failed=0

command -v valgrind >/dev/null || {
    echo "valgrind: not installed (apt-get install valgrind)" >&2
    exit 1
}

# check NAME CODE COMMAND: definite and indirect losses are ours unless tests/valgrind.supp lists
# them.
check() {
    name=$1
    code=$2
    shift 2
    valgrind -q --leak-check=full --show-leak-kinds=definite,indirect \
        --errors-for-leak-kinds=definite,indirect --suppressions="$here/valgrind.supp" \
        --error-exitcode=99 --log-file="$tmp/log" "$@" >"$tmp/out" 2>&1
    if [ $? = "$code" ] && ! [ -s "$tmp/log" ]; then
        echo "ok      $name"
    else
        echo "FAILED  $name"
        cat "$tmp/log"
        tail -3 "$tmp/out"
        failed=1
    fi
}

check "spin-import" 0 "$bin/spin-import" --from d3dgs $clip --data $clip --range 2:4 -o "$tmp/a.spin"
check "spin-import --info" 0 "$bin/spin-import" --info $clip
check "spin-import --check-cameras" 0 "$bin/spin-import" --check-cameras "$tmp/overlay" --data $clip $clip
check "spin-retrain" 0 "$bin/spin-retrain" "$tmp/a.spin" -o "$tmp/b.spin" --preset paper --device cpu --iterations 3 \
    --levels 4 --hash-log2 12 --scale 0.5 --sh-degree 1 --learn-exposure on --preview "$tmp/preview"
check "spin-eval" 0 "$bin/spin-eval" "$tmp/b.spin" --scale 0.5 --images "$tmp/images" --json
for to in $("$bin/spin-export" --list | awk '{ print $1 }'); do
    name=$tmp/to-$to
    [ "$to" = video ] && name=$name.mp4
    check "spin-export --to $to" 0 "$bin/spin-export" "$tmp/b.spin" --to "$to" -o "$name"
done
check "an error's way out" 1 "$bin/spin-import" --info "$here/valgrind.supp"
exit $failed
