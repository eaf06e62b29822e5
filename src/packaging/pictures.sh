#!/bin/sh
# pictures.sh BIN_DIR DOCS [COURT]: generates with this build
#   1. the images of the documents, in DOCS,
#   2. DOCS/pictures.txt, the measured values of the run that these images show, and
#   3. the measured values in tests/clean-debian.md.
# Images that cannot be generated are left unchanged and listed. COURT is the folder of the clip
# "court", which some images of the gallery need. The tests t9007 and t9008 compare the values.
bin=$(realpath "${1:?usage: pictures.sh BIN_DIR DOCS [COURT]}")
docs=$(realpath "${2:?usage: pictures.sh BIN_DIR DOCS [COURT]}")
court=${3:+$(realpath "$3")}
clip=$(realpath fixtures/court-mini)
here=$(realpath "$(dirname "$0")")
transcript=$(realpath tests/clean-debian.md) tools=$(realpath tests/tools) fixtures=$(realpath fixtures)
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT
cd "$work" || exit 1

fail() { echo "pictures: $*" >&2; exit 1; }
node -e 'process.exit(parseInt(process.versions.node) < 18 ? 1 : 0)' 2>/dev/null || { echo "pictures: skipped: needs Node 18 or later (Debian: nodejs)"; exit 0; }
command -v "${CHROMIUM:=chromium}" >/dev/null || { echo "pictures: skipped: Chromium not found (Debian: chromium; or CHROMIUM=/path)"; exit 0; }
export CHROMIUM

# shot PAGE OUT WIDTH HEIGHT [READY]: takes a screenshot once the expression READY is true
shot() {
    node "$here/screenshot.mjs" "file://$work/$1" "$docs/$2" "$3" "$4" "${5:-true}" || fail "cannot create '$2'"
    echo "$2: $(wc -c <"$docs/$2") bytes"
}
# enlarge IMAGE OUT WIDTH HEIGHT [pixelated]: scales an image to this size; pixelated: unsmoothed
enlarge() {
    [ -e "$1" ] || fail "cannot create '$2': '$1' does not exist"
    echo "<body style='margin:0'><img src='$1' style='display:block;width:$3px;height:$4px;image-rendering:${5:-auto}'>" >image.html
    shot image.html "$2" "$3" "$4" 'document.images[0].naturalWidth'
}

# Run the commands of docs/tutorial.md.
"$bin/spin-import" -q "$clip" --data "$clip" -o court.spin &&
    "$bin/spin-import" -q "$clip" --data "$clip" --check-cameras check &&
    "$bin/spin-retrain" -v court.spin -o better.spin --log train.jsonl 2>train.txt &&
    "$bin/spin-export" -q better.spin -o better.html &&
    "$bin/spin-export" -q better.spin --to images --panels truth,before,after -o pictures &&
    "$bin/spin-eval" -q court.spin --json >before.json &&
    "$bin/spin-eval" -q better.spin --report report.html --log train.jsonl --json >after.json ||
    fail "a command of the tutorial failed: $(tail -n 1 train.txt)"
enlarge check/cam_15_frame_00002.png tutorial-check.jpg 480 270 pixelated
shot "better.html?frame=2&autoplay=0" tutorial-page.jpg 800 480 'window.spin4d?.state.ready'
enlarge pictures/cam_15_frame_00003.png tutorial-panels.jpg 960 180
shot report.html report.png 1030 700
node -e '
const [before, after] = ["before.json", "after.json"].map((name) => JSON.parse(require("fs").readFileSync(name)));
const [, iterations] = require("fs").readFileSync("train.txt", "utf8").match(/^preset quick: (\d+) iterations/m), [, path] = require("fs").readFileSync("train.txt", "utf8").match(/cpu \(([a-z0-9-]+)/);
console.log(`path ${path}
iterations ${iterations}
psnr-before ${before.psnr.toFixed(2)}
ssim-before ${before.ssim.toFixed(4)}
psnr ${after.psnr.toFixed(2)}
ssim ${after.ssim.toFixed(4)}
psnr-dynamic ${after.psnr_dynamic.toFixed(2)}
psnr-camera-0 ${after.cameras.find((c) => c.id === 0).psnr.toFixed(1)}
megabytes ${(after.storage.file / 1e6).toFixed(2)}`);' >"$docs/pictures.txt" || fail "cannot write the measured values to '$docs/pictures.txt'"
cat "$docs/pictures.txt"
for when in before after; do
    figure=$(node -p "JSON.parse(require('fs').readFileSync('$when.json')).psnr.toFixed(4)")
    sed -i "s/^\\(psnr_$when *\\) [0-9.]*$/\\1 $figure/" "$transcript"
done
mkdir -p own/output own/data && ln -s "$fixtures/4dgaussian/coarse_and_fine/model" own/output/balls &&
    ln -s "$fixtures/datasets/blender_mini" own/data/balls || exit 1
python3 "$tools/transcript.py" "$transcript" "A run of one's own" "$bin" own --write >said || fail "$(grep -A1 '^not ok' said)"

if [ -z "$court" ]; then
    echo "pictures: hero.webp and before-after.jpg are unchanged: they need COURT=, the folder of the clip court"
else
    "$bin/spin-import" -q "$court" --data "$court" -o big.spin && "$bin/spin-retrain" -q big.spin -o big-better.spin &&
        "$bin/spin-export" -q big-better.spin --to images --panels truth,before,after -o big ||
        fail "a command on court failed"
    enlarge big/cam_00_frame_00009.png before-after.jpg 1600 300
    if command -v ffmpeg >/dev/null; then
        sh "$here/hero.sh" "$bin" big-better.spin "$docs/hero.webp" || fail "cannot create 'hero.webp'"
    else
        echo "pictures: hero.webp is unchanged: ffmpeg not found (Debian: ffmpeg)"
    fi
fi
echo "pictures: blender-film.jpg is unchanged: its scene is made by hand"
