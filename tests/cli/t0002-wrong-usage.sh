#!/bin/sh
# Wrong usage gives exit code 2 and one line that names the fault and points at --help.
. tests/cli/lib.sh

# misuse WORDS-EXPECTED COMMAND ARGUMENTS...
misuse() {
    expected=$1
    name=$2
    shift
    shift
    run "$bin/$name" "$@"
    fails 2 "$name" "$name $*"
    err_has "$expected" "$name $*: says '$expected'"
    err_has "try '$name --help'" "$name $*: points at --help"
}

misuse "did you mean '--output'" spin-import --ouput x
misuse "unknown option '--zzz'" spin-import --zzz
misuse "unknown option '-x'" spin-import -x
misuse "INPUT is missing" spin-import
misuse "unexpected argument" spin-import --info a b
misuse "--output is missing" spin-import a
misuse "needs a value" spin-import a -o
misuse "needs a value" spin-import a --output --force
misuse "takes no value" spin-import --info=yes a
misuse "did you mean 'd3dgs'" spin-import --from d3dg a --info
misuse "unknown importer 'nonsense'" spin-import --from nonsense a --info
misuse "not 'x'" spin-import a --info --frames x
misuse "not '0'" spin-import a --info --frames 0
misuse "not '5:5'" spin-import a --info --range 5:5
misuse "not '1:2:3:4'" spin-import a --info --range 1:2:3:4
misuse "not '0,,1'" spin-import a --info --times 0,,1
misuse "not '0,nan'" spin-import a --info --times 0,nan
misuse "exclude each other" spin-import a --info --times 0,1 --frames 2
misuse "not 'sideways'" spin-import a --info --pair sideways
misuse "exclude each other: --info writes nothing" spin-import a --info -o b.spin
misuse "views requires --info" spin-import a -o b.spin --views
misuse "full requires --info" spin-import a -o b.spin --full
misuse "'panoptic' reads data sets, not runs: use --data-from" spin-import a --info --from panoptic
misuse "unknown data set format 'nonsense'" spin-import a --info --data-from nonsense
misuse "unknown data set format 'ply'" spin-import a --info --data-from ply
misuse "list takes no INPUT" spin-import --list a

misuse "IN.spin is missing" spin-retrain
misuse "--output is missing" spin-retrain a
misuse "not '1e3'" spin-retrain a -o b --iterations 1e3
misuse "not '99999999999'" spin-retrain a -o b --iterations 99999999999
misuse "not '-1'" spin-retrain a -o b --seed -1
misuse "from 0 to 9007199254740991, not '9007199254740992'" spin-retrain a -o b --seed 9007199254740992
misuse "not '1.5'" spin-retrain a -o b --lambda-dssim 1.5
misuse "not 'tpu'" spin-retrain a -o b --device tpu
misuse "not '1,2'" spin-retrain a -o b --finest-resolution 1,2
misuse "not '4.5'" spin-retrain a -o b --finest-resolution 4.5
misuse "not '65537'" spin-retrain a -o b --finest-resolution 65537
misuse "not '0,0,0,1'" spin-retrain a -o b --scene-normalise 0,0,0,1
misuse "not '1,2,3'" spin-retrain a -o b --background 1,2,3
misuse "not '0,0,1,1'" spin-retrain a -o b --background 0,0,1,1
misuse "not 'big'" spin-retrain a -o b --preset big
misuse "not '-1'" spin-retrain a -o b --refine -1
misuse "not 'both'" spin-retrain a -o b --method both
misuse "not 'nowhere'" spin-retrain a -o b --refine-start nowhere
misuse "more than --batch" spin-retrain a -o b --batch 2 --views-per-frame 3

misuse "IN.spin is missing" spin-eval
misuse "not 'half'" spin-eval a --split half
misuse "images and --log cannot be combined with" spin-eval a --table md --images b
misuse "images and --log cannot be combined with" spin-eval a --figures b --log c
misuse "images and --log cannot be combined with" spin-eval a b --log c
misuse "table and --json exclude each other" spin-eval a b --table csv --json
misuse "list takes no IN.spin" spin-export --list a
misuse "RUN is missing" spin4d --force
misuse "IN.spin is missing" spin-export --to ply
misuse "with --to" spin-export a -o b
misuse "no exporter writes '.gif'; the nearest format is .mp4" spin-export a -o clip.gif
misuse "the nearest format is a folder with --to images" spin-export a -o b.d/a.png
misuse "no exporter writes '.sogs'; the nearest format is .sog" spin-export a -o clip.sogs
misuse "with --to" spin-export a -o a.d/clip
misuse "--output is missing" spin-export a --to ply
misuse "unknown exporter 'nonsense'" spin-export a --to nonsense -o b
misuse "the nearest format is a folder with --to images --format exr" spin-export a -o a.exr
misuse "the nearest format is a bundle, which spin-import and spin-retrain write" spin-export a -o a.spin
misuse "did you mean 'video'" spin-export a --to mp4 -o b
misuse "did you mean 'video'" spin-export a --to MOV -o b
misuse "did you mean 'images'" spin-export a --to png -o b
misuse "did you mean 'ply'" spin-export a --to pli -o b
misuse "unknown importer 'mp4'; --list" spin-import --from mp4 a --info
misuse "give the folder that contains them" spin-import a.ply b.ply -o c.spin
misuse "'retain' is neither a run nor a command, did you mean 'retrain'" spin4d retain a.spin -o b.spin
misuse "did you mean 'import'" spin4d imprt a
run "$bin/spin4d" help
is "$code $(head -n 1 "$work/out" | cut -c1-7)" "0 spin4d:" "spin4d help"
run "$bin/spin4d" help import
is "$code $(head -n 1 "$work/out" | cut -c1-12)" "0 spin-import:" "spin4d help import"
run "$bin/spin4d" version
is "$code $(cut -c1-7 "$work/out")" "0 spin4d " "spin4d version"

# An alias of another format's name.
misnamed() {
    expected=$1
    shift
    # shellcheck disable=SC2086,SC2048
    run "$bin/"$*
    is "$code" 2 "$*: exit code 2"
    err_has "$expected" "$*: says '$expected'"
    nothing_at "$work/new" "$*: nothing is written"
}
run "$bin/spin-import" -q "$clip" --data "$clip" --range 0:1 -o "$work/One.SPIN"
is "$code" 0 "*.SPIN is a bundle"
misnamed "named \*.spin; to write .ply, use spin-export" "spin-import $clip -o $work/new.ply"
misnamed "named \*.spin; to write a folder with --to images, use spin-export" "spin-import $clip -o $work/new.png"
misnamed "named \*.spin; to write .HTML, use spin-export" "spin-retrain $work/One.SPIN -o $work/new.HTML"
misnamed "a browser prints the page as PDF" "spin-eval $work/One.SPIN --report $work/new.pdf"
misnamed "a browser prints the page as PDF" "spin-eval $work/One.SPIN $work/One.SPIN --report $work/new.pdf"
misnamed "is that of exporter 'html', but --to is 'ply'" "spin-export $work/One.SPIN --to ply -o $work/new.html"
misnamed "is that of exporter 'ply', but --to is 'html'" "spin4d $work/One.SPIN --no-retrain --to html -o $work/new.ply"
misnamed "no exporter for the extension of '.*new.mov': the nearest format is .mp4" "spin4d $work/One.SPIN --no-retrain -o $work/new.mov"

# A preset implied by other options.
implies() {
    preset=$1
    shift
    run "$bin/spin-retrain" "$work/One.SPIN" --dry-run --json "$@"
    is "$code $(member preset)" "0 $preset" "preset implied by '$*'"
}
implies quick
implies quick --method tracks --refine 0
implies paper --refine 1
implies paper --method network
implies paper --method frames
implies best --method frames --preset best

# Names of formats and file extensions are matched without case.
run "$bin/spin-export" "$work/One.SPIN" -o "$work/A.PLY" --json
is "$code $(member to)" "0 ply" "-o A.PLY"
run "$bin/spin-export" "$work/One.SPIN" --to FTGS-or-PLY -o "$work/a"
is "$code" 2 "a name that is none"
run "$bin/spin-export" "$work/One.SPIN" --to Compressed-PLY -o "$work/A.compressed.Ply" --json
is "$code $(member to)" "0 compressed-ply" "--to Compressed-PLY -o A.compressed.Ply"
[ -f "$work/A.compressed.Ply" ]
ok $? "which is a file"
misnamed "is that of exporter 'ply', but --to is 'compressed-ply'" "spin-export $work/One.SPIN --to compressed-ply -o $work/new.ply"
run "$bin/spin4d" "$work/One.SPIN" --no-retrain -o "$work/T.HTML" --json
is "$code $(member to)" "0 html" "spin4d -o T.HTML"
run "$bin/spin-import" --from PLY "$work/A.PLY" --info --json
is "$code $(member from)" "0 ply" "--from PLY"
run "$bin/spin-import" -q "$clip" --data "$clip" --data-from PANOPTIC --range 0:1 -o "$work/two.spin"
run "$bin/spin-import" --info "$work/two.spin" --json
is "$code $(member data_from)" "0 panoptic" "--data-from PANOPTIC"

done_testing
