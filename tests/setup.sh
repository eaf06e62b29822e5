#!/bin/sh
# setup.sh: installs what the build needs and this machine lacks (Debian, Ubuntu), or prints the
# command that does.
# setup.sh --report [CC [CXX]]: prints what is available.
# setup.sh --video: also what videos need, which no build requires.
# setup.sh --lint: also what `make lint` needs.
# setup.sh --tests: also everything without which tests are skipped; packages that cannot be
# installed are reported, without a failure.
CC=${2:-${CC:-gcc}}
CXX=${3:-${CXX:-g++}}

have() { command -v "$1" >/dev/null 2>&1; }

video=
tests=
lint=
case ${1:-} in
--video)
    video='libavformat-dev libavcodec-dev libswscale-dev'
    shift
    ;;
--tests)
    tests=yes
    shift
    ;;
--lint)
    have clang || lint=clang
    shift
    ;;
esac

# One run of the preprocessor finds all missing headers.
missing_headers() {
    printf '%s\n' '#if !__has_include(<zlib.h>)' zlib1g-dev '#endif' \
        '#if !__has_include(<lzma.h>)' liblzma-dev '#endif' \
        '#if !__has_include(<jansson.h>)' libjansson-dev '#endif' \
        '#if !__has_include(<jpeglib.h>)' libjpeg-dev '#endif' \
        '#if !__has_include(<png.h>)' libpng-dev '#endif' \
        '#if !__has_include(<webp/encode.h>)' libwebp-dev '#endif' \
        '#if !__has_include(<zstd.h>)' libzstd-dev '#endif' \
        '#if !__has_include(<OpenImageIO/imageio.h>)' libopenimageio-dev '#endif' \
        '#if !__has_include(<tiny_gltf.h>)' libtinygltf-dev '#endif' \
        ${video:+"#if !__has_include(<libavformat/avformat.h>)" "libavformat-dev" "#endif"} \
        ${video:+"#if !__has_include(<libavcodec/avcodec.h>)" "libavcodec-dev" "#endif"} \
        ${video:+"#if !__has_include(<libswscale/swscale.h>)" "libswscale-dev" "#endif"} |
        $CXX -E -P -x c++ - 2>/dev/null | tr -s '\n' ' '
}

missing_packages() {
    if have make && have "${CC%% *}" && have "${CXX%% *}"; then
        echo "$lint $(missing_headers)"
    elif have "$CXX"; then
        echo "build-essential $(missing_headers)"
    else
        echo build-essential zlib1g-dev liblzma-dev libjansson-dev libjpeg-dev libpng-dev libopenimageio-dev \
            libtinygltf-dev libwebp-dev libzstd-dev "$video"
    fi
}

has_header() { printf '#include <%s>\n' "$1" | $CXX -E -x c++ - >/dev/null 2>&1; }
has_numpy() { "$1" -c 'import numpy' 2>/dev/null; }

# Only tests need these: without them some are skipped.
missing_for_tests() {
    for pair in libavformat-dev:libavformat/avformat.h libavcodec-dev:libavcodec/avcodec.h \
        libswscale-dev:libswscale/swscale.h; do
        has_header "${pair#*:}" || echo "${pair%%:*}"
    done
    has_numpy python3 || has_numpy /usr/bin/python3 || echo python3-numpy
    have strace || echo strace
    have node || echo nodejs
    have mpirun || echo openmpi-bin
    have mpicc || echo libopenmpi-dev
}

version_of() { # header macro: its value, as text
    printf '#include <%s>\nspin4d %s\n' "$1" "$2" | $CXX -E -P -x c++ - 2>/dev/null |
        sed -n 's/^ *spin4d *//p' | tr -d '" '
}

report() {
    for tool in "$CC" "$CXX" make nvcc; do
        if have "${tool%% *}"; then
            found=$($tool --version 2>/dev/null | grep -i -m 1 '[0-9]\.[0-9]')
        elif [ "$tool" = nvcc ]; then
            found='not found in PATH; only the CUDA device needs it'
        else
            found='not found: package build-essential'
        fi
        printf '%-12s %s\n' "$tool:" "$found"
    done
    lacking=" $(missing_headers) "
    while read -r name package header macro; do
        case $lacking in
        *" $package "*) found="not found: package $package" ;;
        *) found=$(version_of "$header" "$macro") ;;
        esac
        printf '%-12s %s\n' "$name:" "$found"
    done <<LIST
zlib zlib1g-dev zlib.h ZLIB_VERSION
liblzma liblzma-dev lzma.h LZMA_VERSION_STRING
jansson libjansson-dev jansson.h JANSSON_VERSION
libjpeg libjpeg-dev jpeglib.h LIBJPEG_TURBO_VERSION
libpng libpng-dev png.h PNG_LIBPNG_VER_STRING
OpenImageIO libopenimageio-dev OpenImageIO/oiioversion.h OIIO_VERSION_STRING
tinygltf libtinygltf-dev tiny_gltf.h found
libwebp libwebp-dev webp/encode.h found
zstd libzstd-dev zstd.h ZSTD_VERSION_MAJOR.ZSTD_VERSION_MINOR.ZSTD_VERSION_RELEASE
LIST
    ffmpeg=$(printf '#include <libavutil/avutil.h>\n#include <libavformat/avformat.h>\n%s\n' \
        '#include <libswscale/swscale.h>' | $CC -E -P -x c - >/dev/null 2>&1 && echo found)
    printf '%-12s %s\n' MPI: "$(have mpicc && mpicc --showme:version 2>/dev/null ||
        echo 'not found; only needed to work with several machines: package libopenmpi-dev')"
    printf '%-12s %s\n' FFmpeg: "${ffmpeg:-not found; only needed to open and write videos: make setup-video}"
}

if [ "${1:-}" = --report ]; then
    report
    exit 0
fi

packages=$(missing_packages | xargs)
more=
[ -n "$tests" ] && more=$(missing_for_tests | xargs)
[ -z "$packages$more" ] && exit 0

as_root=
if [ "$(id -u)" != 0 ]; then
    as_root=sudo
fi
install='apt-get install -y --no-install-recommends'
can_install=
if have apt-get && { [ -z "$as_root" ] || { have sudo && sudo -n true 2>/dev/null; }; }; then
    can_install=yes
    echo "setup: installing $packages $more" >&2
    export DEBIAN_FRONTEND=noninteractive
    $as_root apt-get update >&2 || echo 'setup: apt-get update failed, trying to install all the same' >&2
    # shellcheck disable=SC2086
    if [ -n "$packages" ] && ! $as_root $install $packages >&2; then
        echo "setup: could not install; type: ${as_root:+sudo }$install $packages" >&2
        exit 1
    fi
    have clang && lint=
    # One by one, since a package that this distribution lacks must not prevent the others.
    for package in $more; do
        $as_root $install "$package" >&2
    done
    packages=$(missing_packages | xargs)
    [ -n "$tests" ] && more=$(missing_for_tests | xargs)
fi
[ -n "$more" ] && echo "setup: some tests will be skipped without: $more" >&2
[ -z "$packages" ] && exit 0
if [ -n "$can_install" ]; then
    echo "setup: still missing after the installation: $packages" >&2
    exit 1
fi
echo "setup: missing packages; type:" >&2
echo "    sudo apt-get update && sudo $install $packages" >&2
exit 1
