#!/usr/bin/env python3
"""Checks a .4dgs against the rules for writers, and prints its contents in one line."""
import math
import struct
import sys
import zlib

MAGIC = b"\x894DGS1\r\n"
CHANNELS = {0: 3, 1: 3, 2: 1, 3: 3, 4: 3, 5: 1, 6: 3, 7: 1, 8: 1, 9: 1, 10: 1}
ID = 13
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


def read_streams(block, n, required):
    """Returns the rows of each attribute; all of them are required, and the others are only
    read."""
    found = {}
    while block.at < len(block.data):
        attribute, rows = stream(block)
        assert attribute not in found and len(rows) == n and len(rows[0]) == {**CHANNELS, ID: 1}[attribute]
        found[attribute] = rows
    assert not n or set(found) >= set(required), "streams are missing"
    return found


def read_chunk(content, keyframed):
    c = Cursor(content)
    t0, t1, level, n = c.get("ddII")
    codec, plain, size = c.text(), c.get("Q"), c.get("Q")
    assert t0 < t1 and (n > 0 or keyframed) and level == 0 and codec == "" and plain == size
    found = read_streams(Cursor(c.bytes(size)), n, list(CHANNELS) + [ID] * keyframed)
    assert keyframed or ID not in found
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


class States:
    """The states of a file of the model keyframe-delta."""

    def __init__(self, degree, steps):
        self.degree, self.step = degree, steps["time"]
        self.live, self.seen, self.dead, self.chunks, self.end = {}, set(), set(), [], 0

    def add(self, at, content, opcode, cutoff):
        fields = self.read_keyframe(at, content) if opcode == 5 else self.read_delta(at, content)
        assert fields["t0"] == self.end < fields["t1"], "the states leave a gap or overlap"
        self.end = fields["t1"]
        fields.update(at=at, size=9 + len(content), live=len(self.live), bands=[])
        self.chunks.append(fields)
        for splat in self.live.values():
            assert all(-(1 << 31) <= v < 1 << 31 for rows in splat.values() for v in rows)

    def insert(self, found, n, t0):
        for i in range(n):
            name = found[ID][i][0]
            assert name not in self.live and name not in self.dead, "an id occurs twice or returns"
            self.seen.add(name)
            self.live[name] = {a: list(found[a][i]) for a in CHANNELS}
            never = found[9][i][0] & 1
            assert never and found[7][i][0] == round(t0 / self.step), "a centre in time is not that of its chunk"

    def read_keyframe(self, at, content):
        t0, t1, n, found = read_chunk(content, True)
        before, self.live = set(self.live), {}
        self.insert(found, n, t0)
        self.dead |= before - set(self.live)
        return dict(t0=t0, t1=t1, n=n, new=n, kind=0, mode=0, reference=0, key=at, depth=0)

    def read_delta(self, at, content):
        c, last = Cursor(content), self.chunks[-1]
        t0, t1, level, mode, reference, key, depth, *counts = c.get("ddIBQQHIII")
        codec, plain, size = c.text(), c.get("Q"), c.get("Q")
        assert level == 0 and mode == 1 and codec == "" and plain == size
        assert (reference, key, depth) == (last["at"], last["key"], last["depth"] + 1)
        block = Cursor(c.bytes(size))
        updates, births, deaths = (Cursor(block.bytes(block.get("Q"))) for _ in range(3))
        updates = read_streams(updates, counts[0], [ID])
        births = read_streams(births, counts[1], list(CHANNELS) + [ID])
        deaths = read_streams(deaths, counts[2], [ID])
        assert not {8, 9, 10} & set(updates) and (2 in updates) == (3 in updates) and set(deaths) <= {ID}
        gone = [row[0] for row in deaths.get(ID, [])]
        for name in gone:
            del self.live[name]
        for i, (name,) in enumerate(updates.get(ID, [])):
            for a in set(updates) - {ID}:
                old, new = self.live[name][a], updates[a][i]
                self.live[name][a] = list(new) if a in (2, 3) else [x + y for x, y in zip(old, new)]
        assert not self.dead & set(gone)
        self.dead |= set(gone)
        self.insert(births, counts[1], t0)
        return dict(t0=t0, t1=t1, n=sum(counts), new=counts[1], kind=1, mode=1, reference=reference, key=key, depth=depth)

    def check_index(self, index):
        assert [e[:5] + e[6:] for e in index] == [
            (c["at"], c["size"], c["t0"], c["t1"], c["n"], (c["kind"], c["mode"], c["reference"], c["key"], c["depth"], c["live"]))
            for c in self.chunks], "the index differs from the chunks"
        assert [e[5] for e in index] == [c["bands"] for c in self.chunks]
        for c in self.chunks:
            assert [b[0] for b in c["bands"]] == list(range(1, self.degree + 1)) * (c["new"] > 0), "SH bands"


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
            keyframed = model == "keyframe-delta"
            assert keyframed or (model == "gaussian-birth" and profile == "")
            assert 0 < cutoff < 1
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
            states = States(degree, steps)
        elif opcode == 16 or (opcode == 5 and keyframed):
            states.add(at, content, opcode, cutoff)
        elif opcode == 5:
            chunk = read_chunk(content, False)
            check_life(chunk, windows, steps, cutoff)
            assert 0 <= chunk[0] and chunk[1] <= duration
            chunks.append((at, size, chunk))
            bands[at] = []
        elif opcode == 7:
            band = c.get("B")
            attribute, rows = stream(c)
            n = states.chunks[-1]["new"] if keyframed else chunks[-1][2][2]
            assert attribute == 7 and len(rows) == n and len(rows[0]) == 3 * (2 * band + 1)
            assert all(0 <= code <= 255 for row in rows for code in row)
            (states.chunks[-1]["bands"] if keyframed else bands[chunks[-1][0]]).append((band, at, size))
        elif opcode == 8:
            if not index:
                summary = at
            t0, t1, offset, length, n, n_bands = c.get("ddQQII")
            found = [c.get("BQQ") for _ in range(n_bands)]
            index.append((offset, length, t0, t1, n, found, c.get("BBQQHQ") if keyframed else ()))
            assert c.at == len(content)
        elif opcode == 12:
            n_chunks = len(states.chunks) if keyframed else len(chunks)
            assert c.get("QI") == (count, n_chunks) and c.get("d") == duration and c.get("6d") == box
        elif opcode == 2:
            assert len(content) == 20 and c.get("QQ") == (summary, 0)
            assert c.get("I") == zlib.crc32(data[summary:at]), "the checksum is wrong"
        elif opcode == 17:
            assert not chunks and not keyframed or not states.chunks, "sound follows splats"
            source = {"id": c.get("I"), "name": c.text(), "codec": c.text(), "layout": c.text(), "bytes": c.get("Q")}
            start, seconds, gain, how, pose, n_keys = c.get("d"), c.get("d"), c.get("d"), c.get("B"), c.get("7d"), c.get("I")
            assert 0 <= start < duration and seconds > 0 and gain >= 0 and how == 0 and n_keys == 0
            assert pose == (0, 0, 0, 0, 0, 0, 1) and c.text() in ("linear", "step") and c.at == len(content)
            assert source["codec"] in ("wav", "opus") and source["layout"] in ("stereo", "unspecified")
        elif opcode == 18:
            assert (c.get("I"), c.get("Q")) == (source["id"], source["bytes"]) and len(content) == 12 + source["bytes"]
        else:
            assert opcode in (11, 32), "record %02x" % opcode
    assert flags == (17 in order) and order.count(17) == order.count(18) <= 1, "sounds"
    assert order[0] == 1 and order[-1] == 2 and all(order.count(k) == 1 for k in (1, 2, 3, 4))
    if keyframed:
        states.check_index(index)
        assert profile == ("keyframed" if len(states.chunks) > 1 else "")
        assert states.end == duration and count == len(states.seen) and windows == [(0, duration)]
        print("%d splats, %d keyframes, %d deltas, SH degree %d, %g s" % (
            count, sum(not c["kind"] for c in states.chunks), sum(c["kind"] for c in states.chunks), degree, duration))
        return
    assert index == [(at, size, *k[:3], bands[at], ()) for at, size, k in chunks], "the index differs from the chunks"
    assert all([b[0] for b in bands[at]] == list(range(1, degree + 1)) for at in bands)
    assert count == sum(k[2] for _, _, k in chunks)
    print("%d splats, %d chunks, %d windows, SH degree %d, %g s" % (count, len(chunks), len(windows), degree, duration))


main(sys.argv[1])
