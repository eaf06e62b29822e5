// Reads the .sogst file named by ?src=, converts it to the clip and the 4D splats that the web page
// expects, and starts that page. Of a file on a server that supports range requests, only the
// segments that the page asks for are fetched.
'use strict';

(async () => {
const $ = (id) => document.getElementById(id);
const fail = (text) => { throw new Error(text); };

// ---- Limits: a small malicious file must not crash the tab --------------------------------------

// The limits are those of src/formats/sog_4d.c and sogst.c, except MOST_FRAMES.
const SLACK = 4096, MOST_SPLATS = 2 ** 20, MOST_SEGMENTS = 65536, MOST_PALETTE = 65536, MOST_FRAMES = 2 ** 18, BOOK = 256, FLOAT = 3.4028234663852886e38;
const number = (v, name, least = -FLOAT, most = FLOAT) => (typeof v === 'number' && v >= least && v <= most ? v : fail(`its ${name} is not a number from ${least} to ${most}`));
const whole = (v, name, least, most) => (Number.isInteger(number(v, name, least, most)) ? v : fail(`its ${name} is not a whole number`));
const numbers = (list, name, n) => (Array.isArray(list) && list.length === n ? list.map((v) => number(v, name)) : fail(`its ${name} is not ${n} numbers`));
const listOf = (list, name, most) => (Array.isArray(list) && list.length <= most ? list : fail(`its ${name} is not a list of at most ${most}`));

// Returns the parts of a clip in order: the persistent splats and the segments, each with its
// folder, its number of splats n, and the first and the last time at which a splat is visible.
function partsOf({ segments, streams, time }, n) {
    if (!streams) return [{ folder: '', n, first: -FLOAT, last: FLOAT }];
    const names = listOf(streams.segments, 'list of streams', MOST_SEGMENTS), list = listOf(segments?.list, 'list of segments', names.length);
    // Readers round the centres of time windows, to 256 values, so that a splat may be visible
    // somewhat before or after the times of its segment.
    const slack = (time.max - time.min) / 256;
    let at = 0;
    const parts = [[streams.persistent, segments.persistent, -FLOAT, FLOAT], ...names.map((name, k) => [name, list[k]?.range, list[k]?.t0, list[k]?.t1])].map(([folder, range, t0, t1]) => {
        const [from, end] = numbers(range, 'range of a segment', 2);
        if (from !== at || whole(end, 'end of a segment', from, n) === from) return { n: 0 };
        at = end;
        return { folder, n: end - from, first: number(t0, 'begin of a segment') - slack, last: number(t1, 'end of a segment') + slack };
    });
    return at === n ? parts.filter((p) => p.n) : fail(`its segments contain ${at} of ${n} splats`);
}

// Returns the width and height of a lossless WebP from its chunks, so that the size can be checked
// before the image is decoded.
function sizeOf(bytes, name) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.length), word = (at) => String.fromCharCode(...bytes.subarray(at, at + 4));
    if (bytes.length < 30 || word(0) !== 'RIFF' || word(8) !== 'WEBP') fail(`${name} is not a WebP`);
    let canvas = null;
    for (let at = 12, n = 0; at + 18 <= bytes.length; at += 8 + n + n % 2) {
        n = view.getUint32(at + 4, true);
        if (word(at) === 'VP8X') canvas = [1 + (view.getUint32(at + 12, true) & 0xffffff), 1 + (view.getUint32(at + 14, true) >>> 8)];
        else if (word(at) === 'VP8L') {
            const size = view.getUint32(at + 9, true), sides = [1 + (size & 0x3fff), 1 + (size >>> 14 & 0x3fff)];
            return !canvas || canvas.every((v, k) => v === sides[k]) ? sides : fail(`${name} has two sizes`);
        } else if (/^(VP8|AL|AN)/.test(word(at))) break;
    }
    return fail(`${name} is not a lossless WebP`);
}

// ---- The file: a ZIP of stored entries ----------------------------------------------------------

// The first request asks for HEAD bytes, and the second for the last TAIL bytes. Entries whose
// distance is less than GAP bytes are fetched in one request.
const HEAD = 65536, TAIL = 65536, GAP = 65536;

// Opens a file. at(from, to) of the result returns a range of its bytes. If the server ignores
// ranges, or does not state the size of the file, the whole file is read.
async function openFile(address) {
    const get = async (headers) => { const answer = await fetch(address, { headers }); return answer.ok ? answer : fail(`${answer.status} ${answer.statusText}`); };
    const bytesOf = async (answer) => new Uint8Array(await answer.arrayBuffer());
    let answer = await get({ Range: `bytes=0-${HEAD - 1}` });
    const size = Number(/^bytes 0-\d+\/(\d+)$/.exec(answer.headers.get('Content-Range') ?? '')?.[1] ?? 0);
    if (answer.status === 206 && !size) answer = await get({});
    const known = await bytesOf(answer);
    if (answer.status !== 206) return { size: known.length, at: (from, to) => known.subarray(from, to) };
    return { size, at: async (from, to) => {
        if (to <= known.length) return known.subarray(from, to);
        const part = await get({ Range: `bytes=${from}-${to - 1}` }), bytes = await bytesOf(part), read = part.status === 206 ? bytes : bytes.subarray(from, to);
        return read.length === to - from ? read : fail('the server sends too few bytes');
    } };
}

// Reads the directory of a file. The result is a function that returns the contents of entries by
// their names. A name is missing in these if the file does not contain the entry. Calls that are
// made at the same time share requests for entries that are close to one another in the file.
async function directoryOf(file) {
    const tail = Math.max(0, file.size - TAIL), last = await file.at(tail, file.size), view = (b) => new DataView(b.buffer, b.byteOffset, b.length);
    let end = last.length - 22;
    while (end >= 0 && view(last).getUint32(end, true) !== 0x06054b50) end--;
    if (end < 0) fail('it is not a ZIP');
    const count = view(last).getUint16(end + 10, true), first = view(last).getUint32(end + 16, true), places = new Map();
    if (first > tail + end) fail('its directory is beyond its end');
    const directory = first >= tail ? last.subarray(first - tail, end) : await file.at(first, tail + end), d = view(directory);
    for (let n = count, at = 0; n > 0; n--) {
        if (at + 46 > directory.length || d.getUint32(at, true) !== 0x02014b50 || d.getUint16(at + 10, true) !== 0) fail('it has a compressed entry');
        const name = d.getUint16(at + 28, true);
        places.set(new TextDecoder().decode(directory.subarray(at + 46, at + 46 + name)), { at: d.getUint32(at + 42, true), size: d.getUint32(at + 20, true) });
        at += 46 + name + d.getUint16(at + 30, true) + d.getUint16(at + 32, true);
    }
    // An entry ends before the next one begins.
    const begins = [...new Set([...[...places.values()].map((p) => p.at), first])].sort((a, b) => a - b), follows = new Map(begins.map((at, i) => [at, begins[i + 1] ?? first]));
    const read = async (names) => {
        const found = new Map(), runs = [];
        for (const [name, p] of names.filter((each) => places.has(each)).map((each) => [each, places.get(each)]).sort((x, y) => x[1].at - y[1].at)) {
            const to = follows.get(p.at), run = runs.at(-1);
            if (p.at + 30 + p.size > Math.min(to, first)) fail('it has an entry beyond its end');
            if (run && p.at - run.to < GAP) Object.assign(run, { to, list: [...run.list, [name, p]] });
            else runs.push({ from: p.at, to, list: [[name, p]] });
        }
        await Promise.all(runs.map(async ({ from, to, list }) => {
            const bytes = await file.at(from, to), v = view(bytes);
            for (const [name, p] of list) {
                const at = p.at - from + 30 + v.getUint16(p.at - from + 26, true) + v.getUint16(p.at - from + 28, true);
                if (at + p.size > bytes.length) fail('it has an entry beyond its end');
                found.set(name, bytes.subarray(at, at + p.size));
            }
        }));
        return found;
    };
    let batch = null;
    return (names) => {
        batch ??= { names: new Set(), found: Promise.resolve().then(() => { const all = [...batch.names]; batch = null; return read(all); }) };
        for (const name of names) batch.names.add(name);
        return batch.found;
    };
}

// Decodes a lossless image to R G B A bytes by WebGL: a 2D canvas would premultiply colours by
// opacities and lose bits.
const gl = document.createElement('canvas').getContext('webgl2') ?? fail('this browser does not support WebGL 2');
gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
async function pixelsOf(bytes, name, n) {
    const [width, height] = sizeOf(bytes ?? fail(`it has no ${name}`), name), out = width * height >= n && width * height <= 2 * n + SLACK ? new Uint8Array(4 * width * height) : fail(`${name} has ${width}x${height} pixels for ${n} values`);
    const picture = await createImageBitmap(new Blob([bytes], { type: 'image/webp' }), { premultiplyAlpha: 'none', colorSpaceConversion: 'none' });
    if (picture.width !== width || picture.height !== height) fail(`${name} has two sizes`);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, gl.getParameter(gl.TEXTURE_BINDING_2D), 0);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, out);
    picture.close();
    return { width, out };
}

// ---- Splats -------------------------------------------------------------------------------------

// Decodes three coordinates per splat. Their signed logarithms are stored as 16-bit numbers, whose
// low and high bytes are in two images.
function path(out, n, range, low, high) {
    const mins = numbers(range.mins, 'mins', 3), maxs = numbers(range.maxs, 'maxs', 3);
    for (let i = 0; i < n; i++) {
        for (let c = 0; c < 3; c++) {
            const x = mins[c] + (maxs[c] - mins[c]) * (low[4 * i + c] + 256 * high[4 * i + c]) / 65535;
            out[3 * i + c] = number(Math.sign(x) * Math.expm1(Math.abs(x)), 'place');
        }
    }
}

const nameIn = (folder, of, k = 0) => (folder ? `${folder}/${of.files[k]}` : of.files[k]);

// Reads the n splats of a part, whose images are in a folder, without SH above degree 0.
async function geometryOf(meta, entriesOf, { folder, n }, coefficients) {
    const many = (k) => new Float32Array(k * n), s = { n, place: many(3), velocity: many(3), accel: many(3), scale: many(3), colour: many(3), quat: many(4), alpha: many(1), centre: many(1), sigma: many(1), sh: many(3 * coefficients) };
    const paths = [['means', s.place], ['motion', s.velocity], ['accel', s.accel]].filter(([name]) => meta[name]), others = [meta.scales, meta.sh0, meta.quats, meta.trbf];
    const entries = await entriesOf([...paths.flatMap(([name]) => [nameIn(folder, meta[name]), nameIn(folder, meta[name], 1)]), ...others.map((of) => nameIn(folder, of))]);
    const picture = async (of, k = 0) => (await pixelsOf(entries.get(nameIn(folder, of, k)), nameIn(folder, of, k), n)).out;
    for (const [name, to] of paths) path(to, n, meta[name], await picture(meta[name]), await picture(meta[name], 1));
    const scales = await picture(meta.scales), colours = await picture(meta.sh0), quats = await picture(meta.quats), times = await picture(meta.trbf), books = [meta.scales, meta.sh0, meta.trbf.center, meta.trbf.sigma].map((of) => numbers(of.codebook, 'codebook', BOOK));
    for (let i = 0; i < n; i++) {
        for (let c = 0; c < 3; c++) {
            s.scale[3 * i + c] = number(Math.exp(books[0][scales[4 * i + c]]), 'scale');
            s.colour[3 * i + c] = 0.5 + 0.28209479177387814 * books[1][colours[4 * i + c]];
        }
        s.alpha[i] = colours[4 * i + 3] / 255;
        s.centre[i] = books[2][times[4 * i]];
        s.sigma[i] = books[3][times[4 * i + 1]];
        const left = quats[4 * i + 3] - 252, kept = [0, 1, 2].map((c) => (quats[4 * i + c] / 127.5 - 1) * Math.SQRT1_2);
        if (left < 0) fail('it has an invalid rotation');
        kept.splice(left, 0, Math.sqrt(Math.max(0, 1 - kept.reduce((sum, v) => sum + v * v, 0))));
        const size = Math.hypot(...kept);
        for (let c = 0; c < 4; c++) s.quat[4 * i + c] = kept[c] / size;
    }
    return s;
}

// Reads the SH palette, an image with 64 entries per row. The result copies an entry to a row.
async function paletteOf({ shN }, entriesOf, coefficients) {
    const { count, codebook: book, files: [name] } = shN, { width, out } = await pixelsOf((await entriesOf([name])).get(name), name, 64 * coefficients * Math.ceil(count / 64));
    if (width !== 64 * coefficients) fail('its SH palette does not match its degree');
    return (sh, row, entry) => {
        if (entry >= count) fail(`it has entry ${entry} of a palette of ${count}`);
        for (let k = 0; k < coefficients; k++) {
            const at = 4 * ((entry >> 6) * width + (entry & 63) * coefficients + k);
            for (let c = 0; c < 3; c++) sh[3 * (coefficients * row + k) + c] = book[out[at + c]];
        }
    };
}

// Reads the metadata. load(k) of the result reads the splats of a part. addSh(loading, k) reads
// their SH at the same time, and resolves to the splats with SH.
async function open(address) {
    const file = await openFile(address), entriesOf = await directoryOf(file), meta = JSON.parse(new TextDecoder().decode((await entriesOf(['meta.json'])).get('meta.json') ?? fail('it has no meta.json'))), bands = meta.shN ? whole(meta.shN.bands, 'bands of shN', 1, 3) : 0, coefficients = (bands + 1) ** 2 - 1;
    if (meta.format !== 'sogst' || meta.version !== 1) fail(`it is of format ${meta.format}, version ${meta.version}`);
    const n = whole(meta.count, 'count', 1, file.size + MOST_SPLATS), { min, max, fps } = meta.time ?? fail('it has no times');
    number(fps, 'frame rate', 1e-3, 1e4);
    number((number(max, 'end') - number(min, 'begin')) * fps, 'number of frames', 0, MOST_FRAMES - 1);
    if (meta.cov2d_scale?.some((v) => v !== 1)) fail('its cov2d_scale is not supported');
    if (bands) whole(meta.shN.count, 'count of shN', 1, MOST_PALETTE);
    if (bands) numbers(meta.shN.codebook, 'codebook', BOOK);
    const parts = partsOf(meta, n);
    let palette = null;
    const addSh = async (loading, { folder, n: count }) => {
        palette ??= paletteOf(meta, entriesOf, coefficients);
        const name = nameIn(folder, meta.shN, 1), [s, copy, labels] = await Promise.all([loading, palette, entriesOf([name]).then(async (entries) => (await pixelsOf(entries.get(name), name, count)).out)]);
        for (let i = 0; i < count; i++) copy(s.sh, i, labels[4 * i] + 256 * labels[4 * i + 1]);
        return s;
    };
    return { meta, bands, coefficients, parts, load: (k) => geometryOf(meta, entriesOf, parts[k], coefficients), addSh: (loading, k) => (bands ? addSh(loading, parts[k]) : loading) };
}

// ---- The page's clip ----------------------------------------------------------------------------

// Describes the clip as the JSON of a page does. The first view shows the region that contains most
// of the splats of the parts `shown`. In these files, x points right, y down and z forward.
function clipOf(name, { meta, bands, coefficients }, shown) {
    const { min, max, fps } = meta.time, sides = [0, 1, 2].map((c) => {
        const x = Float32Array.from(shown.flatMap((s) => Array.from({ length: s.n }, (_, i) => s.place[3 * i + c]))).sort();
        return [x[Math.floor(0.05 * (x.length - 1))], x[Math.ceil(0.95 * (x.length - 1))]];
    }), centre = sides.map(([a, b]) => (a + b) / 2), size = Math.max(1e-6, ...sides.map(([a, b]) => (b - a) / 2));
    return {
        name, fps, size, centre, fovy: 50, aspect: 16 / 9, near: 0.01 * size, background: [0, 0, 0], up: [0, -1, 0], target: centre, eye: [centre[0], centre[1] - 0.5 * size, centre[2] - 3 * size], reach: [0.2 * size, 6 * size],
        numbers: Array.from({ length: Math.round((max - min) * fps) + 1 }, (_, i) => i), versions: [{ name: 'clip', label: 'As it is', degree: bands, sh: 3 * coefficients, antialias: meta.model === 'antialiased', splats: [], moves: true, draft: bands ? {} : undefined }]
    };
}

try {
    const address = new URL(new URL(location.href).searchParams.get('src') ?? fail('the address has no ?src='), location.href);
    if (!/^(https?|blob|file):$/.test(address.protocol)) fail(`an address of ${address.protocol} is not allowed`);
    if (address.protocol === 'file:') fail('browsers do not let pages read local files. Put the page and the clip on a web server, such as "python3 -m http.server" in their folder');
    const made = await open(address), { min } = made.meta.time, visible = (p) => p.first <= min && min <= p.last, firstParts = made.parts.flatMap((p, k) => (visible(p) ? [k] : []));
    // The parts that are visible at the beginning are read once, for the first view, for the draft,
    // which lacks SH above degree 0, and for the page.
    const read = new Map();
    await Promise.all((firstParts.length ? firstParts : [0]).map(async (k) => { read.set(k, await made.load(k)); }));
    const clip = clipOf(decodeURIComponent(address.pathname.split('/').pop()).replace(/\.sogst$/, ''), made, [...read.values()]);
    $('clip').textContent = JSON.stringify(clip);
    document.title = clip.name;
    window.spinMoving = { first: min, parts: made.parts, load: async (k, draft) => {
        if (draft && read.has(k)) return structuredClone(read.get(k));
        const loading = read.get(k) ?? made.load(k);
        read.delete(k);
        return made.addSh(loading, k);
    } };
    document.body.append(Object.assign(document.createElement('script'), { textContent: $('page').textContent }));
} catch (e) {
    $('message').textContent = `The clip cannot be read: ${e.message}`;
    window.parent.postMessage({ spin4d: { error: `spin4d: ${e.message}` } }, '*');
}
})();
