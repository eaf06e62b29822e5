/* .4dgs of avala-ai, version 1 (draft): 4D splats, each visible once, in its own window of time.
 * Everything is little endian: the magic, records, the magic again. A record is an opcode, the
 * length of its content (8 bytes), and the content, to which later writers may append fields:
 *
 *     01  header         profile, writer, duration, splats, cutoff, temporal model, bounding box,
 *                        SH degree, flags
 *     03  quantization   scheme, origin of positions, steps of everything else
 *     04  window table   first and end of each window
 *     05  chunk          its interval, level, splats, codec, and streams of all attributes
 *     07  SH band        the band, and a stream of its coefficients for the preceding chunk
 *     02  footer         offset of the index, and its checksum
 *
 * A stream is 17 bytes (attribute, bytes of a symbol, mode, codec, channels, 4 bytes: elements, 8
 * bytes: length) and byte planes (planes.h) compressed by zlib or zstd; text is 4 bytes of length
 * and its bytes. A splat is visible within its window and the interval of its chunk, while its
 * Gaussian window is at or above the cutoff. The steps of velocity and own time depend on sigma. */
#pragma once

#include "spin.h"

struct spin_4dgs {
    double duration;    /* seconds from 0 */
    double cutoff;      /* least value of the Gaussian window */
    bool sound, camera; /* the file also contains these */
};

/* Reads a whole file in memory; the splats are not settled yet. The ends of windows, which are
 * doubles in the file, are rounded down to floats. keyframe-delta models and object tracks are
 * refused with an error that names them. Errors do not name the file. */
spin_status spin_4dgs_read(const unsigned char *file, size_t size, struct spin_4dgs *out,
                           struct spin_splats_4d *splats);
