/* .splat, the preview format of antimatter15's viewer: no header, 32 bytes per Gaussian, SH degree
 * 0 only.
 *
 *     0  position, 3 floats     24  colour, 3 bytes   clamp(0.5 + C0 dc) * 255
 *    12  scale, 3 floats        27  opacity, 1 byte
 *                               28  rotation w x y z, 4 bytes   q * 128 + 128 */
#pragma once

#include "formats/gaussian.h"

enum { SPIN_SPLAT_ROW = 32 };

void spin_splat_code(const struct spin_gaussian *row, unsigned char out[SPIN_SPLAT_ROW]);
/* Decodes the fields stored as bytes: colour, opacity and rotation (normalised). Position and
 * scale, which are floats, are left unchanged. */
void spin_splat_decode_bytes(const unsigned char in[SPIN_SPLAT_ROW], struct spin_gaussian *out);

/* Reads a whole file in memory. Positions and scales must be finite; a scale of 0 or less becomes
 * the smallest normal float. Errors do not name the file. */
spin_status spin_splat_read(const unsigned char *bytes, size_t n_bytes, unsigned columns,
                            struct spin_splats *out);
