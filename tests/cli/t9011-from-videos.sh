#!/bin/sh
# K: long documents colmap
# The commands of docs/how-to/from-videos.md, in their order, turn videos of court into a page. The
# videos are folders of images, which a script in place of ffmpeg copies.
. tests/cli/lib.sh
scene=../shared/scenes/court
if ! command -v colmap >/dev/null || [ ! -d "$scene/ims" ]; then
    skip "from videos to a clip" "no colmap, or no scene '$scene'"
    done_testing
    exit
fi
mkdir -p "$work/place/videos" "$work/path"
# Every second camera: matching takes most of the time, and grows with the square of their number.
for camera in "$scene"/ims/*[02468]/; do
    film=$(printf 'cam%02d.mp4' "$(basename "$camera")")
    mkdir "$work/place/videos/$film"
    n=0
    for image in "$camera"*; do
        [ $n -lt 2 ] && cp "$image" "$work/place/videos/$film/$(printf '%06d.png' $n)"
        n=$((n + 1))
    done
done
cat >"$work/path/ffmpeg" <<'FFMPEG'
#!/bin/sh
cp "$2"/*.png "$(dirname "$5")"
FFMPEG
# The advice of the document for small images.
cat >"$work/path/colmap" <<COLMAP
#!/bin/sh
case \$1 in
feature_extractor) set -- "\$@" --SiftExtraction.peak_threshold 0.002 ;;
mapper) set -- "\$@" --Mapper.init_min_tri_angle 4 ;;
esac
exec $(command -v colmap) "\$@"
COLMAP
cat >"$work/path/spin4d" <<SPIN4D
#!/bin/sh
exec "$(cd "$bin" && pwd)/spin4d" "\$@" --iterations 20
SPIN4D
ln -s "$(cd "$bin" && pwd)/spin-import" "$work/path/spin-import"
chmod +x "$work"/path/*
{
    echo set -e
    sed -n 's/^    //p' docs/how-to/from-videos.md
} >"$work/script"
# COLMAP draws other random samples each time, also on one thread. Rarely one camera of a model
# diverges to a negative focal length, which spin-import refuses; then all is done once more.
cp -r "$work/place" "$work/again"
(cd "$work/place" && PATH=$work/path:$PATH sh "$work/script") >"$work/out" 2>"$work/err" </dev/null
code=$?
if grep -q "cameras.bin': camera [0-9]*: the focal lengths are" "$work/err"; then
    rm -r "$work/place"
    mv "$work/again" "$work/place"
    (cd "$work/place" && PATH=$work/path:$PATH sh "$work/script") >"$work/out" 2>"$work/err" </dev/null
    code=$?
fi
is "$code" 0 "every command, one after the other"
out_has 'Registered images: [0-9]*$' "COLMAP finds the cameras: $(sed -n 's/.*Registered images: //p' "$work/out" | head -n 1)"
is "$(ls "$work/place/points" | tr '\n' ' ')" "frame000000.ply frame000001.ply " "points of each frame"
out_has '^cameras fit' "the cameras fit: $(sed -n '/^cameras fit/p' "$work/out")"
[ -s "$work/place/clip.html" ]
ok $? "the page"
done_testing
