/* Pictures of numbers that become members of a zip: filled, packed side by side as lossless WebP,
 * written. */
#pragma once

#include "base/pool.h"
#include "io/zip.h"

struct spin_picture {
    char name[64];     /* of the member */
    uint8_t *rgba;     /* [height][width][4] */
    int width, height; /* width 0: there is none */
    unsigned char *file;
    size_t n_file;
    spin_status status;
    char why[256];
};

/* Black and opaque, of this size; keeps its room. */
spin_status spin_picture_blank(struct spin_picture *p, int width, int height);
/* Makes the files of n pictures, with WebP's effort 0 to 9; failures are those of writing. */
void spin_pictures_pack(struct spin_picture *p, int n, int level, struct spin_pool *pool);
spin_status spin_pictures_write(const struct spin_picture *p, int n, struct spin_zip_writer *zip);
/* Frees the files, and with `all` the pictures too. */
void spin_pictures_free(struct spin_picture *p, int n, bool all);
