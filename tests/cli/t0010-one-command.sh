#!/bin/sh
# K: spin4d one command convert
# spin4d converts a run to a clip in one command: which inputs it accepts, which files it leaves,
# and that the same command line resumes after Ctrl-C.
. tests/cli/lib.sh
bin=$(cd "$bin" && pwd)
cp -r $clip "$work/run"
mkdir "$work/taken"
cp -r fixtures/datasets/blender_mini "$work/taken/set"
cd "$work" || exit 1
mkdir alone
cp run/params.npz alone

# ---- Without /proc, as in a bare chroot ----------------------------------------------------------

mkdir empty
apart="mount --bind '$work/empty' /proc && exec \"\$@\""
for how in -m -rm; do
    unshare $how sh -c "$apart" sh true 2>/dev/null && break
    how=
done
case ${SPIN_BUILD:-} in *asan* | *tsan*) how= ;; esac # sanitisers read /proc
if [ "$how" ]; then
    run env PATH="$bin:$PATH" unshare "$how" sh -c "$apart" sh spin4d import run --data run -o no-proc.spin
    is "$code" 0 "finds its commands"
    run unshare "$how" sh -c "$apart" sh "$bin/spin-export" no-proc.spin --to images --range 0:1 -o no-proc
    is "$code" 0 "and its shared objects"
    rm -r no-proc*
else
    skip "without /proc" "no rights to mounts of its own, or a sanitiser"
fi
rmdir empty

# ---- Imported, retrained, exported ---------------------------------------------------------------

run "$bin/spin4d" run --iterations 40
is "$code" 0 "a run"
err_has "the data set '.*run' found beside the run; --data chooses another" "says which data set it takes"
err_has "^preset quick: 40 iterations, 6 frames; about .* here" "says what is trained and how long"
err_has "of 6 frames and 2 versions" "the page has both versions"
out_has "^held-out views: 16.10 dB before, [0-9.]* dB after" "how good it became"
out_has "Open run.html in a browser" "where it is"
[ -s run.html ]
ok $? "and writes the page"
is "$(ls -d run.*)" "$(printf 'run.html\nrun.spin')" "only page and bundle stay"
"$bin/spin-import" --info run.spin --json | grep -q '"trained": {'
ok $? "the bundle is trained"
is "$("$bin/spin-import" --info run.spin --json | grep -c 'hash_log2\|lr_table\|finest_resolution')" 0 \
    "and tells no settings of a network, as there is none"
"$bin/spin-import" run --data run -o by-hand.spin -q >/dev/null
"$bin/spin-retrain" by-hand.spin -o by-hand-better.spin --iterations 40 -q >/dev/null 2>&1
same_frames run.spin by-hand-better.spin "as by the commands one by one"

run "$bin/spin4d" run --iterations 40
fails 1 spin4d "a page that is there"
rm run.html
run "$bin/spin4d" run --iterations 40 --json
is "$code $(member to) $(member bundle)" "0 html run.spin" "without the page only the export is done again"
is_json "--json"
err_has "'run.spin' is already finished" "the training is not"

# ---- Without images ------------------------------------------------------------------------------

run "$bin/spin4d" alone --from d3dgs -v
is "$code" 0 "a run without a data set"
err_has "no data set is known, so the clip is not retrained; give one with --data" "says why it is not retrained"
is "$("$bin/spin-import" --info alone.spin --json | grep -c '"trained": {')" 0 "and it is not"
cp -r "$OLDPWD/fixtures/deformable3dgs/real_small/model" network
run "$bin/spin4d" network -o network.html
is "$code $(grep -c '^network.html: 60 frames' "$work/out")" "0 1" "a run that is continuous in time, without data"
err_has "does not store its number of frames, so 60 frames are sampled from time 0 to 1; --frames samples" "says so"
run "$bin/spin4d" run/params.npz --no-retrain -o clip.glb
is "$code $(ls -d clip.*)" "0 $(printf 'clip.glb\nclip.spin')" "--no-retrain; the ending says the format"
run "$bin/spin4d" alone --data run --data-from panoptic --iterations 40 -o given.html --device cpu --threads 1
is "$code" 0 "--data"
err_has "cpu (.*, 1 thread)" "--device and --threads"
"$bin/spin-import" --info given.spin --json | grep -q '"trained": {'
ok $? "with it a run alone is retrained"
run "$bin/spin4d" run --data-from colmap -o wrong.html
is "$code" 0 "a wrong --data-from, of a data set that is not named"
err_has "warning: not using the data set '.*run' found beside the run" "is said"
! grep -q "^using the data set" "$work/err"
ok $? "and not that it is used"
run "$bin/spin4d" alone --from dash -o other2.html
fails 1 spin4d "a wrong --from"
run "$bin/spin4d" alone --frames 3 -o other2.html
fails 2 spin4d "--frames of a run that stores its frames"
run "$bin/spin4d" given.spin --frames 3 -o other2.html
fails 2 spin4d "--frames of a bundle"
run "$bin/spin4d" given.spin --from ply -o other2.html
fails 2 spin4d "--from of a bundle"
run "$bin/spin4d" given.spin --data not-there -o other2.html
is "$code" 1 "a data set for a bundle that is trained is that of its pictures"
err_has "the clip is already trained and is not retrained" "which are all that is made"
run "$bin/spin4d" given.spin -o page.html --preset best -q
is "$(wc -c <"$work/out")" 0 "-q says nothing"
is "$code $(ls -d page.*)" "0 page.html" "a bundle that is trained is exported"
err_has "warning: nothing is retrained, so --preset has no effect: the clip is already trained; " "which no preset changes"
run "$bin/spin4d" clip.spin --to ply -o frames/
is "$code $(find frames -name '*.ply' | wc -l)" "0 6" "another format"
cp clip.spin own.spin
run "$bin/spin4d" own.spin --data run
fails 2 spin4d "a bundle that would replace itself"
cmp -s clip.spin own.spin
ok $? "stays"

# ---- 4D splats -----------------------------------------------------------------------------------

run "$bin/spin4d" run -o rows.sogst --iterations 40 --preset paper
fails 2 spin4d "4D splats by the paper's network"
run "$bin/spin4d" run -o rows.sogst --iterations 40
is "$code $(echo $(ls -d rows.*))" "0 rows.sogst rows.spin rows.tracks.spin" "a run becomes 4D splats"
err_has "'sogst' stores 4D splats: training 4D splats from the frames" "which are trained from frames"
out_has "^as 4D splats: [0-9.]* dB" "and says how good they are"
"$bin/spin-import" --info rows.spin --json | grep -q antialias.*true
is $? 1 "they are drawn without antialiasing"
rm rows.sogst
run "$bin/spin4d" run -o rows.sogst --iterations 40 --json
is "$code $(grep -c 'is already finished' "$work/err")" "0 2" "the same call does only what is left"
run "$bin/spin4d" rows.tracks.spin -o again.tsog --iterations 5
is "$code $(echo $(ls -d again.*))" "0 again.spin again.tsog" "frames that are trained are not trained again"
run "$bin/spin4d" rows.tracks.spin -o states.4dgs --iterations 1 --json
is "$code $(echo $(ls -d states.*))" "0 states.4dgs states.spin" "4D splats are trained for .4dgs as well"
run "$bin/spin4d" rows.tracks.spin -o frames.4dgs --no-retrain
is "$code $(echo $(ls -d frames.*))" "0 frames.4dgs" "which stores frames only if nothing is trained"
run "$bin/spin4d" rows.spin -o again.ftgs.ply
is "$code" 0 "4D splats that are trained are exported"

"$bin/spin-retrain" clip.spin --data run -o refined.spin --method frames --refine 20 -q >/dev/null 2>&1
run "$bin/spin4d" refined.spin --data run -o refined.tsog
is "$code $(echo $(ls -d refined.*))" "0 refined.spin refined.tsog" "refined frames are written as frames, under their own name"
run "$bin/spin4d" clip.spin --no-retrain --preset paper -o plain.tsog
is "$code" 0 "and so are frames that are not to be trained, whatever the preset"

# A data set that was found without --data but does not fit: two of its six frames are missing from
# its list.
mkdir other && cp -r run/ims run/test_meta.json run/train_meta.json other
python3 - <<'PY'
import json
for name in ("train", "test"):
    path = f"other/{name}_meta.json"
    meta = json.load(open(path))
    for key, value in meta.items():
        if isinstance(value, list):
            meta[key] = value[:2]
    json.dump(meta, open(path, "w"))
PY
cp run/params.npz other
run "$bin/spin4d" other --iterations 40
is "$code" 0 "a data set beside it that does not fit"
err_has "warning: not using the data set '.*other' found beside the run: " "a warning says why"
run "$bin/spin4d" other --data other --iterations 40 --force
is "$code" 2 "the same, named, is an error"
err_has "^spin4d: .*cannot pair frames" "which says why"

# ---- Interrupted ---------------------------------------------------------------------------------

"$bin/spin4d" run -o cut.html >out 2>err &
pid=$!
for _ in $(seq 200); do
    grep -q '^before retraining: ' err && break
    sleep 0.1
done
sleep 0.5
kill -INT $pid
wait $pid
is "$?" 130 "Ctrl-C"
tail -n 1 err | grep -q "^spin4d: interrupted; the checkpoint of iteration [0-9]* is kept in 'cut.spin.part': run the same command to continue$"
ok $? "says what is kept and how to go on: $(tail -n 1 err)"
is "$(ls -d cut.*)" "$(printf 'cut.import.spin\ncut.spin.part\ncut.spin.part.spin')" "the work is kept, and the clip as it was"
run "$bin/spin4d" run -o cut.html --iterations 40
is "$code" 2 "other options do not go on with it"
err_has "; give the same ones, or --force to start anew\$" "and what to type is an option that there is"
run "$bin/spin4d" run -o cut.html --iterations 40 --force
is "$code $(ls -d cut.*)" "0 $(printf 'cut.html\ncut.spin')" "--force starts anew"

# ---- Wrong usage, and the four commands ----------------------------------------------------------

run "$bin/spin4d"
fails 2 spin4d "no run"
run "$bin/spin4d" nothing-here
fails 1 spin4d "a run that is not there"
run "$bin/spin4d" alone -o clip
fails 2 spin4d "an output without an ending"
run "$bin/spin4d" alone -o no/such/folder.html
fails 1 spin4d "a folder that is not there"
nothing_at no "nothing was made"
mkdir full && touch full/mine
run "$bin/spin4d" alone --to ply -o full
fails 1 spin4d "a folder with files"
err_has "'full' exists and is not empty; use --force" "which it names"
for name in import retrain eval export; do
    run "$bin/spin4d" $name --version
    is "$(cat "$work/out")" "$("$bin/spin-$name" --version)" "spin4d $name"
done
run "$bin/spin4d" eval
fails 2 spin-eval "spin4d eval asked wrongly"
# A data set without a run is described, even if the page that it would become exists; a run does
# not overwrite that page.
cp -r run taken/clip
touch taken/set.html taken/clip.html taken/transforms_train.html
run sh -c 'cd taken && "$1/spin4d" set' - "$bin"
is "$code" 1 "a data set is no run"
err_has "^spin4d: cannot import 'set': 'set' is a data set (transforms) of 2 cameras" "but described"
for arguments in clip 'set --from d3dgs' set/transforms_train.json; do
    run sh -c 'cd taken && "$1/spin4d" $2' - "$bin" "$arguments"
    is "$code" 1 "$arguments: fails"
    err_has "cannot write '[a-z_]*.html': it exists; use --force to overwrite" "since the page exists"
done
done_testing
