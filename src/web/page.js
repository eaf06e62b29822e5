'use strict';
const $ = (id) => document.getElementById(id);
const worker = new Worker(URL.createObjectURL(new Blob([$('worker').textContent], { type: 'text/javascript' })));
const waiting = new Map();
let count = 0, busy = false, name = 'clip';

// Runs a task in the worker and shows the output of the task. Resolves to the task's result.
function ask(task, rest = {}) {
    const id = ++count;
    return new Promise((resolve) => {
        waiting.set(id, resolve);
        worker.postMessage({ id, task, ...rest });
    });
}
worker.onmessage = ({ data }) => {
    if (data.done) {
        waiting.get(data.id)(data.done);
        waiting.delete(data.id);
    } else if (/ left\b/.test(data.text) && /%/.test(data.text)) $('now').textContent = data.text;
    else print(data.stream, data.text);
};
worker.onerror = (e) => print('err', `the worker failed: ${e.message}`);

function print(stream, text) {
    const line = document.createElement('div');
    if (stream === 'err' && /^spin-|^the /.test(text)) line.className = 'err';
    line.textContent = text;
    $('log').hidden = false;
    $('log').append(line);
    $('log').scrollTop = $('log').scrollHeight;
}

// Runs work() with all buttons disabled. Does nothing while another task runs.
async function alone(what, work) {
    if (busy) return;
    busy = true;
    $('now').textContent = what;
    document.querySelectorAll('button').forEach((b) => { b.disabled = true; });
    try {
        await work();
    } catch (e) {
        print('err', String(e.message ?? e));
    }
    document.querySelectorAll('button').forEach((b) => { b.disabled = false; });
    $('now').textContent = '';
    busy = false;
}

// Imports files, [{ name: path, data: File }], and shows the clip. The input of the import is the
// common folder of the files.
function open(files) {
    if (!files.length) return;
    const top = new Set(files.map((f) => f.name.split('/')[0]));
    let input = files[0].name.split('/')[0];
    if (top.size > 1) { // move files without a common folder into a new one
        input = 'files';
        files = files.map((f) => ({ name: `files/${f.name}`, data: f.data }));
    }
    name = input.replace(/\.[^.]*$/, '').replace(/[^\w.+-]+/g, '_') || 'clip';
    const options = [];
    if ($('from').value) options.push('--from', $('from').value);
    if ($('frames').value) options.push('--frames', $('frames').value);
    return alone('reading the files', async () => {
        $('log').replaceChildren();
        $('clip').hidden = true;
        if ((await ask('import', { files, input, name, options })).code) return;
        $('now').textContent = 'preparing the player';
        const page = await ask('export', { to: 'html', name: 'clip.html' });
        if (page.code) print('err', 'the clip cannot be shown here, but it can be saved');
        const old = $('player').src;
        $('player').src = page.code ? 'about:blank' : URL.createObjectURL(new Blob([page.files[0][1]], { type: 'text/html' }));
        if (old.startsWith('blob:')) URL.revokeObjectURL(old);
        $('player').hidden = page.code !== 0;
        $('clip').hidden = false;
    });
}

$('file').onclick = () => $('files').click();
$('folder').onclick = () => $('folders').click();
for (const id of ['files', 'folders']) $(id).onchange = (e) => {
    const files = [...e.target.files].map((f) => ({ name: f.webkitRelativePath || f.name, data: f }));
    e.target.value = '';
    open(files);
};

// Adds all files below a dropped entry to `out`.
async function below(entry, out) {
    if (entry.isFile) {
        out.push({ name: entry.fullPath.slice(1), data: await new Promise((yes, no) => entry.file(yes, no)) });
        return;
    }
    const reader = entry.createReader();
    for (;;) { // browsers return at most a hundred entries per call
        const some = await new Promise((yes, no) => reader.readEntries(yes, no));
        if (!some.length) return;
        for (const e of some) await below(e, out);
    }
}
document.ondragover = (e) => { e.preventDefault(); $('drop').classList.add('over'); };
document.ondragleave = () => $('drop').classList.remove('over');
document.ondrop = async (e) => {
    e.preventDefault();
    $('drop').classList.remove('over');
    const entries = [...e.dataTransfer.items].map((item) => item.webkitGetAsEntry()).filter(Boolean), files = [];
    for (const entry of entries) await below(entry, files);
    open(files);
};

// ---- Saving -------------------------------------------------------------------------------------

const crcTable = Uint32Array.from({ length: 256 }, (_, n) => {
    for (let k = 0; k < 8; k++) n = n & 1 ? 0xedb88320 ^ n >>> 1 : n >>> 1;
    return n;
});

// Returns a zip archive of the files. They are stored, since most are already compressed. Zip64 is
// not used, so the archive cannot exceed 4 GB.
function zip(files) {
    const parts = [], directory = [], text = new TextEncoder();
    let at = 0, n = 0;
    for (const [path, bytes] of files) {
        let crc = ~0;
        for (let i = 0; i < bytes.length; i++) crc = crcTable[(crc ^ bytes[i]) & 255] ^ crc >>> 8;
        const label = text.encode(path), head = new DataView(new ArrayBuffer(46));
        head.setUint32(0, 0x504b0102);
        head.setUint16(4, 20, true);
        head.setUint16(6, 20, true);
        head.setUint16(8, 1 << 11, true); // names are UTF-8
        head.setUint16(14, 33, true); // 1 January 1980
        head.setUint32(16, ~crc, true);
        head.setUint32(20, bytes.length, true);
        head.setUint32(24, bytes.length, true);
        head.setUint16(28, label.length, true);
        head.setUint32(42, at, true);
        const local = new Uint8Array(30);
        local.set([0x50, 0x4b, 3, 4]);
        local.set(new Uint8Array(head.buffer, 6, 24), 4);
        parts.push(local, label, bytes);
        directory.push(new Uint8Array(head.buffer), label);
        at += 30 + label.length + bytes.length;
        n++;
    }
    const size = directory.reduce((sum, d) => sum + d.length, 0), end = new DataView(new ArrayBuffer(22));
    if (at + size > 0xffffffff || n > 0xffff) throw new Error('more than 4 GB or 65,535 files: save a smaller range');
    end.setUint32(0, 0x504b0506);
    end.setUint16(8, n, true);
    end.setUint16(10, n, true);
    end.setUint32(12, size, true);
    end.setUint32(16, at, true);
    return new Blob([...parts, ...directory, end]);
}

for (const button of document.querySelectorAll('[data-name]')) button.onclick = () => alone('writing the files', async () => {
    const { to, name: file } = button.dataset;
    const { code, files } = to ? await ask('export', { to, name: file }) : await ask('bundle');
    if (code) return;
    const one = files.length === 1 && !files[0][0].includes('/');
    const link = document.createElement('a');
    link.href = URL.createObjectURL(one ? new Blob([files[0][1]]) : zip(files));
    link.download = one ? (to ? file.replace(/^clip/, name) : files[0][0]) : `${name}-${file}.zip`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
});

ask('importers').then(({ list }) => {
    for (const one of list.filter((l) => l.tracks)) $('from').add(new Option(`${one.name}: ${one.summary}`, one.name));
    document.body.dataset.ready = 'yes';
});
