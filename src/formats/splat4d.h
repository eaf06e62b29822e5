/* .splat4d, version 1, of adamraudonis/splats4D: frames of the same splats with the attributes of
 * antimatter15's .splat, quantised in steps of twice an error bound. Everything is little endian.
 *
 *     0  "SP4D"     4  version, 2 bytes     6  flags, 2 bytes (1: colours were smoothed in time)
 *     8  bytes of the JSON that follows, 4: n, t, fps, steps, and offsets of the static section
 *        and the groups
 *
 *     stream header, 11 bytes   attribute, kind, bytes of a symbol; 4 each: symbols, compressed
 *                               bytes
 *     static section            streams, each after its header: for every attribute its static rows
 *                               (a bit each, highest first); then values of all rows, of which the
 *                               static ones are used
 *     group of frames           number of streams, 2 bytes; their headers; their compressed bytes.
 *                               For dynamic rows: the steps of the first frame (key), and the
 *                               differences of each next frame (change)
 *
 * A stream is byte planes (planes.h) compressed by zstd. The Unity package gsplat-unity has another
 * format with the same extension. */
#pragma once

#include "spin.h"

enum { SPIN_SPLAT4D_ATTRIBUTES = 5 };

/* A clip in memory, with one group of frames unpacked. */
struct spin_splat4d {
    size_t n; /* splats, the same in every frame */
    int n_frames;
    double fps;      /* frame i is at i / fps seconds */
    bool smoothed;   /* colours were smoothed in time */
    unsigned moving; /* columns that change over time */

    /* Private. */
    const unsigned char *file; /* must stay valid until the close */
    size_t size;
    size_t static_at, static_bytes;
    struct spin_splat4d_group *groups;
    size_t n_groups, group; /* the unpacked one; SIZE_MAX: none */
    int frame;              /* the frame of the values in `held` */
    struct spin_splat4d_attribute {
        double step, base_step; /* of dynamic and of static rows */
        float *base;            /* [n][width], converted to columns */
        uint32_t *row;          /* [n_moving] the dynamic rows */
        size_t n_moving;
        int32_t *held;            /* [n_moving][width] in steps */
        unsigned char *planes[2]; /* of the group: key, and changes */
        int symbol[2];            /* bytes per symbol */
    } attribute[SPIN_SPLAT4D_ATTRIBUTES];
};

/* The file must stay valid until the close. All lengths are checked; a file that unpacks to much
 * more than a clip would is refused. Errors do not name the file, here and below. */
spin_status spin_splat4d_open(const unsigned char *file, size_t size, struct spin_splat4d *out);
void spin_splat4d_close(struct spin_splat4d *clip);
/* Reads a frame, in any order; reading the next one is fastest. All values are checked to be
 * finite, rotations are normalised; SH have degree 0. */
spin_status spin_splat4d_read(struct spin_splat4d *clip, int frame, unsigned columns,
                              struct spin_splats *out);
