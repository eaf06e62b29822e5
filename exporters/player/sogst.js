// Reads a .sogst file, which ?src= names, for the page around: its clip, and what moves. Then the page begins.
'use strict';

(async () => {
const $ = (id) => document.getElementById(id);
const fail = (text) => { throw new Error(text); };

// ---- The file: a ZIP of stored entries ------------------------------------------------------------

function entriesOf(bytes) {
    const view = new DataView(bytes.buffer), entries = new Map();
    let end = bytes.length - 22;
    while (end >= 0 && view.getUint32(end, true) !== 0x06054b50) end--;
    if (end < 0) fail('it is no ZIP');
    for (let n = view.getUint16(end + 10, true), at = view.getUint32(end + 16, true); n > 0; n--) {
        const name = view.getUint16(at + 28, true), local = view.getUint32(at + 42, true), size = view.getUint32(at + 20, true);
        if (view.getUint32(at, true) !== 0x02014b50 || view.getUint16(at + 10, true) !== 0) fail('it has an entry that is not stored');
        const from = local + 30 + view.getUint16(local + 26, true) + view.getUint16(local + 28, true);
        if (from + size > end) fail('it has an entry beyond its end');
        entries.set(new TextDecoder().decode(bytes.subarray(at + 46, at + 46 + name)), bytes.subarray(from, from + size));
        at += 46 + name + view.getUint16(at + 30, true) + view.getUint16(at + 32, true);
    }
    return entries;
}

// A lossless picture's bytes, R G B A, as they are: a 2-D canvas would multiply colours by opacities.
const gl = document.createElement('canvas').getContext('webgl2') ?? fail('WebGL 2 is not offered');
gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
async function pixelsOf(bytes, name) {
    const picture = await createImageBitmap(new Blob([bytes ?? fail(`it has no ${name}`)], { type: 'image/webp' }), { premultiplyAlpha: 'none', colorSpaceConversion: 'none' });
    const { width, height } = picture, out = new Uint8Array(4 * width * height);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, gl.getParameter(gl.TEXTURE_BINDING_2D), 0);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, out);
    return { width, out };
}

// ---- Its splats -------------------------------------------------------------------------------------

// Three 16-bit numbers a splat, in two pictures; their logarithms were cut into steps.
function path(out, from, n, { mins, maxs }, low, high) {
    for (let i = 0; i < n; i++) {
        for (let c = 0; c < 3; c++) {
            const x = mins[c] + (maxs[c] - mins[c]) * (low[4 * i + c] + 256 * high[4 * i + c]) / 65535;
            out[3 * (from + i) + c] = Math.sign(x) * Math.expm1(Math.abs(x));
        }
    }
}

// Splats `from` on, whose pictures are in a folder.
async function group(s, meta, entries, folder, from, n, sh) {
    const picture = async (of, k = 0) => {
        const name = folder ? `${folder}/${of.files[k]}` : of.files[k], { out } = await pixelsOf(entries.get(name), name);
        return out.length >= 4 * n ? out : fail(`${name} has fewer than ${n} splats`);
    };
    for (const [name, to] of [['means', s.place], ['motion', s.velocity], ['accel', s.accel]]) if (meta[name]) path(to, from, n, meta[name], await picture(meta[name]), await picture(meta[name], 1));
    const scales = await picture(meta.scales), colours = await picture(meta.sh0), quats = await picture(meta.quats), times = await picture(meta.trbf), labels = sh && await picture(meta.shN, 1);
    for (let i = 0, r = from; i < n; i++, r++) {
        for (let c = 0; c < 3; c++) {
            s.scale[3 * r + c] = Math.exp(meta.scales.codebook[scales[4 * i + c]]);
            s.colour[3 * r + c] = 0.5 + 0.28209479177387814 * meta.sh0.codebook[colours[4 * i + c]];
        }
        s.alpha[r] = colours[4 * i + 3] / 255;
        s.centre[r] = meta.trbf.center.codebook[times[4 * i]];
        s.sigma[r] = meta.trbf.sigma.codebook[times[4 * i + 1]];
        const left = quats[4 * i + 3] - 252, kept = [0, 1, 2].map((c) => (quats[4 * i + c] / 127.5 - 1) * Math.SQRT1_2);
        if (left < 0) fail('it has a rotation of no kind');
        kept.splice(left, 0, Math.sqrt(Math.max(0, 1 - kept.reduce((sum, v) => sum + v * v, 0))));
        const size = Math.hypot(...kept);
        for (let c = 0; c < 4; c++) s.quat[4 * r + c] = kept[c] / size;
        if (sh) sh(r, labels[4 * i] + 256 * labels[4 * i + 1]);
    }
}

// SH by a palette: a picture with 64 entries side by side.
async function paletteOf(s, meta, entries, coefficients) {
    const { width, out } = await pixelsOf(entries.get(meta.shN.files[0]), meta.shN.files[0]);
    if (width !== 64 * coefficients) fail('its SH are of another degree');
    return (row, entry) => {
        for (let k = 0; k < coefficients; k++) {
            const at = 4 * ((entry >> 6) * width + (entry & 63) * coefficients + k);
            for (let c = 0; c < 3; c++) s.sh[3 * (coefficients * row + k) + c] = meta.shN.codebook[out[at + c]];
        }
    };
}

async function read(bytes) {
    const entries = entriesOf(bytes), meta = JSON.parse(new TextDecoder().decode(entries.get('meta.json') ?? fail('it has no meta.json'))), n = meta.count, bands = meta.shN?.bands ?? 0, coefficients = (bands + 1) ** 2 - 1;
    if (meta.format !== 'sogst' || meta.version !== 1) fail(`it is of format ${meta.format}, version ${meta.version}`);
    if (meta.cov2d_scale?.some((v) => v !== 1)) fail('its cov2d_scale is more than this page can draw');
    const many = (k) => new Float32Array(k * n), s = { n, coefficients, place: many(3), velocity: many(3), accel: many(3), scale: many(3), colour: many(3), quat: many(4), alpha: many(1), centre: many(1), sigma: many(1), sh: many(3 * coefficients) };
    const sh = bands && await paletteOf(s, meta, entries, coefficients), parts = meta.streams ? [[meta.streams.persistent, meta.segments.persistent], ...meta.streams.segments.map((name, k) => [name, meta.segments.list[k].range])] : [['', [0, n]]];
    for (const [folder, [from, end]] of parts) if (end > from) await group(s, meta, entries, folder, from, end - from, sh);
    return { s, meta, bands };
}

// ---- The page's clip ----------------------------------------------------------------------------------

// Where most splats are at a time, and from where to look: files of this kind have x right, y down and z ahead.
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
    const address = new URL(new URL(location.href).searchParams.get('src') ?? fail('the address names no ?src='), location.href), answer = await fetch(address);
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
