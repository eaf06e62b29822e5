#!/bin/sh
# K: long build install make portable wheel
# The tarball of `make portable` works with an empty environment, from another folder and without
# any library of this machine; so does the wheel.
. tests/cli/lib.sh
build=${SPIN_BUILD:-build/release}
portable() { make --no-print-directory -s BUILD="$(dirname "$build")" CONFIG="$(basename "$build")" CUDA=0 SETUP=0 portable "$@"; }
unset MAKEFLAGS MFLAGS MAKELEVEL

if [ "$(basename "$build")" != release ] || ! command -v dpkg >/dev/null; then
    skip "make portable" "it needs the release build and dpkg"
    done_testing
fi
run portable
is "$code" 0 "make portable"
tarball=$(sed -n 's/: for the C library .*//p' "$work/out")
cp "$tarball" "$work/first.tar.gz"
mkdir "$work/again"
run sh src/packaging/portable.sh "$(sed -n 's/^#define SPIN_VERSION "\(.*\)"/\1/p' src/spin.h)" "$build" "$work/again"
cmp -s "$tarball" "$work/again/${tarball##*/}"
ok $? "twice the same bytes"
tar -tzf "$tarball" >"$work/list"
is "$(grep -c '/lib/spin4d/lib[^/]*$' "$work/list")" "$(grep -c '/lib/spin4d/lib[^/]*\.so\.[0-9]*[a-z]*$' "$work/list")" \
    "libraries by the names they are opened by"
is "$(grep -c '/share/doc/spin4d/.*\.copyright$' "$work/list")" "$(($(grep -c '/lib/spin4d/lib[^/]*$' "$work/list") + 3))" \
    "a licence for each, and for the three that are linked statically"
for file in README.md package.json player.d.ts player.js view.html; do
    grep -q "/share/spin4d/player/$file\$" "$work/list"
    ok $? "the player has $file"
done
for file in $(cat man/*.[157] | grep -o 'docs/[a-z/-]*\.md' | sort -u); do
    grep -q "/share/doc/spin4d/$file\$" "$work/list"
    ok $? "$file, which the manual names"
done
run sh tests/portable.sh "$work/first.tar.gz" $clip
is "$code $(cat "$work/out")" "0 portable: works" "it works alone"

# The test detects faults: a package without one of its libraries, and one without the image shim.
tar -C "$work" -xzf "$work/first.tar.gz"
tree=$(echo "$work"/spin4d-*)
(cd "$tree/share/doc/spin4d" && for page in docs/*.md docs/how-to/*.md; do
    grep -o ']([^):#]*' "$page" | cut -c3- | while read -r link; do
        [ -e "$(dirname "$page")/$link" ] || echo "$page: $link"
    done
done) >"$work/broken"
is "$(cat "$work/broken")" "" "no document links to a file that is not installed"
for gone in libpng16.so.16 libwebp.so.7 spin-image-plain.so; do
    mv "$tree/lib/spin4d/$gone" "$work/gone"
    tar -C "$work" -cf "$work/less.tar" "${tree##*/}"
    mv "$work/gone" "$tree/lib/spin4d/$gone"
    run sh tests/portable.sh "$work/less.tar" $clip
    is "$code $(grep -c '^portable: ' "$work/err")" "1 1" "the test fails without $gone"
done
# In a root with nothing but the C library: no /proc, no shell. Runs the first command of the
# README.
root=$work/root
mkdir -p "$root/tmp"
cp -r "$tree" "$root/spin4d"
for library in $(ldd "$tree/bin/spin4d" | grep -o '/[^ ]*'); do
    mkdir -p "$root${library%/*}"
    cp -L "$library" "$root$library"
done
if chroot "$root" /spin4d/bin/spin4d --version >"$work/out" 2>"$work/err"; then
    run chroot "$root" /spin4d/bin/spin4d /spin4d/share/spin4d/sample --iterations 5 -o /tmp/sample.html
    is "$code $(find "$root/tmp" -type f | wc -l)" "0 2" "the sample, without /proc"
    run chroot "$root" /spin4d/bin/spin4d export /tmp/sample.spin --to sog -o /tmp/sog
    is "$code" 0 "and another command, with a library that is loaded later"
elif [ "$(id -u)" = 0 ] && chroot / true 2>/dev/null; then
    ok 1 "starts without /proc"
else
    skip "starts without /proc" "only root may chroot"
fi
is "$(grep -c "ffmpeg -framerate\|install.md" "$tree/README")" 2 "the README says how to get videos and EXR"

# ---- The wheel -----------------------------------------------------------------------------------

for folder in one two; do
    mkdir "$work/$folder"
    run python3 src/packaging/wheel.py "$tarball" "$work/$folder"
    is "$code" 0 "a wheel"
done
wheel=$(echo "$work"/one/*.whl)
cmp -s "$wheel" "$work"/two/*.whl
ok $? "twice the same bytes"
if python3 -c 'import pip' 2>/dev/null; then
    run python3 -m pip install --quiet --no-index --no-deps --no-cache-dir --prefix "$work/site" "$wheel"
    is "$code" 0 "pip installs it"
    chmod -R go-w "$work/site"
    module=$(find "$work/site" -name spin4d.py)
    installed=$(dirname "$(find "$work/site" -name spin-retrain)")
    cp -R $clip "$work/run"
    python=$(python3 -c 'import sys; print(sys.executable)')
    run env -i PATH="$installed" PYTHONPATH="${module%/*}" LD_DEBUG=libs LD_DEBUG_OUTPUT="$work/loads" "$python" -c '
import os, sys, spin4d
os.chdir(sys.argv[1])
print(spin4d.__file__, spin4d._command("spin4d"))
print(spin4d.convert("run", "w.html", iterations=10, quiet=True)["bundle"])' "$work"
    is "$(cat "$work/out")" "$module $installed/spin4d
w.spin" "and the commands and the module work from there"
    for file in player/view.html player/player.js sample/params.npz; do
        [ -s "${installed%/bin}/share/spin4d/$file" ]
        ok $? "$file comes with it"
    done
    grep -q "calling init: ${installed%/bin}.*/lib/spin4d/libpng" "$work"/loads.*
    ok $? "with the libraries that it brings"
else
    skip "pip installs it" "no pip"
fi

run sh src/packaging/chroot.sh no-such-suite 0 "$work"
[ "$code" != 0 ] && grep -q '^portable: ' "$work/err"
ok $? "another Debian that cannot be had is said"
done_testing
