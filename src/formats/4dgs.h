/* .4dgs of avala-ai, version 1 (draft): 4D splats that are born once, each in its own window of
 * time. Everything is little endian. The magic, records, the magic again; a record is an opcode,
 * the length of its content (8 bytes), and the content, at whose end later writers may add:
 *
 *     01  header         profile, writer, duration, splats, cutoff, temporal model, box, SH degree, flags
 *     03  quantization   scheme, origin of places, steps of all else
 *     04  window table   first and end of each window
 *     05  chunk          its interval, level, splats, codec, and streams of all attributes
 *     07  SH band        the band, and a stream of its coefficients for the chunk before
 *     02  footer         where the index begins, and its checksum
 *
 * A stream is 17 bytes (attribute, bytes of a symbol, mode, codec, channels, 4 bytes of elements, 8
 * of length) and zlib or zstd of byte planes (planes.h); text is 4 bytes of length and its bytes. A
 * splat is seen where its window and its chunk are, at weights of the cutoff and above. How fine
 * the steps of velocity and own time are depends on its sigma. */
#pragma once

#include "spin.h"

struct spin_4dgs {
    double duration;    /* seconds from 0 */
    double cutoff;      /* least weight */
    bool sound, camera; /* it has those, too */
};

/* All of a file in memory; the splats are not settled yet. Ends of windows, which are doubles
 * there, are the floats at or below them. keyframe-delta models and tracks of objects are refused
 * by name. Errors do not name the file. */
spin_status spin_4dgs_read(const unsigned char *file, size_t size, struct spin_4dgs *out,
                           struct spin_splats_4d *splats);
