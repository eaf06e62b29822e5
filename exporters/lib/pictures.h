/* Arrays of bytes stored as images in a zip: filled by the caller, encoded in parallel as lossless
 * WebP, and written. */
#pragma once

#include "base/pool.h"
#include "io/zip.h"

struct spin_picture {
    char name[64];     /* of the zip member */
    uint8_t *rgba;     /* [height][width][4] */
    int width, height; /* width 0: not used */
    unsigned char *file;
    size_t n_file;
    spin_status status;
    char why[256];
};

/* Makes *p black and opaque with this size; reuses its memory. */
spin_status spin_picture_blank(struct spin_picture *p, int width, int height);
/* Encodes n images with effort 0 to 9; spin_pictures_write() returns their errors. */
void spin_pictures_pack(struct spin_picture *p, int n, int level, struct spin_pool *pool);
spin_status spin_pictures_write(const struct spin_picture *p, int n, struct spin_zip_writer *zip);
/* Frees the encoded files, and with `all` the pixels too. */
void spin_pictures_free(struct spin_picture *p, int n, bool all);
