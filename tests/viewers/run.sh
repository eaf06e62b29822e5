#!/bin/sh
# run.sh BIN_DIR [short]: exports samples in every format and opens them in real viewers.
# run.sh BIN_DIR speed [OPTION...]: images per second of the page beside SuperSplat's viewer
# (speed.mjs).
#
# Samples: a short retraining of the bundled clip; the bundled Dynamic 3D Gaussians run; if the
# large fixtures are available (SPIN_FIXTURES, else ../shared/fixtures), a 4DGaussians and a
# Realtime-4DGS run; and the bundle named in BUNDLE, with the camera in CAMERA (options of
# bench.mjs) and the frames in RANGE (A:B:STEP). `short` uses only the first sample, in small
# images. IMPORTERS=1 uses a PLY of every importer's run instead (importers.sh).
#
# If Python has NumPy, the frames of BUNDLE are also written by NumPy and by splat-transform. Where
# these known-good files score below the bench's limit in a viewer, their score is the limit, since
# viewers differ in how they draw splats that reach beside and behind the camera.
#
# If Node, Chromium, or the packages and a network to fetch them are missing, everything is skipped
# with a message that names what is missing.
bin=$(cd "${1:-build/release/bin}" && pwd) || exit 1
short=${2:-}
root=$(cd "$(dirname "$0")/../.." && pwd)
here=$root/tests/viewers
out=$root/build/viewers
large=${SPIN_FIXTURES:-$root/../shared/fixtures}
large=$(readlink -f "$large")
bundle=${BUNDLE:+$(readlink -f "$BUNDLE")}
failed=0

skip() {
    echo "viewers: skipped: $*"
    exit 0
}
fail() {
    echo "viewers: $*" >&2
    failed=1
}

# ---- Requirements --------------------------------------------------------------------------------

command -v node >/dev/null 2>&1 || skip "no Node (Debian: nodejs npm)"
[ "$(node -p 'process.versions.node.split(".")[0]')" -ge 20 ] ||
    skip "Node $(node --version) is older than 20"
CHROMIUM=${CHROMIUM:-$(command -v chromium || command -v chromium-browser)}
[ -x "$CHROMIUM" ] || skip "no Chromium (Debian: chromium)"
export CHROMIUM

if [ ! -d "$here/node_modules/tinyusdz" ] || [ ! -d "$here/node_modules/@playcanvas/supersplat-viewer" ]; then
    command -v npm >/dev/null 2>&1 || skip "no npm (Debian: npm)"
    echo "viewers: fetching the viewers' packages (400 MB, once)"
    (cd "$here" && timeout 120 npm ci --ignore-scripts --no-audit --no-fund \
        --fetch-retries=1 --fetch-timeout=20000 >"$root/build/viewers-npm.log" 2>&1) || {
        rm -rf "$here/node_modules"
        skip "npm ci failed, no network? (build/viewers-npm.log)"
    }
fi

# ---- Samples -------------------------------------------------------------------------------------

# export_all SAMPLE: exports SAMPLE.spin in every format, to folders of SAMPLE/.
export_all() {
    range=
    [ -n "${RANGE:-}" ] && [ "$1.spin" = "$(basename "$bundle")" ] && range="--range $RANGE"
    rm -rf "$1"
    mkdir -p "$1"
    for format in ply compressed-ply sog spz splat gltf; do
        # shellcheck disable=SC2086
        "$bin/spin-export" -q $range "$1.spin" --to $format -o "$1/$format" ||
            { fail "$1.spin does not export to $format"; return 1; }
    done
    # shellcheck disable=SC2086
    "$bin/spin-export" -q $range "$1.spin" --to spz --spz-version 3 -o "$1/spz3" ||
        { fail "$1.spin does not export to SPZ 3"; return 1; }
    # shellcheck disable=SC2086
    "$bin/spin-export" -q $range "$1.spin" --to gltf -o "$1/clip.glb" ||
        { fail "$1.spin does not export to one GLB"; return 1; }
}

# use_page SAMPLE [OPTION...]: exports the clip as one page, opens it from the disk and clicks
# through it. Its first image is compared with the PLY of the same frame, at the page's default SH
# degree.
use_page() {
    sample=$1
    shift
    # shellcheck disable=SC2086
    "$bin/spin-export" -q $range "$sample.spin" --to html -o "$sample/page.html" &&
        "$bin/spin-export" -q $range "$sample.spin" --to ply --sh 1 -o "$sample/truth" ||
        { fail "$sample.spin does not export to html"; return 1; }
    echo "page.html"
    node "$here/page.mjs" "$@" --out "$sample-shots" --truth "$sample/truth" "$sample/page.html" ||
        fail "$sample: the page does not do what it should"
    case $* in *--size*) return ;; esac
    # On a phone, and as a page and its data from a server.
    # shellcheck disable=SC2086
    "$bin/spin-export" -q $range "$sample.spin" --to html --split -o "$sample/served.html" ||
        { fail "$sample.spin does not export to html --split"; return 1; }
    echo "served.html"
    node "$here/page.mjs" --picture-only --size 390,844 --out "$sample-shots" --truth "$sample/truth" \
        "$sample/served.html" || fail "$sample: the page does not do what it should on a phone"
    node "$here/page-decode.mjs" --like "$sample/truth" "$sample/page.html" || fail "$sample: the page's worker fails"
}

# A Python that has NumPy.
python() {
    for p in python3 /usr/bin/python3; do
        "$p" -c 'import numpy' 2>/dev/null && { echo "$p"; return; }
    done
}

# calibrate SAMPLE OPTION...: the frames of SAMPLE/ply written by other programs to SAMPLE-known;
# their scores in the viewers go to SAMPLE-known-shots/report.json.
calibrate() {
    sample=$1
    shift
    python=$(python)
    [ -n "$python" ] || { echo "viewers: skipped: known-good files of $sample: no NumPy"; return 1; }
    numbers=$(cd "$sample/ply" && ls frame_*.ply | sed 's/frame_0*\([0-9].*\)\.ply/\1/')
    rm -rf "$sample-known"
    # shellcheck disable=SC2086
    "$python" "$here/known-good.py" "$sample.spin" "$sample-known" $numbers || return 1
    mkdir "$sample-known/compressed-ply" "$sample-known/gltf"
    for file in "$sample-known"/ply/*.ply; do
        name=$(basename "$file" .ply)
        for to in compressed-ply/$name.compressed.ply gltf/$name.glb; do
            node "$here/node_modules/@playcanvas/splat-transform/bin/cli.mjs" -q "$file" \
                "$sample-known/$to" || return 1
        done
    done
    echo "-- $sample, known-good files by NumPy and splat-transform"
    # shellcheck disable=SC2086
    node "$here/bench.mjs" $size --out "$sample-known-shots" "$@" --calibrate "$sample-known/ply" \
        "$sample-known/compressed-ply" "$sample-known/spz" "$sample-known/splat" "$sample-known/gltf"
}

# show SAMPLE [OPTION...]: shows every export in every viewer that opens it.
show() {
    sample=$1
    shift
    echo
    echo "== $sample"
    export_all "$sample" || return
    known=
    if [ "$sample.spin" = "$(basename "$bundle")" ]; then
        calibrate "$sample" "$@" && known="--known $sample-known-shots/report.json"
        echo "-- $sample"
    fi
    # shellcheck disable=SC2086
    node "$here/bench.mjs" --expect-motion $size $known --out "$sample-shots" "$@" "$sample/ply" \
        "$sample/compressed-ply" "$sample/sog" "$sample/spz" "$sample/spz3" "$sample/splat" "$sample/gltf" "$sample/clip.glb" ||
        fail "$sample: a viewer disagrees"
    use_page "$sample"
}

# import SAMPLE OPTION...: imports to SAMPLE.spin
import() {
    sample=$1
    shift
    rm -f "$sample.spin"
    "$bin/spin-import" -q "$@" -o "$sample.spin" || { fail "$sample does not import"; return 1; }
}

# still_4d SAMPLE: compares its 4D splats as TSOG and .sogst, each at its own time, with
# splat-transform.
still_4d() {
    python=$(python)
    [ -n "$python" ] || { echo "viewers: skipped: 4D splats of $1: no NumPy"; return; }
    for to in tsog sogst; do
        segment=
        [ $to = sogst ] && segment='--segment 0'
        # shellcheck disable=SC2086
        "$bin/spin-export" -q --force --fps 30 $segment "$1.spin" -o "$1.$to" &&
            "$python" "$here/sog-4d.py" "$bin" "$here/node_modules/@playcanvas/splat-transform/bin/cli.mjs" \
                "$1.$to" || fail "$1.$to: splat-transform reads another"
    done
}

mkdir -p "$out" && cd "$out" || exit 1
if [ "$short" = speed ]; then
    shift 2
    exec node "$here/speed.mjs" --out speed "$@" "$bin"
fi

size='--max-frames 3'
[ -n "$short" ] && size='--max-frames 2 --size 256'

matrix=$(node "$here/bench.mjs" --matrix)
[ "$(sed -n '/^<!-- matrix -->$/,/^$/p' "$root/docs/viewers.md" | grep '^|')" = "$matrix" ] ||
    fail "docs/viewers.md: the table is not what 'node tests/viewers/bench.mjs --matrix' prints"

if [ -n "${IMPORTERS:-}" ]; then
    . "$here/importers.sh"
    show_importers
    [ $failed = 0 ] && echo "viewers: every frame is drawn as it should be (pictures in build/viewers/run-*-shots)"
    exit $failed
fi

if [ -z "$short" ]; then
    echo "== the bench itself"
    node "$here/bench.mjs" --out selftest selftest || fail "the bench's own samples fail"
fi

clip=$root/fixtures/court-mini
import mini-source --from d3dgs "$clip" --data "$clip" &&
    rm -f mini.spin &&
    "$bin/spin-retrain" -q mini-source.spin -o mini.spin --preset paper --device cpu --iterations 300 --levels 8 \
        --hash-log2 15 --finest-resolution 128,128,128,8 --sh-degree 1 \
        --head-lr-factor 4 --residual points &&
    show mini --eye 2.84,-1.44,0 --target 0,-0.95,0 --fovy 41 &&
    echo "USD and GLB in three.js and TinyUSDZ" &&
    { node "$here/readers.mjs" "$bin" mini.spin mini-readers || fail "mini: a reader gets other values"; } &&
    echo "a page of another site" &&
    { node "$here/embed.mjs" "$bin/../player" mini/page.html mini-shots || fail "mini: a page of another site does not hold the clip"; } &&
    echo "the pages beside docs/how-to/viewers.md" &&
    { node "$here/snippets.mjs" mini mini-shots || fail "mini: a page of the documents does not show the clip"; } &&
    echo "one frame as streamed SOG" &&
    "$bin/spin-export" -q --force mini.spin --range 0:1 --to streamed-sog -o mini-streamed &&
    { node "$here/bench.mjs" $size --viewers playcanvas --out mini-shots --eye 2.84,-1.44,0 --target 0,-0.95,0 --fovy 41 \
        mini-streamed/lod-meta.json || fail "mini: the streamed SOG is not drawn as it should be"; }

# Antialiased splats: the page draws them as the PLY declares. The splats and the window are small,
# so that antialiasing matters: without it the image would still agree to 38 dB.
rm -rf anti anti.spin
echo
echo "== anti"
if "$bin/spin-retrain" -q mini-source.spin -o anti.spin --device cpu --method frames --refine 100 \
    --densify off --antialias on; then
    mkdir -p anti && use_page anti --picture-only --size 160,100 --min-psnr 43
else
    fail "antialiased splats cannot be made"
fi

# Frames whose rows are not shared with any other frame.
echo
echo "== varied"
import varied --from ply "$root/fixtures/ply/inria_sh0_varN" && mkdir -p varied &&
    "$bin/spin-export" -q --force varied.spin --to html -o varied/page.html &&
    "$bin/spin-export" -q --force varied.spin --to ply --sh 1 -o varied/truth &&
    node "$here/page-decode.mjs" --like varied/truth varied/page.html ||
    fail "varied: the page has other splats than the frames"

# A clip whose decoded frames need more memory than the page may use, in one group of 2.9 MB: the
# first image comes early, a seek is one request, and the memory does not grow with each loop.
echo
echo "== a long clip"
rm -rf long-frames
"$bin/../tests/bench/clip" long-frames 200 40000 0 >long.log 2>&1 && import long long-frames && mkdir -p long &&
    "$bin/spin-export" -q --force --fps 30 --bound-place 2e-6 --key-every 256 --split long.spin --to html -o long/long.html &&
    node "$here/long.mjs" --seconds 20 --every 4 --first 1 --seeks 4 --most 135 --grows 25 long/long.html ||
    fail "the page of a long clip needs too many bytes, requests or too much memory"
rm -rf long-frames

echo
echo "== 4D splats"
import rot4d "$root/fixtures/realtime4dgs/rot4d_noshfs" && still_4d rot4d
echo "rot4d.sogst in <spin-clip>"
rm -rf rot4d-sogst rot4d.sogst
"$bin/spin-export" -q --fps 30 --segment 0 rot4d.spin -o rot4d.sogst && import rot4d-sogst rot4d.sogst &&
    "$bin/spin-export" -q rot4d-sogst.spin --to ply -o rot4d-sogst &&
    node "$here/sogst.mjs" "$bin/../player" rot4d.sogst rot4d-sogst rot4d-shots || fail "rot4d.sogst: <spin-clip> shows another"
# A file that is read by ranges. Without its SH, the agreement would be 33 dB.
echo "parts.sogst, of segments, in <spin-clip>"
rm -rf parts parts.sogst
python3 "$root/tests/bench/make-checkpoint.py" parts.pth 60000 plain &&
    import parts-run parts.pth --time-duration 0,0.4 && rm parts.pth &&
    "$bin/spin-export" -q --fps 30 --segment 0.1 parts-run.spin -o parts.sogst && import parts parts.sogst &&
    "$bin/spin-export" -q parts.spin --to ply -o parts && mkdir -p parts-shots &&
    node "$here/sogst.mjs" "$bin/../player" parts.sogst parts parts-shots 45 &&
    node "$here/long.mjs" --player "$bin/../player" --seconds 0 --seeks 4 --requests 2 --first 1 parts.sogst ||
    fail "parts.sogst: <spin-clip> shows another, or needs too many requests"
rm -rf parts
[ ! -d "$large/realtime4dgs/rot4d_sht" ] || { import sht "$large/realtime4dgs/rot4d_sht" && still_4d sht; }

if [ -z "$short" ]; then
    import d3dgs --from d3dgs "$root/fixtures/d3dgs/trained" && show d3dgs
    if [ -d "$large/4dgaussian/dynerf_like" ]; then
        import 4dgaussian --from 4dgaussian "$large/4dgaussian/dynerf_like/model" --frames 4 &&
            show 4dgaussian
    else
        echo "viewers: skipped: no 4DGaussians run in $large"
    fi
    if [ -d "$large/realtime4dgs/rot4d_sht" ]; then
        import realtime4dgs --from realtime4dgs "$large/realtime4dgs/rot4d_sht" --frames 4 &&
            show realtime4dgs
    else
        echo "viewers: skipped: no Realtime-4DGS run in $large"
    fi
fi
if [ -n "$bundle" ]; then
    name=$(basename "$bundle" .spin)
    ln -sf "$bundle" "$name.spin"
    # shellcheck disable=SC2086
    show "$name" ${CAMERA:-}
fi

[ $failed = 0 ] && echo "viewers: all agree (pictures in build/viewers/*-shots)"
exit $failed
