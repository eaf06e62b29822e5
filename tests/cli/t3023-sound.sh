#!/bin/sh
# K: sound export import 4dgs tsog bundle
# A sound track through a bundle to every format, byte for byte or with a word, cut with the frames.
. tests/cli/lib.sh

if ! command -v python3 >/dev/null 2>&1; then
    skip "sound" "no python3"
    done_testing
fi
python3 tests/tools/sound.py tone "$work/tone.wav" 3
run "$bin/spin-import" fixtures/4dgs/birth_sh2/scene.4dgs -o "$work/silent.spin"
is "$code" 0 "a clip of 4 seconds, without sound"

# described WHAT: a member of the sound in the report
described() {
    python3 -c 'import json, sys; print(*(json.load(open(sys.argv[1]))["sound"][k] for k in sys.argv[2:]))' "$work/out" "$@"
}

# file NAME: the sound in a bundle, .4dgs or .tsog
file() {
    python3 tests/tools/sound.py "$@"
}

# ---- Through a bundle ----------------------------------------------------------------------------

run "$bin/spin-export" "$work/silent.spin" -o "$work/a.4dgs" --sound "$work/tone.wav"
is "$code" 0 "--sound adds a sound to .4dgs"
[ ! -s "$work/err" ] || ! grep -q sound "$work/err"
ok $? "and says nothing, since all of it is kept"
file extract "$work/a.4dgs" "$work/a.wav"
cmp -s "$work/a.wav" "$work/tone.wav"
ok $? "the file contains it byte for byte"
python3 tests/tools/check_4dgs.py "$work/a.4dgs" >"$work/out" 2>"$work/err"
is $? 0 "by the rules of the format"
run "$bin/spin-import" "$work/a.4dgs" -o "$work/a.spin" --json
is "$(described name type)" "tone wav" "the import reports it"
file extract "$work/a.spin" "$work/a.wav"
cmp -s "$work/a.wav" "$work/tone.wav"
ok $? "and keeps it in the bundle"
run "$bin/spin-import" "$work/a.spin" --info
out_has "^sound       tone, wav, 48 kB" "--info shows it"
run "$bin/spin-export" "$work/a.spin" -o "$work/b.4dgs"
file extract "$work/b.4dgs" "$work/a.wav"
cmp -s "$work/a.wav" "$work/tone.wav"
ok $? "the export of the bundle has it as well"
run "$bin/spin-export" "$work/a.spin" -o "$work/none.4dgs" --sound none
file extract "$work/none.4dgs" "$work/a.wav"
[ ! -s "$work/a.wav" ]
ok $? "unless it is not wanted"

# Frames: keyframes and deltas, and TSOG.
run "$bin/spin-import" "$work/a.4dgs" -o "$work/frames.spin" --frames 5
out_has "change the speed of the clip, but not that of its sound" "the import of sampled frames says so"
run "$bin/spin-import" "$work/a.4dgs" -o "$work/all.spin" --frames 120
! grep -q "change the speed" "$work/out"
ok $? "unless these are all frames"
run "$bin/spin-export" "$work/frames.spin" -o "$work/f.4dgs" --sound "$work/tone.wav"
python3 tests/tools/check_4dgs.py "$work/f.4dgs" >"$work/out" 2>"$work/err"
is $? 0 "keyframes with sound, by the rules of the format"
run "$bin/spin-export" "$work/frames.spin" -o "$work/f.tsog" --sound "$work/tone.wav"
is "$code" 0 "TSOG with sound"
file extract "$work/f.tsog" "$work/a.wav"
cmp -s "$work/a.wav" "$work/tone.wav"
ok $? "byte for byte"
run "$bin/spin-import" "$work/f.tsog" -o "$work/f.spin" --json
is "$(described name type)" "tone wav" "which the import reads back"

# .sogst: in the part of meta.json for private data.
run "$bin/spin-import" fixtures/ftgs_ply/sh1_clamped/scene.ftgs.ply -o "$work/rows.spin"
for segment in 0 0.5; do
    run "$bin/spin-export" "$work/rows.spin" -o "$work/s$segment.sogst" --sound "$work/tone.wav" --segment $segment --check
    is "$code" 0 ".sogst with sound, segments of $segment s"
    err_has "players do not play the sound 'tone' of a .sogst: it is stored for spin-import" "says who reads it"
    file extract "$work/s$segment.sogst" "$work/a.wav"
    cmp -s "$work/a.wav" "$work/tone.wav"
    ok $? "byte for byte"
    run "$bin/spin-import" "$work/s$segment.sogst" -o "$work/s.spin" --force --json
    is "$(described name type)" "tone wav" "which the import reads back"
done
python3 - "$work/s0.sogst" "$work/other.sogst" "$work/bad.sogst" <<'P'
import json, sys, zipfile
source, other, bad = sys.argv[1:]
for path, audio in (other, {"artist": "somebody"}), (bad, {"file": "none.wav", "spin4d": {}}):
    old = zipfile.ZipFile(source)
    with zipfile.ZipFile(path, "w") as new:
        for name in old.namelist():
            data = old.read(name)
            if name == "meta.json":
                meta = json.loads(data)
                meta["asset"]["audio"] = audio
                data = json.dumps(meta)
            new.writestr(name, data)
P
run "$bin/spin-import" "$work/other.sogst" -o "$work/other.spin"
is "$code" 0 "private data of other programs are ignored"
file extract "$work/other.spin" "$work/a.wav" 2>/dev/null
is "$?" 1 "there is no sound"
run "$bin/spin-import" "$work/bad.sogst" -o "$work/bad.spin"
fails 1 spin-import "a sound that is missing"
err_has "sound 'none.wav' is missing" "names it"

# ---- Cut with the frames -------------------------------------------------------------------------

run "$bin/spin-export" "$work/a.spin" -o "$work/cut.4dgs" --range 30:90
file extract "$work/cut.4dgs" "$work/a.wav"
is "$(file heard "$work/a.wav")" "2 s from 1" "--range drops the sound before the first frame"
run "$bin/spin-import" "$work/a.4dgs" -o "$work/late.spin" --range 60:120
run "$bin/spin-export" "$work/late.spin" -o "$work/cut.4dgs" --range 75:120 --force
file extract "$work/cut.4dgs" "$work/a.wav"
is "$(file heard "$work/a.wav")" "0.5 s from 2.5" "and so does that of the import"
run "$bin/spin-export" "$work/late.spin" -o "$work/cut.4dgs" --range 75:120 --sound "$work/tone.wav" --force
file extract "$work/cut.4dgs" "$work/a.wav"
is "$(file heard "$work/a.wav")" "2.5 s from 0.5" "the file of --sound begins with the bundle"
run "$bin/spin-export" "$work/a.spin" -o "$work/mute.4dgs" --range 100:120
is "$code" 0 "frames after the end of the sound"
err_has "the sound 'tone' does not play during the exported frames" "are reported"
run "$bin/spin-export" "$work/a.spin" -o "$work/fast.4dgs" --fps 60
err_has "speed of the clip from 30 to 60 frames per second, .*: the output lacks the sound 'tone'" "another speed, too"

# What cannot be cut keeps its start in a member that only spin4d reads.
python3 tests/tools/sound.py opus "$work/tone.opus" 3
for to in 4dgs tsog; do
    run "$bin/spin-export" "$work/frames.spin" -o "$work/o.$to" --sound "$work/tone.opus" --range 2:5
    err_has "start the sound 'tone' 0.0667 s late" "$to: Opus is not cut"
    run "$bin/spin-import" "$work/o.$to" --info --json
    is "$(described start type | cut -c 1-7) $(described type)" "-0.0666 opus" "$to: but its start is kept"
done

# ---- Page ----------------------------------------------------------------------------------------

run "$bin/spin-export" "$work/a.spin" -o "$work/a.html" --json
is "$code $(member bytes)" "0 $(wc -c <"$work/a.html")" "a page with sound"
grep -q "src=\"data:audio/wav;base64,$(base64 -w 0 "$work/tone.wav")\"" "$work/a.html"
ok $? "contains all of it"
run "$bin/spin-export" "$work/a.spin" -o "$work/s.html" --split --json
is "$code $(member bytes)" "0 $(cat "$work/s.html" "$work/s.bin" "$work/s.sound.wav" | wc -c)" "with --split"
cmp -s "$work/s.sound.wav" "$work/tone.wav"
ok $? "it is a file beside the page"
run "$bin/spin-export" "$work/a.spin" -o "$work/s.html" --split
fails 1 spin-export "files that exist"
"$bin/spin-export" "$work/frames.spin" -o "$work/short.html" -q --sound "$work/tone.wav"
grep -q '"fps":30' "$work/short.html"
ok $? "a short clip is not slowed down, since the sound would be"

# ---- Videos --------------------------------------------------------------------------------------

burst() { # OUT WANTED NAME OPTION...: a video with a tone from 1.5 to 2 s of the clip, of 64x36 pixels
    out=$1 wanted=$2 what=$3
    shift 3
    run "$bin/spin-export" "$work/silent.spin" -o "$work/$out" --sound "$work/burst.wav" --size 64x36 --force "$@"
    is "$("$(dirname "$bin")/tests/tools/read-sound" "$work/$out" 2>&1)" "$wanted" "$out: $what"
}
if [ -x "$(dirname "$bin")/tests/tools/read-sound" ]; then
    python3 tests/tools/sound.py burst "$work/burst.wav" 1.5
    burst v.mp4 "aac from 1.50 to 2.00 of 4.0" "the sound has the length of the clip"
    burst v.mp4 "aac from 0.50 to 1.00 of 2.0" "and is cut with it" --range 30:90
    burst v.webm "opus from 0.50 to 1.00 of 2.0" "as Opus, too" --range 30:90
    burst v.webm "opus from 0.50 to 0.67 of 0.7" "up to the last frame" --range 30:50
    burst v.mp4 none "no sound in a video that is slower" --repeat 2
    err_has "the video takes 8 s but the clip 4 s: the video is written without the sound 'burst'" "which is reported"
    burst v.mp4 none "nor one that is not wanted" --sound none
    printf 'fLaC and nothing that could be decoded' >"$work/x.flac"
    run "$bin/spin-export" "$work/silent.spin" -o "$work/bad.mp4" --sound "$work/x.flac" --size 64x36
    is "$code" 1 "a sound that cannot be decoded is an error"
    err_has "cannot write video .*cannot decode the sound, or cannot start its encoder" "which names the reason"
    [ ! -e "$work/bad.mp4" ]
    ok $? "and leaves no video"
else
    skip "videos with sound" "built without FFmpeg"
fi

# ---- Formats without sound -----------------------------------------------------------------------

for to in ply gltf usd spz splat sog compressed-ply images; do
    run "$bin/spin-export" "$work/a.spin" --to $to -o "$work/$to.out/" --range 0:1
    case $to in
    gltf | usd) run "$bin/spin-export" "$work/a.spin" --to $to -o "$work/x.$to" --range 0:2 --force ;;
    esac
    err_has "'$to' cannot store sound: the output lacks the sound 'tone'" "$to: the loss is reported"
done
run "$bin/spin-export" "$work/a.spin" -o "$work/none.ply" --range 0:1 --sound none
! grep -q sound "$work/err"
ok $? "but not with --sound none"
printf 'ID3\004\0\0\0\0\0\0\377\373\024\300' >"$work/x.mp3"
head -c 92 /dev/zero >>"$work/x.mp3"
run "$bin/spin-export" "$work/silent.spin" -o "$work/mp3.4dgs" --sound "$work/x.mp3"
err_has "'4dgs' stores sound as wav opus, not as mp3: the output lacks the sound 'x'" "nor does .4dgs store MP3"

# ---- spin4d, and mistakes ------------------------------------------------------------------------

run "$bin/spin4d" "$work/a.4dgs" -o "$work/one.4dgs" --no-retrain
file extract "$work/one.4dgs" "$work/a.wav"
cmp -s "$work/a.wav" "$work/tone.wav"
ok $? "spin4d carries the sound"
run "$bin/spin4d" fixtures/4dgs/birth_sh2/scene.4dgs -o "$work/two.4dgs" --no-retrain --sound "$work/tone.wav"
file extract "$work/two.4dgs" "$work/a.wav"
cmp -s "$work/a.wav" "$work/tone.wav"
ok $? "and adds one"
run "$bin/spin4d" "$work/a.4dgs" --frames 2 -o "$work/r.4dgs" --iterations 1
is "$code" 0 "frames with sound that are retrained on renders"
file extract "$work/r.4dgs" "$work/a.wav"
cmp -s "$work/a.wav" "$work/tone.wav"
ok $? "keep it through all bundles"
run "$bin/spin4d" "$work/a.4dgs" -o "$work/three.4dgs" --sound "$work/missing.wav"
fails 1 spin4d "a sound that does not exist"
nothing_at "$work/three" "which is noticed before the import"
run "$bin/spin-export" "$work/silent.spin" -o "$work/bad.4dgs" --sound "$work/silent.spin"
fails 1 spin-export "a file that is no sound"
err_has "unknown format, expected WAV, MP3, AAC" "which formats it may have"
run "$bin/spin-export" "$work/silent.spin" -o "$work/bad.4dgs" --sound "$work/missing.wav"
fails 1 spin-export "a file that does not exist"
[ ! -e "$work/bad.4dgs" ]
ok $? "and nothing is written"
done_testing
