#!/bin/sh
# every_export.sh: imports a run of each importer, and exports it in every format. It checks only
# that commands end well or with a message; tests/tools/changes.py compares what they write.
. tests/cli/lib.sh
. tests/runs.sh

# write COMMAND OUT ARGUMENT...: records each file, then removes it.
write() {
    command=$1 out=$work/out-$2
    shift 2
    run "$bin/$command" "$@" -q -o "$out"
    [ "$code" = 0 ] && [ -e "$out" ]
    [ $? = 0 ] || { [ "$code" = 1 ] && [ ! -e "$out" ] && grep -q "^$command: " "$work/err"; }
    ok $? "$command $* -o $out"
    mkdir "$work/record"
    mv "$out" "$work/record/" 2>/dev/null
    record_files "$work/record"
    rm -rf "$work/record"
}

for name in $(importers_of_runs "$bin"); do
    source=fixtures/$(run_of "$name")
    [ "$source" != fixtures/ ] && [ -e "$source" ] || continue
    # Methods that are defined at any time need a number of frames; of long clips a few are enough.
    for frames in '' '--frames 3' '--range 0:24:8'; do
        # shellcheck disable=SC2086
        "$bin/spin-import" "$source" -q -o "$work/in.spin" --force $frames 2>/dev/null || continue
        [ "$("$bin/spin-import" --info "$work/in.spin" --json | sed -n 's/^  "frames": \([0-9]*\),*$/\1/p')" -gt 30 ] || break
    done
    # shellcheck disable=SC2086
    write spin-import clip.spin "$source" $frames
    for format in $("$bin/spin-export" --list | sed -n 's/^\([a-z0-9][^ ]*\) .*/\1/p' | grep -vx 'images\|video'); do
        write spin-export "$format" "$work/in.spin" --to "$format"
    done
    write spin-export images "$work/in.spin" --to images --path orbit --duration 0.1 --size 64x48
done
done_testing
