// A small CPU splat renderer written from the published mathematics (EWA projection, 3-sigma cut,
// depth sort, front-to-back blending, SH up to degree 3). Slow and simple: the reference for real
// viewers.
const C1 = 0.4886025119029199;
const C2 = [1.092548430592079, -1.092548430592079, 0.31539156525252005, -1.092548430592079, 0.5462742152960396];
const C3 = [-0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154, -0.4570457994644658, 1.445305721320277, -0.5900435899266435];

const sub = (a, b) => a.map((v, i) => v - b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => { const n = Math.hypot(...a); return a.map((v) => v / n); };

function basis(x, y, z, bands) {
    const b = [];
    if (bands > 0) b.push(-C1 * y, C1 * z, -C1 * x);
    if (bands > 1) b.push(C2[0] * x * y, C2[1] * y * z, C2[2] * (2 * z * z - x * x - y * y), C2[3] * x * z, C2[4] * (x * x - y * y));
    if (bands > 2) {
        b.push(C3[0] * y * (3 * x * x - y * y), C3[1] * x * y * z, C3[2] * y * (4 * z * z - x * x - y * y), C3[3] * z * (2 * z * z - 3 * x * x - 3 * y * y),
            C3[4] * x * (4 * z * z - x * x - y * y), C3[5] * z * (x * x - y * y), C3[6] * x * (x * x - 3 * y * y));
    }
    return b;
}

// Viewers widen small splats in three ways; all of them are in use, and they differ visibly far
// from the camera: 'plain' adds 0.3 pixel^2 to the screen covariance, as in the original
// rasteriser; 'thin' adds a quarter of that (viewers that compute in half pixels); 'even' adds 0.3
// and lowers the opacity so that the splat's integral stays the same.
export const MODELS = { plain: [0.3, false], thin: [0.075, false], even: [0.3, true] };

// cam: { eye, target, up, fovy (degrees), width, height, bg:[r,g,b] }; reach: the squared extent of
// a splat, in sigma
export function render(s, cam, model = 'plain', reach = 9) {
    const [widen, even] = MODELS[model];
    const { width: W, height: H } = cam;
    const f = unit(sub(cam.target, cam.eye)), r = unit(cross(f, cam.up)), d = cross(f, r); // right, down, forward
    const tan = Math.tan(cam.fovy * Math.PI / 360), focal = H / 2 / tan, limY = 1.3 * tan, limX = limY * W / H;
    const list = [];
    for (let i = 0; i < s.count; i++) {
        const p = sub([s.pos[0][i], s.pos[1][i], s.pos[2][i]], cam.eye);
        const z = dot(p, f);
        if (z < 0.2) continue;
        const x = dot(p, r), y = dot(p, d);
        // as in the original, the point of linearisation is clamped to 1.3 times the image, since
        // the slope of the projection is unbounded beside the camera
        const cx = Math.max(-limX, Math.min(limX, x / z)), cy = Math.max(-limY, Math.min(limY, y / z));
        let [w, a, b, c] = s.rot.map((v) => v[i]);
        const n = Math.hypot(w, a, b, c);
        w /= n; a /= n; b /= n; c /= n;
        const R = [[1 - 2 * (b * b + c * c), 2 * (a * b - w * c), 2 * (a * c + w * b)],
            [2 * (a * b + w * c), 1 - 2 * (a * a + c * c), 2 * (b * c - w * a)],
            [2 * (a * c - w * b), 2 * (b * c + w * a), 1 - 2 * (a * a + b * b)]];
        let cxx = 0, cxy = 0, cyy = 0;
        for (let k = 0; k < 3; k++) {
            const axis = [R[0][k], R[1][k], R[2][k]], sc = s.scale[k][i];
            const vx = dot(axis, r) * sc, vy = dot(axis, d) * sc, vz = dot(axis, f) * sc;
            const jx = focal * (vx - cx * vz) / z, jy = focal * (vy - cy * vz) / z;
            cxx += jx * jx; cxy += jx * jy; cyy += jy * jy;
        }
        const before = cxx * cyy - cxy * cxy;
        cxx += widen; cyy += widen;
        const det = cxx * cyy - cxy * cxy;
        if (!(det > 0)) continue;
        const v = unit(p), bs = basis(v[0], v[1], v[2], s.bands);
        const rgb = [0, 1, 2].map((ch) => {
            let t = 0.5 + 0.28209479177387814 * s.sh0[ch][i];
            for (let k = 0; k < bs.length; k++) t += bs[k] * s.shN[k][ch][i];
            return Math.max(0, t);
        });
        list.push({ z, u: W / 2 + focal * x / z, v: H / 2 + focal * y / z, ia: cyy / det, ib: -cxy / det, ic: cxx / det, rad: Math.ceil(Math.sqrt(reach * Math.max(cxx, cyy))), rgb, o: s.alpha[i] * (even ? Math.sqrt(Math.max(0, before / det)) : 1) });
    }
    list.sort((m, n) => m.z - n.z);
    const acc = new Float64Array(W * H * 3), T = new Float64Array(W * H).fill(1);
    for (const g of list) {
        for (let y = Math.max(0, Math.floor(g.v - g.rad)); y <= Math.min(H - 1, g.v + g.rad); y++) {
            for (let x = Math.max(0, Math.floor(g.u - g.rad)); x <= Math.min(W - 1, g.u + g.rad); x++) {
                const dx = x + 0.5 - g.u, dy = y + 0.5 - g.v;
                const m = g.ia * dx * dx + 2 * g.ib * dx * dy + g.ic * dy * dy;
                if (m > reach) continue;
                const al = Math.min(0.99, g.o * Math.exp(-0.5 * m)), k = y * W + x;
                if (al < 1 / 255 || T[k] < 1e-4) continue;
                for (let c = 0; c < 3; c++) acc[k * 3 + c] += g.rgb[c] * al * T[k];
                T[k] *= 1 - al;
            }
        }
    }
    const rgb = Buffer.alloc(W * H * 3);
    for (let k = 0; k < W * H; k++) for (let c = 0; c < 3; c++) rgb[k * 3 + c] = Math.max(0, Math.min(255, Math.round(255 * (acc[k * 3 + c] + T[k] * cam.bg[c]))));
    return { width: W, height: H, rgb };
}
