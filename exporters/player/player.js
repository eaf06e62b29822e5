// Embeds a clip in a web page. The clip is a page that `spin-export -o clip.html` wrote, the .bin
// file of such a page with --split, or a .sogst file. It plays in an iframe that fills an element
// and is controlled by a Player object. Frames count from 1; in a clip of 4D splats they may be
// fractions.

const PATIENCE = 5000; // milliseconds in which a loaded page must have reported its state
const WISHES = ['frame', 'autoplay', 'noui', 'poster', 'version', 'fps', 'background', 'view'];

// Parses an address of http, https, blob or file. Throws for other schemes, because javascript:
// would run in the embedding page.
function safeUrl(url) {
    const made = new URL(url, document.baseURI);
    if (!/^(https?|blob|file):$/.test(made.protocol)) throw new TypeError(`spin4d: the address '${String(url).slice(0, 60)}' is not one of http, https, blob or file`);
    return made;
}

// Returns the address of the clip's page with the options as parameters. The value of a switch is
// true or ''. Throws a TypeError if the address of the clip or of the poster is invalid or has a
// scheme that is not allowed.
export function addressOf(url, options = {}) {
    const source = safeUrl(url), address = source.pathname.endsWith('.sogst') ? new URL('view.html', import.meta.url) : source;
    if (address !== source) address.searchParams.set('src', source.href);
    address.pathname = address.pathname.replace(/\.bin$/, '.html');
    for (const name of WISHES) {
        const v = options[name];
        if (v === undefined || v === null) continue;
        const picture = name === 'poster' ? safeUrl(v).href : v;
        address.searchParams.set(name, v === true || v === '' ? '1' : v === false ? '0' : picture);
    }
    return address.href;
}

// Dispatches the events 'ready' when the first image is drawn, 'change' when `state` has changed,
// and 'error' when the page or a request has failed.
export class Player extends EventTarget {
    #frame;
    #tell;
    #waiting = [];
    state = null;

    constructor(element, url, options = {}) {
        super();
        const address = addressOf(url, options), frame = document.createElement('iframe');
        frame.src = address;
        frame.title = options.title ?? 'A clip of 3-D splats';
        frame.allow = 'fullscreen';
        frame.style.cssText = 'display: block; width: 100%; height: 100%; border: 0';
        this.#frame = frame;
        this.#tell = (e) => { if (e.source === frame.contentWindow && e.data?.spin4d) this.#hear(e.data.spin4d); };
        window.addEventListener('message', this.#tell);
        frame.addEventListener('load', () => setTimeout(() => { if (!this.state) this.#hear({ error: `spin4d: ${frame.src} is missing or is not a page of spin-export` }); }, PATIENCE));
        element.append(frame);
    }

    #hear(said) {
        if (said.error) return this.dispatchEvent(Object.assign(new Event('error'), { message: said.error }));
        const was = this.state;
        this.state = said;
        for (const wishes of was ? [] : this.#waiting.splice(0)) this.set(wishes);
        if (said.ready && !was?.ready) this.dispatchEvent(new Event('ready'));
        return this.dispatchEvent(new Event('change'));
    }

    // Changes the state. Requests are { play, frame, speed, version, view }, each optional, and are
    // queued until the page is loaded.
    set(wishes) {
        if (!this.state) this.#waiting.push(wishes);
        else this.#frame.contentWindow.postMessage({ spin4d: wishes }, '*');
    }

    play() { this.set({ play: true }); }
    pause() { this.set({ play: false }); }
    seek(frame) { this.set({ play: false, frame }); }
    get speed() { return this.state?.speed ?? 1; }
    set speed(speed) { this.set({ speed }); }
    get version() { return this.state?.version ?? ''; }
    set version(version) { this.set({ version }); }

    destroy() {
        window.removeEventListener('message', this.#tell);
        this.#frame.remove();
    }
}

export const createPlayer = (element, url, options) => new Player(element, url, options);

// The element <spin-clip src="clip.html" autoplay noui ...>. Its attributes are the options; its
// property `player` is the Player.
if (globalThis.customElements && !customElements.get('spin-clip')) {
    customElements.define('spin-clip', class extends HTMLElement {
        static observedAttributes = ['src'];
        // Whether connectedCallback() has run. If the element is in the document before its class
        // is defined, attributeChangedCallback() runs first; it must not load the clip as well.
        #connected = false;
        connectedCallback() { this.#connected = true; this.#open(); }
        disconnectedCallback() { this.#connected = false; this.#close(); }
        attributeChangedCallback(name, old, value) { if (this.#connected && old !== value) this.#open(); }
        #close() {
            this.player?.destroy();
            this.player = null;
        }
        #open() {
            this.#close();
            if (!this.hasAttribute('src')) return;
            if (!this.style.display) Object.assign(this.style, { display: 'block', aspectRatio: this.style.aspectRatio || '16 / 9' });
            const options = Object.fromEntries([...WISHES, 'title'].filter((name) => this.hasAttribute(name)).map((name) => [name, this.getAttribute(name)]));
            try {
                this.player = createPlayer(this, this.getAttribute('src'), options);
            } catch (e) {
                this.dispatchEvent(Object.assign(new Event('error'), { message: e.message }));
                return;
            }
            for (const type of ['ready', 'change', 'error']) this.player.addEventListener(type, (e) => this.dispatchEvent(Object.assign(new Event(type), { message: e.message })));
        }
    });
}
