#!/bin/sh
# Each header compiles alone, as C; those in math/ also as C++, plain and with the qualifiers that nvcc
# would see, so that a machine without nvcc still notices a header that CUDA would refuse. Those of the CUDA device
# itself compile as CUDA C++, by the emulation.
CC=${1:-gcc}
CXX=${2:-g++}
flags='-Isrc -I. -D_GNU_SOURCE -Wall -Wextra -fsyntax-only'
nvcc='-D__CUDACC__ -D__host__= -D__device__= -D__global__= -D__forceinline__=inline'
failed=0
n=0

# What a file that includes only this header would see. `how` is the compiler and its flags.
try() {
    how=$1
    if ! echo "#include \"$header\"" | $how -Werror $flags -; then
        echo "headers: $path does not compile alone: $how"
        failed=1
    fi
}

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
    try "$CC -std=gnu11 -x c -DSPIN_CPU_PATH=base"
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
