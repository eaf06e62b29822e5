#!/bin/sh
# No file depends on itself through others, neither through included headers nor, if the tree is
# built, through called functions. NAME.c and NAME.h count as one file. Calls of plug-ins through
# their lists, and calls by plug-ins of the functions that src/plugin.sym exports, are not counted.
# B: the build folder (build/release).
build=${B:-build/release}

# "file needed-file", without .c and .h
includes() {
    find src importers exporters -name '*.[ch]' -o -name '*.cpp' | xargs awk '
        BEGIN { for (i = 1; i < ARGC; i++) here[ARGV[i]] }
        /^ *# *include *"[^"]*\.h"/ {
            split($0, part, "\"")
            header = ("src/" part[2] in here ? "src/" : "") part[2]
            file = FILENAME
            sub(/\.[a-z]*$/, "", header)
            sub(/\.[a-z]*$/, "", file)
            print file, header
        }'
}

# The name of an object of src/device/cpu contains its SIMD path; objects without a source are
# stale.
calls() {
    {
        find src importers exporters -name '*.c'
        find "$build/src" "$build/importers" "$build/exporters" -name '*.o' 2>/dev/null | xargs -r nm -gA |
            sed "s|^$build/\(.*\)\.o:|\1 |"
    } | awk '
        FILENAME != "-" { if ($1 ~ /^spin_/) open[substr($1, 1, length($1) - 1)]; next }
        NF == 1 { source[substr($1, 1, length($1) - 2)]; next }
        !($1 in source) { sub(/\.[^.\/]*$/, "", $1) }
        !($1 in source) { next }
        NF == 3 { if ($1 ~ /^src/ || !($3 in open)) needs[++n] = $1 " " $3; next }
        $4 !~ /^spin_(im|ex)porters?(_|$)/ { home[$4] = $1 }
        END {
            for (i = 1; i <= n; i++) {
                split(needs[i], need, " ")
                if (need[2] in home)
                    print need[1], home[need[2]]
            }
        }' src/plugin.sym -
}

# Succeeds if the edges on stdin have no cycle; otherwise prints one.
straight() { awk '$1 != $2' | sort -u | tsort 2>&1 >/dev/null; }

if [ -z "$(printf 'a b\nb c\nc a\n' | straight)" ]; then
    echo "circles: not noticed: a circle"
    exit 1
fi
failed=0
for kind in includes calls; do
    edges=$($kind | sort -u)
    circle=$(echo "$edges" | straight)
    if [ -n "$circle" ]; then
        echo "circles: these files need each other by their $kind:"
        echo "$circle" | sed -n 's/^tsort: \([^-].*\)/    \1/p'
        failed=1
    elif [ -z "$edges" ]; then
        echo "circles: nothing is built in $build, calls are not looked at"
    else
        n="${n:+$n, }$(echo "$edges" | grep -c .) $kind"
    fi
done
[ $failed = 0 ] && echo "circles: none among $n"
exit $failed
