// A page of --to html without a browser: as much of a document, of a worker and of WebGL 2 as it uses. What a real one
// refuses is an error here. Its shaders run by glsl.mjs; the picture is in `page.gl.picture()`.
import fs from 'node:fs';
import path from 'node:path';
import { compile } from './glsl.mjs';

// What lies in a page's file: { clip, texts of the blocks or null, code(id) of a script }.
export function readPage(file) {
    const html = fs.readFileSync(file, 'utf8');
    const script = (id) => html.match(new RegExp(`id="${id}">([^<]*)</script>`))?.[1];
    // Code has a "<" of its own; data has none.
    const code = (id) => html.match(new RegExp(`id="${id}"[^>]*>\n([\\s\\S]*?)</script>`))[1];
    const clip = JSON.parse(script('clip'));
    const data = clip.data && fs.readFileSync(path.join(path.dirname(file), clip.data));
    return { html, clip, code, script: () => html.match(/<script>\n([\s\S]*?)<\/script>/)[1], data, texts: data ? null : clip.versions.map((v, i) => v.splats.map((_, f) => script(`v${i}f${f}`))) };
}

// The functions `names` of the page's worker; post takes what it says.
export function workerOf(code, names, { fetch = null, post = () => {} } = {}) {
    return new Function('fetch', 'postMessage', `let onmessage; ${code}; return { tell: (data) => onmessage({ data }), ${names} };`)(fetch, post);
}

// ---- A document ------------------------------------------------------------------------------------

class Element {
    constructor(page, tagName, id = '') {
        Object.assign(this, { page, id, tagName, textContent: '', value: '', hidden: false, dataset: {}, style: {}, children: [], attributes: {}, handlers: {}, captured: new Set(), words: new Set() });
        this.classList = { toggle: (w, on = !this.words.has(w)) => { this.words[on ? 'add' : 'delete'](w); return on; }, contains: (w) => this.words.has(w) };
    }
    addEventListener(type, f) { (this.handlers[type] ??= []).push(f); }
    setAttribute(name, value) { this.attributes[name] = String(value); }
    getAttribute(name) { return this.attributes[name] ?? null; }
    append(child) { this.children.push(child); }
    remove() { this.removed = true; }
    setPointerCapture(id) { this.captured.add(id); }
    hasPointerCapture(id) { return this.captured.has(id); }
    getContext(kind) { return kind === 'webgl2' ? this.page.gl : null; }
    requestFullscreen() { this.page.document.fullscreenElement = this; return this.page.refuseFull ? Promise.reject(new Error('no')) : Promise.resolve(); }
    // An event as the browser makes it; says whether the page took it.
    fire(type, event = {}) {
        let taken = false;
        const e = { target: this, preventDefault() { taken = true; }, stopPropagation() {}, ...event };
        this[`on${type}`]?.(e);
        for (const f of this.handlers[type] ?? []) f(e);
        return taken;
    }
}

// options: width and height of the window, ratio of its pixels, media (what matchMedia finds true), full (whether a
// full screen may be had), worker (another one), blocks (further texts), clip(c) to change what the page knows.
export function openPage(file, options = {}) {
    const { html, clip, texts, code, script, data } = typeof file === 'string' ? readPage(file) : file, o = { width: 64, height: 40, ratio: 1, media: ['reduced-motion'], ...options };
    const page = { elements: {}, later: [], frames: [], pending: 0, sent: [], asked: [], problems: [], refuseFull: o.refuseFull };
    for (const [, tag, id, attributes, text] of html.matchAll(/<(\w+) id="(\w+)"([^>]*)>([^<]*)/g)) page.elements[id] = Object.assign(new Element(page, tag.toUpperCase(), id), { hidden: / hidden\b/.test(attributes), textContent: text });
    for (const id of ['vertex', 'fragment', 'worker']) page.elements[id] = Object.assign(new Element(page, 'SCRIPT', id), { textContent: code(id) });
    (texts ?? []).forEach((list, v) => list.forEach((text, f) => { page.elements[`v${v}f${f}`] = Object.assign(new Element(page, 'SCRIPT'), { textContent: text }); }));
    page.elements.clip = Object.assign(new Element(page, 'SCRIPT'), { textContent: JSON.stringify(o.clip?.(structuredClone(clip)) ?? clip) });
    const canvas = page.elements.view, root = new Element(page, 'HTML');
    Object.assign(canvas, { clientWidth: o.width, clientHeight: o.height, width: 300, height: 150 });
    page.gl = o.noGl ? null : new Gl(canvas);
    page.document = {
        documentElement: root, title: '', fullscreenEnabled: o.full ?? true, fullscreenElement: null,
        getElementById: (id) => { if (!page.elements[id]) throw new Error(`no element '${id}'`); return page.elements[id]; },
        createElement: (tag) => new Element(page, tag.toUpperCase()), exitFullscreen: () => { page.document.fullscreenElement = null; }
    };
    page.window = Object.assign(new Element(page, 'WINDOW'), { devicePixelRatio: o.ratio });
    class Worker {
        constructor(text) {
            this.inside = workerOf(text, '', {
                fetch: async (address, { headers }) => {
                    const [, from, to] = headers.Range.match(/^bytes=(\d+)-(\d+)$/).map(Number);
                    page.asked.push([address, from, to]);
                    return new Response(data.subarray(from, to + 1), { status: 206 });
                },
                post: (reply) => { page.pending--; page.replies.push(reply); this.onmessage({ data: structuredClone(reply) }); }
            });
        }
        postMessage(message) {
            page.sent.push(message);
            if (!message.clip) page.pending++;
            queueMicrotask(() => this.inside.tell(structuredClone(message)));
        }
    }
    page.replies = [];
    class Address extends URL { static createObjectURL(blob) { return blob.text; } }
    class Text { constructor(parts) { this.text = parts.join(''); } }
    const given = { document: page.document, window: page.window, matchMedia: (q) => ({ matches: o.media.some((m) => q.includes(m)) }), requestAnimationFrame: (f) => page.frames.push(f), setTimeout: (f, ms) => page.later.push([f, ms]), Worker, URL: Address, Blob: Text, location: { href: 'http://there/some/page.html?x#y' }, DecompressionStream: o.old ? undefined : DecompressionStream };
    new Function(...Object.keys(given), script())(...Object.values(given));
    page.$ = (id) => page.elements[id];
    page.root = root;
    page.now = 0;
    // One frame of the screen, `ms` after the one before.
    page.tick = (ms = 16) => {
        page.now += ms;
        for (const f of page.frames.splice(0)) f(page.now);
    };
    // Until nothing is asked for and all is drawn.
    page.settle = async (ms = 0) => {
        for (let quiet = 0, k = 0; quiet < 2; k++) {
            if (k > 1e5) throw new Error('the page does not come to rest');
            const draws = root.dataset.draws;
            if (!page.pending) page.tick(ms);
            await new Promise(setImmediate);
            quiet = page.pending || draws !== root.dataset.draws ? 0 : quiet + 1;
        }
        return page;
    };
    page.key = (key, more = {}) => page.window.fire('keydown', { key, target: canvas, ...more });
    page.camera = () => page.window.spin4d.camera();
    return page;
}

// ---- WebGL 2 ----------------------------------------------------------------------------------------

const NAMES = ['VERTEX_SHADER', 'FRAGMENT_SHADER', 'COMPILE_STATUS', 'LINK_STATUS', 'BLEND', 'ONE', 'ONE_MINUS_SRC_ALPHA', 'TEXTURE_2D', 'TEXTURE_MIN_FILTER', 'TEXTURE_MAG_FILTER', 'NEAREST', 'RGBA32UI',
    'R32UI', 'RGBA_INTEGER', 'RED_INTEGER', 'UNSIGNED_INT', 'ARRAY_BUFFER', 'DYNAMIC_DRAW', 'TRIANGLE_STRIP', 'SCISSOR_TEST', 'COLOR_BUFFER_BIT'];
const must = (good, what) => { if (!good) throw new Error(`WebGL: ${what}`); };

class Gl {
    constructor(canvas) {
        NAMES.forEach((name, i) => { this[name] = 1000 + i; });
        Object.assign(this, { canvas, TEXTURE0: 2000, on: new Set(), unit: 0, units: [], uniforms: {}, colour: [0, 0, 0, 0], box: null, blend: [], textures: 0 });
    }
    createShader(type) { return { type }; }
    shaderSource(s, text) { s.text = text; }
    compileShader(s) {
        must(s.text.startsWith('#version 300 es\n'), 'a shader of another version');
        s.made = compile(s.text);
    }
    getShaderParameter(s, what) { return what === this.COMPILE_STATUS && Boolean(s.made); }
    getShaderInfoLog() { return ''; }
    createProgram() { return {}; }
    attachShader(p, s) { p[s.type] = s.made; }
    linkProgram(p) {
        const made = p[this.VERTEX_SHADER].names.out, read = p[this.FRAGMENT_SHADER].names.in;
        p.linked = read.every((n) => n === 'gl_VertexID' || made.includes(n));
    }
    getProgramParameter(p, what) { return what === this.LINK_STATUS && p.linked; }
    getProgramInfoLog() { return ''; }
    useProgram(p) { this.vertex = p[this.VERTEX_SHADER]; this.fragment = p[this.FRAGMENT_SHADER]; }
    getUniformLocation(p, name) { return p[this.VERTEX_SHADER].names.uniform.includes(name) ? name : null; }
    uniform(name, value) { if (name) this.uniforms[name] = value; }
    uniform1i(n, v) { must(Number.isInteger(v), `${n} is no integer`); this.uniform(n, v); }
    uniform1f(n, v) { this.uniform(n, v); }
    uniform2f(n, a, b) { this.uniform(n, [a, b]); }
    uniform3fv(n, v) { must(v.length === 3, `${n} has ${v.length} numbers`); this.uniform(n, [...v]); }
    uniformMatrix3fv(n, transposed, v) { must(v.length === 9 && !transposed, `${n} is no matrix`); this.uniform(n, [v.slice(0, 3), v.slice(3, 6), v.slice(6)]); }
    enableVertexAttribArray(i) { this.array = i; }
    vertexAttribDivisor(i, n) { this.divisor = n; }
    vertexAttribIPointer(i, size, type, stride, offset) { must(size === 1 && type === this.UNSIGNED_INT && !stride && !offset, 'an attribute of another kind'); this.source = this.buffer; }
    enable(what) { this.on.add(what); }
    disable(what) { this.on.delete(what); }
    blendFunc(from, to) { this.blend = [from, to]; }
    createBuffer() { return {}; }
    bindBuffer(target, b) { this.buffer = b; }
    bufferData(target, data) { this.buffer.data = data; }
    activeTexture(t) { this.unit = t - this.TEXTURE0; }
    createTexture() { this.textures++; return { filters: {} }; }
    deleteTexture(t) { if (t) { this.textures--; t.deleted = true; } }
    bindTexture(target, t) { must(!t?.deleted, 'a deleted texture'); this.units[this.unit] = t; }
    texParameteri(target, name, value) { this.units[this.unit].filters[name] = value; }
    texStorage2D(target, levels, format, width, height) {
        const t = this.units[this.unit], lanes = format === this.RGBA32UI ? 4 : 1;
        must(!t.data, 'storage of a texture for a second time');
        Object.assign(t, { width, height, lanes, data: new Uint32Array(width * height * lanes) });
    }
    texSubImage2D(target, level, x, y, width, height, layout, type, data) {
        const t = this.units[this.unit], n = width * height * t.lanes;
        must(x === 0 && width === t.width && y >= 0 && y + height <= t.height && type === this.UNSIGNED_INT, 'beyond the texture');
        must(data.length >= n && layout === (t.lanes === 4 ? this.RGBA_INTEGER : this.RED_INTEGER), 'too few numbers for the texture');
        t.data.set(data.subarray(0, n), y * t.width * t.lanes);
    }
    // Of a texture that is not fit for reading all is zero.
    sampler(unit) {
        const t = this.units[unit], fit = t?.data && t.filters[this.TEXTURE_MIN_FILTER] === this.NEAREST && t.filters[this.TEXTURE_MAG_FILTER] === this.NEAREST;
        return (x, y) => {
            if (!fit || x < 0 || y < 0 || x >= t.width || y >= t.height) return [0, 0, 0, 0];
            const at = (y * t.width + x) * t.lanes;
            return t.lanes === 4 ? t.data.subarray(at, at + 4) : [t.data[at], 0, 0, 1];
        };
    }
    viewport(...v) { this.view = v; }
    scissor(...b) { this.box = b; }
    clearColor(...c) { this.colour = c; }
    clear(what) {
        must(what === this.COLOR_BUFFER_BIT && !this.on.has(this.SCISSOR_TEST), 'clears a part only');
        const { width, height } = this.canvas;
        this.pixels = { width, height, rgb: new Float64Array(3 * width * height).map((_, i) => this.colour[i % 3]) };
        this.todo = [];
    }
    drawArraysInstanced(mode, first, corners, n) {
        must(mode === this.TRIANGLE_STRIP && first === 0 && corners === 4 && this.divisor === 1, 'another way to draw');
        must(n <= (this.source?.data?.length ?? 0), 'more splats than the buffer has');
        must(!this.view.some((v, i) => v !== [0, 0, this.canvas.width, this.canvas.height][i]), 'a viewport beside the canvas');
        must(this.blend[0] === this.ONE && this.blend[1] === this.ONE_MINUS_SRC_ALPHA && this.on.has(this.BLEND), 'blends in another way');
        const order = this.source.data, u = Object.fromEntries(this.vertex.names.uniform.map((name) => [name, this.uniforms[name] ?? 0]));
        for (const name of ['splats', 'harmonics']) u[name] = this.sampler(u[name]);
        const box = this.on.has(this.SCISSOR_TEST) ? this.box : [0, 0, this.canvas.width];
        this.todo.push(() => {
            Object.assign(this.vertex.uniforms, u);
            for (let i = 0; i < n; i++) this.quad([0, 1, 2, 3].map((corner) => this.vertex.run({ gl_VertexID: corner, splat: order[i] })), box);
        });
    }
    // Corners 0 1 2 3 of a strip are a parallelogram here, with all varyings linear in it.
    quad([a, b, c, d], [x0, , wide]) {
        const { width: W, height: H, rgb } = this.pixels, ends = [a, b, c, d].map((p) => p.gl_Position);
        if (ends.every((p) => p[2] > p[3])) return;
        const [p, q, r, s] = ends.map(([x, y]) => [(x + 1) / 2 * W, (1 - y) / 2 * H]);
        const e = [q[0] - p[0], q[1] - p[1]], f = [r[0] - p[0], r[1] - p[1]], det = e[0] * f[1] - e[1] * f[0];
        if (!(Math.abs(det) > 0)) return;
        must(Math.hypot(p[0] + s[0] - q[0] - r[0], p[1] + s[1] - q[1] - r[1]) < 1e-6 * (1 + Math.hypot(...e, ...f)), 'corners of no parallelogram');
        const within = (k, most) => [Math.max(0, Math.floor(Math.min(p[k], q[k], r[k], s[k]))), Math.min(most - 1, Math.ceil(Math.max(p[k], q[k], r[k], s[k])))];
        const [left, right] = within(0, W), [top, bottom] = within(1, H);
        for (let y = top; y <= bottom; y++) {
            for (let x = Math.max(left, x0); x <= right && x < x0 + wide; x++) {
                const dx = x + 0.5 - p[0], dy = y + 0.5 - p[1], g = (dx * f[1] - dy * f[0]) / det, h = (e[0] * dy - e[1] * dx) / det;
                if (g < 0 || g >= 1 || h < 0 || h >= 1) continue;
                const mix = (name) => a[name].map((v, i) => v + g * (b[name][i] - v) + h * (c[name][i] - v));
                const out = this.fragment.run({ place: mix('place'), colour: mix('colour') });
                if (!out) continue;
                const at = 3 * (y * W + x);
                for (let k = 0; k < 3; k++) rgb[at + k] = Math.min(1, Math.max(0, out.pixel[k] + (1 - out.pixel[3]) * rgb[at + k]));
            }
        }
    }
    // What the canvas shows, for psnr(); only now is it drawn.
    picture() {
        for (const draw of this.todo.splice(0)) draw();
        const { width, height, rgb } = this.pixels;
        return { width, height, rgb: Buffer.from(rgb.map((v) => Math.round(255 * v))) };
    }
}
