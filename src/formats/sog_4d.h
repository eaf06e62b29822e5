/* The common part of the two kinds of SOG (sog.h) with time, TSOG (tsog.h) and .sogst (sogst.h).
 * They add to the images of SOG, for each splat,
 *
 *   time     its own time and its sigma: 16 bits of a range in two images, or two indices in
 *            codebooks
 *   motion   the coefficient of d in its path, encoded like positions: 16 bits of a range in two
 *            images, or 8 bits in one
 *   accel    the same for d^2
 *
 * Images may have any names, and any size that holds the splats; pixels after the last splat are
 * not read. */
#pragma once

#include "formats/sog.h"
#include "io/json.h"
#include "io/zip.h"

enum spin_sog_4d_picture {
    SPIN_4D_MEANS, /* low bytes; the next one has the high bytes */
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
    size_t n; /* number of values */
    float value[SPIN_CODEBOOK];
};

struct spin_sog_4d {
    const char *what; /* name of the format, for messages */
    size_t n;
    int degree, sh_degree; /* degrees: 0 to 2 of paths, 0 to 3 of SH */
    int n_frames; /* of files that store a frame number instead of time and sigma; 0: other files */
    bool antialias; /* to be drawn antialiased */
    bool linear;    /* motion is stored directly, not as its spin_sog_log() */
    struct spin_sog_range means, motion, accel, time; /* time: own time, sigma */
    struct spin_sog_book scales, sh0, sh_n, centre, sigma;
    size_t n_palette;
    const char *name[SPIN_4D_PICTURES]; /* NULL: the image does not exist */

    /* Of a file that is read. */
    struct spin_zip zip;
    spin_json *meta;
    struct spin_sog_book opacity; /* logits */
    uint8_t *centroids;           /* pixels of the palette, once read */
};

/* ---- Reading --------------------------------------------------------------------------------- */

/* Opens the zip and its meta.json. Close it even after a failure. Errors do not name the file. */
spin_status spin_sog_4d_open(const char *what, const void *file, size_t size,
                             struct spin_sog_4d *out);
void spin_sog_4d_close(struct spin_sog_4d *r);

/* Read a value of meta.json: an integer; a number within the range of float. `name` is used in
 * messages. */
spin_status spin_sog_4d_integer(const struct spin_sog_4d *r, const spin_json *j, const char *name,
                                int64_t least, int64_t most, int64_t *out);
spin_status spin_sog_4d_number(const struct spin_sog_4d *r, const spin_json *j, const char *name,
                               double *out);
/* Reads n minima and n maxima, none of which exceeds its maximum. */
spin_status spin_sog_4d_range(const struct spin_sog_4d *r, const spin_json *mins,
                              const spin_json *maxs, const char *name, size_t n,
                              struct spin_sog_range *out);
/* Reads `least` to 256 numbers. */
spin_status spin_sog_4d_book(const struct spin_sog_4d *r, const spin_json *j, const char *name,
                             size_t least, struct spin_sog_book *out);
/* Reads `least` to `most` names from the list of files of `object`, all different: the images from
 * `first` on. */
spin_status spin_sog_4d_files(struct spin_sog_4d *r, const spin_json *object, const char *name,
                              size_t least, size_t most, enum spin_sog_4d_picture first);
/* True if unpacking a member of this name cannot write outside the target folder: no component is
 * empty, "." or "..", and there is none of \ : ? # and no control character. */
bool spin_sog_4d_name_is_plain(const char *name);
/* Reads means, scales, quats, sh0 and shN, whose codebooks have at least `least` numbers. */
spin_status spin_sog_4d_still(struct spin_sog_4d *r, size_t least);

/* Reads the images of n splats in `folder` of the zip (NULL: the root) into rows `first` and on.
 * Time uses codebooks if there are any, else a range; without images of time, times are 0 and
 * sigmas are SPIN_FOREVER. */
spin_status spin_sog_4d_rows(struct spin_sog_4d *r, const char *folder, size_t first, size_t n,
                             struct spin_splats_4d *out);
