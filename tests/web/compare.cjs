// compare.cjs WEB NAME RUN NATIVE [FRAMES]: the run through import and export in WebAssembly; every file must have the bytes of that
// which the commands of this machine wrote to NATIVE, and what they could not write must fail. This includes runs with a network,
// whose products are computed without FMA and whose functions, such as exp and sin, are rounded from double.
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

// The number of values by which two PLYs differ, and the largest difference, of a value of 1 or less or relative to its size.
function apart(a, b) {
    const numbers = (bytes) => {
        const at = Buffer.from(bytes).indexOf('end_header\n') + 11;
        return new Float32Array(new Uint8Array(bytes.subarray(at)).buffer);
    };
    const [x, y] = [numbers(a), numbers(b)];
    const off = Array.from(x, (v, i) => Math.abs(v - y[i]) / Math.max(1, Math.abs(v))).filter((d) => d !== 0);
    return `${off.length} of ${x.length} values, by up to ${Math.max(0, ...off).toExponential(1)}`;
}

const sum = (bytes) => crypto.createHash('sha256').update(bytes).digest('hex').slice(0, 16);

(async () => {
    let wrong = 0, same = 0;
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
            if (ours && sum(ours) === sum(theirs)) same++;
            else if (++wrong < 4) console.log(`  differs: ${to}/${f}${f.endsWith('.ply') && ours?.length === theirs.length ? `: ${apart(theirs, ours)}` : ''}`);
        }
    }
    if (same + wrong === 0) {
        console.log(`  left  ${name}: positions alone, of which nothing is exported here or there`);
        process.exit(0);
    }
    console.log(`  ${wrong ? 'FAIL' : 'ok  '}  ${name}: ${same} files have the same bytes${wrong ? `, ${wrong} have not` : ''}`);
    process.exit(wrong ? 1 : 0);
})().catch((e) => {
    console.log(`  FAIL  ${name}: ${String(e.message ?? e).slice(0, 400)}`);
    process.exit(1);
});
