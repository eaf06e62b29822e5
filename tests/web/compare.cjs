// compare.cjs WEB NAME RUN NATIVE [FRAMES]: the run through import and export in WebAssembly; every file must have the bytes of that
// which the commands of this machine wrote to NATIVE, and what they could not write must fail. Where a network is evaluated,
// exp and sin of two C libraries part in the last bits: the numbers of a PLY may then differ by CLOSE, and GLB and SPZ are not looked at.
const crypto = require('crypto');
const fs = require('fs');
const path = require('path');
const [web, name, run, native, frames] = process.argv.slice(2);
global.spin4d = require(path.resolve(web, 'spin4d.js'));
const { readTree, writeTree, command } = require('../../src/web/worker.js');

function* filesBelow(folder, below = '') {
    for (const e of fs.readdirSync(path.join(folder, below), { withFileTypes: true })) {
        const at = below ? `${below}/${e.name}` : e.name;
        if (fs.statSync(path.join(folder, at)).isDirectory()) yield* filesBelow(folder, at);
        else yield at;
    }
}

const CLOSE = 1e-4; // of a number of 1 or less, or of its size

// The largest difference of the numbers of two PLYs.
function apart(a, b) {
    const numbers = (bytes) => {
        const at = Buffer.from(bytes).indexOf('end_header\n') + 11;
        return new Float32Array(new Uint8Array(bytes.subarray(at)).buffer);
    };
    const [x, y] = [numbers(a), numbers(b)];
    return x.reduce((most, v, i) => Math.max(most, v === y[i] ? 0 : Math.abs(v - y[i]) / Math.max(1, Math.abs(v))), 0);
}

const sum = (bytes) => crypto.createHash('sha256').update(bytes).digest('hex').slice(0, 16);

(async () => {
    let wrong = 0, same = 0, close = 0, most = 0;
    const said = [], say = (stream, text) => said.push(text), base = path.basename(run);
    const { code, module } = await command(['import', `/in/${base}`, '-o', '/bundle/clip.spin', '-q', ...(frames ? ['--frames', frames] : [])], say, ({ FS }) => {
        const folder = fs.statSync(run).isDirectory();
        writeTree(FS, [...(folder ? filesBelow(run) : [''])].map((f) => [f ? `/in/${base}/${f}` : `/in/${base}`, fs.readFileSync(path.join(run, f))]));
        FS.mkdir('/bundle');
    });
    if (code) throw new Error(`import ends with ${code}: ${said.join(' ')}`);
    const clip = readTree(module.FS, '/bundle');
    for (const to of ['ply', 'gltf', 'spz']) {
        const there = fs.existsSync(path.join(native, to));
        const done = await command(['export', '/bundle/clip.spin', '--to', to, '-o', `/out/${to}`, '-q'], say, ({ FS }) => {
            writeTree(FS, clip);
            FS.mkdir('/out');
        });
        if ((done.code === 0) !== there) throw new Error(`${to} ends with ${done.code}: ${said.join(' ')}`);
        if (!there) continue;
        const here = new Map(readTree(done.module.FS, `/out/${to}`)), names = [...filesBelow(path.join(native, to))];
        if (names.length !== here.size) throw new Error(`${to}: ${here.size} files, not ${names.length}`);
        for (const f of names) {
            const ours = here.get(`/out/${to}/${f}`), theirs = fs.readFileSync(path.join(native, to, f));
            const equal = ours && sum(ours) === sum(theirs), size = ours && ours.length === theirs.length;
            const d = size && !equal && to === 'ply' && f.endsWith('.ply') ? apart(theirs, ours) : 0;
            if (equal) same++;
            else if (frames && (to !== 'ply' || (size && d <= CLOSE))) {
                close++;
                most = Math.max(most, d);
            } else { wrong++; if (wrong < 4) console.log(`  differs: ${to}/${f}`); }
        }
    }
    if (same + close + wrong === 0) {
        console.log(`  left  ${name}: positions alone, of which nothing is exported here or there`);
        process.exit(0);
    }
    console.log(`  ${wrong ? 'FAIL' : 'ok  '}  ${name}: ${same} files have the same bytes${close ? `, ${close} are ${most.toExponential(1)} apart` : ''}${wrong ? `, ${wrong} have not` : ''}`);
    process.exit(wrong ? 1 : 0);
})().catch((e) => {
    console.log(`  FAIL  ${name}: ${String(e.message ?? e).slice(0, 400)}`);
    process.exit(1);
});
