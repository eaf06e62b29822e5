#!/usr/bin/env node
// readers.mjs BIN_DIR BUNDLE WORK_DIR: exports a clip as USD in three forms and as GLB, reads the
// files with three.js and TinyUSDZ, in Node, and compares every value with the PLY files of the
// frames. TinyUSDZ reads text, crates and packages; three.js GLB and the same USD.
import fs from 'node:fs';
import path from 'node:path';
import { spawnSync } from 'node:child_process';
import { createRequire } from 'node:module';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { USDAParser } from 'three/addons/loaders/usd/USDAParser.js';
import { USDCParser } from 'three/addons/loaders/usd/USDCParser.js';
import { unzipSync } from 'three/addons/libs/fflate.module.js';
import { readPly } from './lib/splat.mjs';

const [bin, bundle, work] = process.argv.slice(2);
const require = createRequire(import.meta.url);
const SH = 'radiance:sphericalHarmonicsCoefficients';
const WIDTHS = { positions: 3, orientations: 4, scales: 3, opacities: 1, [SH]: 3 };
let failed = false;

function exportTo(output, ...options) {
    const to = path.join(work, output), run = spawnSync(path.join(bin, 'spin-export'), ['-q', '--force', '--range', '0:2', bundle, '-o', to, ...options], { encoding: 'utf8' });
    if (run.status !== 0) throw new Error(`${output}: ${run.stderr}`);
    return to;
}
const bufferOf = (bytes) => bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length);

// ---- Readers: frames of { positions, orientations (w x y z), scales, opacities, SH } ------------

function framesOf(valueAt, n) {
    return Array.from({ length: n }, (_, f) => Object.fromEntries(Object.keys(WIDTHS).map((name) => [name, valueAt(name, f)])));
}

// three.js keeps the values of attributes by path, and quaternions as x y z w.
function framesOfThree({ specsByPath }, n) {
    if (specsByPath['/Splats.colorSpace:name']?.fields.default !== 'srgb_rec709_scene') throw new Error('no colour space');
    return framesOf((name, f) => {
        const { timeSamples, default: still } = specsByPath[`/Splats.${name}`].fields;
        if (timeSamples && timeSamples.times.join() !== [...Array(n).keys()].join()) throw new Error(`${name} at times ${timeSamples.times}`);
        const v = timeSamples ? timeSamples.values[f] : still;
        return name === 'orientations' ? Array.from(v, (_, i) => v[i % 4 ? i - 1 : i + 3]) : v;
    }, n);
}

const three = {
    usdc: (bytes, n) => framesOfThree(new USDCParser().parseData(bufferOf(bytes)), n),
    usda: (bytes, n) => framesOfThree(new USDAParser().parseData(bytes.toString()), n),
    usdz: (bytes, n) => framesOfThree(new USDCParser().parseData(bufferOf(Object.values(unzipSync(bytes))[0])), n),
    async glb(bytes, n) {
        const points = [], { scene } = await new GLTFLoader().parseAsync(bufferOf(bytes), '');
        scene.traverse((o) => o.isPoints && points.push(o.geometry.attributes));
        if (points.length !== n) throw new Error(`${points.length} nodes with points`);
        const own = 'khr_gaussian_splatting:', terms = Object.keys(points[0]).filter((k) => k.includes('_coef_')).length;
        return points.map((at) => {
            const value = (name) => at[name].array, q = value(`${own}rotation`);
            const sh = Array.from({ length: terms }, (_, k) => value(`${own}sh_degree_${Math.floor(Math.sqrt(k))}_coef_${k - Math.floor(Math.sqrt(k)) ** 2}`));
            return {
                positions: value('position'), orientations: Array.from(q, (_, i) => q[i % 4 ? i - 1 : i + 3]), scales: value(`${own}scale`), opacities: value(`${own}opacity`),
                [SH]: Array.from({ length: sh[0].length * terms }, (_, i) => sh[Math.floor(i / 3) % terms][3 * Math.floor(i / (3 * terms)) + i % 3])
            };
        });
    }
};

// TinyUSDZ returns a layer as text. Its build is for browsers only.
async function openTinyusdz() {
    process.type = 'renderer';
    globalThis.window = globalThis;
    const wasm = fs.readFileSync(require.resolve('tinyusdz/tinyusdz.wasm')), { default: start } = await import('tinyusdz');
    const { TinyUSDZLoaderNative: Loader } = await start({ instantiateWasm: (imports, done) => { WebAssembly.instantiate(wasm, imports).then((r) => done(r.instance, r.module)); return {}; } });
    const numbers = (text) => text.match(/-?\d[-+.\de]*/g).map(Number);
    return (bytes, n, name) => {
        const loader = new Loader();
        if (!loader.loadAsLayerFromBinary(bytes, name)) throw new Error('refused');
        const text = loader.layerToString();
        if (!text.includes('uniform token colorSpace:name = "srgb_rec709_scene"')) throw new Error('no colour space');
        return framesOf((attribute, f) => {
            const still = text.match(new RegExp(`\\] ${attribute} = \\[(.*)\\]`)), samples = text.match(new RegExp(`\\] ${attribute}\\.timeSamples = \\{\n((?: *\\d+: \\[.*\\],?\n)*)`));
            return numbers(still ? still[1] : samples[1].split('\n').find((line) => line.trim().startsWith(`${f}: `)).replace(/^ *\d+: /, ''));
        }, n);
    };
}

// ---- Comparison ---------------------------------------------------------------------------------

// Returns the largest difference of an attribute of a frame from the PLY, relative to the largest
// value. Rotations are compared up to their sign and length.
function difference(name, got, ply) {
    const rows = { positions: ply.pos, orientations: ply.rot, scales: ply.scale, opacities: [ply.alpha] }[name] ?? [ply.sh0, ...ply.shN].flat();
    let worst = got.length === rows.length * ply.count ? 0 : Infinity, largest = 1e-9;
    for (let i = 0; i < ply.count && worst < Infinity; i++) {
        let want = rows.map((r) => r[i]);
        const has = rows.map((_, c) => got[i * rows.length + c]);
        if (name === 'orientations') {
            const size = Math.hypot(...want), sign = want.reduce((sum, v, c) => sum + v * has[c], 0) < 0 ? -1 : 1;
            want = want.map((v) => sign * v / size);
        }
        want.forEach((v, c) => { worst = Math.max(worst, Number.isFinite(has[c]) ? Math.abs(v - has[c]) : Infinity); largest = Math.max(largest, Math.abs(v)); });
    }
    return worst / largest;
}

async function compare(what, frames, plies) {
    try {
        const read = await frames(), worst = plies.flatMap((ply, f) => Object.keys(WIDTHS).map((name) => [difference(name, read[f][name], ply), name])).sort((a, b) => b[0] - a[0])[0];
        if (!(worst[0] < 1e-6)) throw new Error(`${worst[1]} differ by ${worst[0].toExponential(1)}`);
        console.log(`  ${what}: ${plies.length} frames of ${plies[0].count} splats, largest difference ${worst[0].toExponential(1)}`);
    } catch (e) {
        console.error(`readers: ${what}: ${e.message}`);
        failed = true;
    }
}

fs.mkdirSync(work, { recursive: true });
exportTo('ply', '--to', 'ply');
const plies = fs.readdirSync(path.join(work, 'ply')).filter((n) => n.endsWith('.ply')).sort().map((n) => readPly(path.join(work, 'ply', n)));
const tinyusdz = await openTinyusdz();
for (const form of ['usdc', 'usdz', 'usda', 'glb']) {
    const bytes = fs.readFileSync(exportTo(`clip.${form}`, '--axes', 'source'));
    await compare(`three.js, .${form}`, () => three[form](bytes, plies.length), plies);
    if (form !== 'glb') await compare(`TinyUSDZ, .${form}`, () => tinyusdz(bytes, plies.length, `clip.${form}`), plies);
}
process.exit(failed ? 1 : 0);
