/** The state of a clip. Frames count from 1; in a clip of 4D splats they may be fractions. */
export interface State {
    play: boolean;
    frame: number;
    frames: number;
    speed: number;
    /** 'after', 'before' or 'wipe' if there are two versions; else the version's name. */
    version: string;
    /** Whether the first image has been drawn. */
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
    /** RGB in hexadecimal, such as 'ffffff'. */
    background?: string;
    /** The position and the target of the camera in world units: 'x,y,z,x,y,z'. */
    view?: string;
    /** The title of the iframe, for screen readers. */
    title?: string;
}

/** The position and the target of the camera, in world units: two points or six numbers. */
export type View = { eye: number[]; target: number[] } | number[];

export type Wishes = Partial<Pick<State, 'play' | 'frame' | 'speed' | 'version'>> & { view?: View };

/** Dispatches the events 'ready', 'change' and 'error'; 'error' has a message. */
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

/** url: a page of spin-export, the .bin file of a page with --split, or a .sogst file. Throws a
 * TypeError if the url or the poster is neither relative nor of http, https, blob or file. */
export declare function createPlayer(element: Element, url: string, options?: Options): Player;
export declare function addressOf(url: string, options?: Options): string;
