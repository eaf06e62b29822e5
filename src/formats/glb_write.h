/* Writes the frames of a clip to one .glb (formats/glb.h). Each attribute of a frame is a
 * contiguous array, a column; all are floats except the 16-bit COLOR_0. Columns are written to
 * their final offsets, in any order. The JSON precedes the binary data in the file but depends on
 * all of them, so it is written last, into reserved space. */
#pragma once

#include "formats/gaussian.h"
#include "formats/glb.h"
#include "formats/glb_shim.h"
#include "io/file.h"

/* Loads the shared object that contains tinygltf, which creates the JSON. If it is missing, the
 * error message explains how to install it. */
spin_status spin_glb_can_write(void);
/* Sets the members of *clip that describe the attributes, which depend on clip->sh_degree, and the
 * number of bytes to reserve for the JSON. */
void spin_glb_begin(struct spin_glb_clip *clip);
/* Returns the size in bytes of a file with n_rows splats. spin_glb_begin() must have been called.
 */
uint64_t spin_glb_bytes(const struct spin_glb_clip *clip, uint64_t n_rows);

/* Writes a splat to row `at` of all columns, in native byte order. sh: n_sh coefficients [k][3];
 * missing coefficients are written as 0. */
void spin_glb_code(const struct spin_glb_clip *clip, const struct spin_gaussian *row,
                   const float *sh, int n_sh, unsigned char *const column[], size_t at);
/* Converts rows 0 to n - 1 of all columns from native byte order to little endian. */
void spin_glb_order(const struct spin_glb_clip *clip, unsigned char *const column[], size_t n);

/* Writes data at offset `at` of the binary chunk. Thread-safe. Returns 0, or an error code, for
 * which spin_glb_failed() sets the error message. */
int spin_glb_put(const struct spin_glb_clip *clip, uint64_t at, const void *data, size_t bytes);
/* Converts an error code of spin_glb_put() to a status with a message. SPIN_E_UNSUPPORTED if the
 * file would exceed 4 GiB, the limit of the format. */
spin_status spin_glb_failed(const struct spin_glb_clip *clip, int error);
/* Completes the file: appends the animation's data to the binary chunk, then writes the JSON and
 * the headers. Bytes [0, clip->n_bytes) of the chunk must have been written. */
spin_status spin_glb_end(struct spin_glb_clip *clip);
