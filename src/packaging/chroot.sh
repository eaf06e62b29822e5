#!/bin/sh
# chroot.sh SUITE VERSION OUT [ARCH]: runs `make portable` on the last commit in a minimal Debian
# system of this suite. Programs linked with an old C library also run with newer ones. debootstrap
# creates the system in OUT/debian-SUITE, which is kept. Reads the tarball that `make dist` wrote to
# OUT. ARCH: another architecture, such as arm64, which QEMU (qemu-user-static) emulates in
# OUT/debian-SUITE-ARCH.
suite=${1:?usage: chroot.sh SUITE VERSION OUT [ARCH]}
version=${2:?usage: chroot.sh SUITE VERSION OUT [ARCH]}
out=${3:?usage: chroot.sh SUITE VERSION OUT [ARCH]}
arch=$4
root=$out/debian-$suite${arch:+-$arch}

fail() {
    echo "portable: $*" >&2
    exit 1
}

[ "$(id -u)" = 0 ] || fail "debootstrap needs root: sudo make portable DEBIAN=$suite"
command -v debootstrap >/dev/null || fail "debootstrap not found: apt-get install debootstrap"
if [ ! -f "$root/ready" ]; then
    rm -rf "$root"
    debootstrap ${arch:+--arch="$arch"} --variant=minbase "$suite" "$root" >"$root.log" 2>&1 || fail "cannot create Debian '$suite': see '$root.log'"
    chroot "$root" env DEBIAN_FRONTEND=noninteractive apt-get install -qq --no-install-recommends make gcc g++ zlib1g-dev \
        liblzma-dev libjansson-dev libjpeg-dev libpng-dev libtinygltf-dev libwebp-dev libzstd-dev \
        >>"$root.log" 2>&1 || fail "cannot install build dependencies: see '$root.log'"
    touch "$root/ready"
fi
rm -rf "$root/tmp/spin4d-$version"
tar -C "$root/tmp" -xzf "$out/spin4d-$version.tar.gz" || exit 1
# debootstrap has created /dev/null and other devices. env -i keeps out variables of a calling make.
chroot "$root" env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin make -s -j"$(nproc)" -C "/tmp/spin4d-$version" SETUP=0 portable || exit 1
cp "$root/tmp/spin4d-$version/build"/spin4d-*-linux-*.tar.gz "$out/" || exit 1
rm -rf "$root/tmp/spin4d-$version"
