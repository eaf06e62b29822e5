#!/bin/sh
# windows.sh ZIP BUILD: compares the commands of `make windows`, under Wine, with those of BUILD
# (build/release, with its test-tools): the same bytes, the same lines, the same exit codes. The C
# library of Windows rounds exp(), log() and similar functions from 80 bits, ours does not, and the
# last bit of a float sometimes differs: the commands of BUILD run with functions that round as
# Windows does.
zip=$(realpath "${1:?usage: windows.sh ZIP BUILD}")
here=$(realpath "${2:?usage: windows.sh ZIP BUILD}")
root=$PWD
work=$(mktemp -d) || exit 1
trap 'WINEPREFIX="$work/wine" wineserver -k 2>/dev/null; rm -rf "$work"' EXIT
n=0

fail() {
    echo "windows: $*" >&2
    exit 1
}

for tool in wine unzip; do
    command -v $tool >/dev/null || fail "no $tool: CONTRIBUTING.md says what windows needs"
done
unset SPIN_PLUGIN_PATH SPIN_CPU
export WINEPREFIX="$work/wine" WINEDEBUG=-all
cd "$work" || exit 1
unzip -q "$zip" || fail "'$zip' is no zip"
there=$(echo "$work"/spin4d-*)/bin
wine "$there/spin4d.exe" --version >there.1 2>there.2 || fail "wine does not start: $(tail -n 3 there.2)"

{
    for f in exp log sin cos tan asin acos atan tanh exp2 log2 log10 log1p expm1 cbrt; do
        echo "long double ${f}l(long double); double $f(double x) { return ${f}l(x); } float ${f}f(float x) { return ${f}l(x); }"
    done
    for f in pow atan2; do
        echo "long double ${f}l(long double, long double); double $f(double x, double y) { return ${f}l(x, y); }" \
            "float ${f}f(float x, float y) { return ${f}l(x, y); }"
    done
} >round.c
${CC:-cc} -w -fno-builtin -O2 -shared -fPIC -o round.so round.c -lm || fail "the rounding functions do not build"

# both COMMAND ARGUMENT...: runs it here and under Wine, each writing 'out', which becomes here/out
# and there/out. Lines and exit codes must be equal; $code is set.
both() {
    command=$1
    shift
    n=$((n + 1))
    rm -rf here there out* && mkdir here there || exit 1
    LD_PRELOAD=$work/round.so "$here/bin/$command" "$@" >here.1 2>here.2 </dev/null
    code=$?
    for file in out*; do [ ! -e "$file" ] || mv "$file" here/; done
    wine "$there/$command.exe" "$@" >there.1 2>there.2 </dev/null
    code_there=$?
    for file in out*; do [ ! -e "$file" ] || mv "$file" there/; done
    sed -i 's|Z:/|/|g' there.1 there.2
    [ $code = $code_there ] || fail "$command $* ends with $code_there, not $code: $(tail -n 1 there.2)"
}

same() { # the last of both()
    { diff here.2 there.2 && diff here.1 there.1; } >&2 || fail "other lines: $command $*"
    diff -r here there >&2 || fail "other bytes: $command $*"
}

larger=${SPIN_FIXTURES:-$root/../shared/fixtures}
imported=0
for run in "$root"/fixtures/*/* "$larger"/*/* "$larger"/real/*/*; do
    [ -e "$run" ] || continue
    both spin-import "$run" -o out.spin
    same "$run"
    [ $code != 0 ] || imported=$((imported + 1))
done
[ $imported -gt 30 ] || fail "$imported imports only"
echo "$imported runs imported: the same bytes; $((n - imported)) folders and files refused in the same words"

exported=0
for run in court-mini 4dgs/birth_one_window 4dgs/birth_sh2 spacetimegs/full_techni splat4d/default_bounds ply/inria_sh3; do
    both spin-import "$root/fixtures/$run" -o out.spin
    mv here/out.spin clip.spin || fail "no clip of '$run'"
    for format in 4dgs compressed-ply ftgs gltf html images ply sog sogst sogst-ply splat spz stglite tsog usd; do
        both spin-export clip.spin --to $format -o out
        same "$run --to $format"
        [ $code != 0 ] || exported=$((exported + 1))
    done
    both spin-export clip.spin --to spz --spz-version 3 -o out
    same "$run --spz-version 3"
    [ $code = 0 ] || fail "no zstd"
done
[ $exported -gt 50 ] || fail "$exported exports only"
echo "$exported exports: the same bytes"

# On the SIMD path of this processor, and on the base path. The output contains times. PSNR uses
# log10() of Windows' own library, or of Wine's, and differs in the last of its 16 digits.
for path in '' base; do
    export SPIN_CPU=$path
    both spin4d "$root/fixtures/court-mini" --iterations 20 --threads 2 -o out.html
    [ $code = 0 ] || fail "spin4d: $(tail -n 1 there.2)"
    cmp here/out.html there/out.html || fail "another page, SPIN_CPU='$path'"
done
cp here/out.spin clip.spin || exit 1
both spin-eval clip.spin --json --report out.html
[ $code = 0 ] || fail "spin-eval: $(tail -n 1 there.2)"
for side in here there; do
    grep -v -E '"(fps|fps_draw|seconds[a-z_]*|memory[a-z_]*)"' $side.1 >$side.measured
done
awk 'NR == FNR { line[n = FNR] = $0; next }
    $0 != line[FNR] {
        split(line[FNR], here, ": ")
        split($0, there, ": ")
        apart = here[2] - there[2]
        if (here[1] != there[1] || here[2] + 0 == 0 || apart * apart > 1e-24 * here[2] * here[2]) exit other = 1
    }
    END { exit other || FNR != n }' here.measured there.measured || {
    diff here.measured there.measured
    fail "other measures"
}
[ -s there/out.html ] || fail "no report"
echo "spin4d and spin-eval: the same page, the same measures"

mkdir -p 'ä b' || exit 1
# looked CODE WHAT: opens an image of the data set, with this exit code and the same output;
# OpenImageIO is not used.
looked() {
    both spin-eval clip.spin --data 'ä b/data' --split all --range 0:1
    [ $code = "$1" ] || fail "$2: ends with $code"
    { diff here.2 there.2 && [ "$(grep -v '^speed' here.1)" = "$(grep -v '^speed' there.1)" ]; } || fail "other words: $2"
}
cp -R "$root/fixtures/court-mini" 'ä b/data' || exit 1
export SPIN_IMAGE_SHIM=/none
photo='ä b/data/ims/0/000008.jpg'
looked 0 JPEG
yes U | tr -d '\n' | dd of="$photo" bs=1 seek=1200 count=600 conv=notrunc 2>dd || fail "dd: $(cat dd)"
looked 1 'a damaged JPEG'
cp "$root/fixtures/pictures/cmyk.jpg" "$photo" || exit 1
looked 1 'a JPEG of four colours'
both spin-export clip.spin --to images --range 0:1 -o out
cp "$(find here/out -name '*.png' | head -n 1)" "$photo" || exit 1
looked 0 PNG
echo damaged | dd of="$photo" bs=1 seek=2000 conv=notrunc 2>dd || fail "dd: $(cat dd)"
looked 1 'a damaged PNG'
unset SPIN_IMAGE_SHIM
echo "photographs, whole and damaged: the same words"

cp clip.spin 'ä b/日本.spin'
wine "$there/spin4d.exe" export 'ä b\日本.spin' --to ply -o 'ä b\out of it' >there.1 2>&1 || fail "names: $(tail -n 1 there.1)"
[ -n "$(ls 'ä b/out of it')" ] || fail "names: nothing written"
wine "$there/spin-import.exe" "$root/fixtures/court-mini" -o 'ä b\日本.spin' >there.1 2>&1 && fail "written over a file unasked"
grep -q -e '--force' there.1 || fail "not a word of --force: $(cat there.1)"
wine "$there/spin-import.exe" "$root/fixtures/court-mini" -o 'ä b\日本.spin' --force >there.1 2>&1 || fail "--force: $(cat there.1)"
wine "$there/spin-retrain.exe" 'ä b\日本.spin' --data "$root/fixtures/court-mini" --iterations 5 -o 'ä b\日本.spin' --force \
    >there.1 2>&1 && fail "a bundle written over itself"
grep -q 'it is an input' there.1 || fail "a bundle into itself: $(tail -n 1 there.1)"
wine "$there/spin-export.exe" 'ä b\日本.spin' -o v.mp4 >there.1 2>&1 && fail "a video"
grep -q 'spin4d for Windows does not include it' there.1 || fail "not a word of what is not there: $(cat there.1)"
left=$(find . -path ./wine -prune -o \( -name '*.tmp*' -o -name '*.lock' \) -print)
[ -z "$left" ] || fail "left behind: $left"
echo "names, --force, a bundle into itself: as elsewhere"
