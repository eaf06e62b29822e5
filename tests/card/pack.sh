#!/bin/sh
# pack.sh BUILD_DIR FOLDER: packs a test kit for a machine with a GPU and little else as
# FOLDER/spin4d-card.tar.xz: programs, their libraries except the C library, the kernels, the
# tests' fixtures, and run.sh. At most 24 MiB. `make card-kit` first builds what it needs.
B=${1:?usage: pack.sh BUILD_DIR FOLDER}
to=${2:?usage: pack.sh BUILD_DIR FOLDER}
MOST=$((24 << 20))
kit=$to/spin4d-card

fail() {
    echo "pack.sh: $*" >&2
    exit 1
}

rm -rf "$kit" "$kit.tar.xz"
mkdir -p "$kit/bin" "$kit/lib" "$kit/fixtures" || exit 1
kernels=$B/lib/spin-cuda.so
[ -f "$kernels" ] || fail "'$kernels' is not there: it needs nvcc"

for source in tests/device/t-*.c tests/train/t-e2e.c tests/train/t-lazy_adam.c tests/train/t-tracks.c; do
    program=$B/${source%.c}
    name=$(echo "${source%.c}" | sed 's|^tests/||; s|/|-|')
    strip -o "$kit/bin/$name" "$program" || fail "'$program' is not built"
    echo "$name" >>"$kit/programs"
done
for program in tests/card/t-card tests/bench/bench bin/spin-import bin/spin-retrain bin/spin-eval; do
    strip -o "$kit/bin/$(basename $program)" "$B/$program" || fail "'$B/$program' is not built"
done
for library in lib/spin-cuda.so lib/spin-image-plain.so tests/libspin-tests.so; do
    strip -o "$kit/lib/$(basename $library)" "$B/$library" || fail "'$B/$library' is not built"
done

# All libraries except those of the C library.
ldd "$kit"/bin/* "$kit"/lib/*.so | awk '$2 == "=>" && $3 ~ /^\// { print $3 }' | sort -u |
    grep -v -E '/(libc|libm|libdl|libpthread|librt|ld-linux[^/]*)\.so' >"$to/libraries" || fail "ldd found no libraries"
while read -r library; do
    cp -L "$library" "$kit/lib/" || exit 1
done <"$to/libraries"
rm "$to/libraries"

fixtures=fixtures
[ -d ../shared/fixtures ] && fixtures=../shared/fixtures
cp -r "$fixtures/core" "$fixtures/hash4d" "$kit/fixtures/" && cp -r fixtures/court-mini "$kit/fixtures/" || exit 1
cp tests/card/run.sh "$kit/" || exit 1
git rev-parse HEAD >"$kit/commit" 2>/dev/null
chmod -R go-w "$kit"

tar -C "$to" -c spin4d-card | xz -9e >"$kit.tar.xz" || exit 1
bytes=$(wc -c <"$kit.tar.xz")
[ "$bytes" -le $MOST ] || fail "'$kit.tar.xz' has $bytes bytes, more than $MOST"
echo "$kit.tar.xz: $bytes bytes, made for the C library $(ldd --version | sed -n '1s/.* //p') and later"
