#!/bin/sh
# --help, --version and --list of every command; they go to stdout and succeed.
. tests/cli/lib.sh

for name in spin-import spin-retrain spin-eval spin-export; do
    run "$bin/$name" --help
    is "$code" 0 "$name --help succeeds"
    [ ! -s "$work/err" ]
    ok $? "$name --help says nothing on stderr"
    for option in help version json threads force quiet verbose; do
        out_has "--$option" "$name --help lists --$option"
    done
    run "$bin/$name" --no-such-option --help
    is "$code" 0 "$name --help answers whatever else was typed"
    run "$bin/$name" --version
    is "$code" 0 "$name --version succeeds"
    out_has "^$name [0-9]*\.[0-9]*\.[0-9]*\$" "$name --version prints name and version"
    "$bin/$name" --help >/dev/full 2>"$work/err"
    is $? 1 "$name --help to a full disk fails"
done

for name in spin-import spin-export; do
    run "$bin/$name" --list
    is "$code" 0 "$name --list succeeds"
    out_has '^ply ' "$name --list has ply"
    run "$bin/$name" --list --json
    is "$code" 0 "$name --list --json succeeds"
    is_json "$name --list --json is one document"
    out_has '"name": "ply"' "$name --list --json has ply"
    out_has '"summary": "' "$name --list --json has summaries"
done
run "$bin/spin-import" --list --json
out_has '"name": "d3dgs"' "spin-import --list --json has d3dgs"
out_has '"upstream": "' "spin-import --list --json has upstreams"

run "$bin/spin-export" --to ply --help
out_has "Options of the exporter 'ply'" "spin-export --to ply --help lists its own options"
out_has "--min-opacity" "spin-export --to ply --help has --min-opacity"
run "$bin/spin-import" --from d3dgs --help
out_has "Options of the importer 'd3dgs'" "spin-import --from d3dgs --help lists its own options"

done_testing
