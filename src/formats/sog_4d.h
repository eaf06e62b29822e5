/* What the two kinds of SOG (sog.h) with time share, TSOG (tsog.h) and .sogst (sogst.h). Beside the
 * pictures of SOG they have, of each splat,
 *
 *   time     its own time and its sigma: 16 bits of a range in two pictures, or two bytes that are places in books
 *   motion   what its path has for d, as places have it: 16 bits of a range in two pictures, or 8 in one
 *   accel    the same for d^2
 *
 * Pictures have any names, and any sides that hold the splats; what is behind the last splat is not
 * read. */
#pragma once

#include "formats/sog.h"
#include "io/json.h"
#include "io/zip.h"

enum spin_sog_4d_picture {
    SPIN_4D_MEANS, /* low bytes; the next: high bytes */
    SPIN_4D_MEANS_HIGH,
    SPIN_4D_SCALES,
    SPIN_4D_QUATS,
    SPIN_4D_SH0,
    SPIN_4D_TIME,
    SPIN_4D_TIME_HIGH,
    SPIN_4D_MOTION,
    SPIN_4D_MOTION_HIGH,
    SPIN_4D_ACCEL,
    SPIN_4D_ACCEL_HIGH,
    SPIN_4D_CENTROIDS,
    SPIN_4D_LABELS,
    SPIN_4D_PICTURES
};

struct spin_sog_book {
    size_t n; /* values it has */
    float value[SPIN_CODEBOOK];
};

struct spin_sog_4d {
    const char *what; /* the format, for messages */
    size_t n;
    int degree, sh_degree; /* of paths 0 to 2, of SH 0 to 3 */
    int n_frames;   /* written with the number of their frame instead of a time and a sigma; 0 */
    bool antialias; /* meant to be drawn antialiased */
    bool linear;    /* motion is not spin_sog_log() of itself */
    struct spin_sog_range means, motion, accel, time; /* time: its own, sigma */
    struct spin_sog_book scales, sh0, sh_n, centre, sigma;
    size_t n_palette;
    const char *name[SPIN_4D_PICTURES]; /* NULL: there is none */

    /* Of a file that is read. */
    struct spin_zip zip;
    spin_json *meta;
    struct spin_sog_book opacity; /* logits */
    uint8_t *centroids;           /* pixels, once they are needed */
};

/* ---- Reading --------------------------------------------------------------------------------- */

/* The zip and its meta.json. Close it also after a failure. Errors do not name the file. */
spin_status spin_sog_4d_open(const char *what, const void *file, size_t size,
                             struct spin_sog_4d *out);
void spin_sog_4d_close(struct spin_sog_4d *r);

/* Values of meta.json; `name` is that of messages. A whole number, a number that a float holds. */
spin_status spin_sog_4d_integer(const struct spin_sog_4d *r, const spin_json *j, const char *name,
                                int64_t least, int64_t most, int64_t *out);
spin_status spin_sog_4d_number(const struct spin_sog_4d *r, const spin_json *j, const char *name,
                               double *out);
/* n numbers each, none above its partner. */
spin_status spin_sog_4d_range(const struct spin_sog_4d *r, const spin_json *mins,
                              const spin_json *maxs, const char *name, size_t n,
                              struct spin_sog_range *out);
/* From `least` to 256 numbers. */
spin_status spin_sog_4d_book(const struct spin_sog_4d *r, const spin_json *j, const char *name,
                             size_t least, struct spin_sog_book *out);
/* From `least` to `most` members of `object`'s list of files, different ones, are the pictures from
 * `first` on. */
spin_status spin_sog_4d_files(struct spin_sog_4d *r, const spin_json *object, const char *name,
                              size_t least, size_t most, enum spin_sog_4d_picture first);
/* A name that no way of unpacking takes elsewhere: no part is empty, "." or "..", and none of \ : ?
 * # or a control character is in it. */
bool spin_sog_4d_name_is_plain(const char *name);
/* means, scales, quats, sh0, shN, whose books have from `least` numbers. */
spin_status spin_sog_4d_still(struct spin_sog_4d *r, size_t least);

/* The pictures of n splats in `folder` of the zip (NULL: as they are named) into rows `first` and
 * on. Time by a range where there are no books; without pictures of time, times are 0 and sigmas
 * are SPIN_FOREVER. */
spin_status spin_sog_4d_rows(struct spin_sog_4d *r, const char *folder, size_t first, size_t n,
                             struct spin_splats_4d *out);
