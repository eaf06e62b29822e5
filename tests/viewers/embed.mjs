#!/usr/bin/env node
// A page of another site that embeds a clip in the three ways of docs/how-to/viewers.md, with the
// lines of that document and the clip's address inserted. Each way must show an image, hide no
// control, let the wheel scroll the page until the clip has been touched, and follow the page's
// commands. The player is that of a package made by `npm pack`.
import fs from 'node:fs';
import path from 'node:path';
import { spawnSync } from 'node:child_process';
import { launch } from './lib/chrome.mjs';
import { snippets } from './lib/docs.mjs';
import { decodePng, drawnShare, psnr } from './lib/png.mjs';
import { serve } from './lib/server.mjs';

const HELP = `usage: node embed.mjs PLAYER_DIR PAGE.html OUT_DIR
Opens PAGE in frames of a page in OUT_DIR/site, from another address, 280, 390 and 1280 pixels wide.
Exit status: 0 all well, 1 something failed, 2 wrong usage.`;
const [player, clip, out] = process.argv.slice(2), LONG = 60000, WIDTHS = [280, 390, 1280], WAYS = ['iframe', 'element', 'module'];
if (!out || process.argv.length > 5 || !fs.existsSync(clip)) { console.error(HELP); process.exit(2); }

let failed = 0, passed = 0;
function ok(good, what) {
    if (good) passed++;
    else failed++;
    console.log(`  ${good ? 'ok  ' : 'FAIL'} ${what}`);
}

// ---- The other site -----------------------------------------------------------------------------

const site = path.join(out, 'site');
fs.rmSync(site, { recursive: true, force: true });
fs.mkdirSync(site, { recursive: true });
const run = (...command) => {
    const done = spawnSync(command[0], command.slice(1), { encoding: 'utf8' });
    if (done.status !== 0) throw new Error(`${command.join(' ')}: ${done.stderr}`);
    return done.stdout.trim();
};
run('tar', 'xzf', path.join(site, run('npm', 'pack', '--silent', '--pack-destination', site, path.resolve(player))), '-C', site, '--strip-components', '1');
const there = await serve([path.dirname(path.resolve(clip))]), here = await serve([site]);
const address = `${there.base.replace('127.0.0.1', 'localhost')}/${encodeURIComponent(path.basename(clip))}`;
const ways = Object.fromEntries(WAYS.map((way) => [way, snippets()[way].replaceAll('clip.html', address)]));
const text = `<p>${'A page has words above a clip and below it, and whoever reads them scrolls with the wheel. '.repeat(9)}</p>\n`;
fs.writeFileSync(path.join(site, 'index.html'), `<!doctype html>
<html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1"><title>Another site</title>
<style>body { font: 16px/1.5 sans-serif; margin: 0 auto; max-width: 1100px } p, h2 { margin: 1em 12px }</style>
${text}${WAYS.map((way) => `<h2>${way}</h2>\n<div id="${way}">${ways[way]}</div>\n${text}`).join('')}</html>\n`);

// ---- The page in use ----------------------------------------------------------------------------

const chrome = await launch(), problems = [];
const inside = async (tab, way) => (await (await tab.$(`#${way} iframe`)).contentFrame());
const distance = (frame) => frame.evaluate(() => { const c = window.spin4d.camera(); return Math.hypot(...c.eye.map((v, i) => v - c.target[i])); });
const scrolled = (tab) => tab.evaluate(() => window.scrollY);
async function picture(tab, way) {
    await tab.waitForTimeout(400);
    return decodePng(await tab.locator(`#${way} iframe`).screenshot());
}

// Controls that the frame cuts off, or that overlap.
async function cutOff(frame) {
    return frame.evaluate(() => {
        const parts = [...document.querySelectorAll('#bar button, #bar input, #bar select, #label, #name, #hint')].filter((e) => e.offsetWidth).map((e) => [e.id || e.textContent, e.getBoundingClientRect()]);
        const out = parts.filter(([, r]) => r.left < 0 || r.right > innerWidth || r.top < 0 || r.bottom > innerHeight), over = parts.flatMap(([a, r], i) => parts.slice(i + 1).filter(([, s]) => r.left < s.right - 1 && s.left < r.right - 1 && r.top < s.bottom - 1 && s.top < r.bottom - 1).map(([b]) => `${a} over ${b}`));
        return [...out.map(([name]) => name), ...over];
    });
}

async function wheel(tab, frame, way) {
    const from = await distance(frame), top = await scrolled(tab);
    await tab.locator(`#${way} iframe`).hover();
    await tab.mouse.wheel(0, 40);
    await tab.waitForFunction((y) => window.scrollY > y, top, { timeout: LONG });
    const same = await distance(frame) === from;
    await tab.locator(`#${way} iframe`).click();
    const middle = await scrolled(tab);
    await tab.mouse.wheel(0, -40);
    await frame.waitForFunction((d) => { const c = window.spin4d.camera(); return Math.hypot(...c.eye.map((v, i) => v - c.target[i])) < d; }, from, { timeout: LONG });
    ok(same && await scrolled(tab) === middle, `${way}: the wheel scrolls the page, and after a click it zooms`);
    await tab.evaluate(() => window.focus());
    await tab.locator(`h2`).nth(WAYS.indexOf(way)).click();
}

async function look(tab, way, width) {
    await tab.locator(`#${way}`).scrollIntoViewIfNeeded();
    await tab.waitForFunction((w) => document.querySelector(`#${w} iframe`), way, { timeout: LONG });
    const frame = await inside(tab, way);
    await frame.waitForFunction(() => window.spin4d?.state.ready, null, { timeout: LONG });
    const box = await tab.locator(`#${way} iframe`).boundingBox(), around = await tab.locator(`#${way}`).boundingBox(), wide = Math.min(width, 1100);
    await tab.evaluate((w) => document.querySelector(`#${w}`).scrollIntoView({ block: 'center' }), way);
    const first = await picture(tab, way), drawn = 100 * Math.min(drawnShare(first, [0, 0, 0]), drawnShare(first, [1, 1, 1])), out2 = await cutOff(frame);
    await tab.screenshot({ path: path.join(out, `embed-${width}-${way}.png`) });
    ok(drawn > 5 && Math.abs(box.width - wide) < 1 && Math.abs(box.width / box.height - 16 / 9) < 0.02 && box.height <= around.height + 1, `${way}: ${Math.round(box.width)} x ${Math.round(box.height)}, ${drawn.toFixed(1)} % drawn`);
    ok(out2.length === 0, `${way}: nothing is cut off ${out2.join(', ')}`);
    await wheel(tab, frame, way);
    return { frame, first };
}

// The page's commands are followed, and the page receives events.
async function ask(tab) {
    const { frame, first } = { frame: await inside(tab, 'element'), first: await picture(tab, 'element') };
    const told = await tab.evaluate(() => new Promise((done, no) => {
        const { player } = document.querySelector('spin-clip'), n = player.state.frames;
        setTimeout(() => no(new Error('the page is not told')), 20000);
        player.addEventListener('change', () => { if (player.state.frame === n) done(player.state); });
        player.seek(n);
    }));
    await frame.waitForFunction(() => document.documentElement.dataset.shown?.endsWith(` ${window.spin4d.clip.numbers.at(-1)}`), null, { timeout: LONG });
    ok(told.play === false && psnr(first, await picture(tab, 'element')) < 45, `the page asks for frame ${told.frame}, and sees it`);
    await tab.evaluate(() => { document.querySelector('spin-clip').player.version = 'before'; });
    await frame.waitForFunction(() => document.documentElement.dataset.shown?.startsWith('before'), null, { timeout: LONG });
    ok(true, 'and for the version before');
    await tab.evaluate(() => document.querySelector('spin-clip').remove());
    ok(await tab.locator('#element iframe').count() === 0, 'an element that goes takes its frame with it');
}

try {
    for (const width of WIDTHS) {
        const tab = await chrome.context.newPage();
        tab.on('console', (m) => { if (['error', 'warning'].includes(m.type())) problems.push(`console: ${m.text()}`); });
        tab.on('pageerror', (e) => problems.push(`exception: ${e.message}`));
        await tab.emulateMedia({ reducedMotion: 'reduce' }); // or they play by themselves
        await tab.setViewportSize({ width, height: 700 });
        await tab.goto(`${here.base}/index.html`, { timeout: LONG });
        console.log(`${width} pixels`);
        for (const way of WAYS) await look(tab, way, width);
        ok(await tab.evaluate(() => document.documentElement.scrollWidth <= innerWidth), 'the page does not scroll sideways');
        if (width === WIDTHS.at(-1)) await ask(tab);
        await tab.close();
    }
} catch (e) {
    ok(false, e.message.split('\n')[0]);
} finally {
    await chrome.close();
    here.close();
    there.close();
}
[...new Set(problems)].forEach((p) => ok(false, p));
console.log(`${passed} passed, ${failed} failed`);
process.exit(failed ? 1 : 0);
