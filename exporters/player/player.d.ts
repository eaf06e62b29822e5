/** What a clip does now. Frames count from 1; of a clip of 4D splats they may be fractions. */
export interface State {
    play: boolean;
    frame: number;
    frames: number;
    speed: number;
    /** Of two versions 'after', 'before' or 'wipe'; of one its name. */
    version: string;
    /** The first picture is there. */
    ready: boolean;
}

export interface Options {
    frame?: number | string;
    autoplay?: boolean | string;
    noui?: boolean | string;
    /** A picture until the first frame is there. */
    poster?: string;
    version?: string;
    fps?: number | string;
    /** Red, green and blue in hexadecimal. */
    background?: string;
    /** Of the frame, for those who are read to. */
    title?: string;
}

export type Wishes = Partial<Pick<State, 'play' | 'frame' | 'speed' | 'version'>>;

/** Events: 'ready', 'change', and 'error', which has a message. */
export declare class Player extends EventTarget {
    constructor(element: Element, url: string, options?: Options);
    /** null until the page is there. */
    readonly state: State | null;
    speed: number;
    version: string;
    set(wishes: Wishes): void;
    play(): void;
    pause(): void;
    seek(frame: number): void;
    destroy(): void;
}

/** url: a page of spin-export, the .bin of --split beside its page, or a .sogst file. Throws a TypeError unless it and the
 * poster are relative or of http, https, blob or file. */
export declare function createPlayer(element: Element, url: string, options?: Options): Player;
export declare function addressOf(url: string, options?: Options): string;
