/** The state of a clip. Frames count from 1; in a clip of 4D splats they may be fractions. */
export interface State {
    play: boolean;
    frame: number;
    frames: number;
    speed: number;
    /** 'after', 'before' or 'wipe' if there are two versions; else the version's name. */
    version: string;
    /** The first image is drawn. */
    ready: boolean;
}

export interface Options {
    frame?: number | string;
    autoplay?: boolean | string;
    noui?: boolean | string;
    /** The address of an image to show until the first frame is drawn. */
    poster?: string;
    version?: string;
    fps?: number | string;
    /** RGB in hexadecimal. */
    background?: string;
    /** The title of the frame, for screen readers. */
    title?: string;
}

export type Wishes = Partial<Pick<State, 'play' | 'frame' | 'speed' | 'version'>>;

/** Events: 'ready', 'change', and 'error', which has a message. */
export declare class Player extends EventTarget {
    constructor(element: Element, url: string, options?: Options);
    /** null until the page is loaded. */
    readonly state: State | null;
    speed: number;
    version: string;
    set(wishes: Wishes): void;
    play(): void;
    pause(): void;
    seek(frame: number): void;
    destroy(): void;
}

/** url: a page of spin-export, the .bin of --split beside its page, or a .sogst file. Throws a
 * TypeError unless it and the poster are relative or of http, https, blob or file. */
export declare function createPlayer(element: Element, url: string, options?: Options): Player;
export declare function addressOf(url: string, options?: Options): string;
