#!/bin/sh
# K: shim security install
# Shared objects are loaded only from lib/ and lib/spin4d/ beside bin/, and only if nobody else can
# write there.
. tests/cli/lib.sh
CC=${CC:-gcc}
build=$(cd "${SPIN_BUILD:-build/release}" && pwd)
unset SPIN_GLTF_SHIM

# A shared object without a version, whose constructor leaves a trace.
echo '#include <fcntl.h>
__attribute__((constructor)) static void mark(void) { creat(TRACE, 0600); }' >"$work/trap.c"
$CC -shared -fPIC -DTRACE="\"$work/trace\"" -o "$work/trap.so" "$work/trap.c"
ok $? "an object that tells when it is loaded"

# A build like this one, in a folder that another user can write.
tree=$work/up/tree/build/release
mkdir -p "$tree/bin" "$tree/lib"
cp "$build/bin/spin-export" "$tree/bin"
chmod -R go-w "$work/up"
export_glb() {
    rm -f "$work/trace"
    run "${1:-$tree}/bin/spin-export" fixtures/hostile/bundle/explicit.spin --source -o "$work/x.glb"
}
# put_trap FOLDER: puts the traced object there
put_trap() {
    mkdir -p "$1"
    cp "$work/trap.so" "$1/spin-gltf.so"
    chmod 755 "$1" "$1/spin-gltf.so"
}
loads() { # YES-OR-NO NAME
    is "$([ -e "$work/trace" ] && echo yes || echo no)" "$1" "$2"
}

put_trap "$tree/lib"
export_glb
fails 1 spin-export "an object of another version"
loads yes "lib beside bin is where it is looked for"
err_has "'$tree/lib/spin-gltf.so' belongs to another version" "and it is named"
for mode in 775 757; do
    chmod $mode "$tree/lib/spin-gltf.so"
    export_glb
    fails 1 spin-export "an object of mode $mode"
    loads no "an object of mode $mode is not loaded"
    err_has "shim 'spin-gltf.so' is refused: '$tree/lib/spin-gltf.so' is writable by its group or by all users: \
remove these permissions with chmod go-w (see spin4d(7))$" "an object of mode $mode: it says why, and what to do"
    is "$(grep -c "on Debian: install" "$work/err")" 0 "but advises no packages, which are not missing"
    chmod 755 "$tree/lib/spin-gltf.so"
    chmod $mode "$tree/lib"
    export_glb
    loads no "nor one in a folder of mode $mode"
    err_has "'$tree/lib' is writable by its group or by all users" "a folder of mode $mode: it says why"
    chmod 755 "$tree/lib"
done
for what in "$tree/lib/spin-gltf.so" "$tree/lib"; do
    if chown 65534 "$what" 2>/dev/null; then
        export_glb
        loads no "of somebody else: ${what##*/}"
        err_has "'$what' belongs to user 65534, who is neither root, nor you, nor the owner of the program: \
change its owner with chown (see spin4d(7))$" "of somebody else: ${what##*/}: it says why"
        chown 65534 "$tree/bin/spin-export"
        export_glb
        loads yes "the owner of the program is trusted: ${what##*/}"
        chown 0 "$tree/bin/spin-export" "$what"
    else
        skip "objects of somebody else" "root alone can give files away"
    fi
done
chmod 775 "$tree/lib/spin-gltf.so"
put_trap "$tree/lib/spin4d"
export_glb
err_has "cannot be loaded: '$tree/lib/spin4d/spin-gltf.so' belongs to another version" "the reason is that of the last object tried"
rm -r "$tree/lib/spin-gltf.so" "$tree/lib/spin4d"

for folder in up/lib up/lib/spin4d up/tree/lib up/tree/build/lib up/tree/build/release/bin/lib; do
    put_trap "$work/$folder"
    export_glb
    loads no "nothing is loaded from $folder"
    err_has "'spin-gltf.so' is missing" "$folder: it says what is missing"
    rm -r "${work:?}/$folder"
done
put_trap "$tree/lib/spin4d"
export_glb
loads yes "lib/spin4d of a prefix is where it is looked for"
rm -r "$tree/lib/spin4d"

# ---- The real shared objects ---------------------------------------------------------------------

if [ -f "$build/lib/spin-gltf.so" ]; then
    is "$(find "$build/lib" -type f -perm /022)" "" "make leaves none that others can write"
    install -d "$work/copy/bin" "$work/copy/lib"
    install "$build/bin/spin-export" "$work/copy/bin"
    install -m 644 "$build/lib/spin-gltf.so" "$work/copy/lib"
    export_glb "$work/copy"
    is "$code" 0 "a copy of the build elsewhere works"
fi
run make -n -B V=1 BUILD="$work/none" CONFIG=release CUDA=0 VIDEO=yes MPICC=mpicc all
is "$(grep -c '^chmod go-w .*/release/lib .*/release/lib/spin-[a-z]*\.so$' "$work/out")" \
    "$(grep -c -e ' -shared .*/release/lib/spin-[a-z]*\.so ' -e '^cp .*/release/lib/spin-[a-z]*\.so$' "$work/out")" "whatever umask is"
done_testing
