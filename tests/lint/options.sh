#!/bin/sh
# Every option of every command, importer, exporter and data set occurs in a test: a cheap reminder
# to test new ones. Whether the test checks the option's effect is up to the test.
# B: the build folder (build/release).
bin=${B:-build/release}/bin
failed=0
checked=0

# The options of one --help text, or of its last part.
options() { sed -n 's/^  \(-., \|    \)--\([a-z0-9-]*\).*/\2/p'; }

# used OPTION FILES...: as --option, as "option" in a list of a C test, as :option= of a data set,
# or by its letter
used() {
    option=$1
    shift
    case $option in
    quiet) letter=q ;;
    verbose) letter=v ;;
    *) letter=NONE ;;
    esac
    grep -q -e "--$option\([^a-z0-9-]\|\$\)" -e "\"$option\"" -e "[:,]$option=" -e " -$letter\([ \"]\|\$\)" "$@"
}

for name in spin4d spin-import spin-retrain spin-eval spin-export; do
    if [ ! -x "$bin/$name" ]; then
        echo "options: $name is not built in $bin, its options are not compared"
        continue
    fi
    tests=$(grep -l -e "$name" tests/cli/t*.sh tests/cmd/t-*.c)
    for option in $("$bin/$name" --help all | options); do
        # shellcheck disable=SC2086
        if ! used "$option" $tests; then
            echo "options: no test uses $name --$option"
            failed=1
        fi
        checked=$((checked + 1))
    done
done
for pair in spin-import:--from:importers spin-export:--to:exporters; do
    name=${pair%%:*}
    room=${pair##*:}
    selector=${pair#*:}
    selector=${selector%:*}
    [ -x "$bin/$name" ] || continue
    for plugin in $("$bin/$name" --list | awk '/^[a-z0-9]/ { print $1 }'); do
        # Options that several importers or exporters share are tested with the shared code.
        for option in $("$bin/$name" $selector "$plugin" --help | sed -n '/^Options of/,$p' | options); do
            if ! used "$option" tests/$room/*.[ch] tests/cli/t*.sh; then
                echo "options: no test uses --$option of $plugin"
                failed=1
            fi
            checked=$((checked + 1))
        done
    done
done
[ $failed = 0 ] && echo "options: each of $checked is used by a test"
exit $failed
