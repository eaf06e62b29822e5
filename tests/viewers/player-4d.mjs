#!/usr/bin/env node
// Prints what the player of TSOG and .ftgs.ply reads, as arrays of floats: see player-4d.py.
import fs from 'node:fs';
import path from 'node:path';
import { pathToFileURL } from 'node:url';

const [player, file, pictures, out] = process.argv.slice(2);
const module = (name) => import(pathToFileURL(path.join(player, name)).href);

// An image written by dwebp -pam.
function picture(name) {
    const bytes = fs.readFileSync(path.join(pictures, `${name}.pam`)), head = bytes.subarray(0, 200).toString('latin1');
    const number = (key) => Number(new RegExp(`${key} (\\d+)`).exec(head)[1]);
    return { width: number('WIDTH'), height: number('HEIGHT'), rgba: new Uint8Array(bytes.subarray(head.indexOf('ENDHDR\n') + 7)) };
}

let model;
if (pictures) {
    const { decodeTSOG } = await module('tsog.js');
    model = await decodeTSOG(JSON.parse(fs.readFileSync(path.join(pictures, 'meta.json'))), picture);
} else {
    const { readFTGS } = await module('ftgs.js');
    model = await readFTGS(new Blob([fs.readFileSync(file)]));
}
const { count, coefficients, nFrames, timelineMode = 0 } = model;
fs.writeFileSync(path.join(out, 'model.json'), JSON.stringify({ count, coefficients, nFrames, timelineMode }));
for (const name of ['positionTime', 'velocityDuration', 'covarianceA', 'covarianceB', 'sh', 'alpha'])
    fs.writeFileSync(path.join(out, name), Buffer.from(model[name].buffer));
