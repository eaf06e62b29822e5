#!/bin/sh
# portable.sh TARBALL CLIP: the package of `make portable` works by itself: with an empty
# environment, from another folder, with no library but its own and the C library's. CLIP:
# fixtures/court-mini, or a copy. Needs a shell, tar and gzip.
tarball=$(realpath "${1:?usage: portable.sh TARBALL CLIP}")
clip=$(realpath "${2:?usage: portable.sh TARBALL CLIP}")
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT

fail() {
    echo "portable: $*" >&2
    [ ! -s "$work/err" ] || tail -n 5 "$work/err" >&2
    exit 1
}

tar -C "$work" -xf "$tarball" || fail "'$tarball' is no tarball"
tree=$(echo "$work"/spin4d-*)
cd "$work" || exit 1

# alone COMMAND ARGUMENT...: fails the test if the command fails or loads a library from elsewhere
alone() {
    command=$1
    shift
    env -i LD_DEBUG=libs LD_DEBUG_OUTPUT="$work/loads" "$tree/bin/$command" "$@" >"$work/out" 2>"$work/err" </dev/null ||
        fail "$command $* ends with $?"
    sed -n 's/.*calling init: //p' loads.* >>inits && rm loads.*
    others=$(sort -u inits | grep -v "^$tree/" | grep -v -E '/(libc|libm|libdl|libpthread|librt|ld-linux[^/]*)\.so')
    [ -z "$others" ] || fail "libraries from elsewhere: $others"
}

alone spin4d "$clip" --iterations 5 -o clip.html
[ -s clip.html ] || fail "no page"
alone spin-eval clip.spin --report report.html
grep -q PSNR report.html || fail "no report"
for format in ply compressed-ply spz sog splat gltf usd images tsog; do
    alone spin-export clip.spin --to $format -o "to-$format"
    [ -e "to-$format" ] || fail "no $format"
    case $format in
    images) ;; # not read
    *) alone spin-import "to-$format" -o "from-$format.spin" ;;
    esac
done
alone spin-export clip.spin --to spz --spz-version 3 -o zstd
alone spin-import zstd -o from-zstd.spin
grep -q "^$tree/.*/libwebp" inits || fail "what the commands load is not seen"
echo "portable: works"
