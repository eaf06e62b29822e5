#!/bin/sh
# K: compare table figures mask
# spin-eval of several bundles: tables, the comparison page, figures; and metrics of a subject
# alone.
. tests/cli/lib.sh

"$bin/spin-import" $clip --data $clip -o "$work/a_b.spin" -q >/dev/null
"$bin/spin-retrain" "$work/a_b.spin" -o "$work/better.spin" --iterations 30 -q >/dev/null 2>&1
views="--range 1:4 --dynamic off"

# ---- The same figures as for each bundle by itself -----------------------------------------------

for name in a_b better; do
    # shellcheck disable=SC2086
    "$bin/spin-eval" "$work/$name.spin" $views --json >"$work/$name.json" 2>/dev/null
done
# shellcheck disable=SC2086
run "$bin/spin-eval" "$work/a_b.spin" "$work/better.spin" $views --json
is "$code" 0 "two bundles"
is_json "--json"
for name in a_b better; do
    wanted=$(member psnr "$work/$name.json")
    grep -q "^ *\"psnr\": $wanted" "$work/out"
    ok $? "$name has the PSNR that it has alone: $wanted"
done
# shellcheck disable=SC2086
run "$bin/spin-eval" "$work/a_b.spin" "$work/better.spin" $views
is "$(awk '{ print $NF }' "$work/out" | tr '\n' ' ')" "run a_b better " "a row a bundle"
# shellcheck disable=SC2086
run "$bin/spin-eval" "$work/a_b.spin" "$work/better.spin" --range 1:4 --table md
psnr=$(member psnr "$work/a_b.json" | awk '{ printf "%.2f", $1 }')
out_has "^| run | PSNR | SSIM | PSNR, dynamic | file, MB | attributes, MB |\$" "--table md"
out_has "^| a_b | $psnr | " "with the figures"
# shellcheck disable=SC2086
run "$bin/spin-eval" "$work/a_b.spin" "$work/better.spin" $views --table csv
is "$(sed -n 1p "$work/out")" "run,psnr,ssim,megabytes,file_megabytes" "--table csv"
is "$(awk -F, 'END { print $5 * 1e6 }' "$work/out")" "$(wc -c <"$work/better.spin")" "and the size of the file"
is "$(awk -F, '{ print NF }' "$work/out" | sort -u)" 5 "with as many columns in every row"
out_has '^"a_b",' "and names in quotes"
# shellcheck disable=SC2086
run "$bin/spin-eval" "$work/a_b.spin" $views --table latex
is "$(head -n 1 "$work/out") $(tail -n 1 "$work/out")" '\begin{tabular}{lrrrr} \end{tabular}' "--table latex of one"
out_has '^a\\_b & [0-9.]* & 0.[0-9]* & [0-9.]* & [0-9.]* \\\\$' "with a name that LaTeX takes"

# Every cell of the tables, and names with characters that a table format escapes.
if python3 -c '' 2>/dev/null; then
    odd="$work/a|\"b\\c&%\$#_{}~^.spin"
    cp "$work/better.spin" "$odd"
    for dynamic in off images; do
        set -- "$work/a_b.spin" "$odd" --range 1:4 --dynamic $dynamic
        "$bin/spin-eval" "$@" --json >"$work/runs" 2>/dev/null
        for table in plain md csv latex; do
            [ $table = plain ] || set -- "$work/a_b.spin" "$odd" --range 1:4 --dynamic $dynamic --table $table
            run "$bin/spin-eval" "$@"
            python3 - "$work/runs" $table $dynamic >"$work/want" <<'PY'
import json, re, sys
table, dynamic = sys.argv[2], sys.argv[3] != "off"
heads, cells = ["PSNR", "SSIM"] + ["PSNR, dynamic"] * dynamic, []
for r in json.load(open(sys.argv[1]))["runs"]:
    q = [r["psnr"], r["ssim"]] + [r.get("psnr_dynamic")] * dynamic
    cells.append((r["name"], q, r["storage"]["file"] / 1e6, r["storage"]["measured"] / 1e6))
def row(sep, digits, *sizes):
    return sep.join(["%.*f" % (d, x) for d, x in zip(digits, sizes)])
short = [2, 4, 2]
if table == "plain":
    print("      PSNR     SSIM" + "   dynamic" * dynamic + "        file  attributes  run")
    for name, q, file, size in cells:
        print("%10.3f%9.4f" % tuple(q[:2]) + "".join("%10.3f" % x for x in q[2:]) + "%9.2f MB%9.2f MB  %s" % (file, size, name))
elif table == "md":
    print("| run | %s | file, MB | attributes, MB |\n|---|%s" % (" | ".join(heads), "---:|" * (len(heads) + 2)))
    for name, q, *sizes in cells:
        print("| %s | %s | %s |" % (re.sub(r"([|\\])", r"\\\1", name), row(" | ", short, *q), row(" | ", [2, 2], *sizes)))
elif table == "csv":
    print("run,psnr,ssim%s,megabytes,file_megabytes" % (",psnr_dynamic" * dynamic))
    for name, q, file, size in cells:
        print('"%s",%s' % (name.replace('"', '""'), row(",", [6] * 5, *q, size, file)))
else:
    print("\\begin{tabular}{l%srr}\nrun & %s & file, MB & attributes, MB \\\\\n\\hline" % ("r" * len(heads), " & ".join(heads)))
    for name, q, *sizes in cells:
        name = re.sub(r"\\|[&%$#_{}~^]", lambda m: {"\\": "\\textbackslash ", "~": "\\~{}", "^": "\\^{}"}.get(
            m.group(), "\\" + m.group()), name)
        print("%s & %s & %s \\\\" % (name, row(" & ", short, *q), row(" & ", [2, 2], *sizes)))
    print("\\end{tabular}")
PY
            is "$(cat "$work/out")" "$(cat "$work/want")" "a table: $table, --dynamic $dynamic"
        done
    done
fi

# ---- Flicker -------------------------------------------------------------------------------------

run "$bin/spin-eval" "$work/better.spin" --temporal --json --report "$work/steady.html"
is "$code $(member flicker >"$work/flicker" && grep -c . "$work/flicker")" "0 1" "--temporal has the mean flicker in JSON"
is "$(grep -c '"flicker_images"' "$work/out")" 3 "and that of each of two cameras"
grep -q "<b>$(awk '{ printf "%.3f", $1 }' "$work/flicker")</b>flicker, in 1/255; images " "$work/steady.html"
ok $? "the report shows it"
is "$(sed -n '/Flicker over time/,/Storage/p' "$work/steady.html" | grep -c '<img ')" 2 "with a row of pixels over time, twice"
run "$bin/spin-eval" "$work/a_b.spin" "$work/better.spin" --temporal --table csv
is "$(sed -n 1p "$work/out")" "run,psnr,ssim,psnr_dynamic,flicker,megabytes,file_megabytes" "a table has it as a column"
is "$(awk -F, 'END { d = $5 - '"$(cat "$work/flicker")"'; print d * d < 1e-12 }' "$work/out")" 1 "with the same value"
run "$bin/spin-eval" "$work/better.spin" --range 2:3 --temporal
fails 1 spin-eval "the flicker of one frame"
run "$bin/spin-eval" "$work/better.spin" --mask --temporal
fails 2 spin-eval "flicker of a subject alone"

# ---- Another data set ----------------------------------------------------------------------------

cp -R "$clip" "$work/copy"
"$bin/spin-import" "$work/copy" --data "$work/copy" -o "$work/copied.spin" -q >/dev/null
# shellcheck disable=SC2086
run "$bin/spin-eval" "$work/a_b.spin" "$work/copied.spin" $views
err_has "^warning: '.*a_b.spin' is measured against '.*court-mini', but '.*copied.spin' against '.*copy': use --data " \
    "measured against two data sets"
# shellcheck disable=SC2086
run "$bin/spin-eval" "$work/a_b.spin" "$work/copied.spin" $views --data "$clip"
is "$code $(wc -c <"$work/err")" "0 0" "against one that is named"
# shellcheck disable=SC2086
run "$bin/spin-eval" "$work/a_b.spin" "$work/a_b.spin" $views
is "$code $(wc -c <"$work/err")" "0 0" "or that both name"

# ---- The page and the figures --------------------------------------------------------------------

# shellcheck disable=SC2086
run "$bin/spin-eval" "$work/a_b.spin" "$work/better.spin" --dynamic off --report "$work/both.html" --figures "$work/figures"
is "$code" 0 "--report and --figures"
run "$bin/spin-eval" "$work/a_b.spin" "$work/none.spin" --report "$work/both.html"
is "$code $(grep -c "both.html': it exists" "$work/err")" "1 1" "a report is kept, which is found before any run is opened"
is "$(grep -o '<h1>.*</h1>' "$work/both.html")" "<h1>2 runs</h1>" "a page of both"
is "$(grep -c '^<path class="line line-[01]"' "$work/both.html")" 4 "with two curves of two lines"
rows=$(grep -c '<img alt="" src="data:image/png;base64,iVBOR' "$work/both.html")
greater "$rows" 0
ok $? "and pictures"
is "$(find "$work/figures" -name '*.png' | wc -l) $(find "$work/figures" -name 'camera*.svg' | wc -l)" "$rows $rows" \
    "each as PNG and as SVG"
if command -v xmllint >/dev/null 2>&1; then
    xmllint --noout "$work"/figures/*.svg 2>"$work/err"
    ok $? "the SVGs are XML"
elif command -v python3 >/dev/null 2>&1; then
    python3 -c 'import sys, xml.dom.minidom as x; [x.parse(f) for f in sys.argv[1:]]' "$work"/figures/*.svg 2>"$work/err"
    ok $? "the SVGs are XML"
fi
is "$(ls "$work/figures" | grep -c 'svg$\|png$') $(grep -c '"file"' "$work/figures/sequence.json")" "$((2 * rows + 2)) $((2 * rows))" \
    "sequence.json lists the images"
run "$bin/spin-eval" "$work/a_b.spin" "$work/better.spin" --figures "$work/figures"
fails 1 spin-eval "a folder with figures in it"
touch "$work/figures/camera_00_frame_99999.png"
# shellcheck disable=SC2086
run "$bin/spin-eval" "$work/a_b.spin" --range 1:2 --dynamic off --figures "$work/figures" --force
is "$code" 0 "--force replaces them"
err_has "removed [0-9]* files of the previous export from '.*/figures'" "and says how many files it removed"
is "$(ls "$work/figures" | sed 's/.*_frame_/frame_/' | sort -u | tr '\n' ' ')" \
    "frame_00001.png frame_00001.svg frame_99999.png psnr.svg sequence.json ssim.svg " "and keeps a file of someone else"

# shellcheck disable=SC2086
run "$bin/spin-eval" "$work/better.spin" $views --report "$work/one.html"
is "$code $(grep -c 'track_iterations' "$work/one.html") $(grep -c 'hash_log2' "$work/one.html")" "0 1 0" \
    "a page of one tells its settings, and none of a network"

# ---- Invalid comparisons -------------------------------------------------------------------------

"$bin/spin-import" $clip --data $clip --range 2:5 -o "$work/other.spin" -q >/dev/null
run "$bin/spin-eval" "$work/a_b.spin" "$work/other.spin" --figures "$work/none"
fails 2 spin-eval "other views"
err_has "have different views" "says so"
run "$bin/spin-eval" "$work/a_b.spin" "$work/nothing.spin"
fails 1 spin-eval "one that is not there"
run "$bin/spin-eval" "$work/a_b.spin" "$work/better.spin" --images "$work/none"
fails 2 spin-eval "--images of several"
run "$bin/spin-eval" "$work/a_b.spin" --table md --json
fails 2 spin-eval "two forms"

# ---- A subject alone -----------------------------------------------------------------------------

if python3 -c 'import numpy' 2>/dev/null; then
    # Masks: a rectangle. The images are unchanged; a copy of the clip with another background must
    # give the same figures.
    cp -r $clip "$work/masked" && chmod -R u+w "$work/masked"
    python3 - "$work/masked" <<'PY'
import glob, os, struct, sys, zlib
root = sys.argv[1]
def png(path, w, h, inside):
    rows = b"".join(b"\0" + bytes(255 if inside(x, y) else 0 for x in range(w)) for y in range(h))
    chunk = lambda k, d: struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d))
    open(path, "wb").write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", w, h, 8, 0, 0, 0, 0))
                           + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))
for image in glob.glob(root + "/ims/*/*"):
    to = image.replace("/ims/", "/seg/").rsplit(".", 1)[0] + ".png"
    os.makedirs(os.path.dirname(to), exist_ok=True)
    absent = to.endswith("/15/000010.png")
    png(to, 160, 90, lambda x, y: 40 <= x < 120 and 20 <= y < 70 and not absent)
PY
    "$bin/spin-import" $clip --data "$work/masked" -o "$work/masked.spin" -q >/dev/null
    run "$bin/spin-eval" "$work/masked.spin" --range 1:4 --dynamic masks --json
    inside=$(member psnr_dynamic)
    run "$bin/spin-eval" "$work/masked.spin" --range 1:4 --mask --json
    is "$code $(member mask) $(member dynamic_from)" "0 masks off" "--mask by masks"
    awk -v a="$(member psnr)" -v b="$inside" 'BEGIN { d = a - b; exit !(a > 0 && d < 1e-3 && d > -1e-3) }'
    ok $? "PSNR is that inside the mask: $(member psnr), $inside"
    is "$(grep -c '"psnr": null' "$work/out")" 1 "without the view that does not show the subject"
    ssim=$(member ssim)
    run "$bin/spin-eval" "$work/masked.spin" --range 1:4 --mask --background white --json
    awk -v a="$(member ssim)" -v b="$ssim" 'BEGIN { d = a - b; exit !(a > 0 && a < 0.9 && d < 0.1 && d > -0.1) }'
    ok $? "SSIM is of the subject, on any background: $(member ssim), $ssim"
    run "$bin/spin-eval" "$work/masked.spin" --range 1:4 --mask --images "$work/alone"
    out_has "^mask     subject only" "it is said"
    run "$bin/spin-eval" "$work/masked.spin" --mask --dynamic masks
    fails 2 spin-eval "--mask with --dynamic"
    mask=$(find "$work/masked/seg" -name '*.png' | head -n 1)
    run "$bin/spin-retrain" "$work/masked.spin" -o "$work/never.spin" --log "$mask" --force
    fails 1 spin-retrain "a log that would replace a mask"
    err_has "'$mask': it is an input" "and says so"

    # Alpha, of a data set without masks: the PSNR of pixels whose alpha is at least a half, from
    # 16-bit images, and the SSIM of windows that touch such a pixel.
    "$bin/spin-import" fixtures/4dgaussian/coarse_and_fine --data fixtures/datasets/blender_mini -o "$work/alpha.spin" -q
    run "$bin/spin-eval" "$work/alpha.spin" --json
    is "$(member alpha_known) $(member psnr_opposite | awk '{ print ($1 > 0) }')" "true 1" \
        "images with alpha are compared over the opposite background, too"
    run "$bin/spin-export" "$work/alpha.spin" --to images --bits 16 -o "$work/drawn"
    for background in black white; do
        run "$bin/spin-eval" "$work/alpha.spin" --mask --background $background --json
        is "$code $(member mask)" "0 alpha" "--mask by alpha, $background"
        got=$(member psnr) got_ssim=$(member ssim)
        [ $background = white ] && run "$bin/spin-export" "$work/alpha.spin" --to images --bits 16 --background white \
            -o "$work/drawn" --force
        want=$(PYTHONDONTWRITEBYTECODE=1 PYTHONPATH=tests/tools python3 - "$work/drawn" $background <<'PY'
import glob, sys
import numpy as np
from pictures import png
kernel = np.exp(-np.arange(-5, 6) ** 2 / 4.5)
kernel /= kernel.sum()
def blur(x): # with zeros around
    for axis in 0, 1:
        x = np.apply_along_axis(np.convolve, axis, x, kernel, "same")
    return x
def ssim(a, b):
    ma, mb = blur(a), blur(b)
    va, vb, both = blur(a * a) - ma * ma, blur(b * b) - mb * mb, blur(a * b) - ma * mb
    return (2 * ma * mb + 1e-4) * (2 * both + 9e-4) / ((ma * ma + mb * mb + 1e-4) * (va + vb + 9e-4))
psnr, seen = [], []
drawn, truth = sorted(glob.glob(sys.argv[1] + "/*.png")), sorted(glob.glob("fixtures/datasets/blender_mini/test/*.png"))
assert len(drawn) == len(truth) == 3
for a, b in zip(drawn, truth):
    a, b = png(a), png(b)
    alpha = b[..., 3:]
    b = b[..., :3] * alpha + (sys.argv[2] == "white") * (1 - alpha)
    subject = alpha[..., 0] >= 0.5
    assert 50 < subject.sum() < .9 * subject.size
    psnr.append(-10 * np.log10(((a - b)[subject] ** 2).mean()))
    a, b = (np.where(subject[..., None], x, sys.argv[2] == "white") for x in (a, b))
    reached = blur(subject.astype(float)) > 1e-9
    seen.append(ssim(a, b)[reached].mean())
print(np.mean(psnr), np.mean(seen))
PY
        )
        want_ssim=${want#* } want=${want% *}
        awk -v a="$got" -v b="$want" 'BEGIN { d = a - b; exit !(a > 0 && d < 0.02 && d > -0.02) }'
        ok $? "PSNR is that of what is opaque by half, $background: $got, $want"
        awk -v a="$got_ssim" -v b="$want_ssim" 'BEGIN { d = a - b; exit !(a > 0 && d < 1e-3 && d > -1e-3) }'
        ok $? "and its SSIM: $got_ssim, $want_ssim"
    done
else
    skip "--mask" "no python3 with NumPy"
fi
run "$bin/spin-eval" "$work/a_b.spin" --mask
fails 1 spin-eval "--mask without masks and alpha"
err_has "not all images have alpha" "says what is missing"

done_testing
