#!/bin/sh
# deps.sh FOLDER: compiles the libraries that spin4d needs from Debian's sources to WebAssembly,
# into FOLDER/usr. Needs emscripten, cmake, libtinygltf-dev, nlohmann-json3-dev, and deb-src in
# apt's sources. This takes some minutes. If FOLDER/usr is complete, the script does nothing.
to=${1:?usage: deps.sh FOLDER}
usr=$(realpath -m "$to")/usr
[ ! -f "$usr/done" ] || exit 0
export NODE_PATH=/usr/share/nodejs # Debian's emscripten needs acorn from this folder

fail() {
    echo "deps.sh: $*" >&2
    exit 1
}

# build NAME COMMAND...: runs COMMAND in the source folder of NAME; the log is FOLDER/NAME.log
build() {
    name=$1
    shift
    echo "  WASM     $name"
    (cd "$to/$name"-*/ && "$@") >"$to/$name.log" 2>&1 || fail "cannot build $name: see '$to/$name.log'"
}

by_cmake() {
    source=$1
    shift
    emcmake cmake -S "$source" -B build -DCMAKE_BUILD_TYPE=Release -DBUILD_SHARED_LIBS=OFF \
        -DCMAKE_INSTALL_PREFIX="$usr" "$@" && emmake make -C build install
}

by_configure() {
    CFLAGS=-O2 emconfigure ./configure --prefix="$usr" "$@"
}

of_zlib() {
    by_configure --static && emmake make libz.a && cp zlib.h zconf.h "$usr/include" && cp libz.a "$usr/lib"
}

of_xz() {
    by_configure --host=wasm32-unknown-emscripten --disable-shared --disable-threads --disable-xz --disable-xzdec \
        --disable-lzmadec --disable-lzmainfo --disable-scripts --disable-doc --disable-nls --disable-assembler &&
        emmake make -C src/liblzma install
}

of_webp() {
    off=
    for part in ANIM_UTILS CWEBP DWEBP GIF2WEBP IMG2WEBP VWEBP WEBPINFO WEBPMUX EXTRAS; do
        off="$off -DWEBP_BUILD_$part=OFF"
    done
    # shellcheck disable=SC2086
    by_cmake . $off
}

for tool in emcc cmake apt-get; do
    command -v $tool >/dev/null || fail "$tool not found: apt-get install emscripten cmake dpkg-dev"
done
for header in tiny_gltf.h nlohmann/json.hpp; do
    [ -f "/usr/include/$header" ] || fail "$header not found: apt-get install libtinygltf-dev nlohmann-json3-dev"
done
mkdir -p "$usr/include/nlohmann" "$usr/lib" || exit 1
# If the newest source is no longer in the archive, the source of the original release is used.
release=$(sed -n 's/^VERSION_CODENAME=//p' /etc/os-release)
for package in zlib xz-utils jansson libzstd libwebp; do
    (cd "$to" && { apt-get source -q "$package" || apt-get source -q "$package/$release"; }) >>"$to/source.log" 2>&1 ||
        fail "apt-get source failed, see '$to/source.log': check that apt's sources have a deb-src line"
done
build zlib of_zlib
build xz-utils of_xz
build jansson by_cmake . -DJANSSON_BUILD_DOCS=OFF -DJANSSON_EXAMPLES=OFF -DJANSSON_WITHOUT_TESTS=ON
build libzstd by_cmake build/cmake -DZSTD_BUILD_PROGRAMS=OFF -DZSTD_BUILD_SHARED=OFF -DZSTD_MULTITHREAD_SUPPORT=OFF
build libwebp of_webp
cp /usr/include/tiny_gltf.h "$usr/include/" && cp -RL /usr/include/nlohmann "$usr/include/" && touch "$usr/done"
