// The formats that the bench knows: how they are named, read, and how their axes stand to a PLY's.
import path from 'node:path';
import { readGlb, readPly } from './splat.mjs';
import { readCompressedPly, readSplat, readSpz } from './compact.mjs';

// A camera is given in the axes of a 3DGS PLY (x right, y down, z away). glTF stands half a turn about
// z from there; the others keep the PLY's axes.
const same = (v) => v;
const aboutZ = ([x, y, z]) => [-x, -y, z];

export const KINDS = {
    'compressed-ply': { ends: '.compressed.ply', read: readCompressedPly, turn: same, tool: true },
    ply: { ends: '.ply', read: readPly, turn: same, tool: true },
    glb: { ends: '.glb', read: readGlb, turn: aboutZ },
    spz: { ends: '.spz', read: readSpz, turn: same, tool: true },
    splat: { ends: '.splat', read: readSplat, turn: same, tool: true }
};

export function kindOf(file) {
    const name = path.basename(file).toLowerCase();
    return Object.keys(KINDS).find((k) => name.endsWith(KINDS[k].ends));
}

export const turned = (cam, kind) => {
    const turn = KINDS[kind].turn;
    return { ...cam, eye: turn(cam.eye), target: turn(cam.target), up: turn(cam.up) };
};
