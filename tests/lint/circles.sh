#!/bin/sh
# No file needs itself by way of others, neither by the headers that are included nor, where the tree is
# built, by the functions that are called. NAME.c and NAME.h are one file here. Plug-ins do not count where
# they are called through their lists, nor where they call what src/plugin.sym opens to them.
# B: the build folder (build/release).
build=${B:-build/release}

# "file needed-file", less .c and .h
includes() {
    find src importers exporters -name '*.[ch]' -o -name '*.cpp' | while read -r file; do
        sed -n 's/^ *# *include *"\([^"]*\)\.h".*/\1/p' "$file" | while read -r header; do
            [ -f "src/$header.h" ] && header=src/$header
            echo "${file%.*} $header"
        done
    done
}

# An object of src/device/cpu has its code path in its name; one without a source is left over.
calls() {
    find "$build/src" "$build/importers" "$build/exporters" -name '*.o' 2>/dev/null | while read -r object; do
        file=${object#"$build/"}
        file=${file%.o}
        [ -f "$file.c" ] || file=${file%.*}
        [ -f "$file.c" ] && nm -g "$object" | sed "s|^|$file |"
    done | awk '
        FILENAME != "-" { if ($1 ~ /^spin_/) open[substr($1, 1, length($1) - 1)]; next }
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

# The edges on stdin have no circle; else one that they have.
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
