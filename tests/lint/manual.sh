#!/bin/sh
# Every option of --help stands in the manual page and the other way round; the pages are well formed.
# B: the build folder (build/release).
bin=${B:-build/release}/bin
failed=0
checked=0

for page in man/spin-*.1; do
    name=$(basename "$page" .1)
    if command -v mandoc >/dev/null 2>&1 && ! mandoc -T lint -W error "$page" >/dev/null; then
        mandoc -T lint -W error "$page"
        failed=1
    fi
    if [ ! -x "$bin/$name" ]; then
        echo "manual: $name is not built in $bin, its options are not compared"
        continue
    fi
    help=$("$bin/$name" --help | sed -n 's/^  \(-., \|    \)--\([a-z0-9-]*\).*/\2/p' | sort)
    plugins= # options that only some exporter or importer has
    case $name in
    spin-export) selector=--to ;;
    spin-import) selector=--from ;;
    *) selector= ;;
    esac
    for plugin in $([ -n "$selector" ] && "$bin/$name" --list | awk '/^[a-z0-9]/ { print $1 }'); do
        plugins="$plugins $("$bin/$name" $selector "$plugin" --help | sed -n 's/^ *--\([a-z0-9-]*\).*/\1/p')"
    done
    manual=$(sed -n 's/^\.It .*Fl Fl \([a-z0-9-]*\).*/\1/p' "$page" | sort)
    for option in $help; do
        if ! echo "$manual" | grep -qx -e "$option"; then
            echo "manual: $page lacks --$option"
            failed=1
        fi
        checked=$((checked + 1))
    done
    for option in $manual; do
        if ! printf '%s\n' "$help" $plugins | grep -qx -e "$option"; then
            echo "manual: $page has --$option, which $name --help lacks"
            failed=1
        fi
    done
    short=$("$bin/$name" --help | sed -n 's/^  -\(.\), --.*/\1/p')
    for option in $short; do
        if ! grep -q "^\.It Fl $option ," "$page"; then
            echo "manual: $page lacks -$option"
            failed=1
        fi
    done
done
[ $failed = 0 ] && echo "manual: $checked options in help and manual agree"
exit $failed
