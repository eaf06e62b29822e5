#!/bin/sh
# K: completion bash zsh
# The completion scripts: bash offers the right words for a line, and zsh can read them.
. tests/cli/lib.sh
unset SPIN_PLUGIN_PATH
PATH=$bin:$PATH # the scripts ask the commands

for name in spin4d spin-import spin-retrain spin-eval spin-export; do
    for shell in bash zsh; do
        run "$bin/$name" --completion $shell
        is "$code $(wc -c <"$work/err")" "0 0" "$name --completion $shell"
        cp "$work/out" "$work/$name.$shell"
        if command -v $shell >/dev/null 2>&1; then
            run $shell -n "$work/$name.$shell"
            is "$code $(wc -c <"$work/err")" "0 0" "$shell reads it"
        else
            skip "$shell reads it" "no $shell"
        fi
    done
    run "$bin/$name" --completion fish
    fails 2 "$name" "$name --completion of another shell"
    "$bin/$name" --completion bash >/dev/full 2>"$work/err"
    is $? 1 "$name --completion to a full disk fails"
done

# offered COMMAND WORD...: writes what bash offers for the last word of this line to $work/out, one
# a line
offered() {
    bash -c '. "$1/$2.bash"
        shift
        COMP_WORDS=("$@")
        COMP_CWORD=$(($# - 1))
        "_${1//-/_}"
        printf "%s\n" "${COMPREPLY[@]}"' bash "$work" "$@" >"$work/out" 2>"$work/err"
    is "$? $(wc -c <"$work/err")" "0 0" "completes '$*'"
}
# offers WORDS COMMAND WORD...: bash offers exactly these words
offers() {
    wanted=$1
    shift
    offered "$@"
    is "$(tr '\n' ' ' <"$work/out" | sed 's/ *$//')" "$wanted" "as: $wanted"
}

if command -v bash >/dev/null 2>&1; then
    for name in spin4d spin-import spin-retrain spin-eval spin-export; do
        offered $name --
        is "$(LC_ALL=C sort "$work/out")" \
            "$("$bin/$name" --help all | sed -n 's/^  \(-., \|    \)\(--[a-z0-9-]*\).*/\2/p' | LC_ALL=C sort)" \
            "$name: every option of --help all"
    done
    offers "--positions-only" spin-import in.npz --pos
    # shellcheck disable=SC2046
    offers "$(echo $("$bin/spin-import" --list | sed -n 's/^\([a-z0-9-]*\) .*/\1/p'))" spin-import --from ""
    offers "deformable3dgs" spin-import x --from=d --from = de
    offers "colmap" spin-retrain --data-from c
    offers "short" spin-retrain in.spin --preset s
    offers "auto cpu cuda" spin-eval --device ""
    offers "off auto none" spin-retrain --scene-normalise ""
    offers "" spin-retrain --iterations ""
    offers "" spin-retrain in.spin --output ""
    offers "" spin-retrain in.spin -o ""
    offers "" spin-export in.spin --pan
    offers "--panels" spin-export in.spin --to images --pan
    offers "--panels" spin-export --pan --to = images --pan
    offers "orbit" spin-export in.spin --to images --path o
    offers "black white" spin-export --background ""
    offers "import retrain eval export" spin4d ""
    offers "--background" spin4d export --backg
    offers "" spin4d run --backg
else
    skip "what bash offers" "no bash"
fi

# What the commands offer to zsh, which joins --name=value into one word and shows an option's help
# beside it.
for line in '--to=images --path' '--to images --path'; do
    # shellcheck disable=SC2086
    run "$bin/spin-export" --complete $line
    is "$code $(wc -c <"$work/err")" "0 0" "completes: $line"
    out_has '^--path:[a-z].*' "with the exporter's own options, and their help"
done
run "$bin/spin-export" --complete in.spin --to=ima
out_has '^images$' "the value of --name=value"
done_testing
