#!/bin/sh
# deb.sh BUILD: builds Debian packages of the last commit in BUILD/deb, from the tarball that
# `make dist` wrote to BUILD. The folder of this script becomes debian/ in the unpacked tree.
# NOTEST=1 skips the tests, LINTIAN=0 skips lintian.
BUILD=${1:?usage: deb.sh BUILD}
here=$(dirname "$0")
version=$(sed -n 's/^#define SPIN_VERSION "\(.*\)"/\1/p' src/spin.h)
for tool in dpkg-buildpackage dh lintian; do
    command -v $tool >/dev/null || [ "$tool$LINTIAN" = lintian0 ] || {
        echo "deb: $tool not found: apt-get install dpkg-dev debhelper lintian" >&2
        exit 1
    }
done
deb=$BUILD/deb
tree=$deb/spin4d-$version
rm -rf "$deb"
mkdir -p "$deb" || exit 1
cp "$BUILD/spin4d-$version.tar.gz" "$deb/spin4d_$version.orig.tar.gz" || exit 1
tar -C "$deb" -xzf "$BUILD/spin4d-$version.tar.gz" || exit 1
cp -R "$here" "$tree/debian" || exit 1
rm -f "$tree"/debian/*.sh "$tree/debian/wheel.py"
# The changelog contains the version and date of the source tree, so that builds are reproducible.
cat >"$tree/debian/changelog" <<CHANGES
spin4d ($version-1) UNRELEASED; urgency=medium

  * See /usr/share/doc/spin4d/changelog.gz.

 -- spin4d <spin4d@spin4d.invalid>  $(LC_ALL=C TZ=UTC date -R -r "$tree/Makefile")
CHANGES
[ -z "$NOTEST" ] || export DEB_BUILD_OPTIONS="nocheck $DEB_BUILD_OPTIONS"
# Do not inherit variables of a calling make.
unset MAKEFLAGS MFLAGS MAKELEVEL CFLAGS CXXFLAGS CPPFLAGS LDFLAGS CC CXX BUILD
(cd "$tree" && dpkg-buildpackage --no-sign) || exit 1
# The package was never uploaded, so there is no bug for its changelog to close.
[ "$LINTIAN" = 0 ] || lintian --fail-on error,warning --suppress-tags initial-upload-closes-no-bugs --allow-root \
    "$deb"/*.changes || exit 1
ls "$deb"/*.deb
