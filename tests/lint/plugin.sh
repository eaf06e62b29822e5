#!/bin/sh
# The functions that a plug-in may call: parts 1 to 4 and 6 of src/spin.h. src/plugin.sym names
# exactly those, and every command in B (build/release) exports them to plug-ins, and nothing else
# of ours.
CC=${1:-gcc}
bin=${B:-build/release}/bin
failed=0
complain() {
    echo "plugin: $*"
    failed=1
}

functions_of() { # FIRST LAST: names that are declared between these headings
    sed -n "/---- $1\\. /,/---- $2\\. /p" src/spin.h | sed 's/^#define.*//' |
        $CC -fpreprocessed -E -P -x c - 2>/dev/null | grep -o 'spin_[a-z0-9_]*(' | tr -d '('
}

wanted=$({ functions_of 1 5; functions_of 6 7; } | LC_ALL=C sort -u)
listed=$(sed -n 's/^ *\(spin_[a-z0-9_]*\);$/\1/p' src/plugin.sym)
n=$(echo "$listed" | wc -l)
[ "$wanted" = "$listed" ] || complain "src/plugin.sym does not list the functions of src/spin.h:
$(printf '%s\n' "$wanted" "$listed" | LC_ALL=C sort | uniq -u)"

for name in spin4d spin-import spin-retrain spin-export spin-eval; do
    if [ ! -x "$bin/$name" ]; then
        echo "plugin: $name is not built in $bin, its symbols are not compared"
        continue
    fi
    found=$(nm -D --defined-only "$bin/$name" | sed -n 's/.* [TDRB] \(spin_.*\)/\1/p' | LC_ALL=C sort)
    [ "$found" = "$listed" ] || complain "$name exports other symbols than src/plugin.sym:
$(printf '%s\n' "$found" "$listed" | LC_ALL=C sort | uniq -u)"
done
[ $failed = 0 ] && echo "plugin: $n functions for plug-ins, in header, list and commands"
exit $failed
