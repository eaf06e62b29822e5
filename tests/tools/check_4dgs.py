#!/usr/bin/env python3
"""Checks a .4dgs of the model gaussian-birth against the rules for writers, and prints its contents in one line."""
import math
import struct
import sys
import zlib

MAGIC = b"\x894DGS1\r\n"
CHANNELS = {0: 3, 1: 3, 2: 1, 3: 3, 4: 3, 5: 1, 6: 3, 7: 1, 8: 1, 9: 1, 10: 1}
STEPS = ("pos", "scale_rel", "rot", "rgb", "alpha", "motion", "time", "sigma_rel")


class Cursor:
    def __init__(self, data):
        self.data, self.at = data, 0

    def bytes(self, n):
        assert self.at + n <= len(self.data), "a field extends beyond its record"
        self.at += n
        return self.data[self.at - n : self.at]

    def get(self, code):
        values = struct.unpack("<" + code, self.bytes(struct.calcsize("<" + code)))
        return values[0] if len(values) == 1 else values

    def text(self):
        return self.bytes(self.get("I")).decode()

    def map(self):
        inner, pairs = Cursor(self.bytes(self.get("I"))), {}
        while inner.at < len(inner.data):
            key = inner.text()
            pairs[key] = inner.text()
        return pairs


def records(data):
    at = len(MAGIC)
    while at < len(data) - len(MAGIC):
        opcode, n = data[at], struct.unpack_from("<Q", data, at + 1)[0]
        assert at + 9 + n <= len(data) - len(MAGIC), "a record extends beyond the file"
        yield at, opcode, data[at + 9 : at + 9 + n]
        at += 9 + n


def stream(c):
    attribute, width, mode, codec, channels, n, size = c.get("BBBBBIQ")
    packed = zlib.decompress(c.bytes(size))
    count = channels * (1 if mode == 2 else n)
    assert codec == 0 and len(packed) == count * width
    symbols = [sum(packed[b * count + i] << (8 * b) for b in range(width)) for i in range(count)]
    smallest = 1 if max(symbols) < 1 << 8 else 2 if max(symbols) < 1 << 16 else 4
    assert width == smallest, "the symbols of stream %d are wider than needed" % attribute
    values = [s >> 1 ^ -(s & 1) for s in symbols]
    if mode == 1:
        for i in range(channels, count):
            values[i] += values[i - channels]
    rows = [values[0:channels]] * n if mode == 2 else [values[channels * i : channels * (i + 1)] for i in range(n)]
    return attribute, rows


def read_chunk(content):
    c = Cursor(content)
    t0, t1, level, n = c.get("ddII")
    codec, plain, size = c.text(), c.get("Q"), c.get("Q")
    assert t0 < t1 and n > 0 and codec == "" and plain == size
    block, found = Cursor(c.bytes(size)), {}
    while block.at < size:
        attribute, rows = stream(block)
        assert attribute not in found and len(rows) == n and len(rows[0]) == CHANNELS[attribute]
        found[attribute] = rows
    assert sorted(found) == list(range(11)), "streams are missing"
    return t0, t1, n, found


def check_life(chunk, windows, steps, cutoff):
    """Nothing of a chunk may be visible outside its interval."""
    t0, t1, n, found = chunk
    for i in range(n):
        lo, hi = windows[found[10][i][0]]
        if not found[9][i][0] & 1:
            sigma = math.exp(found[8][i][0] * steps["sigma_rel"])
            target = min(steps["time"], 0.05 * sigma)
            level = max(-10, min(0, math.floor(math.log2(target / steps["time"]))))
            mu, reach = found[7][i][0] * steps["time"] * 2**level, math.sqrt(-2 * math.log(cutoff)) * sigma
            lo, hi = max(lo, mu - reach), min(hi, mu + reach)
        assert hi <= lo or (t0 <= lo and hi <= t1), "splat %d is visible outside its chunk" % i


def main(path):
    data = open(path, "rb").read()
    assert data.startswith(MAGIC) and data.endswith(MAGIC)
    order, chunks, bands, index, total = [], [], {}, [], 0
    for at, opcode, content in records(data):
        order.append(opcode)
        size, c = 9 + len(content), Cursor(content)
        if opcode == 1:
            profile, library, duration, count, cutoff, model = c.text(), c.text(), c.get("d"), c.get("Q"), c.get("d"), c.text()
            box, degree, flags, attributes = c.get("6d"), c.get("B"), c.get("B"), c.map()
            assert profile == "" and model == "gaussian-birth" and 0 < cutoff < 1 and flags == 0
        elif opcode == 3:
            assert c.text() == "uniform-v1"
            c.get("3d")
            steps = dict(zip(STEPS, c.get("8d")))
            assert c.get("B") == 1
            for name, bound in c.map().items():
                if name != "sh":
                    half = math.log1p(float(bound)) if name.endswith("_rel") else float(bound)
                    assert steps[name] == 2 * half > 0, "the step of %s is not twice its bound" % name
        elif opcode == 4:
            windows = [c.get("dd") for _ in range(c.get("I"))]
            assert len(set(windows)) == len(windows), "a window occurs twice"
        elif opcode == 5:
            chunk = read_chunk(content)
            check_life(chunk, windows, steps, cutoff)
            assert 0 <= chunk[0] and chunk[1] <= duration
            chunks.append((at, size, chunk))
            bands[at] = []
        elif opcode == 7:
            band = c.get("B")
            attribute, rows = stream(c)
            assert attribute == 7 and len(rows) == chunks[-1][2][2] and len(rows[0]) == 3 * (2 * band + 1)
            assert all(0 <= code <= 255 for row in rows for code in row)
            bands[chunks[-1][0]].append((band, at, size))
        elif opcode == 8:
            if not index:
                summary = at
            t0, t1, offset, length, n, n_bands = c.get("ddQQII")
            index.append((offset, length, (t0, t1, n), [c.get("BQQ") for _ in range(n_bands)]))
        elif opcode == 12:
            assert c.get("QI") == (count, len(chunks)) and c.get("d") == duration and c.get("6d") == box
        elif opcode == 2:
            assert len(content) == 20 and c.get("QQ") == (summary, 0)
            assert c.get("I") == zlib.crc32(data[summary:at]), "the checksum is wrong"
        else:
            assert opcode in (11, 32), "record %02x" % opcode
    assert order[0] == 1 and order[-1] == 2 and all(order.count(k) == 1 for k in (1, 2, 3, 4))
    assert index == [(at, size, k[:3], bands[at]) for at, size, k in chunks], "the index differs from the chunks"
    assert all([b[0] for b in bands[at]] == list(range(1, degree + 1)) for at in bands)
    assert count == sum(k[2] for _, _, k in chunks)
    print("%d splats, %d chunks, %d windows, SH degree %d, %g s" % (count, len(chunks), len(windows), degree, duration))


main(sys.argv[1])
