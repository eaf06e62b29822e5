// The worker: unpacks frames, keeps some, and sorts the splats of the wanted one for a view.
// docs/page-format.md says what a block is; exporters/lib/page_group.h writes them.
'use strict';

const MOST_BYTES = 400e6, RUN_BYTES = 1e6, PLACE = 0, COLOUR = 3, OPACITY = 6, SCALE = 7, ROTATION = 10, SH = 13;
let clip = null, texts = null, address = null, wanted = null, busy = false;
const frames = new Map(), groups = [], fetched = new Map();

// ---- Bytes ---------------------------------------------------------------------------------------

// Seven bits a character; 127 and a digit stand for what a page cannot hold.
function bytesOf(text) {
    const special = [0, 10, 13, 60, 127], out = new Uint8Array(Math.ceil(text.length * 7 / 8) + 1);
    let held = 0, bits = 0, n = 0;
    for (let i = 0; i < text.length; i++) {
        let seven = text.charCodeAt(i);
        if (seven === 127) seven = special[text.charCodeAt(++i) - 48];
        held = held << 7 & 0x7fff | seven;
        bits += 7;
        if (bits >= 8) out[n++] = held >> (bits -= 8) & 255;
    }
    return out.subarray(0, n);
}

// Bytes of the file, from a server that may send all of it.
async function rangeOf(from, to) {
    const answer = await fetch(address, { headers: { Range: `bytes=${from}-${to - 1}` } });
    if (!answer.ok) throw new Error(`${address}: ${answer.status} ${answer.statusText}`);
    return { bytes: new Uint8Array(await answer.arrayBuffer()), whole: answer.status !== 206 };
}

// From the server: the block alone when nothing is at hand yet, so that the first picture comes soon; then
// also those behind it, a megabyte at a time.
async function fromServer(v, frame) {
    const name = (f) => `${v.name} ${f}`;
    if (!fetched.has(name(frame))) {
        let last = frame;
        while (fetched.size && last + 1 < v.at.length && v.at[last + 1] === v.at[last] + v.bytes[last] && v.at[last] + v.bytes[last] - v.at[frame] < RUN_BYTES) last++;
        const from = v.at[frame], to = v.at[last] + v.bytes[last];
        const { bytes, whole } = await rangeOf(from, to), base = whole ? 0 : from;
        for (const each of whole ? clip.versions : [v]) {
            for (let f = whole ? 0 : frame; f <= (whole ? each.at.length - 1 : last); f++) {
                const at = each.at[f] - base;
                if (at + each.bytes[f] > bytes.length) throw new Error(`${address} is shorter than the page says`);
                fetched.set(`${each.name} ${f}`, bytes.slice(at, at + each.bytes[f]));
            }
        }
    }
    return fetched.get(name(frame));
}

async function unpacked(packed) {
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'));
    return new Uint8Array(await new Response(stream).arrayBuffer());
}

const blockOf = async (version, frame) => unpacked(address ? await fromServer(clip.versions[version], frame) : bytesOf(texts[version][frame]));

// ---- Columns ---------------------------------------------------------------------------------------

const unfolded = (u) => (u & 1 ? -(u >>> 1) - 1 : u >>> 1);

// A reader of one block's columns, one after the other.
function columnsIn(bytes) {
    let at = 0;
    const need = (n) => { if (at + n > bytes.length) throw new Error('a block ends early'); };
    const head = () => { need(1); const h = bytes[at++]; return [h & 7, (h & 16) !== 0]; };
    const numbers = (n, planes) => {
        if (planes === 1) return bytes.subarray(at, at += n);
        const out = new Uint32Array(n);
        for (let p = 0; p < planes; p++) for (let i = 0, from = at + p * n; i < n; i++) out[i] |= bytes[from + i] << 8 * p;
        at += planes * n;
        return out;
    };
    return {
        whole(x, n) {
            const [planes, byStep] = head();
            need(planes * n);
            const list = numbers(n, planes);
            for (let i = 0, last = 0; i < n; i++) {
                x[i] = unfolded(list[i]) + (byStep ? last : 0);
                last = x[i];
            }
        },
        // last: the numbers of the frame before, made those of this one; mean: sixteen times theirs.
        changes(last, mean, n) {
            const [planes, byMean] = head(), mask = at, nMask = n + 7 >> 3;
            let listed = 0, list = null;
            if (planes) {
                need(nMask);
                for (let i = 0; i < nMask; i++) for (let b = bytes[mask + i]; b; b &= b - 1) listed++;
                at += nMask;
                need(planes * listed);
                list = numbers(listed, planes);
            }
            if (byMean) for (let i = 0; i < n; i++) last[i] = mean[i] + 8 >> 4;
            for (let j = 0, k = 0; list && j < nMask; j++) {
                for (let b = bytes[mask + j]; b; b &= b - 1) last[8 * j + 31 - Math.clz32(b & -b)] += unfolded(list[k++] + 1);
            }
            for (let i = 0; i < n; i++) mean[i] += (last[i] << 4) - mean[i] >> 1;
        },
    };
}

// ---- Splats as the shader reads them -------------------------------------------------------------------

const float = new Float32Array(1), bits = new Uint32Array(float.buffer);
// Half precision, to nearest; too large becomes the largest.
function half(x) {
    float[0] = x;
    const b = bits[0], sign = b >>> 16 & 0x8000, rest = b & 0x7fffffff;
    if (rest >= 0x477fe000) return sign | 0x7bff;
    if (rest < 0x38800000) return sign | Math.round(Math.abs(x) * 16777216);
    return sign | (rest - 0x38000000 + 0x1000) >>> 13;
}


// Rotations of keys as unit quaternions, four a row.
function turnsOf(keys, n) {
    const q = new Float64Array(4 * n), half = 0.5 * clip.steps.rotation, [kx, ky, kz] = keys.slice(ROTATION);
    for (let i = 0; i < n; i++) {
        const x = kx[i] * half, y = ky[i] * half, z = kz[i] * half, angle = Math.sqrt(x * x + y * y + z * z);
        const k = angle > 1e-9 ? Math.sin(angle / 2) / angle : 0.5;
        q[4 * i] = Math.cos(angle / 2);
        q[4 * i + 1] = k * x;
        q[4 * i + 2] = k * y;
        q[4 * i + 3] = k * z;
    }
    return q;
}

// Standard deviations by half steps of their logarithm, in the page's units.
const MIDDLE = 4096;
let scales = null;
function scaleOf(halves) {
    if (!scales) scales = Float64Array.from({ length: 2 * MIDDLE }, (_, i) => Math.exp((i - MIDDLE) * 0.5 * clip.steps.scale) / clip.size);
    return halves >= -MIDDLE && halves < MIDDLE ? scales[halves + MIDDLE] : Math.exp(halves * 0.5 * clip.steps.scale) / clip.size;
}

const cut = (x) => (x <= 0 ? 0 : x >= 65535 ? 65535 : x + 0.5 | 0);

// Two texels of four words a splat, and its SH as halfs, two in a word, for rows from `from` on. Row r has the keys
// offset + r and, where there are some, the numbers r.
function fill(out, from, n, keys, turns, numbers, offset, nSh) {
    const s = clip.steps, m = 1024, { texels, place, sh, words } = out;
    const none = numbers ? null : new Int32Array(n), number = (c) => (numbers ? numbers[c] : none);
    for (let c = 0; c < 3; c++) {
        const key = keys[PLACE + c], now = number(PLACE + c), step = 0.5 * s.place / clip.size;
        for (let r = 0, o = 8 * from + c; r < n; r++, o += 8) place[o] = (key[offset + r] + 2 * now[r]) * step;
    }
    const [red, green, blue, clear, s0, s1, s2] = keys.slice(COLOUR), [red2, green2, blue2, clear2, t0, t1, t2] = [0, 1, 2, 3, 4, 5, 6].map((c) => number(COLOUR + c));
    const nx = number(ROTATION), ny = number(ROTATION + 1), nz = number(ROTATION + 2);
    const shade = 0.5 * s.colour * 65535 / 4, veil = 0.5 * s.opacity * 65535, zero = 65535 / 4;
    for (let r = 0, o = 8 * from, k = offset; r < n; r++, o += 8, k++) {
        texels[o + 3] = cut((red[k] + 2 * red2[r]) * shade + zero) | cut((green[k] + 2 * green2[r]) * shade + zero) << 16;
        texels[o + 7] = cut((blue[k] + 2 * blue2[r]) * shade + zero) | cut((clear[k] + 2 * clear2[r]) * veil) << 16;
        let w = turns[4 * k], x = turns[4 * k + 1], y = turns[4 * k + 2], z = turns[4 * k + 3];
        if (nx[r] | ny[r] | nz[r]) {
            const a = nx[r] * s.rotation, b = ny[r] * s.rotation, c = nz[r] * s.rotation, angle = Math.sqrt(a * a + b * b + c * c);
            const by = Math.sin(angle / 2) / angle, b0 = Math.cos(angle / 2), b1 = by * a, b2 = by * b, b3 = by * c, a0 = w, a1 = x, a2 = y, a3 = z;
            w = a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3;
            x = a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2;
            y = a0 * b2 - a1 * b3 + a2 * b0 + a3 * b1;
            z = a0 * b3 + a1 * b2 - a2 * b1 + a3 * b0;
        }
        const e = scaleOf(s0[k] + 2 * t0[r]), f = scaleOf(s1[k] + 2 * t1[r]), g = scaleOf(s2[k] + 2 * t2[r]);
        const r0 = (1 - 2 * (y * y + z * z)) * e, r1 = 2 * (x * y - w * z) * f, r2 = 2 * (x * z + w * y) * g;
        const r3 = 2 * (x * y + w * z) * e, r4 = (1 - 2 * (x * x + z * z)) * f, r5 = 2 * (y * z - w * x) * g;
        const r6 = 2 * (x * z - w * y) * e, r7 = 2 * (y * z + w * x) * f, r8 = (1 - 2 * (x * x + y * y)) * g;
        texels[o + 4] = half(m * (r0 * r0 + r1 * r1 + r2 * r2)) | half(m * (r0 * r3 + r1 * r4 + r2 * r5)) << 16;
        texels[o + 5] = half(m * (r0 * r6 + r1 * r7 + r2 * r8)) | half(m * (r3 * r3 + r4 * r4 + r5 * r5)) << 16;
        texels[o + 6] = half(m * (r3 * r6 + r4 * r7 + r5 * r8)) | half(m * (r6 * r6 + r7 * r7 + r8 * r8)) << 16;
    }
    for (let c = 0; c < nSh; c++) {
        const key = keys[SH + c], now = number(SH + c), step = 0.5 * s.sh;
        for (let r = 0, o = 2 * words * from + c; r < n; r++, o += 2 * words) sh[o] = half((key[offset + r] + 2 * now[r]) * step);
    }
}

function emptyFrame(n, nSh) {
    const texels = new Uint32Array(8 * n), words = Math.ceil(nSh / 2);
    return { n, words, texels, place: new Float32Array(texels.buffer), sh: new Uint16Array(2 * words * n) };
}

// ---- Frames --------------------------------------------------------------------------------------------

const arrays = (count, n) => Array.from({ length: count }, () => new Int32Array(n));

// Red and blue are written against green.
function keysFrom(read, keys, n) {
    for (const column of keys) read.whole(column, n);
    const [red, green, blue] = keys.slice(COLOUR);
    for (let i = 0; i < n; i++) {
        red[i] += green[i];
        blue[i] += green[i];
    }
}

// The state of a version after frame `frame`: its key, the numbers of what moves, and what stands still as texels.
async function advance(version, frame) {
    const v = clip.versions[version], columns = SH + v.sh, first = v.first[frame], n = v.shared[frame], still = v.still[frame];
    let g = groups[version];
    if (!g || g.first !== first || g.frame >= frame) {
        g = { first, frame: first - 1, n, still, keys: arrays(columns, n), last: arrays(columns, n - still), mean: arrays(columns, n - still), quiet: emptyFrame(still, v.sh) };
        groups[version] = null;
    }
    while (g.frame < frame) {
        const f = g.frame + 1, read = columnsIn(await blockOf(version, f));
        if (f === first) keysFrom(read, g.keys, n);
        else for (let c = 0; c < columns; c++) read.changes(g.last[c], g.mean[c], n - still);
        g.own = arrays(columns, v.own[f]);
        if (v.own[f]) keysFrom(read, g.own, v.own[f]);
        if (f === first) {
            g.turns = turnsOf(g.keys, n);
            fill(g.quiet, 0, still, g.keys, g.turns, null, 0, v.sh);
        }
        g.frame = f;
    }
    groups[version] = g;
    return g;
}

async function decoded(version, frame) {
    const v = clip.versions[version], g = await advance(version, frame), out = emptyFrame(g.n + v.own[frame], v.sh);
    out.texels.set(g.quiet.texels);
    out.sh.set(g.quiet.sh);
    fill(out, g.still, g.n - g.still, g.keys, g.turns, g.last, g.still, v.sh);
    for (const column of g.own) for (let i = 0; i < column.length; i++) column[i] *= 2;
    fill(out, g.n, v.own[frame], g.own, turnsOf(g.own, v.own[frame]), null, 0, v.sh);
    return out;
}

// The draft is a key of a frame of its own.
async function draftOf(version) {
    const v = clip.versions[version], { splats: n, at, bytes: size } = v.draft, { bytes, whole } = await rangeOf(at, at + size);
    const read = columnsIn(await unpacked(whole ? bytes.subarray(at, at + size) : bytes)), keys = arrays(SH + v.sh, n), out = emptyFrame(n, v.sh);
    keysFrom(read, keys, n);
    fill(out, 0, n, keys, turnsOf(keys, n), null, 0, v.sh);
    return out;
}

async function frameOf(version, frame) {
    const name = `${version} ${frame}`, known = frames.get(name);
    if (known) {
        frames.delete(name);
        frames.set(name, known);
        return known;
    }
    const made = await decoded(version, frame);
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

// One frame of one version, or of both, which are shown together.
async function answer(w) {
    const reply = { frame: w.frame, draft: w.draft, parts: [] };
    for (const { version, data } of w.parts) {
        const f = w.draft ? await draftOf(version) : await frameOf(version, w.frame), order = sorted(f, w.eye, w.forward, w.near);
        reply.parts.push({ version, words: f.words, order, texels: data && f.texels, sh: data && new Uint32Array(f.sh.buffer) });
    }
    postMessage(reply, reply.parts.map((p) => p.order.buffer));
}

async function work() {
    if (busy) return;
    busy = true;
    try {
        while (wanted) {
            const w = wanted;
            wanted = null;
            await answer(w);
            for (const { version } of w.parts) if (!wanted && w.next !== undefined) await frameOf(version, w.next);
        }
    } catch (e) {
        postMessage({ error: String(e?.message ?? e) });
    }
    busy = false;
}

onmessage = ({ data }) => {
    if (data.clip) ({ clip, texts, address } = data);
    else wanted = data;
    if (wanted) work();
};
