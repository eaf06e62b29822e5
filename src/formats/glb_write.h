/* Writes a .glb of frames of splats (formats/glb.h): all floats, each attribute of a frame
 * contiguous. Binary data are written in any order to their final offsets; the JSON, which comes
 * first in the file but is known last, goes into reserved space. */
#pragma once

#include "formats/gaussian.h"
#include "formats/glb.h"
#include "formats/glb_shim.h"
#include "io/file.h"

/* Checks that tinygltf, which creates the JSON, can be loaded; the error says how to install it. */
spin_status spin_glb_can_write(void);
/* Reserves space for the JSON; the attributes follow from the SH degree. */
void spin_glb_begin(struct spin_glb_clip *clip);
/* The size of a file with this many rows; call it after spin_glb_begin(). */
uint64_t spin_glb_bytes(const struct spin_glb_clip *clip, uint64_t n_rows);

/* Writes a row at index `at` of each attribute's column, from the first n_sh coefficients [k][3];
 * the others are written as 0. The columns are in native byte order until spin_glb_order() converts
 * rows 0..n. */
void spin_glb_code(const struct spin_glb_clip *clip, const struct spin_gaussian *row,
                   const float *sh, int n_sh, unsigned char *const column[], size_t at);
void spin_glb_order(const struct spin_glb_clip *clip, unsigned char *const column[], size_t n);

/* Writes at an offset of the binary chunk. Thread-safe; does not set the error message: returns 0,
 * or an error for spin_glb_failed(). */
int spin_glb_put(const struct spin_glb_clip *clip, uint64_t at, const void *data, size_t bytes);
/* Converts such an error to a status; SPIN_E_UNSUPPORTED beyond the 4 GiB limit of the format. */
spin_status spin_glb_failed(const struct spin_glb_clip *clip, int error);
/* Ends the file after all of [0, n_bytes) has been written: adds the keys of the animation, and
 * everything before the binary data. */
spin_status spin_glb_end(struct spin_glb_clip *clip);
