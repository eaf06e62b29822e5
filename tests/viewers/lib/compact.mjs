// Reads the compact formats into the form of splat.mjs: .splat, compressed PLY, SPZ 2 to 4. Written
// from the formats' descriptions, independently of the exporters under test. Strict: a wrong
// length, a name out of order or a value outside its range is an error.
import fs from 'node:fs';
import os from 'node:os';
import path from 'node:path';
import { spawnSync } from 'node:child_process';
import { createRequire } from 'node:module';
import zlib from 'node:zlib';
import { readPly } from './splat.mjs';
import { ZSTDDecoder } from 'three/examples/jsm/libs/zstddec.module.js';

const C0 = 0.28209479177387814;
const columns = (n, count) => Array.from({ length: n }, () => new Float32Array(count));

function blank(file, bytes, count, bands) {
    const k = [0, 3, 8, 15][bands];
    return {
        file, bytes, count, bands, pos: columns(3, count), rot: columns(4, count),
        scale: columns(3, count), alpha: new Float32Array(count), sh0: columns(3, count),
        shN: Array.from({ length: k }, () => columns(3, count))
    };
}

// 32 bytes a splat: position 3 f32, linear scale 3 f32, r g b a, rotation w x y z as q * 128 + 128.
export function readSplat(file) {
    const b = fs.readFileSync(file);
    if (!b.length || b.length % 32) throw new Error(`${file}: ${b.length} bytes is no multiple of 32`);
    const s = blank(file, b.length, b.length / 32, 0);
    for (let i = 0; i < s.count; i++) {
        const at = 32 * i, q = [0, 1, 2, 3].map((k) => (b[at + 28 + k] - 128) / 128);
        const length = Math.hypot(...q);
        for (let c = 0; c < 3; c++) {
            s.pos[c][i] = b.readFloatLE(at + 4 * c);
            s.scale[c][i] = b.readFloatLE(at + 12 + 4 * c);
            s.sh0[c][i] = (b[at + 24 + c] / 255 - 0.5) / C0;
        }
        s.alpha[i] = b[at + 27] / 255;
        for (let k = 0; k < 4; k++) s.rot[k][i] = length > 0 ? q[k] / length : 0;
    }
    return s;
}

const CHUNK = ['min_x', 'min_y', 'min_z', 'max_x', 'max_y', 'max_z', 'min_scale_x', 'min_scale_y',
    'min_scale_z', 'max_scale_x', 'max_scale_y', 'max_scale_z', 'min_r', 'min_g', 'min_b', 'max_r',
    'max_g', 'max_b'];
const VERTEX = ['packed_position', 'packed_rotation', 'packed_scale', 'packed_color'];

function compressedHeader(file, b) {
    const end = b.indexOf('end_header\n');
    if (b.toString('latin1', 0, 4) !== 'ply\n' || end < 0) throw new Error(`${file}: not a PLY`);
    const lines = b.toString('latin1', 0, end).split('\n');
    if (lines[1] !== 'format binary_little_endian 1.0') throw new Error(`${file}: ${lines[1]}`);
    const elements = [];
    for (const w of lines.map((l) => l.split(' '))) {
        if (w[0] === 'element') elements.push({ name: w[1], count: Number(w[2]), props: [] });
        if (w[0] === 'property') elements.at(-1).props.push(`${w[1]} ${w[2]}`);
    }
    const [chunk, vertex, sh] = elements;
    const same = (e, name, want) => e?.name === name && e.props.join() === want.join();
    if (!same(chunk, 'chunk', CHUNK.map((n) => `float ${n}`))) throw new Error(`${file}: element chunk`);
    if (!same(vertex, 'vertex', VERTEX.map((n) => `uint ${n}`))) throw new Error(`${file}: element vertex`);
    const rest = sh?.props.length ?? 0, bands = { 0: 0, 9: 1, 24: 2, 45: 3 }[rest];
    const names = Array.from({ length: rest }, (_, i) => `uchar f_rest_${i}`);
    if (bands === undefined || (sh && !same(sh, 'sh', names))) throw new Error(`${file}: element sh`);
    if (chunk.count !== Math.ceil(vertex.count / 256)) throw new Error(`${file}: ${chunk.count} chunks`);
    return { start: end + 11, count: vertex.count, chunks: chunk.count, rest, bands };
}

// Chunks of 256: ranges, then 11-10-11 bits of position and scale, 2-10-10-10 of rotation, 4 x 8 of
// colour.
export function readCompressedPly(file) {
    const b = fs.readFileSync(file), h = compressedHeader(file, b);
    const vertices = h.start + 72 * h.chunks, shs = vertices + 16 * h.count;
    if (b.length !== shs + h.rest * h.count) throw new Error(`${file}: ${b.length} bytes, header promises ${shs + h.rest * h.count}`);
    const s = blank(file, b.length, h.count, h.bands), k = s.shN.length;
    const parts = (v, bits) => bits.map(([at, n]) => ((v >>> at) & (2 ** n - 1)) / (2 ** n - 1));
    const xyz = [[21, 11], [11, 10], [0, 11]];
    for (let i = 0; i < h.count; i++) {
        const range = (j) => b.readFloatLE(h.start + 72 * (i >> 8) + 4 * j);
        const word = (j) => b.readUInt32LE(vertices + 16 * i + 4 * j);
        const between = (t, j) => range(j) + t * (range(j + 3) - range(j));
        parts(word(0), xyz).forEach((t, c) => { s.pos[c][i] = between(t, c); });
        parts(word(2), xyz).forEach((t, c) => { s.scale[c][i] = Math.exp(between(t, c + 6)); });
        const q = parts(word(1), [[20, 10], [10, 10], [0, 10]]).map((t) => (t - 0.5) * Math.SQRT2);
        q.splice(word(1) >>> 30, 0, Math.sqrt(Math.max(0, 1 - q.reduce((t, v) => t + v * v, 0))));
        q.forEach((v, c) => { s.rot[c][i] = v; });
        const colour = parts(word(3), [[24, 8], [16, 8], [8, 8], [0, 8]]);
        s.alpha[i] = colour.pop();
        colour.forEach((t, c) => { s.sh0[c][i] = (between(t, c + 12) - 0.5) / C0; });
        for (let c = 0; c < 3; c++) for (let j = 0; j < k; j++) {
            const u = b[shs + h.rest * i + c * k + j];
            s.shN[j][c][i] = u === 0 ? -4 : u === 255 ? 4 : (u + 0.5) / 32 - 4;
        }
    }
    return s;
}

// The four components of a rotation in x y z w order, where the largest (version 3) or w (version
// 2) is omitted.
function spzRotation(b, at, version) {
    const q = [0, 0, 0, 0];
    if (version === 2) {
        for (let c = 0; c < 3; c++) q[c] = b[at + c] / 127.5 - 1;
        q[3] = Math.sqrt(Math.max(0, 1 - q[0] ** 2 - q[1] ** 2 - q[2] ** 2));
        return q;
    }
    const v = b.readUInt32LE(at), largest = v >>> 30;
    let rest = 1;
    for (let c = 0, shift = 20; c < 4; c++) {
        if (c === largest) continue;
        const bits = (v >>> shift) & 1023, size = (bits & 511) / 511 * Math.SQRT1_2;
        q[c] = bits & 512 ? -size : size;
        rest -= size * size;
        shift -= 10;
    }
    q[largest] = Math.sqrt(Math.max(0, rest));
    return q;
}

const zstd = new ZSTDDecoder();
await zstd.init();

// Version 4: the 16-byte header of older versions, a table of contents (the next word holds its
// offset: for each non-empty stream its packed and unpacked size), and the streams, each a zstd
// frame. Returns the unpacked contents of a version 3 file.
function unpackSpz4(file, b) {
    const number = (at) => Number(b.readBigUInt64LE(at));
    let at = b.readUInt32LE(16) + 16 * b[15];
    const parts = [Buffer.from(b.subarray(0, 16))];
    for (let i = 0; i < b[15]; i++) {
        const entry = b.readUInt32LE(16) + 16 * i, end = at + number(entry);
        if (end > b.length) throw new Error(`${file}: stream ${i} ends behind the file`);
        parts.push(Buffer.from(zstd.decode(b.subarray(at, end), number(entry + 8))));
        at = end;
    }
    if (at !== b.length) throw new Error(`${file}: ${b.length - at} bytes behind the streams`);
    return Buffer.concat(parts);
}

// gzip of a 16-byte header followed by the streams: positions, alphas, colours, scales, rotations,
// SH.
export function readSpz(file) {
    const packed = fs.readFileSync(file), four = packed.readUInt32LE(0) === 0x5053474e;
    const b = four ? unpackSpz4(file, packed) : zlib.gunzipSync(packed), version = b.readUInt32LE(4), count = b.readUInt32LE(8);
    const bands = b[12], step = 2 ** -b[13], turns = version === 2 ? 3 : 4;
    if (b.readUInt32LE(0) !== 0x5053474e) throw new Error(`${file}: not SPZ`);
    if (four ? version !== 4 : version !== 2 && version !== 3) throw new Error(`${file}: SPZ version ${version}`);
    if (bands > 3 || count < 1) throw new Error(`${file}: ${count} points, SH degree ${bands}`);
    const s = blank(file, packed.length, count, bands), k = s.shN.length;
    const sizes = [9, 1, 3, 3, turns, 3 * k].map((n) => n * count);
    const at = sizes.map((_, i) => 16 + sizes.slice(0, i).reduce((t, n) => t + n, 0));
    if (b.length !== at[5] + sizes[5]) throw new Error(`${file}: ${b.length} bytes unpacked, header promises ${at[5] + sizes[5]}`);
    for (let i = 0; i < count; i++) {
        for (let c = 0; c < 3; c++) {
            s.pos[c][i] = b.readIntLE(at[0] + 9 * i + 3 * c, 3) * step;
            s.sh0[c][i] = (b[at[2] + 3 * i + c] / 255 - 0.5) / 0.15;
            s.scale[c][i] = Math.exp(b[at[3] + 3 * i + c] / 16 - 10);
            for (let j = 0; j < k; j++) s.shN[j][c][i] = (b[at[5] + 3 * (k * i + j) + c] - 128) / 128;
        }
        s.alpha[i] = b[at[1] + i] / 255;
        const q = spzRotation(b, at[4] + turns * i, version);
        [q[3], q[0], q[1], q[2]].forEach((v, c) => { s.rot[c][i] = v; });
    }
    return s;
}

// Options of splat-transform that select the finest level of a streamed SOG.
export const finest = (file) => (file.endsWith('lod-meta.json') ? ['--select-lod', '0'] : []);

// Node cannot decode WebP: the tool of the format's authors converts the file to PLY.
export function readSog(file) {
    const at = createRequire(import.meta.url).resolve('@playcanvas/splat-transform');
    const cli = path.join(path.dirname(at), '../bin/cli.mjs');
    const folder = fs.mkdtempSync(path.join(os.tmpdir(), 'viewer-sog-')), ply = path.join(folder, 'sog.ply');
    try {
        const r = spawnSync(process.execPath, [cli, '-q', ...finest(file), file, ply], { encoding: 'utf8' });
        if (r.status !== 0) throw new Error(`${file}: splat-transform: ${(r.stderr || r.stdout).trim()}`);
        return { ...readPly(ply), file, bytes: fs.statSync(file).size };
    } finally {
        fs.rmSync(folder, { recursive: true });
    }
}
