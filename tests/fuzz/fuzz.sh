#!/bin/sh
# fuzz.sh NAME [SECONDS]: build tests/fuzz/fuzz-NAME.c with clang's libFuzzer and run it.
#
# The corpus grows in build/fuzz/NAME/corpus; it begins with fixtures/hostile/NAME and the files
# named in SEEDS; words of the format come from tests/fuzz/NAME.dict. A find is written to
# build/fuzz/NAME; once fixed it belongs in the former.
TARGETS=$(ls tests/fuzz | sed -n 's/^fuzz-\(.*\)\.c$/\1/p' | tr '\n' ' ')
NAME=${1:?name a target: $TARGETS}
SECONDS_=${2:-60}
SOURCE=tests/fuzz/fuzz-$NAME.c
DIR=build/fuzz/$NAME

[ -f "$SOURCE" ] || { echo "no fuzz target '$NAME': it is one of $TARGETS" >&2; exit 2; }
command -v clang >/dev/null || { echo "fuzzing needs clang" >&2; exit 2; }
mkdir -p "$DIR/corpus"

FLAGS="-std=gnu11 -g -O1 -Isrc -I. -D_GNU_SOURCE -pthread -fno-sanitize-recover=undefined"
SANITIZE=-fsanitize=fuzzer-no-link,address,undefined

# An archive of what readers are made of, so that a target links only what it calls.
for source in src/base/*.c src/io/*.c src/formats/*.c src/geometry/*.c src/scene/*.c src/device/*.c src/device/cpu/*.c src/model/*.c \
    src/render/*.c importers/*.c importers/lib/*.c; do
    case $source in src/io/video*ffmpeg.c | src/io/ranks_mpi.c) continue ;; esac # shims, opened at run time
    object=build/fuzz/lib/${source%.c}.o
    [ "$object" -nt "$source" ] && continue
    mkdir -p "$(dirname "$object")"
    path= # the one code path of the CPU device
    case $source in src/device/cpu/*) path=-DSPIN_CPU_PATH=base ;; esac
    # shellcheck disable=SC2086
    clang $FLAGS $SANITIZE $path -c -o "$object" "$source" || exit 1
done
# The loader of plug-ins names the list of exporters, which no reader needs.
echo 'const void *const spin_exporters[1];' | clang -x c -c -o build/fuzz/lib/exporters.o - || exit 1
rm -f build/fuzz/lib/lib.a
find build/fuzz/lib -name '*.o' -exec ar rcs build/fuzz/lib/lib.a {} +
# shellcheck disable=SC2086
clang $FLAGS -fsanitize=fuzzer,address,undefined -o "$DIR/fuzz-$NAME" "$SOURCE" \
    build/fuzz/lib/lib.a -lz -ljansson -llzma -ldl -lm || exit 1

words=
[ -f "tests/fuzz/$NAME.dict" ] && words=-dict=tests/fuzz/$NAME.dict
find=
[ -d "fixtures/hostile/$NAME" ] && find=fixtures/hostile/$NAME
# shellcheck disable=SC2086
for f in ${SEEDS:-}; do
    cp "$f" "$DIR/corpus/seed-$(echo "$f" | tr '/' '_')"
done
# shellcheck disable=SC2086
exec "$DIR/fuzz-$NAME" -max_total_time="$SECONDS_" -timeout=10 -rss_limit_mb=4096 -max_len=65536 \
    -artifact_prefix="$DIR/" -print_final_stats=1 $words "$DIR/corpus" $find
