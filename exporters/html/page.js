// The page: asks the worker for frames and orders, draws them, and listens to whoever looks.
'use strict';

(() => {
const $ = (id) => document.getElementById(id);
const clip = JSON.parse($('clip').textContent), canvas = $('view'), root = document.documentElement;
const say = (text) => { $('message').textContent = text; };
const gl = canvas.getContext('webgl2', { antialias: false, alpha: false, powerPreference: 'high-performance' });
if (!gl) return say('This page needs WebGL 2, which this browser does not offer.');
if (typeof DecompressionStream === 'undefined') return say('This browser is too old: it has no DecompressionStream.');

// ---- Vectors and the camera, in the page's units: (world - centre) / size ------------------------

const add = (a, b, k = 1) => a.map((v, i) => v + k * b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => a.map((v) => v / Math.hypot(...a));
const inside = (p) => p.map((v, i) => (v - clip.centre[i]) / clip.size);

const up = unit(clip.up);
const side = unit(cross(up, Math.abs(up[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0])), front = cross(side, up);
const orbit = {};

function home() {
    const target = inside(clip.target), from = add(inside(clip.eye), target, -1);
    orbit.target = target;
    orbit.distance = orbit.first = Math.hypot(...from);
    orbit.height = Math.asin(dot(from, up) / orbit.distance);
    orbit.angle = Math.atan2(dot(from, side), dot(from, front));
}

function camera() {
    const { angle, height, distance, target } = orbit, flat = Math.cos(height);
    const out = add(add(front.map((v) => v * flat * Math.cos(angle)), side, flat * Math.sin(angle)), up, Math.sin(height));
    const forward = out.map((v) => -v), right = unit(cross(forward, up));
    const w = canvas.width, h = canvas.height, tan = Math.tan(clip.fovy * Math.PI / 360);
    // all of the first camera's picture is in view, whatever the window's shape
    const focal = Math.min(h / 2 / tan, w / 2 / (tan * clip.aspect));
    return { eye: add(target, out, distance), right, down: cross(forward, right), forward, focal };
}

// ---- WebGL -----------------------------------------------------------------------------------------

function shader(type, text) {
    const s = gl.createShader(type);
    gl.shaderSource(s, text.trim());
    gl.compileShader(s);
    if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s) ?? 'no context');
    return s;
}

const program = gl.createProgram();
gl.attachShader(program, shader(gl.VERTEX_SHADER, $('vertex').textContent));
gl.attachShader(program, shader(gl.FRAGMENT_SHADER, $('fragment').textContent));
gl.linkProgram(program);
if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
gl.useProgram(program);
const where = (name) => gl.getUniformLocation(program, name);
const at = Object.fromEntries(['splats', 'harmonics', 'turn', 'eye', 'focal', 'half_size', 'near', 'degree', 'words', 'antialias'].map((n) => [n, where(n)]));
gl.enableVertexAttribArray(0);
gl.vertexAttribDivisor(0, 1);
gl.enable(gl.BLEND);
gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
gl.uniform1i(at.splats, 0);
gl.uniform1i(at.harmonics, 1);

// Words into a texture 2048 wide, made anew when it has to grow; the last row is filled up. Without words: bind it.
function texture(slot, format, layout, perTexel) {
    let made = null, rows = 0;
    return (words) => {
        const line = 2048 * perTexel, need = Math.max(1, Math.ceil((words?.length ?? 0) / line));
        gl.activeTexture(gl.TEXTURE0 + slot);
        gl.bindTexture(gl.TEXTURE_2D, made);
        if (!words) return;
        if (need > rows) {
            gl.deleteTexture(made);
            made = gl.createTexture();
            rows = need;
            gl.bindTexture(gl.TEXTURE_2D, made);
            gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
            gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
            gl.texStorage2D(gl.TEXTURE_2D, 1, format, 2048, rows);
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
// Each version's frame that is on the card.
const shown = clip.versions.map((v) => ({ v, frame: -1, draft: false, count: 0, words: 0, order: gl.createBuffer(), splats: texture(0, gl.RGBA32UI, gl.RGBA_INTEGER, 4), harmonics: texture(1, gl.R32UI, gl.RED_INTEGER, 1) }));

// One version into the columns of pixels from left to right.
function drawPart(s, left, right) {
    gl.scissor(left, 0, right - left, canvas.height);
    s.splats();
    s.harmonics();
    gl.bindBuffer(gl.ARRAY_BUFFER, s.order);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
    gl.uniform1i(at.degree, s.v.degree);
    gl.uniform1i(at.words, s.words);
    gl.uniform1i(at.antialias, s.v.antialias ? 1 : 0);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, s.count);
}

function draw() {
    const w = canvas.width, h = canvas.height, c = camera(), cut = Math.round(state.cut * w);
    gl.viewport(0, 0, w, h);
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(...clip.background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (!state.drawn) return;
    gl.enable(gl.SCISSOR_TEST);
    gl.uniformMatrix3fv(at.turn, false, [...c.right, ...c.down, ...c.forward]);
    gl.uniform3fv(at.eye, c.eye);
    gl.uniform2f(at.focal, c.focal, c.focal);
    gl.uniform2f(at.half_size, w / 2, h / 2);
    gl.uniform1f(at.near, clip.near / clip.size);
    if (state.drawn.length === 1) drawPart(shown[state.drawn[0]], 0, w);
    else {
        drawPart(shown[BEFORE], 0, cut);
        drawPart(shown[AFTER], cut, w);
    }
}

// ---- What is wanted and what is shown ----------------------------------------------------------------

const AFTER = 0, BEFORE = 1; // of two versions
// drawn: the versions in the picture; wipe: both are wanted, with the line at the share `cut` of the width.
const state = { version: 0, wipe: false, cut: 0.5, frame: 0, playing: false, speed: 1, clock: 0, last: 0, asked: '', waiting: false, dirty: true, drawn: null };
const texts = clip.data ? null : clip.versions.map((v, i) => v.splats.map((_, f) => {
    const element = $(`v${i}f${f}`), text = element.textContent;
    element.remove();
    return text;
}));
const source = new Blob([$('worker').textContent], { type: 'text/javascript' });
const worker = new Worker(URL.createObjectURL(source));
worker.onerror = (e) => say(`The page failed: ${e.message}`);
worker.postMessage({ clip, texts, address: clip.data && new URL(encodeURIComponent(clip.data), location.href).href });

worker.onmessage = ({ data }) => {
    state.waiting = false;
    if (data.error) return say(`The clip cannot be read: ${data.error}`);
    for (const part of data.parts) {
        const s = shown[part.version];
        if (part.texels) {
            s.splats(part.texels);
            if (part.words) s.harmonics(part.sh);
            Object.assign(s, { frame: data.frame, draft: data.draft, words: part.words });
        }
        gl.bindBuffer(gl.ARRAY_BUFFER, s.order);
        gl.bufferData(gl.ARRAY_BUFFER, part.order, gl.DYNAMIC_DRAW);
        s.count = part.order.length;
    }
    state.drawn = data.parts.map((p) => p.version);
    state.dirty = true;
    say('');
};

const wanted = () => (state.wipe ? [AFTER, BEFORE] : [state.version]);
const isWhole = () => state.drawn && !shown[state.drawn[0]].draft;

// Ask for the wanted frame, and for a new order when the camera has turned or moved; of a page that is served
// first for the draft, which is shown before anything else is read.
function ask(c) {
    const draft = !state.drawn && !state.wipe && state.frame === 0 && clip.versions[state.version].draft !== undefined;
    const key = [wanted(), draft, state.frame, ...c.forward.map((v) => v.toFixed(3)), ...c.eye.map((v) => v.toFixed(3))].join(' ');
    if (state.waiting || key === state.asked) return;
    state.asked = key;
    state.waiting = true;
    const n = clip.numbers.length, parts = wanted().map((version) => ({ version, data: shown[version].frame !== state.frame || shown[version].draft }));
    worker.postMessage({ parts, draft, frame: state.frame, eye: c.eye, forward: c.forward, near: clip.near / clip.size, next: n > 1 && !draft ? (state.frame + 1) % n : undefined });
}

function tick(now) {
    const n = clip.numbers.length;
    if (state.playing && isWhole()) {
        state.clock = (state.clock + (now - state.last) / 1000 * state.speed * clip.fps) % n;
        if (Math.floor(state.clock) !== state.frame) go(Math.floor(state.clock), false);
    }
    state.last = now;
    const ratio = Math.min(window.devicePixelRatio || 1, 2), w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (w && h && (canvas.width !== w || canvas.height !== h)) {
        canvas.width = w;
        canvas.height = h;
        state.dirty = true;
    }
    ask(camera());
    if (state.dirty) {
        state.dirty = false;
        draw();
        const first = state.drawn && shown[state.drawn[0]];
        root.dataset.shown = !first ? '' : `${state.drawn.length > 1 ? 'wipe' : first.v.name} ${clip.numbers[first.frame]}`;
        root.dataset.draft = first?.draft ? 'yes' : 'no';
        root.dataset.draws = Number(root.dataset.draws || 0) + 1;
    }
    requestAnimationFrame(tick);
}

// ---- Buttons, keys, fingers ------------------------------------------------------------------------

function label() {
    const n = clip.numbers.length;
    $('label').textContent = `Frame ${state.frame + 1} of ${n}`;
    $('label').title = `Number ${clip.numbers[state.frame]}`;
    $('scrub').value = state.frame;
    $('play').textContent = state.playing ? 'Pause' : 'Play';
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

// Before on the left of a line, after on its right.
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
    state.dirty = true;
}

function turnBy(dx, dy) {
    orbit.angle -= dx * 0.006;
    orbit.height = Math.max(-1.55, Math.min(1.55, orbit.height + dy * 0.006));
    state.dirty = true;
    welcome(false);
}

function moveBy(dx, dy) {
    const c = camera(), k = orbit.distance / c.focal * Math.min(window.devicePixelRatio || 1, 2);
    // not farther than the scene reaches
    const first = inside(clip.target), off = add(add(add(orbit.target, c.right, -dx * k), c.down, -dy * k), first, -1);
    orbit.target = add(first, off, Math.min(1, 1 / Math.max(Math.hypot(...off), 1e-9)));
    state.dirty = true;
    welcome(false);
}

// From where the cameras stood to a part of their way in: behind them are the walls.
function zoomBy(factor) {
    const [least, most] = clip.reach.map((d) => d / clip.size);
    orbit.distance = Math.max(Math.min(least, orbit.first), Math.min(Math.max(most, orbit.first), orbit.distance * factor));
    state.dirty = true;
    welcome(false);
}

function fullscreen() {
    if (document.fullscreenElement) document.exitFullscreen();
    else root.requestFullscreen().catch(() => say('This browser does not allow a full screen.'));
}

// The name and the hint, until the scene is touched.
function welcome(on) {
    $('title').classList.toggle('away', !on);
}

$('play').onclick = () => play(!state.playing);
$('full').onclick = fullscreen;
$('full').hidden = !document.fullscreenEnabled;
$('home').onclick = reset;
$('scrub').oninput = (e) => {
    const frame = Number(e.target.value); // before play() puts the old one there
    play(false);
    go(frame);
};
$('speed').onchange = (e) => { state.speed = Number(e.target.value); };
canvas.ondblclick = reset;
canvas.oncontextmenu = (e) => e.preventDefault();
canvas.addEventListener('wheel', (e) => { e.preventDefault(); zoomBy(Math.exp(e.deltaY * (e.deltaMode ? 0.05 : 0.0015))); }, { passive: false });

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
    const step = { ArrowLeft: -1, ArrowRight: 1 }[e.key];
    if (e.key === ' ' && !typed) play(!state.playing);
    else if (step && e.target.id !== 'scrub' && !typed) { play(false); go(state.frame + step); }
    else if (e.key === 'b' || e.key === 'B') show(state.version + 1);
    else if (e.key === 'w' || e.key === 'W') wipe(!state.wipe);
    else if (e.key === 'f' || e.key === 'F') fullscreen();
    else if (e.key === 'r' || e.key === 'R') reset();
    else if (e.key === 'h' || e.key === 'H') root.classList.toggle('bare');
    else return;
    e.preventDefault();
});

canvas.addEventListener('webglcontextlost', () => say('The graphics card lost the picture: reload the page.'));
$('scrub').max = clip.numbers.length - 1;
$('time').hidden = clip.numbers.length < 2;
$('speed').hidden = clip.numbers.length < 2;
$('versions').hidden = clip.versions.length < 2;
function addButton(name, text, title, does) {
    const button = document.createElement('button');
    button.textContent = text;
    button.title = title;
    button.dataset.version = name;
    button.onclick = does;
    $('versions').append(button);
}
clip.versions.forEach((v, i) => addButton(v.name, v.label, `${v.label} alone (B)`, () => show(i)));
if (clip.versions.length === 2) addButton('wipe', 'Wipe', 'Both, with a line between them (W)', () => wipe(true));
$('name').textContent = document.title = clip.name;
$('hint').textContent = matchMedia('(pointer: coarse)').matches ? 'One finger turns, two move and zoom.' : 'Drag to turn, wheel to zoom, right button to move.';
setTimeout(() => welcome(false), 8000);
home();
cutAt(0.5);
play(!matchMedia('(prefers-reduced-motion: reduce)').matches);
requestAnimationFrame(tick);

// For whoever scripts the page: the camera as it is, in the world's units.
window.spin4d = {
    clip,
    camera: () => { const c = camera(), out = (p) => p.map((v, i) => v * clip.size + clip.centre[i]); return { ...c, eye: out(c.eye), target: out(orbit.target), up, width: canvas.width, height: canvas.height, fovy: 360 / Math.PI * Math.atan(canvas.height / 2 / c.focal) }; }
};
})();
