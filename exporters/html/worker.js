// The worker: decodes frames, caches some of them, and sorts the splats of a requested frame for a
// view.
// exporters/html/format.md describes the blocks; exporters/lib/page_*.c write them.
'use strict';

// The caches: of decoded frames, at least LEAST_BYTES and at most MOST_BYTES; of blocks of the file
// of --split, FETCHED_BYTES.
const LEAST_BYTES = 100e6, MOST_BYTES = 400e6, FETCHED_BYTES = 50e6, RUN_BYTES = 1e6, PLACE = 0, COLOUR = 3, OPACITY = 6, SCALE = 7, ROTATION = 10, SH = 13, REACH = 3.34; // REACH: standard deviations at which an opacity of 1 falls to 1/255
let clip = null, texts = null, address = null, moving = null, wanted = null, busy = false;
let all = null, ahead = null; // the whole file, if the server ignores ranges; the run that fetchAhead() fetches
const frames = new Map(), groups = [], bases = [], slices = [], fetched = new Map(), asked = new Map();

// ---- Bytes --------------------------------------------------------------------------------------

// Decodes a text that stores seven bits per character. Character 127 and a digit stand for a
// character that a page cannot contain.
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

// Reads the body of a response of about `size` bytes, and reports to the page how much is loaded.
async function bodyOf(answer, size) {
    const parts = [], reader = answer.body.getReader();
    let n = 0;
    for (let next = await reader.read(); !next.done; next = await reader.read()) {
        parts.push(next.value);
        n += next.value.length;
        postMessage({ loaded: Math.min(1, n / size) });
    }
    return new Uint8Array(await new Blob(parts).arrayBuffer());
}

// Fetches a range of bytes from the file of --split. If the server ignores the range and sends the
// whole file, later calls copy from this file.
async function rangeOf(from, to) {
    if (!all) {
        const answer = await fetch(address, { headers: { Range: `bytes=${from}-${to - 1}` } });
        if (!answer.ok) throw new Error(`${address}: ${answer.status} ${answer.statusText}`);
        const bytes = await bodyOf(answer, Number(answer.headers.get('Content-Length')) || to - from), part = answer.status === 206;
        const need = part ? to - from : Math.max(to, ...clip.versions.flatMap((v) => v.at.map((at, f) => at + v.bytes[f])));
        if (bytes.length < need) throw new Error(`${address} is shorter than the page expects`);
        if (part) return bytes;
        all = bytes;
    }
    return all.slice(from, to);
}

// Returns the last block of a run that begins with a block and includes block `through`. The first
// run is that block only, so that the first image appears soon; later runs also contain the next
// blocks, about RUN_BYTES in total.
function runFrom(v, first, through) {
    const follows = (f) => v.at[f + 1] === v.at[f] + v.bytes[f], size = (f) => v.at[f] + v.bytes[f] - v.at[first];
    let last = first;
    while (last + 1 < v.at.length && follows(last) && (last < through || (fetched.size && size(last) < RUN_BYTES && !fetched.has(`${v.name} ${last + 1}`)))) last++;
    return last;
}

// Fetches blocks `first` to `last`, and drops the least recently used ones of all other blocks if
// there are more than FETCHED_BYTES.
async function fetchRun(v, first, last) {
    const from = v.at[first], bytes = await rangeOf(from, v.at[last] + v.bytes[last]);
    for (let f = first; f <= last; f++) {
        const name = `${v.name} ${f}`, at = v.at[f] - from;
        fetched.delete(name);
        fetched.set(name, bytes.slice(at, at + v.bytes[f]));
    }
    let held = 0, kept = last - first + 1;
    for (const b of fetched.values()) held += b.length;
    for (const [k, b] of fetched) {
        if (held <= FETCHED_BYTES || fetched.size <= kept) break;
        fetched.delete(k);
        held -= b.length;
    }
}

// Returns a block of the file of --split. If it is not there, fetches it in one request with all
// blocks up to `through`.
async function fromServer(v, frame, through) {
    const name = `${v.name} ${frame}`;
    if (all) return all.subarray(v.at[frame], v.at[frame] + v.bytes[frame]);
    if (!fetched.has(name) && ahead?.v === v && frame >= ahead.first && frame <= ahead.last) await ahead.done;
    if (!fetched.has(name)) await fetchRun(v, frame, runFrom(v, frame, through));
    const block = fetched.get(name);
    fetched.delete(name);
    fetched.set(name, block);
    return block;
}

// Fetches the next run of a clip that plays before its first block is needed, if the blocks from
// `frame` on that are there have less than RUN_BYTES. Errors are ignored here: fromServer() repeats
// the request.
function fetchAhead(v, frame) {
    let first = frame, left = RUN_BYTES;
    if (!address || all || ahead || frame < 0) return;
    while (first < v.at.length && left > 0 && fetched.has(`${v.name} ${first}`)) left -= v.bytes[first++];
    if (left <= 0 || first >= v.at.length) return;
    ahead = { v, first, last: runFrom(v, first, first) };
    ahead.done = fetchRun(v, first, ahead.last).catch(() => {}).finally(() => { ahead = null; });
}

async function unpacked(packed) {
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream('gzip'));
    return new Uint8Array(await new Response(stream).arrayBuffer());
}

const blockOf = async (version, frame, through = frame) => unpacked(address ? await fromServer(clip.versions[version], frame, through) : bytesOf(texts[version][frame]));

// ---- Columns ------------------------------------------------------------------------------------

const unfolded = (u) => (u & 1 ? -(u >>> 1) - 1 : u >>> 1);

// Returns functions that read the columns of one block. Columns must be read in order.
function columnsIn(bytes) {
    let at = 0;
    const need = (n) => { if (at + n > bytes.length) throw new Error('a block ends early'); };
    const head = () => { need(1); const h = bytes[at++]; return [h & 7, (h & 16) !== 0, (h & 32) !== 0]; };
    const numbers = (n, planes) => {
        if (planes === 1) return bytes.subarray(at, at += n);
        const out = new Uint32Array(n);
        for (let p = 0; p < planes; p++) for (let i = 0, from = at + p * n; i < n; i++) out[i] |= bytes[from + i] << 8 * p;
        at += planes * n;
        return out;
    };
    return {
        // Returns the positions of the 1 bits among n bits.
        marked(n) {
            const from = at, out = [];
            need(n + 7 >> 3);
            for (let i = 0; i < n; i++) if (bytes[from + (i >> 3)] >> (i & 7) & 1) out.push(i);
            at += n + 7 >> 3;
            return out;
        },
        // Reads n numbers into x. before: in a block of rows, the previous column.
        whole(x, n, before) {
            const [planes, byStep, byColumn] = head();
            need(planes * n);
            const list = numbers(n, planes);
            for (let i = 0, last = 0; i < n; i++) {
                x[i] = unfolded(list[i]) + (byStep ? last : 0);
                last = x[i];
            }
            if (byColumn) for (let i = 0; i < n; i++) x[i] += before[i];
        },
        // Applies the changes of one frame. last: the previous frame's numbers, updated to those of
        // this frame. mean: 16 times the exponential moving average of the numbers.
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

// ---- Splats in the shader's layout --------------------------------------------------------------

const float = new Float32Array(1), bits = new Uint32Array(float.buffer);
// Converts to half precision, rounded to nearest; values too large become the largest half.
function half(x) {
    float[0] = x;
    const b = bits[0], sign = b >>> 16 & 0x8000, rest = b & 0x7fffffff;
    if (rest >= 0x477fe000) return sign | 0x7bff;
    if (rest < 0x38800000) return sign | Math.round(Math.abs(x) * 16777216);
    return sign | (rest - 0x38000000 + 0x1000) >>> 13;
}


// Converts the rotation vectors of rows to unit quaternions, four numbers per row.
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

// Converts a logarithm, in half steps, to a standard deviation in the page's units. The table
// covers logarithms from -MIDDLE to MIDDLE - 1 half steps.
const MIDDLE = 4096;
let scales = null;
function scaleOf(halves) {
    if (!scales) scales = Float64Array.from({ length: 2 * MIDDLE }, (_, i) => Math.exp((i - MIDDLE) * 0.5 * clip.steps.scale) / clip.size);
    return halves >= -MIDDLE && halves < MIDDLE ? scales[halves + MIDDLE] : Math.exp(halves * 0.5 * clip.steps.scale) / clip.size;
}

const cut = (x) => (x <= 0 ? 0 : x >= 65535 ? 65535 : x + 0.5 | 0);

// Writes the covariance of a splat to its second texel. e, f, g: standard deviations; w, x, y, z:
// rotation.
function shape(texels, o, w, x, y, z, e, f, g) {
    const m = 1024;
    const r0 = (1 - 2 * (y * y + z * z)) * e, r1 = 2 * (x * y - w * z) * f, r2 = 2 * (x * z + w * y) * g;
    const r3 = 2 * (x * y + w * z) * e, r4 = (1 - 2 * (x * x + z * z)) * f, r5 = 2 * (y * z - w * x) * g;
    const r6 = 2 * (x * z - w * y) * e, r7 = 2 * (y * z + w * x) * f, r8 = (1 - 2 * (x * x + y * y)) * g;
    texels[o + 4] = half(m * (r0 * r0 + r1 * r1 + r2 * r2)) | half(m * (r0 * r3 + r1 * r4 + r2 * r5)) << 16;
    texels[o + 5] = half(m * (r0 * r6 + r1 * r7 + r2 * r8)) | half(m * (r3 * r3 + r4 * r4 + r5 * r5)) << 16;
    texels[o + 6] = half(m * (r3 * r6 + r4 * r7 + r5 * r8)) | half(m * (r6 * r6 + r7 * r7 + r8 * r8)) << 16;
}

// Writes n splats to `out`, beginning at splat `from`: two texels of four words per splat, and SH
// as two halves per word. Splat r has the values of row offset + r of the key frame. If `numbers`
// is not null, row r of `numbers` is added: a difference from the key frame, in whole steps.
function fill(out, from, n, keys, turns, numbers, offset, nSh) {
    const s = clip.steps, { texels, place, sh, words, radius } = out;
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
        shape(texels, o, w, x, y, z, e, f, g);
        radius[from + r] = REACH * Math.max(e, f, g);
    }
    for (let c = 0; c < nSh; c++) {
        const key = keys[SH + c], now = number(SH + c), step = 0.5 * s.sh;
        for (let r = 0, o = 2 * words * from + c; r < n; r++, o += 2 * words) sh[o] = half((key[offset + r] + 2 * now[r]) * step);
    }
}

function emptyFrame(n, nSh) {
    const texels = new Uint32Array(8 * n), words = Math.ceil(nSh / 2);
    return { n, words, texels, place: new Float32Array(texels.buffer), sh: new Uint16Array(2 * words * n), radius: new Float32Array(n) };
}

// ---- Frames -------------------------------------------------------------------------------------

const arrays = (count, n) => Array.from({ length: count }, () => new Int32Array(n));

// Reads the columns of a key frame, or of the rows that a frame stores in full. Red and blue are
// stored as differences from green.
function keysFrom(read, keys, n) {
    for (const column of keys) read.whole(column, n);
    const [red, green, blue] = keys.slice(COLOUR);
    for (let i = 0; i < n; i++) {
        red[i] += green[i];
        blue[i] += green[i];
    }
}

// Reads the n rows of key frame `first` into `keys`. The first of them may be static rows of the
// base: the last key frame before it that stores all its rows.
async function groupKeys(version, first, read, keys, n) {
    const v = clip.versions[version], referred = v.referred[first] ?? 0;
    if (referred) {
        let base = first - 1;
        while (v.first[base] !== base || v.referred[base]) base--;
        if (bases[version]?.base !== base) {
            const all = arrays(keys.length, v.shared[base]);
            keysFrom(columnsIn(await blockOf(version, base)), all, v.shared[base]);
            bases[version] = { base, keys: all };
        }
        const rows = read.marked(v.still[base]), from = bases[version].keys;
        for (let c = 0; c < keys.length; c++) for (let i = 0; i < rows.length; i++) keys[c][i] = from[c][rows[i]];
    }
    keysFrom(read, keys.map((column) => column.subarray(referred)), n - referred);
    if (!referred) bases[version] = { base: first, keys };
}

// Decodes a frame of a version. The frames of a group are decoded in order, beginning after the
// frame that was decoded last, or at the key frame. The result contains the values of the key
// frame, the differences of the dynamic splats between `frame` and the key frame, and the texels of
// the static splats.
async function advance(version, frame) {
    const v = clip.versions[version], columns = SH + v.sh, first = v.first[frame], n = v.shared[frame], still = v.still[frame];
    let g = groups[version];
    if (!g || g.first !== first || g.frame >= frame) {
        g = { first, frame: first - 1, n, still, keys: arrays(columns, n), last: arrays(columns, n - still), mean: arrays(columns, n - still), quiet: emptyFrame(still, v.sh) };
        groups[version] = null;
    }
    while (g.frame < frame) {
        const f = g.frame + 1, read = columnsIn(await blockOf(version, f, frame));
        if (f === first) await groupKeys(version, first, read, g.keys, n);
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
    if (clip.versions[version].moves) return movedTo(await partsAt(frame), clip.versions[version].sh, timeOf(frame));
    if (clip.versions[version].rows) return sliced(version, frame);
    const v = clip.versions[version], g = await advance(version, frame), out = emptyFrame(g.n + v.own[frame], v.sh);
    out.texels.set(g.quiet.texels);
    out.sh.set(g.quiet.sh);
    out.radius.set(g.quiet.radius);
    fill(out, g.still, g.n - g.still, g.keys, g.turns, g.last, g.still, v.sh);
    for (const column of g.own) for (let i = 0; i < column.length; i++) column[i] *= 2;
    fill(out, g.n, v.own[frame], g.own, turnsOf(g.own, v.own[frame]), null, 0, v.sh);
    out.bytes = out.texels.byteLength + out.sh.byteLength + out.radius.byteLength;
    return out;
}

// ---- Rows: 4D splats, stored once, from which a slice is computed at any time -------------------

const powerOf = (number) => (number > 0 ? number - 1 : number);

// Returns one side of the Gaussian window of each row. at: the time, in frames, at which the window
// begins to fade. by: 1 / sigma, or 0 if the window does not fade.
function sideOf(r, from, length, sigma, middle) {
    const n = from.length, at = new Float64Array(n), by = new Float64Array(n);
    for (let i = 0; i < n; i++) {
        const half = length[i] / 2 / r.ticks, power = powerOf(sigma[i]) / r.octave;
        if (!sigma[i]) continue;
        at[i] = (from[i] + length[i] / 2) / r.ticks + middle[i] * r.middle * half * 2 ** Math.floor(power);
        by[i] = 1 / (half * 2 ** power);
    }
    return { at, by };
}

// Decodes block k: its columns, and the texels of its rows at their first tick. needed: the names
// of the blocks of the same time; through: the last of these blocks.
async function rowsOf(version, k, needed, through) {
    return keep(`${version} rows ${k}`, async () => {
        const v = clip.versions[version], r = v.rows, n = v.splats[k], read = columnsIn(await blockOf(version, k, through)), all = [];
        const columns = (count) => Array.from({ length: count }, () => {
            const x = new Int32Array(n);
            read.whole(x, n, all[all.length - 1]);
            all.push(x);
            return x;
        });
        const keys = columns(SH + v.sh), [from, length, sigma, middle] = columns(4), [middle2, sigma2] = r.plateaus ? columns(2) : [middle, sigma];
        const path = columns(3 * r.degree), [gate] = columns(r.gate ? 1 : 0), turn = columns(r.ratio ? 4 : 0), cosines = columns(r.period ? 7 + 2 * v.sh : 0);
        const whole = emptyFrame(n, v.sh), halves = keys.map((x) => x.map((d) => 2 * d)), turns = turnsOf(halves, n);
        fill(whole, 0, n, halves, turns, null, 0, v.sh);
        return { n, keys, from, length, path, gate, turn, cosines, turns, whole, rise: sideOf(r, from, length, sigma, middle), fall: sideOf(r, from, length, sigma2, middle2), bytes: n * (4 * all.length + 68) + whole.texels.byteLength + whole.sh.byteLength };
    }, needed);
}

// Returns the blocks that may have visible rows at a tick.
async function blocksAt(version, tick) {
    const v = clip.versions[version], at = [...v.splats.keys()].filter((k) => v.from[k] <= tick && tick < v.end[k]), needed = at.map((k) => `${version} rows ${k}`), list = [];
    // Blocks that follow one another in the file are fetched together.
    for (const [i, k] of at.entries()) list.push(await rowsOf(version, k, needed, at.findLast((last, j) => j >= i && last - k === j - i)));
    return list;
}

// Sets `tilt` to the rotation of row i at `share`, 0 to 1, of the time in which the row is visible:
// a linear interpolation of the quaternions at both ends, which have different lengths.
const tilt = new Float64Array(4);
function turnTo(b, i, share, r) {
    const [tx, ty, tz, long] = b.turn, a = tx[i] * clip.steps.rotation, c = ty[i] * clip.steps.rotation, d = tz[i] * clip.steps.rotation, angle = Math.sqrt(a * a + c * c + d * d);
    const by = angle > 1e-9 ? Math.sin(angle / 2) / angle : 0.5, b0 = Math.cos(angle / 2), b1 = by * a, b2 = by * c, b3 = by * d, k = share * Math.exp(long[i] * r.ratio), l = 1 - share;
    const [a0, a1, a2, a3] = b.turns.subarray(4 * i, 4 * i + 4);
    tilt[0] = l * a0 + k * (a0 * b0 - a1 * b1 - a2 * b2 - a3 * b3);
    tilt[1] = l * a1 + k * (a0 * b1 + a1 * b0 + a2 * b3 - a3 * b2);
    tilt[2] = l * a2 + k * (a0 * b2 - a1 * b3 + a2 * b0 + a3 * b1);
    tilt[3] = l * a3 + k * (a0 * b3 + a1 * b2 - a2 * b1 + a3 * b0);
    const size = Math.hypot(...tilt);
    for (let c2 = 0; c2 < 4; c2++) tilt[c2] /= size;
}

// Writes colours and SH of row i to splat o of the output.
function colourAt(out, o, b, i, v, frame) {
    const s = clip.steps, r = v.rows, turn = 2 * Math.PI * frame / r.period - b.cosines[0][i] * r.phase, c1 = Math.cos(turn), c2 = Math.cos(2 * turn), values = 3 + v.sh;
    const now = (c, key, step, by) => key[i] * step + by * (c1 * b.cosines[1 + c][i] + c2 * b.cosines[1 + values + c][i]);
    const colour = (c) => cut((now(c, b.keys[COLOUR + c], s.colour, r.cosine) + 1) * 65535 / 4);
    out.texels[8 * o + 3] = colour(0) | colour(1) << 16;
    out.texels[8 * o + 7] = colour(2) | out.texels[8 * o + 7] & 0xffff0000;
    for (let c = 0; c < v.sh; c++) out.sh[2 * out.words * o + c] = half(now(3 + c, b.keys[SH + c], s.sh, r.cosine_sh));
}

// Writes the visible rows of a block to the output, beginning at splat o. Returns the index of the
// next splat.
function cutRows(out, o, b, v, frame) {
    const r = v.rows, s = clip.steps, step = s.place / clip.size, tick = frame * r.ticks, { whole: { texels, sh, words, radius }, rise, fall, path } = b, clear = b.keys[OPACITY];
    for (let i = 0; i < b.n; i++) {
        if (tick < b.from[i] || tick >= b.from[i] + b.length[i]) continue;
        for (let k = 0; k < 8; k++) out.texels[8 * o + k] = texels[8 * i + k];
        for (let k = 0; k < 2 * words; k++) out.sh[2 * words * o + k] = sh[2 * words * i + k];
        out.radius[o] = radius[i];
        const share = (tick - b.from[i]) / b.length[i], at = share * r.degree;
        for (let c = 0; c < 3; c++) {
            let sum = 0;
            for (let k = r.degree; k > 0; k--) sum = (path[3 * k - 3 + c][i] + sum) * (at - k + 1) / k;
            out.place[8 * o + c] = (b.keys[PLACE + c][i] + sum) * step;
        }
        const z = frame < rise.at[i] ? (frame - rise.at[i]) * rise.by[i] : frame > fall.at[i] ? (frame - fall.at[i]) * fall.by[i] : 0, g = r.gate ? b.gate[i] * r.gate : 0;
        const opacity = Math.min(1, Math.max(0, clear[i] * s.opacity)) * (g + (1 - g) * Math.exp(-0.5 * z * z));
        out.texels[8 * o + 7] = texels[8 * i + 7] & 65535 | cut(opacity * 65535) << 16;
        if (r.ratio) {
            const scale = (c) => scaleOf(2 * b.keys[SCALE + c][i]);
            turnTo(b, i, share, r);
            shape(out.texels, 8 * o, ...tilt, scale(0), scale(1), scale(2));
        }
        if (r.period) colourAt(out, o, b, i, v, frame);
        o++;
    }
    return o;
}

// Returns the splats that are visible at a time, which is in frames and may be fractional. For
// times after the last frame, returns those of the last frame.
async function sliced(version, wanted) {
    const v = clip.versions[version], frame = Math.min(wanted, clip.numbers.length - 1), tick = frame * v.rows.ticks, blocks = await blocksAt(version, tick);
    let n = 0, o = 0;
    for (const b of blocks) for (let i = 0; i < b.n; i++) n += tick >= b.from[i] && tick < b.from[i] + b.length[i];
    const out = emptyFrame(n, v.sh);
    for (const b of blocks) o = cutRows(out, o, b, v, frame);
    return out;
}

// ---- 4D splats of a .sogst file, as sogst.js reads them, in world units -------------------------

function standing(m, words) {
    const out = emptyFrame(m.n, words), { texels, sh, radius } = out, colour = (k) => cut((m.colour[k] + 1) * 65535 / 4);
    for (let i = 0, o = 0; i < m.n; i++, o += 8) {
        const [e, f, g] = m.scale.subarray(3 * i, 3 * i + 3).map((v) => v / clip.size);
        texels[o + 3] = colour(3 * i) | colour(3 * i + 1) << 16;
        texels[o + 7] = colour(3 * i + 2);
        shape(texels, o, ...m.quat.subarray(4 * i, 4 * i + 4), e, f, g);
        radius[i] = REACH * Math.max(e, f, g);
        for (let c = 0; c < words; c++) sh[2 * out.words * i + c] = half(m.sh[words * i + c]);
    }
    return out;
}

// Returns a part of the file, which the page reads: its persistent splats or a segment. draft:
// without SH. needed: the names of the parts of the same time.
const unsent = [];
function partOf(part, draft, needed) {
    const name = `${draft ? 'draft' : 'part'} ${part}`;
    return keep(name, () => {
        if (!asked.has(name)) {
            const end = {};
            end.made = new Promise((done, fails) => { Object.assign(end, { done, fails }); });
            asked.set(name, end);
            // Parts that are asked for at the same time can be fetched in one request.
            if (unsent.push({ part, draft }) === 1) queueMicrotask(() => postMessage({ ask: unsent.splice(0) }));
        }
        return asked.get(name).made;
    }, needed);
}

// Receives a part from the page.
function takePart({ part, draft, splats, error }) {
    const name = `${draft ? 'draft' : 'part'} ${part}`, { done, fails } = asked.get(name), nSh = clip.versions[0].sh;
    asked.delete(name);
    if (error) return fails(new Error(error));
    if (!draft) frames.delete(`draft ${part}`);
    return done(Object.assign(splats, { bytes: splats.n * 4 * (22 + nSh + 9 + Math.ceil(nSh / 2)) }));
}

const timeOf = (frame) => moving.first + Math.min(frame, clip.numbers.length - 1) / clip.fps;

// Returns the parts with splats that may be visible at a frame.
async function partsAt(frame, draft = false) {
    const t = timeOf(frame), at = [...moving.parts.keys()].filter((k) => moving.parts[k].first <= t && t <= moving.parts[k].last), needed = at.map((k) => `part ${k}`);
    return Promise.all(at.map((k) => partOf(k, draft, needed)));
}

// Returns the splats of these parts that are visible at time t, in seconds.
function movedTo(parts, nSh, t) {
    const opacity = (m, i) => m.alpha[i] * Math.exp(-0.5 * ((t - m.centre[i]) / m.sigma[i]) ** 2);
    const rows = parts.map((m) => Array.from({ length: m.n }, (_, i) => i).filter((i) => opacity(m, i) >= 0.5 / 255)), out = emptyFrame(rows.reduce((sum, list) => sum + list.length, 0), nSh);
    let o = 0;
    for (const [p, m] of parts.entries()) {
        m.whole ??= standing(m, nSh);
        const { texels, sh, words, radius } = m.whole;
        for (const i of rows[p]) {
            const d = t - m.centre[i];
            for (let k = 3; k < 8; k++) out.texels[8 * o + k] = texels[8 * i + k];
            for (let k = 0; k < 2 * words; k++) out.sh[2 * words * o + k] = sh[2 * words * i + k];
            for (let c = 0, j = 3 * i; c < 3; c++, j++) out.place[8 * o + c] = (m.place[j] + d * (m.velocity[j] + d * m.accel[j]) - clip.centre[c]) / clip.size;
            out.texels[8 * o + 7] |= cut(opacity(m, i) * 65535) << 16;
            out.radius[o++] = radius[i];
        }
    }
    return out;
}

// Fetches and decodes the draft, which has the format of a key frame. That of a .sogst file is its
// first frame without SH.
async function draftOf(version) {
    const v = clip.versions[version];
    if (v.moves) return movedTo(await partsAt(0, true), v.sh, timeOf(0));
    const { splats: n, at, bytes } = v.draft;
    const read = columnsIn(await unpacked(await rangeOf(at, at + bytes))), keys = arrays(SH + v.sh, n), out = emptyFrame(n, v.sh);
    keysFrom(read, keys, n);
    fill(out, 0, n, keys, turnsOf(keys, n), null, 0, v.sh);
    return out;
}

// Returns the cached object of this name; if there is none, make() creates it. The cache holds
// `count` objects of this size, but at least LEAST_BYTES and at most MOST_BYTES. Beyond this limit,
// the least recently used objects are dropped, except those named in `needed`.
async function keep(name, make, needed = [], count = 0) {
    const known = frames.get(name);
    if (known) {
        frames.delete(name);
        frames.set(name, known);
        return known;
    }
    const made = await make();
    frames.set(name, made);
    const most = Math.min(MOST_BYTES, Math.max(LEAST_BYTES, count * made.bytes));
    let held = 0;
    for (const f of frames.values()) held += f.bytes;
    for (const [k, f] of frames) {
        if (held <= most || f === made) break;
        if (needed.includes(k)) continue;
        frames.delete(k);
        held -= f.bytes;
    }
    return made;
}

// Returns a decoded frame. Decoded frames are cached, at least AROUND of them if MOST_BYTES
// permits: a step back in a group would otherwise decode the group again. Of 4D splats, only the
// most recent slice is kept.
const AROUND = 40;
async function frameOf(version, frame) {
    if (!clip.versions[version].rows && !clip.versions[version].moves) return keep(`${version} ${frame}`, () => decoded(version, frame), [], AROUND);
    if (slices[version]?.frame !== frame) slices[version] = { frame, made: await decoded(version, frame) };
    return slices[version].made;
}

const ready = (version, frame) => (clip.versions[version].moves ? partsAt(frame) : clip.versions[version].rows ? blocksAt(version, frame * clip.versions[version].rows.ticks) : frameOf(version, frame));

// Begins to fetch the blocks after those of a frame, or the parts of the next second.
function fetchAfter(version, frame) {
    const v = clip.versions[version];
    if (v.moves) return void partsAt(frame + clip.fps).catch(() => {});
    fetchAhead(v, v.rows ? v.from.findIndex((from) => from > frame * v.rows.ticks) : frame);
}

// Returns the rows of splats that may be visible, sorted from far to near by a counting sort with
// 65536 steps of depth. The frustum is widened by the factor WIDER, since the camera may turn
// before the next order arrives.
const WIDER = 1.3;
function sorted({ n, place, radius }, { eye, right, down, forward, near, slope }) {
    const depth = new Float32Array(n), seen = new Uint32Array(n), [x, y, z] = forward, [rx, ry, rz] = right, [dx, dy, dz] = down;
    const [ax, ay] = slope.map((v) => WIDER * v), [lx, ly] = [ax, ay].map((v) => Math.hypot(1, v)), at = (v) => eye[0] * v[0] + eye[1] * v[1] + eye[2] * v[2];
    const shift = at(forward), shiftX = at(right), shiftY = at(down);
    let least = Infinity, most = -Infinity, count = 0;
    for (let i = 0, o = 0; i < n; i++, o += 8) {
        const px = place[o], py = place[o + 1], pz = place[o + 2], d = px * x + py * y + pz * z - shift;
        if (d < near) continue;
        if (Math.abs(px * rx + py * ry + pz * rz - shiftX) > ax * d + lx * radius[i] || Math.abs(px * dx + py * dy + pz * dz - shiftY) > ay * d + ly * radius[i]) continue;
        depth[count] = d;
        seen[count++] = i;
        if (d < least) least = d;
        if (d > most) most = d;
    }
    // The steps are logarithmic, so that they are finer near the camera.
    const low = Math.log(least), by = count ? 65535 / Math.max(Math.log(most) - low, 1e-6) : 0;
    const start = new Uint32Array(65537), step = new Uint16Array(count), order = new Uint32Array(count);
    for (let k = 0; k < count; k++) {
        step[k] = 65535 - ((Math.log(depth[k]) - low) * by | 0);
        start[step[k] + 1]++;
    }
    for (let s = 0; s < 65536; s++) start[s + 1] += start[s];
    for (let k = 0; k < count; k++) order[start[step[k]]++] = seen[k];
    return order;
}

// Answers a request for a frame of one version, or of both versions of a wipe.
async function answer(w) {
    const reply = { frame: w.frame, draft: w.draft, parts: [] };
    for (const { version, data } of w.parts) {
        const f = w.draft ? await draftOf(version) : await frameOf(version, w.frame), order = sorted(f, w);
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
            for (const { version } of w.parts) {
                if (!wanted && w.next !== undefined) await ready(version, w.next);
                if (w.plays) fetchAfter(version, w.next);
            }
        }
    } catch (e) {
        postMessage({ error: String(e?.message ?? e) });
    }
    busy = false;
}

onmessage = ({ data }) => {
    if (data.part !== undefined) return takePart(data);
    if (data.clip) ({ clip, texts, address, moving } = data);
    else wanted = data;
    if (wanted) work();
};
