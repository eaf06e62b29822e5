#!/bin/sh
# K: plugin install
# An installed spin4d loads importers and exporters that were built with nothing but its header.
. tests/cli/lib.sh
unset SPIN_PLUGIN_PATH
CC=${CC:-gcc}
prefix=$work/usr
stage=$work/stage

# This very build, installed below a DESTDIR; `make install` copies and compiles nothing.
build=${SPIN_BUILD:-build/release}
cuda=0 # a build without the object for cards stays one
[ -f "$build/lib/spin-cuda.so" ] && cuda=auto
run make -s BUILD="$(dirname "$build")" CONFIG="$(basename "$build")" CUDA=$cuda DESTDIR="$stage" PREFIX="$prefix" install
is "$code" 0 "make install with DESTDIR and PREFIX"
[ ! -e "$prefix" ]
ok $? "writes below DESTDIR only"
mv "$stage$prefix" "$prefix"
for file in bin/spin-import lib/libspin.a lib/libspin.so.0 lib/spin4d/spin-image.so lib/spin4d/spin-image-plain.so include/spin4d/spin.h \
    share/bash-completion/completions/spin-import share/zsh/site-functions/_spin-export \
    share/man/man1/spin-import.1 share/man/man5/spin-bundle.5 share/man/man7/spin-plugin.7 \
    lib/python3/dist-packages/spin4d.py lib/pkgconfig/spin4d.pc share/doc/spin4d/example-plugin/Makefile; do
    [ -s "$prefix/$file" ]
    ok $? "installs $file"
done
bin=$prefix/bin

SPIN_CFLAGS=-I$prefix/include/spin4d
if command -v pkg-config >/dev/null 2>&1; then
    SPIN_CFLAGS=$(PKG_CONFIG_PATH=$prefix/lib/pkgconfig pkg-config --cflags spin4d)
    is "${SPIN_CFLAGS% }" "-I$prefix/include/spin4d" "pkg-config knows where spin.h is"
    run env PKG_CONFIG_PATH="$prefix/lib/pkgconfig" pkg-config --modversion spin4d
    is "spin-import $(cat "$work/out")" "$("$bin/spin-import" --version)" "and the version"
fi

# The example, built outside the tree.
cp -r "$prefix/share/doc/spin4d/example-plugin" "$work/example"
run make -s -C "$work/example" CC="$CC" SPIN_CFLAGS="$SPIN_CFLAGS" CFLAGS='-O1 -Wall -Wextra -Werror'
is "$code" 0 "the example builds against the install"
importer=$work/example/points-csv.so
exporter=$work/example/xyz.so

cat >"$work/two.csv" <<CSV
frame,x,y,z,red,green,blue
3,0.5,1,-0.25,255,0,128
3,1,2,3,0,255,0
7,0,0,0.125,10,20,30
CSV

run "$bin/spin-import" --list
! grep -q points-csv "$work/out"
ok $? "without SPIN_PLUGIN_PATH nothing is loaded"
(cd "$work/example" && cp ../two.csv . && SPIN_PLUGIN_PATH=: "$bin/spin-import" --list) >"$work/out"
! grep -q points-csv "$work/out"
ok $? "an empty piece of it is not the folder we are in"
run "$bin/spin-import" --info "$work/example/two.csv"
fails 1 spin-import "a plug-in beside the input is not loaded"

export SPIN_PLUGIN_PATH="$work/example"
run "$bin/spin-import" --list
is "$code" 0 "a folder of plug-ins"
is "$(wc -c <"$work/err")" 0 "loads without a word"
out_has "^points-csv  *tracks coloured points" "--list has the importer"
out_has "plug-in .*/example/points-csv.so" "and where it came from"
run "$bin/spin-import" --list --json
is_json "--list --json is JSON"
out_has '"plugin": ".*points-csv.so"' "that says so too"
run "$bin/spin-export" --list
out_has "^xyz  *places as text" "spin-export --list has the exporter"
run "$bin/spin-import" --from points-csv --help
out_has "^ *--size LENGTH " "--help has the importer's options"
run "$bin/spin-export" --to xyz --help
out_has "^ *--colour " "and the exporter's"

run "$bin/spin-import" "$work/two.csv" -o "$work/two.spin" --size 0.1 --json
is "$code" 0 "imports"
is "$(member from)" points-csv "by detection"
is "$(member frames)" 2 "two frames"
out_has '"max": 2$' "of up to two points"
run "$bin/spin-export" "$work/two.spin" --to xyz -o "$work/xyz" --colour
is "$code" 0 "exports"
is "$(cat "$work/xyz/frame_00003.xyz")" "0.5 1 -0.25 255 0 128
1 2 3 0 255 0" "what was imported, frame 3"
is "$(cat "$work/xyz/frame_00007.xyz")" "0 0 0.125 10 20 30" "and frame 7"
run "$bin/spin-export" "$work/two.spin" --to xyz -o "$work/xyz"
fails 1 spin-export "an exporter's failure"
err_has "use --force" "says what to do"
run "$bin/spin-export" "$work/two.spin" --to ply -o "$work/ply"
is "$code" 0 "a built-in exporter takes it as well"

echo "frame,x,y,z,red,green,blue
0,1,2" >"$work/short.csv"
run "$bin/spin-import" "$work/short.csv" -o "$work/short.spin"
fails 1 spin-import "a plug-in's failure"
err_has "short.csv' line 2: expected frame,x,y,z" "has its own words"
nothing_at "$work/short.spin" "nothing was written"
run "$bin/spin-import" "$work/two.csv" -o "$work/bad.spin" --size -1
fails 2 spin-import "a wrong value of a plug-in's option"
run "$bin/spin-import" "$work/two.csv" -o "$work/bad.spin" --from d3dgs --size 1
fails 2 spin-import "an option of another importer"

# ---- Broken plug-ins -----------------------------------------------------------------------------

# variant NAME SED: the example importer, edited, as $work/broken/NAME.so
mkdir "$work/broken"
variant() {
    sed "$2" "$work/example/points-csv.c" >"$work/broken/$1.c"
    $CC -std=gnu11 -fPIC -shared -w $SPIN_CFLAGS -o "$work/broken/$1.so" "$work/broken/$1.c"
}
# refused NAME WORDS: skipped with a warning that contains WORDS; an error if named.
refused() {
    export SPIN_PLUGIN_PATH="$work/broken/$1.so:$exporter"
    run "$bin/spin-import" --list
    is "$code" 0 "$1: the rest works"
    is "$(grep -c '^warning: ' "$work/err"), $(wc -l <"$work/err")" "1, 1" "$1: one line of warning"
    err_has "^warning: .*$1.so.*$2" "$1: names the file and why"
    run "$bin/spin-import" --from "$1" "$work/two.csv" -o "$work/bad.spin"
    fails 1 spin-import "$1, asked for"
    err_has "$1.so.*$2" "$1, asked for: names the file and why"
}

variant future 's/SPIN_PLUGIN_ABI/(SPIN_PLUGIN_ABI + 1)/'
abi=$(sed -n 's/^#define SPIN_PLUGIN_ABI //p' src/spin.h)
refused future "built for version $((abi + 1)) of spin.h, expected version $abi"
variant mixed '/const struct spin_importer points_csv/,/^};/ s/SPIN_PLUGIN_ABI/(SPIN_PLUGIN_ABI - 1)/'
refused mixed "an importer was built for another version"
variant nameless 's/^const struct spin_plugin spin_plugin/static const struct spin_plugin hidden/; s/-csv"/-x"/'
refused nameless "symbol 'spin_plugin' is missing"
variant needy 's/spin_splats_reserve(/spin_splats_conjure(/'
refused needy "undefined symbol: spin_splats_conjure"
variant frameless 's/^    .frame = .*//'
refused frameless "open() but no frame()"
echo "not a shared object, however long the file may be: sixty-four bytes and more" >"$work/broken/text.so"
refused text "invalid ELF header"
: >"$work/broken/empty.so"
refused empty "file too short"
refused absent "does not exist"

# breaks NAME SED WORDS: loads, but violates the contract of the header.
breaks() {
    variant "$1" "$2"
    SPIN_PLUGIN_PATH=$work/broken/$1.so run "$bin/spin-import" "$work/two.csv" -o "$work/bad.spin"
    fails 1 spin-import "$1"
    err_has "the importer 'points-csv' $3" "$1: says so"
    nothing_at "$work/bad.spin" "$1: nothing was written"
}
breaks frames 's/n_frames = run->n_frames;/n_frames = 0;/' "found no frames"
variant twice 's/sequence->numbers = run->numbers;/static int same[99]; sequence->numbers = same;/'
SPIN_PLUGIN_PATH=$work/broken/twice.so run "$bin/spin-import" "$work/two.csv" -o "$work/bad.spin"
fails 1 spin-import "numbers twice"
err_has "two frames have the number 0" "numbers twice: says which"
breaks degree 's/sh_degree = 0;/sh_degree = 4;/' "provides SH of degree 4"
breaks change 's/sh_degree = 0;/sh_degree = 1;/' "provides SH of degree 0 in frame 0, but declared degree 1"
breaks hollow 's/SPIN_TRY(spin_splats_reserve(.*/out->n = 3; return SPIN_OK;/' "provides no means in frame 0"

variant clash 's/"points-csv"/"ply"/'
export SPIN_PLUGIN_PATH="$work/broken/clash.so"
run "$bin/spin-import" --from ply --help
is "$code" 0 "a name that is taken: the built-in one stays"
err_has "^warning: .*clash.so': an importer called 'ply' exists already: built in; the plug-in is skipped" \
    "and a warning says so"
export SPIN_PLUGIN_PATH="$importer:$work/example:$importer"
run "$bin/spin-import" --list
is "$(grep -c '^points-csv' "$work/out"), $(wc -c <"$work/err")" "1, 0" "named three times: loaded once"
variant again ''
export SPIN_PLUGIN_PATH="$importer:$work/broken/again.so"
run "$bin/spin-import" --list
err_has "again.so': an importer called 'points-csv' exists already: .*example/points-csv.so" \
    "two of a name: the first stays"
export SPIN_PLUGIN_PATH="$work/nowhere/"
run "$bin/spin-retrain" "$work/two.spin" --dry-run -o "$work/x.spin" --data "$work/xyz" --data-from panoptic
err_has "^warning: plug-in '$work/nowhere/' of SPIN_PLUGIN_PATH does not exist" "a folder that is missing"

# ---- A data set ----------------------------------------------------------------------------------

cat >"$work/two-cameras.c" <<'C'
#include <spin.h>

/* Two cameras, the first held out, over the images of the bundled clip. */
static spin_status two_views(const char *path, const struct spin_plugin_values *values,
                             struct spin_views *out)
{
    static const int id[] = {0, 12};
    double z = atof(spin_plugin_value(values, "z", "3"));

    for (int i = 0; i < 12; i++) {
        char image[4096];
        struct spin_view view = {
            .camera = {160, 90, 120, 120, 80, 45, {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, z}},
            .dataset_frame = i / 2, .number = 8 + i / 2, .time = i / 2,
            .camera_id = id[i % 2], .test = i % 2 == 0, .path = image};

        snprintf(image, sizeof image, "%s/ims/%d/%06d.jpg", path, view.camera_id, view.number);
        SPIN_TRY(spin_views_add(out, &view));
    }
    out->numbered = true;
    return SPIN_OK;
}

static const struct spin_plugin_option options[] = {{"z", "Z", "how far back", "3"}, {0}};
static const struct spin_importer two_cameras = {.abi = SPIN_PLUGIN_ABI, .name = "two-cameras",
    .summary = "made up", .options = options, .views = two_views};
const struct spin_plugin spin_plugin = {.abi = SPIN_PLUGIN_ABI,
    .importers = (const struct spin_importer *const[]){&two_cameras, NULL}};
C
$CC -std=gnu11 -fPIC -shared -w -include stdlib.h $SPIN_CFLAGS -o "$work/two-cameras.so" "$work/two-cameras.c"
ok $? "a plug-in that reads data sets"
export SPIN_PLUGIN_PATH="$work/two-cameras.so"
run "$bin/spin-import" "$clip" --data "$clip" --data-from two-cameras:z=4 -o "$work/clip.spin"
is "$code" 0 "is asked for by --data-from, with its option"
run "$bin/spin-retrain" "$work/clip.spin" -o "$work/x.spin" --dry-run --json
is "$code" 0 "a later command finds it again"
run "$bin/spin-eval" "$work/clip.spin" --source --json
is "$code $(grep -c '"camera": 0' "$work/out") $(grep -c '"camera": 12' "$work/out")" "0 6 0" \
    "the camera that it holds out is measured"
unset SPIN_PLUGIN_PATH
run "$bin/spin-retrain" "$work/clip.spin" -o "$work/x.spin" --dry-run
[ "$code" != 0 ]
ok $? "without the plug-in that data set is not known"
err_has "two-cameras" "and its name is said"

# The example of spin.h as a program of its own, linked with the installed library.
if command -v pkg-config >/dev/null 2>&1 && [ "$(basename "${SPIN_BUILD:-release}")" = release ]; then
    {
        echo '#include <spin.h>'
        echo 'int main(void) {'
        sed -n '/^ \* Example: print/,/^ \*\//p' "$prefix/include/spin4d/spin.h" |
            sed -n 's/^ \*     //p' | sed 's|"ball.spin"|"'"$work/two.spin"'"|'
        echo 'return 0; }'
    } >"$work/use.c"
    export PKG_CONFIG_PATH="$prefix/lib/pkgconfig"
    run $CC -o "$work/use" "$work/use.c" $(pkg-config --cflags --libs spin4d)
    is "$code" 0 "a program links the installed library"
    run env LD_LIBRARY_PATH="$prefix/lib" "$work/use"
    is "$(cat "$work/out")" "2 splats" "and reads a bundle"
    run "$work/use"
    err_has 'libspin\.so\.0' "it is the shared one, by its soname"
    run ${CXX:-g++} -x c++ -o "$work/use" "$work/use.c" -x none $(pkg-config --cflags --libs spin4d)
    is "$code" 0 "so does one in C++"
    run env LD_LIBRARY_PATH="$prefix/lib" "$work/use"
    is "$(cat "$work/out")" "2 splats" "which reads it as well"
    run $CC -o "$work/use" "$work/use.c" $(pkg-config --static --cflags --libs spin4d | sed 's/-lspin/-l:libspin.a/')
    is "$code" 0 "a program links the static library"
    run "$work/use"
    is "$(cat "$work/out")" "2 splats" "and does without the shared one"
fi
done_testing
