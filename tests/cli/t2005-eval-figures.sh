#!/bin/sh
# K: eval figures
# The figures that spin-eval prints agree with each other: speed, storage, means of frames and cameras.
. tests/cli/lib.sh

in=$work/in.spin
few='--device cpu --scale 0.1 --range 0:3'
run "$bin/spin-import" --from d3dgs $clip --data $clip -o "$in"
is "$code" 0 "imports the clip"
# shellcheck disable=SC2086
run "$bin/spin-retrain" "$in" -o "$work/net.spin" $few --levels 4 --hash-log2 12 --hidden 16 \
    --finest-resolution 32 --iterations 2 --residual points
is "$code" 0 "a network"
# shellcheck disable=SC2086
run "$bin/spin-retrain" "$in" -o "$work/explicit.spin" $few --method explicit --refine 2
is "$code" 0 "explicit frames"

# A number anywhere in the last JSON.
number() { sed -n 's/^ *"'"$1"'": \([-0-9.e+]*\),*$/\1/p' "$work/out" | head -n 1; }
# The same to nine digits.
same() { # GOT WANT NAME
    awk -v a="$1" -v b="$2" 'BEGIN { d = a - b; d = d < 0 ? -d : d; exit !(a != "" && b != "" && d <= 1e-9 * (b < 0 ? -b : b)) }'
    ok $? "$3"
}
# In each list every mean is that of the views with this key. LIST KEY VIEWS_KEY
means() {
    awk -v list="$1" -v key="$2" -v of="$3" '
        BEGIN { n = 0 }
        /^  "[a-z]*": \[/ { gsub(/[^a-z]/, "", $1); section = $1 }
        /^    }/ && section == list { id[n] = k; mean[n] = p; ssim[n++] = s }
        /^    }/ && section == "views" { sum[k2] += p; sum_ssim[k2] += s; count[k2]++ }
        { gsub(/[",]/, "") }
        $1 == key ":" { k = $2 }
        $1 == of ":" { k2 = $2 }
        $1 == "psnr:" { p = $2 }
        $1 == "ssim:" { s = $2 }
        END {
            for (i = 0; i < n; i++) {
                d = mean[i] - sum[id[i]] / count[id[i]]
                e = ssim[i] - sum_ssim[id[i]] / count[id[i]]
                if (count[id[i]] < 1 || d * d > 1e-16 || e * e > 1e-16) exit 1
            }
            exit n < 2
        }' "$work/out"
    ok $? "$4"
}

run "$bin/spin-eval" "$work/net.spin" --scale 0.1 --split all --json
is "$code" 0 "measures the network"
same "$(number fps)" "$(awk -v a="$(number seconds_decode)" -v b="$(number seconds_draw)" \
    'BEGIN { printf "%.15g", 1 / (a + b) }')" "pictures a second, with decoding"
same "$(number fps_draw)" "$(awk -v b="$(number seconds_draw)" 'BEGIN { printf "%.15g", 1 / b }')" "and without"
same "$(number measured)" "$(($(number positions) + $(number table) + $(number heads)))" \
    "a network is its positions, its table and its heads"
same "$(number measured_per_frame)" "$(awk -v a="$(number measured)" 'BEGIN { printf "%.15g", a / 3 }')" \
    "a frame's part of it"
means frames frame frame "a frame's line is the mean of its views"
means cameras id camera "a camera's line is the mean of its views"
greater "$(number file)" "$(($(number source) + $(number measured)))"
ok $? "the file has the source besides"

run "$bin/spin-eval" "$work/net.spin" --scale 0.1
speed=$(sed -n 's/^speed *\([0-9.]*\) pictures a second with decoding, \([0-9.]*\) without$/\1 \2/p' "$work/out")
greater "${speed#* }" "${speed% *}"
ok $? "in words: decoding takes time ($speed)"
run "$bin/spin-eval" "$work/net.spin" --scale 0.1 --source --json
same "$(number measured)" "$(number source)" "with --source it is the source's"
run "$bin/spin-eval" "$work/explicit.spin" --scale 0.1 --json
same "$(number measured)" "$(number refined)" "explicit frames are themselves"
[ "$(number refined)" != "$(number source)" ] && [ "$(number table)" = 0 ]
ok $? "and nothing else"
done_testing
