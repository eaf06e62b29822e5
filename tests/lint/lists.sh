#!/bin/sh
# The file of each plug-in (a source without a header of its own) defines at least one struct, each
# struct is in the list, and the list is alphabetical and ends with NULL.
failed=0
n=0
complain() {
    echo "lists: $*"
    failed=1
}

for list in importers exporters; do
    kind=${list%s}
    listed=$(grep -o 'ONE([a-z0-9_]*)' $list/$list.c | sed 's/ONE(\(.*\))/\1/' | grep -vx ONE)
    define="^\(const struct spin_$kind spin_${kind}_\|SPIN_[A-Z_]*PORTER(\)\([a-z0-9_]*\)\( = {\|,.*\)\$"
    defined=$(sed -n "/^SPIN_[A-Z_]*PORTER(\$/{N;s/\n *//};s/$define/\2/p" $list/*.c)
    for file in $list/*.c; do
        name=$(basename "$file" .c)
        [ "$name" = $list ] && continue
        [ -f "$list/$name.h" ] && continue # a helper that the room shares
        grep -Eq "^(const struct spin_$kind spin_${kind}_[a-z0-9_]* = \{|SPIN_[A-Z_]*PORTER\()" "$file" ||
            complain "$file defines no spin_${kind}_NAME"
    done
    for name in $defined; do
        n=$((n + 1))
        echo "$listed" | grep -qx "$name" || complain "spin_${kind}_$name is not in $list/$list.c"
    done
    for name in $listed; do
        echo "$defined" | grep -qx "$name" || complain "$list/$list.c lists '$name', which no file defines"
    done
    [ "$listed" = "$(echo "$listed" | LC_ALL=C sort)" ] ||
        complain "$list/$list.c is not alphabetical"
    grep -q 'ALL(LIST) NULL};$' $list/$list.c || complain "$list/$list.c does not end with NULL"
done
[ $failed = 0 ] && echo "lists: $n plug-ins, all listed"
exit $failed
