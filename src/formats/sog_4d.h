/* Code shared by TSOG (tsog.h) and .sogst (sogst.h), two extensions of SOG (sog.h) to 4D splats.
 * With d = time minus the splat's centre in time, the additional images contain for each splat
 *
 *   time     centre in time and sigma: 16-bit codes within a range, as two images of low and high
 *            bytes; or indices in two codebooks, in one image
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
    SPIN_4D_MEANS, /* image of the low bytes; SPIN_4D_..._HIGH: image of the high bytes */
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
    /* Number of frames if splats have a frame number instead of a centre in time and a sigma;
     * otherwise 0. */
    int n_frames;
    bool antialias; /* splats must be drawn antialiased */
    bool linear;    /* motion is stored as it is; otherwise it was converted by spin_sog_log() */
    struct spin_sog_range means, motion, accel, time; /* time: [0] centre in time, [1] sigma */
    struct spin_sog_book scales, sh0, sh_n, centre, sigma;
    size_t n_palette;
    /* Names of the images in the zip; NULL: the image does not exist. */
    const char *name[SPIN_4D_PICTURES];

    /* Set only while reading. */
    struct spin_zip zip;
    spin_json *meta;
    struct spin_sog_book opacity; /* the logit that each of the bytes 0..255 stands for */
    uint8_t *centroids;           /* pixels of the palette; NULL: not read yet */
};

/* ---- Reading --------------------------------------------------------------------------------- */

/* Opens the zip and parses its meta.json. Call spin_sog_4d_close() even after a failure. Error
 * messages of this section contain `what`, but not the path. */
spin_status spin_sog_4d_open(const char *what, const void *file, size_t size,
                             struct spin_sog_4d *out);
void spin_sog_4d_close(struct spin_sog_4d *r);

/* Read a value of meta.json. The first function requires an integer in [least, most], the second a
 * number that does not overflow a float. name: name of the value in messages. */
spin_status spin_sog_4d_integer(const struct spin_sog_4d *r, const spin_json *j, const char *name,
                                int64_t least, int64_t most, int64_t *out);
spin_status spin_sog_4d_number(const struct spin_sog_4d *r, const spin_json *j, const char *name,
                               double *out);
/* Reads n minima and n maxima. SPIN_E_MALFORMED if a minimum is above its maximum. */
spin_status spin_sog_4d_range(const struct spin_sog_4d *r, const spin_json *mins,
                              const spin_json *maxs, const char *name, size_t n,
                              struct spin_sog_range *out);
/* Reads a codebook of `least` to 256 numbers. */
spin_status spin_sog_4d_book(const struct spin_sog_4d *r, const spin_json *j, const char *name,
                             size_t least, struct spin_sog_book *out);
/* Reads the names of consecutive images, from image `first` on, from the list object.files, which
 * must contain `least` to `most` different names. */
spin_status spin_sog_4d_files(struct spin_sog_4d *r, const spin_json *object, const char *name,
                              size_t least, size_t most, enum spin_sog_4d_picture first);
/* True if a member with this name can be unpacked safely within a folder: no component of the path
 * is empty, "." or "..", and the name contains no \ : ? # and no control character. */
bool spin_sog_4d_name_is_plain(const char *name);
/* Reads the keys of meta.json that SOG has as well: means, scales, quats, sh0 and shN. Codebooks
 * must have at least `least` numbers. */
spin_status spin_sog_4d_still(struct spin_sog_4d *r, size_t least);

/* Reads the images of n splats into rows [first, first + n). folder: the folder of the images in
 * the zip; NULL: the root. Centres in time and sigmas are decoded with r->centre and r->sigma if
 * these codebooks were read, otherwise with the range r->time. If there are no images of time, the
 * centres become 0 and the sigmas SPIN_FOREVER. */
spin_status spin_sog_4d_rows(struct spin_sog_4d *r, const char *folder, size_t first, size_t n,
                             struct spin_splats_4d *out);
