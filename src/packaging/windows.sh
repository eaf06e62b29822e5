#!/bin/sh
# windows.sh VERSION BUILD: builds BUILD/windows/spin4d-VERSION-windows-x86_64.zip with Debian's
# MinGW. The archive contains the commands, and libraries with their licences. The commands run on
# 64-bit Windows without further software. Libraries for which Debian has no MinGW package are built
# from Debian's sources in BUILD/windows/deps, which is kept. The same build always gives the same
# archive.
version=${1:?usage: windows.sh VERSION BUILD}
mkdir -p "${2:?usage: windows.sh VERSION BUILD}/windows/deps/include" || exit 1
W=$(cd "$2/windows" && pwd)
deps=$W/deps
name=spin4d-$version-windows-x86_64
host=x86_64-w64-mingw32
jobs=${JOBS:-$(nproc)}
# src/base/windows implements the POSIX functions that Windows lacks.
posix="-include base/windows/posix.h -D__USE_MINGW_ANSI_STDIO=1 -D_FILE_OFFSET_BITS=64 -I$deps/include"

fail() {
    echo "windows: $*" >&2
    exit 1
}

for tool in $host-gcc-posix:gcc-mingw-w64-x86-64-posix $host-g++-posix:g++-mingw-w64-x86-64-posix cmake:cmake zip:zip \
    dpkg-source:dpkg-dev; do
    command -v "${tool%:*}" >/dev/null || fail "${tool%:*} not found: apt-get install ${tool#*:}"
done
[ -f /usr/$host/include/zlib.h ] || fail "MinGW's zlib.h not found: apt-get install libz-mingw-w64-dev"

# source_of PACKAGE: downloads and unpacks the Debian source into $tree. If the newest source is no
# longer in the archive, the source of the original release is used.
source_of() {
    mkdir -p "$deps/src" && cd "$deps/src" || exit 1
    tree=$deps/src/$1
    [ ! -d "$tree" ] || return 0
    apt-get source --download-only "$1" >"$1.log" 2>&1 ||
        apt-get source --download-only "$1/$(sed -n 's/^VERSION_CODENAME=//p' /etc/os-release)" >>"$1.log" 2>&1 ||
        fail "cannot download the source of '$1' (check that apt's sources contain deb-src lines): $(tail -n 1 "$1.log")"
    dpkg-source --no-check -x "$1"_*.dsc "$1" >>"$1.log" 2>&1 || fail "cannot unpack '$1', see $deps/src/$1.log"
}

# library PACKAGE FOLDER OPTION...: builds a library with the CMakeLists.txt in FOLDER
library() {
    package=$1
    (
        source_of "$package"
        folder=$tree/$2
        shift 2
        [ ! -f "$tree/done" ] || exit 0
        echo "  DEPS     $package"
        { cmake -S "$folder" -B "$tree/build-windows" -DCMAKE_SYSTEM_NAME=Windows -DCMAKE_SYSTEM_PROCESSOR=x86_64 \
            -DCMAKE_C_COMPILER=$host-gcc-posix -DCMAKE_CXX_COMPILER=$host-g++-posix -DCMAKE_RC_COMPILER=$host-windres \
            -DCMAKE_C_FLAGS="-D__USE_MINGW_ANSI_STDIO=1 -ffile-prefix-map=$tree=." -DCMAKE_BUILD_TYPE=Release \
            -DCMAKE_INSTALL_PREFIX="$deps" -DCMAKE_FIND_ROOT_PATH="$deps;/usr/$host" -DCMAKE_FIND_ROOT_PATH_MODE_LIBRARY=ONLY \
            -DCMAKE_FIND_ROOT_PATH_MODE_INCLUDE=ONLY -DBUILD_SHARED_LIBS=OFF "$@" &&
            cmake --build "$tree/build-windows" -j "$jobs" && cmake --install "$tree/build-windows" && touch "$tree/done"; } \
            >>"$deps/src/$package.log" 2>&1 || fail "cannot build '$package', see $deps/src/$package.log"
    ) || exit 1
}

library xz-utils . -DENABLE_NLS=OFF
library jansson . -DJANSSON_BUILD_DOCS=OFF -DJANSSON_WITHOUT_TESTS=ON -DJANSSON_EXAMPLES=OFF
library libzstd build/cmake -DZSTD_BUILD_SHARED=OFF -DZSTD_BUILD_PROGRAMS=OFF -DZSTD_BUILD_TESTS=OFF
library libwebp . -DWEBP_BUILD_ANIM_UTILS=OFF -DWEBP_BUILD_CWEBP=OFF -DWEBP_BUILD_DWEBP=OFF -DWEBP_BUILD_GIF2WEBP=OFF \
    -DWEBP_BUILD_IMG2WEBP=OFF -DWEBP_BUILD_VWEBP=OFF -DWEBP_BUILD_WEBPINFO=OFF -DWEBP_BUILD_WEBPMUX=OFF -DWEBP_BUILD_EXTRAS=OFF
library libjpeg-turbo . -DENABLE_SHARED=OFF -DWITH_SIMD=OFF
library libpng1.6 . -DPNG_SHARED=OFF -DPNG_TESTS=OFF

# Create empty files for headers that Windows lacks; posix.h declares their contents.
mkdir -p "$deps/include/sys" || exit 1
for header in dirent dlfcn sys/file sys/mman sys/resource sys/statvfs sys/wait; do
    [ -f "$deps/include/$header.h" ] || : >"$deps/include/$header.h" || exit 1
done

# -Wa,-muse-unaligned-vector-move: gcc does not align the stack for AVX vectors on Windows (gcc bug
# 54412). -Wno-format: gcc assumes Microsoft's printf, which lacks %zu. The Linux build checks
# formats.
windows_make() {
    make --no-print-directory -j"$jobs" BUILD="$W" CC=$host-gcc-posix CXX=$host-g++-posix AR=$host-ar MPICC= VIDEO= CUDA=0 \
        CPPFLAGS="$posix" CFLAGS='-Wa,-muse-unaligned-vector-move -Wno-format -Wno-format-extra-args' PLUGIN_LD= \
        SPIN_LDLIBS='-lz -llzma -ljansson -lm' \
        LDFLAGS="-static -s -Wl,--no-insert-timestamp -Wl,--stack,8388608 -L$deps/lib" LDLIBS="$own" "$@" ||
        fail "the build failed"
}
own=
for file in main posix; do
    own="$own $W/release/src/base/windows/$file.o"
done
image=$W/release/src/io/image_plain.o
# shellcheck disable=SC2086
windows_make $own "$image"
windows_make "$W/release/bin/spin-import" "$W/release/bin/spin-export" "$W/release/bin/spin-eval" "$W/release/bin/spin-retrain" \
    "$W/release/bin/spin4d"

# Build the libraries and shims that the commands load on demand.
shared() { # OUT SOURCE OPTION...: builds BUILD/windows/release/OUT
    out=$W/release/$1
    shift
    mkdir -p "${out%/*}" || exit 1
    $host-g++-posix -shared -static -s -Wl,--no-insert-timestamp -Wl,--disable-auto-image-base -O2 -Isrc \
        -ffile-prefix-map="$PWD=." -ffile-prefix-map="$deps=." -o "$out" "$@" ||
        fail "cannot build '$out'"
}
for library in zstd webp; do
    shared bin/lib$library.dll -Wl,--whole-archive "$deps/lib/lib$library.a" -Wl,--no-whole-archive
done
shared lib/spin-image-plain.so "$image" "$W/release/src/base/windows/posix.o" "$deps/lib/libjpeg.a" "$deps/lib/libpng.a" -lz
(source_of tinygltf) && (source_of nlohmann-json3) || exit 1
shared lib/spin-gltf.so -std=c++17 -DTINYGLTF_NO_STB_IMAGE -DTINYGLTF_NO_STB_IMAGE_WRITE -I"$deps/src/tinygltf" \
    -I"$deps/src/nlohmann-json3/include" src/formats/glb_tiny.cpp "$deps/src/tinygltf/tiny_gltf.cc"

rm -rf "${W:?}/$name" "$W/$name.zip"
mkdir -p "$W/$name/bin" "$W/$name/lib/spin4d" "$W/$name/licences" || exit 1
for program in spin4d spin-import spin-retrain spin-eval spin-export; do
    cp "$W/release/bin/$program.exe" "$W/$name/bin/" || exit 1
done
cp "$W"/release/bin/*.dll "$W/$name/bin/" && cp "$W"/release/lib/*.so "$W/$name/lib/spin4d/" &&
    cp LICENSE CHANGELOG.md "$W/$name/" || exit 1
for package in xz-utils jansson libzstd libwebp libjpeg-turbo libpng1.6 tinygltf nlohmann-json3; do
    cp "$deps/src/$package/debian/copyright" "$W/$name/licences/$package.txt" || exit 1
done
for package in libz-mingw-w64 mingw-w64-common gcc-mingw-w64-base; do
    cp -L "/usr/share/doc/$package/copyright" "$W/$name/licences/$package.txt" || exit 1
done
cat >"$W/$name/README.txt" <<README
spin4d $version for 64-bit Windows 10 and newer. Nothing else needs to be installed; this folder can be anywhere.

    bin\\spin4d RUN --data IMAGES -o clip.html

RUN is the folder that a 4D Gaussian Splatting method wrote, IMAGES the data set it was trained on.
For more, see bin\\spin4d --help. Images are PNG and JPEG. Videos, EXR, GPUs, MPI and plug-ins
need Linux or WSL. licences\\ contains the licences of the libraries.
README
sed -i 's/$/\r/' "$W/$name/README.txt"
chmod -R u=rwX,go=rX "$W/$name"
(cd "$W" && find "$name" -exec touch -h -d @1577836800 {} + && find "$name" | LC_ALL=C sort | TZ=UTC zip -q -X "$name.zip" -@) ||
    exit 1
rm -rf "${W:?}/$name"
echo "$W/$name.zip"
