#!/bin/sh
# walk.sh FUNCTION,... COMMAND...: runs the command in gdb, and prints each source file among the
# callers of these functions, once, in the order of their first calls. It counts the files that a
# value passes through: docs/architecture.md.
functions=$(echo "$1" | tr ',' ' ')
shift
script=$(mktemp) || exit 1
trap 'rm -f "$script"' EXIT
{
    echo 'set pagination off'
    echo 'set breakpoint pending on'
    for f in $functions; do
        printf 'tbreak %s\ncommands\nsilent\nbt\ncontinue\nend\n' "$f"
    done
    echo 'run'
} >"$script"
gdb -batch -x "$script" --args "$@" 2>/dev/null | sed -n 's/^#.* at \([a-z][^:]*\):[0-9]*$/\1/p' | awk '!seen[$0]++'
