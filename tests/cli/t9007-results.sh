#!/bin/sh
# K: results long
# The rows of docs/results.md and the figures of docs/tutorial.md that anyone can reproduce from the
# bundled clip. On the SIMD path they were measured with, which docs/pictures.txt names, they agree
# to the last digit; on others small differences grow as large as those between seeds. RESULTS=all,
# which `make results` sets, runs every seed and prints the measurements.
. tests/cli/lib.sh

run "$bin/spin-import" fixtures/court-mini --data fixtures/court-mini -o "$work/mini.spin"
is "$code" 0 "imports"

# The measured values of the images that `make pictures` makes for the documents.
shown() { sed -n "s/^$1 //p" docs/pictures.txt; }

# like GOT WANT SLACK NAME: equal when rounded to the digits of WANT on that SIMD path, otherwise
# within SLACK
like() {
    got=$(awk -v got="$1" -v want="$2" -v slack="$3" -v same="$same" 'BEGIN {
        digits = want ~ /\./ ? length(want) - index(want, ".") : 0
        far = got - want
        print (same ? sprintf("%.*f", digits, got) + 0 == want + 0 : far < slack && far > -slack) ? want : got }')
    is "$got" "$2" "$4"
}

# figure EXPRESSION: a value of j, the JSON that the last run printed
figure() { python3 -c 'import json, sys
j = json.load(open(sys.argv[1]))
print(eval(sys.argv[2]))' "$work/out" "$1"; }

run "$bin/spin-eval" "$work/mini.spin" --dynamic images --json
same=1
set -- $(sed -n 's/^| court-mini, as imported | | | | \([^ ]*\) | \([^ ]*\) | \([^ ]*\) |$/\1 \2 \3/p' docs/results.md)
like "$(figure 'j["psnr"]')" "$1" 0.01 "as imported: PSNR"
like "$(figure 'j["ssim"]')" "$2" 0.001 "SSIM"
like "$(figure 'j["psnr_dynamic"]')" "$3" 0.01 "in dynamic regions"
grep -q "reach $1 dB" docs/tutorial.md
ok $? "the tutorial says so too"

for seed in 0 ${RESULTS:+1 2}; do
    run "$bin/spin-retrain" "$work/mini.spin" -o "$work/better.spin" --seed "$seed" --threads 1 --force -v
    is "$code" 0 "seed $seed"
    same=$(grep -c "cpu ($(shown path)," "$work/err")
    [ "$same" = 0 ] && same=
    [ $seed = 0 ] && cp "$work/err" "$work/retrained"
    run "$bin/spin-eval" "$work/better.spin" --dynamic images --json
    [ $seed = 0 ] && row='court-mini | ' || row=" | \`--seed $seed\`"
    set -- $(sed -n "s/^|* *$row *| [^ ]* | \([^ ]*\) MB | \([^ ]*\) | \([^ ]*\) | \([^ ]*\) |$/\1 \2 \3 \4/p" docs/results.md | tr -d '*')
    is "$#" 4 "seed $seed has a row"
    like "$(figure 'j["storage"]["file"] / 1e6')" "$1" 0.3 "its storage"
    like "$(figure 'j["psnr"]')" "$2" 1.5 "its PSNR"
    like "$(figure 'j["ssim"]')" "$3" 0.06 "its SSIM"
    like "$(figure 'j["psnr_dynamic"]')" "$4" 1.5 "its PSNR in dynamic regions"
    [ -z "$RESULTS" ] || figure '"# seed %s: %.2f MB, %.3f dB, %.4f, dynamic %.3f dB" % ("'$seed'", j["storage"]["file"] / 1e6, j["psnr"], j["ssim"], j["psnr_dynamic"])'
    [ $seed = 0 ] || continue
    tutorial=$(sed 's/$/ /' docs/tutorial.md | tr -d '\n')
    want=$(echo "$tutorial" | sed -n 's/.*views now have \([0-9.]*\) dB.*/\1/p')
    like "$(figure 'j["psnr"]')" "$want" 1.5 "the tutorial's"

    # The images of the documents, and the text beside them.
    like "$(figure 'j["psnr"]')" "$(shown psnr)" 1.5 "the report's picture: PSNR"
    like "$(figure 'j["ssim"]')" "$(shown ssim)" 0.06 "SSIM"
    like "$(figure 'j["psnr_dynamic"]')" "$(shown psnr-dynamic)" 1.5 "in dynamic regions"
    like "$(figure '[c["psnr"] for c in j["cameras"] if c["id"] == 0][0]')" "$(shown psnr-camera-0)" 1.5 "of camera 0"
    like "$(figure 'j["storage"]["file"] / 1e6')" "$(shown megabytes)" 0.3 "storage"
    grep -q "^preset quick: $(shown iterations) iterations, 6 frames" "$work/retrained"
    ok $? "as many iterations"
    echo "$tutorial" | grep -q "reach $(shown psnr-before) dB .*Camera 0 is worse, with $(shown psnr-camera-0) dB"
    ok $? "the tutorial has the same of the import and of camera 0"
    same=1
    like "$(shown psnr)" "$want" 0 "and of the retrained clip"
    for when in psnr_before psnr_after; do
        got=$(sed -n "s/^$when *//p" tests/clean-debian.md)
        [ $when = psnr_after ] && want=$(shown psnr) || want=$(shown psnr-before)
        like "$got" "$want" 0 "so has the transcript: $when"
    done
    grep -q "^preset quick: $(shown iterations) iterations, 6 frames" tests/clean-debian.md
    ok $? "and the iterations"
done
done_testing
