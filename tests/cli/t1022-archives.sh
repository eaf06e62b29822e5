#!/bin/sh
# K: archives zip tar gzip import
# Runs in archives are read in place; archives that lie are refused, and nothing is left behind.
. tests/cli/lib.sh

TMPDIR=$work/tmp
export TMPDIR
mkdir -p "$TMPDIR" "$work/run/frames"
for i in 0 1; do cp fixtures/ply/brush_sh1/00001.ply "$work/run/frames/frame_000$i.ply"; done
cp fixtures/splats/sog/frame_00000.sog "$work/one.sog"

empty() { # NAME
    is "$(ls -A "$TMPDIR")" "" "$1: nothing is left in the temporary folder"
}
run "$bin/spin-import" -q "$work/run/frames" -o "$work/plain.spin"
rm -rf "$work/want"
"$bin/spin-export" -q "$work/plain.spin" --to ply -o "$work/want"

python3 - "$work" <<'EOP'
import gzip, io, os, struct, sys, tarfile, warnings, zipfile
warnings.simplefilter('ignore')
os.chdir(sys.argv[1])
frames = ['run/frames/frame_000%d.ply' % i for i in range(2)]
ply = open(frames[0], 'rb').read()

with zipfile.ZipFile('deflated.zip', 'w', zipfile.ZIP_DEFLATED) as z:
    z.writestr('run/', b'')
    z.writestr('__MACOSX/run/._frame.ply', b'x')
    z.writestr('run/.DS_Store', b'x')
    for f in frames:
        z.write(f, f.replace('/', '\\') if f[-5] == '1' else f)
for name, mode, form in (('gnu.tar', 'w', tarfile.GNU_FORMAT), ('pax.tar', 'w', tarfile.PAX_FORMAT),
                         ('ustar.tar.gz', 'w:gz', tarfile.USTAR_FORMAT), ('gnu.tgz', 'w:gz', tarfile.GNU_FORMAT)):
    with tarfile.open(name, mode, format=form) as t:
        long = '' if form == tarfile.USTAR_FORMAT else 'a' * 120 + '/'
        for f in frames:
            t.add(f, './' + long + f)
with open('frame_0007.ply.gz', 'wb') as f:  # two members in sequence, as pigz and bgzip write
    f.write(gzip.compress(ply[:1000]) + gzip.compress(ply[1000:]))
with zipfile.ZipFile('sog.zip', 'w') as z:
    z.write('one.sog')
with zipfile.ZipFile('loose.zip', 'w') as z:  # an unpacked SOG in a folder
    for name in zipfile.ZipFile('one.sog').namelist():
        z.writestr('scene/' + name, zipfile.ZipFile('one.sog').read(name))

def tar(name, *members):
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode='w', format=tarfile.USTAR_FORMAT) as t:
        for member, kind in members:
            info = tarfile.TarInfo(member)
            info.type, info.linkname = kind, '/etc/passwd'
            info.size = len(ply) if kind == tarfile.REGTYPE else 0
            t.addfile(info, io.BytesIO(ply))
    data = bytearray(out.getvalue())
    open(name, 'wb').write(data)
    return data

R = tarfile.REGTYPE
tar('up.tar', ('a/../../b.ply', R))
tar('absolute.tar', ('/b.ply', R))
tar('link.tar', ('b.ply', tarfile.SYMTYPE), ('c.ply', R))
tar('hard.tar', ('b.ply', tarfile.LNKTYPE))
tar('device.tar', ('b.ply', tarfile.CHRTYPE))
tar('twice.tar', ('b.ply', R), ('./b.ply', R))
tar('both.tar', ('b.ply', R), ('b.ply/c.ply', R))
data = tar('whole.tar', ('a.ply', R), ('b.ply', R))
second = 512 + (len(ply) + 511) // 512 * 512
open('cut.tar', 'wb').write(data[:second + 700])
open('boundary.tar', 'wb').write(data[:second])
data[second + 130] ^= 1
open('checksum.tar', 'wb').write(data)
packed = gzip.compress(bytes(tar('whole.tar', ('a.ply', R), ('b.ply', R))))
open('cut.tar.gz', 'wb').write(packed[:len(packed) // 2])
bad = bytearray(packed)
bad[-6] ^= 1
open('crc.tar.gz', 'wb').write(bad)
with open('bomb.ply.gz', 'wb') as f:
    f.write(gzip.compress(bytes(80 << 20)))
with zipfile.ZipFile('bomb.zip', 'w', zipfile.ZIP_DEFLATED) as z:
    z.writestr('a.ply', bytes(80 << 20))

def huge(name, field):  # a member of 2^62 bytes, in a header of tar
    data = tar(name, ('a.ply', R))
    data[124:136] = field
    data[148:156] = b' ' * 8
    data[148:156] = b'%06o\0 ' % sum(data[:512])
    open(name, 'wb').write(data)
huge('huge.tar', b'\x80' + struct.pack('>Q', 1 << 62).rjust(11, b'\0'))
huge('nosize.tar', b'99999999999\0')
def pax(name, record):
    with tarfile.open(name, 'w', format=tarfile.USTAR_FORMAT) as t:
        info = tarfile.TarInfo('pax')
        info.type, info.size = b'x', len(record)
        t.addfile(info, io.BytesIO(record))
        info = tarfile.TarInfo('b.ply')
        info.size = len(ply)
        t.addfile(info, io.BytesIO(ply))
pax('pax-up.tar', b'22 path=../../up.ply\n\n'[:21].replace(b'22', b'21'))
pax('pax-length.tar', b'99 path=b.ply\n')
pax('pax-sparse.tar', b'22 GNU.sparse.major=1\n')
for name, members in (('up.zip', ['../a.ply']), ('drive.zip', ['C:/a.ply']), ('twice.zip', ['a.ply', 'a.ply'])):
    with zipfile.ZipFile(name, 'w') as z:
        for m in members:
            z.writestr(m, ply)
with zipfile.ZipFile('nothing.zip', 'w') as z:
    z.writestr('readme.txt', 'text')
EOP
ok $? "the archives are written"

for name in deflated.zip gnu.tar pax.tar ustar.tar.gz gnu.tgz; do
    run "$bin/spin-import" "$work/$name" -o "$work/got.spin" --force
    is "$code" 0 "$name: is imported"
    out_has "the run was found in '.*/$name/" "$name: the folder in the archive is named"
    rm -rf "$work/got"
    "$bin/spin-export" -q "$work/got.spin" --to ply -o "$work/got"
    diff -r "$work/want" "$work/got"
    ok $? "$name: the splats are those of the folder"
    empty "$name"
done
for input in frame_0007.ply.gz sog.zip loose.zip one.sog; do
    run "$bin/spin-import" --info --json "$work/$input"
    is "$code" 0 "$input: is read"
    empty "$input"
done
run "$bin/spin-import" --info "$work/loose.zip"
out_has "the run was found in '.*/loose.zip/scene'" "an unpacked SOG in an archive"
run "$bin/spin-import" "$work/frame_0007.ply.gz" --from ply -o "$work/named.spin"
is "$code" 0 "with --from"
commands=$(cd "$bin" && pwd)
(cd "$work" && run "$commands/spin4d" ustar.tar.gz --no-retrain -q)
[ -s "$work/ustar.html" ]
ok $? "spin4d names the page after the archive"
empty spin4d

hostile() { # NAME TEXT
    rm -f "$work/none.spin"
    run "$bin/spin-import" "$work/$1" -o "$work/none.spin"
    fails 1 spin-import "$1"
    err_has "$2" "$1: says why"
    empty "$1"
    [ ! -e "$work/none.spin" ] && [ ! -e "$work/b.ply" ] && [ ! -e "$work/up.ply" ]
    ok $? "$1: nothing was written"
}
hostile up.tar "'a/../../b.ply' leads out of the archive"
hostile absolute.tar "'/b.ply' is absolute"
hostile link.tar "'b.ply' is a link; if you trust it, unpack"
hostile hard.tar "'b.ply' is a link"
hostile device.tar "'b.ply' is a device"
hostile twice.tar "several members named './b.ply'"
hostile both.tar "both.tar/b.ply': a file has that name"
hostile cut.tar "is cut short"
hostile boundary.tar "is cut short"
hostile checksum.tar "not a tar archive, or it is damaged"
hostile cut.tar.gz "damaged or cut short after"
hostile crc.tar.gz "damaged or cut short after"
hostile bomb.ply.gz "contains more than .* bytes, far more than its own size"
hostile bomb.zip "contains more than .* bytes, far more than its own size"
hostile huge.tar "is cut short"
hostile nosize.tar "damaged header"
hostile pax-up.tar "leads out of the archive"
hostile pax-length.tar "damaged pax header"
hostile pax-sparse.tar "a sparse file"
hostile up.zip "'../a.ply' leads out"
hostile drive.zip "'C:/a.ply' is absolute"
hostile twice.zip "several members named 'a.ply'"
hostile nothing.zip "cannot recognise '.*/nothing.zip/readme.txt'"

# An error of an importer names the archive and the member.
head -c 2000 "$work/run/frames/frame_0000.ply" >"$work/short.ply"
gzip "$work/short.ply"
hostile short.ply.gz "'[^ ]*/short.ply.gz/short.ply'"

# An interruption while an archive is unpacked.
head -c 50000000 /dev/urandom | gzip -1 >"$work/long.ply.gz"
# In the background, timeout would signal twice, and a second Ctrl-C exits at once.
timeout --foreground -s INT 0.2 "$bin/spin-import" "$work/long.ply.gz" -o "$work/none.spin" 2>"$work/err"
is "$(ls -A "$TMPDIR")" "" "an interrupted import leaves nothing behind"

# A folder that a killed process left behind is removed by the next import of an archive.
"$bin/spin-import" "$work/long.ply.gz" -o "$work/none.spin" 2>/dev/null &
pid=$!
for i in $(seq 200); do
    [ -z "$(ls -A "$TMPDIR")" ] || break
    sleep 0.01
done
kill -KILL $pid
wait $pid 2>/dev/null
is "$(ls -A "$TMPDIR" | wc -l)" 1 "a killed import leaves its folder behind"
run "$bin/spin-import" --info "$work/gnu.tar"
is "$code $(ls -A "$TMPDIR")" "0 " "the next one removes it"
mkdir -p "$work/set"
cp -r fixtures/datasets/panoptic_mini "$work/set"
tar -C "$work/set" -cf "$work/set.tar" panoptic_mini
run "$bin/spin-import" "$work/set.tar" -o "$work/none.spin"
fails 1 spin-import "a data set in an archive"
err_has "contains a data set, not a run: unpack it, and give its folder with --data" "is named"
run "$bin/spin-import" "$work/gnu.tar" --data "$work/set.tar" -o "$work/none.spin"
fails 1 spin-import "an archive for --data"
err_has "it is a tar archive: unpack it and give its contents" "is refused"

TMPDIR=$work/none run "$bin/spin-import" --info "$work/gnu.tar"
is "$code" 0 "without a folder TMPDIR, another temporary folder is used"
done_testing
