#!/bin/sh
# Each header compiles alone, as C; those in math/ also as C++, plain and with the qualifiers that
# nvcc would see, so that a machine without nvcc detects headers that CUDA would refuse. Those of
# the CUDA device itself compile as CUDA C++, by the emulation. A header that a C file includes
# before anything else is not compiled here: the build has shown that it is self-contained.
CC=${1:-gcc}
CXX=${2:-g++}
flags='-Isrc -I. -D_GNU_SOURCE -Wall -Wextra -fsyntax-only'
nvcc='-D__CUDACC__ -D__host__= -D__device__= -D__global__= -D__forceinline__=inline'
failed=0
n=0

# Compiles a file that includes only this header. `how` is the compiler and its flags.
try() {
    how=$1
    if ! echo "#include \"$header\"" | $how -Werror $flags -; then
        echo "headers: $path does not compile alone: $how"
        failed=1
    fi
}

# Headers that are included in the first code line of a C file.
first=$(find src importers exporters -name '*.c' ! -path 'src/base/windows/*' -exec awk '
    FNR == 1 { done = 0 }
    done || !/^ *#/ { next }
    { done = 1 }
    match($0, /^#include "[^"]*"/) { print substr($0, 11, RLENGTH - 11) }' {} +)

for path in $(find src importers exporters -name '*.h' | sort); do
    header=${path#src/}
    case $header in
    base/windows/*) continue ;; # for Windows: it stands before every source there
    esac
    n=$((n + 1))
    case $header in
    device/cuda/shim.h) ;;
    device/cuda/*)
        try "$CXX -std=c++14 -x c++ -DSPIN_EMU -include tests/emu/emu.h -Wno-unused-function"
        continue
        ;;
    esac
    case "
$first
" in
    *"
$header
"*) ;;
    *) try "$CC -std=gnu11 -x c -DSPIN_CPU_PATH=base" ;;
    esac
    case $header in
    spin.h | spin_train.h | spin_run.h) try "$CXX -std=c++17 -x c++" ;;
    math/*)
        try "$CXX -std=c++17 -x c++"
        try "$CXX -std=c++17 -x c++ $nvcc -Wno-unused-function"
        ;;
    esac
done
[ $failed = 0 ] && echo "headers: $n compile alone"
exit $failed
