// The worker: unpacks frames, keeps some, and sorts the splats of the wanted one for a view.
//
// A block is base64 of a gzip of: one byte a column (1: differences to the key frame, 0: as it is),
// then the columns, those of 16 bits as n low bytes and n high bytes. exporters/lib/html_pack.h writes
// them and says what they mean.
'use strict';

const WIDE = 9, NARROW = 5, MOST_BYTES = 400e6;
let clip = null, blocks = null, wanted = null, busy = false;
const frames = new Map(), keys = new Map();

async function unpack(text) {
    const binary = atob(text), packed = new Uint8Array(binary.length);
    for (let i = 0; i < packed.length; i++) packed[i] = binary.charCodeAt(i);
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'));
    return new Uint8Array(await new Response(stream).arrayBuffer());
}

// The columns of a frame, differences undone.
async function columnsOf(version, frame) {
    const v = clip.versions[version], n = v.splats[frame], key = v.key[frame];
    const base = key === frame ? null : await keyOf(version, key);
    const bytes = await unpack(blocks[version][frame]), narrows = NARROW + v.sh;
    const wide = new Uint16Array(WIDE * n), narrow = new Uint8Array(narrows * n);
    let at = WIDE + narrows;
    for (let c = 0; c < WIDE; c++, at += 2 * n) {
        const add = bytes[c] ? base.wide : null;
        for (let i = 0, o = c * n; i < n; i++, o++) {
            wide[o] = (bytes[at + i] | bytes[at + n + i] << 8) + (add ? add[o] : 0);
        }
    }
    for (let c = 0; c < narrows; c++, at += n) {
        const add = bytes[WIDE + c] ? base.narrow : null;
        for (let i = 0, o = c * n; i < n; i++, o++) narrow[o] = bytes[at + i] + (add ? add[o] : 0);
    }
    return { n, wide, narrow };
}

async function keyOf(version, frame) {
    const name = `${version} ${frame}`;
    if (!keys.has(name)) keys.set(name, await columnsOf(version, frame));
    return keys.get(name);
}

const float = new Float32Array(1), bits = new Uint32Array(float.buffer);
// Half precision, to nearest; too large becomes the largest.
function half(x) {
    float[0] = x;
    const b = bits[0], sign = b >>> 16 & 0x8000, rest = b & 0x7fffffff;
    if (rest >= 0x477fe000) return sign | 0x7bff;
    if (rest < 0x38800000) return sign | Math.round(Math.abs(x) * 16777216);
    return sign | (rest - 0x38000000 + 0x1000) >>> 13;
}

// What the shader reads: two texels of four words a splat, and its SH bytes by fours.
function texelsOf({ n, wide, narrow }, sh) {
    const texels = new Uint32Array(8 * n), place = new Float32Array(texels.buffer);
    const words = Math.ceil(sh / 4), extra = new Uint8Array(4 * words * n), q = [0, 0, 0, 0];
    for (let i = 0; i < n; i++) {
        const o = 8 * i, u16 = (c) => wide[c * n + i], u8 = (c) => narrow[c * n + i];
        for (let c = 0; c < 3; c++) {
            const u = (u16(c) - 32768) / 32767;
            place[o + c] = u / (1 - Math.abs(u));
        }
        texels[o + 3] = (u16(3) | u16(4) << 10 | u16(5) << 20) >>> 0;
        const largest = u8(4);
        let sum = 0;
        for (let c = 0, k = 6; c < 4; c++) {
            if (c === largest) continue;
            q[c] = (u16(k++) - 2048) / 2047 * Math.SQRT1_2;
            sum += q[c] * q[c];
        }
        q[largest] = Math.sqrt(Math.max(0, 1 - sum));
        const [w, x, y, z] = q;
        const a = scaleOf(u8(0)), b = scaleOf(u8(1)), c = scaleOf(u8(2));
        const r0 = (1 - 2 * (y * y + z * z)) * a, r1 = 2 * (x * y - w * z) * b, r2 = 2 * (x * z + w * y) * c;
        const r3 = 2 * (x * y + w * z) * a, r4 = (1 - 2 * (x * x + z * z)) * b, r5 = 2 * (y * z - w * x) * c;
        const r6 = 2 * (x * z - w * y) * a, r7 = 2 * (y * z + w * x) * b, r8 = (1 - 2 * (x * x + y * y)) * c;
        const m = 1024;
        texels[o + 4] = (half(m * (r0 * r0 + r1 * r1 + r2 * r2)) | half(m * (r0 * r3 + r1 * r4 + r2 * r5)) << 16) >>> 0;
        texels[o + 5] = (half(m * (r0 * r6 + r1 * r7 + r2 * r8)) | half(m * (r3 * r3 + r4 * r4 + r5 * r5)) << 16) >>> 0;
        texels[o + 6] = (half(m * (r3 * r6 + r4 * r7 + r5 * r8)) | half(m * (r6 * r6 + r7 * r7 + r8 * r8)) << 16) >>> 0;
        texels[o + 7] = u8(3);
        for (let k = 0; k < sh; k++) extra[4 * words * i + k] = u8(NARROW + k);
    }
    return { n, texels, place, sh: new Uint32Array(extra.buffer), words };
}

const scaleOf = (u) => Math.exp(u * 14 / 255 - 12);

async function frameOf(version, frame) {
    const name = `${version} ${frame}`, known = frames.get(name);
    if (known) {
        frames.delete(name);
        frames.set(name, known);
        return known;
    }
    const v = clip.versions[version], made = texelsOf(v.key[frame] === frame ? await keyOf(version, frame) : await columnsOf(version, frame), v.sh);
    made.bytes = made.texels.byteLength + made.sh.byteLength;
    frames.set(name, made);
    let held = 0;
    for (const f of frames.values()) held += f.bytes;
    for (const [k, f] of frames) {
        if (held <= MOST_BYTES || f === made) break;
        frames.delete(k);
        held -= f.bytes;
    }
    return made;
}

// Rows before the camera, far to near: a counting sort over 65536 steps of depth.
function sorted({ n, place }, eye, forward, near) {
    const depth = new Float32Array(n), [x, y, z] = forward;
    const shift = eye[0] * x + eye[1] * y + eye[2] * z;
    let least = Infinity, most = -Infinity, count = 0;
    for (let i = 0; i < n; i++) {
        const d = place[8 * i] * x + place[8 * i + 1] * y + place[8 * i + 2] * z - shift;
        depth[i] = d;
        if (d < near) continue;
        count++;
        if (d < least) least = d;
        if (d > most) most = d;
    }
    // steps are finer near the camera: log(depth)
    const low = Math.log(least), by = count ? 65535 / Math.max(Math.log(most) - low, 1e-6) : 0;
    const start = new Uint32Array(65537), step = new Uint16Array(n), order = new Uint32Array(count);
    for (let i = 0; i < n; i++) {
        if (depth[i] < near) continue;
        step[i] = 65535 - ((Math.log(depth[i]) - low) * by | 0);
        start[step[i] + 1]++;
    }
    for (let s = 0; s < 65536; s++) start[s + 1] += start[s];
    for (let i = 0; i < n; i++) if (depth[i] >= near) order[start[step[i]]++] = i;
    return order;
}

async function answer(w) {
    const f = await frameOf(w.version, w.frame), order = sorted(f, w.eye, w.forward, w.near);
    const reply = { version: w.version, frame: w.frame, id: w.id, n: f.n, words: f.words, order };
    if (w.data) {
        reply.texels = f.texels;
        reply.sh = f.sh;
    }
    postMessage(reply, [order.buffer]);
}

async function work() {
    if (busy) return;
    busy = true;
    try {
        while (wanted) {
            const w = wanted;
            wanted = null;
            await answer(w);
            if (!wanted && w.next !== undefined) await frameOf(w.version, w.next);
        }
    } catch (e) {
        postMessage({ error: String(e?.message ?? e) });
    }
    busy = false;
}

onmessage = ({ data }) => {
    if (data.clip) ({ clip, blocks } = data);
    else wanted = data;
    if (wanted) work();
};
