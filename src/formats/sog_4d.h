/* Code shared by TSOG (tsog.h) and .sogst (sogst.h), two extensions of SOG (sog.h) to 4D splats.
 * Additional images contain for each splat, with d = time minus the splat's centre in time,
 *
 *   time     centre and standard deviation (sigma) of the Gaussian window: 16-bit codes within a
 *            range, in two images for low and high bytes; or indices in two codebooks, in one image
 *   motion   coefficient of d in the path, encoded like positions: 16-bit codes in two images, or
 *            8-bit codes in one image
 *   accel    coefficient of d^2 in the path, encoded like motion
 *
 * Images may have any names, and any size with enough pixels; pixels after the last splat are
 * ignored. */
#pragma once

#include "formats/sog.h"
#include "io/json.h"
#include "io/zip.h"

enum spin_sog_4d_picture {
    SPIN_4D_MEANS, /* low bytes; the image of the high bytes is SPIN_4D_..._HIGH */
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
    int degree, sh_degree; /* degree of the paths, 0 to 2; degree of SH, 0 to 3 */
    /* Number of frames, if splats have a frame number instead of a Gaussian window; otherwise 0. */
    int n_frames;
    bool antialias; /* true: splats must be drawn antialiased */
    bool linear;    /* true: motion is stored without spin_sog_log() */
    struct spin_sog_range means, motion, accel, time; /* time: [0] centre in time, [1] sigma */
    struct spin_sog_book scales, sh0, sh_n, centre, sigma;
    size_t n_palette;
    /* Names of the images in the zip; NULL: the image does not exist. */
    const char *name[SPIN_4D_PICTURES];

    /* Set only while reading. */
    struct spin_zip zip;
    spin_json *meta;
    struct spin_sog_book opacity; /* logits of the opacities that bytes 0..255 encode */
    uint8_t *centroids;           /* pixels of the palette; NULL: not yet read */
};

/* ---- Reading --------------------------------------------------------------------------------- */

/* Opens the zip and parses its meta.json. Call spin_sog_4d_close() even after a failure. what: name
 * of the format, with which error messages of all functions begin. They do not contain the path. */
spin_status spin_sog_4d_open(const char *what, const void *file, size_t size,
                             struct spin_sog_4d *out);
void spin_sog_4d_close(struct spin_sog_4d *r);

/* These functions read a value of meta.json. The first requires an integer in [least, most], the
 * second a number that does not overflow a float. name: name of the value in messages. */
spin_status spin_sog_4d_integer(const struct spin_sog_4d *r, const spin_json *j, const char *name,
                                int64_t least, int64_t most, int64_t *out);
spin_status spin_sog_4d_number(const struct spin_sog_4d *r, const spin_json *j, const char *name,
                               double *out);
/* Reads the range of n components, from a list of n minima and a list of n maxima. Fails with
 * SPIN_E_MALFORMED if a minimum is above its maximum. */
spin_status spin_sog_4d_range(const struct spin_sog_4d *r, const spin_json *mins,
                              const spin_json *maxs, const char *name, size_t n,
                              struct spin_sog_range *out);
/* Reads a codebook of `least` to 256 numbers. */
spin_status spin_sog_4d_book(const struct spin_sog_4d *r, const spin_json *j, const char *name,
                             size_t least, struct spin_sog_book *out);
/* Reads the names of images first, first + 1, ... from the list object.files, which must contain
 * `least` to `most` different names. */
spin_status spin_sog_4d_files(struct spin_sog_4d *r, const spin_json *object, const char *name,
                              size_t least, size_t most, enum spin_sog_4d_picture first);
/* Returns whether a zip member with this name stays inside the folder to which it is unpacked: no
 * component of the path may be empty, "." or "..", and the characters \ : ? # and control
 * characters are not allowed. */
bool spin_sog_4d_name_is_plain(const char *name);
/* Reads the keys of meta.json that SOG also has: means, scales, quats, sh0 and shN. Codebooks must
 * have at least `least` numbers. */
spin_status spin_sog_4d_still(struct spin_sog_4d *r, size_t least);

/* Reads the images of n splats into rows first to first + n - 1 of *out. folder: the folder of the
 * images in the zip; NULL: the root. Centres in time and sigmas are decoded with the codebooks
 * r->centre and r->sigma or, if r->centre.n is 0, with the range r->time. If the file has no images
 * of times, all centres in time become 0, and all sigmas SPIN_FOREVER. */
spin_status spin_sog_4d_rows(struct spin_sog_4d *r, const char *folder, size_t first, size_t n,
                             struct spin_splats_4d *out);
