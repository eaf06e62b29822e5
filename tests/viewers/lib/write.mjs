// Writers for the samples: 3DGS PLY, and GLB with KHR_gaussian_splatting (one frame, or a sequence
// in one file).
import fs from 'node:fs';

export function writePly(file, g, bands) {
    const k = [0, 3, 8, 15][bands];
    const names = ['x', 'y', 'z', 'nx', 'ny', 'nz', 'f_dc_0', 'f_dc_1', 'f_dc_2', ...Array.from({ length: 3 * k }, (_, i) => `f_rest_${i}`), 'opacity', 'scale_0', 'scale_1', 'scale_2', 'rot_0', 'rot_1', 'rot_2', 'rot_3'];
    const head = Buffer.from(`ply\nformat binary_little_endian 1.0\nelement vertex ${g.length}\n${names.map((n) => `property float ${n}\n`).join('')}end_header\n`);
    const body = Buffer.alloc(g.length * names.length * 4);
    let o = 0;
    for (const s of g) {
        const rest = [0, 1, 2].flatMap((c) => Array.from({ length: k }, (_, j) => s.shN?.[j]?.[c] ?? 0));
        for (const v of [...s.pos, 0, 0, 0, ...s.sh0, ...rest, Math.log(s.alpha / (1 - s.alpha)), ...s.scale.map(Math.log), ...s.rot]) o = body.writeFloatLE(v, o);
    }
    fs.writeFileSync(file, Buffer.concat([head, body]));
}

// Converts from the COLMAP-like axes of a PLY (right x, down y, forward z) to those of glTF (right
// -x, up y, forward z): half a turn about z, as in splat-transform. SH coefficients of odd order m
// change sign.
const FLIP = [-1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1, 1, -1];
export const toGltf = (s) => ({
    ...s,
    pos: [-s.pos[0], -s.pos[1], s.pos[2]],
    rot: [-s.rot[3], -s.rot[2], s.rot[1], s.rot[0]],
    shN: s.shN?.map((v, j) => v.map((x) => x * FLIP[j]))
});

const toLinear = (v) => { v = Math.min(1, Math.max(0, v)); return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; };

// frames: arrays of Gaussians in glTF's axes. how: null (one frame), 'scale' or 'visibility'.
export function writeGlb(file, frames, bands, { how = null, fps = 30 } = {}) {
    const E = 'KHR_gaussian_splatting';
    const json = { asset: { version: '2.0', generator: 'spin4d viewer bench sample' }, extensionsUsed: [E], scene: 0, scenes: [{ nodes: [] }], nodes: [], meshes: [], accessors: [], bufferViews: [], buffers: [] };
    const parts = [];
    let size = 0;
    const add = (arr, type, extra = {}) => {
        const data = Buffer.from(Float32Array.from(arr.flat()).buffer);
        json.bufferViews.push({ buffer: 0, byteOffset: size, byteLength: data.length });
        json.accessors.push({ bufferView: json.bufferViews.length - 1, componentType: 5126, count: arr.length, type, ...extra });
        parts.push(data);
        size += data.length;
        return json.accessors.length - 1;
    };
    frames.forEach((g, n) => {
        const min = [0, 1, 2].map((c) => Math.fround(Math.min(...g.map((s) => s.pos[c])))), max = [0, 1, 2].map((c) => Math.fround(Math.max(...g.map((s) => s.pos[c]))));
        const attributes = {
            POSITION: add(g.map((s) => s.pos), 'VEC3', { min, max }),
            COLOR_0: add(g.map((s) => [...s.sh0.map((v) => toLinear(0.5 + 0.28209479177387814 * v)), s.alpha]), 'VEC4'),
            [`${E}:ROTATION`]: add(g.map((s) => { const l = Math.hypot(...s.rot); return [s.rot[1] / l, s.rot[2] / l, s.rot[3] / l, s.rot[0] / l]; }), 'VEC4'),
            [`${E}:SCALE`]: add(g.map((s) => s.scale), 'VEC3'),
            [`${E}:OPACITY`]: add(g.map((s) => s.alpha), 'SCALAR'),
            [`${E}:SH_DEGREE_0_COEF_0`]: add(g.map((s) => s.sh0), 'VEC3')
        };
        let j = 0;
        for (let d = 1; d <= bands; d++) for (let c = 0; c < 2 * d + 1; c++, j++) { const q = j; attributes[`${E}:SH_DEGREE_${d}_COEF_${c}`] = add(g.map((s) => s.shN?.[q] ?? [0, 0, 0]), 'VEC3'); }
        json.meshes.push({ primitives: [{ mode: 0, attributes, extensions: { [E]: { kernel: 'ellipse', colorSpace: 'srgb_rec709_display', projection: 'perspective', sortingMethod: 'cameraDistance' } } }] });
        json.nodes.push({ mesh: n, name: `frame_${String(n).padStart(5, '0')}` });
        json.scenes[0].nodes.push(n);
    });
    if (how) {
        const n = frames.length, times = Array.from({ length: n + 1 }, (_, i) => i / fps);
        const input = add(times, 'SCALAR', { min: [0], max: [Math.fround(n / fps)] });
        const anim = { name: 'sequence', samplers: [], channels: [] };
        frames.forEach((_, f) => {
            const on = times.map((_, i) => (i === f || (i === n && f === n - 1) ? 1 : 0));
            const channel = { sampler: f, target: {} };
            if (how === 'scale') {
                anim.samplers.push({ input, interpolation: 'STEP', output: add(on.map((v) => [v, v, v]), 'VEC3') });
                channel.target = { node: f, path: 'scale' };
                json.nodes[f].scale = f ? [0, 0, 0] : [1, 1, 1];
            } else {
                const data = Buffer.alloc((on.length + 3) & ~3);
                on.forEach((v, i) => { data[i] = v; });
                json.bufferViews.push({ buffer: 0, byteOffset: size, byteLength: on.length });
                json.accessors.push({ bufferView: json.bufferViews.length - 1, componentType: 5121, count: on.length, type: 'SCALAR' });
                parts.push(data);
                size += data.length;
                anim.samplers.push({ input, interpolation: 'STEP', output: json.accessors.length - 1 });
                channel.target = { path: 'pointer', extensions: { KHR_animation_pointer: { pointer: `/nodes/${f}/extensions/KHR_node_visibility/visible` } } };
                json.nodes[f].extensions = { KHR_node_visibility: { visible: f === 0 } };
            }
            anim.channels.push(channel);
        });
        if (how === 'visibility') json.extensionsUsed.push('KHR_animation_pointer', 'KHR_node_visibility');
        json.animations = [anim];
    }
    json.buffers.push({ byteLength: size });
    let text = Buffer.from(JSON.stringify(json));
    text = Buffer.concat([text, Buffer.alloc((4 - (text.length & 3)) & 3, 32)]);
    const head = Buffer.alloc(20), bh = Buffer.alloc(8);
    head.writeUInt32LE(0x46546c67, 0);
    head.writeUInt32LE(2, 4);
    head.writeUInt32LE(28 + text.length + size, 8);
    head.writeUInt32LE(text.length, 12);
    head.writeUInt32LE(0x4e4f534a, 16);
    bh.writeUInt32LE(size, 0);
    bh.writeUInt32LE(0x004e4942, 4);
    fs.writeFileSync(file, Buffer.concat([head, text, bh, ...parts]));
}
