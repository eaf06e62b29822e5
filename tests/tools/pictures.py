"""exr(path): the channels of an EXR of scan lines, as arrays by name; without compression, or by
ZIP. exr_head(path): the attributes of its header, as bytes by name, and where the header ends.
png(path): [height, width, channels] of a PNG, 0 to 1."""
import struct
import zlib

import numpy as np


def text(data, at):
    end = data.index(b"\0", at)
    return data[at:end].decode(), end + 1


def exr_head(path):
    data = open(path, "rb").read()
    assert data[:4] == b"\x76\x2f\x31\x01" and data[4] == 2 and not data[5] & 2, "scan lines of EXR 2"
    at, head = 8, {}
    while data[at]:
        name, at = text(data, at)
        kind, at = text(data, at)
        size, = struct.unpack_from("<i", data, at)
        head[name] = data[at + 4:at + 4 + size]
        at += 4 + size
    return head, at + 1


def exr(path):
    data, (head, at) = open(path, "rb").read(), exr_head(path)
    channels, k = [], 0
    while head["channels"][k]:
        name, k = text(head["channels"], k)
        channels.append((name, {1: "<f2", 2: "<f4"}[struct.unpack_from("<i", head["channels"], k)[0]]))
        k += 16
    x0, y0, x1, y1 = struct.unpack("<4i", head["dataWindow"])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    rows = {0: 1, 2: 1, 3: 16}[head["compression"][0]]
    line = np.dtype([(n, t, width) for n, t in channels])
    out = np.zeros(height, line)
    for place in struct.unpack_from(f"<{-(-height // rows)}q", data, at):
        y, size = struct.unpack_from("<ii", data, place)
        n = min(rows, height - (y - y0))
        piece = data[place + 8:place + 8 + size]
        if size < n * line.itemsize:  # differences of halves that are apart
            d = np.frombuffer(zlib.decompress(piece), np.uint8).astype(np.int64)
            d[1:] -= 128
            d = (np.cumsum(d) & 255).astype(np.uint8)
            both = np.empty(len(d), np.uint8)
            both[0::2], both[1::2] = d[:(len(d) + 1) // 2], d[(len(d) + 1) // 2:]
            piece = both.tobytes()
        out[y - y0:y - y0 + n] = np.frombuffer(piece, line, n)
    return {n: out[n].astype(np.float64) for n, _ in channels}


def unfilter(kind, row, above, step):
    """The bytes of a row of a PNG; above is zero for the first one."""
    if kind == 1:
        return row.reshape(-1, step).cumsum(0, dtype=np.uint8).ravel()
    if kind in (0, 2):
        return row + above * np.uint8(kind // 2)
    now = [0] * step
    for value, a, b, c in zip(row.tolist(), now, above.tolist(), [0] * step + above.tolist()):
        if kind == 3:
            near = (a + b) // 2
        else:
            left, up, corner = abs(b - c), abs(a - c), abs(a + b - 2 * c)
            near = a if left <= up and left <= corner else b if up <= corner else c
        now.append(value + near & 255)
    return now[step:]


def png(path):
    data, at, packed = open(path, "rb").read(), 8, b""
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8:at + 8 + size]
        if kind == b"IHDR":
            width, height, bits, colour = struct.unpack_from(">IIBB", body)
        packed += body if kind == b"IDAT" else b""
        at += 12 + size
    n = {0: 1, 2: 3, 4: 2, 6: 4}[colour]
    step, stride = n * bits // 8, width * n * bits // 8
    rows = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(height, stride + 1)
    out = np.zeros((height, stride), np.uint8)
    for y in range(height):
        out[y] = unfilter(int(rows[y, 0]), rows[y, 1:], out[y - 1], step)
    whole = np.frombuffer(out.tobytes(), ">u2" if bits == 16 else "u1").reshape(height, width, n)
    return whole.astype(np.float64) / (2 ** bits - 1)
