// The lines that docs/how-to/viewers.md offers for embedding.
import fs from 'node:fs';

const NAME = /^<!-- (\w+) -->$/;

// Keyed by the name in the comment before a block: { iframe: '<iframe ...', ... }
export function snippets() {
    const lines = fs.readFileSync(new URL('../../../docs/how-to/viewers.md', import.meta.url), 'utf8').split('\n'), found = {};
    lines.forEach((line, i) => {
        const name = NAME.exec(line)?.[1];
        if (!name) return;
        const from = i + 2, to = lines.indexOf('```', from);
        if (lines[i + 1] !== '```html' || to < 0) throw new Error(`viewers.md: no html behind <!-- ${name} -->`);
        found[name] = lines.slice(from, to).join('\n');
    });
    return found;
}
