#!/bin/sh
# Every option of --help stands in the manual page and the other way round; the pages are well formed.
# Of spin-retrain they also have the same argument and the same default.
# B: the build folder (build/release).
bin=${B:-build/release}/bin
failed=0
checked=0

# Lines "--name argument (default)": of a --help text, and of a page, where "Default: " begins a line.
lines_of_help() {
    awk 'function flush() {
            if (name) print "--" name, arg, match(help, /\([^()]*\)$/) ? substr(help, RSTART) : ""
            name = ""
        }
        /^ +(-., )?--/ {
            flush()
            sub(/^ *(-., )?--/, "")
            help = match($0, /   *[^ ]/) ? substr($0, RSTART + RLENGTH - 1) : ""
            left = RSTART ? substr($0, 1, RSTART - 1) : $0
            name = arg = left
            sub(/ .*/, "", name)
            sub(/^[^ ]* ?/, "", arg)
            next
        }
        /^ / { sub(/^ */, ""); help = help (help ? " " : "") $0; next }
        { flush() }
        END { flush() }'
}
lines_of_page() {
    awk 'function flush() {
            if (name) print "--" name, arg, fallback
            name = ""
        }
        /^\.(It|El|Ss|Sh)/ { flush() }
        /^\.It .*Fl Fl / {
            sub(/.*Fl Fl /, "")
            name = $1
            fallback = ""
            sub(/^[^ ]*( Ar )?/, "")
            gsub(/ \| /, "|")
            arg = $0
        }
        /^Default: .*\.$/ { fallback = "(" substr($0, 10, length($0) - 10) ")" }'
}

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
    if [ "$name" = spin-retrain ]; then
        differences=$({
            "$bin/$name" --help | lines_of_help
            lines_of_page <"$page"
        } | sort | uniq -u)
        if [ -n "$differences" ]; then
            echo "manual: $page and --help differ:"
            printf '%s\n' "$differences"
            failed=1
        fi
    fi
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
