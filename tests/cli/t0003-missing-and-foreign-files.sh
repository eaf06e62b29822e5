#!/bin/sh
# What is not there or not ours: exit code 1, one line that names it, nothing written.
. tests/cli/lib.sh

echo "not a zip" >"$work/text.spin"
: >"$work/empty.spin"
printf 'PK\005\006\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0' >"$work/hollow.spin"

for file in "$work/absent.spin" "$work/text.spin" "$work/empty.spin" "$work/hollow.spin" "$work"; do
    word=$(basename "$file")
    run "$bin/spin-import" --info "$file"
    fails 1 spin-import "import $word"
    err_has "'$file" "import $word: names the input"
    run "$bin/spin-import" "$file" -o "$work/new.spin"
    fails 1 spin-import "import $word to a bundle"
    nothing_at "$work/new" "import $word: nothing was written"
    run "$bin/spin-retrain" "$file" -o "$work/new.spin"
    fails 1 spin-retrain "retrain $word"
    nothing_at "$work/new" "retrain $word: nothing was written"
    run "$bin/spin-eval" "$file" --json
    fails 1 spin-eval "eval $word"
    run "$bin/spin-export" "$file" --to ply -o "$work/new"
    fails 1 spin-export "export $word"
    nothing_at "$work/new" "export $word: nothing was written"
done

done_testing
