// The page: requests frames and sort orders from the worker, draws the frames, and handles user
// input.
'use strict';

(() => {
const $ = (id) => document.getElementById(id);
const clip = JSON.parse($('clip').textContent), canvas = $('view'), root = document.documentElement;
const say = (text) => { $('message').textContent = text; root.classList.toggle('loading', false); };
root.classList.toggle('loading', true);
$('bar').hidden = $('message').hidden = false; // hidden in the page, for browsers without JavaScript
const asked = readParameters(new URL(location.href).searchParams);
const embedded = window.parent !== window;
const gl = canvas.getContext('webgl2', { antialias: false, depth: false, alpha: false, powerPreference: 'high-performance' });
if (!gl) return say('This page needs WebGL 2, which this browser does not support.');
if (clip.data && location.href.startsWith('file:')) return say(`This page loads ${clip.data} from its own folder, which browsers do not allow for local files. Put both files on a web server, such as "python3 -m http.server" in their folder, or export the clip without --split.`);
if (typeof DecompressionStream === 'undefined') return say('This browser is too old: it has no DecompressionStream.');

// Returns the address if it is relative or has the scheme http, https, blob or file; null for other
// schemes, such as javascript: and data:.
function safeAddress(address) {
    try { return /^(https?|blob|file):$/.test(new URL(address, location.href).protocol) ? address : null; } catch { return null; }
}

// Reads the parameters of the page's URL, such as
// ?frame=7&autoplay=0&noui&poster=first.jpg&version=before&fps=12&background=fff&view=0,1,5,0,0,0
function readParameters(given) {
    const has = (name) => given.has(name) && given.get(name) !== '0' && given.get(name) !== 'false', number = (name, least, most) => (given.get(name) && Number(given.get(name)) >= least && Number(given.get(name)) <= most ? Number(given.get(name)) : undefined);
    const hex = given.get('background')?.match(/^#?(?:([0-9a-f])([0-9a-f])([0-9a-f])|([0-9a-f]{2})([0-9a-f]{2})([0-9a-f]{2}))$/i)?.slice(1).filter(Boolean).map((h) => parseInt(h.repeat(3 - h.length), 16) / 255);
    return { frame: number('frame', 1, clip.numbers.length), autoplay: given.has('autoplay') ? has('autoplay') : undefined, noui: has('noui'), poster: given.has('poster') ? safeAddress(given.get('poster')) : null, version: given.get('version'), fps: number('fps', 0.001, 1000), background: hex, view: viewOf(given.get('view')?.split(',')) };
}

// Converts six numbers, the position of the camera and its target in world units, to a view.
// Returns undefined unless all numbers are finite and the two points differ.
function viewOf(list) {
    const v = Array.from(list ?? [], (each) => (String(each).trim() === '' ? NaN : Number(each)));
    const view = { eye: v.slice(0, 3), target: v.slice(3) };
    return v.length === 6 && v.every(Number.isFinite) && view.eye.some((x, i) => x !== view.target[i]) ? view : undefined;
}

// ---- Vectors and the camera, in the page's units: (world - centre) / size -----------------------

const add = (a, b, k = 1) => a.map((v, i) => v + k * b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((v) => v / Math.hypot(...a));
const inside = (p) => p.map((v, i) => (v - clip.centre[i]) / clip.size);

const up = unit(clip.up);
const side = unit(cross(up, Math.abs(up[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0])), front = cross(side, up);
const orbit = { tall: Infinity };

// Sets the camera to a view in world units. The page starts with the view in its address or, if
// the address contains none, with the view in the clip; Reset returns to this view.
const start = asked.view ?? { eye: clip.eye, target: clip.target };
function look(view) {
    const target = inside(view.target), from = add(inside(view.eye), target, -1);
    orbit.target = target;
    orbit.distance = Math.hypot(...from);
    orbit.height = Math.asin(dot(from, up) / orbit.distance);
    orbit.angle = Math.atan2(dot(from, side), dot(from, front));
}

function home() {
    look(start);
    orbit.first = orbit.distance;
}

function camera() {
    const { angle, height, distance, target } = orbit, flat = Math.cos(height);
    const out = add(add(front.map((v) => v * flat * Math.cos(angle)), side, flat * Math.sin(angle)), up, Math.sin(height));
    const forward = out.map((v) => -v), right = unit(cross(forward, up));
    const w = canvas.width, h = canvas.height, tan = Math.tan(clip.fovy * Math.PI / 360);
    // The window shows the whole image of the first camera. If the window is taller than this
    // image, the image is enlarged and cropped at its sides, as far as is needed to leave no empty
    // space above and below the scene, but not so far that the subject is cropped.
    const crop = Math.min(h / 2 / orbit.tall, w / 2 / (clip.keep ?? 0));
    const focal = Math.min(h / 2 / tan, Math.max(w / 2 / (tan * clip.aspect), crop));
    return { eye: add(target, out, distance), right, down: cross(forward, right), forward, focal };
}

// Returns the height of the scene in the first view: the 90th percentile of |y| / depth of the
// splats in the middle half of the image.
function measureHeight(place, n) {
    const c = camera(), near = clip.near / clip.size, tan = Math.tan(clip.fovy * Math.PI / 360), high = [];
    for (let i = 0; i < n; i++) {
        const p = add([place[8 * i], place[8 * i + 1], place[8 * i + 2]], c.eye, -1), depth = dot(p, c.forward);
        if (depth > near && Math.abs(dot(p, c.right)) < 0.5 * tan * clip.aspect * depth) high.push(Math.abs(dot(p, c.down)) / depth);
    }
    return high.length ? Math.max(tan, Float32Array.from(high).sort()[Math.floor(0.9 * high.length)]) : Infinity;
}

// ---- WebGL --------------------------------------------------------------------------------------

function shader(type, text) {
    const s = gl.createShader(type);
    gl.shaderSource(s, text.trim());
    gl.compileShader(s);
    if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s) ?? 'no context');
    return s;
}

// Compiles and links a program. The method at(name) of the result returns the location of a
// uniform.
function programOf(vertex, fragment) {
    const p = gl.createProgram();
    gl.attachShader(p, shader(gl.VERTEX_SHADER, vertex));
    gl.attachShader(p, shader(gl.FRAGMENT_SHADER, fragment));
    gl.linkProgram(p);
    if (!gl.getProgramParameter(p, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(p));
    return { use: () => gl.useProgram(p), at: (name) => gl.getUniformLocation(p, name) };
}

// A first pass projects each splat and stores the result in two textures. A second pass draws the
// bounding quads of all splats.
const ALL = '#version 300 es\nvoid main() { gl_Position = vec4(float(gl_VertexID & 1) * 4.0 - 1.0, float(gl_VertexID & 2) * 2.0 - 1.0, 0, 1); }';
const project = programOf(ALL, $('project').textContent), boxes = programOf($('vertex').textContent, $('fragment').textContent);
const at = Object.fromEntries(['turn', 'eye', 'focal', 'half_size', 'near', 'degree', 'words', 'antialias', 'count'].map((n) => [n, project.at(n)]));
const first = boxes.at('first'), most = boxes.at('most'), SPLATS = 0, HARMONICS = 1, ORDER = 2, ELLIPSES = 3, PAINTS = 4;
project.use();
Object.entries({ splats: SPLATS, harmonics: HARMONICS, order: ORDER }).forEach(([name, unit]) => gl.uniform1i(project.at(name), unit));
boxes.use();
Object.entries({ ellipses: ELLIPSES, paints: PAINTS }).forEach(([name, unit]) => gl.uniform1i(boxes.at(name), unit));
// Each splat is drawn as two triangles. A batch has so few splats that 16-bit indices can address
// all corners of these triangles. Instanced quads would be many times slower on software renderers.
const BATCH = 16384, CORNERS = [0, 1, 2, 2, 1, 3];
gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, Uint16Array.from({ length: 6 * BATCH }, (_, i) => 4 * Math.floor(i / 6) + CORNERS[i % 6]), gl.STATIC_DRAW);
gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);

// Allocates a texture of 2048 texels times `rows` rows in this texture unit.
function storage(unit, format, rows) {
    const made = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, 2048, rows);
    return made;
}

// Returns a function that uploads 32-bit words to a texture that is 2048 texels wide. The texture
// is reallocated if it is too small, and its last row is padded. Without words, the function only
// binds the texture.
function texture(slot, format, layout, perTexel) {
    let made = null, rows = 0;
    return (words) => {
        const line = 2048 * perTexel, need = Math.max(1, Math.ceil((words?.length ?? 0) / line));
        gl.activeTexture(gl.TEXTURE0 + slot);
        gl.bindTexture(gl.TEXTURE_2D, made);
        if (!words) return;
        if (need > rows) {
            gl.deleteTexture(made);
            made = storage(slot, format, rows = need);
        }
        const full = Math.floor(words.length / line), rest = words.length - full * line;
        const put = (y, h, data) => gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, y, 2048, h, layout, gl.UNSIGNED_INT, data);
        if (full) put(0, full, words.subarray(0, full * line));
        if (rest) {
            const last = new Uint32Array(line);
            last.set(words.subarray(full * line));
            put(full, 1, last);
        }
    };
}
// For each version of the clip: the frame that is on the GPU, and its textures.
const shown = clip.versions.map((v) => ({ v, frame: -1, draft: false, count: 0, words: 0, splats: texture(SPLATS, gl.RGBA32UI, gl.RGBA_INTEGER, 4), harmonics: texture(HARMONICS, gl.R32UI, gl.RED_INTEGER, 1), order: texture(ORDER, gl.R32UI, gl.RED_INTEGER, 1) }));

// The render targets of project.frag: one row for every 2048 splats.
const projected = { frame: gl.createFramebuffer(), rows: 0, textures: [] };
function makeRoom(rows) {
    gl.bindFramebuffer(gl.FRAMEBUFFER, projected.frame);
    if (rows <= projected.rows) return;
    projected.textures.forEach((t) => gl.deleteTexture(t));
    projected.textures = [storage(ELLIPSES, gl.RGBA32UI, rows), storage(PAINTS, gl.RG32UI, rows)];
    projected.rows = rows;
    projected.textures.forEach((t, i) => gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + i, gl.TEXTURE_2D, t, 0));
    gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]);
}

// Draws one version into the pixel columns from `left` to `right`.
function drawPart(s, c, left, right) {
    const w = canvas.width, h = canvas.height, rows = Math.ceil(s.count / 2048);
    if (!rows) return;
    makeRoom(rows);
    project.use();
    s.splats();
    s.harmonics();
    s.order();
    gl.uniformMatrix3fv(at.turn, false, [...c.right, ...c.down, ...c.forward]);
    gl.uniform3fv(at.eye, c.eye);
    gl.uniform2f(at.focal, c.focal, c.focal);
    gl.uniform2f(at.half_size, w / 2, h / 2);
    gl.uniform1f(at.near, clip.near / clip.size);
    gl.uniform1i(at.degree, s.v.degree);
    gl.uniform1i(at.words, s.words);
    gl.uniform1i(at.antialias, s.v.antialias ? 1 : 0);
    gl.uniform1i(at.count, s.count);
    gl.viewport(0, 0, 2048, rows);
    gl.drawArrays(gl.TRIANGLES, 0, 3);

    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    boxes.use();
    gl.uniform1f(most, state.moves ? 2.83 : 4);
    gl.viewport(0, 0, w, h);
    gl.enable(gl.BLEND);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(left, 0, right - left, h);
    for (let k = 0; k < s.count; k += BATCH) {
        gl.uniform1i(first, k);
        gl.drawElements(gl.TRIANGLES, 6 * Math.min(BATCH, s.count - k), gl.UNSIGNED_SHORT, 0);
    }
    gl.disable(gl.SCISSOR_TEST);
    gl.disable(gl.BLEND);
}

function draw() {
    const w = canvas.width, c = camera(), cut = Math.round(state.cut * w);
    gl.clearColor(...asked.background ?? clip.background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (!state.drawn) return;
    if (state.drawn.length === 1) drawPart(shown[state.drawn[0]], c, 0, w);
    else {
        drawPart(shown[BEFORE], c, 0, cut);
        drawPart(shown[AFTER], c, cut, w);
    }
}

// ---- Requests to the worker ---------------------------------------------------------------------

const AFTER = 0, BEFORE = 1; // indices of clip.versions, if there are two
const between = clip.versions.every((v) => v.rows || v.moves); // splats exist at any time, not only at frames
// Some members of `state`. moves: the camera has moved since the last draw. Draws are then faster
// but coarser: splats are cut off where they are still faintly visible. A full draw follows when
// the camera stops. drawn: indices of the versions that are drawn; null before the first frame.
// wipe: true if both versions are shown, with a line between them at the share `cut` of the width.
const state = { version: 0, wipe: false, cut: 0.5, frame: 0, playing: false, speed: 1, clock: 0, last: 0, touched: 0, asked: '', waiting: false, dirty: true, drawn: null, view: '', moves: false };
const texts = clip.data ? null : clip.versions.map((v, i) => v.splats.map((_, f) => {
    const element = $(`v${i}f${f}`), text = element.textContent;
    element.remove();
    return text;
}));
const source = new Blob([$('worker').textContent], { type: 'text/javascript' });
const worker = new Worker(URL.createObjectURL(source));
worker.onerror = (e) => say(`The page failed: ${e.message}`);
worker.postMessage({ clip, texts, address: clip.data && new URL(encodeURIComponent(clip.data), location.href).href, moving: window.spinMoving && { first: window.spinMoving.first, parts: window.spinMoving.parts } });

// Reads a part of a .sogst file for the worker.
async function loadPart(part, draft) {
    try {
        const splats = await window.spinMoving.load(part, draft);
        worker.postMessage({ part, draft, splats }, Object.values(splats).flatMap((a) => a.buffer ?? []));
    } catch (e) {
        worker.postMessage({ part, draft, error: e.message });
    }
}

worker.onmessage = ({ data }) => {
    if (data.loaded !== undefined) return loading(data.loaded);
    if (data.ask) return data.ask.forEach(({ part, draft }) => loadPart(part, draft));
    state.waiting = false;
    if (data.error) return say(`The clip cannot be read: ${data.error}`);
    for (const part of data.parts) {
        const s = shown[part.version];
        if (part.texels) {
            s.splats(part.texels);
            if (!state.drawn) orbit.tall = measureHeight(new Float32Array(part.texels.buffer), part.texels.length / 8);
            if (part.words) s.harmonics(part.sh);
            Object.assign(s, { frame: data.frame, draft: data.draft, words: part.words });
        }
        s.order(part.order);
        s.count = part.order.length;
    }
    const isFirst = !state.drawn;
    state.drawn = data.parts.map((p) => p.version);
    state.dirty = true;
    if (isFirst) label();
    $('poster').hidden = true;
    say('');
};

// Shows the progress of loading the first image. share: 0 to 1.
function loading(share) {
    if (state.drawn) return;
    $('message').textContent = `Loading the clip: ${Math.floor(100 * share)} %`;
    root.style.setProperty('--loaded', `${100 * share}%`);
}

const wanted = () => (state.wipe ? [AFTER, BEFORE] : [state.version]);
// The controls disappear REST milliseconds after the last input if the clip plays, or if the canvas
// is less than SMALL pixels high.
const REST = 3000, SMALL = 240;
const isWhole = () => state.drawn && !shown[state.drawn[0]].draft;

// Requests the current frame or, if only the camera has moved, a new sort order. A page with
// --split first requests the draft.
function ask(c) {
    const draft = !state.drawn && !state.wipe && state.frame === 0 && clip.versions[state.version].draft !== undefined;
    const slope = [canvas.width, canvas.height].map((v) => v / 2 / c.focal);
    const key = [wanted(), draft, state.frame, ...[c.forward, c.eye, slope].flat().map((v) => v.toFixed(3))].join(' ');
    if (state.waiting || key === state.asked) return;
    state.asked = key;
    state.waiting = true;
    const n = clip.numbers.length, parts = wanted().map((version) => ({ version, data: shown[version].frame !== state.frame || shown[version].draft }));
    worker.postMessage({ parts, draft, frame: state.frame, eye: c.eye, right: c.right, down: c.down, forward: c.forward, slope, near: clip.near / clip.size, next: n > 1 && !draft ? (state.frame + 1) % n : undefined, plays: state.playing });
}

function tick(now) {
    const n = clip.numbers.length;
    if (state.playing && isWhole()) {
        state.clock = (state.clock + (now - state.last) / 1000 * state.speed * (asked.fps ?? clip.fps)) % n;
        const frame = between ? Math.min(state.clock, n - 1) : Math.floor(state.clock);
        if (frame !== state.frame) go(frame, false);
    }
    if (audio) follow();
    fly((now - state.last) / 1000);
    state.last = now;
    tell();
    const ratio = Math.min(window.devicePixelRatio || 1, 2), w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (w && h && (canvas.width !== w || canvas.height !== h)) {
        canvas.width = w;
        canvas.height = h;
        state.dirty = true;
    }
    root.classList.toggle('rest', (state.playing || canvas.clientHeight < SMALL) && now - state.touched > REST);
    const c = camera(), view = [...c.eye, ...c.forward, c.focal].join(' '), moves = view !== state.view;
    if (state.moves && !moves) state.dirty = true;
    Object.assign(state, { view, moves });
    ask(c);
    if (state.dirty) {
        state.dirty = false;
        draw();
        const first = state.drawn && shown[state.drawn[0]];
        root.dataset.shown = !first ? '' : `${state.drawn.length > 1 ? 'wipe' : first.v.name} ${numberAt(first.frame)}`;
        root.dataset.draft = first?.draft ? 'yes' : 'no';
        root.dataset.draws = Number(root.dataset.draws || 0) + 1;
    }
    requestAnimationFrame(tick);
}

// ---- Sound --------------------------------------------------------------------------------------

// The sound, if there is one, is muted until the user turns it on, since browsers only start muted
// sound without a user action. When the time of the sound differs from that of the clip by more
// than a tenth of a second, it is set to the time of the clip.
const audio = clip.sound && $('sound');
function follow() {
    const { step, start } = clip.sound, at = state.clock * step - start, rate = state.speed * (asked.fps ?? clip.fps) * step;
    const on = state.playing && isWhole() && !document.hidden && at >= 0 && !(at >= audio.duration) && rate >= 0.0625 && rate <= 16;
    if (!on) {
        if (!audio.paused) audio.pause();
        return;
    }
    if (audio.playbackRate !== rate) audio.playbackRate = rate;
    if (!audio.seeking && Math.abs(audio.currentTime - at) > 0.1 * Math.max(1, rate)) audio.currentTime = at;
    if (audio.paused) audio.play().catch(() => {});
}

function mute(on) {
    audio.muted = on;
    $('mute').setAttribute('aria-pressed', !on);
}

if (audio) {
    $('mute').hidden = $('keym').hidden = false;
    $('mute').onclick = () => mute(!audio.muted);
    audio.volume = clip.sound.volume;
    document.addEventListener('visibilitychange', follow);
    mute(true);
}

// ---- Buttons, keys, fingers ---------------------------------------------------------------------

// Returns the number that the source gives to a frame. Between two frames, it is interpolated.
function numberAt(frame) {
    const k = Math.floor(frame), a = clip.numbers[k];
    return frame === k ? a : Number((a + (frame - k) * (clip.numbers[k + 1] - a)).toFixed(3));
}

function label() {
    const n = clip.numbers.length;
    $('label').textContent = `Frame ${Math.floor(state.frame) + 1} of ${n}`;
    $('label').title = `Number ${numberAt(state.frame)}`;
    $('scrub').value = state.frame;
    $('play').textContent = state.playing ? 'Pause' : 'Play';
    root.classList.toggle('playing', state.playing);
    // Without this button, a paused clip inside another page would look like an image.
    $('start').hidden = !embedded || !state.drawn || state.playing || clip.numbers.length < 2;
    for (const b of $('versions').children) b.setAttribute('aria-pressed', b.dataset.version === (state.wipe ? 'wipe' : clip.versions[state.version].name));
    $('wipe').hidden = !state.wipe;
}

function go(frame, byHand = true) {
    const n = clip.numbers.length;
    state.frame = (frame + n) % n;
    if (byHand) state.clock = state.frame;
    label();
}

function play(on) {
    state.playing = on && clip.numbers.length > 1;
    label();
}

function show(version) {
    state.version = version % clip.versions.length;
    state.wipe = false;
    label();
}

// Shows both versions: "before" to the left of a line, "after" to the right of the line.
function wipe(on) {
    state.wipe = on && clip.versions.length === 2;
    label();
}

function cutAt(share) {
    state.cut = Math.max(0.02, Math.min(0.98, share));
    $('wipe').style.left = `${100 * state.cut}%`;
    $('wipe').setAttribute('aria-valuenow', Math.round(100 * state.cut));
    state.dirty = true;
}

function reset() {
    home();
    state.flies = false;
    state.dirty = true;
}

// Rotates the camera about the target or, after flying, about the position of the camera.
function turnBy(dx, dy) {
    const { eye } = camera();
    orbit.angle -= dx * 0.006;
    orbit.height = Math.max(-1.55, Math.min(1.55, orbit.height + dy * 0.006));
    if (state.flies) orbit.target = add(orbit.target, add(eye, camera().eye, -1));
    state.dirty = true;
    welcome(false);
}

function moveBy(dx, dy) {
    const c = camera(), k = orbit.distance / c.focal * Math.min(window.devicePixelRatio || 1, 2);
    aim(add(add(orbit.target, c.right, -dx * k), c.down, -dy * k));
}

// Sets the target of the camera, limited to a distance of clip.size from the first view's target.
function aim(target) {
    const first = inside(start.target), off = add(target, first, -1);
    orbit.target = add(first, off, Math.min(1, 1 / Math.max(Math.hypot(...off), 1e-9)));
    state.dirty = true;
    welcome(false);
}

// The keys W, A, S and D fly forward, left, back and right, Q and E down and up. While a key is
// pressed, the camera moves, in each second, half the distance to the target in the first view.
const FLY = { w: ['forward', 1], s: ['forward', -1], d: ['right', 1], a: ['right', -1], q: ['down', 1], e: ['down', -1] }, held = new Set();
function fly(seconds) {
    const c = camera(), step = 0.5 * orbit.first * Math.min(seconds, 0.1);
    if (held.size) aim([...held].reduce((p, key) => add(p, c[FLY[key][0]], step * FLY[key][1]), orbit.target));
}

// Multiplies the distance from the target by `factor`. The distance is at least clip.reach[0], so
// that the camera does not pass through walls, and at most so large that the whole scene is
// visible. The distance of the first view is always allowed.
function zoomBy(factor) {
    const [least, most] = clip.reach.map((d) => d / clip.size), whole = 1.5 / Math.tan(clip.fovy * Math.PI / 360);
    orbit.distance = Math.max(Math.min(least, orbit.first), Math.min(Math.max(most, whole, orbit.first), orbit.distance * factor));
    state.dirty = true;
    welcome(false);
}

// Returns the current view in world units, in the form of the page's address and of set().
function viewNow() {
    const out = (p) => p.map((v, i) => v * clip.size + clip.centre[i]);
    return { eye: out(camera().eye), target: out(orbit.target) };
}

// Copies the address of the page with the current view and, if the clip is paused, the current
// frame. Shows the address if the browser does not allow copying.
async function copyLink() {
    const link = new URL(location.href), { eye, target } = viewNow();
    link.searchParams.set('view', [...eye, ...target].map((v) => Number(v.toPrecision(6))).join(','));
    if (!state.playing) link.searchParams.set('frame', Math.floor(state.frame) + 1);
    link.search = link.search.replaceAll('%2C', ',');
    try {
        await navigator.clipboard.writeText(link.href);
        note('The link to this view is copied.');
    } catch {
        note(link.href);
    }
}

// Shows a text for five seconds, unless another text replaces it earlier.
function note(text) {
    say(text);
    setTimeout(() => { if ($('message').textContent === text) say(''); }, 5000);
}

function fullscreen() {
    if (document.fullscreenElement) document.exitFullscreen();
    else root.requestFullscreen().catch(() => say('This browser does not allow full screen.'));
}

// Shows or hides the clip's name and the hint, which disappear after 8 seconds or when the view
// moves.
function welcome(on) {
    $('title').classList.toggle('away', !on);
}

$('play').onclick = $('start').onclick = () => play(!state.playing);
$('keys').onclick = () => { $('keys').hidden = true; };
$('full').onclick = fullscreen;
$('full').hidden = !document.fullscreenEnabled;
$('home').onclick = reset;
$('scrub').oninput = (e) => {
    const frame = Number(e.target.value); // read it before play() resets it
    play(false);
    go(frame);
};
$('speed').onchange = (e) => { state.speed = Number(e.target.value); };
canvas.ondblclick = reset;
canvas.oncontextmenu = (e) => e.preventDefault();
// Inside another page, the wheel and one-finger swipes scroll the outer page until the user clicks
// or touches this page, or presses a key in it.
const engage = (on) => {
    state.engaged = on || !embedded;
    canvas.style.touchAction = state.engaged ? 'none' : 'pan-y';
};
window.addEventListener('blur', () => engage(false));
for (const type of ['pointermove', 'pointerdown', 'keydown', 'focusin']) {
    window.addEventListener(type, () => {
        state.touched = state.last;
        if (type !== 'pointermove') engage(true);
    });
}
canvas.addEventListener('wheel', (e) => { if (!state.engaged) return; e.preventDefault(); zoomBy(Math.exp(e.deltaY * (e.deltaMode ? 0.05 : 0.0015))); }, { passive: false });

const line = $('wipe');
line.onpointerdown = (e) => { line.setPointerCapture(e.pointerId); };
line.onpointermove = (e) => { if (line.hasPointerCapture(e.pointerId)) cutAt(e.clientX / canvas.clientWidth); };
line.onkeydown = (e) => {
    const step = { ArrowLeft: -0.02, ArrowRight: 0.02 }[e.key];
    if (!step) return;
    cutAt(state.cut + step);
    e.preventDefault();
    e.stopPropagation();
};

const fingers = new Map();
canvas.onpointerdown = (e) => { canvas.setPointerCapture(e.pointerId); fingers.set(e.pointerId, [e.clientX, e.clientY]); };
canvas.onpointerup = canvas.onpointercancel = (e) => fingers.delete(e.pointerId);
canvas.onpointermove = (e) => {
    const before = fingers.get(e.pointerId), now = [e.clientX, e.clientY];
    if (!before) return;
    const dx = now[0] - before[0], dy = now[1] - before[1];
    if (fingers.size === 1) (e.buttons & 2 || e.shiftKey ? moveBy : turnBy)(dx, dy);
    else {
        const other = [...fingers].find(([id]) => id !== e.pointerId)[1];
        const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]);
        zoomBy(Math.max(apart(before), 1) / Math.max(apart(now), 1));
        moveBy(dx / 2, dy / 2);
    }
    fingers.set(e.pointerId, now);
};

window.addEventListener('keydown', (e) => {
    if (e.ctrlKey || e.metaKey || e.altKey) return;
    const typed = e.target.tagName === 'BUTTON' || e.target.tagName === 'SELECT';
    const to = { ArrowLeft: Math.ceil(state.frame) - 1, ArrowRight: Math.floor(state.frame) + 1, Home: 0, End: clip.numbers.length - 1 }[e.key];
    if (e.key === ' ' && !typed) play(!state.playing);
    else if (to !== undefined && e.target.id !== 'scrub' && !typed) { play(false); go(to); }
    else if (e.key === 'b' || e.key === 'B') show(state.version + 1);
    else if (e.key === 'c' || e.key === 'C') wipe(!state.wipe);
    else if (FLY[e.key.toLowerCase()] && !typed) { held.add(e.key.toLowerCase()); state.flies = true; }
    else if (e.key === 'f' || e.key === 'F') fullscreen();
    else if (e.key === 'r' || e.key === 'R') reset();
    else if (e.key === 'h' || e.key === 'H') root.classList.toggle('bare');
    else if (e.key === 'v' || e.key === 'V') copyLink();
    else if (audio && (e.key === 'm' || e.key === 'M')) mute(!audio.muted);
    else if (e.key === '?') $('keys').hidden = !$('keys').hidden;
    else if (e.key === 'Escape' && !$('keys').hidden) $('keys').hidden = true;
    else return;
    e.preventDefault();
});

window.addEventListener('keyup', (e) => held.delete(e.key.toLowerCase()));
window.addEventListener('blur', () => held.clear());

canvas.addEventListener('webglcontextlost', () => say('The WebGL context was lost: reload the page.'));
$('scrub').max = clip.numbers.length - 1;
$('scrub').step = between ? 0.1 : 1;
for (const id of ['play', 'scrub', 'label', 'speed']) $(id).hidden = clip.numbers.length < 2;
$('versions').hidden = clip.versions.length < 2;
root.classList.toggle('two', clip.versions.length > 1);
function addButton(name, text, title, does) {
    const button = document.createElement('button');
    button.textContent = text;
    button.title = title;
    button.dataset.version = name;
    button.onclick = does;
    $('versions').append(button);
}
clip.versions.forEach((v, i) => addButton(v.name, v.label, `${v.label} alone (B)`, () => show(i)));
if (clip.versions.length === 2) addButton('wipe', 'Wipe', 'Both, with a line between them (C)', () => wipe(true));
$('name').textContent = clip.title ?? clip.name;
$('title').hidden = clip.title === '';
$('hint').textContent = matchMedia('(pointer: coarse)').matches ? 'One finger turns, two move and zoom.' : 'Drag to turn, wheel to zoom, right button to move, WASD to fly.';
setTimeout(() => welcome(false), 8000);
if (asked.poster) {
    $('poster').src = asked.poster;
    $('poster').hidden = false;
}
root.classList.toggle('bare', asked.noui);
root.style.background = asked.background ? `rgb(${asked.background.map((v) => Math.round(255 * v))})` : '';
home();
cutAt(0.5);
engage(false);
if (asked.frame !== undefined) go(between ? asked.frame - 1 : Math.floor(asked.frame) - 1);
if (asked.version === 'wipe') wipe(true);
else show(Math.max(0, clip.versions.findIndex((v) => v.name === asked.version)));
play(asked.autoplay ?? (asked.frame === undefined && !matchMedia('(prefers-reduced-motion: reduce)').matches));
requestAnimationFrame(tick);

// ---- Interface for scripts and embedding pages --------------------------------------------------

// Requests are objects { play, frame, speed, version, view } with optional members. Frames count
// from 1, as in the control bar. view: { eye, target } or a list of six numbers, in world units.
const viewIn = (v) => viewOf(Array.isArray(v) ? v : [...(v?.eye ?? []), ...(v?.target ?? [])]);
const is = { play: (v) => typeof v === 'boolean', frame: (v) => v >= 1 && v <= clip.numbers.length, speed: (v) => v > 0 && v <= 100, version: (v) => clip.versions.some((each) => each.name === v) || (v === 'wipe' && clip.versions.length === 2), view: viewIn };
function set(wishes) {
    for (const [name, v] of Object.entries(wishes)) if (!is[name]?.(v)) throw new RangeError(`spin4d: ${name} cannot be ${v}`);
    const { play: on, frame, speed, version, view } = wishes;
    if (view !== undefined) look(viewIn(view));
    if (frame !== undefined) go(between ? frame - 1 : Math.floor(frame) - 1);
    if (speed !== undefined) $('speed').value = String(state.speed = speed);
    if (version === 'wipe') wipe(true);
    else if (version !== undefined) show(clip.versions.findIndex((each) => each.name === version));
    play(on ?? state.playing);
}

const stateNow = () => ({ play: state.playing, frame: state.frame + 1, frames: clip.numbers.length, speed: state.speed, version: state.wipe ? 'wipe' : clip.versions[state.version].name, ready: Boolean(state.drawn) });
let told = '';
// Reports the state to the embedding page if the state has changed since the last report.
function tell() {
    const now = JSON.stringify(stateNow());
    if (embedded && now !== told) window.parent.postMessage({ spin4d: JSON.parse(told = now) }, '*');
}
window.addEventListener('message', (e) => {
    if (e.source !== window.parent || !e.data?.spin4d) return;
    try { set(e.data.spin4d); } catch (error) { window.parent.postMessage({ spin4d: { error: error.message } }, '*'); }
});
tell();
// The interface for scripts. `camera` is the current camera in world units.
window.spin4d = {
    clip,
    set,
    get state() { return stateNow(); },
    camera: () => { const c = camera(); return { ...c, ...viewNow(), up, width: canvas.width, height: canvas.height, fovy: 360 / Math.PI * Math.atan(canvas.height / 2 / c.focal) }; }
};
})();
