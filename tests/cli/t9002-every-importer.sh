#!/bin/sh
# K: long import export ply realtime4dgs 4dgaussian ed3dgs spacetimegs hybrid4dgs ex4dgs freetimegs
# retrain
# K: spz splat ksplat splat4d 4dgs sog tsog sogst gltf
# A run of every importer in the list is exported as PLY; some that are defined at any time, two of
# splat files and some of 4D splats are retrained too. To a training all splat files are frames,
# whatever their format.
. tests/cli/lib.sh
. tests/runs.sh

# Where a run is stored: in the large fixtures, or in those of the repository.
place_of() { # PATH
    if [ -e "$fixtures/$1" ]; then
        echo "$fixtures/$1"
    else
        echo "fixtures/$1"
    fi
}

# Each file has the length that its header implies, and its values are finite floats. `headers` has
# a line for each file: its rows, their bytes, and the expected size of the file.
plys_are_whole() { # NAME FILE...
    of=$1
    shift
    LC_ALL=C awk 'FNR == 1 { p = bytes = 0 } /^element vertex / { n = $3 } /^property / { p++; if ($2 != "float") exit 1 }
        { bytes += length($0) + 1 } /^end_header$/ { print n, n * p * 4, n * p * 4 + bytes; nextfile }' "$@" >"$work/headers"
    ok $? "$of: rows of floats"
    is "$(stat -L -c %s "$@")" "$(cut -d ' ' -f 3 "$work/headers")" "$of: and as many bytes"
    # Nonfinite floats have an exponent of all ones, found in hexadecimal since od prints that ten
    # times faster.
    is "$(while read -r rows bytes all; do
        tail -c "$bytes" "$1"
        shift
    done <"$work/headers" | od -An -v -t x4 | grep -c ' [7f]f[89a-f]')" 0 "$of: all of them numbers"
}

# Each frame has as many splats as in the bundle, counted by the PLY importer.
goes_out() { # BUNDLE FRAMES NAME
    run "$bin/spin-export" "$1" --to ply -o "$work/$3" --json
    is "$code" 0 "$3: goes out as PLY"
    plys_are_whole "$3" "$work/$3"/frame_*.ply
    is "$(wc -l <"$work/headers")" "$2" "$3: $2 files"
    run "$bin/spin-import" --json "$work/$3" -o "$work/$3-back.spin"
    is "$code $(member from) $(member frames)" "0 ply $2" "$3: comes back"
    sed -n '/"splats": {/,/}/s/.*"m[axein]*": \([0-9.]*\).*/\1/p' "$work/out" | cat - "$work/headers" | awk 'NF == 1 { said[++m] = $1; next }
        { n++; sum += $1; if (n == 1 || $1 < least) least = $1; if ($1 > most) most = $1 }
        END { exit !(m == 3 && said[1] == least && said[3] == most && (said[2] - sum / n) ^ 2 < 1e-6) }'
    ok $? "$3: with as many splats"
}

importers_of_runs "$bin" >"$work/names"
ok "$([ -s "$work/names" ]; echo $?)" "there are importers"
while read -r name; do
    path=$(run_of "$name")
    ok "$([ -n "$path" ]; echo $?)" "$name: this test has a run of it"
    in=$(place_of "$path")
    if [ -z "$path" ] || [ ! -e "$in" ]; then
        skip "$name" "no fixture '$path'"
        continue
    fi
    run "$bin/spin-import" "$in" -o "$work/$name.spin" --json
    if [ "$code" = 2 ]; then # it is defined at any time
        run "$bin/spin-import" "$in" -o "$work/$name.spin" --json --frames 3
    fi
    is "$code $(member from)" "0 $name" "$name: comes in, by detection"
    if [ "$(member frames)" -gt 30 ]; then # 4D splats: a few of their frames will do
        run "$bin/spin-import" "$in" -o "$work/$name.spin" --json --range 0:24:8 --force
    fi
    if ! grep -q '"logit_opacities"' "$work/out"; then
        run "$bin/spin-export" "$work/$name.spin" --to ply -o "$work/$name"
        fails 1 spin-export "$name: positions only"
        err_has spin-retrain "$name: needs spin-retrain before it goes out"
        continue
    fi
    goes_out "$work/$name.spin" "$(member frames)" "$name"
done <"$work/names"

# ---- Retrained -----------------------------------------------------------------------------------

# The network is trained on renders of the source clip; until they exist, any image serves as data
# set.
retrained() { # IMPORTER RADIUS LAST_TIME [IMPORT_OPTIONS]
    in=$(place_of "$(run_of "$1")")
    data=$work/$1-data
    if [ ! -e "$in" ]; then
        skip "$1: retrained" "no fixture '$in'"
        return
    fi
    stand_in "$data" "$clip/ims/0/000008.jpg"
    cameras "$data" "$2" "$3"
    # shellcheck disable=SC2086
    run "$bin/spin-import" "$in" --data "$data" --data-from transforms:ending=.jpg -o "$work/$1-a.spin" $4
    is "$code" 0 "$1: with cameras"
    run "$bin/spin-export" "$work/$1-a.spin" --to images --views all -o "$work/$1-images"
    is "$code" 0 "$1: is rendered"
    for camera in 0 1 2 3 4 5; do
        for frame in 0 1 2; do
            mv "$work/$1-images/cam_0${camera}_frame_0000$frame.png" "$data/images/cam0${camera}_000$frame.png"
        done
    done
    # shellcheck disable=SC2086
    run "$bin/spin-import" "$in" --data "$data" -o "$work/$1-b.spin" --json $4
    is "$code $(member frames)" "0 3" "$1: with its own pictures"
    run "$bin/spin-retrain" "$work/$1-b.spin" -o "$work/$1-c.spin" --preset paper --iterations 20 --hash-log2 14 --json --scene-normalise auto \
        --head-lr-factor 4 \
        --log "$work/$1.jsonl"
    is "$code $(member iterations)" "0 20" "$1: 20 iterations"
    greater "$(tr -d '\n' <"$work/out" | sed 's/.*"before": {[^}]*"psnr": \([0-9.]*\).*/\1/')" 40
    ok $? "$1: its own attributes are its own pictures"
    loss=$(awk -F'"loss": ' 'NF > 1 { print $2 + 0 }' "$work/$1.jsonl")
    greater "$(echo "$loss" | head -n 5 | awk '{ s += $1 } END { print s }')" \
        "$(echo "$loss" | tail -n 5 | awk '{ s += $1 } END { print s }')"
    ok $? "$1: the loss of the last five is below that of the first"
    # Trained splats are exported alike whatever their source: two methods, frames and two files of
    # 4D splats suffice.
    case $1 in realtime4dgs | 4dgaussian | spz | sogst | 4dgs) goes_out "$work/$1-c.spin" 3 "$1-retrained" ;; esac
}

retrained realtime4dgs 7 1
retrained 4dgaussian 4 1
retrained ed3dgs 8 1
retrained spacetimegs 30 0.95
retrained spz 7 2
retrained sog 7 2
retrained hybrid4dgs 7 9
retrained ex4dgs 7 2
retrained freetimegs 7 1
retrained sogst 24 2
retrained tsog 60 1
retrained splat4d 8 0.6 '--range 0:3 --pair order'
retrained 4dgs 7 3.9

# A trained clip consists of frames, even if its source is 4D splats.
if [ -f "$work/freetimegs-c.spin" ]; then
    run "$bin/spin-export" "$work/freetimegs-c.spin" -o "$work/c.sogst"
    fails 1 spin-export "a trained clip as 4D splats"
    err_has "the training produced frames: .*--method 4d.*, or export the imported 4D splats with --source" "names the option that has them"
    run "$bin/spin-export" "$work/freetimegs-c.spin" --source -o "$work/c.sogst" --check
    is "$code" 0 "which does"
    run "$bin/spin-export" "$work/freetimegs-c.spin" -o "$work/c.tsog" --check
    is "$code" 0 "TSOG takes the frames"
else
    skip "a trained clip as 4D splats" "no fixture"
fi
done_testing
