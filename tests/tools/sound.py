#!/usr/bin/env python3
"""Makes and examines the sounds of tests.

tone FILE SECONDS       a WAV file of 8 kHz whose samples count hundredths of a second
burst FILE AT          two seconds of silence, except for a tone of half a second from AT on
opus FILE SECONDS       first and last page of an Ogg Opus file, without packets of sound
extract FILE OUT        the sound in a .spin, .tsog, .sogst or .4dgs
heard FILE [START]      length and first hundredth of a second of a WAV file made by tone
"""
import json
import math
import struct
import sys
import zipfile

RATE = 8000


def tone(path, seconds):
    write(path, [100 + i * 100 // RATE * 10 for i in range(int(float(seconds) * RATE))])


def burst(path, at):
    at = float(at)
    write(path, [int(20000 * math.sin(i * 0.8)) if at <= i / RATE < at + 0.5 else 0 for i in range(2 * RATE)])


def write(path, samples):
    data = struct.pack("<%dh" % len(samples), *samples)
    head = struct.pack("<IHHIIHH", 16, 1, 1, RATE, 2 * RATE, 2, 16)
    with open(path, "wb") as f:
        f.write(b"RIFF" + struct.pack("<I", 36 + len(data)) + b"WAVEfmt " + head)
        f.write(b"data" + struct.pack("<I", len(data)) + data)


def opus(path, seconds):
    def page(flags, position, packet):
        return b"OggS\0" + struct.pack("<BqIIIBB", flags, position, 1, 0, 0, 1, len(packet)) + packet

    with open(path, "wb") as f:
        f.write(page(2, 0, b"OpusHead" + struct.pack("<BBHIhB", 1, 1, 312, 48000, 0, 0)))
        f.write(page(4, int(float(seconds) * 48000) + 312, b"\0"))


def extract(path, out):
    data = open(path, "rb").read()
    if data[:2] == b"PK":
        archive = zipfile.ZipFile(path)
        meta = json.load(archive.open("meta.json"))
        audio = meta.get("audio") or meta.get("asset", {}).get("audio")
        found = archive.read(audio["file"] if audio else "sound")
    else:
        at, found = 8, b""
        while at < len(data) - 8:
            opcode, n = data[at], struct.unpack_from("<Q", data, at + 1)[0]
            if opcode == 0x12:
                found = data[at + 21 : at + 9 + n]
            at += 9 + n
    open(out, "wb").write(found)


def heard(path):
    data = open(path, "rb").read()
    assert struct.unpack("<II", data[4:8] + data[40:44]) == (len(data) - 8, len(data) - 44)
    first = struct.unpack_from("<h", data, 44)[0]
    print("%g s from %g" % ((len(data) - 44) / 2 / RATE, (first - 100) / 1000))


globals()[sys.argv[1]](*sys.argv[2:])
