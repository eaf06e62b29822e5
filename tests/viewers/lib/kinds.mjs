// The formats that the bench knows: their names, their readers, and the relation of their axes to
// those of a PLY.
import fs from 'node:fs';
import path from 'node:path';
import { readGlb, readPly } from './splat.mjs';
import { readCompressedPly, readSog, readSplat, readSpz } from './compact.mjs';

// A camera is given in the axes of a 3DGS PLY (x right, y down, z forward). glTF is rotated from
// these by half a turn about z; the others keep them.
const same = (v) => v;
const aboutZ = ([x, y, z]) => [-x, -y, z];

export const KINDS = {
    'compressed-ply': { ends: '.compressed.ply', read: readCompressedPly, turn: same, tool: true },
    ply: { ends: '.ply', read: readPly, turn: same, tool: true },
    glb: { ends: '.glb', read: readGlb, turn: aboutZ },
    spz: { ends: '.spz', label: '`.spz`, version 4', read: readSpz, turn: same, tool: true },
    spz3: { ends: '.spz', label: '`.spz`, version 3', read: readSpz, turn: same, tool: true },
    sog: { ends: '.sog', read: readSog, turn: same, tool: true },
    'streamed-sog': { ends: 'lod-meta.json', label: 'streamed SOG', read: readSog, turn: same, tool: true },
    splat: { ends: '.splat', read: readSplat, turn: same, tool: true }
};

function isGzip(file) {
    if (fs.statSync(file).isDirectory()) return false;
    const at = fs.openSync(file), head = Buffer.alloc(2);
    fs.readSync(at, head, 0, 2, 0);
    fs.closeSync(at);
    return head.readUInt16BE(0) === 0x1f8b;
}

export function kindOf(file) {
    const name = path.basename(file).toLowerCase();
    const kind = Object.keys(KINDS).find((k) => name.endsWith(KINDS[k].ends));
    return kind === 'spz' && isGzip(file) ? 'spz3' : kind;
}

export const turned = (cam, kind) => {
    const turn = KINDS[kind].turn;
    return { ...cam, eye: turn(cam.eye), target: turn(cam.target), up: turn(cam.up) };
};
