#!/usr/bin/env node
// A .sogst file as the source of <spin-clip>: its frames are compared with PLYs of the same times,
// drawn by the reference.
import fs from 'node:fs';
import path from 'node:path';
import { launch } from './lib/chrome.mjs';
import { decodePng, drawnShare, encodePng, psnr } from './lib/png.mjs';
import { render } from './lib/reference.mjs';
import { serve } from './lib/server.mjs';
import { readPly } from './lib/splat.mjs';

const HELP = `usage: node sogst.mjs PLAYER_DIR FILE.sogst PLY_DIR OUT_DIR [DB]
PLY_DIR has the frames of FILE. DB: least agreement (32). Exit status: 0 all well, 1 something failed, 2 wrong usage.`;
const [player, file, truth, out, least = '32'] = process.argv.slice(2), LONG = 60000, LEAST = Number(least), width = 480, height = 270;
if (!out || process.argv.length > 7 || !fs.existsSync(file)) { console.error(HELP); process.exit(2); }
const plys = fs.readdirSync(truth).filter((f) => f.endsWith('.ply')).sort(), site = path.join(out, 'sogst'), name = path.basename(file);
fs.rmSync(site, { recursive: true, force: true });
fs.cpSync(player, site, { recursive: true });
fs.copyFileSync(file, path.join(site, name));
fs.writeFileSync(path.join(site, 'bad.sogst'), 'no file of this kind');

let failed = 0;
const ok = (good, what) => { if (!good) failed++; console.log(`  ${good ? 'ok  ' : 'FAIL'} ${what}`); };
const chrome = await launch(), server = await serve([site]), problems = [];
async function open(source, more) {
    fs.writeFileSync(path.join(site, 'index.html'), `<!doctype html><meta charset="utf-8"><style>body { margin: 0 }</style><script type="module" src="player.js"></script><spin-clip src="${source}" noui ${more}></spin-clip>`);
    const tab = await chrome.context.newPage();
    await tab.setViewportSize({ width, height });
    tab.on('pageerror', (e) => problems.push(e.message));
    await tab.goto(`${server.base}/index.html`);
    return { tab, frame: await (await tab.waitForSelector('iframe')).contentFrame() };
}

try {
    for (const k of [0, Math.floor(plys.length / 2), plys.length - 1]) {
        const { tab, frame } = await open(name, `frame="${k + 1}" autoplay="0"`);
        await frame.waitForFunction(() => window.spin4d?.state.ready, null, { timeout: LONG });
        await tab.waitForTimeout(500);
        const cam = await frame.evaluate(() => window.spin4d.camera()), { frames } = await frame.evaluate(() => window.spin4d.state), shot = decodePng(await tab.screenshot());
        fs.writeFileSync(path.join(out, `sogst-${k + 1}.png`), encodePng(shot));
        const dB = psnr(shot, render(readPly(path.join(truth, plys[k])), { ...cam, width, height, bg: [0, 0, 0] }, 'plain')), drawn = 100 * drawnShare(shot, [0, 0, 0]);
        ok(dB >= LEAST && drawn > 0.5 && frames === plys.length, `${name}: frame ${k + 1} of ${frames} as in ${plys[k]}: ${dB.toFixed(1)} dB, ${drawn.toFixed(1)} % drawn`);
        await tab.close();
    }
    const { tab, frame } = await open('bad.sogst', '');
    await frame.waitForFunction(() => document.querySelector('#message').textContent.startsWith('The clip cannot be read'), null, { timeout: LONG });
    ok(true, await frame.textContent('#message'));
    await tab.close();
} catch (e) {
    ok(false, e.message.split('\n')[0]);
} finally {
    await chrome.close();
    server.close();
}
[...new Set(problems)].forEach((p) => ok(false, p));
process.exit(failed ? 1 : 0);
