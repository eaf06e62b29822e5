#!/usr/bin/env node
// Opens splat files in real clients. See README.md; 'node bench.mjs --help' for the options.
import fs from 'node:fs';
import os from 'node:os';
import path from 'node:path';
import { spawnSync } from 'node:child_process';
import { createRequire } from 'node:module';
import { parseArgs } from 'node:util';
import { check, checkGlb, meshesAt, readGlb, timesOf } from './lib/splat.mjs';
import { KINDS, kindOf, turned } from './lib/kinds.mjs';
import { finest } from './lib/compact.mjs';
import { render, MODELS } from './lib/reference.mjs';
import { decodePng, encodePng, psnr, drawnShare } from './lib/png.mjs';

const here = path.dirname(new URL(import.meta.url).pathname);
const require = createRequire(import.meta.url);

const DEFAULT_VIEWERS = 'spark,playcanvas,babylon,three';
const ENDS = [...new Set(Object.values(KINDS).map((k) => k.ends))].join(', ');

const HELP = `usage: node bench.mjs [options] FILE | DIR ...
       node bench.mjs [options] selftest
       node bench.mjs --matrix

A FILE ends in ${ENDS}.
A DIR is a sequence: its files of one kind in name order, each shown in turn by every viewer.

  --viewers A,B     viewers to use (${DEFAULT_VIEWERS}); those that cannot open the kind of file are skipped
  --out DIR         screenshots and report.json go here (bench-out)
  --eye X,Y,Z  --target X,Y,Z  --up X,Y,Z  --fovy DEG
                    camera, in the axes of a PLY (x right, y down, z away), turned for a GLB;
                    without --eye it is fitted to the splats
  --size N          picture is N x N pixels (384)
  --bg R,G,B        background, 0..1 (0.1,0.1,0.12)
  --max-frames N    of a sequence, show at most N frames spread over it (8)
  --times A,B,..    seconds: for a GLB that holds a whole sequence, seek to these times
                    (the middles of its frames, at most --max-frames of them)
  --truth FILE|DIR  known-good splats: pictures are held to these, not to the file's own contents
                    (turned as the formats' axes ask)
  --min-psnr DB     least agreement of each picture with the CPU reference (28)
  --known FILE      report.json of the bench on known-good files of the same scene, by the same camera: where even
                    these stay below --min-psnr, what they reached in a viewer, less 0.5 dB, is the limit there
  --calibrate       for such files: --min-psnr only says how long to wait for a picture, it may fall short of it
  --min-drawn P     least share of pixels drawn, percent (0.5)
  --expect-motion   fail if no two frames of a sequence differ
  --no-reference    do not render the CPU reference (it is left out above 600000 Gaussians too)
  --no-tools        skip splat-transform and gltf-validator
  --pages DIR       folder with further viewer pages (its own name must be 'pages')
  --matrix          print which viewer opens what, as a table, from the pages; opens nothing
  --json            print the report as JSON on stdout, and nothing else there
Exit status: 0 all well, 1 something failed, 2 wrong usage or no such file.`;

function pageOf(viewer, pages) {
    const folders = [path.join(here, 'pages'), pages].filter(Boolean);
    return folders.map((d) => path.join(d, `${viewer}.html`)).find((f) => fs.existsSync(f));
}

function usage(why) {
    console.error(`bench: ${why}\n${HELP}`);
    process.exit(2);
}

function options() {
    const text = ['eye', 'target', 'up', 'times', 'truth', 'known', 'pages'];
    const preset = { viewers: DEFAULT_VIEWERS, out: 'bench-out', fovy: '50', size: '384', bg: '0.1,0.1,0.12', 'max-frames': '8', 'min-psnr': '28', 'min-drawn': '0.5' };
    const flags = ['expect-motion', 'calibrate', 'no-reference', 'no-tools', 'matrix', 'json'];
    const table = { help: { type: 'boolean', short: 'h' } };
    text.forEach((k) => { table[k] = { type: 'string' }; });
    flags.forEach((k) => { table[k] = { type: 'boolean' }; });
    Object.entries(preset).forEach(([k, v]) => { table[k] = { type: 'string', default: v }; });
    try {
        const { values, positionals } = parseArgs({ allowPositionals: true, options: table });
        if (values.help) { console.log(HELP); process.exit(0); }
        if (!positionals.length && !values.matrix) throw new Error('no file named');
        for (const v of values.viewers.split(',')) {
            if (!/^[\w-]+$/.test(v) || !pageOf(v, values.pages)) throw new Error(`no viewer '${v}'`);
        }
        return { opt: values, args: positionals };
    } catch (e) {
        return usage(e.message);
    }
}

const { opt, args } = options();
const log = (...a) => (opt.json ? console.error : console.log)(...a);
const vec = (t) => t.split(',').map(Number);

// each viewer's page declares what it opens: <meta name="opens" content="ply glb">
function meta(viewer, name) {
    const page = fs.readFileSync(pageOf(viewer, opt.pages), 'utf8');
    return new RegExp(`<meta name="${name}" content="([^"]*)"`).exec(page)?.[1] ?? '';
}
const opens = (viewer, kind) => meta(viewer, 'opens').split(' ').includes(kind);

const labelOf = (kind) => KINDS[kind].label ?? `\`${KINDS[kind].ends}\``;

function matrix() {
    const viewers = opt.viewers.split(','), locked = require('./package.json').dependencies;
    const version = (v) => `${/<title>(.*)<\/title>/.exec(fs.readFileSync(pageOf(v), 'utf8'))[1]} ${locked[meta(v, 'package')]}`;
    console.log(`| | ${viewers.map(version).join(' | ')} |`);
    console.log(`|---|${viewers.map(() => '---|').join('')}`);
    for (const kind of Object.keys(KINDS)) console.log(`| ${labelOf(kind)} | ${viewers.map((v) => (opens(v, kind) ? 'yes' : '-')).join(' | ')} |`);
    console.log(`| a clip in one \`.glb\` | ${viewers.map((v) => (opens(v, 'glb') ? 'plays' : '-')).join(' | ')} |`);
}
if (opt.matrix) { matrix(); process.exit(0); }

// ---- Inputs -------------------------------------------------------------------------------------

function selftest() {
    const s = fs.mkdtempSync(path.join(os.tmpdir(), 'viewer-sample-'));
    const cam = { eye: [0.9, -0.5, -3.2], target: [0.1, 0, 0], up: [0, -1, 0] };
    const made = spawnSync(process.execPath, [path.join(here, 'sample/make-sample.mjs'), s], { encoding: 'utf8' });
    if (made.status !== 0) throw new Error(`sample: ${made.stderr}`);
    process.on('exit', () => fs.rmSync(s, { recursive: true, force: true }));
    const clip = { times: [0.25, 1.25], motion: true };
    return [
        { name: 'F.ply', kind: 'ply', files: [`${s}/F.ply`], cam },
        { name: 'F-behind', kind: 'ply', files: [`${s}/F.ply`], cam: { ...cam, eye: [-1.5, -1, 2.6] } },
        { name: 'seq', kind: 'ply', files: fs.readdirSync(`${s}/seq`).sort().map((f) => `${s}/seq/${f}`), cam, motion: true },
        { name: 'F.glb', kind: 'glb', files: [`${s}/F.glb`], cam },
        { name: 'seq-scale.glb', kind: 'glb', files: [`${s}/seq-scale.glb`], cam, ...clip },
        { name: 'seq-visibility.glb', kind: 'glb', files: [`${s}/seq-visibility.glb`], cam, ...clip, only: ['babylon'] }
    ];
}

function jobsOf(arg) {
    if (arg === 'selftest') return selftest();
    if (!fs.existsSync(arg)) { console.error(`bench: ${arg}: no such file or folder`); process.exit(2); }
    const cam = opt.eye && { eye: vec(opt.eye), target: vec(opt.target ?? '0,0,0'), up: vec(opt.up ?? '0,-1,0') };
    const name = path.basename(path.resolve(arg)), motion = opt['expect-motion'];
    if (fs.statSync(arg).isDirectory()) {
        const inside = fs.readdirSync(arg).sort(), kind = Object.keys(KINDS).find((k) => inside.some((f) => kindOf(path.join(arg, f)) === k));
        if (!kind) { console.error(`bench: ${arg}: holds none of ${ENDS}`); process.exit(2); }
        const all = inside.filter((f) => kindOf(path.join(arg, f)) === kind), n = Math.min(Number(opt['max-frames']), all.length);
        const pick = [...new Set(Array.from({ length: n }, (_, i) => Math.round(i * (all.length - 1) / Math.max(1, n - 1))))];
        return [{ name, kind, files: pick.map((i) => path.join(arg, all[i])), pick, total: all.length, cam, motion }];
    }
    const kind = kindOf(arg);
    if (!kind) { console.error(`bench: ${arg}: none of ${ENDS}`); process.exit(2); }
    const own = kind === 'glb' ? timesOf(arg, Number(opt['max-frames'])) : [];
    return [{ name, kind, files: [arg], cam, times: opt.times ? vec(opt.times) : own.length ? own : undefined, motion }];
}

// A camera in front of most of the splats, in the axes of a PLY.
function fit(s, kind) {
    const turn = KINDS[kind].turn, q = (a, p) => Float32Array.from(a).sort()[Math.floor(p * (a.length - 1))];
    const a = turn(s.pos.map((c) => q(c, 0.03))), b = turn(s.pos.map((c) => q(c, 0.97)));
    const lo = a.map((v, i) => Math.min(v, b[i])), hi = a.map((v, i) => Math.max(v, b[i]));
    const mid = lo.map((v, i) => (v + hi[i]) / 2), r = Math.max(...lo.map((v, i) => hi[i] - v), 1e-3) / 2;
    const away = r / Math.tan(Number(opt.fovy) * Math.PI / 360) + (hi[2] - lo[2]) / 2 + 0.3 * r;
    return { eye: [mid[0], mid[1], mid[2] - away], target: mid, up: [0, -1, 0] };
}

// Merges several meshes that are visible at once into one cloud.
function join(list) {
    if (list.length === 1) return list[0];
    const all = (f) => list.flatMap((s) => [...f(s)]);
    const columns = (k, n) => Array.from({ length: n }, (_, c) => all((s) => s[k][c]));
    return {
        count: list.reduce((n, s) => n + s.count, 0), bands: Math.min(3, ...list.map((s) => s.bands)),
        pos: columns('pos', 3), rot: columns('rot', 4), scale: columns('scale', 3), sh0: columns('sh0', 3), alpha: all((s) => s.alpha),
        shN: (list[0]?.shN ?? []).map((v, j) => v.map((_, c) => all((s) => s.shN[j][c])))
    };
}

// ---- Checks by other programs -------------------------------------------------------------------

// splat-transform reads the file: it must count as many splats as we do, find no NaN or infinity,
// and recognise splat data. An opacity of exactly 1, stored as byte 255, is an infinite logit there
// and not a fault.
function splatTransform(file, count, kind) {
    const cli = path.join(path.dirname(require.resolve('@playcanvas/splat-transform')), '../bin/cli.mjs');
    const t0 = Date.now(), r = spawnSync(process.execPath, [cli, '-q', ...finest(file), file, '--stats', 'json', 'null'], { encoding: 'utf8', maxBuffer: 1 << 28 });
    const problems = [];
    if (r.status !== 0) return { problems: [`splat-transform: exit ${r.status}: ${(r.stderr || r.stdout).trim().split('\n').slice(-2).join(' ')}`] };
    const j = JSON.parse(r.stdout);
    const lod = j.lods?.[0] ?? {}, n = j.count ?? j.numGaussians ?? lod.count ?? j.gaussians;
    if (j.gaussian === false) problems.push('splat-transform: does not take this for splat data');
    if (n !== undefined && n !== count) problems.push(`splat-transform: counts ${n} Gaussians, the file has ${count}`);
    for (const { columns, data } of j.stats ?? []) for (const k of ['nanCount', 'infCount']) {
        const named = columns.filter((c, i) => data[k]?.[i] > 0 && !(k === 'infCount' && c === 'opacity' && kind !== 'ply'));
        if (named.length) problems.push(`splat-transform: ${k} of ${named.join(', ')} is not 0`);
    }
    return { problems, ms: Date.now() - t0, stats: j };
}

// gltf-validator 2.0.0-dev.3.10 does not know KHR_gaussian_splatting and rejects its attribute
// names (KhronosGroup/glTF-Validator issue 252): these findings are dropped, and lib/splat.mjs
// checks the extension instead.
async function gltfValidator(file) {
    const r = await require('gltf-validator').validateBytes(new Uint8Array(fs.readFileSync(file)), { maxIssues: 100000 });
    const seen = {}, problems = [];
    for (const m of r.issues.messages) {
        seen[m.code] = (seen[m.code] ?? 0) + 1;
        if (m.code === 'MESH_PRIMITIVE_INVALID_ATTRIBUTE' && /KHR_gaussian_splatting:(ROTATION|SCALE|OPACITY|SH_DEGREE_[0-3]_COEF_[0-6])$/.test(m.pointer)) continue;
        if (m.severity === 0) problems.push(`gltf-validator: ${m.code} ${m.message} (${m.pointer ?? ''})`);
    }
    return { problems: [...new Set(problems)].slice(0, 12), seen, errors: r.issues.numErrors, warnings: r.issues.numWarnings };
}

// ---- One job ------------------------------------------------------------------------------------

let failed = 0;

// Reads the files, renders them, and runs the other programs on them.
async function readFiles(job, entry, fail) {
    const clouds = [];
    for (const f of job.files) {
        const name = path.basename(f);
        try {
            const s = KINDS[job.kind].read(f), [bad, note] = check(s);
            if (job.kind === 'glb') bad.push(...checkGlb(f));
            bad.forEach((t) => fail(`${name}: ${t}`));
            note.forEach((t) => log(`  note ${name}: ${t}`));
            clouds.push(s);
            const row = { file: name, bytes: s.bytes, gaussians: s.count, bands: s.bands, note };
            entry.files.push(row);
            if (!opt['no-tools']) {
                const t = KINDS[job.kind].tool ? splatTransform(f, s.count, job.kind) : await gltfValidator(f);
                t.problems.forEach((p) => fail(`${name}: ${p}`));
                row[KINDS[job.kind].tool ? 'splatTransform' : 'gltfValidator'] = t.stats ?? t.seen;
            }
            log(`  ${name}: ${s.count} Gaussians, SH ${s.bands}, ${s.bytes} bytes`);
        } catch (e) { fail(e.message); }
    }
    return clouds;
}

// The splats that the images are compared with, and the axes they are in.
function wantedOf(job, clouds) {
    if (!opt.truth) {
        const shown = (t) => join(meshesAt(job.files[0], t).map((m) => readGlb(job.files[0], { mesh: m })));
        return { wanted: job.times ? job.times.map(shown) : clouds, kind: job.kind };
    }
    const folder = fs.statSync(opt.truth).isDirectory();
    const names = folder ? fs.readdirSync(opt.truth).sort().map((f) => path.join(opt.truth, f)).filter(kindOf) : [opt.truth];
    const wanted = (job.times ?? job.files).map((_, i) => {
        const f = names[folder ? job.pick?.[i] ?? i : 0];
        if (!f) throw new Error(`${opt.truth}: holds fewer frames than ${job.name}`);
        return KINDS[kindOf(f)].read(f);
    });
    return { wanted, kind: kindOf(names[0]) };
}

// The PSNR that a viewer's image of this kind of file must reach.
const known = opt.known ? JSON.parse(fs.readFileSync(opt.known, 'utf8')).jobs : [];
function limitOf(kind, viewer) {
    const rows = known.filter((j) => j.kind === kind).flatMap((j) => j.viewers).filter((v) => v.viewer === viewer);
    return Math.min(Number(opt['min-psnr']), Math.min(...rows.flatMap((v) => v.psnr)) - 0.5);
}

// The best of three ways to widen small splats counts; the other two are tried only below 38 dB.
function agreement(shot, reference) {
    let best = [-1];
    for (const m of Object.keys(MODELS)) {
        if (best[0] >= 38) break;
        const p = psnr(shot, reference(m));
        if (p > best[0]) best = [p, m];
    }
    return best;
}

function judge(row, job, shots) {
    row.moved = shots.slice(1).some((s, i) => psnr(s, shots[i]) < 45);
    if (row.drawn.some((d) => d < Number(opt['min-drawn']))) row.problems.push(`almost nothing drawn (${row.drawn.join(', ')} % of the picture)`);
    row.limit = +limitOf(job.kind, row.viewer).toFixed(1);
    if (!opt.calibrate && row.psnr.some((p) => p < row.limit)) row.problems.push(`differs from the reference (${row.psnr.join(', ')} dB, limit ${row.limit})`);
    if (job.motion && shots.length > 1 && !row.moved) row.problems.push('all frames look the same');
    if (job.motion && shots.length < 2) row.problems.push('one frame only: nothing can move');
}

async function run(job, report, server, chrome) {
    const entry = { name: job.name, kind: job.kind, files: [], viewers: [] };
    const fail = (t) => { failed++; (entry.problems ??= []).push(t); log(`  FAIL ${t}`); };
    log(`${job.name}: ${job.files.length} file(s)${job.total > job.files.length ? ` of ${job.total}` : ''}, ${job.kind}`);
    report.jobs.push(entry);
    const clouds = await readFiles(job, entry, fail);
    if (clouds.length !== job.files.length) return;
    const frame = { fovy: Number(opt.fovy), width: Number(opt.size), height: Number(opt.size), bg: vec(opt.bg) };
    const cam = { ...frame, ...(job.cam ?? fit(clouds[0], job.kind)) }, view = turned(cam, job.kind);
    entry.camera = cam;
    const stem = (v, i) => path.join(opt.out, `${job.name.replace(/[^\w.-]/g, '_')}-${job.kind}-${String(i).padStart(3, '0')}-${v}.png`);
    const refs = [];
    if (!opt['no-reference']) {
        const { wanted, kind } = wantedOf(job, clouds);
        wanted.forEach((s, i) => {
            if (s.count > 600000) return;
            const made = {};
            refs[i] = (m) => (made[m] ??= render(s, turned(cam, kind), m));
            fs.writeFileSync(stem('reference', i), encodePng(refs[i]('plain')));
        });
    }
    for (const v of opt.viewers.split(',')) {
        if (!opens(v, job.kind)) { log(`  ${v}: skipped, opens no ${labelOf(job.kind)}`); continue; }
        if (job.only && !job.only.includes(v)) { log(`  ${v}: skipped, known not to play this (README)`); continue; }
        const good = (i, png) => !refs[i] || agreement(decodePng(png), refs[i])[0] >= limitOf(job.kind, v);
        const r = await show(chrome.context, server.base, v, { kind: job.kind, urls: job.files.map(server.url), cam: view, times: job.times }, good);
        const row = { viewer: v, ms: r.ms, info: r.info, drawn: [], psnr: [], problems: r.problems };
        entry.viewers.push(row);
        const shots = r.frames.map(decodePng);
        shots.forEach((s, i) => {
            fs.writeFileSync(stem(v, i), encodePng(s));
            row.drawn.push(+(100 * drawnShare(s, cam.bg)).toFixed(2));
            if (!refs[i]) return;
            const [dB, model] = agreement(s, refs[i]);
            row.psnr.push(+dB.toFixed(1));
            row.widening = model;
        });
        judge(row, job, shots);
        failed += row.problems.length;
        log(`  ${row.problems.length ? 'FAIL' : 'ok  '} ${v}: drawn ${row.drawn.join(' ')} %${row.psnr.length ? `, reference (${row.widening}) ${row.psnr.join(' ')} dB${row.limit < Number(opt['min-psnr']) ? ` (limit ${row.limit})` : ''}` : ''}, ${(r.ms / 1000).toFixed(1)} s ${JSON.stringify(r.info ?? {})}`);
        row.problems.forEach((p) => log(`       ${p}`));
    }
}

const { serve } = await import('./lib/server.mjs');
const { launch, show } = await import('./lib/chrome.mjs');
const pages = opt.pages && path.resolve(opt.pages);
const jobs = args.flatMap(jobsOf);
const server = await serve([here, ...(pages ? [path.dirname(pages)] : [])]);
const chrome = await launch();
const report = { started: new Date().toISOString(), jobs: [] };
fs.mkdirSync(opt.out, { recursive: true });
try {
    for (const job of jobs) await run(job, report, server, chrome);
} finally {
    await chrome.close();
    server.close();
}
report.failed = failed;
fs.writeFileSync(path.join(opt.out, 'report.json'), JSON.stringify(report, null, 1));
if (opt.json) console.log(JSON.stringify(report, null, 1));

const views = report.jobs.flatMap((j) => j.viewers);
const bad = views.filter((v) => v.problems.length).length + report.jobs.filter((j) => j.problems).length;
log(`${views.filter((v) => !v.problems.length).length} passed, ${bad} failed`);
process.exit(failed ? 1 : 0);
