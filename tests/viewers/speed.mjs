#!/usr/bin/env node
// Images per second of the page beside SuperSplat's viewer: the same splats, view and size, in the
// same browser on the same processor, alternately, in rounds. A simulated pointer rotates both to
// and fro by the same pixels in every image.
import fs from 'node:fs';
import path from 'node:path';
import { spawnSync } from 'node:child_process';
import { parseArgs } from 'node:util';
import { launch } from './lib/chrome.mjs';
import { decodePng, encodePng, psnr } from './lib/png.mjs';
import { serve } from './lib/server.mjs';
import { writePly } from './lib/write.mjs';

const HELP = `usage: node speed.mjs [options] BIN_DIR
  --out DIR      scenes and pictures go here (bench-out)
  --splats A,B   sizes of the scenes (60000,300000)
  --ply FILE     this frame instead of a scene made up
  --size W,H     of the picture (640,400)
  --seconds S    of each turn (3); four of both, one after the other, make a round
  --rounds N     how often all that (3)
  --least R      fails where the middle ratio is below R (0)
Prints a line for each size: pictures a second of both, and the middle one of the rounds' ratios, page to SuperSplat.
Exit status: 0 all well, 1 something failed, 2 wrong usage.`;
let opt, args;
try {
    ({ values: opt, positionals: args } = parseArgs({ allowPositionals: true, options: { out: { type: 'string', default: 'bench-out' }, splats: { type: 'string', default: '60000,300000' }, ply: { type: 'string' }, size: { type: 'string', default: '640,400' }, seconds: { type: 'string', default: '3' }, rounds: { type: 'string', default: '3' }, least: { type: 'string', default: '0' }, help: { type: 'boolean', short: 'h' } } }));
    if (opt.help) { console.log(HELP); process.exit(0); }
    if (args.length !== 1) throw new Error('name the folder of spin-export');
} catch (e) {
    console.error(`speed: ${e.message}\n${HELP}`);
    process.exit(2);
}
const here = path.dirname(new URL(import.meta.url).pathname), [width, height] = opt.size.split(',').map(Number), LONG = 120000;
fs.mkdirSync(opt.out, { recursive: true });
let failed = 0;

// ---- A scene: a room with three walls and balls in it, with soft and hard splats on the surfaces 

let seed = 1;
const rnd = () => { seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0; return seed / 2 ** 32; };
const gauss = () => Math.sqrt(-2 * Math.log(1 - rnd())) * Math.cos(2 * Math.PI * rnd());
// The quaternion that turns z to a direction.
function facing([x, y, z]) {
    const q = [1 + z, -y, x, 0], n = Math.hypot(...q);
    return n > 1e-6 ? q.map((v) => v / n) : [0, 1, 0, 0];
}

function room(n) {
    seed = 1;
    const balls = Array.from({ length: 14 }, () => ({ at: [4 * rnd() - 2, 1.3 - 1.6 * rnd(), 4 * rnd() - 2], r: 0.15 + 0.35 * rnd(), hue: [rnd(), rnd(), rnd()] }));
    const areas = [...balls.map((b) => 8 * Math.PI * b.r ** 2), 36, 18, 18, 18], all = areas.reduce((a, b) => a + b), step = Math.sqrt(all / n);
    return Array.from({ length: n }, () => {
        let part = 0, pos, normal, hue;
        for (let k = rnd() * all; part < areas.length - 1 && k > areas[part]; part++) k -= areas[part];
        if (part < balls.length) {
            const b = balls[part], v = [gauss(), gauss(), gauss()], l = Math.hypot(...v);
            normal = v.map((c) => c / l);
            pos = b.at.map((c, i) => c + b.r * normal[i]);
            hue = b.hue.map((c) => 0.2 + 0.6 * c + 0.1 * normal[1]);
        } else {
            const wall = part - balls.length, u = 6 * rnd() - 3, v = wall ? 3 * rnd() - 1.5 : 6 * rnd() - 3;
            normal = [[0, -1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, -1]][wall];
            pos = [[u, 1.5, v], [-3, v, u], [3, v, u], [u, v, 3]][wall];
            hue = [0.5 + 0.2 * Math.sin(5 * u), 0.5 + 0.2 * Math.sin(4 * v), 0.3 + 0.1 * wall];
        }
        return {
            pos: pos.map((c) => c + 0.3 * step * gauss()), rot: facing(normal), alpha: Math.min(0.99, Math.max(0.02, 1.1 * rnd() ** 1.5)),
            scale: [0.7 * step * Math.exp(0.6 * gauss()), 0.7 * step * Math.exp(0.6 * gauss()), 0.15 * step],
            sh0: hue.map((c) => (c + 0.08 * gauss() - 0.5) / 0.28209479), shN: [0, 1, 2].map(() => [0.05 * gauss(), 0.05 * gauss(), 0.05 * gauss()])
        };
    });
}

// ---- One measurement ----------------------------------------------------------------------------

// Runs in the page before its own scripts: counts the frames in which something is drawn, and moves
// the pointer.
function watch() {
    const contexts = new Set(), get = HTMLCanvasElement.prototype.getContext;
    let drawn = false;
    HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
        const gl = get.call(this, kind, ...more);
        if (kind === 'webgl2' && gl) contexts.add(gl);
        return gl;
    };
    for (const name of ['drawArrays', 'drawElements', 'drawArraysInstanced', 'drawElementsInstanced']) {
        const does = WebGL2RenderingContext.prototype[name];
        WebGL2RenderingContext.prototype[name] = function (...a) { drawn = true; return does.apply(this, a); };
    }
    // The clock stops when the GPU process has finished all of them.
    const finish = () => contexts.forEach((gl) => gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)));
    window.firstFrame = () => { window.hasDrawn = true; }; // SuperSplat's viewer calls it
    window.turn = (seconds, x, y) => new Promise((done) => {
        const canvas = document.elementFromPoint(x, y), hand = (type, at) => canvas.dispatchEvent(new PointerEvent(type, { bubbles: true, cancelable: true, pointerId: 1, pointerType: 'mouse', button: type === 'pointermove' ? -1 : 0, buttons: type === 'pointerup' ? 0 : 1, clientX: at, clientY: y, screenX: at, screenY: y }));
        const held = canvas.setPointerCapture;
        canvas.setPointerCapture = () => {};
        let pictures = 0, k = 0, from = 0;
        hand('pointerdown', x);
        const next = () => {
            if (k === 2) { finish(); from = performance.now(); pictures = 0; } // it has begun
            if (drawn) pictures++;
            drawn = false;
            if (k > 2 && performance.now() - from > 1000 * seconds) {
                finish();
                const result = { pictures, seconds: (performance.now() - from) / 1000 };
                hand('pointerup', x);
                canvas.setPointerCapture = held;
                return done(result);
            }
            k++;
            hand('pointermove', x + 2 * Math.abs(k % 120 - 60) - 120);
            requestAnimationFrame(next);
        };
        requestAnimationFrame(next);
    });
}

const settle = 1500, TURNS = 4; // of both, one after the other, in a round
const clients = {
    page: { ready: () => window.spin4d?.state.ready },
    supersplat: { ready: () => window.hasDrawn }
};

async function open(chrome, url, ready, name) {
    const tab = await chrome.context.newPage();
    await tab.emulateMedia({ reducedMotion: 'reduce' });
    const fail = (text) => { failed++; console.log(`  FAIL ${name}: ${text}`); };
    tab.on('pageerror', (e) => fail(e.message));
    tab.on('console', (m) => { if (m.type() === 'error') fail(m.text()); });
    await tab.setViewportSize({ width, height });
    await tab.addInitScript(watch);
    await tab.goto(url, { timeout: LONG });
    await tab.waitForFunction(ready, null, { timeout: LONG });
    await tab.waitForTimeout(settle);
    const picture = decodePng(await tab.screenshot({ style: '#bar, #title { display: none !important }', timeout: LONG }));
    fs.writeFileSync(path.join(opt.out, `speed-${name}.png`), encodePng(picture));
    const size = await tab.evaluate(() => { const c = document.querySelector('canvas'); return [c.width, c.height]; });
    if (size[0] !== width || size[1] !== height) fail(`draws ${size.join(' x ')}`);
    return { tab, picture };
}

// Images, seconds of the clock and seconds of the processor in one round.
async function turn(tab) {
    await tab.bringToFront();
    const used = processorSeconds(), { pictures, seconds } = await tab.evaluate(([s, x, y]) => window.turn(s, x, y), [Number(opt.seconds), width / 2, height / 2]);
    return { pictures, seconds, used: processorSeconds() - used };
}

// Processor seconds of this browser and its children so far.
function processorSeconds() {
    const stat = fs.readdirSync('/proc').filter((p) => /^\d+$/.test(p)).flatMap((p) => {
        try { const f = fs.readFileSync(`/proc/${p}/stat`, 'utf8').replace(/.*\) /s, '').split(' '); return [{ pid: Number(p), parent: Number(f[1]), used: (Number(f[11]) + Number(f[12])) / 100 }]; } catch { return []; }
    });
    const mine = new Set([process.pid]);
    for (let more = 1; more;) { more = 0; for (const s of stat) if (mine.has(s.parent) && !mine.has(s.pid)) { mine.add(s.pid); more++; } }
    return stat.filter((s) => mine.has(s.pid) && s.pid !== process.pid).reduce((sum, s) => sum + s.used, 0);
}

function command(...line) {
    const done = spawnSync(path.join(args[0], line[0]), line.slice(1), { encoding: 'utf8' });
    if (done.status !== 0) throw new Error(`${line.join(' ')}: ${done.stderr}`);
}

// The same splats for both, and the page's first view converted for SuperSplat, which rotates a
// file by half a turn about z.
async function files(n, chrome) {
    const stem = path.join(opt.out, `speed-${n}`);
    if (!opt.ply) { fs.mkdirSync(`${stem}-ply`, { recursive: true }); writePly(`${stem}-ply/frame_00000.ply`, room(n), 1); }
    command('spin-import', '-q', '--force', '--from', 'ply', opt.ply ?? `${stem}-ply`, '-o', `${stem}.spin`);
    command('spin-export', '-q', '--force', `${stem}.spin`, '--to', 'html', '-o', `${stem}.html`);
    command('spin-export', '-q', '--force', `${stem}.spin`, '--to', 'sog', '--sh', '1', '-o', `${stem}-sog`);
    const sog = fs.readdirSync(`${stem}-sog`).filter((f) => f.endsWith('.sog'))[0];
    const tab = await chrome.context.newPage(), server = await serve([path.resolve(opt.out)]);
    await tab.setViewportSize({ width, height });
    await tab.goto(`${server.base}/${path.basename(stem)}.html`, { timeout: LONG });
    await tab.waitForFunction(clients.page.ready, null, { timeout: LONG });
    const cam = await tab.evaluate(() => window.spin4d.camera());
    await tab.close();
    server.close();
    const half = ([x, y, z]) => [-x, -y, z], across = 360 / Math.PI * Math.atan(width / height * Math.tan(cam.fovy * Math.PI / 360));
    const initial = { position: half(cam.eye), target: half(cam.target), fov: width > height ? across : cam.fovy };
    const off = { sharpness: { enabled: false, amount: 0 }, bloom: { enabled: false, intensity: 0.1, blurLevel: 2 }, grading: { enabled: false, brightness: 1, contrast: 1, saturation: 1, tint: [1, 1, 1] }, vignette: { enabled: false, intensity: 0.5, inner: 0.3, outer: 0.75, curvature: 1 }, fringing: { enabled: false, intensity: 0.5 } };
    fs.writeFileSync(`${stem}.json`, JSON.stringify({ version: 2, tonemapping: 'none', highPrecisionRendering: false, background: { color: [0, 0, 0] }, postEffectSettings: off, animTracks: [], cameras: [{ initial }], annotations: [], startMode: 'default' }));
    return { page: `/${path.basename(stem)}.html`, supersplat: `/index.html?webgl&noui&noanim&content=/${path.basename(stem)}-sog/${sog}&settings=/${path.basename(stem)}.json` };
}

const middle = (list) => list.slice().sort((a, b) => a - b)[list.length >> 1];
const chrome = await launch(), server = await serve([path.resolve(opt.out), path.join(here, 'node_modules/@playcanvas/supersplat-viewer/public')]);
try {
    for (const n of opt.ply ? ['ply'] : opt.splats.split(',').map(Number)) {
        const address = await files(n, chrome), who = Object.keys(clients), tabs = {}, all = { page: [], supersplat: [] };
        for (const w of who) tabs[w] = await open(chrome, server.base + address[w], clients[w].ready, `${n}-${w}`);
        for (let round = 0; round < Number(opt.rounds); round++) {
            const sums = { page: { pictures: 0, seconds: 0, used: 0 }, supersplat: { pictures: 0, seconds: 0, used: 0 } };
            for (let k = 0; k < TURNS; k++) {
                for (const w of who) {
                    const one = await turn(tabs[w].tab);
                    for (const key of Object.keys(one)) sums[w][key] += one[key];
                }
            }
            for (const w of who) all[w].push({ rate: sums[w].pictures / sums[w].seconds, cost: sums[w].used / sums[w].pictures });
        }
        for (const w of who) await tabs[w].tab.close();
        const ratio = middle(all.page.map((r, i) => r.rate / all.supersplat[i].rate)), same = psnr(tabs.page.picture, tabs.supersplat.picture);
        const say = (w, key, digits) => all[w].map((r) => r[key].toFixed(digits)).join(' ');
        const good = ratio >= Number(opt.least) && same > 24;
        if (!good) failed++;
        console.log(`  ${good ? 'ok  ' : 'FAIL'} ${n} splats, ${width} x ${height}: page ${say('page', 'rate', 2)}, SuperSplat ${say('supersplat', 'rate', 2)} pictures a second; ratio ${ratio.toFixed(2)}; processor seconds a picture ${say('page', 'cost', 3)} and ${say('supersplat', 'cost', 3)}; the same picture to ${same.toFixed(1)} dB`);
    }
} finally {
    await chrome.close();
    server.close();
}
process.exit(failed ? 1 : 0);
