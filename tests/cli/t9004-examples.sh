#!/bin/sh
# K: long documents
# Every example of README, docs and the manual pages is run on small fixtures, or is named in
# examples.list with the reason why it is not. The examples of a document run in one folder, in
# their order. All options in them must exist.
. tests/cli/lib.sh
root=$PWD
bin=$(cd "$bin" && pwd)
blocks=$work/blocks
mkdir "$blocks" "$work/place" "$work/path"
documents="README.md CONTRIBUTING.md $(ls docs/*.md docs/*/*.md man/*.[157] tests/viewers/*.md tests/bench/*.md)"

# The examples of --help, as a document of their own.
for name in spin4d spin-import spin-retrain spin-eval spin-export; do
    "$bin/$name" --help | sed -n '/^Examples:/,/^$/s/^  \(spin[^ ]*\( [^ ]*\)*\)   *[^ ].*/    \1/p' >"$work/$name--help"
    is "$(wc -l <"$work/$name--help")" 3 "three examples in $name --help"
    documents="$documents $work/$name--help"
done

# shellcheck disable=SC2086
awk -v into="$blocks" -v first=1 -f tests/cli/examples.awk $documents >"$work/index"
is "$(grep '^stray' "$work/index")" "" "every line that begins with a command is in an example that does"
[ "$(grep -vc '^stray' "$work/index")" -gt 40 ]
ok $? "finds the examples"

# The three commands for a fresh machine. Continuous integration runs the last one literally.
grep -q '^    make demo' README.md
ok $? "README says how to see it work"
is "$(grep -c '^    spin4d ' README.md)" 1 "README names one command for the main job"
tests=$(sed -n 's/^    \(make test.*\)/\1/p' README.md)
is "$(sed -n 's/^step \(make test\)$/\1/p' .ci/run)" "${tests:-a command}" "README says how to test it, and .ci/run does that"

# ---- Options -------------------------------------------------------------------------------------

for name in spin4d spin-import spin-retrain spin-eval spin-export; do
    "$bin/$name" --help all | sed -n 's/^  \(-., \|    \)--\([a-z0-9-]*\).*/--\2/p' >"$work/$name.options"
done
for plugin in $("$bin/spin-import" --list | awk '/^[a-z0-9]/ { print $1 }'); do
    "$bin/spin-import" --from "$plugin" --help
done | sed -n 's/^ *\(--[a-z0-9-]*\).*/\1/p' | sort -u >>"$work/spin-import.options"
for plugin in $("$bin/spin-export" --list | awk '/^[a-z0-9]/ { print $1 }'); do
    "$bin/spin-export" --to "$plugin" --help
done | sed -n 's/^ *\(--[a-z0-9-]*\).*/\1/p' | sort -u >>"$work/spin-export.options"

# An example as one line per command: joins continued lines, and drops comments and everything after
# && or |.
commands() {
    sed -e ':a' -e '/\\$/{N;s/ *\\\n */ /;ba' -e '}' -e '/^#/d' -e 's/  *# .*//' -e 's/ *$//' -e '/^$/d' "$1"
}
# Reads lines "PLACE<tab>COMMAND-LINE" and prints the options that their commands lack.
wrong() {
    awk -F '\t' '
        FILENAME != "-" { command = FILENAME; gsub(/.*\/|\.options$/, "", command); has[command, $0]; next }
        {
            n = split("import retrain eval export", name, " ")
            for (i = 1; i <= n; i++)
                gsub("spin4d " name[i] " ", "spin-" name[i] " ", $2)
            n = split($2, part, /&&|[|;]/)
            for (i = 1; i <= n; i++) {
                if (!match(part[i], /spin4d |spin-(import|retrain|eval|export)/))
                    continue
                command = substr(part[i], RSTART, RLENGTH)
                sub(/ /, "", command)
                m = split(substr(part[i], index(part[i], command) + length(command)), word, " ")
                for (k = 1; k <= m; k++) {
                    sub(/=.*/, "", word[k])
                    if (word[k] ~ /^--[a-z]/ && !((command, word[k]) in has))
                        print $1 command, word[k]
                }
            }
        }' "$work"/spin*.options -
}
while read -r number kind place; do
    [ "$kind" = sh ] || continue
    commands "$blocks/$number.sh" >"$blocks/$number.lines"
    while IFS= read -r line; do
        printf '%s: \t%s\n' "$place" "$line" >>"$work/lines"
        case $line in
        make*)
            target=$(echo "$line" | awk '$2 ~ /^[a-z]/ { print $2 }')
            grep -q "^${target:-all}:" Makefile || is "$target" "" "$place: a target that is there"
            ;;
        'sh tests'*)
            file=$(echo "$line" | awk '{ print $2 }')
            [ -f "$file" ] || is "$file" "" "$place: a file that is there"
            ;;
        esac
    done <"$blocks/$number.lines"
done <"$work/index"
is "$(wrong <"$work/lines")" "" "examples have options that are there"
[ "$failed" = 0 ]
ok $? "the options, targets and scripts in examples are there"

# Commands inside sentences too.
# shellcheck disable=SC2086
grep -ohE '`(spin4d|spin-(import|retrain|eval|export)) [^`]*`' README.md CONTRIBUTING.md $(ls docs/*.md docs/*/*.md) | tr -d '`' | sort -u |
    sed 's/^/\t/' | wrong >"$work/strangers"
is "$(cat "$work/strangers")" "" "commands in the text of documents have the options that they name"

# Options named in the text exist in some command: `--word`, or Fl Fl word.
sort -u "$work"/spin*.options >"$work/all.options"
# shellcheck disable=SC2086
grep -ohE '`--[a-z0-9-]+' README.md CONTRIBUTING.md $(ls docs/*.md docs/*/*.md) | tr -d '`' | sort -u |
    grep -vxF -f "$work/all.options" | grep -vxE -e '--(mca|bind-to|expect-motion|max-frames|matrix|deterministic|alone|bound-)' >"$work/strangers"
is "$(cat "$work/strangers")" "" "options named in the text of documents are there"

# Links, and files that a sentence names.
for file in README.md CONTRIBUTING.md docs/*.md docs/*/*.md; do
    grep -oE '\]\([^)#:]+' "$file" | cut -c 3- | while read -r to; do
        [ -e "$(dirname "$file")/$to" ] || echo "$file: $to"
    done
    grep -ohE '`(docs|man|fixtures|importers|exporters|tests|src)/[A-Za-z0-9_./-]+`' "$file" | tr -d '`' |
        grep -v 'NAME\|COMMAND' | while read -r to; do
        [ -e "$to" ] || echo "$file: $to"
    done
done >"$work/strangers"
is "$(cat "$work/strangers")" "" "links and files named in documents lead somewhere"
for file in $(git ls-files docs 2>/dev/null | grep -v '\.md$\|\.txt$'); do
    grep -qF "$(basename "$file")" README.md docs/*.md docs/*/*.md || echo "$file"
done >"$work/strangers"
is "$(cat "$work/strangers")" "" "every picture of docs is in a document"

# ---- Running -------------------------------------------------------------------------------------

# Inputs of the examples: every name in them stands for the same small clip.
here=$work/place
cp -r fixtures/court-mini "$here/court"
for link in runs/ball data/ball data basketball court-hd run; do
    mkdir -p "$here/$(dirname "$link")"
    [ -e "$here/$link" ] || ln -s "$here/court" "$here/$link"
done
ln -s "$root/fixtures" "$here/fixtures"
mkdir -p "$here/output/d3dgs"
ln -s "$here/court/params.npz" "$here/output/d3dgs/params.npz"
while read -r name path; do
    ln -s "$root/fixtures/$path" "$here/output/$name"
done <<RUNS
3dgstream 3dgstream
4dgaussian 4dgaussian/coarse_and_fine/model
balls 4dgaussian/coarse_and_fine/model
steak 4dgaussian/coarse_and_fine/model
dash dash/default_like/model
deformable3dgs deformable3dgs/real_small/model
ed3dgs ed3dgs/annealed_early/model
ex4dgs ex4dgs/small/model
grid4d grid4d/dnerf_like/model
hybrid4dgs hybrid4dgs/small/model
modecgs modecgs/default_like/model
motiongs motiongs/dynerf_6dof_small/model
omg4 omg4/comp_xz
realtime4dgs realtime4dgs/rot4d_noshfs
freetimegs freetimegs/still_sh0_no_optimizers
freetimegspp freetimegspp/gated_sh3
rotor4dgs rotor4dgs/old_names
gaussianflow gaussianflow/dnerf_like
gifstream gifstream/entropy_knn
scgs scgs/real_mask_hyper2/model
shapeofmotion shapeofmotion/fg_only_k4
spacetimegs spacetimegs/full_techni/model
tc3dgs tc3dgs/trained
RUNS
ln -s "$root/fixtures/hybrid4dgs/small/train_config.yaml" "$here/train_config.yaml"
ln -s "$root/fixtures/splat4d/default_bounds/scene.splat4d" "$here/clip.splat4d"
ln -s "$root/fixtures/4dgs/birth_sh2/scene.4dgs" "$here/scene.4dgs"
ln -s "$root/fixtures/datasets/blender_mini" "$here/data/balls"
ln -s "$root/fixtures/datasets/dynerf_mini" "$here/data/steak"
(
    cd "$here" && "$bin/spin-import" court -o court.spin --data court -q &&
        "$bin/spin-import" output/balls -o balls.spin --data data/balls -q &&
        for copy in ball in clip bball; do cp court.spin $copy.spin; done &&
        "$bin/spin-retrain" court.spin -o better.spin --iterations 20 --log train.jsonl -q &&
        "$bin/spin-export" court.spin --to ply -o frames -q && cp -r frames ply &&
        for i in 0 1 2 3 4 5; do mv ply/frame_0000$i.ply ply/$((i + 8)).ply; done
) >"$work/out" 2>"$work/err"
is "$?" 0 "a place with what the examples take"

cat >"$work/path/spin-retrain" <<RETRAIN
#!/bin/sh
case "\$*" in *'--log train.jsonl'*) rm -f train.jsonl ;; esac
case "\$*" in
*'--method frames'*--refine* | *--refine*'--method frames'* | *--iterations*) ;;
*'--method frames'*) set -- "\$@" --refine 5 ;;
*) set -- "\$@" --iterations 5 ;;
esac
case "\$*" in
*--hash-log2* | *'--method frames'*) ;;
*'--preset paper'* | *'--preset short'* | *--refine*) set -- "\$@" --hash-log2 12 ;;
esac
exec "$bin/spin-retrain" "\$@"
RETRAIN
cat >"$work/path/mpirun" <<MPIRUN
#!/bin/sh
exec $(command -v mpirun || echo mpirun) --oversubscribe --allow-run-as-root "\$@"
MPIRUN
for name in import eval export; do
    ln -s "$bin/spin-$name" "$work/path/spin-$name"
done
cat >"$work/path/spin4d" <<SPIN4D
#!/bin/sh
case "\$1" in
import | retrain | eval | export) name=\$1 && shift && exec spin-\$name "\$@" ;;
*) exec "$bin/spin4d" "\$@" --iterations 5 ;;
esac
SPIN4D
chmod +x "$work"/path/*

# missing: what some examples need and this machine lacks; COLMAP and ffmpeg lack footage.
has() { command -v "$1" >/dev/null; }
missing=' footage'
python3 -c 'import numpy' 2>/dev/null || missing="$missing NumPy"
[ -f "$bin/../lib/spin-video.so" ] || missing="$missing FFmpeg"
has mpirun && [ -f "$bin/../lib/spin-mpi.so" ] || missing="$missing Open-MPI"
has jq || missing="$missing jq"

# lacks SCRIPT: prints which of them the example needs.
lacks() {
    awk -v missing="$missing " '
        function need(what) { if (index(missing, " " what " ") && !said[what]++) print what }
        /^ *(colmap|ffmpeg) / { need("footage") }
        /^mpirun/ { need("Open-MPI") }
        /--to video|\.mp4|\.webm/ { need("FFmpeg") }
        /[|] jq/ { need("jq") }
        /^import (.*numpy|spin4d)/ { need("NumPy") }' "$1"
}

# A copy of the folder without the files that the examples of this document write.
begin_document() { # DOCUMENT
    rm -rf "$work/fresh"
    cp -al "$here" "$work/fresh"
    grep " $1:" "$work/index" | while read -r number kind place; do
        [ "$kind" = stray ] || cat "$blocks/$number.$kind"
    done >"$work/document"
    {
        grep -oE '(-o|--output|--images|--preview) [^ ]+' "$work/document"
        grep -oE '^spin4d .*-o [^ ]+' "$work/document" | sed 's/\.[a-z0-9]*$/.spin/'
    } | awk -v into="$work/fresh/" '{ sub(/\/$/, ""); print into $NF }' | xargs -d '\n' -r rm -rf
}

sed -n 's/^\([^#].*\) | .*/\1/p' tests/cli/examples.list >"$work/listed"
: >"$work/met"
document=
while read -r number kind place; do
    [ "$kind" = stray ] && continue
    file=$blocks/$number.$kind
    if [ "$kind" = sh ]; then
        {
            echo set -e
            while IFS= read -r line; do
                while IFS= read -r begin; do
                    case $line in "$begin"*) echo "$begin" >>"$work/met" && continue 2 ;; esac
                done <"$work/listed"
                printf '%s\n' "$line"
            done <"$blocks/$number.lines"
        } | sed -f tests/cli/examples.sed >"$work/script"
        [ "$(wc -l <"$work/script")" -gt 1 ] || continue
    else
        cp "$file" "$work/script"
    fi
    lacking=$(lacks "$work/script")
    if [ -n "$lacking" ]; then
        skip "$place" "needs $(echo $lacking)"
        continue
    fi
    [ "${place%:*}" = "$document" ] || begin_document "${place%:*}"
    document=${place%:*}
    if [ "$kind" = py ]; then
        (cd "$work/fresh" && PYTHONPATH=$root/exporters/python PATH=$work/path:$PATH python3 "$work/script") >"$work/out" 2>"$work/err" </dev/null
    else
        (cd "$work/fresh" && SLURM_ARRAY_TASK_ID=0 PATH=$work/path:$PATH sh "$work/script") \
            >"$work/out" 2>"$work/err" </dev/null
    fi
    code=$?
    while read -r line && [ "$line" = 'set -e' ]; do :; done <"$work/script"
    is "$code" 0 "$place: $line"
done <"$work/index"
is "$(sort -u "$work/met" | grep -vxF -f - "$work/listed")" "" "examples.list names no example that is not there"
done_testing
