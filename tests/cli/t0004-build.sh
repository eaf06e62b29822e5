#!/bin/sh
# K: build install make
# The Makefile as a packager uses it: their flags, other folders, quiet output, reproducible files
# and a complete uninstall.
. tests/cli/lib.sh
build=${SPIN_BUILD:-build/release}
config=$(basename "$build")
objects='src/base/shim.o src/device/cpu/contract.base.o'
# AddressSanitizer stores the path of a source in the object, even for sources generated in the
# build folder.
[ "$config" = asan ] || objects="$objects exporters/html_page.o"
unset MAKEFLAGS MFLAGS MAKELEVEL

# Runs make in this tree, for its own objects.
own_make() { make --no-print-directory BUILD="$(dirname "$build")" CONFIG="$config" CUDA=0 "$@"; }

# ---- Flags of the packager -----------------------------------------------------------------------

run own_make -n -B V=1 CC=mycc CXX=my++ CPPFLAGS=-DMINE_P CFLAGS=-DMINE_C CXXFLAGS=-DMINE_X LDFLAGS=-Wl,--mine all
is "$code" 0 "make -n with the packager's flags"
compiled=$(grep -c '^mycc .* -c ' "$work/out")
greater "$compiled" 150
ok $? "compiles with their CC"
is "$(grep '^mycc .* -c ' "$work/out" | grep -- '-std=gnu11 .*-fPIC .* -DMINE_C' | grep -c -- '-D_GNU_SOURCE.* -DMINE_P')" \
    "$compiled" "CPPFLAGS and CFLAGS come after those that spin4d needs"
is "$(grep -c '^mycc .*-Wl,--mine.*libspin.a' "$work/out")" 5 "LDFLAGS reach the commands"
is "$(grep '^mycc .*-shared' "$work/out" | grep -c -- '-Wl,--mine .*-soname,libspin.so.0')" 1 "and the shared library"
is "$(grep '^my++ .*-shared' "$work/out" | grep -cv -- '-std=c++17.* -DMINE_X -Wl,--mine ')" 0 \
    "CXX, CXXFLAGS and LDFLAGS reach what is C++"
is "$(grep -c 'mfma.*-DMINE_C' "$work/out")" 0 "a path of the CPU has the last word on its -march"
run env CFLAGS=-DMINE_C make -n -B V=1 CUDA=0 BUILD="$work/env" CONFIG="$config" "$work/env/$config/src/base/text.o"
out_has '-DMINE_C' "CFLAGS of the environment"

# ---- Other folders -------------------------------------------------------------------------------

top=$(pwd)
mkdir "$work/else"
run make -s -C "$work/else" -f "$top/Makefile" CUDA=0 CONFIG="$config" "$work/else/build/$config/src/base/text.o"
is "$code $(wc -c <"$work/out") $(wc -c <"$work/err")" "0 0 0" "make -s from another folder says nothing"
[ -s "$work/else/build/$config/src/base/text.o" ]
ok $? "and builds there"

# ---- Reproducible builds -------------------------------------------------------------------------

# Two trees in folders whose names differ in length, one built inside and one outside.
mkdir "$work/a" "$work/a-longer-name"
for tree in a a-longer-name; do
    cp -R Makefile src importers exporters man "$work/$tree"
done
for object in $objects; do
    set -- "$@" "$config/$object"
done
# shellcheck disable=SC2046
run make -s -C "$work/a" CUDA=0 CONFIG="$config" $(printf 'build/%s ' "$@")
is "$code" 0 "builds in one tree"
# shellcheck disable=SC2046
run make -s -C "$work/a-longer-name" CUDA=0 CONFIG="$config" BUILD="$work/out-of-it" $(printf "$work/out-of-it/%s " "$@")
is "$code" 0 "builds outside another"
for object in "$@"; do
    cmp -s "$work/a/build/$object" "$work/out-of-it/$object"
    ok $? "$object is the same"
done
[ ! -e "$work/a-longer-name/build" ]
ok $? "BUILD leaves the tree alone"

if [ "$(git rev-parse --show-toplevel 2>/dev/null)" = "$(pwd -P)" ]; then
    run make -s BUILD="$work/dist1" dist
    is "$code $(wc -c <"$work/out")" "0 0" "make dist"
    tar=$(basename "$work"/dist1/spin4d-*.tar.gz)
    # The tarball depends on the commit only: gzip stores neither name nor time, tar the time of the
    # commit.
    is "$(od -An -t x1 -N 8 "$work/dist1/$tar")" " 1f 8b 08 00 00 00 00 00" "twice the same tarball"
    is "$(tar -tzvf "$work/dist1/$tar" --full-time --utc | awk '{ print $4, $5 }' | sort -u)" \
        "$(TZ=UTC git log -1 --date=format-local:'%Y-%m-%d %H:%M:%S' --format=%cd)" "of the time of the commit"
    is "$(tar -tzf "$work/dist1/$tar" | sed "s|^${tar%.tar.gz}/||" | grep -v '/$' | grep . | LC_ALL=C sort | cksum)" \
        "$(git ls-tree -r --name-only HEAD | LC_ALL=C sort | cksum)" "with every file of the last commit"
else
    skip "make dist" "not a clone of the repository"
fi

# ---- The shared library --------------------------------------------------------------------------

nm -D --defined-only "$build"/libspin.so.*.*.* | sed 's/.* //' | LC_ALL=C sort >"$work/shown"
grep -o 'spin_[a-z0-9_]*' src/spin.h src/spin_train.h src/spin_run.h | sed 's/.*://' | LC_ALL=C sort -u >"$work/declared"
greater "$(wc -l <"$work/shown")" 40
ok $? "the shared library has the public functions"
is "$(LC_ALL=C comm -23 "$work/shown" "$work/declared")" "" "and shows nothing else"

# ---- Install and uninstall -----------------------------------------------------------------------

for libdir in lib lib/some-machine; do
    run own_make -s BUILD="$work/none" DESTDIR="$work/d" PREFIX=/p LIBDIR=/p/$libdir -o all -n install
    is "$code" 0 "make -n install, LIBDIR=/p/$libdir"
    out_has "install -d $work/d/p/$libdir/spin4d" "libraries into /p/$libdir"
done
mkdir -p "$work/d/p/bin" "$work/d/p/lib/pkgconfig"
echo mine >"$work/d/p/bin/other"
run own_make -s DESTDIR="$work/d" PREFIX=/p install
is "$code $(wc -c <"$work/out")" "0 0" "make -s install says nothing"
greater "$(find "$work/d/p" -type f | wc -l)" 20
ok $? "make install"
run own_make -s DESTDIR="$work/d" PREFIX=/p uninstall
is "$code $(find "$work/d/p" ! -type d -print)" "0 $work/d/p/bin/other" \
    "make uninstall takes all that, and nothing else"
is "$(grep -c rmdir "$work/err")" 0 "without a complaint"
is "$(find "$work/d/p" -name '*spin4d*')" "" "and its folders"

# ---- spin4d.py in the search path of the system's Python -----------------------------------------

if /usr/bin/python3 -c 'import numpy' 2>/dev/null; then
    (HOME=$work/home && export HOME && own_make -s DESTDIR= PREFIX="$HOME/.local" install) >"$work/out" 2>"$work/err"
    run env -u PYTHONPATH -u PYTHONNOUSERSITE HOME="$work/home" /usr/bin/python3 -c \
        'import spin4d; print(spin4d.__file__)'
    is "$code $(cat "$work/out")" "0 $(ls "$work"/home/.local/lib/python3*/*-packages/spin4d.py)" \
        "import spin4d works in an installed tree, without PYTHONPATH"
    # goes_to FOLDER NAME OPTION...: where make would install the module.
    goes_to() {
        folder=$1 name=$2
        shift 2
        run own_make -n DESTDIR="$work/p" "$@" install
        is "$(sed -n 's/^install -m 644 .*spin4d\.py //p' "$work/out")" "$work/p$folder" "$name"
    }
    for prefix in /usr /usr/local; do
        goes_to "$(/usr/bin/python3 -c 'import site, sys
print(*[d for d in site.getsitepackages() if d.startswith(sys.argv[1])][:1])' $prefix/lib/)" \
            "PREFIX=$prefix: in a folder where Python looks" PREFIX=$prefix
    done
    goes_to /usr/local/lib/python3/dist-packages "without Python below PREFIX" PYTHON=no-such-python
    goes_to /else "PYTHONDIR is where it goes" PYTHONDIR=/else
else
    skip "import spin4d" "no /usr/bin/python3 with numpy"
fi

# ---- SETUP=0 -------------------------------------------------------------------------------------

run own_make -n BUILD="$work/none" SETUP=0 test
is "$code" 0 "make -n SETUP=0 test"
mkdir "$work/fake"
printf '#!/bin/sh\necho called >>%s/called\n' "$work" >"$work/fake/apt-get"
chmod +x "$work/fake/apt-get"
PATH=$work/fake:$PATH run own_make BUILD="$work/none" SETUP=0 -o all -o test-bins CC=no-such-compiler K=no-such-test test
[ ! -e "$work/called" ] && [ ! -e "$work/none/test-needs" ]
ok $? "make test SETUP=0 does not call apt-get"
done_testing
