// A page of --to html without a browser: as much of a document, a worker and WebGL 2 as it uses.
// Whatever a real browser refuses is an error here. glsl.mjs runs its shaders; page.gl.picture()
// returns the image.
import fs from 'node:fs';
import path from 'node:path';
import { compile } from './glsl.mjs';

// The parts of a page's file: { clip, texts of the blocks or null, code(id) of a script }.
export function readPage(file) {
    const html = fs.readFileSync(file, 'utf8');
    const script = (id) => html.match(new RegExp(`id="${id}">([^<]*)</script>`))?.[1];
    // Code may contain "<", data never does.
    const code = (id) => html.match(new RegExp(`id="${id}"[^>]*>\n([\\s\\S]*?)</script>`))[1];
    const clip = JSON.parse(script('clip'));
    const data = clip.data && fs.readFileSync(path.join(path.dirname(file), clip.data));
    return { html, clip, code, script: () => html.match(/<script>\n([\s\S]*?)<\/script>/)[1], data, texts: data ? null : clip.versions.map((v, i) => v.splats.map((_, f) => script(`v${i}f${f}`))) };
}

// The functions `names` of the page's worker; post receives its messages.
export function workerOf(code, names, { fetch = null, post = () => {} } = {}) {
    return new Function('fetch', 'postMessage', `let onmessage; ${code}; return { tell: (data) => onmessage({ data }), ${names} };`)(fetch, post);
}

// ---- A document ---------------------------------------------------------------------------------

class Element {
    constructor(page, tagName, id = '') {
        Object.assign(this, { page, id, tagName, textContent: '', value: '', hidden: false, dataset: {}, style: { setProperty(name, v) { this[name] = v; } }, children: [], attributes: {}, handlers: {}, captured: new Set(), words: new Set() });
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
    // Dispatches an event like a browser's; returns whether the page handled it.
    fire(type, event = {}) {
        let taken = false;
        const e = { target: this, preventDefault() { taken = true; }, stopPropagation() {}, ...event };
        this[`on${type}`]?.(e);
        for (const f of this.handlers[type] ?? []) f(e);
        return taken;
    }
}

// options: width and height of the window, ratio of its pixels, media (the queries that matchMedia
// finds true), full (whether full screen is available), address, embedded (in another page), worker
// (a replacement), blocks (more texts), clip(c) to change the page's description of the clip.
export function openPage(file, options = {}) {
    const { html, clip, texts, code, script, data } = typeof file === 'string' ? readPage(file) : file, o = { width: 64, height: 40, ratio: 1, media: ['reduced-motion'], ...options };
    const page = { elements: {}, later: [], frames: [], pending: 0, sent: [], asked: [], problems: [], refuseFull: o.refuseFull };
    for (const [, tag, id, attributes, text] of html.matchAll(/<(\w+) id="(\w+)"([^>]*)>([^<]*)/g)) page.elements[id] = Object.assign(new Element(page, tag.toUpperCase(), id), { hidden: / hidden\b/.test(attributes), textContent: text });
    for (const id of ['project', 'vertex', 'fragment', 'worker']) page.elements[id] = Object.assign(new Element(page, 'SCRIPT', id), { textContent: code(id) });
    (texts ?? []).forEach((list, v) => list.forEach((text, f) => { page.elements[`v${v}f${f}`] = Object.assign(new Element(page, 'SCRIPT'), { textContent: text }); }));
    page.elements.clip = Object.assign(new Element(page, 'SCRIPT'), { textContent: JSON.stringify(o.clip?.(structuredClone(clip)) ?? clip) });
    if (page.elements.sound) Object.assign(page.elements.sound, { paused: true, muted: false, currentTime: 0, duration: NaN, playbackRate: 1, volume: 1, play() { this.paused = false; return Promise.resolve(); }, pause() { this.paused = true; } });
    const canvas = page.elements.view, root = new Element(page, 'HTML');
    Object.assign(canvas, { clientWidth: o.width, clientHeight: o.height, width: 300, height: 150 });
    page.gl = o.noGl ? null : new Gl(canvas);
    page.document = {
        documentElement: root, title: '', hidden: false, addEventListener: (type, f) => { page.document[`on${type}`] = f; }, fullscreenEnabled: o.full ?? true, fullscreenElement: null,
        getElementById: (id) => { if (!page.elements[id]) throw new Error(`no element '${id}'`); return page.elements[id]; },
        createElement: (tag) => new Element(page, tag.toUpperCase()), exitFullscreen: () => { page.document.fullscreenElement = null; }
    };
    page.window = Object.assign(new Element(page, 'WINDOW'), { devicePixelRatio: o.ratio });
    page.window.parent = o.embedded ? (o.embedded.postMessage ? o.embedded : { postMessage() {} }) : page.window;
    class Worker {
        constructor(text) {
            this.inside = workerOf(text, '', {
                fetch: async (address, { headers }) => {
                    const [, from, to] = headers.Range.match(/^bytes=(\d+)-(\d+)$/).map(Number);
                    page.asked.push([address, from, to]);
                    return new Response(data.subarray(from, to + 1), { status: 206 });
                },
                post: (reply) => {
                    if (reply.loaded !== undefined) page.loaded.push(reply.loaded);
                    else { page.pending--; page.replies.push(reply); }
                    this.onmessage({ data: structuredClone(reply) });
                }
            });
        }
        postMessage(message) {
            page.sent.push(message);
            if (!message.clip) page.pending++;
            queueMicrotask(() => this.inside.tell(structuredClone(message)));
        }
    }
    page.replies = [];
    page.loaded = [];
    class Address extends URL { static createObjectURL(blob) { return blob.text; } }
    class Text { constructor(parts) { this.text = parts.join(''); } }
    const given = { document: page.document, window: page.window, matchMedia: (q) => ({ matches: o.media.some((m) => q.includes(m)) }), requestAnimationFrame: (f) => page.frames.push(f), setTimeout: (f, ms) => page.later.push([f, ms]), Worker, URL: Address, Blob: Text, location: { href: o.address ?? 'http://there/some/page.html?x#y' }, DecompressionStream: o.old ? undefined : DecompressionStream, navigator: { clipboard: o.clipboard } };
    new Function(...Object.keys(given), script())(...Object.values(given));
    page.$ = (id) => page.elements[id];
    page.root = root;
    page.now = 0;
    // Advances one animation frame, `ms` after the previous one.
    page.tick = (ms = 16) => {
        page.now += ms;
        for (const f of page.frames.splice(0)) f(page.now);
    };
    // Waits until there are no pending requests and everything is drawn.
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

// ---- WebGL 2 ------------------------------------------------------------------------------------

const NAMES = ['VERTEX_SHADER', 'FRAGMENT_SHADER', 'COMPILE_STATUS', 'LINK_STATUS', 'BLEND', 'ONE', 'ONE_MINUS_SRC_ALPHA', 'TEXTURE_2D', 'TEXTURE_MIN_FILTER', 'TEXTURE_MAG_FILTER', 'NEAREST', 'RGBA32UI',
    'R32UI', 'RG32UI', 'RGBA_INTEGER', 'RED_INTEGER', 'UNSIGNED_INT', 'UNSIGNED_SHORT', 'ELEMENT_ARRAY_BUFFER', 'STATIC_DRAW', 'TRIANGLES', 'SCISSOR_TEST', 'COLOR_BUFFER_BIT', 'FRAMEBUFFER', 'COLOR_ATTACHMENT0', 'COLOR_ATTACHMENT1'];
const SAMPLERS = ['order', 'splats', 'harmonics', 'ellipses', 'paints'];
const must = (good, what) => { if (!good) throw new Error(`WebGL: ${what}`); };

class Gl {
    constructor(canvas) {
        NAMES.forEach((name, i) => { this[name] = 1000 + i; });
        Object.assign(this, { canvas, TEXTURE0: 2000, on: new Set(), unit: 0, units: [], uniforms: {}, colour: [0, 0, 0, 0], box: null, blend: [], textures: 0, frame: null, programs: [] });
    }
    createShader(type) { return { type }; }
    shaderSource(s, text) { s.text = text; }
    compileShader(s) {
        must(s.text.startsWith('#version 300 es\n'), 'a shader of another version');
        s.made = compile(s.text);
    }
    getShaderParameter(s, what) { return what === this.COMPILE_STATUS && Boolean(s.made); }
    getShaderInfoLog() { return ''; }
    createProgram() { return this.programs[this.programs.push({}) - 1]; }
    attachShader(p, s) { p[s.type] = s.made; }
    linkProgram(p) {
        const made = p[this.VERTEX_SHADER].names.out, read = p[this.FRAGMENT_SHADER].names.in;
        p.linked = read.every((n) => n.startsWith('gl_') || made.includes(n));
        p.values = {};
    }
    getProgramParameter(p, what) { return what === this.LINK_STATUS && p.linked; }
    getProgramInfoLog() { return ''; }
    useProgram(p) { this.program = p; }
    getUniformLocation(p, name) { return [this.VERTEX_SHADER, this.FRAGMENT_SHADER].some((k) => p[k].names.uniform.includes(name)) ? { p, name } : null; }
    uniform(at, value) {
        if (!at) return;
        must(at.p === this.program, `${at.name} of a program that is not used`);
        at.p.values[at.name] = value;
    }
    uniform1i(n, v) { must(Number.isInteger(v), `${n?.name} is no integer`); this.uniform(n, v); }
    uniform1f(n, v) { this.uniform(n, v); }
    uniform2f(n, a, b) { this.uniform(n, [a, b]); }
    uniform3fv(n, v) { must(v.length === 3, `${n?.name} has ${v.length} numbers`); this.uniform(n, [...v]); }
    uniformMatrix3fv(n, transposed, v) { must(v.length === 9 && !transposed, `${n?.name} is no matrix`); this.uniform(n, [v.slice(0, 3), v.slice(3, 6), v.slice(6)]); }
    enable(what) { this.on.add(what); }
    disable(what) { this.on.delete(what); }
    blendFunc(from, to) { this.blend = [from, to]; }
    createBuffer() { return {}; }
    bindBuffer(target, b) { must(target === this.ELEMENT_ARRAY_BUFFER, 'another buffer'); this.buffer = b; }
    bufferData(target, data) { this.buffer.data = data; }
    createFramebuffer() { return { at: [] }; }
    bindFramebuffer(target, f) { this.frame = f; }
    framebufferTexture2D(target, attachment, kind, t) { this.frame.at[attachment - this.COLOR_ATTACHMENT0] = t; }
    drawBuffers(list) { this.frame.to = list.map((b) => b - this.COLOR_ATTACHMENT0); }
    activeTexture(t) { this.unit = t - this.TEXTURE0; }
    createTexture() { this.textures++; return { filters: {} }; }
    deleteTexture(t) { if (t) { this.textures--; t.deleted = true; } }
    bindTexture(target, t) { must(!t?.deleted, 'a deleted texture'); this.units[this.unit] = t; }
    texParameteri(target, name, value) { this.units[this.unit].filters[name] = value; }
    texStorage2D(target, levels, format, width, height) {
        const t = this.units[this.unit], lanes = { [this.RGBA32UI]: 4, [this.RG32UI]: 2, [this.R32UI]: 1 }[format];
        must(!t.data, 'storage of a texture for a second time');
        Object.assign(t, { width, height, lanes, data: new Uint32Array(width * height * lanes) });
    }
    texSubImage2D(target, level, x, y, width, height, layout, type, data) {
        const t = this.units[this.unit], n = width * height * t.lanes;
        must(x === 0 && width === t.width && y >= 0 && y + height <= t.height && type === this.UNSIGNED_INT, 'beyond the texture');
        must(data.length >= n && layout === (t.lanes === 4 ? this.RGBA_INTEGER : this.RED_INTEGER), 'too few numbers for the texture');
        t.data.set(data.subarray(0, n), y * t.width * t.lanes);
    }
    // A texture that is incomplete reads as zero.
    sampler(unit) {
        const t = this.units[unit], fit = t?.data && t.filters[this.TEXTURE_MIN_FILTER] === this.NEAREST && t.filters[this.TEXTURE_MAG_FILTER] === this.NEAREST;
        return (x, y) => {
            if (!fit || x < 0 || y < 0 || x >= t.width || y >= t.height) return [0, 0, 0, 0];
            const at = (y * t.width + x) * t.lanes;
            return t.lanes === 4 ? t.data.subarray(at, at + 4) : [t.data[at], t.lanes > 1 ? t.data[at + 1] : 0, 0, 1];
        };
    }
    viewport(...v) { this.view = v; }
    scissor(...b) { this.box = b; }
    clearColor(...c) { this.colour = c; }
    clear(what) {
        must(what === this.COLOR_BUFFER_BIT && !this.on.has(this.SCISSOR_TEST) && !this.frame, 'clears a part only');
        const { width, height } = this.canvas;
        this.pixels = { width, height, rgb: new Float64Array(3 * width * height).map((_, i) => this.colour[i % 3]) };
        this.todo = [];
    }
    // The uniforms of the current program, with the textures of its samplers, none of which may be
    // in `never`.
    inputs(shader, never = []) {
        const u = Object.fromEntries(shader.names.uniform.map((name) => [name, this.program.values[name] ?? 0]));
        for (const name of shader.names.uniform.filter((n) => SAMPLERS.includes(n))) {
            must(!never.includes(this.units[u[name]]), `${name} is read where it is written`);
            u[name] = this.sampler(u[name]);
        }
        return u;
    }
    // The first of the page's programs: computes a value for each texel of the textures that the
    // image is drawn from.
    drawArrays(mode, first, corners) {
        must(mode === this.TRIANGLES && first === 0 && corners === 3 && this.frame, 'another way to draw');
        must(!this.on.has(this.BLEND) && !this.on.has(this.SCISSOR_TEST), 'blends numbers, or a part of them');
        const ends = [0, 1, 2].map((k) => this.program[this.VERTEX_SHADER].run({ gl_VertexID: k }).gl_Position.join());
        must(ends.join(' ') === '-1,-1,0,1 3,-1,0,1 -1,3,0,1', `a triangle that does not cover all: ${ends}`);
        const fragment = this.program[this.FRAGMENT_SHADER], [x0, y0, width, height] = this.view, at = this.frame.to.map((k) => this.frame.at[k]), u = this.inputs(fragment, at);
        must(at.length === 2 && at.every((t) => t && !t.deleted && x0 === 0 && y0 === 0 && width === t.width && height <= t.height), 'textures that it does not fit');
        this.todo.push(() => {
            Object.assign(fragment.uniforms, u);
            for (let y = 0; y < height; y++) {
                for (let x = 0; x < width; x++) {
                    const out = fragment.run({ gl_FragCoord: [x + 0.5, y + 0.5, 0.5, 1] }), all = fragment.names.out.filter((n) => !n.startsWith('gl_'));
                    at.forEach((t, k) => t.data.set(out[all[k]], (y * width + x) * t.lanes));
                }
            }
        });
    }
    // The second program: two triangles per splat.
    drawElements(mode, count, type, offset) {
        const list = this.buffer.data, { width, height } = this.canvas;
        must(mode === this.TRIANGLES && type === this.UNSIGNED_SHORT && offset === 0 && !this.frame && list instanceof Uint16Array, 'another way to draw');
        must(count % 6 === 0 && count <= list.length, 'more corners than the buffer has');
        must(!this.view.some((v, i) => v !== [0, 0, width, height][i]), 'a viewport beside the canvas');
        must(this.blend[0] === this.ONE && this.blend[1] === this.ONE_MINUS_SRC_ALPHA && this.on.has(this.BLEND), 'blends in another way');
        const vertex = this.program[this.VERTEX_SHADER], fragment = this.program[this.FRAGMENT_SHADER], u = this.inputs(vertex), box = this.on.has(this.SCISSOR_TEST) ? this.box : [0, 0, width];
        this.todo.push(() => {
            Object.assign(vertex.uniforms, u);
            for (let i = 0; i < count; i += 6) {
                const [a, b, c, d] = [list[i], list[i + 1], list[i + 2], list[i + 5]];
                must(list[i + 3] === c && list[i + 4] === b, 'two triangles that are no box');
                this.quad([a, b, c, d].map((k) => vertex.run({ gl_VertexID: k })), box, fragment);
            }
        });
    }
    // The four corners form a parallelogram here, across which the position is linear and the
    // colour is that of the last corner.
    quad([a, b, c, d], [x0, , wide], fragment) {
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
                const out = fragment.run({ place: mix('place'), colour: d.colour });
                if (!out) continue;
                const at = 3 * (y * W + x);
                for (let k = 0; k < 3; k++) rgb[at + k] = Math.min(1, Math.max(0, out.pixel[k] + (1 - out.pixel[3]) * rgb[at + k]));
            }
        }
    }
    // The contents of the canvas, for psnr(); drawing is deferred until here.
    picture() {
        for (const draw of this.todo.splice(0)) draw();
        const { width, height, rgb } = this.pixels;
        return { width, height, rgb: Buffer.from(rgb.map((v) => Math.round(255 * v))) };
    }
}
