/* For the fuzz targets of TSOG and .sogst: puts a fuzzed meta.json into a zip with the images of 16
 * splats with SH of degree 1, so that readers find images. The images are in the root and in folder
 * "a". */
#ifndef SPIN_TESTS_FUZZ_SOG_4D_H
#define SPIN_TESTS_FUZZ_SOG_4D_H

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <zlib.h>

#include "formats/sog_4d.h"
#include "io/webp.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

enum { FUZZ_ROOM = 1 << 18, FUZZ_PICTURES = 13 };

/* ml mu ... are means, q quats, c colours, tl tu times, vl vu motion, al au acceleration, p a
 * palette, l labels. */
static const char *const fuzz_picture[FUZZ_PICTURES] = {"ml", "mu", "s",  "q",  "c", "tl", "tu",
                                                        "vl", "vu", "al", "au", "p", "l"};

struct fuzz_zip {
    unsigned char data[FUZZ_ROOM], directory[FUZZ_ROOM / 8];
    size_t n, n_directory;
    unsigned count;
};

static inline void put_numbers(unsigned char *to, const uint32_t *value, const int *width, int n)
{
    for (int i = 0; i < n; i++)
        for (int b = 0; b < width[i]; b++)
            *to++ = (unsigned char)(value[i] >> 8 * b);
}

/* A stored member. */
static inline void add_member(struct fuzz_zip *zip, const char *name, const void *data, size_t n)
{
    static const int local[] = {4, 2, 2, 2, 2, 2, 4, 4, 4, 2, 2};
    static const int central[] = {4, 2, 2, 2, 2, 2, 2, 4, 4, 4, 2, 2, 2, 2, 2, 4, 4};
    uint32_t crc = (uint32_t)crc32(0, data, (uInt)n), length = (uint32_t)strlen(name);
    const uint32_t head[] = {0x04034b50, 20, 0, 0, 0, 0, crc, (uint32_t)n, (uint32_t)n, length, 0};
    const uint32_t entry[] = {0x02014b50,      20,          20,     0, 0, 0, 0, crc,
                              (uint32_t)n,     (uint32_t)n, length, 0, 0, 0, 0, 0,
                              (uint32_t)zip->n};

    put_numbers(zip->data + zip->n, head, local, 11);
    memcpy(zip->data + zip->n + 30, name, length);
    memcpy(zip->data + zip->n + 30 + length, data, n);
    zip->n += 30 + length + n;
    put_numbers(zip->directory + zip->n_directory, entry, central, 17);
    memcpy(zip->directory + zip->n_directory + 46, name, length);
    zip->n_directory += 46 + length;
    zip->count++;
}

static inline void add_pictures(struct fuzz_zip *zip, const char *folder)
{
    for (int p = 0; p < FUZZ_PICTURES; p++) {
        uint8_t pixels[4 * 4 * 192];
        unsigned char *packed = NULL;
        char name[16];
        size_t n = 0;
        bool palette = strcmp(fuzz_picture[p], "p") == 0,
             labels = strcmp(fuzz_picture[p], "l") == 0;

        for (size_t i = 0; i < sizeof pixels; i++)
            pixels[i] = (uint8_t)(i % 4 == 3             ? 252 + i / 4 % 4
                                  : i % 4 == 1 && labels ? 0
                                                         : 7 * i * i + 3 * i);
        if (spin_webp_write(pixels, palette ? 192 : 4, 4, 0, &packed, &n) != SPIN_OK)
            abort();
        snprintf(name, sizeof name, "%s%s", folder, fuzz_picture[p]);
        add_member(zip, name, packed, n);
        free(packed);
    }
}

/* The zip with this meta.json. */
static inline const struct fuzz_zip *zip_around(const uint8_t *meta, size_t n)
{
    static const int widths[] = {4, 2, 2, 2, 2, 4, 4, 2};
    static struct fuzz_zip pictures, zip;

    if (pictures.n == 0) {
        add_pictures(&pictures, "");
        add_pictures(&pictures, "a/");
    }
    zip = pictures;
    add_member(&zip, "meta.json", meta, n);
    put_numbers(zip.directory + zip.n_directory,
                (const uint32_t[]){0x06054b50, 0, 0, zip.count, zip.count,
                                   (uint32_t)zip.n_directory, (uint32_t)zip.n, 0},
                widths, 8);
    memcpy(zip.data + zip.n, zip.directory, zip.n_directory + 22);
    zip.n += zip.n_directory + 22;
    return &zip;
}

/* What was read settles, and is numbers at the ends of its clip and between. */
static inline void look_at_splats(struct spin_splats_4d *splats, double first, double last)
{
    struct spin_splats s = {0};
    size_t n_dropped;

    if (spin_splats_4d_finish(splats, &n_dropped, NULL) == SPIN_OK)
        for (int i = 0; i < 3; i++) {
            if (spin_splats_4d_slice(splats, first + (last - first) * i / 2,
                                     SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, &s) != SPIN_OK)
                continue;
            for (size_t k = 0; k < 3 * s.n; k++)
                if (!isfinite(s.means[k]) || !isfinite(s.log_scales[k]) || !isfinite(s.sh[k]))
                    abort();
            for (size_t k = 0; k < 4 * s.n; k++)
                if (!(fabsf(s.quats[k]) <= 1.0001f))
                    abort();
        }
    spin_splats_free(&s);
}

#endif
