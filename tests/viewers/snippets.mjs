#!/usr/bin/env node
// Runs the pages beside docs/how-to/viewers.md unchanged: each must show a frame of the clip as the
// reference does, and then another frame. Their network requests are answered from the packages of
// this bench, in the same versions.
import fs from 'node:fs';
import path from 'node:path';
import { launch } from './lib/chrome.mjs';
import { decodePng, encodePng, psnr } from './lib/png.mjs';
import { MODELS, render } from './lib/reference.mjs';
import { serve } from './lib/server.mjs';
import { readPly } from './lib/splat.mjs';

const HELP = `usage: node snippets.mjs SAMPLE_DIR OUT_DIR
SAMPLE_DIR has clip.glb, sog/ and ply/ of court-mini, whose camera the pages have.
Exit status: 0 all well, 1 something failed, 2 wrong usage.`;
const [sample, out] = process.argv.slice(2), WAIT = 90000, LEAST = 28;
if (!out || process.argv.length > 4 || !fs.existsSync(sample)) { console.error(HELP); process.exit(2); }
const here = path.dirname(new URL(import.meta.url).pathname), versions = JSON.parse(fs.readFileSync(path.join(here, 'package.json'), 'utf8')).dependencies;

const site = path.join(out, 'snippets');
fs.rmSync(site, { recursive: true, force: true });
fs.mkdirSync(site, { recursive: true });
fs.symlinkSync(path.resolve(sample, 'clip.glb'), path.join(site, 'clip.glb'));
fs.symlinkSync(path.resolve(sample, 'sog'), path.join(site, 'frames'));
const size = 256, cam = { eye: [2.84, -1.44, 0], target: [0, -0.95, 0], up: [0, -1, 0], fovy: 41, width: size, height: size, bg: [0, 0, 0] };
const plys = fs.readdirSync(path.join(sample, 'ply')).filter((f) => f.endsWith('.ply')).sort().map((f) => readPly(path.join(sample, 'ply', f)));
const truth = plys.flatMap((s, frame) => Object.keys(MODELS).map((model) => ({ frame, picture: render(s, cam, model) })));
const best = (shot) => truth.map(({ frame, picture }) => ({ frame, dB: psnr(shot, picture) })).reduce((a, b) => (b.dB > a.dB ? b : a));

// https://cdn.jsdelivr.net/npm/NAME@VERSION/FILE
function fromPackages(route, problems) {
    const [, name, version, file] = /\/npm\/((?:@[^/]+\/)?[^@/]+)@([^/]+)\/(.*)$/.exec(new URL(route.request().url()).pathname) ?? [], at = path.join(here, 'node_modules', name ?? '', file ?? '');
    if (versions[name] === version && fs.existsSync(at)) return route.fulfill({ path: at, headers: { 'access-control-allow-origin': '*' } });
    problems.push(`no ${route.request().url()} in this bench`);
    return route.abort();
}

// The frames shown, and the errors.
async function watch(chrome, base, name) {
    const tab = await chrome.context.newPage(), problems = [], seen = new Map();
    tab.on('console', (m) => { if (m.type() === 'error') problems.push(`console: ${m.text()}`); });
    tab.on('pageerror', (e) => problems.push(`exception: ${e.message}`));
    await tab.route('https://cdn.jsdelivr.net/**', (route) => fromPackages(route, problems));
    await tab.setViewportSize({ width: size, height: size });
    await tab.goto(`${base}/${name}.html`);
    for (const end = Date.now() + WAIT; Date.now() < end && seen.size < 2 && !problems.length; await tab.waitForTimeout(100)) {
        const shot = decodePng(await tab.screenshot({ timeout: WAIT })), { frame, dB } = best(shot);
        fs.writeFileSync(path.join(out, `snippet-${name}.png`), encodePng(shot));
        if (dB >= LEAST) seen.set(frame, Math.max(dB, seen.get(frame) ?? 0));
    }
    await tab.close();
    return { seen: [...seen], problems };
}

const chrome = await launch(), server = await serve([site]);
let failed = 0;
for (const name of ['three', 'playcanvas', 'babylon', 'spark']) {
    fs.copyFileSync(path.join(here, '../../docs/how-to', `${name}.html`), path.join(site, `${name}.html`));
    const { seen, problems } = await watch(chrome, server.base, name), good = seen.length > 1 && !problems.length;
    if (!good) failed++;
    console.log(`  ${good ? 'ok  ' : 'FAIL'} ${name}: ${[...seen.map(([frame, dB]) => `frame ${frame} at ${dB.toFixed(1)} dB`), ...problems].join(', ') || 'no frame of the clip'}`);
}
await chrome.close();
server.close();
process.exit(failed ? 1 : 0);
