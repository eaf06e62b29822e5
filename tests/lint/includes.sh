#!/bin/sh
# Checks includes against this table, the diagram of docs/architecture.md.
#
#     cmd                  -> spin.h base/program.h base/text.h io/json.h io/template.h cmd, and
#                             train/options.def, which is data
#     importers            -> spin.h formats geometry io math base, and headers of their own room
#     exporters            -> spin.h formats geometry io math base, and headers of their own room
#     run                  -> every room below, of formats only gaussian.h
#     train                -> spin.h eval render model scene device/*.h io math base train
#     eval                 -> spin.h render model scene device/*.h io math base eval
#     render               -> spin.h model scene device/*.h io math base render
#     model                -> spin.h device/*.h io math base model
#     scene                -> spin.h geometry io math base scene
#     geometry             -> spin.h math base geometry
#     formats              -> spin.h io math base formats
#     device               -> spin.h device math base;  a device sees device.h and its own folder
#     io                   -> spin.h base io
#     base                 -> spin.h base
#     math                 -> math
#
# spin.h includes nothing of ours. train and run may also include spin_train.h, and only run and cmd
# spin_run.h. Tests may include anything of ours.

# file, pattern of the files of ours that it may include
ours() {
    case $1 in
    src/spin.h) echo '^$' ;;
    src/spin_train.h) echo '^spin\.h$' ;;
    src/spin_run.h) echo '^spin_train\.h$' ;;
    src/cmd/*) echo '^(spin(_run)?\.h|base/(program|text)\.h|io/(json|template)\.h|cmd/.*|train/options\.def)$' ;;
    importers/*) echo '^(spin\.h|(formats|geometry|io|math|base|importers)/.*)$' ;;
    exporters/*) echo '^(spin\.h|(formats|geometry|io|math|base|exporters)/.*)$' ;;
    src/run/*) echo '^(spin(_run)?\.h|formats/gaussian\.h|device/[a-z_]+\.h|(train|eval|render|model|scene|geometry|io|math|base|run)/.*)$' ;;
    src/train/*) echo '^(spin(_train)?\.h|device/[a-z_]+\.h|(eval|render|model|scene|geometry|io|math|base|train)/.*)$' ;;
    src/eval/*) echo '^(spin\.h|device/[a-z_]+\.h|(render|model|scene|io|math|base|eval)/.*)$' ;;
    src/render/*) echo '^(spin\.h|device/[a-z_]+\.h|(model|scene|io|math|base|render)/.*)$' ;;
    src/model/*) echo '^(spin\.h|device/[a-z_]+\.h|(io|math|base|model)/.*)$' ;;
    src/formats/*) echo '^(spin\.h|(io|math|base|formats)/.*)$' ;;
    src/geometry/*) echo '^(spin\.h|(math|base|geometry)/.*)$' ;;
    src/scene/*) echo '^(spin\.h|(geometry|io|math|base|scene)/.*)$' ;;
    src/device/device.c) echo '^(spin\.h|device/device\.h|device/[a-z]+/[a-z]+\.h|base/.*)$' ;;
    src/device/cpu/*) echo '^(spin\.h|device/(device|pairs)\.h|device/cpu/.*|(math|base)/.*)$' ;;
    src/device/cuda/*) echo '^(spin\.h|device/(device|pairs)\.h|device/cuda/.*|(math|base)/.*)$' ;;
    src/device/*.h) echo '^(spin\.h|device/device\.h|(math|base)/.*)$' ;;
    src/io/*) echo '^(spin\.h|(base|io)/.*)$' ;;
    src/base/*) echo '^(spin\.h|base/.*)$' ;;
    src/math/*) echo '^math/.*$' ;;
    *) echo '.' ;;
    esac
}

# file, pattern of what it may include besides libc and POSIX
foreign() {
    case $1 in
    src/io/file.c | src/io/zip.c | src/io/zip_writer.c | src/io/gzip.c | src/io/stream.c) echo '^zlib\.h$' ;;
    src/base/windows/*) echo '^[a-z]+\.h$' ;;
    src/io/xz.c) echo '^lzma\.h$' ;;
    src/web/shim.c) echo '^(webp/(de|en)code|zstd|zstd_errors)\.h$' ;;
    src/io/webp.c) echo '^webp/(de|en)code\.h$' ;;
    src/io/zstd.c) echo '^zstd(_errors)?\.h$' ;;
    src/io/json.[ch]) echo '^jansson\.h$' ;;
    src/io/image_oiio.cpp) echo '^(OpenImageIO/.*|[a-z_]+)$' ;;
    src/io/image_plain.c) echo '^(jpeglib|jerror|png)\.h$' ;;
    src/formats/glb_tiny.cpp) echo '^(tiny_gltf\.h|[a-z_]+)$' ;;
    src/io/video_ffmpeg.c | src/io/video_encode_ffmpeg.c | src/io/video_sound_ffmpeg.c) echo '^lib(avcodec|avformat|avutil|swresample|swscale)/.*\.h$' ;;
    src/io/ranks_mpi.c) echo '^mpi\.h$' ;;
    src/device/cpu/*) echo '^[a-z0-9]*intrin\.h$|^arm_neon\.h$' ;;
    src/device/cuda/*) echo '^(cuda.*|cub/.*|cooperative_groups.*)$' ;;
    src/base/mem.c) echo '^sanitizer/asan_interface\.h$' ;;
    *) echo '^$' ;;
    esac
}

libc='^(assert|ctype|dirent|dlfcn|errno|fcntl|fenv|float|glob|inttypes|limits|locale|math|pthread|'
libc=$libc'sched|setjmp|signal|stdarg|stdatomic|stdbool|stddef|stdint|stdio|stdlib|string|strings|'
libc=$libc'time|unistd|sys/[a-z]+|cstdint|cstdio|cstdlib|cstring|cmath)(\.h)?$'

files=$(find src importers exporters -name '*.[ch]' -o -name '*.cpp' -o -name '*.cu' -o -name '*.cuh' | sort)
said=$(for file in $files; do
    echo "$file"
    ours "$file"
    foreign "$file"
done | LIBC=$libc awk '
    function there(path, line, found) { found = (getline line <path) >= 0; close(path); return found }
    NR % 3 == 1 { file = $0 }
    NR % 3 == 2 { may = $0 }
    NR % 3 { next }
    {
        while ((getline line <file) > 0) {
            if (line !~ /^ *# *include *("[^"]*"|<[^>]*>)/)
                continue
            n++
            split(line, part, /["<>]/)
            header = part[2]
            if (line ~ /include *</) {
                if (header !~ ENVIRON["LIBC"] && header !~ $0)
                    print "includes: " file " may not include <" header ">"
                continue
            }
            if (header !~ may)
                print "includes: " file " may not include \"" header "\""
            if (!there("src/" header) && !there(header))
                print "includes: " file ": no such file \"" header "\""
        }
        close(file)
    }
    END { print n }')
arrows=$(echo "$said" | tail -n 1)

# Names that belong to one list: a plug-in is named only by itself and by the list, a device only in
# src/device.
said=$(echo "$said" | sed '$d'
    grep -rowE 'spin_(im|ex)porter_[a-z0-9_]+' src importers exporters | sort -u | while IFS=: read -r file name; do
        plugin=${name#spin_*porter_}
        list=${name#spin_}
        list=${list%%_*}s
        case $file in
        "$list/$list.c" | "$list/$plugin.c") ;;
        *) [ ! -f "$list/$plugin.c" ] || echo "includes: $file names the plug-in '$plugin'" ;;
        esac
    done
    grep -rlE '\<spin_(cpu|cuda)_' src importers exporters | grep -v '^src/device/' | sed 's/.*/includes: & names a device/')

[ -z "$said" ] && echo "includes: $arrows arrows, all in the drawing" && exit
echo "$said"
exit 1
