/* .splat4d, version 1, of adamraudonis/splats4D: a clip in which all frames have the same splats,
 * with the attributes of antimatter15's .splat. Values are quantised; a quantisation step is twice
 * the maximum error. A file is little endian and begins with a header of 12 bytes (offsets in
 * bytes):
 *
 *     0  "SP4D"
 *     4  version, 2 bytes
 *     6  flags, 2 bytes (1: colours were smoothed in time)
 *     8  length of the JSON, 4 bytes
 *
 * The JSON follows the header. It contains the number of splats n, the number of frames t, fps, the
 * quantisation steps, and offset and length of the following sections:
 *
 *     static section     For each attribute a stream of bits, one per row, highest bit of a byte
 *                        first: 1 if the row is static in this attribute. Then for each attribute
 *                        a stream of values, which contains all rows, though only the values of
 *                        static rows are used. The header of each stream directly precedes it.
 *     group of frames    Number of streams, 2 bytes; the headers of all streams; the data of all
 *                        streams. Each attribute has a stream of kind "key", with the codes of
 *                        the dynamic rows in the first frame, and a stream of kind "change", with
 *                        the differences of these codes from frame to frame.
 *
 * A stream header has 11 bytes: attribute, kind and bytes per symbol in one byte each, the number
 * of symbols and the compressed size in 4 bytes each. The data of a stream are byte planes
 * (planes.h), compressed with zstd. The Unity package gsplat-unity uses the extension .splat4d for
 * another format. */
#pragma once

#include "spin.h"

enum { SPIN_SPLAT4D_ATTRIBUTES = 5 };

/* An open clip, with one group of frames unpacked. */
struct spin_splat4d {
    size_t n; /* number of splats, which is the same in every frame */
    int n_frames;
    double fps;      /* frame i is at i / fps seconds */
    bool smoothed;   /* true: the writer smoothed the colours over time */
    unsigned moving; /* columns that change over time, a set of SPIN_COL_* */

    /* Private. */
    const unsigned char *file; /* the whole file; borrowed */
    size_t size;
    size_t static_at, static_bytes;
    struct spin_splat4d_group *groups;
    size_t n_groups, group; /* group: index of the unpacked group; SIZE_MAX: none */
    int frame;              /* index of the frame whose values are in `held` */
    struct spin_splat4d_attribute {
        double step, base_step; /* quantisation steps of dynamic and of static rows */
        /* [n][width] values of all rows, of which only those of static rows are used; units as in
         * struct spin_splats. */
        float *base;
        uint32_t *row; /* [n_moving] indices of the dynamic rows */
        size_t n_moving;
        int32_t *held; /* [n_moving][width] quantised values of the dynamic rows */
        /* Byte planes of the streams "key" and "change" in the unpacked group. */
        unsigned char *planes[2];
        int symbol[2]; /* bytes per symbol of these two streams */
    } attribute[SPIN_SPLAT4D_ATTRIBUTES];
};

/* Opens a file in memory. The memory must stay valid until spin_splat4d_close(). Checks all
 * lengths, and refuses decompression bombs. Error messages of these functions do not contain the
 * path. */
spin_status spin_splat4d_open(const unsigned char *file, size_t size, struct spin_splat4d *out);
void spin_splat4d_close(struct spin_splat4d *clip);
/* Reads a frame, 0..n_frames - 1. Frames can be read in any order; ascending order is fastest.
 * Values that are not finite are an error. Rotations are normalised. SH have degree 0. Fails with
 * SPIN_E_NOT_FOUND if the frame does not exist. */
spin_status spin_splat4d_read(struct spin_splat4d *clip, int frame, unsigned columns,
                              struct spin_splats *out);
