#!/usr/bin/env node
// The page of --to html without a browser, in Node 18 or later: its worker's numbers against the splats that were exported,
// its pictures against the CPU renderer of the bench, and what buttons, keys and fingers do. Prints TAP.
//     node page-in-node.mjs FOLDER_OF_COMMANDS WORKING_FOLDER
import { execFileSync } from 'node:child_process';
import fs from 'node:fs';
import path from 'node:path';
import zlib from 'node:zlib';
import { openPage, readPage, workerOf } from './lib/browser.mjs';
import { halfValue } from './lib/glsl.mjs';
import { psnr } from './lib/png.mjs';
import { render } from './lib/reference.mjs';
import { writePly } from './lib/write.mjs';

const [bin, work] = process.argv.slice(2), BANDS = [3, 1], SPLATS = 300, FRAMES = 7, C0 = 0.28209479177387814;
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

// ---- Vectors -----------------------------------------------------------------------------------------

const sub = (a, b) => a.map((v, i) => v - b[i]), dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0), size = (a) => Math.hypot(...a), unit = (a) => a.map((v) => v / size(a));
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const times = (a, b) => [a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3], a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2], a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1], a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]];
const turnAbout = (axis, angle) => [Math.cos(angle / 2), ...unit(axis).map((v) => v * Math.sin(angle / 2))];
const turned = (q, v) => times(times(q, [0, ...v]), [q[0], -q[1], -q[2], -q[3]]).slice(1);
// Row by row, the six different numbers of a covariance.
function covariance({ rot, scale }) {
    const q = unit(rot), axes = [0, 1, 2].map((k) => turned(q, [0, 1, 2].map((c) => (c === k ? scale[k] : 0))));
    return [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]].map(([i, j]) => dot(axes.map((a) => a[i]), axes.map((a) => a[j])));
}

// ---- A clip ------------------------------------------------------------------------------------------
// Splats that stand, move, turn, grow and fade; from frame 4 on some go and others come. Twice: with SH of degree 3,
// and in other colours with SH of degree 1.

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
// Both as one page with a version after and one before.
const two = { ...pages[0], texts: [pages[0].texts[0], pages[1].texts[0]], clip: { ...pages[0].clip, versions: [{ ...pages[0].clip.versions[0], name: 'after', label: 'After' }, { ...pages[1].clip.versions[0], name: 'before', label: 'Before' }] } };
for (const key of ['size', 'centre', 'steps']) is(pages[1].clip[key], pages[0].clip[key], `both clips have one ${key}`);
const { clip } = two, v0 = clip.versions[0], code = two.code('worker');
is([clip.numbers, v0.first, v0.own.map((n) => n > 0)], [[10, 12, 14, 16, 18, 20, 22], [0, 0, 0, 3, 3, 3, 6], [false, false, false, true, true, true, false]], 'the clip has groups, and rows of single frames');
ok(v0.still.every((n, f) => n > 30 && n <= v0.shared[f]) && v0.still[0] < v0.shared[0], 'and rows that stand still');

// ---- The worker: numbers -----------------------------------------------------------------------------

const NAMES = ['bytesOf', 'unfolded', 'columnsIn', 'half', 'cut', 'scaleOf', 'turnsOf', 'sorted', 'decoded', 'frameOf', 'frames', 'fetched', 'blockOf', 'draftOf', 'advance'];
const worker = (more = {}, given = two, changed = code) => { const w = workerOf(changed, NAMES, more); w.tell({ clip: given.clip, texts: given.texts, address: more.address ?? null }); return w; };
const first = worker();

// The splats of a frame as the shader has them, in world units; sh by channel.
function splatsIn({ n, texels, place, sh, words }) {
    return Array.from({ length: n }, (_, i) => {
        const t = texels.subarray(8 * i, 8 * i + 8), both = (w) => [halfValue(w & 65535), halfValue(w >>> 16)];
        return { pos: [0, 1, 2].map((c) => place[8 * i + c] * clip.size + clip.centre[c]), colour: [t[3] & 65535, t[3] >>> 16, t[7] & 65535].map((v) => v / 65535 * 4 - 1), alpha: (t[7] >>> 16) / 65535, covariance: [t[4], t[5], t[6]].flatMap(both).map((v) => v / 1024 * clip.size ** 2), sh: [...sh.subarray(2 * words * i, 2 * words * (i + 1))].map(halfValue) };
    });
}
// What is not as it was exported; nothing when all is well.
function wrongIn(frame, wanted, within = 1.6 * bounds.place, slack = 0) {
    const left = new Set(wanted);
    for (const s of splatsIn(frame)) {
        const of = [...left].find((w) => w.pos.every((v, c) => Math.abs(v - s.pos[c]) <= within));
        if (!of) { if (s.alpha > 0) return `no splat at ${s.pos}`; continue; }
        left.delete(of);
        const cov = covariance(of), trace = cov[0] + cov[3] + cov[5], colour = of.sh0.map((v) => 0.5 + C0 * v), sh = of.shN.flat();
        if (s.colour.some((v, c) => Math.abs(v - colour[c]) > (bounds.colour + 0.02) / 255)) return `colour ${s.colour} for ${colour}`;
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
ok(await first.frameOf(0, 5) === await first.frameOf(0, 5), 'a frame is decoded once');

// Half precision: each number is itself; between two the nearer.
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

// Columns by hand, and all that are cut off.
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
// Ten rows; 0, 2 and 9 change, by 1, -1 and 300: folded and less one 1, 0 and 599.
const thrice = (reader, x, mean) => { for (let k = 0; k < 3; k++) reader.changes(x, mean, 10); };
is(column([2, 5, 2, 1, 0, 87, 0, 0, 2, 0, 0], 10, thrice), [1, 0, -1, 0, 0, 0, 0, 0, 0, 300], 'changes, and twice none');
// The means become 8, 8 and 2400 sixteenths; then 12 and 3600.
is(column([2, 5, 2, 1, 0, 87, 0, 0, 2, 16, 0], 10, thrice), [1, 0, 0, 0, 0, 0, 0, 0, 0, 150], 'and from the mean');
is(column([2, 5, 2, 1, 0, 87, 0, 0, 2, 0, 17, 1, 0, 1], 10, thrice), [2, 0, -1, 0, 0, 0, 0, 0, 0, 225], 'with changes added');

// Bytes as text: seven bits a character, five of which are written otherwise.
const bytes = Uint8Array.from({ length: 3000 }, () => 256 * random()), special = [0, 10, 13, 60, 127];
const sevens = [...bytes].map((b) => b.toString(2).padStart(8, '0')).join('').match(/.{1,7}/g).map((s) => parseInt(s.padEnd(7, '0'), 2));
is([...first.bytesOf(sevens.map((s) => (special.includes(s) ? `\x7f${special.indexOf(s)}` : String.fromCharCode(s))).join(''))].slice(0, 3000), [...bytes], 'seven bits a character');

// ---- The worker: order -------------------------------------------------------------------------------

const n = 2000, place = new Float32Array(8 * n).map(() => 4 * about()), eye = [0.3, -0.2, 0.1], forward = unit([1, 2, -0.5]);
const depth = Array.from({ length: n }, (_, i) => dot(sub([...place.subarray(8 * i, 8 * i + 3)], eye), forward)), order = [...first.sorted({ n, place }, eye, forward, 0.2)];
is([...order].sort((a, b) => a - b), depth.flatMap((d, i) => (d >= 0.2 ? [i] : [])), 'all splats that are not before the near plane, once');
ok(order.every((i, k) => !k || depth[i] <= depth[order[k - 1]] * 1.0001), 'far to near');
const exactDepths = new Float32Array(16).map((_, k) => (k === 2 ? 0.5 : k === 10 ? 1 : 0));
is([...first.sorted({ n: 2, place: exactDepths }, [0, 0, 0], [0, 0, 1], 0.5)], [1, 0], 'one at the near plane is in');
is([[...first.sorted({ n: 1, place: exactDepths }, [0, 0, 0], [0, 0, 1], 0.1)], [...first.sorted({ n, place }, eye, forward, 99)]], [[0], []], 'one splat, and none');

// ---- The worker: frames that are kept, and what is fetched ---------------------------------------------

// With room for three frames and a half.
const least = Math.min(...v0.splats) * (32 + 4 * 23), small = worker({}, two, code.replace('400e6', String(3.5 * least)));
for (const f of [0, 1, 2]) await small.frameOf(0, f);
await small.frameOf(0, 0);
await small.frameOf(0, 3);
is([...small.frames.keys()], ['0 2', '0 0', '0 3'], 'the frame that was not used for longest goes');
const tiny = worker({}, two, code.replace('400e6', '1'));
for (const f of [0, 1]) await tiny.frameOf(0, f);
is([...tiny.frames.keys()], ['0 1'], 'but not the one that is shown, however large');

const { versions: [s0] } = served.clip;
function server({ status = 206, cut = 0 } = {}, given = served) {
    const asked = [], w = worker({ address: 'http://x/served.bin', fetch: async (address, { headers }) => {
        const [from, to] = headers.Range.match(/^bytes=(\d+)-(\d+)$/).slice(1).map(Number);
        asked.push([from, to + 1]);
        if (status === 404) return new Response('', { status, statusText: 'Not Found' });
        return new Response(status === 206 ? served.data.subarray(from, to + 1) : served.data.subarray(0, served.data.length - cut), { status });
    } }, given);
    return { w, asked };
}
const partly = server(), wholly = server({ status: 200 });
await partly.w.blockOf(0, 0);
is(partly.asked, [[0, s0.bytes[0]]], 'the first block alone');
await partly.w.blockOf(0, 1);
is(partly.asked.slice(1), [[s0.at[1], s0.at[6] + s0.bytes[6]]], 'then all that follow, to a megabyte');
for (let f = 0; f < FRAMES; f++) ok(Buffer.from(await partly.w.blockOf(0, f)).equals(zlib.gunzipSync(served.data.subarray(s0.at[f], s0.at[f] + s0.bytes[f]))), `block ${f} is that of the file`);
is(partly.asked.length, 2, 'which is asked for no more');
// Runs end before a megabyte, made smaller here, and where blocks do not lie side by side.
const [runs, apart] = [s0.bytes[1] + s0.bytes[2] + 1, 1e6].map((most, gap) => {
    const asked = [], given = { ...served, clip: { ...served.clip, versions: [gap ? { ...s0, at: s0.at.map((a, f) => (f > 2 ? a + 1 : a)) } : s0] } };
    return { asked, w: worker({ address: 'x', fetch: async (_, { headers }) => { const [from, to] = headers.Range.slice(6).split('-').map(Number); asked.push(to + 1); return new Response(served.data.subarray(from, to + 1), { status: 206 }); } }, given, code.replace('1e6', String(most))) };
});
for (const w of [runs, apart]) { await w.w.blockOf(0, 0); await w.w.blockOf(0, 1); }
is([runs.asked[1], apart.asked[1]], [s0.at[3] + s0.bytes[3], s0.at[2] + s0.bytes[2]], 'in runs of so many bytes, side by side');
// A server that sends all is asked once, for all versions.
const twice = { ...served, clip: { ...served.clip, versions: [s0, { ...s0, name: 'other', at: [...s0.at].reverse(), bytes: [...s0.bytes].reverse() }] } }, every = server({ status: 200 }, twice);
for (const [v, f] of [[0, 2], [1, 2], [1, 6]]) ok(Buffer.from(await every.w.blockOf(v, f)).equals(zlib.gunzipSync(served.data.subarray(...((at) => [at, at + served.clip.versions[0].bytes[v ? 6 - f : f]])(twice.clip.versions[v].at[f])))), `version ${v}, block ${f}`);
is(every.asked.length, 1, 'from one answer');
await wholly.w.blockOf(0, 4);
for (let f = 0; f < FRAMES; f++) ok(Buffer.from(await wholly.w.blockOf(0, f)).equals(Buffer.from(await partly.w.blockOf(0, f))), `block ${f} of a server that sends all`);
is(wholly.asked.length, 1, 'once');
const missing = server({ status: 404 }), short = server({ status: 200, cut: served.data.length - s0.at[6] });
await fails('a file that is not there', 'http://x/served.bin: 404 Not Found', () => missing.w.blockOf(0, 0));
await fails('a file that is too short', 'served.bin is shorter than the page says', () => short.w.blockOf(0, 0));
for (const { w } of [partly, wholly]) {
    const draft = await w.draftOf(0), why = wrongIn(draft, clips[0][0], 1.6 * bounds.place, 1);
    ok(draft.n === s0.draft.splats && why === '', 'the draft has splats of the first frame', why);
}

// What is asked for last is answered; a mistake does not end the work.
const said = [], ready = [], busy = worker({ post: (reply) => { said.push(reply); ready.push(busy.frames.has('0 5')); } }), view = { eye: [0, 0, -3], forward: [0, 0, 1], near: 0.05 };
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

// ---- The page: pictures ------------------------------------------------------------------------------

// Splats as the CPU renderer takes them.
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
// Small, and more than a row of the textures has.
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
    const { vertex, uniforms } = page.gl, { centre } = clip, at = (k) => clip.eye.map((v, i) => (v + k * page.camera().forward[i] - centre[i]) / clip.size);
    near(uniforms.near, clip.near / clip.size, 1e-12, 'the near plane, in units of the page');
    const nearest = Math.min(...clips[0][0].map((s) => dot(sub(s.pos, clip.eye), page.camera().forward))), drawn = (eye) => {
        Object.assign(vertex.uniforms, { ...uniforms, splats: page.gl.sampler(0), harmonics: page.gl.sampler(1), eye });
        return Array.from({ length: SPLATS }, (_, splat) => [0, 1, 2, 3].filter((corner) => vertex.run({ gl_VertexID: corner, splat }).gl_Position[2] <= 1).length).filter((k) => k > 0);
    };
    ok(drawn(at(0)).length > 250 && drawn(at(0)).every((k) => k === 4), 'splats before the camera have four corners');
    ok(drawn(at(nearest - 0.21)).length === drawn(at(0)).length && drawn(at(nearest - 0.19)).length < drawn(at(0)).length && drawn(at(99)).length === 0, 'those before the near plane none, though the order is of an older view');
}
// Straight ahead and along the axes: one that is wide, one that is high.
for (const [k, what] of [[0, 'wide'], [1, 'high']]) {
    const { vertex, fragment, uniforms } = page.gl, c = page.camera(), s = splatsIn(await first.decoded(0, 0)).findIndex((p) => size(sub(p.pos, some[k].pos)) < 1e-3);
    Object.assign(vertex.uniforms, { ...uniforms, splats: page.gl.sampler(0), harmonics: page.gl.sampler(1), eye: some[k].pos.map((v, i) => (v - 2 * c.forward[i] - clip.centre[i]) / clip.size), turn: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] });
    const ends = [0, 1, 2, 3].map((corner) => vertex.run({ gl_VertexID: corner, splat: s }).gl_Position), reach = Math.sqrt(2 * Math.log(255 * some[k].alpha));
    near([0, 1].map((i) => Math.max(...ends.map((e) => e[i])) * [c.width, c.height][i] / 2), [0, 1].map((i) => reach * Math.sqrt((c.focal * some[k].scale[i] / 2) ** 2 + 0.3)), 0.05, `a splat that is ${what} is drawn so`);
    is([fragment.run({ place: [0, 0], colour: [1, 1, 1, 1] }).pixel[3], fragment.run({ place: [3.4, 0], colour: [1, 1, 1, 1] })], [0.99, null], 'nothing hides all behind it; rims end at 1/255');
}
// Other windows: the whole picture of the first camera is in view.
for (const [width, height, ratio] of [[30, 50, 1], [20, 12, 3], [70, 20, 1]]) {
    const p = await opened({ width, height, ratio }), c = p.camera(), k = Math.min(ratio, 2), fovx = 2 * Math.atan(c.width / 2 / c.focal), wide = 2 * Math.atan(Math.tan(clip.fovy * Math.PI / 360) * clip.aspect);
    is([c.width, c.height], [k * width, k * height], `${width} x ${height}, ${ratio} pixels each`);
    ok(Math.min(c.fovy * Math.PI / 180 - clip.fovy * Math.PI / 180, fovx - wide) > -1e-9 && (Math.abs(c.fovy - clip.fovy) < 1e-6 || Math.abs(fovx - wide) < 1e-6), 'all of the first picture, and no more than that', `${c.fovy} ${fovx}`);
    like(p, truth(p, clips[0][0], 3), 'there');
}
// Within the scene, so that the near plane cuts and splats reach beside the camera; other axes.
for (const [what, eyeAt, up] of [['amid the splats', [3, -1, 2], [0, -1, 0]], ['up is z', [1, -2, 2.5], [0, 0, 2]], ['up leans', [4, 0.5, 1], [1, -2, 0.3]]]) {
    const p = await opened({ clip: (c) => ({ ...c, eye: eyeAt, target: [3.1, -0.9, 2.3], up }) });
    near([p.camera().eye, p.camera().up].flat(), [eyeAt, unit(up)].flat(), 1e-6, `${what}: the eye`);
    like(p, truth(p, clips[0][0], 3), what);
}

// ---- The page: frames and versions -------------------------------------------------------------------

const at = (p, f) => `${p.root.dataset.shown} | ${p.$('label').textContent} | ${p.$('label').title} | ${p.$('scrub').value}` === `after ${10 + 2 * f} | Frame ${f + 1} of 7 | Number ${10 + 2 * f} | ${f}`;
is([page.$('name').textContent, page.document.title, page.$('scrub').max, page.$('time').hidden, page.$('speed').hidden, page.$('versions').hidden, page.$('wipe').hidden, page.$('full').hidden, page.$('message').textContent], ['a', 'a', 6, false, false, false, true, false, ''], 'the page as it is opened');
is(page.$('versions').children.map((b) => [b.textContent, b.title, b.dataset.version, b.getAttribute('aria-pressed')]), [['After', 'After alone (B)', 'after', 'true'], ['Before', 'Before alone (B)', 'before', 'false'], ['Wipe', 'Both, with a line between them (W)', 'wipe', 'false']], 'its buttons');
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
// Both: before on the left of the line, after on its right.
page.key('w');
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
page.key('w');
is([page.$('wipe').hidden, page.$('versions').children[0].getAttribute('aria-pressed')], [true, 'true'], 'the wipe ends');
page.$('versions').children[2].onclick();
is(page.$('wipe').hidden, false, 'and begins by its button');
page.key('b');
is([page.$('wipe').hidden, page.$('versions').children[1].getAttribute('aria-pressed')], [true, 'true'], 'a version ends it');
page.key('b');

// ---- The page: time ----------------------------------------------------------------------------------

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
    is([still.$('time').hidden, still.$('speed').hidden, still.$('versions').hidden, still.sent.at(-1).next, still.key(' '), still.$('play').textContent, still.key('w'), still.$('wipe').hidden, still.$('versions').children.length], [true, true, true, undefined, true, 'Play', true, true, 1], 'a still has no time and nothing to compare');
}

// ---- The page: hands ---------------------------------------------------------------------------------

const canvas = page.$('view');
let moves = 0;
function drag(from, to, more = {}) {
    const id = ++moves;
    canvas.fire('pointerdown', { pointerId: id, clientX: from[0], clientY: from[1] });
    canvas.fire('pointermove', { pointerId: id, clientX: to[0], clientY: to[1], buttons: 1, ...more });
    canvas.fire('pointerup', { pointerId: id });
}
// Where a place is in the picture, in pixels.
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
    drag([0, 0], [0, 5000]);
    near(Math.asin(dot(unit(sub(page.camera().eye, page.camera().target)), page.camera().up)), 1.55, 1e-6, 'not over the top');
    drag([0, 0], [0, -9000]);
    near(Math.asin(dot(unit(sub(page.camera().eye, page.camera().target)), page.camera().up)), -1.55, 1e-6, 'nor below');
    await page.settle();
    const asked = page.sent.at(-1);
    near([asked.eye, asked.forward, [asked.near]].flat(), [page.camera().eye.map((v, i) => (v - clip.centre[i]) / clip.size), page.camera().forward, [clip.near / clip.size]].flat(), 1e-9, 'the worker orders for that view');
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
    // Near the target the eye hardly moves when it turns.
    const close = await opened({ width: 16, height: 10, clip: (c) => ({ ...c, reach: [0.001, 1] }) });
    close.$('view').fire('wheel', { deltaY: -1e5 });
    await close.settle();
    const messages = close.sent.length;
    close.$('view').fire('pointerdown', { pointerId: 1, clientX: 0, clientY: 0 });
    close.$('view').fire('pointermove', { pointerId: 1, clientX: 9, clientY: 0, buttons: 1 });
    await close.settle();
    ok(close.sent.length > messages, 'a turn on the spot makes a new order');
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
    const far = () => { const c = page.camera(); return size(sub(c.eye, c.target)); }, start = far();
    ok(canvas.fire('wheel', { deltaY: 100, deltaMode: 0 }), 'the wheel does not scroll');
    near(far(), start * Math.exp(0.15), 1e-6, 'it zooms');
    canvas.fire('wheel', { deltaY: -3, deltaMode: 1 });
    near(far(), start, 1e-6, 'by lines, too');
    canvas.fire('wheel', { deltaY: 1e5 });
    near(far(), Math.max(clip.reach[1], start), 1e-6, 'not out of the scene');
    canvas.fire('wheel', { deltaY: -1e5 });
    near(far(), Math.min(clip.reach[0], start), 1e-6, 'nor into it');
    page.key('r');
    await page.settle();
    const inside = await opened({ clip: (c) => ({ ...c, reach: [2 * start, 3 * start] }) }), there = () => { const c = inside.camera(); return size(sub(c.eye, c.target)); };
    inside.$('view').fire('wheel', { deltaY: -1e5 });
    near(there(), start, 1e-6, 'the first view may be reached again from outside');
    inside.$('view').fire('wheel', { deltaY: 1e5 });
    near(there(), 3 * start, 1e-6, 'and left');

    // Two fingers: twice as far apart is half the distance, and their middle moves the target.
    canvas.fire('pointerdown', { pointerId: 101, clientX: 20, clientY: 20 });
    canvas.fire('pointerdown', { pointerId: 102, clientX: 30, clientY: 20 });
    canvas.fire('pointermove', { pointerId: 102, clientX: 32, clientY: 20 });
    near(far(), start * 10 / 12, 1e-6, 'two fingers zoom');
    near(seen(page.camera(), clip.target), [32 + 1, 20], 1e-6, 'and move, by half');
    canvas.fire('pointerup', { pointerId: 101 });
    canvas.fire('pointerup', { pointerId: 102 });
    page.key('r');
}

// ---- The page: words ---------------------------------------------------------------------------------

{
    const p = await opened({ width: 16, height: 10, full: false }), title = p.$('title');
    is([p.$('hint').textContent, p.$('full').hidden, title.classList.contains('away'), p.later.map(([, ms]) => ms)], ['Drag to turn, wheel to zoom, right button to move.', true, false, [8000]], 'a hint');
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
    is(p.$('message').textContent, 'The graphics card lost the picture: reload the page.', 'a card that is gone');
    const refused = await opened({ width: 16, height: 10, refuseFull: true });
    refused.key('F');
    await until(() => refused.$('message').textContent);
    is(refused.$('message').textContent, 'This browser does not allow a full screen.', 'a full screen that is refused');
    is([openPage(two, { noGl: true }), openPage(two, { old: true })].map((q) => [q.$('message').textContent, q.frames.length]), [['This page needs WebGL 2, which this browser does not offer.', 0], ['This browser is too old: it has no DecompressionStream.', 0]], 'browsers that are too old');
    const torn = openPage({ ...two, texts: [two.texts[0].map((t) => t.slice(0, 300)), two.texts[1]] });
    await torn.settle();
    ok(torn.$('message').textContent.startsWith('The clip cannot be read: '), 'a page that is torn', torn.$('message').textContent);
}

// ---- The page: with its data on a server -----------------------------------------------------------------

{
    const p = openPage(served, { media: [] });
    p.tick();
    await new Promise(setImmediate);
    is([p.sent[1].draft, p.sent[1].next, p.sent[1].frame], [true, undefined, 0], 'the draft is asked for first');
    await until(() => p.replies.length);
    p.tick();
    is([p.root.dataset.draft, p.root.dataset.shown, p.asked, p.$('label').textContent], ['yes', 'clip 10', [['http://there/some/served.bin', s0.draft.at, s0.draft.at + s0.draft.bytes - 1]], 'Frame 1 of 7'], 'and shown, with nothing else read');
    p.tick(5000);
    is(p.$('label').textContent, 'Frame 1 of 7', 'it does not play');
    await until(() => p.replies.length > 1);
    p.tick();
    is([p.root.dataset.draft, p.sent[2].parts, p.sent[2].draft], ['no', [{ version: 0, data: true }], false], 'then the frame itself');
    like(p, truth(p, clips[0][0], 3), 'that frame');
    is(p.gl.textures, 2, 'in textures that are larger; the small ones are given back');
    p.tick(250);
    is(p.$('label').textContent, 'Frame 3 of 7', 'and now it plays');
}
// Whoever asks for another frame, or for both versions, before the draft is there gets no draft.
for (const [what, does] of [['another frame', (p) => p.key('ArrowRight')], ['both versions', (p) => p.key('w')]]) {
    const p = openPage({ ...served, clip: { ...served.clip, versions: [s0, { ...s0, name: 'other' }] } });
    does(p);
    p.tick();
    await new Promise(setImmediate);
    is(p.sent[1].draft, false, `no draft of ${what}`);
}
// More splats than a row of the texture has.
{
    const p = await opened({ width: 16, height: 10 }), words = p.gl.units[1].data, t = p.gl.units[0];
    is([t.width, t.height, p.gl.units[1].height > 3, words.some((v, i) => v && i > 3 * 2048)], [2048, 1, true, true], 'textures as long as needed');
    p.key('ArrowRight');
    await p.settle();
    is(p.gl.textures, 2, 'which are used again');
}
console.log(`1..${tests}`);
process.exit(failed ? 1 : 0);
