#!/usr/bin/env node
// Opens an exported page from the disk in Chromium and uses it as a person would: plays, scrubs,
// switches between before and after, rotates, zooms. Every step must change the image; no error may
// be logged, and no network request made, except that a page of --split, which is served, may
// request its own two files. No control may be cut off at any window size. With --truth the first
// image is compared with the PLYs of the clip.
import fs from 'node:fs';
import path from 'node:path';
import { pathToFileURL } from 'node:url';
import { parseArgs } from 'node:util';
import { launch } from './lib/chrome.mjs';
import { decodePng, drawnShare, encodePng, psnr } from './lib/png.mjs';
import { render } from './lib/reference.mjs';
import { serve } from './lib/server.mjs';
import { readPly } from './lib/splat.mjs';

const HELP = `usage: node page.mjs [options] PAGE.html
  --out DIR         screenshots go here (bench-out)
  --truth DIR       the clip as PLY frames, of the version that the page shows first
  --min-psnr DB     least agreement with the truth (28)
  --size W,H        of the window (640,400)
  --first-share P   of a page of --split: the most of its data, in percent, before the first picture (10), or 16 kB
  --picture-only    look at the first picture and do no more
Exit status: 0 all well, 1 something failed, 2 wrong usage.`;

let opt, args;
try {
    ({ values: opt, positionals: args } = parseArgs({ allowPositionals: true, options: { out: { type: 'string', default: 'bench-out' }, truth: { type: 'string' }, 'min-psnr': { type: 'string', default: '28' }, size: { type: 'string', default: '640,400' }, 'first-share': { type: 'string', default: '10' }, 'picture-only': { type: 'boolean' }, help: { type: 'boolean', short: 'h' } } }));
    if (opt.help) { console.log(HELP); process.exit(0); }
    if (args.length !== 1) throw new Error('name one page');
} catch (e) {
    console.error(`page: ${e.message}\n${HELP}`);
    process.exit(2);
}

const [width, height] = opt.size.split(',').map(Number), LONG = 60000;
const stem = path.join(opt.out, path.basename(args[0], '.html'));
fs.mkdirSync(opt.out, { recursive: true });
let failed = 0, passed = 0;
function ok(good, what) {
    if (good) passed++;
    else failed++;
    console.log(`  ${good ? 'ok  ' : 'FAIL'} ${what}`);
    return good;
}

const chrome = await launch(), tab = await chrome.context.newPage(), problems = [];
await tab.emulateMedia({ reducedMotion: 'reduce' }); // or it plays by itself
tab.on('console', (m) => { if (['error', 'warning'].includes(m.type())) problems.push(`console: ${m.text()}`); });
tab.on('pageerror', (e) => problems.push(`exception: ${e.message}`));
const folder = path.resolve(path.dirname(args[0])), data = `${path.basename(args[0], '.html')}.bin`;
// Only one response with a served page's data is sent before the first image is shown.
let asked = 0, firstRead = 0, goOn;
const pictureIsThere = new Promise((ok) => { goOn = ok; });
const ask = async (p) => { if (p.endsWith('.bin') && ++asked > 1) await pictureIsThere; };
const split = fs.existsSync(path.join(folder, data)), server = split ? await serve([folder], ask) : null;
tab.on('response', (r) => { if (r.url().endsWith('.bin') && !firstRead) firstRead = Number(r.headers()['content-length'] ?? 0); });
tab.on('request', (r) => { if (!/^(file|blob|data):/.test(r.url()) && !(split && r.url().startsWith(server.base))) problems.push(`asked a network for ${r.url()}`); });

const shown = () => tab.evaluate(() => document.documentElement.dataset.shown);
const draws = () => tab.evaluate(() => Number(document.documentElement.dataset.draws || 0));
const until = (test, arg) => tab.waitForFunction(test, arg, { timeout: LONG });
// An image of the canvas alone, after the latest request has been drawn.
async function picture(name) {
    await tab.waitForTimeout(400);
    const shot = decodePng(await tab.locator('#view').screenshot({ style: '#bar, #message, #title, #wipe { display: none }' }));
    fs.writeFileSync(`${stem}-${name}.png`, encodePng(shot));
    return shot;
}
const differ = (a, b) => psnr(a, b) < 45;

// The page's own camera, for the reference.
function held(shot, cam) {
    const files = fs.readdirSync(opt.truth).filter((f) => f.endsWith('.ply')).sort(), s = readPly(path.join(opt.truth, files[0]));
    const view = { eye: cam.eye, target: cam.target, up: cam.up, fovy: cam.fovy, width: cam.width, height: cam.height, bg: [0, 0, 0] };
    const model = s.comments.includes('antialiased 1') ? 'even' : 'plain', dB = psnr(shot, render(s, view, model));
    ok(dB >= Number(opt['min-psnr']), `the picture is that of ${files[0]}: ${dB.toFixed(1)} dB (${model})`);
}

// All controls are inside the window, and none overlap.
async function layout() {
    const boxes = await tab.evaluate(() => [...document.querySelectorAll('#bar button, #bar input, #bar select, #label, #name, #hint')].filter((e) => e.offsetWidth).map((e) => { const r = e.getBoundingClientRect(); return { name: e.id || e.textContent, left: r.left, right: r.right, top: r.top, bottom: r.bottom, wide: e.scrollWidth > e.clientWidth + 1 && e.tagName !== 'INPUT' && e.tagName !== 'SELECT' }; }));
    const out = boxes.filter((b) => b.left < 0 || b.right > width || b.top < 0 || b.bottom > height || b.wide);
    const over = boxes.flatMap((a, i) => boxes.slice(i + 1).filter((b) => a.left < b.right - 1 && b.left < a.right - 1 && a.top < b.bottom - 1 && b.top < a.bottom - 1).map((b) => `${a.name} over ${b.name}`));
    ok(boxes.length >= 5 && out.length === 0 && over.length === 0, `nothing is cut off at ${width} x ${height}: ${boxes.length} parts ${[...out.map((b) => b.name), ...over].join(', ')}`);
}

// Unless the user prefers reduced motion, the clip plays at once.
async function playsByItself(url) {
    const other = await chrome.context.newPage();
    await other.emulateMedia({ reducedMotion: 'no-preference' });
    await other.goto(url, { timeout: LONG });
    await other.waitForFunction(() => document.documentElement.dataset.shown, null, { timeout: LONG });
    const first = await other.evaluate(() => document.documentElement.dataset.shown);
    await other.waitForFunction((was) => document.documentElement.dataset.shown !== was, first, { timeout: LONG });
    ok(true, 'plays by itself');
    await other.close();
}

// The part of an image from x = left to right, without the pixels that the line covers.
function part(shot, left, right) {
    const from = Math.round(left * shot.width), n = Math.round(right * shot.width) - from, rgb = new Uint8Array(n * shot.height * 3);
    for (let y = 0; y < shot.height; y++) rgb.set(shot.rgb.subarray((y * shot.width + from) * 3, (y * shot.width + from + n) * 3), y * n * 3);
    return { width: n, height: shot.height, rgb };
}

// Before to the left of the line, after to its right, wherever the line is.
async function wipe(first, versions) {
    await tab.click(`[data-version=${versions[1]}]`);
    await until((v) => document.documentElement.dataset.shown.startsWith(v), versions[1]);
    const other = await picture('before');
    await tab.click('[data-version=wipe]');
    await until(() => document.documentElement.dataset.shown.startsWith('wipe'));
    await tab.screenshot({ path: `${stem}-wipe-page.png` });
    for (const cut of [0.5, 0.25]) {
        const box = await tab.locator('#wipe').boundingBox(), margin = 0.06;
        await tab.mouse.move(box.x + box.width / 2, height / 2);
        await tab.mouse.down();
        await tab.mouse.move(cut * width, height / 2, { steps: 3 });
        await tab.mouse.up();
        const both = await picture(`wipe-${cut}`), l = [0, cut - margin], r = [cut + margin, 1];
        ok(!differ(part(both, ...l), part(other, ...l)) && !differ(part(both, ...r), part(first, ...r)), `a line at ${cut}: ${versions[1]} on its left, ${versions[0]} on its right`);
        if (cut === 0.5) ok(differ(part(both, ...l), part(first, ...l)), 'which are not the same');
    }
    await tab.focus('#wipe');
    await tab.keyboard.press('ArrowRight');
    ok(await tab.getAttribute('#wipe', 'aria-valuenow') === '27', 'moved by a key');
    await tab.click(`[data-version=${versions[0]}]`);
    await until((v) => document.documentElement.dataset.shown.startsWith(v), versions[0]);
}

// As a person would: play, scrub, switch, turn, zoom.
async function use(first, numbers, versions) {
    const first0 = await tab.evaluate(() => { const c = window.spin4d.camera(); return Math.hypot(...c.eye.map((v, i) => v - c.target[i])); });
    if (numbers.length > 1) {
        const before = await shown(), t0 = Date.now();
        await tab.click('#play');
        await until((was) => document.documentElement.dataset.shown !== was, before);
        ok(await tab.textContent('#play') === 'Pause', `plays: another frame after ${Date.now() - t0} ms`);
        await tab.click('#play');
        ok(await tab.textContent('#play') === 'Play', 'pauses');
        const box = await tab.locator('#scrub').boundingBox();
        await tab.mouse.click(box.x + box.width - 3, box.y + box.height / 2);
        const last = String(numbers.at(-1));
        await until((n) => document.documentElement.dataset.shown.endsWith(` ${n}`), last);
        ok(differ(first, await picture('last')), `scrubs to the last frame, ${last}`);
        await tab.focus('#scrub');
        await tab.keyboard.press('Home');
        await until((n) => document.documentElement.dataset.shown.endsWith(` ${n}`), String(numbers[0]));
        ok(!differ(first, await picture('again')), 'and back: the first picture again');
        await tab.selectOption('#speed', '0.5');
    }
    if (versions.length > 1) {
        await tab.click(`[data-version=${versions[1]}]`);
        await until((v) => document.documentElement.dataset.shown.startsWith(v), versions[1]);
        ok(differ(first, await picture(versions[1])), `switches to ${versions[1]}`);
        await tab.click(`[data-version=${versions[0]}]`);
        await until((v) => document.documentElement.dataset.shown.startsWith(v), versions[0]);
        ok(!differ(first, await picture(versions[0])), `and back to ${versions[0]}`);
    }
    if (versions.length > 1) await wipe(first, versions);
    let n = await draws();
    await tab.mouse.move(width / 2, height / 3);
    await tab.mouse.down();
    await tab.mouse.move(width / 2 + 90, height / 3 + 20, { steps: 4 });
    await tab.mouse.up();
    await until((was) => Number(document.documentElement.dataset.draws) > was, n);
    const turned = await picture('turned');
    ok(differ(first, turned), 'turns by dragging');
    n = await draws();
    await tab.mouse.wheel(0, 300);
    await until((was) => Number(document.documentElement.dataset.draws) > was, n);
    ok(differ(turned, await picture('zoomed')), 'zooms by the wheel');
    const reach = await tab.evaluate(() => { const { reach, size, fovy } = window.spin4d.clip; return [reach[0], Math.max(reach[1], 1.5 * size / Math.tan(fovy * Math.PI / 360))]; }), far = (c) => Math.hypot(...c.eye.map((v, i) => v - c.target[i]));
    for (const [by, limit] of [[-1e5, reach[0]], [1e5, reach[1]]]) {
        await tab.mouse.wheel(0, by);
        await tab.waitForTimeout(200);
        const now = far(await tab.evaluate(() => window.spin4d.camera()));
        ok(by < 0 ? now >= Math.min(limit, first0) * 0.999 : now <= Math.max(limit, first0) * 1.001, `the wheel stops at ${now.toFixed(2)}`);
    }
    await tab.click('#full');
    await until(() => document.fullscreenElement);
    await tab.click('#full');
    await until(() => !document.fullscreenElement);
    ok(true, 'fills the screen and comes back');
    await tab.click('#home');
    await tab.waitForTimeout(500);
    ok(!differ(first, await picture('home')), 'comes back to the first view');
}

try {
    await tab.setViewportSize({ width, height });
    const url = split ? `${server.base}/${encodeURIComponent(path.basename(args[0]))}` : pathToFileURL(path.resolve(args[0])).href;
    await tab.goto(url, { timeout: LONG });
    await until(() => document.documentElement.dataset.shown);
    if (split) {
        const whole = fs.statSync(path.join(folder, data)).size, share = 100 * firstRead / whole, draft = await tab.evaluate(() => document.documentElement.dataset.draft);
        ok(firstRead > 0 && (share <= Number(opt['first-share']) || firstRead <= 16000), `the first picture after ${firstRead} of the ${whole} bytes of data, ${share.toFixed(1)} %${draft === 'yes' ? ', a draft' : ''}`);
        await picture('draft');
        goOn();
        await until(() => document.documentElement.dataset.draft === 'no');
    }
    ok(await tab.title() === path.basename(args[0], '.html'), 'has its name');
    if (width >= 320) await layout();
    const { numbers, versions } = await tab.evaluate(() => ({ numbers: window.spin4d.clip.numbers, versions: window.spin4d.clip.versions.map((v) => v.name) }));
    const first = await picture('first'), drawn = 100 * drawnShare(first, [0, 0, 0]);
    ok(drawn > 0.5, `opens from the disk: ${numbers.length} frames, ${versions.join(' and ')}, ${drawn.toFixed(1)} % drawn`);
    if (opt.truth) held(first, await tab.evaluate(() => window.spin4d.camera()));
    await tab.screenshot({ path: `${stem}-page.png` });
    if (!opt['picture-only']) {
        await use(first, numbers, versions);
        if (numbers.length > 1) await playsByItself(url);
    }
} catch (e) {
    ok(false, e.message.split('\n')[0]);
} finally {
    await chrome.close();
    server?.close();
}
[...new Set(problems)].forEach((p) => ok(false, p));
ok(problems.length === 0, 'no error, no warning, no request');
console.log(`${passed} passed, ${failed} failed`);
process.exit(failed ? 1 : 0);
