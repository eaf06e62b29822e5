#!/bin/sh
# demo.sh BIN_DIR: the whole way on the bundled clip: import, retrain on the CPU, measure, export.
# Everything lands in demo-out/. Fails when the retrained clip does not reach LEAST decibels.
bin=${1:-build/release/bin}
clip=fixtures/court-mini
out=demo-out

# What fits into a minute on two cores: a small network for a small clip. The paper's numbers are the
# defaults of spin-retrain.
ITERATIONS=1000
LEVELS=8
HASH_LOG2=15
BASE=8,8,8,2
FINEST=128,128,128,8
SH_DEGREE=1
LR_RESIDUAL=3
LEAST=20.5 # dB on held-out views; the clip as imported has 16.1, and 21.1 is usual

fail() {
    echo "demo: $*" >&2
    exit 1
}

# The first member of this name on the top level of a JSON document of ours.
number() { sed -n 's/^  "'"$1"'": \([-0-9.e+]*\),*$/\1/p' "$2"; }

rm -rf "$out"
mkdir -p "$out" || exit 1

echo "1. import a Dynamic 3D Gaussians run, with the video it was trained on"
"$bin/spin-import" --from d3dgs $clip --data $clip -o $out/court.spin || fail "the import failed"

echo
echo "2. how the imported splats look from cameras that training did not see"
"$bin/spin-eval" --source --json $out/court.spin >$out/before.json || fail "the first evaluation failed"
echo "   PSNR $(number psnr $out/before.json)  SSIM $(number ssim $out/before.json)"

echo
echo "3. retrain the attributes: $ITERATIONS iterations"
"$bin/spin-retrain" $out/court.spin -o $out/better.spin --device cpu --preset short \
    --iterations $ITERATIONS --levels $LEVELS --hash-log2 $HASH_LOG2 --base-resolution $BASE \
    --finest-resolution $FINEST --sh-degree $SH_DEGREE --lr-residual $LR_RESIDUAL ||
    fail "the retraining failed"

echo
echo "4. measure again, and write every frame as PLY for any viewer"
"$bin/spin-eval" --json $out/better.spin --images $out/images >$out/after.json ||
    fail "the second evaluation failed"
"$bin/spin-export" $out/better.spin --to ply -o $out/ply || fail "the export failed"

before=$(number psnr $out/before.json)
after=$(number psnr $out/after.json)
echo
echo "psnr_before $before"
echo "psnr_after  $after"
echo "frames      $out/ply/"
echo "pictures    $out/images/ (ground truth | before | after, every frame and held-out camera)"
awk -v a="$after" -v least=$LEAST 'BEGIN { exit !(a + 0 >= least) }' ||
    fail "the retrained clip has $after dB, not at least $LEAST"
