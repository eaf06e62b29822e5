#!/usr/bin/env node
// Decodes the output of --to html with the page's own worker, outside a browser: writes frames as
// PLY files, and measures how many splats and frames it decodes per second.
import fs from 'node:fs';
import path from 'node:path';
import { parseArgs } from 'node:util';
import { readPage, workerOf } from './lib/browser.mjs';
import { readPly } from './lib/splat.mjs';

const HELP = `usage: node page-decode.mjs [options] PAGE.html
  --version NAME    which of the page's versions (its first)
  --ply DIR         write the frames there, frame_NNNNN.ply
  --like DIR        frames of the same names there, by spin-export --to ply: every splat of the page must lie
                    where one of them lies, within two steps of the page
  --repeat N        decode the clip N times (1); the rate is that of the last
Prints one line: frames, splats, seconds of this process, splats a second.
Exit status: 0 all well, 1 something failed, 2 wrong usage.`;

let opt, args;
try {
    ({ values: opt, positionals: args } = parseArgs({ allowPositionals: true, options: { version: { type: 'string' }, repeat: { type: 'string', default: '1' }, ply: { type: 'string' }, like: { type: 'string' }, help: { type: 'boolean', short: 'h' } } }));
    if (opt.help) { console.log(HELP); process.exit(0); }
    if (args.length !== 1) throw new Error('name one page');
} catch (e) {
    console.error(`page-decode: ${e.message}\n${HELP}`);
    process.exit(2);
}

const { clip, texts, data, code } = readPage(args[0]);
const fromFile = async (_, { headers }) => {
    const [from, to] = headers.Range.slice(6).split('-').map(Number);
    return new Response(data.subarray(from, to + 1), { status: 206 });
};
const worker = workerOf(code('worker'), ['decoded', 'advance', 'blocksAt'], { fetch: fromFile });
worker.tell({ clip, texts, address: clip.data });
const version = opt.version ? clip.versions.findIndex((v) => v.name === opt.version) : 0;
if (version < 0) throw new Error(`no version '${opt.version}'`);
const v = clip.versions[version];

function multiply(a, b) {
    return [a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3], a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1], a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]];
}
function turn(x) {
    const angle = Math.hypot(...x), k = angle > 1e-9 ? Math.sin(angle / 2) / angle : 0.5;
    return [Math.cos(angle / 2), ...x.map((c) => k * c)];
}

const rest = v.sh / 3, names = ['x', 'y', 'z', 'f_dc_0', 'f_dc_1', 'f_dc_2'];
for (let k = 0; k < v.sh; k++) names.push(`f_rest_${k}`);
names.push('opacity', 'scale_0', 'scale_1', 'scale_2', 'rot_0', 'rot_1', 'rot_2', 'rot_3');
const scaled = (q, k) => q.map((x) => k * x), sum = (a, b) => a.map((x, i) => x + b[i]);

// The values by the layout of exporters/html/format.md: for one splat, value(column) returns a
// column, q the rotation.
function splatOf(value, q) {
    const opacity = Math.min(1 - 1e-7, Math.max(1e-7, value(6))), out = [0, 1, 2].map((c) => value(c) + clip.centre[c]);
    for (let c = 0; c < 3; c++) out.push((value(3 + c) - 0.5) / 0.28209479177387814);
    for (let c = 0; c < 3; c++) for (let k = 0; k < rest; k++) out.push(value(13 + 3 * k + c));
    return out.concat(Math.log(opacity / (1 - opacity)), [7, 8, 9].map(value), q);
}

const s = clip.steps, stepOf = (c) => (c < 3 ? s.place : c < 6 ? s.colour : c < 7 ? s.opacity : c < 10 ? s.scale : c < 13 ? s.rotation : s.sh);

function frameValues(g, frame) {
    return Array.from({ length: g.n + v.own[frame] }, (_, i) => {
        const own = i >= g.n, key = (c) => (own ? g.own[c][i - g.n] : 0.5 * g.keys[c][i]), number = (c) => (own || i < g.still ? 0 : g.last[c][i - g.still]);
        const turned = (x) => turn([10, 11, 12].map((c) => x(c) * s.rotation));
        return splatOf((c) => (key(c) + number(c)) * stepOf(c), multiply(turned(key), turned(number)));
    });
}

// Slices 4D splats at a frame.
function rowValues(blocks, frame) {
    const r = v.rows, tick = frame * r.ticks, out = [];
    for (const b of blocks) for (let i = 0; i < b.n; i++) {
        const share = (tick - b.from[i]) / b.length[i], t = share * r.degree;
        if (share < 0 || share >= 1) continue;
        const side = (x, sign) => Math.exp(-0.5 * Math.max(0, sign * (frame - x.at[i]) * x.by[i]) ** 2), gate = r.gate ? b.gate[i] * r.gate : 0;
        const newton = [t, t * (t - 1) / 2, t * (t - 1) * (t - 2) / 6], path = (c) => newton.reduce((total, k, d) => total + (d < r.degree ? k * b.path[3 * d + c][i] : 0), 0);
        const angle = r.period && 2 * Math.PI * frame / r.period - b.cosines[0][i] * r.phase, at = (c) => (c < 6 ? c - 3 : c - 10), n = 3 + v.sh;
        const wave = (c) => (r.period && (c > 12 || (c > 2 && c < 6)) ? (c < 6 ? r.cosine : r.cosine_sh) * (Math.cos(angle) * b.cosines[1 + at(c)][i] + Math.cos(2 * angle) * b.cosines[1 + n + at(c)][i]) : 0);
        const value = (c) => (c < 3 ? (b.keys[c][i] + path(c)) * s.place : c === 6 ? Math.min(1, Math.max(0, b.keys[6][i] * s.opacity)) * (gate + (1 - gate) * side(b.rise, -1) * side(b.fall, 1)) : b.keys[c][i] * stepOf(c) + wave(c));
        const first = turn([10, 11, 12].map((c) => b.keys[c][i] * s.rotation)), last = r.ratio ? multiply(first, turn([0, 1, 2].map((c) => b.turn[c][i] * s.rotation))) : first;
        const q = r.ratio ? sum(scaled(first, 1 - share), scaled(last, share * Math.exp(b.turn[3][i] * r.ratio))) : first;
        out.push(splatOf(value, scaled(q, 1 / Math.hypot(...q))));
    }
    return out;
}

// Writes frames, compares them, or both.
function usePly(file, list) {
    const head = `ply\nformat binary_little_endian 1.0\n${v.antialias ? "comment antialiased 1\n" : ""}element vertex ${list.length}\n${names.map((k) => `property float ${k}\n`).join('')}end_header\n`;
    if (opt.ply) fs.writeFileSync(path.join(opt.ply, file), Buffer.concat([Buffer.from(head), Buffer.from(new Float32Array(list.flat()).buffer)]));
    if (opt.like) compare(path.join(opt.like, file), list.flatMap((x) => x.slice(0, 3)), 2 * s.place);
}

// Fails unless each position [n][3] is within this distance, on each axis, of a splat of the PLY.
function compare(file, places, within) {
    const { count, pos } = readPly(file), cells = new Map(), cell = (x) => Math.floor(x / within);
    for (let i = 0; i < count; i++) {
        const key = pos.map((x) => cell(x[i])).join();
        if (!cells.get(key)?.push(i)) cells.set(key, [i]);
    }
    const near = (x) => {
        for (let k = 0; k < 27; k++) {
            const found = cells.get([k % 3, Math.floor(k / 3) % 3, Math.floor(k / 9)].map((d, c) => cell(x[c]) + d - 1).join());
            if (found?.some((i) => pos.every((y, c) => Math.abs(y[i] - x[c]) <= within))) return true;
        }
        return false;
    };
    for (let i = 0; i < places.length; i += 3)
        if (!near(places.slice(i, i + 3))) throw new Error(`${file} has no splat where the page has number ${i / 3}`);
}

let splats = 0, seconds = 0;
if (opt.ply) fs.mkdirSync(opt.ply, { recursive: true });
for (let turn = 0; turn < Number(opt.repeat); turn++) {
    splats = seconds = 0;
    for (let f = 0; f < clip.numbers.length; f++) {
        const t0 = process.cpuUsage(), frame = await worker.decoded(version, f), { user, system } = process.cpuUsage(t0);
        seconds += (user + system) / 1e6;
        splats += frame.n;
        if (!opt.ply && !opt.like) continue;
        const file = `frame_${String(clip.numbers[f]).padStart(5, '0')}.ply`;
        if (v.rows) usePly(file, rowValues(await worker.blocksAt(version, f * v.rows.ticks), f));
        else usePly(file, frameValues(await worker.advance(version, f), f));
    }
}
console.log(`${v.name}: ${clip.numbers.length} frames, ${splats} splats, ${seconds.toFixed(2)} s, ${(splats / seconds / 1e6).toFixed(2)} million splats a second`);
