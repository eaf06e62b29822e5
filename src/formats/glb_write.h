/* A .glb of frames of splats (formats/glb.h), all floats, each attribute in one piece. Bytes are
 * written in any order to their places; the JSON, which comes first in the file but is known last,
 * goes into room that was left for it. */
#pragma once

#include "formats/gaussian.h"
#include "formats/glb.h"
#include "formats/glb_shim.h"
#include "io/file.h"

/* Whether tinygltf, which makes the JSON, can be loaded; else an error that says how to get it. */
spin_status spin_glb_can_write(void);
/* Room for everything; the attributes follow from the SH degree. */
void spin_glb_begin(struct spin_glb_clip *clip);
/* Of a file with so many rows; after spin_glb_begin(). */
uint64_t spin_glb_bytes(const struct spin_glb_clip *clip, uint64_t n_rows);

/* A row to place `at` of each attribute's column, from the first n_sh coefficients [k][3]; more are
 * written as 0. The columns are in this machine's byte order until spin_glb_order(), which is given
 * rows 0..n. */
void spin_glb_code(const struct spin_glb_clip *clip, const struct spin_gaussian *row,
                   const float *sh, int n_sh, unsigned char *const column[], size_t at);
void spin_glb_order(const struct spin_glb_clip *clip, unsigned char *const column[], size_t n);

/* At a place in the binary chunk, by any thread, without the trail: 0, or an error for
 * spin_glb_failed(). */
int spin_glb_put(const struct spin_glb_clip *clip, uint64_t at, const void *data, size_t bytes);
/* SPIN_E_UNSUPPORTED beyond the 4 GiB that the format can count. */
spin_status spin_glb_failed(const struct spin_glb_clip *clip, int error);
/* Everything in [0, n_bytes) has been written. Adds the keys of the animation, and what stands
 * before the bytes. */
spin_status spin_glb_end(struct spin_glb_clip *clip);
