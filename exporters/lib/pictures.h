/* Arrays of bytes that are stored as images in a zip. The caller fills the pixels; these functions
 * encode them in parallel as lossless WebP and write the zip members. */
#pragma once

#include "base/pool.h"
#include "io/zip.h"

struct spin_picture {
    char name[64];     /* name of the zip member */
    uint8_t *rgba;     /* [height][width][4] */
    int width, height; /* in pixels; width 0: the image is not used */
    unsigned char *file;
    size_t n_file;
    spin_status status;
    char why[256];
};

/* Sets *p to a black, opaque image of this size, and reuses the memory of the image that *p
 * contained before. */
spin_status spin_picture_blank(struct spin_picture *p, int width, int height);
/* Encodes n images with a compression effort of 0 to 9. spin_pictures_write() returns the
 * errors. */
void spin_pictures_pack(struct spin_picture *p, int n, int level, struct spin_pool *pool);
spin_status spin_pictures_write(const struct spin_picture *p, int n, struct spin_zip_writer *zip);
/* Frees the encoded files and, if `all` is true, the pixels. */
void spin_pictures_free(struct spin_picture *p, int n, bool all);
