/* The .4dgs format of avala-ai, version 1 (draft): 4D splats, each visible during one interval of
 * time. A file is little endian. It consists of a magic number, records, and the magic number
 * again. A record is an opcode (1 byte), the length of its content (8 bytes), and the content, to
 * which newer writers may append fields:
 *
 *     01  header         profile, writer, duration, number of splats, cutoff, temporal model,
 *                        bounding box, SH degree, flags
 *     03  quantization   scheme, origin of positions, quantisation steps
 *     04  window table   start and end of each window
 *     05  chunk          interval of time, level, number of splats, codec, and one stream for each
 *                        attribute
 *     07  SH band        number of the band, and a stream of its coefficients for the splats of the
 *                        preceding chunk
 *     11  audio source   id, name, codec, start, duration, gain and position of a sound
 *     12  audio data     id of a sound, and its file
 *     02  footer         offset of the index, and its checksum
 *
 * A stream contains the integers of one attribute: a header of 17 bytes, followed by byte planes
 * (planes.h) that are compressed with zlib or zstd. The stream header contains attribute, bytes per
 * symbol, mode, codec and number of channels in one byte each, the number of splats in 4 bytes, and
 * the compressed length in 8 bytes. A text is a 4-byte length followed by its characters.
 *
 * In files of the temporal model keyframe-delta, each chunk defines a state: the splats that are
 * visible until the next chunk. Chunks of record 05 are keyframes, with all splats of the state and
 * their ids. Chunks of record 10 contain only the differences from an earlier state:
 *
 *     10  delta chunk    updates of splats, births and deaths
 *
 * The reader converts a splat to several 4D splats, one for each interval in which the splat does
 * not change.
 *
 * A splat is visible while three conditions are met: the time is within the splat's entry of the
 * window table, the time is within the interval of the splat's chunk, and the splat's Gaussian
 * window is at or above the cutoff. The quantisation steps of a splat's velocity and centre in time
 * depend on the standard deviation (sigma) of its Gaussian window. */
#pragma once

#include "spin.h"

struct spin_4dgs {
    double duration; /* length of the clip in seconds; the clip starts at time 0 */
    double cutoff;   /* splats are not drawn while their Gaussian window is below this value */
    bool camera;     /* true: the file contains a camera path */
    /* The first sound that has no position in the scene or, if all sounds have one, the first
     * sound. Its data point into the file in memory. */
    struct spin_sound sound;
    char sound_notes[512]; /* one line for each property or sound that is dropped */
    bool keyframes;        /* true: the temporal model is keyframe-delta */
    /* Frames per second, from the metadata that spin4d writes or, if states are evenly spaced, the
     * number of states per second; 0: unknown. */
    double fps;
};

/* Reads a whole file from memory. The caller must call spin_splats_4d_finish() on the splats.
 * Starts and ends of windows, which are doubles in the file, are rounded down to floats. Files with
 * object tracks are refused. Error messages do not contain the path. */
spin_status spin_4dgs_read(const unsigned char *file, size_t size, struct spin_4dgs *out,
                           struct spin_splats_4d *splats);
