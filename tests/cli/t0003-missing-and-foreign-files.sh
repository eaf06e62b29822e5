#!/bin/sh
# Missing files and files of other programs give exit code 1 and one line that names them; nothing
# is written.
. tests/cli/lib.sh

echo "not a zip" >"$work/text.spin"
: >"$work/empty.spin"
printf 'PK\005\006\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0' >"$work/hollow.spin"

for file in "$work/absent.spin" "$work/text.spin" "$work/empty.spin" "$work/hollow.spin" "$work"; do
    word=$(basename "$file")
    run "$bin/spin-import" --info "$file"
    fails 1 spin-import "import $word"
    err_has "'$file" "import $word: names the input"
    run "$bin/spin-import" "$file" -o "$work/new.spin"
    fails 1 spin-import "import $word to a bundle"
    nothing_at "$work/new" "import $word: nothing was written"
    run "$bin/spin-retrain" "$file" -o "$work/new.spin"
    fails 1 spin-retrain "retrain $word"
    nothing_at "$work/new" "retrain $word: nothing was written"
    run "$bin/spin-eval" "$file" --json
    fails 1 spin-eval "eval $word"
    run "$bin/spin-export" "$file" --to ply -o "$work/new"
    fails 1 spin-export "export $word"
    nothing_at "$work/new" "export $word: nothing was written"
done

# Files known to an importer: which importer reads the file, and as what.
for pair in ply:fixtures/ply/brush_sh1/00001.ply gltf:fixtures/splats/glb/frame_00000.glb \
    spz:fixtures/splats/spz4/frame_00000.spz tc3dgs:fixtures/tc3dgs/trained/params.npz d3dgs:$clip; do
    file=${pair#*:}
    for command in "spin-export $file -o $work/new.glb" "spin-eval $file" "spin-retrain $file -o $work/new.spin"; do
        # shellcheck disable=SC2086
        run "$bin/"$command
        fails 1 "${command%% *}" "${command%% *} of ${pair%%:*}"
        err_has "'$file' is not a bundle: convert it with spin-import (importer '${pair%%:*}') first" "${command%% *}: who reads ${pair%%:*}"
    done
done
nothing_at "$work/new" "what is not a bundle: nothing was written"
run "$bin/spin-export" "$work/text.spin" -o "$work/new.glb"
err_has "'$work/text.spin' is not a bundle\$" "text is not a bundle"

# Files that no importer reads are named, with advice.
mkdir -p "$work/in/out" "$work/empty" "$work/pictures" "$work/films" "$work/packed"
cp fixtures/ply/brush_sh1/00001.ply "$work/in/out/p.ply"
cp $clip/ims/0/*.jpg "$work/pictures"
printf '\0\0\0\040ftypisom' >"$work/film.mp4"
cp "$work/film.mp4" "$work/films"
printf '7z\274\257' >"$work/a.7z"
printf '\375''7zXZ' >"$work/a.xz"
python3 -c 'import sys, zipfile
zipfile.ZipFile(sys.argv[1], "w").write(sys.argv[2], "out/p.ply")' "$work/a.zip" "$work/in/out/p.ply"
cp "$work/a.zip" "$work/packed"
run "$bin/spin-import" --info fixtures/3dgstream/ntc_warmup.pth
fails 1 spin-import "a checkpoint of no method"
err_has "ntc_warmup.pth': a PyTorch checkpoint that no importer reads" "is called one"
foreign() { # INPUT EXPECTED
    for command in "spin-import --info" "spin-import -o $work/new.spin" "spin4d --no-retrain -o $work/new.html" spin-eval \
        "spin-export -o $work/new.glb" "spin-retrain -o $work/new.spin"; do
        # shellcheck disable=SC2086
        run "$bin/"$command "$1"
        fails 1 "${command%% *}" "$command ${1##*/}"
        err_has "'$(echo "$1" | sed 's/[*]/[*]/')'.*: it $2" "$command ${1##*/}: it $2"
        nothing_at "$work/new" "$command ${1##*/}: nothing was written"
    done
}
foreign "$work/a.7z" "is a 7z archive: unpack it"
foreign "$work/a.xz" "is packed by xz: unpack it"
run "$bin/spin-eval" "$work/a.zip"
fails 1 spin-eval "an archive in place of a bundle"
err_has "is a ZIP archive that contains 'out/p.ply': unpack it" "is named with what it contains"
"$bin/spin-import" -q fixtures/ply/inria_sh1 -o "$work/whole.spin"
head -c 3000 "$work/whole.spin" >"$work/short.spin"
run "$bin/spin-export" "$work/short.spin" -o "$work/short.html"
fails 1 spin-export "a bundle that is cut short"
err_has "like a ZIP archive, but is truncated or damaged" "is not to be unpacked"
foreign "$work/packed" "contains an archive, 'a.zip': unpack it"
foreign "$work/film.mp4" "is a video, not splats: train"
foreign "$work/films" "is a folder of videos, not of splats: .* with --data"
foreign "$work/pictures" "is a folder of images, not of splats: .* with --data"
foreign "$work/empty" "is an empty folder: give the one that a method wrote"
foreign "https://example.org/a.ply" "is a URL: download it first"
foreign "$work/in/out/x*.ply" "is a pattern: give the folder, '$work/in/out'"
for pair in "$work/a.zip=is a ZIP" "$work/film.mp4=is a video: give the folder" "$work/empty=is an empty folder: give the one with" \
    "$work/pictures=is a folder of images without a supported file of cameras" "https://example.org/a=is a URL" "$work/no*=is a pattern"; do
    run "$bin/spin-import" "$clip" --data "${pair%%=*}" -o "$work/new.spin"
    fails 1 spin-import "--data ${pair##*/}"
    err_has "'$(echo "${pair%%=*}" | sed 's/[*]/[*]/')': it ${pair#*=}" "--data: it ${pair#*=}"
done

# Each line is a single write(), so that lines of several processes do not interleave.
if strace -f -o "$work/strace" true 2>/dev/null; then
    for command in spin-import spin-eval spin-export spin-retrain; do
        run traced -f -qq -e trace=write -o "$work/strace" "$bin/$command" "$work/text.spin" -o "$work/new.glb"
        is "$(grep -c 'write(2' "$work/strace")" "$(wc -l <"$work/err")" "$command: a line on stderr is one write"
    done
    "$bin/spin-import" -q $clip -o "$work/warned.spin"
    run traced -f -qq -e trace=write -o "$work/strace" "$bin/spin-export" "$work/warned.spin" --to ply -o "$work/ply" --crop 99,99,99,1
    is "$(grep -c 'write(2' "$work/strace") $(grep -c '^warning: ' "$work/err")" "3 2" "so is a warning"
else
    skip "a line on stderr is one write" "no strace"
fi

# SOG is a zip file with a meta.json too.
cp fixtures/splats/splat/frame_00000.splat "$work/one.splat"
"$bin/spin-import" -q "$work/one.splat" -o "$work/one.spin" && "$bin/spin-export" -q "$work/one.spin" -o "$work/one.sog"
run "$bin/spin-import" "$work/one.sog" -o "$work/back.spin" --json
is "$code $(member from)" "0 sog" "import of SOG: splats, and no bundle"
run "$bin/spin-import" --info "$work/one.sog" --json
is "$code $(member from)" "0 sog" "nor is it described as one"
run "$bin/spin-export" "$work/one.sog" -o "$work/new.glb"
fails 1 spin-export "export of SOG"
nothing_at "$work/new" "SOG: nothing was written"

# A full disk, simulated by a limit on the size of files.
(
    ulimit -f 16
    exec "$bin/spin-import" "$clip" -o "$work/new.spin" >"$work/out" 2>"$work/err"
)
code=$?
fails 1 spin-import "a full disk"
err_has "cannot write '$work/new.spin': File too large" "a full disk: says what the system said"
nothing_at "$work/new" "a full disk: nothing was written"

# little_memory KILOBYTES COMMAND...; skipped with sanitisers, whose address space exceeds the
# limit.
little_memory() {
    (
        ulimit -v "$1"
        shift
        exec "$@" >"$work/out" 2>"$work/err"
    )
    code=$?
}
case ${SPIN_BUILD:-} in *asan* | *tsan*) skip "little memory" "a sanitiser" && done_testing ;; esac
"$bin/spin-import" -q "$clip" --data "$clip" -o "$work/clip.spin"
echo '__attribute__((constructor)) static void fall(void) { __builtin_trap(); }' >"$work/falls.c"
if ${CC:-gcc} -shared -fPIC -o "$work/falls.so" "$work/falls.c" 2>/dev/null; then
    export SPIN_IMAGE_SHIM="$work/falls.so" SPIN_IMAGE_PLAIN_SHIM="$work/falls.so"
    little_memory 8000000 "$bin/spin-retrain" "$work/clip.spin" -o "$work/new.spin"
    unset SPIN_IMAGE_SHIM SPIN_IMAGE_PLAIN_SHIM
    fails 1 spin-retrain "libraries that fall when they are loaded"
    err_has "its libraries need more memory than .ulimit -v. allows" "libraries that fall: says why"
fi
for limit in 200000 350000 400000 450000 500000 600000 700000; do
    little_memory $limit "$bin/spin-retrain" "$work/clip.spin" -o "$work/new.spin" --iterations 1 -q
    [ "$code" = 0 ] || fails 1 spin-retrain "ulimit -v $limit"
    rm -rf "$work/new.spin"*
done

# The shims of OpenImageIO and FFmpeg: a library that cannot be mapped is reported as lack of
# memory, not as missing.
for what in "spin-image: --to images --format exr -o $work/little" "spin-video: --path orbit --size 64x64 -o $work/little.mp4"; do
    if [ ! -f "$bin/../lib/${what%%:*}.so" ]; then
        skip "little memory for ${what%%:*}" "not built"
        continue
    fi
    for limit in 60000 120000 160000; do
        # shellcheck disable=SC2086
        little_memory $limit "$bin/spin-export" "$work/clip.spin" -q --range 0:1 ${what#*:}
        fails 1 spin-export "${what%%:*}, ulimit -v $limit"
        err_has memory "${what%%:*}, ulimit -v $limit: says that memory is lacking"
        nothing_at "$work/little" "${what%%:*}, ulimit -v $limit: nothing was written"
    done
done
done_testing
