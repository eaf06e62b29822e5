// Runs the page's shaders in Node: translates the part of GLSL ES 3.00 that they use to JavaScript.
// Numbers are numbers, vectors are arrays, matrices are arrays of columns; shifts treat integers as
// unsigned.
const TYPES = /^(void|bool|int|uint|float|[iu]?vec[234]|mat3)$/, LANES = 'xyzwrgba';

// Operators in ascending order of precedence.
const BINARY = [['||'], ['&&'], ['|'], ['^'], ['&'], ['==', '!='], ['<', '>', '<=', '>='], ['<<', '>>'], ['+', '-'], ['*', '/']];

const SCALAR = {
    '+': (a, b) => a + b, '-': (a, b) => a - b, '*': (a, b) => a * b, '/': (a, b) => a / b, '<<': (a, b) => a << b >>> 0, '>>': (a, b) => a >>> b, '&': (a, b) => (a & b) >>> 0,
    '|': (a, b) => (a | b) >>> 0, '^': (a, b) => (a ^ b) >>> 0, '<': (a, b) => a < b, '>': (a, b) => a > b, '<=': (a, b) => a <= b, '>=': (a, b) => a >= b, '==': (a, b) => a === b, '!=': (a, b) => a !== b
};
const isMatrix = (a) => Array.isArray(a) && Array.isArray(a[0]);
// Applies f to each component of one, two or three arguments.
function each(f, a, b, c) {
    const vector = [a, b, c].find((v) => typeof v === 'object');
    if (!vector) return f(a, b, c);
    const out = [];
    for (const v of [a, b, c]) if (typeof v === 'object' && v.length !== vector.length) throw new Error('vectors of two lengths');
    for (let i = 0; i < vector.length; i++) out.push(f(typeof a === 'object' ? a[i] : a, typeof b === 'object' ? b[i] : b, typeof c === 'object' ? c[i] : c));
    return out;
}
const dot = (a, b) => { let sum = 0; for (let i = 0; i < a.length; i++) sum += a[i] * b[i]; return sum; };

function op(sign, a, b) {
    const f = SCALAR[sign];
    if (typeof a === 'number' && typeof b === 'number') return f(a, b);
    if (isMatrix(a) && Array.isArray(b)) return [0, 1, 2].map((r) => dot(a.map((column) => column[r]), b));
    if (isMatrix(b)) return b.map((column) => dot(a, column));
    if (isMatrix(a)) return a.map((column) => op(sign, column, b));
    return each(f, a, b);
}

function halfValue(h) {
    const e = h >> 10 & 31, m = h & 1023, sign = h & 0x8000 ? -1 : 1;
    return sign * (e === 0 ? m * 2 ** -24 : e === 31 ? (m ? NaN : Infinity) : (1 + m / 1024) * 2 ** (e - 15));
}
// Rounds to the nearest half-precision value, ties to even.
function halfOf(x) {
    const sign = x < 0 || Object.is(x, -0) ? 0x8000 : 0, size = Math.abs(x), e = Math.max(-14, Math.floor(Math.log2(size || 2 ** -24))), m = size / 2 ** (e - 10), down = Math.floor(m);
    const whole = m - down > 0.5 || (m - down === 0.5 && down % 2) ? down + 1 : down;
    return size >= 65520 ? sign | 0x7c00 : sign | (e + 14) * 1024 + whole;
}
// Constructors such as float(), ivec2() and mat3().
function maker(type) {
    const n = type === 'mat3' ? 9 : Number(type.at(-1)) || 1, one = /^[iu]/.test(type) ? Math.trunc : Number;
    if (n === 1) return one;
    return (...args) => {
        let flat = args.some((v) => typeof v === 'object') ? args.flat() : args;
        if (one !== Number) flat = flat.map(one);
        if (flat.length === 1) flat = Array(n).fill(flat[0]);
        if (flat.length !== n) throw new Error(`${type} of ${flat.length} numbers`);
        return type === 'mat3' ? [flat.slice(0, 3), flat.slice(3, 6), flat.slice(6)] : flat;
    };
}
const word = new Uint32Array(1), float = new Float32Array(word.buffer);

export const builtin = {
    op, dot, make: Object.fromEntries(['int', 'uint', 'float', 'mat3', ...['vec', 'ivec', 'uvec'].flatMap((t) => [2, 3, 4].map((n) => t + n))].map((t) => [t, maker(t)])),
    minus: (a) => each((v) => -v, a),
    lanes: (a, names) => (names.length > 1 ? Array.from(names, (c) => a[LANES.indexOf(c) % 4]) : a[LANES.indexOf(names) % 4]),
    min: (a, b) => each((x, y) => Math.min(x, y), a, b), max: (a, b) => each((x, y) => Math.max(x, y), a, b), abs: (a) => each(Math.abs, a), sqrt: (a) => each(Math.sqrt, a), exp: (a) => each(Math.exp, a), log: (a) => each(Math.log, a),
    clamp: (x, a, b) => each((v, low, high) => Math.min(high, Math.max(low, v)), x, a, b),
    length: (a) => Math.hypot(...a), normalize: (a) => { const n = Math.hypot(...a); return a.map((v) => v / n); },
    uintBitsToFloat: (a) => each((v) => { word[0] = v; return float[0]; }, a),
    floatBitsToUint: (a) => each((v) => { float[0] = v; return word[0]; }, a),
    packHalf2x16: ([x, y]) => (halfOf(x) | halfOf(y) << 16) >>> 0,
    unpackHalf2x16: (v) => [halfValue(v & 65535), halfValue(v >>> 16)],
    texelFetch: (sampler, [x, y]) => sampler(x, y)
};
export { halfValue };

// A program: uniforms by name; run({ inputs }) returns the outputs, or null if the fragment is
// discarded.
export function compile(source) {
    const tokens = source.replace(/^#.*$/gm, '').replace(/\/\/.*$/gm, '').match(/[A-Za-z_]\w*|(?:\d+\.\d*|\.\d+|\d+)(?:[eE][-+]?\d+)?[uf]?|[-+*/]=|<<|>>|[<>=!]=|&&|\|\||\S/g);
    const names = { in: ['gl_VertexID', 'gl_FragCoord'], out: ['gl_Position'], uniform: [] }, functions = new Set();
    let at = 0;
    const peek = (k = 0) => tokens[at + k], next = () => tokens[at++];
    const take = (t) => { if (next() !== t) throw new Error(`'${t}' expected before '${tokens.slice(at - 1, at + 6).join(' ')}'`); };
    const list = (end, one) => { const out = []; while (peek() !== end) { out.push(one()); if (peek() !== end) take(','); } take(end); return out; };

    function primary() {
        const t = next();
        let code;
        if (t === '-') return `G.minus(${unary()})`;
        if (t === '(') { code = `(${expression()})`; take(')'); }
        else if (/^[\d.]/.test(t)) code = t.replace(/[uf]$/, '');
        else if (!/^\w+$/.test(t)) throw new Error(`'${t}' is no value`);
        else if (peek() === '(') {
            next();
            const args = list(')', expression);
            if (TYPES.test(t)) code = `G.make.${t}(${args})`;
            else if (functions.has(t)) code = `${t}(${args})`;
            else if (builtin[t]) code = `G.${t}(${args})`;
            else throw new Error(`no function '${t}'`);
        } else code = names.uniform.includes(t) ? `U.${t}` : t;
        return code;
    }
    function unary() {
        let code = primary();
        while (peek() === '.' || peek() === '[') {
            if (next() === '.') code = `G.lanes(${code}, "${next()}")`;
            else { code = `${code}[${expression()}]`; take(']'); }
        }
        return code;
    }
    function binary(level) {
        if (level === BINARY.length) return unary();
        let code = binary(level + 1);
        while (BINARY[level].includes(peek())) {
            const sign = next(), right = binary(level + 1);
            code = level < 2 ? `(${code} ${sign} ${right})` : `G.op("${sign}", ${code}, ${right})`;
        }
        return code;
    }
    function expression() {
        const code = binary(0);
        if (peek() !== '?') return code;
        next();
        const yes = expression();
        take(':');
        return `(${code} ? ${yes} : ${expression()})`;
    }
    function statement() {
        const t = next();
        if (t === '{') { let code = '{'; while (peek() !== '}') code += statement(); next(); return `${code}}`; }
        if (t === 'if') { take('('); const test = expression(); take(')'); return `if (${test}) ${statement()}`; }
        if (t === 'return') { const code = peek() === ';' ? '' : expression(); take(';'); return `return ${code};`; }
        if (t === 'discard') { take(';'); return '{ discarded = true; return; }'; }
        if (TYPES.test(t)) {
            const parts = [];
            do { const name = next(); take('='); parts.push(`${name} = ${expression()}`); } while (next() === ',');
            return `let ${parts.join(', ')};`;
        }
        const sign = next(), code = expression();
        take(';');
        return sign === '=' ? `${t} = ${code};` : `${t} = G.op("${sign[0]}", ${t}, ${code});`;
    }

    let body = '';
    while (at < tokens.length) {
        let t = next();
        if (t === 'precision') { while (next() !== ';'); continue; }
        if (t === 'layout') { while (next() !== ')'); t = next(); }
        if (t === 'flat') t = next();
        if (names[t]) {
            next();
            do names[t].push(next()); while (next() === ',');
            continue;
        }
        const name = next();
        functions.add(name);
        take('(');
        const args = list(')', () => { next(); return next(); });
        body += `function ${name}(${args}) ${statement()}\n`;
    }
    const state = [...names.in, ...names.out], uniforms = {};
    const run = new Function('G', 'U', `'use strict'; let discarded, ${state};\n${body}
        return (given) => { ${names.in.map((n) => `${n} = given.${n};`).join(' ')} discarded = false; main(); return discarded ? null : { ${names.out} }; };`)(builtin, uniforms);
    return { uniforms, names, run };
}
