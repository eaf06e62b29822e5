// make-sample.mjs [DIR]: writes the samples into DIR, or beside this script. A lopsided letter F in
// the usual PLY axes (x right, y down, z forward), each part of which exposes one kind of mistake:
//   red stem, green top bar, blue middle bar  - axis flips and mirroring, channel order
//   yellow fan of needles                     - quaternion order (wxyz) and sign, scale order
//   magenta ball in front of a cyan plate     - depth order and the sign of z
//   patch right of the stem                   - SH band 1..3: white from the front, see README
import path from 'node:path';
import { writePly, writeGlb, toGltf } from '../lib/write.mjs';

const here = process.argv[2] ?? import.meta.dirname;
let seed = 12345;
const rnd = () => { seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0; return seed / 2 ** 32; };
const sh0 = (rgb) => rgb.map((v) => (v - 0.5) / 0.28209479177387814);
const axisAngle = (x, y, z, deg) => { const h = deg * Math.PI / 360, n = Math.hypot(x, y, z), s = Math.sin(h) / n; return [Math.cos(h), x * s, y * s, z * s]; };
const mul = (a, b) => [a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3], a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2], a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1], a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]];

export function letter(t = 0) {
    const g = [], move = [0.5 * t, -0.25 * t, 0.2 * t];
    const box = (n, lo, hi, rgb, extra = {}) => {
        for (let i = 0; i < n; i++) g.push({ pos: lo.map((v, c) => v + rnd() * (hi[c] - v)), sh0: sh0(rgb), alpha: 0.9, scale: [0.035, 0.03, 0.025], rot: axisAngle(rnd() - 0.5, rnd() - 0.5, rnd() - 0.5, 360 * rnd()), ...extra });
    };
    box(520, [-0.85, -1, -0.05], [-0.55, 1, 0.05], [0.9, 0.1, 0.1]);
    box(320, [-0.55, -1, -0.05], [0.75, -0.72, 0.05], [0.1, 0.75, 0.15]);
    box(200, [-0.55, -0.2, -0.05], [0.3, 0.05, 0.05], [0.1, 0.2, 0.9]);
    box(260, [0.15, 0.35, 0.9], [1.05, 1.0, 0.95], [0.1, 0.8, 0.85]);
    for (let i = 0; i < 160; i++) {
        const u = rnd() * 2 - 1, a = rnd() * 2 * Math.PI, r = 0.2 * Math.cbrt(rnd()), h = Math.sqrt(1 - u * u);
        g.push({ pos: [0.3 + r * h * Math.cos(a) + move[0], 0.45 + r * h * Math.sin(a) + move[1], -0.6 + r * u + move[2]], sh0: sh0([0.85, 0.1, 0.8]), alpha: 0.9, scale: [0.03, 0.03, 0.03], rot: [1, 0, 0, 0] });
    }
    // needles: one Gaussian each, a fan of spokes (long axis x, y, z in turn) and one out of the
    // image plane
    const needle = (pos, scale, rot) => g.push({ pos, sh0: sh0([0.95, 0.85, 0.1]), alpha: 0.98, scale, rot });
    for (let i = 0; i < 15; i++) {
        const deg = -70 + 18 * i, c = Math.cos(deg * Math.PI / 180), s = Math.sin(deg * Math.PI / 180), at = [0.62 + 0.24 * c, -0.3 + 0.24 * s, 0.02 * i - 0.15];
        const turn = axisAngle(0, 0, 1, deg);
        if (i % 3 === 0) needle(at, [0.11, 0.018, 0.012], turn);
        if (i % 3 === 1) needle(at, [0.012, 0.11, 0.018], mul(turn, axisAngle(0, 0, 1, -90)));
        if (i % 3 === 2) needle(at, [0.018, 0.012, 0.11], mul(turn, axisAngle(0, 1, 0, 90)));
    }
    needle([0.75, 0.2, 0], [0.02, 0.03, 0.3], mul(axisAngle(0, 1, 0, 60), axisAngle(1, 0, 0, 25)));
    // view-dependent patch: +band 1 in z and x, band 2 in xz, band 3 in z(2zz-3xx-3yy); grey
    // without SH
    const shN = Array.from({ length: 15 }, () => [0, 0, 0]);
    shN[1] = [0.5, 0.2, 0.35];
    shN[2] = [0.5, 0, -0.5];
    shN[5] = [0.1, 0.25, 0.05];
    shN[6] = [0, -0.4, 0.3];
    shN[11] = [0.2, 0.1, 0.3];
    box(240, [-0.45, 0.3, -0.05], [0.0, 0.95, 0.05], [0.35, 0.35, 0.35], { shN });
    return g;
}

if (process.argv[1] && path.resolve(process.argv[1]) === path.resolve(new URL(import.meta.url).pathname)) {
    const F = letter(), frames = [0, 1, 2, 3].map((t) => { seed = 12345; return letter(t * 0.5); });
    writePly(`${here}/F.ply`, F, 3);
    writeGlb(`${here}/F.glb`, [F.map(toGltf)], 3);
    const { mkdirSync } = await import('node:fs');
    mkdirSync(`${here}/seq`, { recursive: true });
    frames.forEach((f, i) => writePly(`${here}/seq/frame_${String(i).padStart(5, '0')}.ply`, f, 0));
    for (const how of ['scale', 'visibility']) writeGlb(`${here}/seq-${how}.glb`, frames.map((f) => f.map(toGltf)), 0, { how, fps: 2 });
}
