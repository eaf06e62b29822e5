/* .splat4d, version 1, of adamraudonis/splats4D: frames of the same splats, as antimatter15's
 * .splat has them, in steps of twice a bound. Everything is little endian.
 *
 *     0  "SP4D"     4  version, 2 bytes     6  flags, 2 bytes (1: colours were smoothed in time)
 *     8  bytes of the JSON that follows, 4: n, t, fps, steps, and where the static section and the groups lie
 *
 *     a stream's head, 11 bytes   attribute, kind, bytes of a symbol; 4 each: symbols, bytes packed
 *     static section              streams, each behind its head: for every attribute the rows that stand still (a bit
 *                                 each, highest first); then their values, where first frames of the others stand too
 *     a group of frames           number of streams, 2 bytes; their heads; their packed bytes. Of the rows that move:
 *                                 the steps of its first frame (key), the differences of each next frame (change)
 *
 * A stream is zstd of byte planes (planes.h). The Unity package gsplat-unity has another format of
 * the same ending. */
#pragma once

#include "spin.h"

enum { SPIN_SPLAT4D_ATTRIBUTES = 5 };

/* A clip in memory, with one group of frames unpacked. */
struct spin_splat4d {
    size_t n; /* splats, the same in every frame */
    int n_frames;
    double fps;      /* frame i is at i / fps seconds */
    bool smoothed;   /* colours were, in time */
    unsigned moving; /* columns that change */

    /* Private. */
    const unsigned char *file; /* borrowed */
    size_t size;
    size_t static_at, static_bytes;
    struct spin_splat4d_group *groups;
    size_t n_groups, group; /* the one at hand; SIZE_MAX: none */
    int frame;              /* that `held` is at */
    struct spin_splat4d_attribute {
        double step, base_step; /* of rows that move, and of others */
        float *base;            /* [n][width] finished */
        uint32_t *row;          /* [n_moving] */
        size_t n_moving;
        int32_t *held;            /* [n_moving][width] steps */
        unsigned char *planes[2]; /* of the group: key, and changes */
        int symbol[2];            /* bytes of their symbols */
    } attribute[SPIN_SPLAT4D_ATTRIBUTES];
};

/* The file must stay until close(). Its lengths must fit it, and what would unpack to far more than
 * a clip does is refused. Errors do not name the file, here and below. */
spin_status spin_splat4d_open(const unsigned char *file, size_t size, struct spin_splat4d *out);
void spin_splat4d_close(struct spin_splat4d *clip);
/* Frames in any order; next frames are the fastest. All that comes out is finite, rotations are of
 * unit length; SH have degree 0. */
spin_status spin_splat4d_read(struct spin_splat4d *clip, int frame, unsigned columns,
                              struct spin_splats *out);
