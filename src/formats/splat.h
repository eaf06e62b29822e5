/* .splat, the format of antimatter15's viewer. There is no header; each splat has 32 bytes, with SH
 * of degree 0 only. Offsets in bytes:
 *
 *      0  position, 3 floats
 *     12  scale, 3 floats (standard deviations, not logarithms)
 *     24  colour, 3 bytes: clamp(0.5 + C0 dc) * 255
 *     27  opacity, 1 byte: opacity * 255
 *     28  rotation w x y z, 4 bytes: q * 128 + 128 */
#pragma once

#include "formats/gaussian.h"

enum { SPIN_SPLAT_ROW = 32 };

void spin_splat_code(const struct spin_gaussian *row, unsigned char out[SPIN_SPLAT_ROW]);
/* Decodes the values that are stored as bytes: colour, opacity and rotation. The rotation is
 * normalised. out->place and out->log_scale stay unchanged. */
void spin_splat_decode_bytes(const unsigned char in[SPIN_SPLAT_ROW], struct spin_gaussian *out);

/* Reads a whole file from memory. Positions and scales that are not finite are an error. Scales
 * below 1e-38, including 0 and negative ones, become 1e-38. Error messages do not contain the path.
 */
spin_status spin_splat_read(const unsigned char *bytes, size_t n_bytes, unsigned columns,
                            struct spin_splats *out);
