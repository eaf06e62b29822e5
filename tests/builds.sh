#!/bin/sh
# builds.sh BUILD [PART...]: builds that `make test` does not make, each in a folder of its own
# below BUILD. Stops at the first part that fails. The last four parts run only if they are named.
#
#   gcc, clang  without warnings, with the tests of math, device and io
#   paths       these tests on the SIMD paths base and v3 of the CPU, in the build of `make`
#   bytes       the last commit twice, in two folders, inside and outside the tree: identical files
#   deb         make deb, with its tests and lintian
#   portable    make portable DEBIAN=bullseye, and its package in bare Debians of other suites, as
#               root with debootstrap
#   web         make web, and its page compared with the build of `make`
#   windows     make windows, and its package under Wine compared with the build of `make`
#   arm64       the cross compiler, and these tests under QEMU
BUILD=${1:?usage: builds.sh BUILD [PART...]}
shift
[ $# -gt 0 ] || set -- gcc clang paths bytes deb
words='tests/math tests/device tests/io'
jobs=$(nproc)

fail() {
    echo "test-builds: $*" >&2
    exit 1
}

# built FOLDER VARIABLE=VALUE...: builds the commands and these tests
built() {
    folder=$1
    shift
    programs=
    for source in tests/math/t-*.c tests/device/t-*.c tests/io/t-*.c; do
        programs="$programs $folder/release/${source%.c}"
    done
    mkdir -p "$folder"
    # shellcheck disable=SC2086
    make -s -j"$jobs" BUILD="$folder" CUDA=0 "$@" all test-tools $programs 2>"$folder/stderr" || {
        tail -n 30 "$folder/stderr"
        fail "does not build: $*"
    }
    [ ! -s "$folder/stderr" ] || {
        cat "$folder/stderr"
        fail "builds with warnings: $*"
    }
}

tested() { # FOLDER
    JOBS=$jobs sh tests/run.sh "$1" "$words" || fail "$1: $words"
}

same_bytes() {
    rm -rf "$BUILD/bytes"
    mkdir -p "$BUILD/bytes/a" "$BUILD/bytes/another-folder"
    for tree in a another-folder; do
        git archive HEAD | tar -xf - -C "$BUILD/bytes/$tree" || fail "git archive"
    done
    # A compiler cache would return the objects of the first build to the second.
    export CCACHE_DISABLE=1
    make -s -j"$jobs" -C "$BUILD/bytes/a" CUDA=0 all || fail "does not build"
    (cd "$BUILD/bytes" && make -s -j"$jobs" -f another-folder/Makefile CUDA=0 all) || fail "does not build elsewhere"
    (cd "$BUILD/bytes/a/build/release" && find bin lib libspin.* -type f | LC_ALL=C sort) >"$BUILD/bytes/list"
    while read -r file; do
        cmp "$BUILD/bytes/a/build/release/$file" "$BUILD/bytes/build/release/$file" || fail "bytes differ"
    done <"$BUILD/bytes/list"
    echo "$(wc -l <"$BUILD/bytes/list") files, the same bytes"
}

mkdir -p "$BUILD" || exit 1
BUILD=$(cd "$BUILD" && pwd)
unset MAKEFLAGS MFLAGS MAKELEVEL
for part in "$@"; do
    echo "== $part"
    case $part in
    gcc)
        built "$BUILD/gcc" CC=gcc CXX=g++
        tested "$BUILD/gcc/release"
        ;;
    clang)
        built "$BUILD/clang" CC=clang CXX=clang++
        tested "$BUILD/clang/release"
        ;;
    paths)
        built "$BUILD"
        for path in base v3; do
            echo "-- SPIN_CPU=$path"
            SPIN_CPU=$path
            export SPIN_CPU
            tested "$BUILD/release"
            unset SPIN_CPU
        done
        ;;
    bytes) (same_bytes) || exit 1 ;;
    deb) make -s BUILD="$BUILD" deb || exit 1 ;;
    portable)
        make -s BUILD="$BUILD" DEBIAN=bullseye portable || exit 1
        for suite in bullseye bookworm trixie sid; do
            root=$BUILD/bare-$suite
            [ -f "$root/etc/debian_version" ] ||
                debootstrap --variant=minbase "$suite" "$root" >"$BUILD/bare-$suite.log" 2>&1 || fail "no Debian '$suite'"
            rm -rf "$root/try" && mkdir "$root/try" || exit 1
            cp -R "$BUILD"/spin4d-*-linux-*.tar.gz tests/portable.sh fixtures/court-mini "$root/try/" || exit 1
            echo "-- $suite"
            # shellcheck disable=SC2016
            unshare -m sh -c 'mount -t proc proc "$0/proc" && exec chroot "$0" sh -c "sh /try/portable.sh /try/*.gz /try/court-mini"' \
                "$root" || fail "not in '$suite'"
        done
        ;;
    web)
        make -s -j"$jobs" BUILD="$BUILD" CUDA=0 all || fail "does not build"
        make -s -j"$jobs" BUILD="$BUILD" web || fail "does not build for the browser"
        sh tests/web/run.sh "$BUILD" "$BUILD/release/bin" || exit 1
        ;;
    windows)
        make -s -j"$jobs" BUILD="$BUILD" CUDA=0 all test-tools || fail "does not build"
        make -s BUILD="$BUILD" JOBS="$jobs" windows || fail "does not build for Windows"
        sh tests/windows.sh "$BUILD"/windows/spin4d-*-windows-x86_64.zip "$BUILD/release" || exit 1
        ;;
    arm64)
        for tool in aarch64-linux-gnu-gcc aarch64-linux-gnu-g++ qemu-aarch64; do
            command -v $tool >/dev/null || fail "no $tool: CONTRIBUTING.md says what arm64 needs"
        done
        SPIN_RUN='qemu-aarch64'
        built "$BUILD/arm64" CC=aarch64-linux-gnu-gcc CXX=aarch64-linux-gnu-g++ AR=aarch64-linux-gnu-ar \
            MPICC= RUN="$SPIN_RUN"
        export SPIN_RUN
        tested "$BUILD/arm64/release"
        unset SPIN_RUN
        ;;
    *) fail "no part is called '$part'" ;;
    esac
done
