#!/bin/sh
# hero.sh BIN_DIR BUNDLE OUT.webp [CAMERA] [BEFORE]: creates an animation for README.md. It shows
# the test views of a retrained bundle. A vertical line moves from side to side; the image shows the
# source's splats, or those of the bundle BEFORE, on its left and the retrained splats on its right.
# BEFORE: the bundle on whose renders the other one was retrained. Needs ffmpeg with libwebp
# (Debian: ffmpeg).
usage="usage: hero.sh BIN_DIR BUNDLE OUT.webp [CAMERA] [BEFORE]"
bin=${1:?$usage} bundle=${2:?$usage} out=${3:?$usage} camera=${4:-00} before=$5
width=640 height=360 rate=10 seconds=5.4
MOST=2000000
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT

command -v ffmpeg >/dev/null || { echo "hero: ffmpeg not found (Debian: ffmpeg)" >&2; exit 1; }
# write_panel OF PANEL OPTIONS: writes the images of one panel
write_panel() {
    of=$1 panel=$2
    shift 2
    "$bin/spin-export" -q "$of" --to images --panels "$panel" --no-labels --size ${width}x$height -o "$work/$panel" "$@" || exit 1
}
if [ -n "$before" ]; then
    write_panel "$before" after --data renders
    mv "$work/after" "$work/before"
else
    write_panel "$bundle" before
fi
write_panel "$bundle" after
[ -n "$(ls "$work/after/cam_${camera}"_* 2>/dev/null)" ] || { echo "hero: camera $camera is not a held-out camera of the bundle" >&2; exit 1; }
# The line is at X = (0.5 - 0.5 cos(2 pi T / seconds)) W, white and two pixels wide.
at="W*(0.5-0.5*cos(2*PI*T/$seconds))"
read_images="-stream_loop -1 -framerate $rate -pattern_type glob"
ffmpeg -v error -y $read_images -i "$work/before/cam_${camera}_*.png" $read_images -i "$work/after/cam_${camera}_*.png" \
    -t $seconds -filter_complex "[0]format=gbrp[before]; [1]format=gbrp[after];
    [before][after]blend=all_expr='if(lt(abs(X-$at)\,1)\,255\,if(lt(X\,$at)\,A\,B))'" \
    -c:v libwebp_anim -quality 72 -compression_level 6 -loop 0 "$out" || exit 1
bytes=$(wc -c <"$out")
[ "$bytes" -le $MOST ] || { echo "hero: '$out' has $bytes bytes, more than $MOST" >&2; exit 1; }
echo "$out: $bytes bytes"
