#!/bin/sh
# hero.sh BIN_DIR BUNDLE OUT.webp [CAMERA]: creates the animation in README.md. It shows the test
# views of a retrained bundle. A vertical line moves from side to side; the image shows the source's
# splats on its left and the retrained splats on its right. Needs ffmpeg with libwebp (Debian:
# ffmpeg).
bin=${1:?usage: hero.sh BIN_DIR BUNDLE OUT.webp [CAMERA]}
bundle=${2:?usage: hero.sh BIN_DIR BUNDLE OUT.webp [CAMERA]}
out=${3:?usage: hero.sh BIN_DIR BUNDLE OUT.webp [CAMERA]}
camera=${4:-00}
width=640 height=360 rate=10 seconds=5.4
MOST=2000000
work=$(mktemp -d) || exit 1
trap 'rm -rf "$work"' EXIT

command -v ffmpeg >/dev/null || { echo "hero: ffmpeg not found (Debian: ffmpeg)" >&2; exit 1; }
"$bin/spin-export" -q "$bundle" --to images --panels before,after --no-labels --size ${width}x$height -o "$work/pictures" || exit 1
[ -n "$(ls "$work/pictures/cam_${camera}"_* 2>/dev/null)" ] || { echo "hero: camera $camera is not a held-out camera of the bundle" >&2; exit 1; }
# The line is at X = (0.5 - 0.5 cos(2 pi T / seconds)) W, white and two pixels wide.
at="W*(0.5-0.5*cos(2*PI*T/$seconds))"
ffmpeg -v error -y -stream_loop -1 -framerate $rate -pattern_type glob -i "$work/pictures/cam_${camera}_*.png" -t $seconds -filter_complex "
    [0]format=gbrp,split[l][r]; [l]crop=$width:$height:0:0[before]; [r]crop=$width:$height:$width:0[after];
    [before][after]blend=all_expr='if(lt(abs(X-$at)\,1)\,255\,if(lt(X\,$at)\,A\,B))'" \
    -c:v libwebp_anim -quality 72 -compression_level 6 -loop 0 "$out" || exit 1
bytes=$(wc -c <"$out")
[ "$bytes" -le $MOST ] || { echo "hero: '$out' has $bytes bytes, more than $MOST" >&2; exit 1; }
echo "$out: $bytes bytes"
