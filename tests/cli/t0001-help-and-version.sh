#!/bin/sh
# --help, --version and --list of every command print to stdout and succeed.
. tests/cli/lib.sh

for name in spin4d spin-import spin-retrain spin-eval spin-export; do
    run "$bin/$name" --help
    is "$code" 0 "$name --help succeeds"
    [ ! -s "$work/err" ]
    ok $? "$name --help says nothing on stderr"
    [ "$(wc -l <"$work/out")" -le 40 ] && ! grep -q '.\{101\}' "$work/out"
    ok $? "$name --help is one screen"
    [ "$(grep -c '^ \{7\}' "$work/out")" = "$(grep -c '^ \{28\}[^ ]' "$work/out")" ]
    ok $? "$name --help continues lines in the second column"
    out_has "^  -h, --help " "$name --help shows short names"
    out_has "--help all" "$name --help says where the rest is"
    ! twice=$(sed -n 's/^  \(-., \|    \)\(--[a-z0-9-]*\).*/\2/p' "$work/out" | sort | uniq -d | grep .)
    ok $? "$name --help has no option twice: $twice"
    for all in '--help all' '-h all' --help=all '--no-such-option --help all'; do
        # shellcheck disable=SC2086
        run "$bin/$name" $all
        is "$code $(wc -c <"$work/err")" "0 0" "$name $all"
        for option in help version json threads force quiet verbose; do
            out_has "--$option" "$name $all lists --$option"
        done
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

run "$bin/spin-export" --help
out_has "^  *4dgs, compressed-ply, ftgs, gltf, html" "spin-export --help names the formats"
run "$bin/spin-export" --help all
for name in ply gltf html video; do
    out_has "^      $name  *[A-Za-z3]" "spin-export --help all says what --to $name writes"
done
run "$bin/spin-export" --to ply --help
out_has "Options of the exporter 'ply'" "spin-export --to ply --help lists its own options"
out_has "--rotate" "spin-export --to ply --help has --rotate"
run "$bin/spin-import" --from d3dgs --help
out_has "Options of the importer 'd3dgs'" "spin-import --from d3dgs --help lists its own options"
for plugin in $("$bin/spin-export" --list | awk '/^[a-z0-9]/ { print $1 }'); do
    run "$bin/spin-export" --to "$plugin" --help
    [ "$(wc -l <"$work/out")" -le 40 ]
    ok $? "and those of $plugin on one screen"
done

done_testing
