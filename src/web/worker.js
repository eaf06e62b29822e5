// Runs commands of spin4d in a worker. Each command runs in a new WebAssembly module, which has no
// state of earlier commands. The bundle is passed between commands as the bytes of its files.
let clip = [], bundle = '/bundle/clip.spin';

function readTree(FS, path, out = []) {
    if (!FS.isDir(FS.stat(path).mode)) out.push([path, FS.readFile(path)]);
    else for (const name of FS.readdir(path)) if (name !== '.' && name !== '..') readTree(FS, `${path}/${name}`, out);
    return out;
}

function writeTree(FS, files) {
    for (const [path, bytes] of files) {
        FS.mkdirTree(path.slice(0, path.lastIndexOf('/')) || '/');
        FS.writeFile(path, bytes);
    }
}

// Returns a function that collects bytes into lines and passes each line to say(). Progress lines
// end with a carriage return or begin with an escape sequence.
function lines(say) {
    const decoder = new TextDecoder();
    let bytes = [];
    const end = () => {
        const text = decoder.decode(new Uint8Array(bytes)).replace(/\x1b\[[0-9;]*[A-Za-z]/g, '').trim();
        bytes = [];
        if (text) say(text);
    };
    return (c) => {
        if (c === null || c === 10 || c === 13 || c === 27) end();
        if (c !== null && c !== 10 && c !== 13) bytes.push(c & 255);
    };
}

// Adds mmap() to emscripten's WORKERFS, which mounts dropped files without reading them. WORKERFS
// cannot map files, so this mmap() copies the requested part of a file.
function mapDropped(module) {
    const ops = module.WORKERFS.stream_ops;
    ops.mmap = (stream, address, length, position) => {
        const ptr = module._emscripten_builtin_memalign(65536, Math.ceil(length / 65536) * 65536) >>> 0;
        if (!ptr) throw new module.FS.ErrnoError(48);
        ops.read(stream, module.HEAPU8, ptr, length, position);
        return { ptr, allocated: true };
    };
}

// Runs a command and passes each line of its output to say(stream, line). Resolves to
// { code, module }.
async function command(args, say, before) {
    const module = await spin4d({ stdin: () => null, stdout: lines((t) => say('out', t)), stderr: lines((t) => say('err', t)) });
    before(module);
    let code = 1;
    try {
        code = module.callMain(args);
    } catch (e) {
        const memory = /memory|OOM|Aborted/i.test(String(e));
        say('err', memory ? 'out of memory: a page can use at most 4 GB' : `the command failed: ${String(e).slice(0, 200)}`);
    }
    return { code, module };
}

// Exports the bundle. Resolves to { code, files: [[name, bytes]] }.
async function exportClip(to, name, say) {
    const out = `/out/${name}`;
    const { code, module } = await command(['export', bundle, '-o', out, '--to', to], say, ({ FS }) => {
        writeTree(FS, clip);
        FS.mkdir('/out');
    });
    return { code, files: code ? [] : readTree(module.FS, out).map(([path, bytes]) => [path.slice('/out/'.length), bytes]) };
}

const tasks = {
    async importers(say) {
        let text = '';
        await command(['import', '--list', '--json'], (stream, t) => { if (stream === 'out') text += t; }, () => {});
        return { list: JSON.parse(text) };
    },
    async import(say, { files, input, name, options }) {
        const path = `/bundle/${name}.spin`;
        const { code, module } = await command(['import', `/in/${input}`, '-o', path, ...options], say, (m) => {
            mapDropped(m);
            m.FS.mkdir('/in');
            m.FS.mkdir('/bundle');
            m.FS.mount(m.WORKERFS, { blobs: files }, '/in');
        });
        if (!code) [clip, bundle] = [readTree(module.FS, '/bundle'), path];
        return { code };
    },
    async export(say, { to, name }) { return exportClip(to, name, say); },
    async bundle() { return { code: 0, files: clip.map(([path, bytes]) => [path.slice('/bundle/'.length), bytes]) }; },
};

if (typeof importScripts === 'function') onmessage = async ({ data: { id, task, ...rest } }) => {
    let result;
    try {
        result = await tasks[task]((stream, text) => postMessage({ id, stream, text }), rest);
    } catch (e) {
        result = { code: 1 };
        postMessage({ id, stream: 'err', text: String(e.message ?? e).slice(0, 300) });
    }
    postMessage({ id, done: result });
};
else module.exports = { readTree, writeTree, command };
