"""record.py FOLDER...: prints a line with a hash for each file below the folders, for changes.py:
members of bundles and other zip files one by one, short text files as text."""
import hashlib
import os
import sys
import zipfile

MOST_TEXT = 20000  # bytes


def lines_of(name, data):
    if len(data) <= MOST_TEXT and not name.endswith((".html", ".npy")):
        try:
            return ["%s: %s" % (name, line) for line in data.decode("ascii").splitlines()]
        except UnicodeDecodeError:
            pass
    return ["%s: %s" % (name, hashlib.sha1(data).hexdigest()[:16])]


def lines_of_file(path, name):
    try:
        with zipfile.ZipFile(path) as z:
            return [line for m in z.infolist() for line in lines_of(name + "/" + m.filename, z.read(m))]
    except Exception:  # no zip file, or a broken one
        pass
    with open(path, "rb") as f:
        return lines_of(name, f.read())


for top in sys.argv[1:]:
    for folder, folders, names in os.walk(top):
        folders.sort()
        for name in sorted(n for n in names if not n.startswith("strace")):  # varies with threads
            path = os.path.join(folder, name)
            if os.path.isfile(path) and not os.path.islink(path) and os.access(path, os.R_OK):
                for line in lines_of_file(path, os.path.relpath(path, top)):
                    print("#~ file " + line)
