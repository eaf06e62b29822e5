// Reads splats into one in-memory form, { count, pos, rot(wxyz), scale(linear), alpha(0..1), sh0,
// shN, bands }, from a 3DGS PLY or a GLB with KHR_gaussian_splatting. Strict on purpose: what one
// viewer tolerates is an error here, because another viewer will refuse it.
import fs from 'node:fs';

const TYPES = { char: 1, int8: 1, uchar: 1, uint8: 1, short: 2, int16: 2, ushort: 2, uint16: 2, int: 4, int32: 4, uint: 4, uint32: 4, float: 4, float32: 4, double: 8, float64: 8 };

export function readPly(file) {
    const buf = fs.readFileSync(file);
    const end = buf.indexOf('end_header\n');
    if (buf.toString('latin1', 0, 4) !== 'ply\n' || end < 0) throw new Error(`${file}: not a PLY with LF line ends`);
    const lines = buf.toString('latin1', 0, end).split('\n');
    if (lines[1] !== 'format binary_little_endian 1.0') throw new Error(`${file}: '${lines[1]}' is not binary_little_endian 1.0`);
    let count = -1, stride = 0;
    const at = new Map(), order = [], comments = [];
    let element = '';
    for (const line of lines.slice(2)) {
        const w = line.trim().split(/\s+/);
        if (w[0] === 'comment') comments.push(line.slice(8));
        if (w[0] === 'element') {
            element = w[1];
            if (element === 'vertex') count = Number(w[2]);
            else if (count < 0) throw new Error(`${file}: element ${element} stands before vertex`);
        }
        if (w[0] === 'property' && element === 'vertex') {
            if (w[1] === 'list' || !TYPES[w[1]]) throw new Error(`${file}: property ${line}`);
            if (!['float', 'float32'].includes(w[1])) throw new Error(`${file}: property ${w[2]} is ${w[1]}; viewers expect float`);
            at.set(w[2], stride);
            order.push(w[2]);
            stride += TYPES[w[1]];
        }
    }
    if (count <= 0) throw new Error(`${file}: no vertices`);
    const start = end + 11;
    if (buf.length < start + count * stride) throw new Error(`${file}: cut short: ${buf.length} bytes, header promises ${start + count * stride}`);
    const need = (name) => {
        if (!at.has(name)) throw new Error(`${file}: property ${name} is missing`);
        return at.get(name);
    };
    const rest = order.filter((n) => n.startsWith('f_rest_')).length;
    const bands = { 0: 0, 9: 1, 24: 2, 45: 3 }[rest];
    if (bands === undefined) throw new Error(`${file}: ${rest} f_rest_* properties (0, 9, 24 or 45 expected)`);
    const dv = new DataView(buf.buffer, buf.byteOffset + start, count * stride);
    const col = (name) => {
        const o = need(name), out = new Float32Array(count);
        for (let i = 0; i < count; i++) out[i] = dv.getFloat32(i * stride + o, true);
        return out;
    };
    const s = { file, count, bands, order, comments, bytes: buf.length, trailing: buf.length - start - count * stride };
    s.pos = ['x', 'y', 'z'].map(col);
    s.rot = [0, 1, 2, 3].map((i) => col(`rot_${i}`));
    s.logScale = [0, 1, 2].map((i) => col(`scale_${i}`));
    s.scale = s.logScale.map((c) => c.map(Math.exp));
    s.alpha = col('opacity').map((v) => 1 / (1 + Math.exp(-v)));
    s.sh0 = [0, 1, 2].map((i) => col(`f_dc_${i}`));
    const k = rest / 3;
    // channel-major in the file: f_rest_[c * k + j] is coefficient j of channel c
    s.shN = Array.from({ length: k }, (_, j) => [0, 1, 2].map((c) => col(`f_rest_${c * k + j}`)));
    return s;
}

const COMPONENT = { 5120: [1, 'getInt8', 127], 5121: [1, 'getUint8', 255], 5122: [2, 'getInt16', 32767], 5123: [2, 'getUint16', 65535], 5126: [4, 'getFloat32', 1] };
const SIZE = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4, MAT4: 16 };

export function openGlb(file) {
    const buf = fs.readFileSync(file);
    if (buf.length < 20 || buf.readUInt32LE(0) !== 0x46546c67 || buf.readUInt32LE(4) !== 2) throw new Error(`${file}: not a GLB version 2`);
    if (buf.readUInt32LE(8) !== buf.length) throw new Error(`${file}: length field ${buf.readUInt32LE(8)}, file ${buf.length}`);
    const jl = buf.readUInt32LE(12);
    const json = JSON.parse(buf.toString('utf8', 20, 20 + jl));
    const bin = 20 + jl < buf.length ? buf.subarray(28 + jl, 28 + jl + buf.readUInt32LE(20 + jl)) : Buffer.alloc(0);
    const accessor = (i) => {
        const a = json.accessors[i], v = json.bufferViews[a.bufferView], n = SIZE[a.type];
        const [size, get, max] = COMPONENT[a.componentType];
        const dv = new DataView(bin.buffer, bin.byteOffset + (v.byteOffset ?? 0) + (a.byteOffset ?? 0));
        const stride = v.byteStride ?? size * n;
        const out = Array.from({ length: n }, () => new Float32Array(a.count));
        for (let e = 0; e < a.count; e++) {
            for (let c = 0; c < n; c++) {
                let x = dv[get](e * stride + c * size, true);
                if (a.normalized) x = Math.max(x / max, -1);
                out[c][e] = x;
            }
        }
        return out;
    };
    return { file, json, bin, accessor, bytes: buf.length };
}

export function readGlb(file, { mesh = 0 } = {}) {
    const g = openGlb(file);
    const E = 'KHR_gaussian_splatting';
    const prim = g.json.meshes[mesh].primitives.find((p) => p.extensions?.[E]);
    if (!prim) throw new Error(`${file}: mesh ${mesh} has no ${E}`);
    if ((prim.mode ?? 4) !== 0) throw new Error(`${file}: splat primitive is not POINTS`);
    const at = (n) => {
        if (prim.attributes[n] === undefined) throw new Error(`${file}: attribute ${n} is missing`);
        return g.accessor(prim.attributes[n]);
    };
    const q = at(`${E}:ROTATION`);
    const s = { file, bands: 0, bytes: g.bytes, pos: at('POSITION'), rot: [q[3], q[0], q[1], q[2]], scale: at(`${E}:SCALE`), alpha: at(`${E}:OPACITY`)[0], sh0: at(`${E}:SH_DEGREE_0_COEF_0`), shN: [], extension: prim.extensions[E] };
    s.count = s.alpha.length;
    for (let d = 1; d <= 3 && prim.attributes[`${E}:SH_DEGREE_${d}_COEF_0`] !== undefined; d++) {
        for (let c = 0; c < 2 * d + 1; c++) s.shN.push(at(`${E}:SH_DEGREE_${d}_COEF_${c}`));
        s.bands = d;
    }
    return s;
}

// Requirements of KHR_gaussian_splatting that gltf-validator does not check. Returns problems.
export function checkGlb(file) {
    const { json, accessor } = openGlb(file), E = 'KHR_gaussian_splatting', bad = [];
    if (!json.extensionsUsed?.includes(E)) bad.push(`extensionsUsed does not name ${E}`);
    if (json.extensionsRequired?.includes(E)) bad.push(`extensionsRequired names ${E}: point-cloud fallback is lost`);
    const allowed = { ROTATION: ['VEC4', 5126, '5120n', '5122n'], SCALE: ['VEC3', 5126, 5121, '5121n', 5123, '5123n'], OPACITY: ['SCALAR', 5126, '5121n', '5123n'] };
    let found = 0;
    (json.meshes ?? []).forEach((m, mi) => m.primitives.forEach((p, pi) => {
        const x = p.extensions?.[E], at = `/meshes/${mi}/primitives/${pi}`;
        if (!x) return;
        found++;
        if ((p.mode ?? 4) !== 0) bad.push(`${at}: mode is not POINTS`);
        if (p.indices !== undefined) bad.push(`${at}: has indices`);
        if (x.kernel !== 'ellipse') bad.push(`${at}: kernel ${x.kernel}`);
        if (!['srgb_rec709_display', 'lin_rec709_display'].includes(x.colorSpace)) bad.push(`${at}: colorSpace ${x.colorSpace}`);
        const n = json.accessors[p.attributes.POSITION]?.count;
        for (const name of ['POSITION', 'ROTATION', 'SCALE', 'OPACITY', 'SH_DEGREE_0_COEF_0'].map((k, i) => (i ? `${E}:${k}` : k))) if (p.attributes[name] === undefined) bad.push(`${at}: ${name} is missing`);
        const seen = [0, 0, 0, 0];
        for (const [name, i] of Object.entries(p.attributes)) {
            const a = json.accessors[i], key = name.replace(`${E}:`, ''), sh = /^SH_DEGREE_([0-3])_COEF_([0-6])$/.exec(key);
            if (a.count !== n) bad.push(`${at}: ${name} has ${a.count} elements, POSITION ${n}`);
            if (a.sparse) bad.push(`${at}: ${name} is a sparse accessor`);
            const rule = sh ? ['VEC3', 5126] : name.startsWith(E) ? allowed[key] : null;
            if (name.startsWith(E) && !rule) bad.push(`${at}: unknown attribute ${name}`);
            if (rule && (a.type !== rule[0] || !rule.slice(1).includes(a.normalized ? `${a.componentType}n` : a.componentType))) bad.push(`${at}: ${name} is ${a.type} ${a.componentType}${a.normalized ? ' normalized' : ''}`);
            if (sh) seen[sh[1]]++;
        }
        const deg = seen.findLastIndex((k) => k > 0);
        for (let d = 0; d <= deg; d++) if (seen[d] !== 2 * d + 1) bad.push(`${at}: SH degree ${d} has ${seen[d]} of ${2 * d + 1} coefficients`);
        const q = p.attributes[`${E}:ROTATION`];
        if (q !== undefined) {
            const r = accessor(q), tol = json.accessors[q].componentType === 5120 ? 0.02 : 1e-3;
            const off = r[0].reduce((k, _, i) => k + (Math.abs(Math.hypot(r[0][i], r[1][i], r[2][i], r[3][i]) - 1) > tol), 0);
            if (off) bad.push(`${at}: ${off} rotations are not of unit length`);
        }
    }));
    if (!found) bad.push(`no primitive carries ${E}`);
    return bad;
}

// The times in seconds at which a GLB with a sequence shows its frames: midpoints between key
// times, at most n of them, spread over the clip. Empty for a GLB without animation.
export function timesOf(file, n) {
    const { json, accessor } = openGlb(file), sampler = json.animations?.[0]?.samplers[0];
    if (!sampler) return [];
    const keys = accessor(sampler.input)[0], last = keys.length - 2, m = Math.min(n, last + 1);
    const pick = new Set(Array.from({ length: m }, (_, i) => Math.round(i * last / Math.max(1, m - 1))));
    return [...pick].map((i) => (keys[i] + keys[i + 1]) / 2);
}

// The meshes visible at time t in a GLB with a sequence: evaluates STEP samplers of node scales or
// of KHR_node_visibility.
export function meshesAt(file, t) {
    const { json, accessor } = openGlb(file), on = json.nodes.map((n) => !(n.scale?.every((v) => v === 0)) && n.extensions?.KHR_node_visibility?.visible !== false);
    for (const a of json.animations ?? []) {
        for (const c of a.channels) {
            const ptr = /^\/nodes\/(\d+)\/(scale|extensions\/KHR_node_visibility\/visible)$/.exec(c.target.extensions?.KHR_animation_pointer?.pointer ?? '');
            const node = ptr ? Number(ptr[1]) : c.target.path === 'scale' ? c.target.node : -1;
            if (node < 0) continue;
            const s = a.samplers[c.sampler], time = accessor(s.input)[0], value = accessor(s.output)[0];
            let i = time.findLastIndex((v) => v <= t + 1e-6);
            if (i < 0) i = 0;
            on[node] = value[i] !== 0;
        }
    }
    return json.nodes.flatMap((n, i) => (n.mesh !== undefined && on[i] ? [n.mesh] : []));
}

// Properties that make some viewers fail, as [problems, notes].
export function check(s) {
    const bad = [], note = [];
    let nan = 0, q0 = 0, qn = 0, big = 0, neg = 0;
    for (let i = 0; i < s.count; i++) {
        const all = [...s.pos, ...s.rot, ...s.scale, s.alpha, ...s.sh0].map((c) => c[i]);
        if (all.some((v) => !Number.isFinite(v))) nan++;
        const n = Math.hypot(...s.rot.map((c) => c[i]));
        if (n < 1e-6) q0++;
        else if (Math.abs(n - 1) > 1e-3) qn++;
        if (s.scale.some((c) => c[i] < 0)) neg++;
        if (s.pos.some((c) => Math.abs(c[i]) > 1e5)) big++;
    }
    if (nan) bad.push(`${nan} Gaussians hold NaN or Inf`);
    if (q0) bad.push(`${q0} rotations have zero length`);
    if (neg) bad.push(`${neg} scales are negative`);
    if (s.alpha.some((v) => v < 0 || v > 1)) bad.push('an opacity lies outside 0..1');
    if (qn) (s.extension ? bad : note).push(`${qn} of ${s.count} rotations are not unit quaternions`);
    if (big) note.push(`${big} positions lie beyond 1e5`);
    if (s.trailing) note.push(`${s.trailing} bytes after the vertices`);
    return [bad, note];
}
