/* .splat, the light preview format of antimatter15's viewer: no header, 32 bytes a Gaussian, no
 * colour beyond SH degree 0.
 *
 *     0  place, 3 floats        24  colour, 3 bytes   clamp(0.5 + C0 dc) * 255
 *    12  scale, 3 floats        27  opacity, 1 byte
 *                               28  rotation w x y z, 4 bytes   q * 128 + 128 */
#pragma once

#include "formats/gaussian.h"

enum { SPIN_SPLAT_ROW = 32 };

void spin_splat_code(const struct spin_gaussian *row, unsigned char out[SPIN_SPLAT_ROW]);
/* What is stored in bytes: colour, opacity and rotation (of unit length). Place and scale, which
 * are floats, are left alone. */
void spin_splat_decode_bytes(const unsigned char in[SPIN_SPLAT_ROW], struct spin_gaussian *out);

/* A whole file in memory. Places and scales must be finite; a scale of 0 and below becomes the
 * least float. Errors do not name the file. */
spin_status spin_splat_read(const unsigned char *bytes, size_t n_bytes, unsigned columns,
                            struct spin_splats *out);
