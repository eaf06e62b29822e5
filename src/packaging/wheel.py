#!/usr/bin/env python3
"""wheel.py TARBALL OUT: converts the tarball of `make portable` to a wheel.

The wheel contains the Python module, the commands and their libraries, the manual, the player and a
sample clip. pip installs the commands into bin/ of its environment, the libraries into lib/spin4d/,
where the commands find them, and the rest into share/.
This script needs only Python's standard library. The same tarball always gives the same wheel."""
import base64
import hashlib
import os
import re
import sys
import tarfile
import zipfile

tarball, out = sys.argv[1:]
with tarfile.open(tarball) as source:
    tree = {m.name.split("/", 1)[1]: source.extractfile(m).read() for m in source.getmembers() if m.isfile()}
version, machine = re.match(r"spin4d-([\d.]+)-linux-(\w+)\.tar", os.path.basename(tarball)).groups()
libc = re.search(r"C library (\d+)\.(\d+)", tree["README"].decode()).groups()
tag = f"py3-none-manylinux_{libc[0]}_{libc[1]}_{machine}"
data = f"spin4d-{version}.data"
info = f"spin4d-{version}.dist-info"

files = {"spin4d.py": tree.pop("python/spin4d.py"), f"{info}/licenses/LICENSE": tree.pop("LICENSE")}
for path, content in tree.items():
    if path.startswith("bin/"):
        files[f"{data}/scripts/{path[4:]}"] = content
    elif path.endswith(".copyright"):
        files[f"{info}/licenses/{os.path.basename(path)}"] = content
    elif path.startswith(("lib/", "share/")) and not path.startswith("share/completion/"):
        files[f"{data}/data/{path}"] = content

texts = {
    f"{info}/METADATA": f"""Metadata-Version: 2.1
Name: spin4d
Version: {version}
Summary: convert and retrain 4D Gaussian Splatting clips
License: Apache-2.0
Requires-Python: >=3.8
Requires-Dist: numpy
Description-Content-Type: text/markdown

The folder of pip's environment (`python3 -c "import sys; print(sys.prefix)"`) then contains the commands in `bin`, the
manual in `share/man`, documents in `share/doc/spin4d`, the player for web pages in `share/spin4d/player`, and a sample clip:

    spin4d SAMPLE -o sample.html

where SAMPLE is `share/spin4d/sample` in that folder. Images are PNG and JPEG; videos and EXR need a build from source,
which `share/doc/spin4d/docs/how-to/install.md` describes.
""",
    f"{info}/WHEEL": f"Wheel-Version: 1.0\nGenerator: spin4d\nRoot-Is-Purelib: false\nTag: {tag}\n",
}
name = os.path.join(out, f"spin4d-{version}-{tag}.whl")
record = []
with zipfile.ZipFile(name + ".part", "w", zipfile.ZIP_DEFLATED) as wheel:
    def add(member, content, mode):
        entry = zipfile.ZipInfo(member, (1980, 1, 1, 0, 0, 0))
        entry.compress_type = zipfile.ZIP_DEFLATED
        entry.external_attr = (0o100000 | mode) << 16
        wheel.writestr(entry, content)
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        record.append(f"{member},sha256={digest},{len(content)}\n")

    for member, content in files.items():
        add(member, content, 0o755 if "/scripts/" in member else 0o644)
    for member, text in texts.items():
        add(member, text.encode(), 0o644)
    record.append(f"{info}/RECORD,,\n")
    wheel.writestr(zipfile.ZipInfo(f"{info}/RECORD", (1980, 1, 1, 0, 0, 0)), "".join(record))
os.replace(name + ".part", name)
print(name)
