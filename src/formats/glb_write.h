/* A .glb of frames of splats (formats/glb.h), all floats, each attribute in one piece. Bytes are written in any order to
 * their places; the JSON, which comes first in the file but is known last, goes into room that was left for it. */
#ifndef SPIN_FORMATS_GLB_WRITE_H
#define SPIN_FORMATS_GLB_WRITE_H

#include "formats/gaussian.h"
#include "formats/glb.h"
#include "io/file.h"

/* POSITION, ROTATION, SCALE, OPACITY, the SH coefficients, COLOR_0. */
enum { SPIN_GLB_MAX_ATTRIBUTES = 4 + SPIN_SH_MAX + 1 };

/* Rows of an attribute in the binary chunk. */
struct spin_glb_column {
    int attribute;
    uint64_t n, offset;
    uint64_t hash[2];      /* of what it holds */
    float low[3], high[3]; /* of POSITION */
};

/* A node with a mesh of points, or without one when n is 0. */
struct spin_glb_frame {
    size_t n;
    int number;  /* the source's */
    double time; /* in the source's unit */
    size_t
        column[SPIN_GLB_MAX_ATTRIBUTES]; /* which one each attribute has; frames may share them */
};

struct spin_glb_clip {
    /* Set before spin_glb_begin(). */
    struct spin_out *out; /* the caller opens and commits it */
    int sh_degree;
    const char *axes, *source; /* for extras; source NULL: unknown */
    double fps;                /* 0: unknown */
    int n_frames;
    bool animated; /* frames take turns, by STEP keys on the scale of their nodes */

    /* The attributes in the order of the file: bytes a row, and their sum. */
    int n_attributes;
    size_t width[SPIN_GLB_MAX_ATTRIBUTES], row;
    size_t room; /* bytes kept for the JSON */

    /* Set before spin_glb_end(). */
    const struct spin_glb_frame *frame; /* [n_frames] */
    /* Points of all frames, in a node of their own: the last of the list and the first of the scene, as some viewers draw
     * mesh after mesh. Its number and time say nothing. NULL, or n 0: none. */
    const struct spin_glb_frame *still;
    const struct spin_glb_column *column; /* [n_columns] */
    size_t n_columns;
    uint64_t n_bytes; /* of the binary chunk so far; becomes those of all of it */
};

void spin_glb_begin(struct spin_glb_clip *clip);
/* Of a file with so many rows; after spin_glb_begin(). */
uint64_t spin_glb_bytes(const struct spin_glb_clip *clip, uint64_t n_rows);

/* A row to place `at` of each attribute's column, from the first n_sh coefficients [k][3]; more are written
 * as 0. The columns are in this machine's byte order until spin_glb_order(), which is given rows 0..n. */
void spin_glb_code(const struct spin_glb_clip *clip, const struct spin_gaussian *row,
                   const float *sh, int n_sh, unsigned char *const column[], size_t at);
void spin_glb_order(const struct spin_glb_clip *clip, unsigned char *const column[], size_t n);

/* At a place in the binary chunk, by any thread, without the trail: 0, or an error for spin_glb_failed(). */
int spin_glb_put(const struct spin_glb_clip *clip, uint64_t at, const void *data, size_t bytes);
/* SPIN_E_UNSUPPORTED beyond the 4 GiB that the format can count. */
spin_status spin_glb_failed(const struct spin_glb_clip *clip, int error);
/* Everything in [0, n_bytes) has been written. Adds the keys of the animation, and what stands before the bytes. */
spin_status spin_glb_end(struct spin_glb_clip *clip);

#endif
