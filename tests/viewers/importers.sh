# shellcheck shell=sh
# Shows a frame of every importer's run in the viewers; run.sh sources it for `make test-viewers
# IMPORTERS=1`, or IMPORTERS='realtime4dgs points' for some of them.
#
# The run is imported into a bundle and exported as PLY; every viewer draws its middle frame, which
# is compared with the reference for the camera that the bench fits to it. A run without attributes
# cannot be exported before it is retrained: 20 iterations on one substitute image, with six
# synthetic cameras, add them. The result shows that all positions arrive and that the file is
# valid, and nothing about image quality.
. "$root/tests/runs.sh"

# Adds attributes by 20 iterations. The cameras are far enough away to see everything.
learn() { # NAME IN LAST_TIME
    rm -rf "$1-data"
    mkdir -p "$1-data"
    stand_in "$1-data" "$root/fixtures/court-mini/ims/0/000008.jpg"
    cameras "$1-data" 5 "$3"
    import "$1-bare" "$2" --data "$1-data" --data-from transforms:ending=.jpg || return
    rm -f "$1.spin"
    "$bin/spin-retrain" -q "$1-bare.spin" -o "$1.spin" --preset paper --device cpu --iterations 20 --hash-log2 14 \
        --sh-degree 1 --scene-normalise auto ||
        { fail "$1 does not retrain"; return 1; }
}

# A cloud of plain points with colours: a rotating helix, in three frames.
plain_points() { # FOLDER
    rm -rf "$1"
    mkdir -p "$1"
    for frame in 0 1 2; do
        awk -v turn="$frame" 'BEGIN {
            print "ply\nformat ascii 1.0\nelement vertex 400"
            print "property float x\nproperty float y\nproperty float z"
            print "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header"
            for (i = 0; i < 400; i++) {
                a = i * 0.06 + turn
                printf "%.6g %.6g %.6g %d %d %d\n", cos(a), i / 200 - 1, sin(a), i % 256, 128, 255 - i % 256
            }
        }' >"$1/frame_$frame.ply"
    done
}

# Shows NAME.spin in the viewers, and adds its row of the table in tests/viewers/measured.md to
# importers.rows.
draw() { # NAME IMPORTER RUN DRAWN
    rm -rf "$1-ply"
    "$bin/spin-export" -q "$1.spin" --to ply -o "$1-ply" || { fail "$1.spin does not export"; return; }
    middle=$(($(ls "$1-ply"/*.ply | wc -l) / 2 + 1))
    node "$here/bench.mjs" --out "$1-shots" "$(ls "$1-ply"/*.ply | sed -n ${middle}p)" ||
        fail "$1: a viewer disagrees"
    node -p '
        const [file, importer, run, drawn] = process.argv.slice(1);
        const job = JSON.parse(require("fs").readFileSync(file)).jobs[0];
        const row = job.viewers.map((v) => (v.problems.length ? "failed" : v.psnr[0].toFixed(1)));
        `| \`${importer}\` | ${run} | ${drawn} | ${row.join(" | ")} |`' \
        "$1-shots/report.json" "$2" "$3" "$4" >>importers.rows
}

show_importer() { # NAME
    path=$(run_of "$1")
    [ -n "$path" ] || { fail "$1: tests/runs.sh has no run of it"; return; }
    in=$large/$path
    [ -d "$in" ] || in=$root/fixtures/$path
    [ -d "$in" ] || { echo "viewers: skipped: no run '$path' of $1 in $large"; return; }
    echo
    echo "== $1: $path"
    drawn='as imported'
    info=$("$bin/spin-import" --info --json "$in") || { fail "$1: no --info of $in"; return; }
    frames=
    echo "$info" | grep -q '"continuous": true' && frames='--frames 3'
    if ! echo "$info" | grep -q '"logit_opacities"'; then
        drawn='positions, retrained'
        learn "run-$1" "$in" 1 || return
    else
        # shellcheck disable=SC2086
        import "run-$1" "$in" $frames || return
    fi
    draw "run-$1" "$1" "$path" "$drawn"
}

show_points() {
    echo
    echo "== plain points"
    plain_points points
    learn run-points points 2 && draw run-points ply 'plain points' 'positions, retrained'
}

show_importers() {
    rm -f importers.rows
    names=$IMPORTERS
    [ "$names" = 1 ] && names="$(importers_of_runs "$bin") points"
    for name in $names; do
        if [ "$name" = points ]; then
            show_points
        else
            show_importer "$name"
        fi
    done
    echo
    cat importers.rows
}
