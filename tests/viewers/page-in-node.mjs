#!/usr/bin/env node
// The page of --to html without a browser, in Node 18 or later: its worker's numbers against the
// exported splats, its images against the CPU renderer of the bench, and the effect of buttons,
// keys and touch. Prints TAP.
//     node page-in-node.mjs FOLDER_OF_COMMANDS WORKING_FOLDER
import { execFileSync } from 'node:child_process';
import fs from 'node:fs';
import path from 'node:path';
import zlib from 'node:zlib';
import { openPage, readPage, workerOf } from './lib/browser.mjs';
import { halfValue } from './lib/glsl.mjs';
import { psnr } from './lib/png.mjs';
import { render } from './lib/reference.mjs';
import { readPly } from './lib/splat.mjs';
import { writePly } from './lib/write.mjs';

const [bin, work] = process.argv.slice(2), BANDS = [3, 1], SPLATS = 300, FRAMES = 7, SCHEMES = ['javascript:alert(1)', ' JaVa\nScript:alert(1)//.sogst', 'data:text/html,x', 'vbscript:x'], C0 = 0.28209479177387814;
let tests = 0, failed = 0;
function ok(good, what, why = '') {
    tests++;
    if (!good) failed++;
    console.log(`${good ? 'ok' : 'not ok'} ${tests} - ${what}${good || why === '' ? '' : `\n#   ${why}`}`);
}
const is = (got, want, what) => { const [a, b] = [got, want].map((v) => JSON.stringify(v)); ok(a === b, what, `got ${a}, want ${b}`); };
const near = (got, want, within, what) => { const a = [got].flat(), b = [want].flat(); ok(a.length === b.length && a.every((v, i) => Math.abs(v - b[i]) <= within), what, `got ${a}, want ${b}`); };
async function fails(what, words, does) {
    try { await does(); ok(false, what, 'it does not'); } catch (e) { ok(e.message.includes(words), what, e.message); }
}

async function until(test) {
    for (const end = Date.now() + 20000; !test();) {
        if (Date.now() > end) throw new Error(`in 20 seconds not: ${test}`);
        await new Promise(setImmediate);
    }
}

// ---- Vectors ------------------------------------------------------------------------------------

const sub = (a, b) => a.map((v, i) => v - b[i]), dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0), size = (a) => Math.hypot(...a), unit = (a) => a.map((v) => v / size(a));
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const times = (a, b) => [a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3], a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2], a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1], a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]];
const turnAbout = (axis, angle) => [Math.cos(angle / 2), ...unit(axis).map((v) => v * Math.sin(angle / 2))];
const turned = (q, v) => times(times(q, [0, ...v]), [q[0], -q[1], -q[2], -q[3]]).slice(1);
// The six independent elements of a covariance, row by row.
function covariance({ rot, scale }) {
    const q = unit(rot), axes = [0, 1, 2].map((k) => turned(q, [0, 1, 2].map((c) => (c === k ? scale[k] : 0))));
    return [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]].map(([i, j]) => dot(axes.map((a) => a[i]), axes.map((a) => a[j])));
}

// ---- A clip -------------------------------------------------------------------------------------
// Splats that are static, move, rotate, grow and fade; in frame 4 some disappear and others appear.
// Two versions: with SH of degree 3, and in other colours with SH of degree 1.

let seed = 7;
const random = () => { seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0; return seed / 2 ** 32; }, about = () => 2 * random() - 1;
const some = Array.from({ length: SPLATS + 40 }, (_, i) => ({
    pos: [1.3 * about() + 3, about() - 1, 0.8 * about() + 2], by: i % 5 > 1 ? [0.02 * about(), 0.02 * about(), 0.02 * about()] : [0, 0, 0], alpha: i % 6 ? 0.15 + 0.8 * random() : 0.004 + 0.05 * random(), fade: i % 5 === 3 ? 0.02 : 0,
    scale: [0.02 + 0.1 * random(), 0.02 + 0.1 * random(), 0.004 + 0.05 * random()], grows: i % 5 > 1 ? 1 + 0.05 * about() : 1, rot: turnAbout([about(), about(), about()], 3 * about()), axis: i % 5 === 2 ? [0, 0, 1] : [about(), about(), about()], spin: i % 5 > 1 ? about() : 0,
    sh0: [2 * about(), 2 * about(), 2 * about()], shN: Array.from({ length: 15 }, () => [0.4 * about(), 0.4 * about(), 0.4 * about()])
}));
Object.assign(some[0], { rot: [1, 0, 0, 0], scale: [0.15, 0.03, 0.02] });
Object.assign(some[1], { rot: [1, 0, 0, 0], scale: [0.03, 0.15, 0.02] });
function splatsOf(frame, other) {
    return some.filter((_, i) => (frame < 4 ? i < SPLATS : i % 7 !== 3)).map((s) => ({
        pos: s.pos.map((v, c) => Math.fround(v + frame * s.by[c])), alpha: s.alpha + frame * s.fade * (s.alpha < 0.5 ? 1 : -1), scale: s.scale.map((v) => v * s.grows ** frame), rot: times(s.rot, turnAbout(s.axis, frame * s.spin)),
        sh0: other ? s.sh0.map((v) => -v) : s.sh0, shN: other ? s.shN.slice(0, 3).reverse() : s.shN
    }));
}
const clips = BANDS.map((_, k) => Array.from({ length: FRAMES }, (_, f) => splatsOf(f, k > 0)));
const command = (name, ...args) => execFileSync(path.resolve(bin, name), args, { cwd: work, stdio: ['ignore', 'ignore', 'inherit'] });
clips.forEach((frames, k) => {
    fs.mkdirSync(`${work}/clip${k}`);
    frames.forEach((s, f) => writePly(`${work}/clip${k}/frame_${String(10 + 2 * f).padStart(5, '0')}.ply`, s, BANDS[k]));
    command('spin-import', '-q', '--from', 'ply', `clip${k}`, '-o', `clip${k}.spin`);
});
const bounds = { place: 2e-4, colour: 0.25, scale: 0.2, rotation: 0.2, sh: 0.002 }, exact = Object.entries(bounds).flatMap(([k, v]) => [`--bound-${k}`, String(v)]);
const html = (from, to, ...more) => { command('spin-export', '-q', from, '--to', 'html', '-o', to, '--key-every', '3', '--sh', '3', '--fps', '10', ...exact, ...more); return readPage(`${work}/${to}`); };
const pages = [html('clip0.spin', 'a.html'), html('clip1.spin', 'b.html')], served = html('clip0.spin', 'served.html', '--split');
// A page with a version before and one after.
const two = { ...pages[0], texts: [pages[0].texts[0], pages[1].texts[0]], clip: { ...pages[0].clip, versions: [{ ...pages[0].clip.versions[0], name: 'after', label: 'After' }, { ...pages[1].clip.versions[0], name: 'before', label: 'Before' }] } };
for (const key of ['size', 'centre', 'steps']) is(pages[1].clip[key], pages[0].clip[key], `both clips have one ${key}`);
const { clip } = two, v0 = clip.versions[0], code = two.code('worker');
is([clip.numbers, v0.first, v0.own.map((n) => n > 0)], [[10, 12, 14, 16, 18, 20, 22], [0, 0, 0, 3, 3, 3, 6], [false, false, false, true, true, true, false]], 'the clip has groups, and rows of single frames');
ok(v0.still.every((n, f) => n > 30 && n <= v0.shared[f]) && v0.still[0] < v0.shared[0], 'and rows that stand still');

// ---- The worker: numbers ------------------------------------------------------------------------

const NAMES = ['bytesOf', 'unfolded', 'columnsIn', 'half', 'cut', 'scaleOf', 'turnsOf', 'sorted', 'decoded', 'frameOf', 'frames', 'fetched', 'blockOf', 'draftOf', 'advance', 'movedTo', 'keep', 'fetchAhead'];
const worker = (more = {}, given = two, changed = code) => { const w = workerOf(changed, NAMES, more); w.tell({ clip: given.clip, texts: given.texts, address: more.address ?? null }); return w; };
const first = worker();

// The splats of a frame as passed to the shader, in world units; SH by channel.
function splatsIn({ n, texels, place, sh, words, radius }, of = clip) {
    return Array.from({ length: n }, (_, i) => {
        const t = texels.subarray(8 * i, 8 * i + 8), both = (w) => [halfValue(w & 65535), halfValue(w >>> 16)];
        return { pos: [0, 1, 2].map((c) => place[8 * i + c] * of.size + of.centre[c]), colour: [t[3] & 65535, t[3] >>> 16, t[7] & 65535].map((v) => v / 65535 * 4 - 1), alpha: (t[7] >>> 16) / 65535, reach: radius[i] * of.size, covariance: [t[4], t[5], t[6]].flatMap(both).map((v) => v / 1024 * of.size ** 2), sh: [...sh.subarray(2 * words * i, 2 * words * (i + 1))].map(halfValue) };
    });
}
// The differences from the exported values; empty if there are none.
function wrongIn(frame, wanted, within = 1.6 * bounds.place, slack = 0, given = clip) {
    const left = new Set(wanted);
    for (const s of splatsIn(frame, given)) {
        const of = [...left].find((w) => w.pos.every((v, c) => Math.abs(v - s.pos[c]) <= within));
        if (!of) { if (s.alpha > 0) return `no splat at ${s.pos}`; continue; }
        left.delete(of);
        const cov = covariance(of), trace = cov[0] + cov[3] + cov[5], colour = of.sh0.map((v) => 0.5 + C0 * v), sh = of.shN.flat();
        if (s.colour.some((v, c) => Math.abs(v - colour[c]) > (bounds.colour + 0.02) / 255)) return `colour ${s.colour} for ${colour}`;
        if (Math.abs(s.reach / Math.sqrt(2 * Math.log(255)) / Math.max(...of.scale) - 1) > 0.025 && !slack) return `radius ${s.reach} for ${of.scale}`;
        if (Math.abs(s.alpha - of.alpha) > (bounds.colour + 0.02) / 255 && !slack) return `opacity ${s.alpha} for ${of.alpha}`;
        if (s.covariance.some((v, k) => Math.abs(v - cov[k]) > 0.009 * trace) && !slack) return `covariance ${s.covariance} for ${cov}`;
        if (sh.some((v, k) => Math.abs(v - s.sh[k]) > bounds.sh + 0.0003)) return `SH ${s.sh} for ${sh}`;
    }
    return left.size && !slack ? `${left.size} splats are missing` : '';
}
for (const version of [0, 1]) {
    for (const f of [0, 1, 2, 3, 4, 5, 6, 1, 5, 5, 2]) {
        const why = wrongIn(await first.decoded(version, f), clips[version][f]);
        ok(why === '', `version ${version}, frame ${f}: the splats that were exported`, why);
    }
}
ok(!(0 in v0.referred) && v0.referred[3] > 0, `the second key frame has ${v0.referred[3]} rows of the first`);
for (const f of [6, 3, 5]) {
    const w = worker(), why = wrongIn(await w.decoded(0, f), clips[0][f]) || wrongIn(await w.decoded(0, 1), clips[0][1]) || wrongIn(await w.decoded(0, f), clips[0][f]);
    ok(why === '', `frame ${f} is decoded first, then others`, why);
}
ok(await first.frameOf(0, 5) === await first.frameOf(0, 5), 'a frame is decoded once');

// Half precision: every representable value is exact; others round to the nearest.
let wrong = 0;
for (let h = 0; h < 0x7bff; h++) {
    const x = halfValue(h), next = halfValue(h + 1);
    wrong += first.half(x) !== h || first.half(-x) !== (h | (x ? 0x8000 : first.half(-x) & 0x8000)) || first.half(x + 0.51 * (next - x)) !== h + 1 || first.half(x + 0.49 * (next - x)) !== h;
}
is(wrong, 0, 'half precision, to nearest');
is([65504, 65520, 1e9, Infinity, -1e9].map(first.half), [0x7bff, 0x7bff, 0x7bff, 0x7bff, 0xfbff], 'too large becomes the largest');
is([-3, 0, 0.4, 0.6, 65534.6, 65535, 1e9].map(first.cut), [0, 0, 0, 1, 65535, 65535, 65535], 'whole numbers from 0 to 65535');
const halves = [-9000, -4097, -4096, -1, 0, 4095, 4096, 4097];
near(halves.map((h) => Math.log(first.scaleOf(h))), halves.map((h) => h * 0.5 * clip.steps.scale - Math.log(clip.size)), 1e-6, 'scales by half steps of their logarithm, also beyond the table');
const step = clip.steps.rotation / 2, axes = [[0, 0, 0], [Math.PI / step, 0, 0], [0, 0, -Math.PI / 2 / step]], keys = Array.from({ length: 13 }, (_, c) => Int32Array.from(axes, (a) => (c < 10 ? 9 : a[c - 10])));
near([...first.turnsOf(keys, 3)], [1, 0, 0, 0, 0, 1, 0, 0, Math.SQRT1_2, 0, 0, -Math.SQRT1_2], 0.01, 'rotations of none, a half and a quarter turn');

// Columns made by hand, and all truncations of them.
function column(bytes, n, read) {
    const [x, mean] = [new Int32Array(n), new Int32Array(n)], all = Uint8Array.from(bytes);
    read(first.columnsIn(all), x, mean);
    for (let k = 0; k < bytes.length; k++) {
        try { read(first.columnsIn(all.subarray(0, k)), new Int32Array(n), new Int32Array(n)); return `${k} bytes are enough`; } catch (e) { if (e.message !== 'a block ends early') return e.message; }
    }
    return [...x];
}
const whole = (reader, x) => reader.whole(x, x.length);
is(column([1, 0, 1, 2, 255], 4, whole), [0, -1, 1, -128], 'numbers of one byte');
is(column([17, 2, 2, 1, 0], 4, whole), [1, 2, 1, 1], 'steps from the one before');
is(column([2, 0, 1, 2, 1, 0, 0], 3, whole), [128, -1, 1], 'numbers of two bytes');
is(column([4, 255, 254, 255, 255, 255, 255, 255, 255], 2, whole), [-(2 ** 31), 2 ** 31 - 1], 'numbers of four bytes');
is(column([0], 3, whole), [0, 0, 0], 'zeros');
// Ten rows; 0, 2 and 9 change, by 1, -1 and 300: zigzag-coded and less one 1, 0 and 599.
const thrice = (reader, x, mean) => { for (let k = 0; k < 3; k++) reader.changes(x, mean, 10); };
is(column([2, 5, 2, 1, 0, 87, 0, 0, 2, 0, 0], 10, thrice), [1, 0, -1, 0, 0, 0, 0, 0, 0, 300], 'changes, and twice none');
// The positions become 8, 8 and 2400 sixteenths; then 12 and 3600.
is(column([2, 5, 2, 1, 0, 87, 0, 0, 2, 16, 0], 10, thrice), [1, 0, 0, 0, 0, 0, 0, 0, 0, 150], 'and from the mean');
is(column([2, 5, 2, 1, 0, 87, 0, 0, 2, 0, 17, 1, 0, 1], 10, thrice), [2, 0, -1, 0, 0, 0, 0, 0, 0, 225], 'with changes added');

// Bytes as text: seven bits a character; five characters are escaped.
const bytes = Uint8Array.from({ length: 3000 }, () => 256 * random()), special = [0, 10, 13, 60, 127];
const sevens = [...bytes].map((b) => b.toString(2).padStart(8, '0')).join('').match(/.{1,7}/g).map((s) => parseInt(s.padEnd(7, '0'), 2));
is([...first.bytesOf(sevens.map((s) => (special.includes(s) ? `\x7f${special.indexOf(s)}` : String.fromCharCode(s))).join(''))].slice(0, 3000), [...bytes], 'seven bits a character');

// ---- The worker: 4D splats ----------------------------------------------------------------------
// They are sliced at any time. Three sources at whole frames, compared with PLY exports.

const fixtures = new URL('../../fixtures/', import.meta.url).pathname, fourD = {};
for (const [name, source] of [['lines', 'realtime4dgs/rot4d_noshfs'], ['cubes', 'ex4dgs/small'], ['turns', 'spacetimegs/full_techni']]) {
    command('spin-import', '-q', path.join(fixtures, source), '-o', `${name}.spin`);
    command('spin-export', '-q', `${name}.spin`, '--to', 'ply', '-o', name);
    fourD[name] = html(`${name}.spin`, `${name}.html`);
    const given = fourD[name].clip, w = worker({}, fourD[name]), last = given.numbers.length - 1;
    ok(given.versions[0].rows && given.versions[0].splats.length > (name === 'cubes'), `${name}: rows, in several blocks where some are short`);
    for (const f of [0, 1, last, 7]) {
        const p = readPly(`${work}/${name}/frame_${String(given.numbers[f]).padStart(5, '0')}.ply`), of = (x) => (i) => x.map((column) => column[i]);
        const wanted = Array.from({ length: p.count }, (_, i) => ({ pos: of(p.pos)(i), alpha: p.alpha[i], scale: of(p.scale)(i), rot: of(p.rot)(i), sh0: of(p.sh0)(i), shN: p.shN.map((k) => of(k)(i)) })).filter((s) => s.alpha > 0.0005);
        const why = wrongIn(await w.decoded(0, f), wanted, 1.6 * bounds.place, 0, given);
        ok(why === '', `${name}, frame ${f}: the splats of that time`, why);
    }
}

// Rows made by hand with every kind of attribute, at times between frames.
const hand = {
    numbers: [0, 1, 2, 3, 4], size: 2, centre: [1, -1, 0.5], steps: { place: 0.01, colour: 0.02, opacity: 0.01, scale: 0.05, rotation: 0.02, sh: 0.03 },
    versions: [{ name: 'clip', degree: 1, sh: 9, splats: [3], from: [0], end: [65], at: [0], rows: { ticks: 16, degree: 3, octave: 10, middle: 0.1, plateaus: true, gate: 0.02, ratio: 0.05, period: 3, phase: 0.1, cosine: 0.01, cosine_sh: 0.02 } }]
};
// Columns of the three rows: position, times and window, plateau, path, gate, rotation, waves.
const table = [[10, -20, 3], [5, 6, 7], [-4, 0, 300], [20, 30, 40], [25, 26, 27], [10, 44, 18], [80, 95, 60], [-60, -70, -50], [-65, -75, -40], [-90, -80, -45], [10, 0, -90], [20, 0, 30], [-30, 0, 15],
    ...Array.from({ length: 9 }, (_, c) => [c - 4, 3 - c, 2 * c]), [0, 16, 10], [65, 24, 50], [-12, 0, 5], [-9, 0, -3], [11, 20, 2], [-8, 0, 7], [3, -4, 0], [1, 2, 0], [-5, 7, 0], [2, 0, 1], [0, 1, 0], [4, -3, 0], [1, 1, 0], [0, -2, 0], [2, 0, 0], [10, 0, 35],
    [30, 0, -20], [-10, 0, 14], [5, 0, 40], [6, 0, -8], [7, 0, 33], ...Array.from({ length: 24 }, (_, c) => [3 - c, c % 5, c - 9])];
{
    const packed = zlib.gzipSync(Buffer.concat(table.map((x, c) => {
        // each encoding of a column in turn
        const against = c % 3 === 1 ? x.map((v, i) => v - table[c - 1][i]) : x, steps = c % 2 ? against.map((v, i) => v - (i ? against[i - 1] : 0)) : against;
        return Buffer.from([2 | (c % 2 ? 16 : 0) | (c % 3 === 1 ? 32 : 0), ...[0, 8].flatMap((bit) => steps.map((v) => (v < 0 ? -2 * v - 1 : 2 * v) >> bit & 255))]);
    })));
    hand.versions[0].bytes = [packed.length];
    const v = hand.versions[0], r = v.rows, s = hand.steps, w = worker({ address: 'x', fetch: async () => new Response(packed, { status: 206 }) }, { clip: hand, texts: null });
    const at = (c, i) => table[c][i], vector = (c, i, by) => [0, 1, 2].map((k) => at(c + k, i) * by), turnOf = (x) => (size(x) > 0 ? turnAbout(x, size(x)) : [1, 0, 0, 0]);
    function row(i, frame) {
        const from = at(22, i) / 16, length = at(23, i) / 16, share = (frame - from) / length, t = 3 * share;
        const window = (sigma, middle, sign) => {
            if (sigma === 0) return 1;
            const half = length / 2, power = (sigma > 0 ? sigma - 1 : sigma) / 10, off = frame - from - half - middle * 0.1 * half * 2 ** Math.floor(power);
            return sign * off > 0 ? Math.exp(-0.5 * (off / half / 2 ** power) ** 2) : 1;
        };
        const gate = at(37, i) * r.gate, angle = 2 * Math.PI * frame / 3 - at(42, i) * 0.1, wave = (c) => Math.cos(angle) * at(43 + c, i) + Math.cos(2 * angle) * at(55 + c, i);
        const a = turnOf(vector(10, i, s.rotation)), b = times(a, turnOf(vector(38, i, s.rotation))), k = share * Math.exp(at(41, i) * 0.05);
        return {
            pos: [0, 1, 2].map((c) => hand.centre[c] + 0.01 * (at(c, i) + t * at(28 + c, i) + t * (t - 1) / 2 * at(31 + c, i) + t * (t - 1) * (t - 2) / 6 * at(34 + c, i))), colour: [0, 1, 2].map((c) => 0.02 * at(3 + c, i) + 0.01 * wave(c)),
            alpha: 0.01 * at(6, i) * (gate + (1 - gate) * window(at(24, i), at(25, i), -1) * window(at(27, i), at(26, i), 1)), covariance: covariance({ rot: a.map((x, c) => (1 - share) * x + k * b[c]), scale: vector(7, i, 0.05).map(Math.exp) }), sh: Array.from({ length: 9 }, (_, c) => 0.03 * at(13 + c, i) + 0.02 * wave(3 + c))
        };
    }
    for (const [frame, rows] of [[0, [0]], [0.4, [0]], [1.3, [0, 1, 2]], [2.5, [0, 2]], [4, [0]], [4.7, [0]]]) {
        const is4 = splatsIn(await w.decoded(0, frame), hand), want = rows.map((i) => row(i, Math.min(frame, 4)));
        is(is4.length, rows.length, `at ${frame}: so many rows`);
        want.forEach((x, k) => near([is4[k].pos, is4[k].colour, is4[k].alpha, is4[k].sh.slice(0, 9)].flat(), [x.pos, x.colour, x.alpha, x.sh].flat(), 4e-4, `row ${rows[k]}`));
        near(is4.map((x) => x.reach), rows.map((i) => 3.33 * Math.max(...vector(7, i, 0.05).map(Math.exp))), 0.05, 'they reach as far');
        want.forEach((x, k) => near(is4[k].covariance, x.covariance, 0.002 * (x.covariance[0] + x.covariance[3] + x.covariance[5]), 'and its shape'));
    }
    ok(await w.frameOf(0, 2.5) === await w.frameOf(0, 2.5) && await w.frameOf(0, 2.4) !== await w.frameOf(0, 2.5), 'the last slice is kept');
}

// ---- The worker: splats that the reader of .sogst files returns ---------------------------------

{
    const n = 40, many = (k, f) => Float32Array.from({ length: k * n }, f), moved = { ...fourD.lines.clip, fps: 4, centre: [1, -2, 0.5], size: 2, numbers: [0, 1, 2, 3], versions: [{ name: 'clip', degree: 1, sh: 9, splats: [], moves: true }] };
    const m = { n, place: many(3, about), velocity: many(3, about), accel: many(3, about), scale: many(3, () => 0.02 + 0.1 * Math.abs(about())), colour: many(3, () => 0.5 + 0.4 * about()), alpha: many(1, () => 0.2 + 0.7 * Math.abs(about())), centre: many(1, () => 2 + Math.abs(about())), sigma: many(1, () => 0.1 + 0.4 * Math.abs(about())), sh: many(9, () => 0.3 * about()), quat: new Float32Array(4 * n) };
    for (let i = 0; i < n; i++) m.quat.set(unit([about(), about(), about(), about()]), 4 * i);
    const w = worker({ address: null, fetch: null }, { clip: moved, texts: [[]] });
    for (const [frame, t] of [[0, 2], [1.5, 2.375], [9, 2.75]]) {
        const want = Array.from({ length: n }, (_, i) => {
            const d = t - m.centre[i], three = (a) => [...a.subarray(3 * i, 3 * i + 3)], [x, v, a] = [m.place, m.velocity, m.accel].map(three);
            return { pos: x.map((c, k) => c + v[k] * d + a[k] * d * d), colour: three(m.colour), alpha: m.alpha[i] * Math.exp(-d * d / 2 / m.sigma[i] ** 2), reach: 3.34 * Math.max(...three(m.scale)), covariance: covariance({ rot: [...m.quat.subarray(4 * i, 4 * i + 4)], scale: three(m.scale) }), sh: [...m.sh.subarray(9 * i, 9 * i + 9)] };
        }).filter((x) => x.alpha >= 0.5 / 255), got = splatsIn(w.movedTo([m], 9, t), moved);
        is([got.length, want.length < n], [want.length, true], `at ${frame}: those that are seen`);
        want.forEach((x, k) => near([got[k].pos, got[k].colour, got[k].alpha, got[k].sh.slice(0, 9), got[k].reach].flat(), [x.pos, x.colour, x.alpha, x.sh, x.reach].flat(), 4e-4, `splat ${k}`));
        want.forEach((x, k) => near(got[k].covariance, x.covariance, 0.002 * (x.covariance[0] + x.covariance[3] + x.covariance[5]), 'and its shape'));
    }
}

// ---- The worker: sorting ------------------------------------------------------------------------

const n = 2000, place = new Float32Array(8 * n).map(() => 4 * about()), radius = new Float32Array(n).map((_, i) => i % 7 * 0.05), forward = unit([1, 2, -0.5]), right = unit(cross(forward, [0, 0, 1]));
const view = { eye: [0.3, -0.2, 0.1], right, down: cross(forward, right), forward, near: 0.2, slope: [0.9, 0.4] }, away = (i) => sub([...place.subarray(8 * i, 8 * i + 3)], view.eye);
// The distance of a sphere's centre outside the four planes that enclose 1.3 times the image.
const outside = (i, wide) => Math.max(...[right, view.down].map((v, k) => (Math.abs(dot(away(i), v)) - wide * view.slope[k] * dot(away(i), forward)) / Math.hypot(1, wide * view.slope[k])));
const depth = Array.from({ length: n }, (_, i) => dot(away(i), forward)), order = [...first.sorted({ n, place, radius }, view)], want = depth.flatMap((d, i) => (d >= 0.2 && outside(i, 1.3) <= radius[i] ? [i] : []));
is([...order].sort((a, b) => a - b), want, 'all splats that are not before the near plane and may be in the picture, once');
ok(want.length < 0.5 * depth.filter((d) => d >= 0.2).length && depth.some((d, i) => d >= 0.2 && outside(i, 1.3) > 0 && outside(i, 1.3) <= radius[i]), 'which are not all, and some by their rim alone');
ok(order.every((i, k) => !k || depth[i] <= depth[order[k - 1]] * 1.0001), 'far to near');
const pair = { n: 2, place: new Float32Array(16).map((_, k) => (k === 2 ? 0.5 : k === 10 ? 1 : 0)), radius: new Float32Array(2) }, ahead = { ...view, eye: [0, 0, 0], right: [1, 0, 0], down: [0, 1, 0], forward: [0, 0, 1] };
is([...first.sorted(pair, { ...ahead, near: 0.5 })], [1, 0], 'one at the near plane is in');
is([[...first.sorted({ ...pair, n: 1 }, ahead)], [...first.sorted({ n, place, radius }, { ...view, near: 99 })]], [[0], []], 'one splat, and none');

// ---- The worker: cached frames and range requests -----------------------------------------------

// The cache holds three frames and a half.
const least = Math.min(...v0.splats) * (32 + 4 * 23), small = worker({}, two, code.replace('400e6', String(3.5 * least)));
for (const f of [0, 1, 2]) await small.frameOf(0, f);
await small.frameOf(0, 0);
await small.frameOf(0, 3);
is([...small.frames.keys()], ['0 2', '0 0', '0 3'], 'the frame that was not used for longest goes');
const tiny = worker({}, two, code.replace('400e6', '1'));
for (const f of [0, 1]) await tiny.frameOf(0, f);
is([...tiny.frames.keys()], ['0 1'], 'but not the one that is shown, however large');

const { versions: [s0] } = served.clip;
function server({ status = 206, cut = 0, lack = 0 } = {}, given = served, changed = code) {
    const asked = [], w = worker({ address: 'http://x/served.bin', fetch: async (address, { headers }) => {
        const [from, to] = headers.Range.match(/^bytes=(\d+)-(\d+)$/).slice(1).map(Number);
        asked.push([from, to + 1]);
        if (status === 404) return new Response('', { status, statusText: 'Not Found' });
        return new Response(status === 206 ? served.data.subarray(from, to + 1 - lack) : served.data.subarray(0, served.data.length - cut), { status });
    } }, given, changed);
    return { w, asked };
}
const partly = server(), wholly = server({ status: 200 });
await partly.w.blockOf(0, 0);
is(partly.asked, [[0, s0.bytes[0]]], 'the first block alone');
await partly.w.blockOf(0, 1);
is(partly.asked.slice(1), [[s0.at[1], s0.at[6] + s0.bytes[6]]], 'then all that follow, to a megabyte');
for (let f = 0; f < FRAMES; f++) ok(Buffer.from(await partly.w.blockOf(0, f)).equals(zlib.gunzipSync(served.data.subarray(s0.at[f], s0.at[f] + s0.bytes[f]))), `block ${f} is that of the file`);
is(partly.asked.length, 2, 'which is asked for no more');
// Merged requests end before a megabyte (smaller in this test), and between blocks that are not
// adjacent.
const [runs, apart] = [s0.bytes[1] + s0.bytes[2] + 1, 1e6].map((most, gap) => {
    const asked = [], given = { ...served, clip: { ...served.clip, versions: [gap ? { ...s0, at: s0.at.map((a, f) => (f > 2 ? a + 1 : a)) } : s0] } };
    return { asked, w: worker({ address: 'x', fetch: async (_, { headers }) => { const [from, to] = headers.Range.slice(6).split('-').map(Number); asked.push(to + 1); return new Response(served.data.subarray(from, to + 1), { status: 206 }); } }, given, code.replace('1e6', String(most))) };
});
for (const w of [runs, apart]) { await w.w.blockOf(0, 0); await w.w.blockOf(0, 1); }
is([runs.asked[1], apart.asked[1]], [s0.at[3] + s0.bytes[3], s0.at[2] + s0.bytes[2]], 'in runs of so many bytes, side by side');
// A server that ignores ranges is asked once, for all versions.
const twice = { ...served, clip: { ...served.clip, versions: [s0, { ...s0, name: 'other', at: [...s0.at].reverse(), bytes: [...s0.bytes].reverse() }] } }, every = server({ status: 200 }, twice);
for (const [v, f] of [[0, 2], [1, 2], [1, 6]]) ok(Buffer.from(await every.w.blockOf(v, f)).equals(zlib.gunzipSync(served.data.subarray(...((at) => [at, at + served.clip.versions[0].bytes[v ? 6 - f : f]])(twice.clip.versions[v].at[f])))), `version ${v}, block ${f}`);
is(every.asked.length, 1, 'from one answer');
await wholly.w.blockOf(0, 4);
for (let f = 0; f < FRAMES; f++) ok(Buffer.from(await wholly.w.blockOf(0, f)).equals(Buffer.from(await partly.w.blockOf(0, f))), `block ${f} of a server that sends all`);
is(wholly.asked.length, 1, 'once');
const missing = server({ status: 404 }), short = server({ status: 200, cut: served.data.length - s0.at[6] });
await fails('a file that is not there', 'http://x/served.bin: 404 Not Found', () => missing.w.blockOf(0, 0));
await fails('a file that is too short', 'served.bin is shorter than the page expects', () => short.w.blockOf(0, 0));
for (const { w } of [partly, wholly]) {
    const draft = await w.draftOf(0), why = wrongIn(draft, clips[0][0], 1.6 * bounds.place, 1);
    ok(draft.n === s0.draft.splats && why === '', 'the draft has splats of the first frame', why);
}

is(wholly.asked.length, 1, 'a server that sends all is asked once, for the draft as well');
// A seek into a group is one request, also if it is larger than a run.
{
    const runs2 = server({}, served, code.replace('RUN_BYTES = 1e6', 'RUN_BYTES = 1'));
    await runs2.w.blockOf(0, 0);
    await runs2.w.blockOf(0, 1, 4);
    is(runs2.asked.slice(1), [[s0.at[1], s0.at[4] + s0.bytes[4]]], 'a group up to a frame is one request');
    for (const f of [2, 3, 4]) await runs2.w.blockOf(0, f);
    is(runs2.asked.length, 2, 'which has them all');
    // While a clip plays, the next run is fetched before it is needed, once.
    runs2.w.fetchAhead(s0, 4);
    runs2.w.fetchAhead(s0, 4);
    is(runs2.asked.length, 2, 'nothing is fetched ahead while there is a run of blocks');
    runs2.w.fetchAhead(s0, 5);
    runs2.w.fetchAhead(s0, 5);
    await runs2.w.blockOf(0, 5);
    is(runs2.asked.slice(2), [[s0.at[5], s0.at[5] + s0.bytes[5]]], 'the next run is fetched ahead');
}
// Blocks far from the current frame are released.
{
    const few = server({}, served, code.replace('RUN_BYTES = 1e6', 'RUN_BYTES = 1').replace('FETCHED_BYTES = 50e6', `FETCHED_BYTES = ${s0.bytes[4] + s0.bytes[5] + s0.bytes[6]}`));
    for (const f of [0, 1, 2, 3, 4, 5, 4, 6]) await few.w.blockOf(0, f);
    is([...few.w.fetched.keys()], ['clip 5', 'clip 4', 'clip 6'], 'blocks that were not used for longest are released');
    ok(Buffer.from(await few.w.blockOf(0, 1)).equals(zlib.gunzipSync(served.data.subarray(s0.at[1], s0.at[1] + s0.bytes[1]))), 'and fetched again');
}
// The blocks of one time are all kept, however large.
{
    const pinned = worker({}, two, code.replace('100e6', '1'));
    for (const k of ['a', 'b', 'c']) await pinned.keep(k, async () => ({ bytes: 9 }), ['a', 'c']);
    is([...pinned.frames.keys()], ['a', 'c'], 'objects of one time are not dropped');
}
await fails('a part that is too short', 'is shorter than the page expects', () => server({ lack: 1 }).w.blockOf(0, 0));

// The latest request is answered; an error does not stop the worker.
const said = [], ready = [], busy = worker({ post: (reply) => { said.push(reply); ready.push(busy.frames.has('0 5')); } });
Object.assign(view, { ...ahead, eye: [0, 0, -3], near: 0.05 });
const asks = (frame, more = {}) => busy.tell({ parts: [{ version: 0, data: true }], frame, ...view, ...more });
for (const f of [0, 1, 2]) asks(f, { next: 5 });
await until(() => said.length > 1 && busy.frames.has('0 5'));
is([said.map((r) => r.frame), said[0].parts[0].words, busy.frames.has('0 1'), ready], [[0, 2], 23, false, [false, false]], 'the wanted frame, and not those asked for in between; then the next one is made ready');
asks(99);
await until(() => said.length > 2);
ok(said[2].error, 'a frame that is not there');
asks(3, { parts: [{ version: 1, data: false }] });
await until(() => said.length > 3);
is([said[3].frame, said[3].parts.map((p) => [p.version, p.texels, p.sh, p.order.length > 0])], [3, [[1, false, false, true]]], 'then the work goes on; an order without the splats');

// ---- The page: images ---------------------------------------------------------------------------

// Splats in the form of the CPU renderer.
const forReference = (list, bands) => ({ count: list.length, bands, pos: [0, 1, 2].map((c) => list.map((s) => s.pos[c])), rot: [0, 1, 2, 3].map((c) => list.map((s) => s.rot[c])), scale: [0, 1, 2].map((c) => list.map((s) => s.scale[c])), alpha: list.map((s) => s.alpha), sh0: [0, 1, 2].map((c) => list.map((s) => s.sh0[c])), shN: Array.from({ length: (bands + 1) ** 2 - 1 }, (_, k) => [0, 1, 2].map((c) => list.map((s) => s.shN[k][c]))) });
const truth = (page, list, bands, model = 'plain') => { const c = page.camera(); return render(forReference(list, bands), { ...c, bg: page.window.spin4d.clip.background }, model, 2 * Math.log(255)); };
const like = (page, want, what, least = 47) => { const dB = psnr(page.gl.picture(), want); ok(dB >= least, `${what}: the picture`, `${dB.toFixed(1)} dB`); };
const opened = (more) => openPage(two, more).settle();

const page = await opened({ clip: (c) => ({ ...c, background: [0.1, 0.2, 0.3] }) });
like(page, truth(page, clips[0][0], 3), 'the first view');
ok(psnr(page.gl.picture(), truth(page, clips[1][0], 1)) < 25, 'which is not that of the other version');
{
    const c = page.camera(), d = sub(clip.target, clip.eye);
    near([c.eye, c.target, c.forward, [c.fovy]].flat(), [clip.eye, clip.target, unit(d), [clip.fovy]].flat(), 1e-6, 'the first view is that of the clip');
    near([dot(c.right, c.down), dot(c.right, c.forward), size(c.right), size(c.down), dot(cross(c.right, c.down), c.forward)], [0, 0, 1, 1, 1], 1e-9, 'right, down and forward are axes');
    ok(dot(c.down, clip.up) < 0, 'up is up');
    is([c.width, c.height, page.root.dataset.shown, page.root.dataset.draft], [64, 40, 'after 10', 'no'], 'what is shown');
}
for (const degree of [2, 1, 0]) {
    const low = await opened({ clip: (c) => { c.versions[0].degree = degree; return c; } });
    like(low, truth(low, clips[0][0], degree), `SH of degree ${degree}`);
}
// The corners that the shaders compute for one splat, with other uniforms.
function corners(gl, splat, more) {
    const [project, boxes] = gl.programs, fragment = project[gl.FRAGMENT_SHADER], vertex = boxes[gl.VERTEX_SHADER];
    Object.assign(fragment.uniforms, { ...project.values, splats: gl.sampler(0), harmonics: gl.sampler(1), order: () => [splat, 0, 0, 1], count: 1, ...more });
    const { ellipse, paint } = fragment.run({ gl_FragCoord: [0.5, 0.5, 0.5, 1] });
    Object.assign(vertex.uniforms, { ellipses: () => ellipse, paints: () => [...paint, 0, 1], first: 0, most: 4 });
    return [0, 1, 2, 3].map((k) => vertex.run({ gl_VertexID: k }).gl_Position);
}
const small0 = [0, 0.7, 1.4, 2.1].flatMap((x) => clips[0][0].map((s) => ({ ...s, pos: [Math.fround(s.pos[0] + 0.1 * x), Math.fround(s.pos[1] - 0.2 * x), s.pos[2]], scale: s.scale.map((v) => 0.12 * v) })));
fs.mkdirSync(`${work}/dots`);
writePly(`${work}/dots/frame_00000.ply`, small0, 0);
command('spin-import', '-q', '--from', 'ply', 'dots', '-o', 'dots.spin');
const dots = html('dots.spin', 'dots.html');
for (const antialias of [false, true]) {
    const p = await openPage({ ...dots, clip: { ...dots.clip, versions: [{ ...dots.clip.versions[0], antialias }] } }).settle();
    like(p, truth(p, small0, 0, antialias ? 'even' : 'plain'), `small splats, ${antialias ? 'meant to be drawn antialiased' : 'plain'}`);
    ok(psnr(p.gl.picture(), truth(p, small0, 0, antialias ? 'plain' : 'even')) < 40, 'and not the other way');
}
{
    const { centre } = clip, at = (k) => clip.eye.map((v, i) => (v + k * page.camera().forward[i] - centre[i]) / clip.size);
    near(page.gl.programs[0].values.near, clip.near / clip.size, 1e-12, 'the near plane, in units of the page');
    const nearest = Math.min(...clips[0][0].map((s) => dot(sub(s.pos, clip.eye), page.camera().forward))), drawn = (eye) => Array.from({ length: SPLATS }, (_, splat) => corners(page.gl, splat, { eye }).filter((end) => end[2] <= 1).length).filter((k) => k > 0);
    ok(drawn(at(0)).length > 250 && drawn(at(0)).every((k) => k === 4), 'splats before the camera have four corners');
    ok(drawn(at(nearest - clip.near - 0.01)).length === drawn(at(0)).length && drawn(at(nearest - clip.near + 0.01)).length < drawn(at(0)).length && drawn(at(99)).length === 0, 'those before the near plane none, though the order is of an older view');
}
// Straight ahead and along the axes: a wide splat and a high one.
for (const [k, what] of [[0, 'wide'], [1, 'high']]) {
    const c = page.camera(), s = splatsIn(await first.decoded(0, 0)).findIndex((p) => size(sub(p.pos, some[k].pos)) < 1e-3), reach = Math.sqrt(2 * Math.log(255 * some[k].alpha));
    const ends = corners(page.gl, s, { eye: some[k].pos.map((v, i) => (v - 2 * (i === 2) - clip.centre[i]) / clip.size), turn: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] }), fragment = page.gl.programs[1][page.gl.FRAGMENT_SHADER];
    near([0, 1].map((i) => Math.max(...ends.map((e) => e[i])) * [c.width, c.height][i] / 2), [0, 1].map((i) => reach * Math.sqrt((c.focal * some[k].scale[i] / 2) ** 2 + 0.3)), 0.05, `a splat that is ${what} is drawn so`);
    is([fragment.run({ place: [0, 0], colour: [1, 1, 1, 1] }).pixel[3], fragment.run({ place: [3.4, 0], colour: [1, 1, 1, 1] })], [0.99, null], 'nothing hides all behind it; rims end at 1/255');
}
// More splats than one draw call takes.
{
    const many = Array.from({ length: 5 * 11 }, (_, k) => clips[0][0].map((s) => ({ ...s, pos: [s.pos[0], Math.fround(s.pos[1] + 0.02 * (k % 11 - 5)), Math.fround(s.pos[2] + 0.02 * (Math.floor(k / 11) - 2))], scale: s.scale.map((v) => 0.05 * v), alpha: 0.5 * s.alpha }))).flat();
    fs.mkdirSync(`${work}/many`);
    writePly(`${work}/many/frame_00000.ply`, many, 0);
    command('spin-import', '-q', '--from', 'ply', 'many', '-o', 'many.spin');
    const large = html('many.spin', 'many.html'), p = await openPage(large, { width: 32, height: 20 }).settle();
    ok(p.replies.at(-1).parts[0].order.length > 16384, 'more than 16384 splats');
    like(p, truth(p, many, 0), 'all of them', 44);
    // A version with few splats, then one with many: their ellipses need a larger texture.
    const both = await openPage({ ...large, clip: { ...large.clip, versions: [{ ...dots.clip.versions[0], name: 'few' }, { ...large.clip.versions[0], name: 'many' }] }, texts: [dots.texts[0], large.texts[0]] }, { width: 16, height: 10 }).settle(), held = both.gl.textures;
    both.key('b');
    await both.settle();
    is([both.root.dataset.shown.split(' ')[0], both.replies.at(-1).parts[0].order.length > 2048, both.gl.textures - held], ['many', true, 2], 'which is made once, and what was too small is given back');
}
// Other window shapes: the whole image of the first camera is visible.
for (const [width, height, ratio, fovy = clip.fovy] of [[30, 50, 1], [30, 50, 1, clip.fovy / 4], [30, 50, 1, clip.fovy / 2], [20, 80, 1, clip.fovy / 4], [10, 80, 1, clip.fovy / 8], [20, 12, 3], [70, 20, 1]]) {
    const p = await opened({ width, height, ratio, clip: (of) => ({ ...of, fovy }) }), c = p.camera(), k = Math.min(ratio, 2), fovx = 2 * Math.atan(c.width / 2 / c.focal), wide = 2 * Math.atan(Math.tan(fovy * Math.PI / 360) * clip.aspect);
    is([c.width, c.height], [k * width, k * height], `${width} x ${height}, ${ratio} pixels each`);
    // In a tall window, a tenth of the content in front of its centre remains above and below.
    const high = clips[0][0].map((s) => sub(s.pos, c.eye)).filter((d) => dot(d, c.forward) > clip.near && Math.abs(dot(d, c.right) / dot(d, c.forward)) < 0.5 * Math.tan(wide / 2)).map((d) => Math.abs(dot(d, unit(cross(c.forward, c.right)))) / dot(d, c.forward)).sort((a, b) => a - b), tall = Math.max(Math.tan(fovy * Math.PI / 360), high[Math.floor(0.9 * high.length)]);
    ok(Math.min(c.fovy - fovy, width > height ? fovx - wide : 0) > -1e-6 && (width > height ? Math.abs(c.fovy - fovy) < 1e-6 || Math.abs(fovx - wide) < 1e-6 : Math.abs(c.height / 2 / c.focal - Math.min(Math.max(tall, c.height / c.width * (clip.keep ?? 0)), c.height / c.width * Math.tan(wide / 2))) < 2e-3), 'all of the first picture, and no more than that', `${c.fovy} ${fovx} ${tall}`);
    like(p, truth(p, clips[0][0], 3), 'there', 45);
}
// From inside the scene, so that the near plane cuts and splats reach beside the camera; other
// axes.
for (const [what, eyeAt, up] of [['amid the splats', [3, -1, 2], [0, -1, 0]], ['up is z', [1, -2, 2.5], [0, 0, 2]], ['up leans', [4, 0.5, 1], [1, -2, 0.3]]]) {
    const p = await opened({ clip: (c) => ({ ...c, eye: eyeAt, target: [3.1, -0.9, 2.3], up }) });
    near([p.camera().eye, p.camera().up].flat(), [eyeAt, unit(up)].flat(), 1e-6, `${what}: the eye`);
    like(p, truth(p, clips[0][0], 3), what);
}

// ---- The page: frames and versions --------------------------------------------------------------

const at = (p, f) => `${p.root.dataset.shown} | ${p.$('label').textContent} | ${p.$('label').title} | ${p.$('scrub').value}` === `after ${10 + 2 * f} | Frame ${f + 1} of 7 | Number ${10 + 2 * f} | ${f}`;
is([page.$('name').textContent, two.html.match(/<title>(.*)<.title>/)[1], page.$('scrub').max, page.$('play').hidden, page.$('speed').hidden, page.$('versions').hidden, page.$('wipe').hidden, page.$('full').hidden, page.$('message').textContent], ['a', 'a', 6, false, false, false, true, false, ''], 'the page as it is opened');
is(page.$('versions').children.map((b) => [b.textContent, b.title, b.dataset.version, b.getAttribute('aria-pressed')]), [['After', 'After alone (B)', 'after', 'true'], ['Before', 'Before alone (B)', 'before', 'false'], ['Wipe', 'Both, with a line between them (C)', 'wipe', 'false']], 'its buttons');
ok(Object.keys(page.elements).filter((k) => /^v\d+f/.test(k)).every((k) => page.elements[k].removed), 'the texts of the blocks are given back');
{
    const messages = page.sent.length;
    page.tick();
    is(page.sent.length, messages, 'nothing is asked for twice');
    is(page.sent.at(-1).next, 1, 'the next frame is asked for as well');
}
ok(page.key('ArrowRight'), 'a key that the page knows');
ok(!page.key('x') && !page.key('ArrowRight', { ctrlKey: true }) && !page.key('b', { metaKey: true }) && !page.key('b', { altKey: true }), 'and others are the browser\'s');
await page.settle();
ok(at(page, 1), 'a frame on', page.root.dataset.shown);
like(page, truth(page, clips[0][1], 3), 'frame 1');
page.key('ArrowLeft');
page.key('ArrowLeft');
await page.settle();
ok(at(page, 6), 'and two back: the last one', page.root.dataset.shown);
like(page, truth(page, clips[0][6], 3), 'the last frame');
is(page.sent.at(-1).next, 0, 'after which comes the first');
page.$('scrub').value = '5';
page.$('scrub').fire('input');
await page.settle();
ok(at(page, 5), 'the slider');
page.key('ArrowRight', { target: page.$('scrub') });
page.key(' ', { target: page.$('play') });
page.key('ArrowRight', { target: page.$('speed') });
await page.settle();
ok(at(page, 5) && page.$('play').textContent === 'Play', 'keys of the slider, a button and a list are theirs');
{
    const before = page.gl.picture();
    page.key('b');
    await page.settle();
    like(page, truth(page, clips[1][5], 1), 'the other version');
    is([page.root.dataset.shown, page.$('versions').children.map((b) => b.getAttribute('aria-pressed'))], ['before 20', ['false', 'true', 'false']], 'and its button');
    page.key('B');
    await page.settle();
    ok(psnr(page.gl.picture(), before) === 99, 'and back');
    is(page.sent.at(-1).parts, [{ version: 0, data: false }], 'whose splats are on the card still');
    page.$('versions').children[1].onclick();
    await page.settle();
    is(page.root.dataset.shown, 'before 20', 'by its button');
    page.$('versions').children[0].onclick();
}
// Both versions: before to the left of the line, after to its right.
page.key('c');
await page.settle();
is([page.root.dataset.shown, page.$('wipe').hidden, page.$('versions').children[2].getAttribute('aria-pressed'), page.$('wipe').style.left, page.$('wipe').getAttribute('aria-valuenow')], ['wipe 20', false, 'true', '50%', '50'], 'the wipe');
const line = page.$('wipe');
line.fire('pointermove', { pointerId: 3, clientX: 10 });
is(line.style.left, '50%', 'the line does not follow before it is taken');
for (const [x, left, now] of [[16, 0.25, '25'], [-5, 0.02, '2'], [64, 0.98, '98'], [40, 0.625, '63']]) {
    line.fire('pointerdown', { pointerId: 3 });
    line.fire('pointermove', { pointerId: 3, clientX: x });
    await page.settle();
    const column = Math.round(left * 64), shot = page.gl.picture(), [b, a] = [truth(page, clips[1][5], 1), truth(page, clips[0][5], 3)];
    for (let y = 0; y < 40; y++) b.rgb.set(a.rgb.subarray(3 * (64 * y + column), 3 * 64 * (y + 1)), 3 * (64 * y + column));
    ok(psnr(shot, b) > 44 && line.getAttribute('aria-valuenow') === now && line.style.left === `${100 * left}%`, `a line at ${x}: before on its left, after on its right`, `${psnr(shot, b)} dB, ${line.style.left}`);
}
ok(line.fire('keydown', { key: 'ArrowLeft' }) && Math.abs(parseFloat(line.style.left) - 60.5) < 1e-9 && line.fire('keydown', { key: 'ArrowRight' }) && !line.fire('keydown', { key: 'x' }), 'keys move the line');
near(parseFloat(line.style.left), 62.5, 1e-9, 'and back');
page.key('c');
is([page.$('wipe').hidden, page.$('versions').children[0].getAttribute('aria-pressed')], [true, 'true'], 'the wipe ends');
page.$('versions').children[2].onclick();
is(page.$('wipe').hidden, false, 'and begins by its button');
page.key('b');
is([page.$('wipe').hidden, page.$('versions').children[1].getAttribute('aria-pressed')], [true, 'true'], 'a version ends it');
page.key('b');

// ---- The page: time -----------------------------------------------------------------------------

// 10 frames a second: a hundred milliseconds each.
const plays = await opened({ width: 16, height: 10 });
is([plays.$('play').textContent, plays.key(' '), plays.$('play').textContent], ['Play', true, 'Pause'], 'plays when told');
const steps = async (ms) => { plays.tick(ms); await plays.settle(); return Number(plays.root.dataset.shown.split(' ')[1]) / 2 - 5; };
is([await steps(60), await steps(60), await steps(90), await steps(300)], [0, 1, 2, 5], 'as many frames a second as the clip has');
is([await steps(100), await steps(100)], [6, 0], 'and round');
plays.$('speed').value = '0.5';
plays.$('speed').fire('change', { target: plays.$('speed') });
is([await steps(130), await steps(200)], [0, 1], 'at half the speed');
is([plays.$('play').onclick(), plays.$('play').textContent, await steps(500)], [undefined, 'Play', 1], 'stops');
plays.key('ArrowRight');
plays.$('play').onclick();
is([await steps(110), await steps(110)], [2, 3], 'goes on from the frame that was chosen');
plays.key('ArrowLeft');
is([plays.$('play').textContent, await steps(500)], ['Play', 2], 'a frame by hand stops it');
plays.$('play').onclick();
plays.$('scrub').value = '4';
plays.$('scrub').fire('input');
is([plays.$('play').textContent, await steps(500)], ['Play', 4], 'so does the slider');
is((await opened({ width: 16, height: 10, media: [] })).$('play').textContent, 'Pause', 'plays by itself unless less motion is wished for');
{
    const still = await openPage({ ...dots, html: two.html }).settle();
    is([still.$('scrub').hidden, still.$('speed').hidden, still.$('versions').hidden, still.sent.at(-1).next, still.key(' '), still.$('play').textContent, still.key('w'), (still.key('c'), still.$('wipe').hidden), still.$('versions').children.length], [true, true, true, undefined, true, 'Play', true, true, 1], 'a still has no time and nothing to compare');
}

// 4D splats can be shown at any time, between frames too.
{
    const p = await openPage(fourD.lines, { width: 16, height: 10 }).settle(), said = () => [p.root.dataset.shown, p.$('label').textContent, p.$('label').title];
    is([p.$('scrub').step, plays.$('scrub').step, said()], [0.1, 1, ['clip 0', 'Frame 1 of 61', 'Number 0']], 'the slider has steps between frames');
    p.key(' ');
    await p.settle();
    p.$('speed').value = '0.1';
    p.$('speed').fire('change', { target: p.$('speed') });
    for (const [ms, frame] of [[250, 0.25], [500, 0.75], [500, 1.25]]) {
        p.tick(ms);
        await p.settle();
        is(said(), [`clip ${frame}`, `Frame ${Math.floor(frame) + 1} of 61`, `Number ${frame}`], `at a tenth of the speed, after ${ms} ms`);
    }
    const whole = p.gl.picture();
    p.key('ArrowRight');
    await p.settle();
    is([said()[0], p.$('play').textContent], ['clip 2', 'Play'], 'a key goes to the next frame');
    ok(psnr(p.gl.picture(), whole) < 60, 'which is another picture');
    p.$('scrub').value = '3.4';
    p.$('scrub').fire('input');
    await p.settle();
    is(said()[0], 'clip 3.4', 'the slider to between two');
    p.key('ArrowLeft');
    await p.settle();
    is(said()[0], 'clip 3', 'and a key to the one before');
    p.$('scrub').value = '59.5';
    p.$('scrub').fire('input');
    p.key(' ');
    p.$('speed').value = '1';
    p.$('speed').fire('change', { target: p.$('speed') });
    p.tick(120);
    await p.settle();
    is(said()[0], 'clip 60', 'the last frame stays for as long as others');
    p.tick(60);
    await p.settle();
    ok(/^clip 0\.\d+$/.test(said()[0]), 'then it begins again', said()[0]);
}

// ---- The page: pointer, keys and touch ----------------------------------------------------------

const canvas = page.$('view');
let moves = 0;
function drag(from, to, more = {}) {
    const id = ++moves;
    canvas.fire('pointerdown', { pointerId: id, clientX: from[0], clientY: from[1] });
    canvas.fire('pointermove', { pointerId: id, clientX: to[0], clientY: to[1], buttons: 1, ...more });
    canvas.fire('pointerup', { pointerId: id });
}
// The position of a point in the image, in pixels.
const seen = (c, p) => { const d = sub(p, c.eye), z = dot(d, c.forward); return [c.width / 2 + c.focal * dot(d, c.right) / z, c.height / 2 + c.focal * dot(d, c.down) / z]; };
page.key('r');
{
    const c = page.camera(), arm = sub(c.eye, c.target), nearby = c.eye.map((v, i) => (v + c.target[i]) / 2 + 0.01), from = seen(c, nearby);
    drag([10, 10], [60, 10]);
    const d = page.camera();
    near(sub(d.eye, d.target), turned(turnAbout(c.up, -0.3), arm), 1e-6, 'a drag of 50 to the right turns by 0.3');
    ok(seen(d, nearby)[0] > from[0], 'what is in front goes right');
    drag([10, 10], [10, 30]);
    const e = page.camera();
    ok(seen(e, nearby)[1] > from[1] && Math.abs(Math.acos(dot(unit(sub(e.eye, e.target)), unit(sub(d.eye, d.target)))) - 0.12) < 1e-6, 'a drag of 20 down: what is in front goes down');
    near([size(sub(e.eye, e.target)), ...e.target], [size(arm), ...c.target], 1e-6, 'the target and its distance stay');
    await page.settle();
    like(page, truth(page, clips[0][5], 3), 'turned');
    const draws = () => Number(page.root.dataset.draws), mostOf = () => page.gl.programs[1].values.most, still = draws();
    await page.settle();
    is([draws(), mostOf()], [still, 4], 'at rest nothing is drawn');
    drag([10, 30], [11, 30]);
    page.tick();
    is([draws(), mostOf()], [still + 1, 2.83], 'while it turns splats end sooner');
    page.tick();
    is([draws(), mostOf()], [still + 2, 4], 'and when it stands they are whole');
    drag([0, 0], [0, 5000]);
    near(Math.asin(dot(unit(sub(page.camera().eye, page.camera().target)), page.camera().up)), 1.55, 1e-6, 'not over the top');
    drag([0, 0], [0, -9000]);
    near(Math.asin(dot(unit(sub(page.camera().eye, page.camera().target)), page.camera().up)), -1.55, 1e-6, 'nor below');
    await page.settle();
    const asked = page.sent.at(-1);
    near([asked.eye, asked.right, asked.down, asked.forward, [asked.near], asked.slope].flat(), [page.camera().eye.map((v, i) => (v - clip.centre[i]) / clip.size), page.camera().right, page.camera().down, page.camera().forward, [clip.near / clip.size], [page.camera().width, page.camera().height].map((v) => v / 2 / page.camera().focal)].flat(), 1e-9, 'the worker orders for that view');
    page.key('r');
    near(page.camera().eye, clip.eye, 1e-6, 'the first view again by a key');
    await page.settle();
    for (const [what, does] of [['turn', () => drag([0, 0], [1, 0])], ['zoom', () => canvas.fire('wheel', { deltaY: 2 })]]) {
        const messages = page.sent.length;
        does();
        await page.settle();
        ok(page.sent.length > messages, `a ${what}, however small, makes a new order`);
    }
    page.key('r');
    canvas.fire('pointerdown', { pointerId: 50, clientX: 0, clientY: 0 });
    for (const x of [10, 30, 40]) canvas.fire('pointermove', { pointerId: 50, clientX: x, clientY: 0, buttons: 1 });
    canvas.fire('pointerup', { pointerId: 50 });
    near(sub(page.camera().eye, clip.target), turned(turnAbout(clip.up, -0.24), sub(clip.eye, clip.target)), 1e-6, 'a drag in three steps turns by their sum');
    page.$('home').onclick();
    near(page.camera().eye, clip.eye, 1e-6, 'by a button');
    drag([0, 0], [9, 9]);
    canvas.fire('dblclick');
    near(page.camera().eye, clip.eye, 1e-6, 'by a double click');
    canvas.fire('pointermove', { pointerId: 77, clientX: 30, clientY: 30, buttons: 0 });
    near(page.camera().eye, clip.eye, 1e-6, 'a pointer that is not down does nothing');
    ok(canvas.fire('contextmenu'), 'the right button has no menu');
    // Keys that fly: half of the way to the target per second, at any frame rate.
    const p = await opened({ width: 16, height: 10 }), home4 = p.camera(), way = 0.5 * size(sub(clip.eye, clip.target));
    const flown = (key, ms) => {
        const from = p.camera();
        p.key(key);
        for (let k = 0; k < ms; k += 50) p.tick(50);
        p.window.fire('keyup', { key });
        p.tick(500);
        return [p.camera().eye, p.camera().target].map((v, i) => sub(v, [from.eye, from.target][i]));
    };
    for (const [key, axis] of [['w', home4.forward], ['S', home4.forward.map((v) => -v)], ['d', home4.right], ['a', home4.right.map((v) => -v)], ['e', home4.down.map((v) => -v)], ['q', home4.down]]) {
        for (const moved of flown(key, 200)) near(moved, axis.map((v) => 0.2 * way * v), 1e-6, `${key} flies`);
    }
    const stood = p.camera().eye;
    p.$('view').fire('pointerdown', { pointerId: 1, clientX: 0, clientY: 0 });
    p.$('view').fire('pointermove', { pointerId: 1, clientX: 30, clientY: 5, buttons: 1 });
    near(p.camera().eye, stood, 1e-6, 'who flies turns where he is');
    ok(size(sub(p.camera().forward, home4.forward)) > 0.1, 'and looks elsewhere');
    p.key('r');
    p.$('view').fire('pointermove', { pointerId: 1, clientX: 60, clientY: 5, buttons: 1 });
    ok(size(sub(p.camera().eye, clip.eye)) > 0.1, 'until the first view');
    p.key('w');
    p.window.fire('blur');
    const left4 = p.camera().eye;
    p.tick(50);
    near(p.camera().eye, left4, 1e-9, 'a key that is held when the window is left is let go');
    p.key('w');
    for (let k = 0; k < 400; k++) p.tick(50);
    near(size(sub(p.camera().target, clip.target)), clip.size, 1e-6, 'no farther than the scene reaches');
    // Close to the target, orbiting hardly moves the eye.
    const close = await opened({ width: 16, height: 10, clip: (c) => ({ ...c, reach: [0.001, 1] }) });
    close.$('view').fire('wheel', { deltaY: -1e5 });
    await close.settle();
    const messages = close.sent.length;
    close.$('view').fire('pointerdown', { pointerId: 1, clientX: 0, clientY: 0 });
    close.$('view').fire('pointermove', { pointerId: 1, clientX: 9, clientY: 0, buttons: 1 });
    await close.settle();
    ok(close.sent.length > messages, 'a turn on the spot makes a new order');
    const narrow = await opened({ width: 8, height: 10 }), asked2 = narrow.sent.length;
    narrow.$('view').clientWidth = 30;
    await narrow.settle();
    ok(narrow.sent.length > asked2, 'so does a wider window');
}
{
    const fine = await opened({ ratio: 2, width: 40, height: 30 }), c = fine.camera();
    for (const how of [{ buttons: 2 }, { shiftKey: true }]) {
        fine.$('home').onclick();
        fine.$('view').fire('pointerdown', { pointerId: 1, clientX: 5, clientY: 5 });
        fine.$('view').fire('pointermove', { pointerId: 1, clientX: 8, clientY: 3, buttons: 1, ...how });
        near(seen(fine.camera(), clip.target), [c.width / 2 + 6, c.height / 2 - 4], 1e-6, `${Object.keys(how)}: the target follows the hand`);
        fine.$('view').fire('pointermove', { pointerId: 1, clientX: 9000, clientY: 3, buttons: 1, ...how });
        near(size(sub(fine.camera().target, clip.target)), clip.size, 1e-6, 'no farther than the scene reaches');
        const left = fine.camera().target;
        fine.$('view').fire('pointercancel', { pointerId: 1 });
        fine.$('view').fire('pointermove', { pointerId: 1, clientX: 20, clientY: 3, buttons: 1, ...how });
        near(fine.camera().target, left, 1e-9, 'and no more once the browser took the pointer away');
    }
}
{
    const far = () => { const c = page.camera(); return size(sub(c.eye, c.target)); }, start = far(), whole = 1.5 * clip.size / Math.tan(clip.fovy * Math.PI / 360);
    ok(canvas.fire('wheel', { deltaY: 100, deltaMode: 0 }), 'the wheel does not scroll');
    near(far(), start * Math.exp(0.15), 1e-6, 'it zooms');
    canvas.fire('wheel', { deltaY: -3, deltaMode: 1 });
    near(far(), start, 1e-6, 'by lines, too');
    canvas.fire('wheel', { deltaY: 1e5 });
    near(far(), Math.max(clip.reach[1], start, whole), 1e-6, 'until the whole scene is seen');
    canvas.fire('wheel', { deltaY: -1e5 });
    near(far(), Math.min(clip.reach[0], start), 1e-6, 'nor into it');
    page.key('r');
    await page.settle();
    const inside = await opened({ clip: (c) => ({ ...c, reach: [2 * start, 3 * start] }) }), there = () => { const c = inside.camera(); return size(sub(c.eye, c.target)); };
    inside.$('view').fire('wheel', { deltaY: -1e5 });
    near(there(), start, 1e-6, 'the first view may be reached again from outside');
    inside.$('view').fire('wheel', { deltaY: 1e5 });
    near(there(), Math.max(3 * start, whole), 1e-6, 'and left');
    const narrow = await opened({ clip: (c) => ({ ...c, reach: [start, start], fovy: c.fovy / 8 }) }), back = narrow.camera(), enough = 1.5 * clip.size / Math.tan(clip.fovy / 8 * Math.PI / 360);
    narrow.$('view').fire('wheel', { deltaY: 1e5 });
    near([size(sub(narrow.camera().eye, clip.target)), size(sub(back.eye, clip.target))], [enough, start], 1e-6, 'by a narrow lens from farther than the cameras stood');
    ok(enough > start, 'which is farther');

    // Two fingers: spreading them to twice the distance halves the distance to the target, and
    // their midpoint moves the target.
    canvas.fire('pointerdown', { pointerId: 101, clientX: 20, clientY: 20 });
    canvas.fire('pointerdown', { pointerId: 102, clientX: 30, clientY: 20 });
    canvas.fire('pointermove', { pointerId: 102, clientX: 32, clientY: 20 });
    near(far(), start * 10 / 12, 1e-6, 'two fingers zoom');
    near(seen(page.camera(), clip.target), [32 + 1, 20], 1e-6, 'and move, by half');
    canvas.fire('pointerup', { pointerId: 101 });
    canvas.fire('pointerup', { pointerId: 102 });
    page.key('r');
}

// ---- The page: text -----------------------------------------------------------------------------

{
    const p = await opened({ width: 16, height: 10, full: false }), title = p.$('title');
    is([p.$('hint').textContent, p.$('full').hidden, title.classList.contains('away'), p.later.map(([, ms]) => ms)], ['Drag to turn, wheel to zoom, right button to move, WASD to fly.', true, false, [8000]], 'a hint');
    p.later[0][0]();
    ok(title.classList.contains('away'), 'for eight seconds');
    for (const [what, does] of [['turns', (q) => { q.$('view').fire('pointerdown', { pointerId: 1, clientX: 0, clientY: 0 }); q.$('view').fire('pointermove', { pointerId: 1, clientX: 1, clientY: 0, buttons: 1 }); }], ['zooms', (q) => q.$('view').fire('wheel', { deltaY: 1 })], ['moves', (q) => { q.$('view').fire('pointerdown', { pointerId: 1, clientX: 0, clientY: 0 }); q.$('view').fire('pointermove', { pointerId: 1, clientX: 1, clientY: 0, buttons: 2 }); }]]) {
        const q = openPage(two, {});
        does(q);
        ok(q.$('title').classList.contains('away'), `or until one ${what}`);
    }
    is((await opened({ width: 16, height: 10, media: ['coarse', 'reduced-motion'] })).$('hint').textContent, 'One finger turns, two move and zoom.', 'for fingers');
    p.key('h');
    ok(p.root.classList.contains('bare') && p.key('H') && !p.root.classList.contains('bare'), 'without controls, and with them');
    p.key('f');
    ok(p.document.fullscreenElement === p.root && (p.$('full').onclick(), !p.document.fullscreenElement), 'full screen, and back');
    p.$('view').fire('webglcontextlost');
    is(p.$('message').textContent, 'The WebGL context was lost: reload the page.', 'a card that is gone');
    const refused = await opened({ width: 16, height: 10, refuseFull: true });
    refused.key('F');
    await until(() => refused.$('message').textContent);
    is(refused.$('message').textContent, 'This browser does not allow full screen.', 'a full screen that is refused');
    is([openPage(two, { noGl: true }), openPage(two, { old: true })].map((q) => [q.$('message').textContent, q.frames.length]), [['This page needs WebGL 2, which this browser does not support.', 0], ['This browser is too old: it has no DecompressionStream.', 0]], 'browsers that are too old');
    const torn = openPage({ ...two, texts: [two.texts[0].map((t) => t.slice(0, 300)), two.texts[1]] });
    await torn.settle();
    ok(torn.$('message').textContent.startsWith('The clip cannot be read: '), 'a page that is torn', torn.$('message').textContent);
}

// ---- The page: embedded, and with options in its address ----------------------------------------

{
    const in16 = (more) => opened({ width: 16, height: 10, ...more }), here = 'http://there/some/page.html';
    const away = (q) => size(sub(q.camera().eye, q.camera().target)), inner = await in16({ embedded: true }), first = away(inner), wheel = (q) => q.$('view').fire('wheel', { deltaY: -50 });
    is([wheel(inner), away(inner) === first, inner.$('view').style.touchAction], [false, true, 'pan-y'], 'in another page the wheel and a finger are that page\'s');
    inner.window.fire('pointerdown');
    is([wheel(inner), away(inner) < first, inner.$('view').style.touchAction], [true, true, 'none'], 'until this one is touched');
    inner.window.fire('blur');
    is([wheel(inner), inner.$('view').style.touchAction], [false, 'pan-y'], 'or left again');
    page.window.fire('blur');
    ok(wheel(page), 'a page of its own always has them');
    page.key('r');
    const one = await in16({ address: `${here}?frame=3&version=before&autoplay=0&fps=20&background=0f8`, media: [] });
    is([one.root.dataset.shown, one.$('play').textContent, one.root.classList.contains('bare'), one.root.style.background], ['before 14', 'Play', false, 'rgb(0,255,136)'], 'a frame, a version and a background');
    near(one.gl.colour, [0, 1, 8 / 15, 1], 1e-9, 'behind the splats as well');
    one.key(' ');
    one.tick(60);
    await one.settle();
    is(one.root.dataset.shown, 'before 16', 'at so many frames a second');
    const two2 = await in16({ address: `${here}?noui&autoplay&poster=first.jpg&version=wipe&background=102030&frame=99&fps=x` });
    is([two2.$('play').textContent, two2.root.classList.contains('bare'), two2.$('poster').src, two2.$('poster').hidden, two2.root.dataset.shown, two2.root.style.background], ['Pause', true, 'first.jpg', true, 'wipe 10', 'rgb(16,32,48)'], 'no controls, plays at once, both versions; a frame and a rate that there are not are left out');
    const waits = openPage(two, { address: `${here}?poster=p.png&noui=0` });
    is([waits.$('poster').hidden, waits.root.classList.contains('bare'), waits.root.classList.contains('loading')], [false, false, true], 'a poster until the first picture is there');
    await waits.settle();
    is([waits.$('poster').hidden, waits.root.classList.contains('loading'), page.$('poster').hidden], [true, false, true], 'and no longer');
    for (const bad of [...SCHEMES, 'http://']) {
        const q = openPage(two, { address: `${here}?poster=${encodeURIComponent(bad)}` });
        is([q.$('poster').hidden, q.$('poster').src], [true, undefined], `a poster of ${JSON.stringify(bad)} is left out`);
    }
    is([(await in16({ address: `${here}?frame=2`, media: [] })).$('play').textContent, openPage(fourD.lines, { address: `${here}?frame=2.5` }).$('label').title], ['Play', 'Number 1.5'], 'a frame that is asked for stays; of 4D splats also one between two');
    ok(openPage(served, { address: 'file:///home/x/served.html' }).$('message').textContent.startsWith('This page loads served.bin from its own folder'), 'from the disk a page of two files says what to do');
    const rests = await in16({ media: [], height: 250 });
    rests.tick(3100);
    await rests.settle();
    ok(rests.root.classList.contains('rest') && rests.root.classList.contains('playing'), 'while it plays the controls go after three seconds');
    rests.window.fire('pointermove');
    rests.tick(16);
    ok(!rests.root.classList.contains('rest'), 'and come back with a hand');
    rests.key(' ');
    rests.tick(9000);
    ok(!rests.root.classList.contains('rest') && !rests.root.classList.contains('playing'), 'and stay when it stands still');
    const low = await in16({ height: 239 }), lone = await in16({ height: 241 });
    for (const q of [low, lone]) { q.tick(3100); await q.settle(); }
    is([low.root.classList.contains('rest'), lone.root.classList.contains('rest')], [true, false], 'from a low picture they go when it stands still, too');
    // By a script, and by messages from the embedding page.
    const mine = await in16({}), api = mine.window.spin4d;
    is(api.state, { play: false, frame: 1, frames: 7, speed: 1, version: 'after', ready: true }, 'what a script is told');
    api.set({ frame: 4, version: 'before', speed: 0.25 });
    await mine.settle();
    is([mine.root.dataset.shown, api.state.frame, api.state.play, mine.$('speed').value], ['before 16', 4, false, '0.25'], 'and what it may set');
    api.set({ play: true, version: 'wipe' });
    is([api.state.play, api.state.version, mine.$('play').textContent], [true, 'wipe', 'Pause'], 'it plays, both versions');
    for (const wish of [{ frame: 0 }, { frame: 8 }, { play: 1 }, { speed: -1 }, { version: 'x' }, { view: [1, 2] }, { view: null }, { other: 1 }]) {
        const was = JSON.stringify(api.state);
        let said4 = '';
        try { api.set({ frame: 2, ...wish }); } catch (e) { said4 = e.message; }
        ok(said4.startsWith(`spin4d: ${Object.keys(wish)[0]} cannot be`) && JSON.stringify(api.state) === was, `${JSON.stringify(wish)} is refused, and nothing is done`, said4);
    }
    const heard = [], around = { postMessage: (m) => heard.push(m.spin4d) }, held = await in16({ embedded: around });
    is(heard.at(-1), { play: false, frame: 1, frames: 7, speed: 1, version: 'after', ready: true }, 'the page around is told');
    const before = heard.length;
    held.window.fire('message', { source: around, data: { spin4d: { frame: 3 } } });
    await held.settle();
    is([held.root.dataset.shown, heard.length - before, heard.at(-1).frame], ['after 14', 1, 3], 'and may set the same');
    held.window.fire('message', { source: around, data: { spin4d: { frame: 99 } } });
    is(heard.at(-1), { error: 'spin4d: frame cannot be 99' }, 'or is told why not');
    for (const e of [{ source: {}, data: { spin4d: { frame: 1 } } }, { source: around, data: 'hello' }, { source: around, data: null }]) held.window.fire('message', e);
    await held.settle();
    is([held.root.dataset.shown, heard.length - before], ['after 14', 2], 'others are not listened to');
    const named = (title) => { command('spin-export', '-q', 'dots.spin', '--to', 'html', '-o', 'named.html', '--force', '--title', title); return readPage(`${work}/named.html`); }, tag = named('A <b> & "c"'), none = named('');
    const shownName = openPage(tag);
    is([tag.html.match(/<title>(.*)<.title>/)[1], shownName.$('name').textContent, shownName.$('title').hidden], ['A &lt;b> &amp; &quot;c&quot;', 'A <b> & "c"', false], 'a title of its own');
    is(tag.html.match(/property="og:title" content="([^"]*)"/)[1], 'A &lt;b> &amp; &quot;c&quot;', 'which previews of links show too');
    // The view: in the address, set by a script, and copied as a link.
    const seen = (q) => { const { eye, target } = q.camera(); return [...eye, ...target]; }, list = [4, -3, 1.5, 3, -1, 2];
    near(seen(await in16({ address: `${here}?view=${list}` })), list, 1e-5, 'a view in the address');
    for (const bad of ['', '1,2,3', '1,2,3,1,2,3', '1,2,3,4,5,x', '1,2,3,4,5,', '1,2,3,4,5,Infinity', '1,2,3,4,5,6,7']) near(seen(await in16({ address: `${here}?view=${bad}` })), seen(await in16({})), 1e-9, `the view '${bad}' is left out`);
    const framed = await in16({ address: `${here}?view=${list}` });
    framed.$('view').fire('wheel', { deltaY: -200 });
    ok(away(framed) < size(sub(list.slice(0, 3), list.slice(3))), 'zoomed from there');
    framed.key('r');
    near(seen(framed), list, 1e-5, 'and back to it');
    framed.window.spin4d.set({ view: { eye: [1, 2, 3], target: [3, 0, 2] } });
    near(seen(framed), [1, 2, 3, 3, 0, 2], 1e-5, 'a view by a script');
    framed.window.spin4d.set({ view: list });
    near(seen(framed), list, 1e-5, 'as six numbers');
    let copied = '';
    const linked = await in16({ address: `${here}?view=${list}&noui`, clipboard: { writeText: async (text) => { copied = text; } } });
    linked.key('ArrowRight');
    linked.key('v');
    await until(() => copied && linked.$('message').textContent);
    const link = new URL(copied).searchParams;
    near(link.get('view').split(',').map(Number), list, 1e-4, 'V copies the address with the view');
    is([link.get('frame'), link.has('noui'), copied.includes('%2C'), linked.$('message').textContent], ['2', true, false, 'The link to this view is copied.'], 'with the frame and the rest of the address');
    linked.later.at(-1)[0]();
    is(linked.$('message').textContent, '', 'and says so for a while');
    const denied = await in16({});
    denied.key('V');
    await until(() => denied.$('message').textContent);
    ok(denied.$('message').textContent.includes('?x=&view='), 'where copying is not allowed the address is shown', denied.$('message').textContent);
    // Keys, and the button of an embedded clip that waits to be started.
    denied.key('End');
    is(denied.$('label').textContent, 'Frame 7 of 7', 'End');
    denied.key('Home');
    is(denied.$('label').textContent, 'Frame 1 of 7', 'Home');
    is([denied.$('keys').hidden, denied.key('?'), denied.$('keys').hidden, denied.key('Escape'), denied.$('keys').hidden, denied.key('Escape')], [true, true, false, true, true, false], 'a list of keys');
    const paused = await in16({ embedded: true }), alone = await in16({});
    is([paused.$('start').hidden, alone.$('start').hidden], [false, true], 'a button on a clip that waits in another page');
    paused.$('start').onclick();
    is([paused.$('start').hidden, paused.$('play').textContent], [true, 'Pause'], 'plays it');
    is([alone.$('bar').hidden, tag.html.includes('<div id="bar" hidden>')], [false, true], 'without JavaScript there are no buttons');
    is([none.html.match(/<title>(.*)<.title>/)[1], openPage(none).$('title').hidden], ['named', true], 'or none');
}

// ---- The page: with its data on a server --------------------------------------------------------

{
    const p = openPage(served, { media: [] });
    p.tick();
    await new Promise(setImmediate);
    is([p.sent[1].draft, p.sent[1].next, p.sent[1].frame], [true, undefined, 0], 'the draft is asked for first');
    await until(() => p.replies.length);
    p.tick();
    is([p.root.dataset.draft, p.root.dataset.shown, p.asked, p.$('label').textContent], ['yes', 'clip 10', [['http://there/some/served.bin', s0.draft.at, s0.draft.at + s0.draft.bytes - 1]], 'Frame 1 of 7'], 'and shown, with nothing else read');
    is([p.loaded.at(-1), p.root.style['--loaded']], [1, '100%'], 'how much is loaded was shown');
    p.tick(5000);
    is(p.$('label').textContent, 'Frame 1 of 7', 'it does not play');
    await until(() => p.replies.length > 1);
    p.tick();
    is([p.root.dataset.draft, p.sent[2].parts, p.sent[2].draft], ['no', [{ version: 0, data: true }], false], 'then the frame itself');
    like(p, truth(p, clips[0][0], 3), 'that frame');
    is(p.gl.textures, 5, 'in textures that are larger; the small ones are given back');
    p.tick(250);
    is(p.$('label').textContent, 'Frame 3 of 7', 'and now it plays');
}
// A request for another frame, or for both versions, that comes before the draft suppresses the
// draft.
for (const [what, does] of [['another frame', (p) => p.key('ArrowRight')], ['both versions', (p) => p.key('c')]]) {
    const p = openPage({ ...served, clip: { ...served.clip, versions: [s0, { ...s0, name: 'other' }] } });
    does(p);
    p.tick();
    await new Promise(setImmediate);
    is(p.sent[1].draft, false, `no draft of ${what}`);
}
// More splats than a row of the texture holds.
{
    const p = await opened({ width: 16, height: 10 }), words = p.gl.units[1].data, t = p.gl.units[0];
    is([t.width, t.height, p.gl.units[1].height > 3, words.some((v, i) => v && i > 3 * 2048)], [2048, 1, true, true], 'textures as long as needed');
    p.key('ArrowRight');
    await p.settle();
    is(p.gl.textures, 5, 'which are used again');
}

// ---- Malformed .sogst files: exporters/player/sogst.js ------------------------------------------

{
    const code3 = fs.readFileSync(new URL('../../exporters/player/sogst.js', import.meta.url), 'utf8'), fixture = (name) => new URL(`../../fixtures/sogst/${name}/scene.sogst`, import.meta.url);
    // The members of a ZIP whose entries are stored, and how to write one.
    const membersOf = (file) => {
        const bytes = fs.readFileSync(file), members = new Map();
        for (let at = bytes.readUInt32LE(bytes.length - 6), n = bytes.readUInt16LE(bytes.length - 12); n > 0; n--) {
            const [size3, name, extra, note] = [24, 28, 30, 32].map((o) => (o === 24 ? bytes.readUInt32LE(at + o) : bytes.readUInt16LE(at + o))), local = bytes.readUInt32LE(at + 42);
            const from = local + 30 + bytes.readUInt16LE(local + 26) + bytes.readUInt16LE(local + 28);
            members.set(bytes.toString('utf8', at + 46, at + 46 + name), bytes.subarray(from, from + size3));
            at += 46 + name + extra + note;
        }
        return members;
    };
    const zipOf = (members) => {
        const parts = [], directory = [];
        let at = 0;
        for (const [name, data] of members) {
            const local = Buffer.alloc(30), head = Buffer.alloc(46), label = Buffer.from(name);
            local.writeUInt32LE(0x04034b50, 0);
            local.writeUInt16LE(label.length, 26);
            head.writeUInt32LE(0x02014b50, 0);
            [20, 24].forEach((o) => head.writeUInt32LE(data.length, o));
            head.writeUInt16LE(label.length, 28);
            head.writeUInt32LE(at, 42);
            parts.push(local, label, data);
            directory.push(head, label);
            at += 30 + label.length + data.length;
        }
        const end = Buffer.alloc(22);
        end.writeUInt32LE(0x06054b50, 0);
        end.writeUInt16LE(members.size, 10);
        end.writeUInt32LE(at, 16);
        return new Uint8Array(Buffer.concat([...parts, ...directory, end]));
    };
    const sizesOf = (webp) => { const v = webp.readUInt32LE(21); return { width: 1 + (v & 0x3fff), height: 1 + (v >>> 14 & 0x3fff), close() {} }; };
    // Returns { error } or { frames, n, decoded }, for images whose bytes are all 252.
    // ranges: the server supports range requests, which are listed in state.ranges.
    const read = async (name, change = () => {}, address = 'http://there/view.html?src=c.sogst', ranges = false) => {
        const members = membersOf(fixture(name)), meta = JSON.parse(members.get('meta.json'));
        delete meta.shN;
        change(meta, members);
        members.set('meta.json', Buffer.from(JSON.stringify(meta)));
        const elements = { clip: {}, page: { textContent: '' }, message: {} }, state = { decoded: 0 }, gl = new Proxy({ readPixels: (x, y, w, h, f, t, out) => out.fill(252) }, { get: (o, key) => o[key] ?? (() => {}) });
        await new Promise((end) => {
            const window = { parent: { postMessage: (m) => { state.error = m.spin4d.error; end(); } } };
            const document = { getElementById: (id) => elements[id], createElement: (tag) => (tag === 'canvas' ? { getContext: () => gl } : {}), body: { append: async () => {
                const { parts, load } = window.spinMoving;
                try {
                    if (ranges) state.ranges.push('shown');
                    const splats = ranges ? [] : await Promise.all(parts.map((_, k) => load(k)));
                    for (const k of ranges ? parts.keys() : []) splats.push(await load(k));
                    state.n = splats.reduce((sum, s) => sum + s.n, 0);
                    state.frames = JSON.parse(elements.clip.textContent).numbers.length;
                } catch (e) {
                    state.error = e.message;
                }
                end();
            } } };
            const given = { document, window, location: { href: address }, fetch: async (_, { headers: { Range } }) => {
                const file = zipOf(members), [from, to] = ranges ? Range.slice(6).split('-').map(Number) : [0, file.length - 1];
                if (!ranges) return new Response(file);
                state.ranges.push([from, Math.min(to + 1, file.length)]);
                return new Response(file.subarray(from, to + 1), { status: 206, headers: { 'Content-Range': `bytes ${from}-${Math.min(to, file.length - 1)}/${file.length}` } });
            }, createImageBitmap: async (blob) => { state.decoded++; return sizesOf(Buffer.from(await blob.arrayBuffer())); } };
            if (ranges) state.ranges = [];
            new Function(...Object.keys(given), ranges ? code3.replaceAll('= 65536, TAIL = 65536, GAP = 65536', '= 100, TAIL = 100, GAP = 1') : code3)(...Object.values(given));
        });
        return state;
    };
    is(await read('no_segments'), { decoded: 8, n: 300, frames: 61 }, 'a .sogst file is read');
    is(await read('sh1_by_splat_transform'), { decoded: 88, n: 420, frames: 61 }, 'and one of segments');
    {
        const { ranges, error, n: n3, frames: frames3, decoded } = await read('sh1_by_splat_transform', () => {}, undefined, true), size3 = zipOf(membersOf(fixture('sh1_by_splat_transform'))).length;
        const before = ranges.indexOf('shown'), sum = (list) => list.reduce((all, [from, to]) => all + to - from, 0);
        is([error, n3, frames3, decoded], [undefined, 420, 61, 88], 'by ranges, the same splats');
        ok(before > 0 && sum(ranges.slice(0, before)) < 0.75 * size3, 'the first image needs a part of the file', `${sum(ranges.slice(0, before))} of ${size3}`);
        ok(new Set(ranges.map(String)).size === ranges.length, 'nothing is read twice', JSON.stringify(ranges));
    }
    const header = (webp, size3) => { const copy = Buffer.from(webp); copy.writeUInt32LE(size3 - 1 | size3 - 1 << 14, 21); return copy; };
    for (const [what, words, change, name = 'no_segments'] of [
        ['ten years long', 'number of frames', (m) => { m.time.max = 3e8; }], ['of a billion frames a second', 'frame rate', (m) => { m.time.fps = 1e9; }], ['of no frame rate', 'frame rate', (m) => { delete m.time.fps; }], ['that ends before it begins', 'number of frames', (m) => { m.time.max = -1; }],
        ['of a billion splats', 'count', (m) => { m.count = 1e9; }], ['of two million splats in 30 kB', 'count', (m) => { m.count = 2e6; }], ['of half a splat', 'count', (m) => { m.count = 0.5; }], ['of more splats than pixels', 'pixels for 9000 values', (m) => { m.count = 9000; }],
        ['with SH of degree 40', 'bands of shN', (m) => { m.shN = { bands: 40 }; }], ['with a palette of a million', 'count of shN', (m) => { m.shN = { bands: 1, count: 1e6 }; }],
        ['with a picture of 16384 pixels a side', '16384x16384 pixels', (m, f) => f.set('means_l.webp', header(f.get('means_l.webp'), 16384))], ['with a picture of no WebP', 'not a WebP', (m, f) => f.set('means_l.webp', Buffer.alloc(40))],
        ['with an animation', 'not a lossless WebP', (m, f) => f.set('means_l.webp', Buffer.concat([f.get('means_l.webp').subarray(0, 12), Buffer.from('ANIM'), Buffer.alloc(30)]))],
        ['with a chunk that never ends', 'not a lossless WebP', (m, f) => f.set('means_l.webp', Buffer.concat([f.get('means_l.webp').subarray(0, 12), Buffer.from('EXIF'), Buffer.alloc(30, 255)]))],
        ['with a short codebook', 'codebook', (m) => { m.scales.codebook.length = 3; }], ['with a codebook of words', 'codebook', (m) => { m.scales.codebook[9] = 'x'; }], ['beyond what a float holds', 'place', (m) => { m.means.maxs[0] = 1e3; }],
        ['whose segments overlap', 'segments', (m) => { m.segments.list.forEach((s) => { s.range = [0, m.count]; }); }, 'sh1_by_splat_transform'], ['whose segments end early', 'segments', (m) => { m.segments.list.length = m.streams.segments.length = 2; }, 'sh1_by_splat_transform'], ['with streams alone', 'segments', (m) => { delete m.segments; }, 'sh1_by_splat_transform']
    ]) {
        const { error, decoded } = await read(name, change);
        ok(error?.includes(words) && (decoded === 0 || ['place', 'codebook'].includes(words)), `a clip ${what} is refused, unread`, `${error}, ${decoded} pictures decoded`);
    }
    is((await read('no_segments', () => {}, 'file:///view.html?src=c.sogst')).error.split('. ')[0], 'spin4d: browsers do not let pages read local files', 'a local file is refused with a reason');
    for (const bad of SCHEMES) ok((await read('no_segments', () => {}, `http://there/view.html?src=${encodeURIComponent(bad)}`)).error, `a clip at ${JSON.stringify(bad)} is refused`);
}

// ---- The player for other pages: exporters/player -----------------------------------------------

{
    const folder = new URL('../../exporters/player/', import.meta.url), about = JSON.parse(fs.readFileSync(new URL('package.json', folder))), version = fs.readFileSync(new URL('../../src/spin.h', import.meta.url), 'utf8').match(/SPIN_VERSION "(.*)"/)[1];
    is([about.version, about.files.every((f) => f === 'view.html' || fs.existsSync(new URL(f, folder)))], [version, true], 'the package has the version of spin4d, and its files but that which is made');
    const listeners = new Set(), made = [], kinds = {};
    class Thing extends EventTarget {
        style = {};
        attributes = {};
        children = [];
        isConnected = true;
        append(child) { this.children.push(child); child.parent = this; }
        hasAttribute(name) { return name in this.attributes; }
        getAttribute(name) { return this.attributes[name] ?? null; }
    }
    const tell = (source, data) => [...listeners].forEach((f) => f({ source, data }));
    Object.assign(globalThis, {
        HTMLElement: Thing, customElements: { get: (name) => kinds[name], define: (name, kind) => { kinds[name] = kind; } }, window: { addEventListener: (_, f) => listeners.add(f), removeEventListener: (_, f) => listeners.delete(f) },
        document: { baseURI: 'https://site/blog/post.html', createElement: () => made[made.push({ addEventListener(type, f) { this[type] = f; }, style: {}, sent: [], removed: false, contentWindow: { postMessage(m) { made.find((f) => f.contentWindow === this).sent.push(m.spin4d); } }, remove() { this.removed = true; } }) - 1] }
    });
    const { createPlayer, addressOf } = await import(new URL('player.js', folder)), element = new Thing(), player = createPlayer(element, '../clips/a.html?frame=2', { autoplay: false, noui: true, frame: 7, poster: 'p.jpg', version: null });
    const [frame] = made, events = [], now = { play: false, frame: 7, frames: 9, speed: 1, version: 'after', ready: false };
    for (const type of ['ready', 'change', 'error']) player.addEventListener(type, (e) => events.push(e.message ?? type));
    is([frame.src, frame.parent === element, frame.title], ['https://site/clips/a.html?frame=7&autoplay=0&noui=1&poster=https%3A%2F%2Fsite%2Fblog%2Fp.jpg', true, 'A clip of 3-D splats'], 'a frame with what is wished for in its address');
    player.play();
    player.speed = 0.5;
    is([frame.sent, player.state, player.speed], [[], null, 1], 'wishes wait for the page');
    tell({}, { spin4d: now });
    tell(frame.contentWindow, 'something else');
    is(player.state, null, 'others are not listened to');
    tell(frame.contentWindow, { spin4d: now });
    is([frame.sent, player.state, events], [[{ play: true }, { speed: 0.5 }], now, ['change']], 'and are told when it is there');
    tell(frame.contentWindow, { spin4d: { ...now, ready: true, speed: 0.5 } });
    tell(frame.contentWindow, { spin4d: { ...now, ready: true, frame: 8, version: 'wipe' } });
    is([events, player.version, player.speed], [['change', 'ready', 'change', 'change'], 'wipe', 1], 'it says once that it is ready, and what changes');
    frame.sent.length = 0;
    player.pause();
    player.seek(3.5);
    player.version = 'before';
    tell(frame.contentWindow, { spin4d: { error: 'spin4d: frame cannot be 99' } });
    is([frame.sent, events.at(-1), player.state.frame], [[{ play: false }, { play: false, frame: 3.5 }, { version: 'before' }], 'spin4d: frame cannot be 99', 8], 'pause, seek, version; and mistakes');
    const later = [], setTimeoutOf = globalThis.setTimeout;
    globalThis.setTimeout = (f, ms) => later.push([f, ms]);
    const parts = createPlayer(element, 'b.bin?frame=2'), lost = [];
    parts.addEventListener('error', (e) => lost.push(e.message));
    made.at(-1).load();
    frame.load();
    is([made.at(-1).src, later.map(([, ms]) => ms)], ['https://site/blog/b.html?frame=2', [5000, 5000]], 'the data of --split stand for their page');
    later.forEach(([f]) => f());
    globalThis.setTimeout = setTimeoutOf;
    is([lost, events.filter((e) => e.includes('is missing')).length], [['spin4d: https://site/blog/b.html?frame=2 is missing or is not a page of spin-export'], 0], 'a page that says nothing is an error');
    parts.destroy();
    made.pop();
    is(addressOf('c.sogst', { noui: true }), `${new URL('view.html', folder)}?src=${encodeURIComponent('https://site/blog/c.sogst')}&noui=1`, 'a .sogst file is shown by the page that comes with the player');
    for (const bad of SCHEMES) {
        await fails(`a clip of ${JSON.stringify(bad)} is refused`, 'not one of http, https, blob or file', () => createPlayer(element, bad));
        await fails('and so is a poster', 'not one of http, https, blob or file', () => addressOf('a.html', { poster: bad }));
    }
    is(['http://a/b.html', 'blob:https://site/1', 'file:///b.html', '../b.html', '//c/b.html'].map((url) => addressOf(url)), ['http://a/b.html', 'blob:https://site/1', 'file:///b.html', 'https://site/b.html', 'https://c/b.html'], 'the web, blobs, files and relative addresses are not');
    player.destroy();
    is([frame.removed, listeners.size], [true, 0], 'nothing is left of it');
    const hostile = new kinds['spin-clip'](), refused = [];
    hostile.addEventListener('error', (e) => refused.push(e.message));
    hostile.attributes = { src: 'javascript:alert(1)' };
    hostile.connectedCallback();
    is([made.length, hostile.children.length, hostile.player, refused.length], [1, 0, null, 1], '<spin-clip> of a script is an error, and no frame');
    const clip3 = new kinds['spin-clip']();
    clip3.connectedCallback();
    is(made.length, 1, '<spin-clip> without a clip is empty');
    clip3.attributes = { src: 'b.html', noui: '', fps: '12', title: 'A ball' };
    clip3.attributeChangedCallback('src', null, 'b.html');
    is([made[1].src, made[1].title, made[1].parent === clip3, clip3.style.aspectRatio], ['https://site/blog/b.html?noui=1&fps=12', 'A ball', true, '16 / 9'], 'with one it is a frame, its attributes the options');
    let ready = 0;
    clip3.addEventListener('ready', () => { ready++; });
    tell(made[1].contentWindow, { spin4d: { ...now, ready: true } });
    clip3.attributes.src = 'c.html';
    clip3.attributeChangedCallback('src', 'b.html', 'c.html');
    is([ready, made[1].removed, made[2].src.includes('c.html'), clip3.player.state], [1, true, true, null], 'another clip, another frame');
    clip3.disconnectedCallback();
    is([made[2].removed, listeners.size, clip3.player], [true, 0, null], 'which goes with the element');
    const upgraded = new kinds['spin-clip'](), madeBefore = made.length;
    upgraded.attributes = { src: 'b.html' };
    upgraded.attributeChangedCallback('src', null, 'b.html');
    upgraded.connectedCallback();
    is(made.length, madeBefore + 1, 'an element that was in the page before the script loads its clip once');
    upgraded.disconnectedCallback();
}

// ---- Sound ------------------------------------------------------------------------------------

{
    const tone = Buffer.alloc(44 + 2 * 8000);
    [['RIFF', 0], ['WAVEfmt ', 8], ['data', 36]].forEach(([word, at]) => tone.write(word, at, 'latin1'));
    [[4, tone.length - 8], [16, 16], [24, 8000], [28, 16000], [40, 16000]].forEach(([at, v]) => tone.writeUInt32LE(v, at));
    [[20, 1], [22, 1], [32, 2], [34, 16]].forEach(([at, v]) => tone.writeUInt16LE(v, at));
    fs.writeFileSync(`${work}/tone.wav`, tone);
    const heard = html('clip0.spin', 'heard.html', '--sound', 'tone.wav'), beside = html('clip0.spin', 'beside.html', '--sound', 'tone.wav', '--split');
    ok(tone.equals(Buffer.from(heard.html.match(/<audio id="sound" preload="auto" src="data:audio.wav;base64,([^"]*)">/)[1], 'base64')), 'the page contains the sound');
    ok(beside.html.includes('src="beside.sound.wav"') && tone.equals(fs.readFileSync(`${work}/beside.sound.wav`)), 'with --split it is a file beside the page');
    is([heard.clip.sound, pages[0].clip.sound], [{ step: 0.1, start: 0, volume: 1 }, undefined], 'its place in the clip');
    const quiet = await openPage(pages[0]).settle();
    is([quiet.$('mute').hidden, quiet.key('m')], [true, false], 'without sound there is no button for it');
    const p = await openPage(heard).settle(), audio = p.$('sound');
    is([audio.muted, audio.paused, p.$('mute').hidden, p.$('mute').getAttribute('aria-pressed')], [true, true, false, 'false'], 'the sound is muted at first');
    p.$('mute').onclick();
    is([audio.muted, p.$('mute').getAttribute('aria-pressed')], [false, 'true'], 'a button turns it on');
    ok(p.key('m') && audio.muted && p.key('M') && !audio.muted, 'and so does a key');
    p.window.spin4d.set({ frame: 3, play: true });
    p.tick(50);
    near([audio.currentTime, audio.playbackRate, Number(audio.paused)], [0.25, 1, 0], 0.011, 'it plays from where the clip is');
    audio.currentTime += 0.05;
    p.tick(100);
    near(audio.currentTime, 0.3, 0.011, 'a small difference is left alone');
    audio.currentTime = 0.9;
    p.tick(1);
    near(audio.currentTime, 0.351, 0.011, 'a large one is corrected');
    p.window.spin4d.set({ speed: 0.5 });
    p.tick(10);
    near(audio.playbackRate, 0.5, 1e-9, 'it has the speed of the clip');
    p.window.spin4d.set({ speed: 100 });
    p.tick(0);
    is(audio.paused, true, 'but none that no browser plays');
    p.window.spin4d.set({ speed: 1, frame: 7 });
    p.tick(150);
    near([audio.currentTime, Number(audio.paused)], [0.05, 0], 0.011, 'it begins again with the clip');
    p.document.hidden = true;
    p.document.onvisibilitychange();
    is(audio.paused, true, 'it pauses with a hidden page');
    p.document.hidden = false;
    audio.duration = 0.2;
    p.window.spin4d.set({ frame: 4 });
    p.tick(1);
    is(audio.paused, true, 'and after its end');
    audio.duration = NaN;
    p.tick(1);
    p.window.spin4d.set({ play: false });
    p.tick(1);
    is(audio.paused, true, 'it pauses with the clip');
    const later = await openPage({ ...heard, clip: { ...heard.clip, sound: { step: 0.1, start: 0.25, volume: 0.5 } } }).settle();
    later.window.spin4d.set({ frame: 2, play: true });
    later.tick(0);
    const before = later.$('sound').paused;
    later.window.spin4d.set({ frame: 6 });
    later.tick(0);
    is([before, later.$('sound').paused, later.$('sound').volume], [true, false, 0.5], 'a later sound waits');
    near(later.$('sound').currentTime, 0.25, 0.011, 'and plays from its own beginning');
}
console.log(`1..${tests}`);
process.exit(failed ? 1 : 0);
