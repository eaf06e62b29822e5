/* Encodes the kept rows of a frame as the images of a SOG (formats/sog.h). Rows are usually in
 * Morton order, since WebP compresses better if neighbouring pixels are similar splats.
 *
 * Codes of static splats should not change from frame to frame. For this, the bounding box of
 * positions only grows, and codebooks of an earlier frame are reused if their error is close to
 * that of new ones. The palette of SH is not reused: each frame has its own. */
#pragma once

#include "exporters/lib/pictures.h"
#include "exporters/lib/quant_error.h"
#include "exporters/lib/splat_rows.h"
#include "formats/sog.h"

struct spin_sog_images {
    int level; /* effort of WebP, 0 to 9; set by the caller, who zeroes all other members */
    struct spin_sog sog;
    struct spin_picture picture[SPIN_SOG_PICTURES];

    /* Private. */
    bool begun; /* true: `sog` contains the bounding box and the codebooks of an earlier frame */
    const struct spin_splat_rows *rows;
    const struct spin_keyed *order;
    struct spin_quant_error *block_quant;
    float *scales, *dc; /* [n][3] logarithms of scales; SH coefficients of degree 0 */
    float *rest;        /* [n][n_rest] SH coefficients above degree 0 */
    uint32_t *label;    /* [n] palette index of each splat */
    float *palette;     /* [n_palette][n_rest] */
};

/* Encodes the kept rows of the current frame. order: [rows->n_kept] the rows in the order of the
 * file. block_quant: [spin_splat_rows_blocks(rows)] receives the rounding errors, and must be
 * zero. */
spin_status spin_sog_images_encode(struct spin_sog_images *x, const struct spin_splat_rows *rows,
                                   bool antialias, const struct spin_keyed *order,
                                   struct spin_quant_error *block_quant);
/* Write the encoded images and meta.json, and free the encoded images: as a zip, or as separate
 * files in an existing folder. *bytes: receives the total size of the files. */
spin_status spin_sog_images_write_zip(struct spin_sog_images *x, struct spin_out *out);
spin_status spin_sog_images_write_folder(struct spin_sog_images *x, const char *folder, bool sync,
                                         uint64_t *bytes);
/* Returns an upper bound of the size in bytes of a SOG with n splats. */
uint64_t spin_sog_images_most_bytes(int sh_degree, size_t n);
void spin_sog_images_free(struct spin_sog_images *x);
