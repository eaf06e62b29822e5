#!/bin/sh
# portable.sh VERSION BUILD_DIR OUT: packs OUT/spin4d-VERSION-linux-MACHINE.tar.gz from the files
# that `make portable` has built. The archive contains the commands, manual, documents, player,
# Python module, a sample clip, and all libraries except the C library, with their licences. Its
# programs run on Linux without further packages. The same build always gives the same archive.
version=${1:?usage: portable.sh VERSION BUILD_DIR OUT}
B=${2:?usage: portable.sh VERSION BUILD_DIR OUT}
out=${3:?usage: portable.sh VERSION BUILD_DIR OUT}
name=spin4d-$version-linux-$(uname -m)
tree=$out/$name

fail() {
    echo "portable: $*" >&2
    rm -rf "$tree"
    exit 1
}

# take FILE NAME: copies a library and records its path
take() {
    cp -L "$1" "$tree/lib/spin4d/$2" && chmod 644 "$tree/lib/spin4d/$2" || fail "cannot copy '$1'"
    realpath "$1" | sed 's|^/usr||' >>"$out/taken"
}

command -v dpkg >/dev/null || fail "dpkg not found: it is needed to locate licences of libraries"
rm -rf "$tree" "$out/taken"
mkdir -p "$tree/bin" "$tree/lib/spin4d" "$tree/share/doc/spin4d" "$tree/python" "$tree/share/spin4d" || exit 1
for shim in image-plain gltf; do
    strip -o "$tree/lib/spin4d/spin-$shim.so" "$B/lib/spin-$shim.so" || fail "cannot read '$B/lib/spin-$shim.so'"
done
[ ! -f "$B/lib/spin-cuda.so" ] || strip -o "$tree/lib/spin4d/spin-cuda.so" "$B/lib/spin-cuda.so" || exit 1
for program in "$B"/portable/bin/spin*; do
    command=$(basename "$program")
    strip -o "$tree/bin/$command" "$program" || fail "cannot strip '$program'"
    for shell in bash zsh; do
        mkdir -p "$tree/share/completion/$shell"
        env -u SPIN_PLUGIN_PATH "$B/bin/$command" --completion $shell >"$tree/share/completion/$shell/$command" || exit 1
    done
done

# Copy the libraries that are loaded on demand, under the names by which they are loaded.
for opened in $(sed -n 's/.*struct spin_library library = {"\(lib[^"]*\)".*/\1/p' src/io/*.c); do
    take "$(${CC:-cc} -print-file-name="${opened%%.so*}.so")" "$opened"
done
ldd "$tree"/bin/* "$tree"/lib/spin4d/*.so* | awk '$2 == "=>" && $3 ~ /^\// { print $3 }' | sort -u |
    grep -v -E '/(libc|libm|libdl|libpthread|librt|ld-linux[^/]*)\.so' >"$out/libraries" || fail "ldd found no libraries"
while read -r library; do
    take "$library" "$(basename "$library")"
done <"$out/libraries"
for static in libz.a liblzma.a libjansson.a; do
    realpath "$(${CC:-cc} -print-file-name=$static)" | sed 's|^/usr||' >>"$out/taken"
done
# Copy the licence of each library's package.
sed 's/^/*/' "$out/taken" | xargs dpkg -S >"$out/owners" 2>/dev/null
while read -r library; do
    package=$(sed -n "s|[:,].*$library\$||p" "$out/owners" | head -n 1)
    [ -f "/usr/share/doc/$package/copyright" ] || fail "no licence of '$library': it does not belong to a Debian package"
    cp -L "/usr/share/doc/$package/copyright" "$tree/share/doc/spin4d/$package.copyright" || exit 1
done <"$out/taken"
rm "$out/libraries" "$out/taken" "$out/owners"

needs=$(objdump -T "$tree"/bin/* "$tree"/lib/spin4d/* | grep -o 'GLIBC_[0-9.]*' | sort -uV | sed -n '$s/GLIBC_//p')

for page in man/*.[157]; do
    mkdir -p "$tree/share/man/man${page##*.}" && cp "$page" "$tree/share/man/man${page##*.}/" || exit 1
done
mkdir -p "$tree/share/doc/spin4d/docs" &&
    cp docs/*.md docs/*.jpg docs/*.png docs/*.webp "$tree/share/doc/spin4d/docs/" && cp -R docs/how-to "$tree/share/doc/spin4d/docs/" &&
    cp exporters/python/spin4d.py "$tree/python/" && cp -R "$B/player" "$tree/share/spin4d/" &&
    cp -R fixtures/court-mini "$tree/share/spin4d/sample" && rm "$tree/share/spin4d/sample/gt_points.npz" &&
    cp LICENSE CHANGELOG.md "$tree/" || exit 1
cat >"$tree/README" <<README
spin4d $version for Linux on $(uname -m). It needs no packages except the C library $needs
or newer; this folder can be anywhere.

    bin/spin4d share/spin4d/sample -o sample.html
    bin/spin4d RUN --data IMAGES -o clip.html

The first command converts a sample of six frames. RUN is the folder that a 4D Gaussian Splatting method wrote, IMAGES the
data set it was trained on. For more, see bin/spin4d --help and man -M share/man spin4d.

share/spin4d/player plays clips in your own pages; its README says how. python/ contains the module spin4d, for PYTHONPATH.
share/doc/spin4d contains the documents that the manual names, and the licences of the libraries.

Images are PNG and JPEG. Videos and EXR need FFmpeg and OpenImageIO, which are not included: build spin4d from source, see
share/doc/spin4d/docs/how-to/install.md. Without a build, FFmpeg's own command makes a video of PNG files:

    bin/spin4d export clip.spin --to images --path orbit -o frames
    ffmpeg -framerate 30 -i frames/orbit_frame_%05d.png -pix_fmt yuv420p clip.mp4
README
chmod -R u=rwX,go=rX "$tree"
tar -C "$out" --sort=name --owner=0 --group=0 --numeric-owner --mtime=./Makefile -c "$name" | gzip -9n >"$tree.tar.gz" || exit 1
rm -rf "$tree"
echo "$tree.tar.gz: for the C library $needs and newer"
