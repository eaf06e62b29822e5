#!/usr/bin/env node
// Uses the page of `make web` as a person would: opens it from the disk, gives it a run, views and
// saves the result. It may make no network request.
import fs from 'node:fs';
import path from 'node:path';
import { execFileSync } from 'node:child_process';
import { launch } from './lib/chrome.mjs';
import { decodePng, drawnShare } from './lib/png.mjs';

const HELP = `usage: node web.mjs PAGE.html RUN NATIVE OUT_DIR
RUN: a folder; NATIVE has what the commands made of it: ply/, spz/. Exit status: 0 all well, 1 something failed, 2 wrong usage.`;
const [page, run, native, out] = process.argv.slice(2), LONG = 60000;
if (!out || process.argv.length > 6 || !fs.existsSync(page)) { console.error(HELP); process.exit(2); }

let failed = 0;
const ok = (good, what) => { if (!good) failed++; console.log(`  ${good ? 'ok  ' : 'FAIL'} ${what}`); };
const chrome = await launch(), asked = [], problems = [];
chrome.context.on('request', (r) => { if (!/^(blob|data|file):/.test(r.url())) asked.push(r.url()); });

try {
    const tab = await chrome.context.newPage();
    tab.on('pageerror', (e) => problems.push(e.message));
    tab.on('console', (m) => { if (m.type() === 'error') problems.push(m.text()); });
    await tab.setViewportSize({ width: 1000, height: 1100 });
    await tab.goto(`file://${path.resolve(page)}`);
    await tab.waitForSelector('body[data-ready]', { timeout: LONG });
    const free = () => tab.waitForFunction(() => !document.querySelector('#file').disabled, null, { timeout: LONG });
    const save = async (to) => {
        const [download] = await Promise.all([tab.waitForEvent('download', { timeout: LONG }), tab.click(`[data-to="${to}"]`)]);
        const file = path.join(out, download.suggestedFilename());
        await download.saveAs(file);
        await free();
        return file;
    };

    fs.writeFileSync(path.join(out, 'bad.pth'), 'no checkpoint');
    await tab.setInputFiles('#files', path.join(out, 'bad.pth'));
    await tab.waitForSelector('#log .err', { timeout: LONG });
    await free();
    ok(/bad\.pth/.test(await tab.innerText('#log .err')), `a bad file is named: ${await tab.innerText('#log .err')}`);

    await tab.setInputFiles('#folders', run);
    const frame = await (await tab.waitForSelector('#clip:not([hidden]) iframe', { timeout: LONG })).contentFrame();
    await frame.waitForFunction(() => window.spin4d?.state.ready, null, { timeout: LONG });
    await tab.waitForTimeout(1500);
    const box = await tab.locator('#player').boundingBox(), shot = await tab.screenshot({ clip: box });
    fs.writeFileSync(path.join(out, 'page.png'), await tab.screenshot());
    const drawn = drawnShare(decodePng(shot), [0, 0, 0]);
    ok(drawn > 0.3, `the player shows the clip: ${(100 * drawn).toFixed(0)} % of its picture`);
    await free();

    for (const to of ['ply', 'spz']) {
        const file = await save(to), folder = path.join(out, `saved-${to}`);
        execFileSync('python3', ['-m', 'zipfile', '-e', file, folder]);
        const names = fs.readdirSync(path.join(native, to));
        const same = names.filter((n) => fs.readFileSync(path.join(native, to, n)).equals(fs.readFileSync(path.join(folder, to, n))));
        ok(same.length === names.length, `${path.basename(file)}: ${same.length} of ${names.length} files have the bytes of spin-export`);
    }
    for (const [to, begins] of [['html', '<!doctype html>'], ['gltf', 'glTF'], ['', 'PK']]) {
        const file = await save(to), bytes = fs.readFileSync(file);
        ok(bytes.subarray(0, begins.length).toString().toLowerCase() === begins.toLowerCase(), `${path.basename(file)}: ${bytes.length} bytes`);
    }
    ok(asked.length === 0, `nothing is asked of any machine${asked.length ? `: ${asked.join(' ')}` : ''}`);
    ok(problems.length === 0, `no complaint of the browser${problems.length ? `: ${problems.join('; ')}` : ''}`);
} catch (e) {
    ok(false, e.message.split('\n')[0]);
} finally {
    await chrome.close();
}
process.exit(failed ? 1 : 0);
