// node screenshot.mjs URL OUT.png|OUT.jpg WIDTH HEIGHT [READY]: takes a screenshot of a page in
// Chromium once the JavaScript expression READY is true. Controls Chromium through pipes, so that
// no other package is needed. The environment variable CHROMIUM is the path of another browser.
import { spawn } from 'node:child_process';
import fs from 'node:fs';
import os from 'node:os';
import path from 'node:path';

const [url, out, width, height, ready = 'true'] = process.argv.slice(2), PATIENCE = 120000, folder = fs.mkdtempSync(path.join(os.tmpdir(), 'screenshot-'));
const flags = ['--headless', '--no-sandbox', '--remote-debugging-pipe', `--user-data-dir=${folder}`, '--use-gl=angle', '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--ignore-gpu-blocklist', '--no-first-run', '--disable-background-networking', '--hide-scrollbars', '--force-device-scale-factor=1'];
const chrome = spawn(process.env.CHROMIUM ?? 'chromium', flags, { stdio: ['ignore', 'ignore', 'ignore', 'pipe', 'pipe'] }), waiting = new Map();
function end(code, text) {
    if (text) console.error(`screenshot: ${url}: ${text}`);
    chrome.on('close', async () => {
        // The browser's last processes may still write to the folder, so that removing it fails.
        for (let i = 0; i < 20 && fs.existsSync(folder); i++) {
            try { fs.rmSync(folder, { recursive: true, force: true }); } catch { await new Promise((yes) => setTimeout(yes, 100)); }
        }
        process.exit(code);
    });
    chrome.kill();
}
chrome.on('error', (e) => { console.error(`screenshot: ${e.message}`); process.exit(1); });
setTimeout(() => end(1, `the page was not ready after ${PATIENCE / 1000} seconds`), PATIENCE);

// Messages are JSON, each terminated by a zero byte.
let text = '', count = 0;
chrome.stdio[4].setEncoding('utf8').on('data', (some) => {
    const messages = (text + some).split('\0');
    text = messages.pop();
    for (const { id, result, error } of messages.map((m) => JSON.parse(m))) {
        if (error) waiting.get(id)?.no(new Error(error.message));
        else waiting.get(id)?.yes(result);
    }
});
const call = (method, params = {}, sessionId = undefined) => new Promise((yes, no) => {
    waiting.set(++count, { yes, no });
    chrome.stdio[3].write(`${JSON.stringify({ id: count, method, params, sessionId })}\0`);
});

try {
    const { targetId } = await call('Target.createTarget', { url: 'about:blank' }), { sessionId } = await call('Target.attachToTarget', { targetId, flatten: true });
    await call('Emulation.setDeviceMetricsOverride', { width: Number(width), height: Number(height), deviceScaleFactor: 1, mobile: false }, sessionId);
    const { errorText } = await call('Page.navigate', { url }, sessionId);
    if (errorText) throw new Error(errorText);
    while (!(await call('Runtime.evaluate', { expression: `document.readyState === 'complete' && Boolean(${ready})` }, sessionId)).result.value) await new Promise((yes) => setTimeout(yes, 200));
    await new Promise((yes) => setTimeout(yes, 1000)); // wait for a last redraw
    const { data } = await call('Page.captureScreenshot', { format: out.endsWith('.png') ? 'png' : 'jpeg', ...(out.endsWith('.png') ? {} : { quality: 85 }) }, sessionId);
    fs.writeFileSync(out, Buffer.from(data, 'base64'));
    end(0);
} catch (e) {
    end(1, e.message);
}
