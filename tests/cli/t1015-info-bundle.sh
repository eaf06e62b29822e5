#!/bin/sh
# K: info bundle d3dgs realtime4dgs
# --info of bundles and of methods that are defined at any time; runs one folder further down; data
# sets beside a run.
. tests/cli/lib.sh

# ---- An imported bundle --------------------------------------------------------------------------

run "$bin/spin-import" -q "$clip" --data "$clip" --range 1:5 -o "$work/in.spin"
is "$code" 0 "a bundle of four frames"
run "$bin/spin-import" --info "$work/in.spin"
is "$code" 0 "is described"
out_has "^bundle  *$work/in.spin, by spin4d" "that it is one, and who wrote it"
out_has "^from  *d3dgs, Dynamic 3D Gaussians" "where it came from"
out_has "^upstream  *JonathonLuiten" "whose files those were"
out_has "^data  *$PWD/$clip, panoptic$" "its data set"
out_has "^frames  *4 of the source's 6, numbers 1 to 4 (counted), times 1 to 4$" "its frames"
out_has "^splats  *2940 a frame$" "its splats"
out_has "^attributes  *means quats log_scales logit_opacities sh (SH degree 0)$" "its attributes"
out_has "^static  *log_scales logit_opacities$" "what does not change"
out_has "^size  *[0-9.]* kB, source [0-9.]* kB$" "its sizes"
grep -qE '^(refined|network) ' "$work/out"
is $? 1 "and nothing that it has not"
run "$bin/spin-import" --info --json "$work/in.spin"
is_json "as JSON"
is "$(member from) $(member frames) $(member source_frames)" "d3dgs 4 6" "frames as JSON"
is "$(member sh_degree) $(member data_there)" "0 true" "SH degree and data set as JSON"
is "$(tr -d ' \n' <"$work/out" | sed 's/.*"bytes":{"file":\([0-9]*\),.*/\1/')" "$(wc -c <"$work/in.spin")" \
    "the size of the file as JSON"
tr -d ' \n' <"$work/out" | grep -q '"times":\[1,4\],"splats":{"min":2940,"mean":2940,"max":2940}'
ok $? "splats and times as JSON"
run "$bin/spin-import" --info --json "$work/in.spin" --positions-only
is "$code" 0 "options of an import change nothing"

mv "$work/in.spin" "$work/moved.spin"
mkdir "$work/deep"

# The bundle moved alone, moved together with the data set, and without the data set: the path in it
# is absolute each time.
mkdir -p "$work/one/a" "$work/two/x/y"
cp -r "$clip" "$work/one/set"
run "$bin/spin-import" -q "$clip" --data "$work/one/set" -o "$work/one/a/b.spin"
cp "$work/one/a/b.spin" "$work/two/x/y/b.spin"
run "$bin/spin-eval" "$work/two/x/y/b.spin" --range 0:1 --scale 0.1 --dynamic off
is "$code" 0 "a bundle copied to another depth keeps its data set"
mv "$work/one" "$work/three"
run "$bin/spin-import" --info "$work/three/a/b.spin"
out_has "^data  *$work/three/set, panoptic\$" "so does one that was moved with it"
run "$bin/spin-eval" "$work/two/x/y/b.spin"
err_has "'$work/one/set'" "a data set that is gone: the path that was recorded"
run "$bin/spin-import" -q "$clip" -o "$work/alone.spin"
run "$bin/spin-import" --info --json "$work/alone.spin"
is "$(member data)" null "a bundle without a data set"
cp -r "$clip" "$work/deep/data"
run "$bin/spin-import" -q "$clip" --data "$work/deep/data" -o "$work/deep/b.spin"
rm -r "$work/deep/data"
run "$bin/spin-import" --info "$work/deep/b.spin"
out_has "^data .*data, panoptic: not found$" "a data set that is gone"

# ---- A retrained bundle --------------------------------------------------------------------------

run "$bin/spin-retrain" -q "$work/moved.spin" -o "$work/net.spin" --device cpu --iterations 12 --refine 3 \
    --scale 0.25 --hash-log2 14 --levels 8 --hidden 32 --sh-degree 2 --residual points --force
is "$code" 0 "is retrained"
run "$bin/spin-import" --info "$work/net.spin"
is "$code" 0 "what was retrained is described"
out_has "^refined .*, 3 iterations each$" "refined frames"
out_has "^trained .*, 12 iterations on cpu; 8 levels of 4 features, [0-9]* rows, hidden width 32$" "the network"
out_has "attributes: means quats log_scales logit_opacities sh (SH degree 2)$" "what it gives"
out_has "held-out views before: [0-9.]* dB, SSIM 0[.0-9]*$" "how good the source was"
out_has "held-out views after: [0-9.]* dB, SSIM 0[.0-9]*$" "how good it is"
out_has "hash_log2: 14" "its settings"
out_has "^size .*source .*refined .*values of frames .*table .*heads " "the sizes of all its parts"
run "$bin/spin-import" --info --json "$work/net.spin"
is_json "as JSON"
trained=$(tr -d ' \n' <"$work/out" | sed 's/.*"trained"://')
for word in '"field":{"levels":8,"features":4,"hidden":32,' '"device":"cpu"' '"options":{' '"iterations":12' '"hash_log2":14'; do
    case $trained in
    *"$word"*) : ;;
    *) false ;;
    esac
    ok $? "the network as JSON: $word"
done
is "$(tr -d ' \n' <"$work/out" | sed 's/.*"bytes":{"file":\([0-9]*\),"source":\([0-9]*\),"refined":\([0-9]*\),"positions":\([0-9]*\),"tracks":\([0-9]*\),"table":\([0-9]*\),"heads":\([0-9]*\)}.*/\2+\3+\4+\5+\6+\7 \1/' |
    awk '{ n = split($1, part, "+"); for (i = 1; i <= n; i++) sum += part[i]; print (sum > 0.97 * $2 && sum < $2) }')" \
    1 "the parts are nearly all of the file"

run "$bin/spin-retrain" "$work/moved.spin" -o "$work/tracks.spin" --device cpu --iterations 6 \
    --scale 0.25 --force
is "$code" 0 "is retrained without a network"
grep -q "the hash table has" "$work/err"
is $? 1 "of which nothing is said then"
run "$bin/spin-import" --info "$work/tracks.spin"
out_has "^trained .*, 6 iterations on cpu, no network$" "nor here"
out_has "^size .*source .*values of frames .*tracks [0-9]" "its sizes"
run "$bin/spin-retrain" -q "$work/moved.spin" -o "$work/tracks.spin" --device cpu --tracks off --force
fails 2 spin-retrain "--method tracks, and --tracks off"
err_has "method tracks does not support --tracks off: use --tracks auto" "is told what it lacks"
run "$bin/spin-retrain" "$work/moved.spin" --dry-run --json --device cpu
is "$(member method)" tracks "the method as JSON"

run "$bin/spin-import" "$work/net.spin" -o "$work/again.spin"
fails 1 spin-import "a bundle as input"
err_has "is already a bundle" "is told so"
nothing_at "$work/again" "and nothing is written"
head -c 3000 "$work/net.spin" >"$work/cut.spin"
run "$bin/spin-import" --info "$work/cut.spin"
fails 1 spin-import "a bundle that is cut short"
err_has "cut.spin" "it is named"

# ---- Terminal escape sequences -------------------------------------------------------------------

# Escape sequences in meta.json, in the bundle's name and in an array's name; $escape begins one, as
# does U+009B.
escape=$(printf '\033]0;X\007\302\233\177')
mkdir "$work/$escape"
odd=$work/$escape/b.spin
no_control() { # NAME
    ! LC_ALL=C grep -q "$(printf '[\001-\010\013-\037\177]\|\302[\200-\237]')" "$work/out" "$work/err"
    ok $? "$1: no control characters"
}
if command -v python3 >/dev/null; then
    python3 - "$work/alone.spin" "$odd" <<'PY'
import json, sys, zipfile
evil = "\x1b]0;X\x07\x9b\x7f\nevil"
with zipfile.ZipFile(sys.argv[1]) as old, zipfile.ZipFile(sys.argv[2], "w") as new:
    for name in old.namelist():
        data = old.read(name)
        if name == "meta.json":
            meta = json.loads(data)
            for key in "from", "upstream", "variant", "generator":
                meta[key] = key + evil
            meta["data"] = {"path": "data" + evil, "from": "panoptic" + evil}
            data = json.dumps(meta, ensure_ascii=False)
        new.writestr(name, data)
PY
    run "$bin/spin-import" --info "$odd"
    is "$code" 0 "a bundle of escapes"
    no_control "a bundle of escapes"
    is "$(grep -c '^evil' "$work/out")" 0 "and no lines that it makes up"
    out_has "^upstream  *upstream?.0;X?????evil" "they are question marks"
    run "$bin/spin-import" --info --json "$odd"
    no_control "as JSON"
    is_json "which it is"
    run "$bin/spin-export" "$odd" --to ply -o "$work/$escape/ply"
    no_control "what an export says"
else
    skip "a bundle of escapes" "no python3"
fi
mkdir "$work/$escape/run"
cp "$clip/params.npz" "$work/$escape/run"
cp -r "$clip/ims" "$clip"/*_meta.json "$work/$escape"
run "$bin/spin-import" --info "$work/$escape/run"
is "$code" 0 "a run in a folder of escapes"
out_has "^note .*beside the run" "beside a data set"
no_control "a run in a folder of escapes"
run "$bin/spin-import" --from "$escape" --info "$clip"
no_control "an error"

# ---- Runs one folder further down, data sets beside them -----------------------------------------

mkdir -p "$work/one/models/ball" "$work/one/notes"
cp "$clip/params.npz" "$work/one/models/ball"
run "$bin/spin-import" "$work/one/models" -o "$work/below.spin"
is "$code" 0 "a folder around a run"
out_has "^note .*the run was found in '$work/one/models/ball'" "says where it is"
run "$bin/spin-import" "$work/one/models/ball" -o "$work/itself.spin"
same_frames "$work/below.spin" "$work/itself.spin" "and is imported as the run itself is"
run "$bin/spin-import" --info "$work/one/models" --from d3dgs
fails 1 spin-import "with --from the folder is taken as it is"
mkdir "$work/sets"
cp -r "$clip" "$work/sets/court"
run "$bin/spin-import" "$clip" --data "$work/sets" -o "$work/never.spin"
fails 1 spin-import "a folder around a data set"
err_has "the data set is in '$work/sets/court' (panoptic)" "says where that is"
mkdir "$work/one/models/other"
cp "$clip/params.npz" "$work/one/models/other"
run "$bin/spin-import" --info "$work/one/models"
err_has "it contains several runs, such as '$work/one/models/ball'" "a folder around two"
run "$bin/spin-import" --info "$work/one"
fails 1 spin-import "two folders down"
err_has "no importer reads it" "is not looked for"
run "$bin/spin-import" --info --json --data "$work/one" "$clip"
fails 1 spin-import "a folder that is no data set"

run "$bin/spin-import" --info "$clip"
out_has "^note .*a data set (panoptic) was found beside the run: use --data '$PWD/$clip'" "a run in its data set"
run "$bin/spin-import" --info "$clip/params.npz"
out_has "^note .*a data set (panoptic)" "a file in its data set"
run "$bin/spin-import" --info "$clip" --data "$clip"
grep -q "beside the run" "$work/out"
is $? 1 "no word of it with --data"
run "$bin/spin-import" --info "$work/one/models/ball"
grep -q "lie" "$work/out"
is $? 1 "nor where there is none"
mkdir "$work/one/models/video"
cp -r "$clip/ims" "$clip"/*_meta.json "$work/one/models/video"
run "$bin/spin-import" "$work/one/models/ball" -o "$work/hint.spin"
is "$code" 0 "imports beside one"
out_has "^note .*found beside the run: use --data '$work/one/models/video'" "and says so"
cp -r "$work/one/models/video" "$work/one/models/video2"
run "$bin/spin-import" --info "$work/one/models/ball"
out_has "^note .*2 data sets were found beside the run" "two of them"

# ---- Methods that are defined at any time --------------------------------------------------------

in=$fixtures/realtime4dgs/rot4d_noshfs
if [ ! -d "$in" ]; then
    skip "any time" "no fixtures at $in"
    done_testing
fi
run "$bin/spin-import" --info "$in"
out_has "^time  *any from [-0-9.]* to [-0-9.]*, read at both ends" "its range, and how it was looked at"
out_has "^read  *at [-0-9.]* and [-0-9.]*$" "when"
grep -q "^frames\|2 frames" "$work/out"
is $? 1 "it is not said to have frames"
run "$bin/spin-import" --info --json "$in"
is "$(member continuous) $(member sampled)" "true ends" "as JSON"
run "$bin/spin-import" --info "$in" --frames 3
out_has "^time .*, sampled evenly$" "evenly"
out_has "^frames  *3," "three frames"
run "$bin/spin-import" --info --json "$in" --frames 3
is "$(member sampled) $(member frames)" "evenly 3" "as JSON"
run "$bin/spin-import" --info --json "$in" --times 0.5,0.25
is "$(member sampled) $(member frames)" "times 2" "at times that were asked for"
run "$bin/spin-import" --info --json "$in" --data "$clip"
is "$(member sampled) $(member frames)" "data 6" "at those of a data set"
run "$bin/spin-import" --json "$in" --frames 2 -o "$work/any.spin"
is "$(member sampled)" evenly "an import says it too"
done_testing
