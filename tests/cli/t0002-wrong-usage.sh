#!/bin/sh
# Asked wrongly: exit code 2 and one line that says what and points at --help.
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
misuse "with --output" spin-import a
misuse "needs a value" spin-import a -o
misuse "needs a value" spin-import a --output --force
misuse "takes no value" spin-import --info=yes a
misuse "did you mean 'd3dgs'" spin-import --from d3dg a --info
misuse "no importer is called" spin-import --from nonsense a --info
misuse "not 'x'" spin-import a --info --frames x
misuse "not '0'" spin-import a --info --frames 0
misuse "not '5:5'" spin-import a --info --range 5:5
misuse "not '1:2:3:4'" spin-import a --info --range 1:2:3:4
misuse "not '0,,1'" spin-import a --info --times 0,,1
misuse "not '0,nan'" spin-import a --info --times 0,nan
misuse "exclude each other" spin-import a --info --times 0,1 --frames 2
misuse "not 'sideways'" spin-import a --info --pair sideways

misuse "IN.spin is missing" spin-retrain
misuse "with --output" spin-retrain a
misuse "not '1e3'" spin-retrain a -o b --iterations 1e3
misuse "not '99999999999'" spin-retrain a -o b --iterations 99999999999
misuse "not '-1'" spin-retrain a -o b --seed -1
misuse "from 0 to 9007199254740991, not '9007199254740992'" spin-retrain a -o b --seed 9007199254740992
misuse "not '1.5'" spin-retrain a -o b --lambda-dssim 1.5
misuse "not 'tpu'" spin-retrain a -o b --device tpu
misuse "not '1,2'" spin-retrain a -o b --base-resolution 1,2
misuse "not '4.5'" spin-retrain a -o b --base-resolution 4.5
misuse "not '65537'" spin-retrain a -o b --finest-resolution 65537
misuse "not 'big'" spin-retrain a -o b --init-log-scale big
misuse "not '0,0,0,-1'" spin-retrain a -o b --scene-normalise 0,0,0,-1
misuse "not '1,2,3'" spin-retrain a -o b --background 1,2,3
misuse "not '0,0,1,1'" spin-retrain a -o b --background 0,0,1,1
misuse "not 'big'" spin-retrain a -o b --preset big
misuse "not '-1'" spin-retrain a -o b --refine -1
misuse "not 'both'" spin-retrain a -o b --method both
misuse "not 'nowhere'" spin-retrain a -o b --refine-start nowhere
misuse "more than --batch" spin-retrain a -o b --batch 2 --views-per-frame 3

misuse "IN.spin is missing" spin-eval
misuse "not 'half'" spin-eval a --split half
misuse "IN.spin is missing" spin-export --to ply
misuse "with --to" spin-export a -o b
misuse "no exporter writes '.gif'; the nearest is .mp4" spin-export a -o clip.gif
misuse "the nearest is a folder with --to images" spin-export a -o b.d/a.png
misuse "no exporter writes '.sogs'; the nearest is .sog" spin-export a -o clip.sogs
misuse "with --to" spin-export a -o a.d/clip
misuse "with --output" spin-export a --to ply
misuse "no exporter is called" spin-export a --to nonsense -o b

done_testing
