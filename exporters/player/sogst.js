// Reads the .sogst file named by ?src=, converts it to the clip and the 4D splats that the web page
// expects, and starts that page.
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

// Returns the parts of a clip in order, as [folder, first splat, last splat + 1].
function partsOf({ segments, streams }, n) {
    if (!streams) return [['', 0, n]];
    const names = listOf(streams.segments, 'list of streams', MOST_SEGMENTS), list = listOf(segments?.list, 'list of segments', names.length);
    let at = 0;
    const parts = [[streams.persistent, segments.persistent], ...names.map((name, k) => [name, list[k]?.range])].map(([name, range]) => {
        const [from, end] = numbers(range, 'range of a segment', 2);
        if (from !== at || whole(end, 'end of a segment', from, n) === from) return [name, at, at];
        return [name, from, at = end];
    });
    return at === n ? parts : fail(`its segments contain ${at} of ${n} splats`);
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

function entriesOf(bytes) {
    const view = new DataView(bytes.buffer), entries = new Map();
    let end = bytes.length - 22;
    while (end >= 0 && view.getUint32(end, true) !== 0x06054b50) end--;
    if (end < 0) fail('it is not a ZIP');
    for (let n = view.getUint16(end + 10, true), at = view.getUint32(end + 16, true); n > 0; n--) {
        const name = view.getUint16(at + 28, true), local = view.getUint32(at + 42, true), size = view.getUint32(at + 20, true);
        if (view.getUint32(at, true) !== 0x02014b50 || view.getUint16(at + 10, true) !== 0) fail('it has a compressed entry');
        const from = local + 30 + view.getUint16(local + 26, true) + view.getUint16(local + 28, true);
        if (from + size > end) fail('it has an entry beyond its end');
        entries.set(new TextDecoder().decode(bytes.subarray(at + 46, at + 46 + name)), bytes.subarray(from, from + size));
        at += 46 + name + view.getUint16(at + 30, true) + view.getUint16(at + 32, true);
    }
    return entries;
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
    return { width, out };
}

// ---- Splats -------------------------------------------------------------------------------------

// Decodes three coordinates per splat. Their signed logarithms are stored as 16-bit numbers, whose
// low and high bytes are in two images.
function path(out, from, n, range, low, high) {
    const mins = numbers(range.mins, 'mins', 3), maxs = numbers(range.maxs, 'maxs', 3);
    for (let i = 0; i < n; i++) {
        for (let c = 0; c < 3; c++) {
            const x = mins[c] + (maxs[c] - mins[c]) * (low[4 * i + c] + 256 * high[4 * i + c]) / 65535;
            out[3 * (from + i) + c] = number(Math.sign(x) * Math.expm1(Math.abs(x)), 'place');
        }
    }
}

// Reads n splats, beginning at splat `from`, from the images in a folder.
async function group(s, meta, entries, folder, from, n, sh) {
    const picture = async (of, k = 0) => {
        const name = folder ? `${folder}/${of.files[k]}` : of.files[k];
        return (await pixelsOf(entries.get(name), name, n)).out;
    };
    for (const [name, to] of [['means', s.place], ['motion', s.velocity], ['accel', s.accel]]) if (meta[name]) path(to, from, n, meta[name], await picture(meta[name]), await picture(meta[name], 1));
    const scales = await picture(meta.scales), colours = await picture(meta.sh0), quats = await picture(meta.quats), times = await picture(meta.trbf), books = [meta.scales, meta.sh0, meta.trbf.center, meta.trbf.sigma].map((of) => numbers(of.codebook, 'codebook', BOOK)), labels = sh && await picture(meta.shN, 1);
    for (let i = 0, r = from; i < n; i++, r++) {
        for (let c = 0; c < 3; c++) {
            s.scale[3 * r + c] = number(Math.exp(books[0][scales[4 * i + c]]), 'scale');
            s.colour[3 * r + c] = 0.5 + 0.28209479177387814 * books[1][colours[4 * i + c]];
        }
        s.alpha[r] = colours[4 * i + 3] / 255;
        s.centre[r] = books[2][times[4 * i]];
        s.sigma[r] = books[3][times[4 * i + 1]];
        const left = quats[4 * i + 3] - 252, kept = [0, 1, 2].map((c) => (quats[4 * i + c] / 127.5 - 1) * Math.SQRT1_2);
        if (left < 0) fail('it has an invalid rotation');
        kept.splice(left, 0, Math.sqrt(Math.max(0, 1 - kept.reduce((sum, v) => sum + v * v, 0))));
        const size = Math.hypot(...kept);
        for (let c = 0; c < 4; c++) s.quat[4 * r + c] = kept[c] / size;
        if (sh) sh(r, labels[4 * i] + 256 * labels[4 * i + 1]);
    }
}

// Returns a function that copies an entry of the SH palette to a row. The palette is an image with
// 64 entries per row.
async function paletteOf(s, { shN }, entries, coefficients) {
    const count = whole(shN.count, 'count of shN', 1, MOST_PALETTE), book = numbers(shN.codebook, 'codebook', BOOK), { width, out } = await pixelsOf(entries.get(shN.files[0]), shN.files[0], 64 * coefficients * Math.ceil(count / 64));
    if (width !== 64 * coefficients) fail('its SH palette does not match its degree');
    return (row, entry) => {
        if (entry >= count) fail(`it has entry ${entry} of a palette of ${count}`);
        for (let k = 0; k < coefficients; k++) {
            const at = 4 * ((entry >> 6) * width + (entry & 63) * coefficients + k);
            for (let c = 0; c < 3; c++) s.sh[3 * (coefficients * row + k) + c] = book[out[at + c]];
        }
    };
}

async function read(bytes) {
    const entries = entriesOf(bytes), meta = JSON.parse(new TextDecoder().decode(entries.get('meta.json') ?? fail('it has no meta.json'))), bands = meta.shN ? whole(meta.shN.bands, 'bands of shN', 1, 3) : 0, coefficients = (bands + 1) ** 2 - 1;
    if (meta.format !== 'sogst' || meta.version !== 1) fail(`it is of format ${meta.format}, version ${meta.version}`);
    const n = whole(meta.count, 'count', 1, bytes.length + MOST_SPLATS), { min, max, fps } = meta.time ?? fail('it has no times');
    number(fps, 'frame rate', 1e-3, 1e4);
    number((number(max, 'end') - number(min, 'begin')) * fps, 'number of frames', 0, MOST_FRAMES - 1);
    if (meta.cov2d_scale?.some((v) => v !== 1)) fail('its cov2d_scale is not supported');
    const parts = partsOf(meta, n), many = (k) => new Float32Array(k * n), s = { n, coefficients, place: many(3), velocity: many(3), accel: many(3), scale: many(3), colour: many(3), quat: many(4), alpha: many(1), centre: many(1), sigma: many(1), sh: many(3 * coefficients) };
    const sh = bands && await paletteOf(s, meta, entries, coefficients);
    for (const [folder, from, end] of parts) if (end > from) await group(s, meta, entries, folder, from, end - from, sh);
    return { s, meta, bands };
}

// ---- The page's clip ----------------------------------------------------------------------------

// Describes the clip as the JSON of a page does. The first view shows the region that contains most
// of the splats; the axes of these files are x right, y down, z forward.
function clipOf(name, { s, meta, bands }) {
    const { min, max, fps } = meta.time, sides = [0, 1, 2].map((c) => {
        const x = Float32Array.from({ length: s.n }, (_, i) => s.place[3 * i + c]).sort();
        return [x[Math.floor(0.05 * (s.n - 1))], x[Math.ceil(0.95 * (s.n - 1))]];
    }), centre = sides.map(([a, b]) => (a + b) / 2), size = Math.max(1e-6, ...sides.map(([a, b]) => (b - a) / 2));
    return {
        name, fps, size, centre, fovy: 50, aspect: 16 / 9, near: 0.01 * size, background: [0, 0, 0], up: [0, -1, 0], target: centre, eye: [centre[0], centre[1] - 0.5 * size, centre[2] - 3 * size], reach: [0.2 * size, 6 * size],
        numbers: Array.from({ length: Math.round((max - min) * fps) + 1 }, (_, i) => i), versions: [{ name: 'clip', label: 'As it is', degree: bands, sh: 3 * s.coefficients, antialias: meta.model === 'antialiased', splats: [], moves: true }]
    };
}

try {
    const address = new URL(new URL(location.href).searchParams.get('src') ?? fail('the address has no ?src='), location.href), answer = await fetch(/^(https?|blob|file):$/.test(address.protocol) ? address : fail(`an address of ${address.protocol} is not allowed`));
    if (!answer.ok) fail(`${answer.status} ${answer.statusText}`);
    const made = await read(new Uint8Array(await answer.arrayBuffer())), clip = clipOf(decodeURIComponent(address.pathname.split('/').pop()).replace(/\.sogst$/, ''), made);
    $('clip').textContent = JSON.stringify(clip);
    document.title = clip.name;
    window.spinMoving = { ...made.s, first: made.meta.time.min };
    document.body.append(Object.assign(document.createElement('script'), { textContent: $('page').textContent }));
} catch (e) {
    $('message').textContent = `The clip cannot be read: ${e.message}`;
    window.parent.postMessage({ spin4d: { error: `spin4d: ${e.message}` } }, '*');
}
})();
