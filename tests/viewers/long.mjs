#!/usr/bin/env node
// Plays a clip in Chromium for minutes and logs the memory that it needs, after forced garbage
// collections. Also measures how many bytes are sent before the first image, and how many requests
// a seek needs.
import fs from 'node:fs';
import path from 'node:path';
import { parseArgs } from 'node:util';
import { launch } from './lib/chrome.mjs';
import { serve } from './lib/server.mjs';

const HELP = `usage: node long.mjs [options] PAGE.html|CLIP.sogst
  --player DIR    player for CLIP.sogst (build/release/player)
  --seconds S     how long to play (130)
  --every S       seconds from one line of the table to the next (20)
  --speed X       of the clip (1)
  --rate KB       kilobytes a second that the server sends (no limit)
  --whole         the server ignores ranges
  --first MB      fail if more than this is sent before the first image
  --seeks N       seek to N frames of the paused clip (0)
  --requests N    fail if a seek needs more than N requests (1)
  --most MB       fail if JavaScript and its buffers need more than this
  --grows MB      fail if JavaScript's or the GPU process's memory grows by more than this after the
                  first loop of the clip
Exit status: 0 all well, 1 something failed, 2 wrong usage.`;
let opt, args;
try {
    ({ values: opt, positionals: args } = parseArgs({ allowPositionals: true, options: { player: { type: 'string', default: 'build/release/player' }, seconds: { type: 'string', default: '130' }, every: { type: 'string', default: '20' }, speed: { type: 'string', default: '1' }, rate: { type: 'string', default: '0' }, whole: { type: 'boolean' }, first: { type: 'string' }, seeks: { type: 'string', default: '0' }, requests: { type: 'string', default: '1' }, grows: { type: 'string' }, most: { type: 'string' }, help: { type: 'boolean', short: 'h' } } }));
    if (opt.help) { console.log(HELP); process.exit(0); }
    if (args.length !== 1 || !fs.existsSync(args[0])) throw new Error('name one clip');
} catch (e) {
    console.error(`long: ${e.message}\n${HELP}`);
    process.exit(2);
}

const LONG = 600000, folder = path.resolve(path.dirname(args[0])), name = path.basename(args[0]), mb = (n) => (n / 1e6).toFixed(1);
let failed = 0;
const ok = (good, what) => { if (!good) failed++; console.log(`  ${good ? 'ok  ' : 'FAIL'} ${what}`); };

// Returns the resident memory of the browser's processes of one type, without files, in bytes.
function residentOf(type) {
    const about = (pid, file) => { try { return fs.readFileSync(`/proc/${pid}/${file}`, 'utf8'); } catch { return ''; } };
    const parent = new Map(fs.readdirSync('/proc').filter((d) => /^\d+$/.test(d)).map((pid) => [pid, about(pid, 'stat').replace(/.*\) \S+ /s, '').split(' ')[0]]));
    const isOurs = (pid) => { for (let p = pid; parent.has(p); p = parent.get(p)) if (p === String(process.pid)) return true; return false; };
    return [...parent.keys()].filter((pid) => isOurs(pid) && about(pid, 'cmdline').includes(`--type=${type}`)).map((pid) => 1024 * Number(/RssAnon:\s*(\d+)/.exec(about(pid, 'status'))?.[1] ?? 0)).reduce((a, b) => a + b, 0);
}

// During a seek, only the first --requests requests are answered: later ones wait until the frame
// is shown.
const seek = { asked: 0, shown: null, done: null };
async function gate(p) {
    if (seek.shown && !p.endsWith('.html') && ++seek.asked > Number(opt.requests)) await seek.shown;
}

// Cross-origin isolation lets the page measure the memory of its worker as well.
const isolated = { 'cross-origin-opener-policy': 'same-origin', 'cross-origin-embedder-policy': 'require-corp' };
const chrome = await launch(['--js-flags=--expose-gc', '--enable-blink-features=ForceEagerMeasureMemory']), server = await serve([folder, path.resolve(opt.player)], gate, { headers: isolated, rate: 1000 * Number(opt.rate), whole: opt.whole });
const tab = await chrome.context.newPage(), problems = [];
tab.on('pageerror', (e) => problems.push(e.message));
tab.on('console', (m) => { if (m.type() === 'error') problems.push(m.text()); });

async function memory() {
    for (const w of tab.workers()) await w.evaluate(() => globalThis.gc());
    return tab.evaluate(async () => { globalThis.gc(); return (await performance.measureUserAgentSpecificMemory()).bytes; });
}

try {
    await tab.setViewportSize({ width: 320, height: 200 });
    const t0 = Date.now();
    await tab.goto(name.endsWith('.sogst') ? `${server.base}/view.html?src=${encodeURIComponent(name)}&frame=1` : `${server.base}/${encodeURIComponent(name)}?frame=1`, { timeout: LONG });
    await tab.waitForFunction(() => document.documentElement.dataset.shown, null, { timeout: LONG });
    const first = server.sent(), t1 = (Date.now() - t0) / 1000, n = await tab.evaluate(() => window.spin4d.state.frames), fps = await tab.evaluate(() => window.spin4d.clip.fps);
    ok(!opt.first || first <= 1e6 * Number(opt.first), `${name}: ${n} frames, the first image after ${t1.toFixed(2)} s and ${mb(first)} MB in ${server.requests()} requests`);
    await tab.waitForFunction(() => document.documentElement.dataset.draft === 'no', null, { timeout: LONG });
    await tab.waitForTimeout(1000);
    for (let k = 0; k < Number(opt.seeks); k++) {
        const frame = 1 + Math.floor(n * ((k + 0.5) * 0.618 % 1)), t2 = Date.now(), sent = server.sent();
        Object.assign(seek, { asked: 0, shown: new Promise((done) => { seek.done = done; }) });
        await tab.evaluate((f) => { window.spin4d.set({ frame: f }); }, frame);
        const shown = await tab.waitForFunction((f) => document.documentElement.dataset.shown.endsWith(` ${window.spin4d.clip.numbers[f - 1]}`), frame, { timeout: 20000 }).then(() => true, () => false);
        ok(shown, `seeks to frame ${frame} by ${shown ? 'at most' : 'more than'} ${opt.requests} requests, ${mb(server.sent() - sent)} MB, ${Date.now() - t2} ms`);
        seek.shown = null;
        seek.done();
        await tab.waitForTimeout(1500);
    }
    if (Number(opt.seconds) > 0) {
        console.log('| played s | frame | JS and buffers MB | renderer MB | GPU process MB | requests | sent MB |\n|---|---|---|---|---|---|---|');
        const lines = [], loop = n / fps / Number(opt.speed);
        await tab.evaluate((speed) => window.spin4d.set({ play: true, speed, frame: 1 }), Number(opt.speed));
        const from = Date.now(), played = () => (Date.now() - from) / 1000;
        for (let at = 0; ; at += Number(opt.every)) {
            await tab.waitForTimeout(Math.max(0, 1000 * (at - played())));
            const line = [played(), await tab.evaluate(() => Math.floor(window.spin4d.state.frame)), await memory(), residentOf('renderer'), residentOf('gpu-process'), server.requests(), server.sent()];
            lines.push(line);
            console.log(`| ${line[0].toFixed(0)} | ${line[1]} | ${line.slice(2, 5).map(mb).join(' | ')} | ${line[5]} | ${mb(line[6])} |`);
            if (played() >= Number(opt.seconds)) break;
        }
        const highest = Math.max(...lines.map((l) => l[2]));
        ok(!opt.most || highest <= 1e6 * Number(opt.most), `JavaScript and its buffers need at most ${mb(highest)} MB`);
        const after = lines.filter((l) => l[0] >= loop), by = (k) => (after.length > 1 ? Math.max(...after.map((l) => l[k])) - after[0][k] : NaN);
        // A debugged Chromium keeps responses in the renderer, so only the other two count.
        ok(!opt.grows || [2, 4].every((k) => by(k) <= 1e6 * Number(opt.grows)), `after the first loop, of ${loop.toFixed(0)} s, it grows by ${[2, 3, 4].map((k) => mb(by(k))).join(', ')} MB`);
    }
} catch (e) {
    ok(false, e.message.split('\n')[0]);
} finally {
    await chrome.close();
    server.close();
}
[...new Set(problems)].forEach((p) => ok(false, p));
process.exit(failed ? 1 : 0);
