/* Common code of both forms in which USD is exported: a folder of text layers (exporters/usd.c),
 * and one crate, package or text file (usd_file.c, usd_text_file.c). Both write the same
 * attributes, in the schema ParticleField3DGaussianSplat, and the same cameras. */
#pragma once

#include "exporters/lib/camera_path.h"
#include "exporters/lib/frames.h"
#include "formats/usd_compose.h"
#include "formats/usd_crate_write.h"

#define SPIN_USD_PRIM "Splats"
#define SPIN_USD_APERTURE 36.0 /* horizontal aperture of every camera */
#define SPIN_USD_FLOATS 48     /* largest number of floats of one row in an attribute */
#define SPIN_USD_NUMBER 16     /* characters of the longest number in text, with separators */
#define SPIN_USD_STILL "still.usda"
#define SPIN_USD_TEXT_SCHEMAS "    prepend apiSchemas = [\"ColorSpaceAPI\"]\n"
/* If no colour space is given, readers assume that colours are linear light. This is the only name
 * in OpenUSD for colours as they are displayed, with the transfer curve and the primaries of sRGB.
 */
#define SPIN_USD_COLOUR_SPACE "srgb_rec709_scene"

struct spin_usd_form {
    /* type_half, name_half: type and name of the attribute if it consists of half floats; NULL: it
     * always consists of floats. */
    const char *type, *name, *type_half, *name_half;
};
extern const struct spin_usd_form spin_usd_forms[SPIN_USD_COLUMNS];

/* A clip in one file. */
struct spin_usd_file {
    bool packed;         /* the file is a package (.usdz) */
    bool text;           /* the file is text (.usda) */
    struct spin_out out; /* the crate; a temporary file if a package or text is made from it */
    struct spin_usdc_writer crate;
    /* [n] the samples of each attribute and of the extent. */
    uint64_t *value[SPIN_USD_COLUMNS + 1];
    double *time;                    /* [n] */
    uint64_t hash[SPIN_USD_COLUMNS]; /* hashes of the attributes of the previous frame */
    bool changes[SPIN_USD_COLUMNS];  /* the attribute differs between two successive frames */
    size_t n;
    int32_t scope, camera; /* the prim /Cameras, and the prim of the camera that is being written */
};

struct spin_usd_export {
    struct spin_frames frames;
    double codes; /* number of time codes from one frame to the next */
    bool half;
    double meters; /* metres per unit of the scene */
    int decimals;  /* decimal places of positions in text with --half, which the first frame
                      determines */
    enum spin_usd_column attribute; /* the attribute that is being written */

    /* The following members describe the camera of --path. */
    struct spin_camera_path path;
    bool has_path;
    /* [n_pictures] all poses; NULL before the first frame and without --path. */
    struct spin_camera *camera;

    /* The following members are for text layers. */
    unsigned still;     /* bit mask: if bit a is 1, attribute a has the same values in all frames */
    char (*halves)[10]; /* [65536] the decimal text of each half float, indexed by the bits of the
                           half */
    /* The current batch of blocks. */
    size_t first;     /* index of the batch's first block */
    char *text;       /* text of each block of the batch, `stride` bytes each */
    size_t n_text[8]; /* length of each block's text */
    size_t stride;    /* capacity for one block */

    struct spin_usd_file file;
};

/* ---- Values ---------------------------------------------------------------------------------- */

/* Returns whether the current attribute consists of half floats. */
bool spin_usd_is_half(const struct spin_usd_export *x);
const char *spin_usd_type_of(const struct spin_usd_export *x, enum spin_usd_column a);
const char *spin_usd_name_of(const struct spin_usd_export *x, enum spin_usd_column a);
uint32_t spin_usd_half_bits(float h);

/* Sets `out` to the values of the current attribute of row i as readers decode them, adds their
 * rounding errors to quant, and returns the number of values. Sets *group to the number of values
 * in a tuple. Quaternions are w x y z. */
size_t spin_usd_row(const struct spin_usd_export *x, size_t i, float out[SPIN_USD_FLOATS],
                    size_t *group, struct spin_quant_error *quant);
/* Sets extent to the bounding box of the ellipsoids of all kept splats: the minimum, then the
 * maximum. The radii of an ellipsoid are three standard deviations. */
void spin_usd_extent(const struct spin_usd_export *x, float extent[6]);
/* Returns a hash of one attribute of all rows of the frame and of the choice of rows to keep. */
uint64_t spin_usd_hash(const struct spin_usd_export *x, enum spin_usd_column a);

/* ---- Text ------------------------------------------------------------------------------------ */

/* Makes the table `halves`. */
spin_status spin_usd_make_halves(struct spin_usd_export *x);
/* Print the header of a layer with the time codes from first to last, the attributes of the splats
 * that never have time samples, and the cameras. */
void spin_usd_print_head(const struct spin_usd_export *x, int first, int last, FILE *to);
void spin_usd_print_uniforms(const struct spin_usd_export *x, FILE *to);
spin_status spin_usd_print_cameras(const struct spin_usd_export *x, FILE *to);

/* ---- Cameras --------------------------------------------------------------------------------- */

struct spin_usd_camera {
    const char *name;
    double clip_near, high; /* near plane; vertical aperture */
    double offset[2];       /* horizontal and vertical offset of the aperture */
    const double *time;     /* [n] time codes */
    double *focal;          /* [n] */
    double (*matrix)[4][4]; /* [n] camera to world, with x right, y up, z back; row 3 is the
                               position */
    size_t n;
    bool zooms, moves; /* the focal length or the matrix changes */
};
typedef void (*spin_usd_camera_fn)(void *context, const struct spin_usd_camera *camera);

/* Computes the poses of --path from the first frame. */
spin_status spin_usd_begin_path(struct spin_usd_export *x);
bool spin_usd_has_cameras(const struct spin_usd_export *x);
/* Visits each camera of the data set that has a view in the exported frames, then that of
 * --path. */
spin_status spin_usd_each_camera(const struct spin_usd_export *x, spin_usd_camera_fn visit,
                                 void *context);

/* ---- A clip in one file ---------------------------------------------------------------------- */

/* The functions open, add and close of struct spin_frames_format; `self` is a struct
 * spin_usd_export. */
spin_status spin_usd_file_open(void *self, const struct spin_export_job *job);
spin_status spin_usd_file_add(void *self, const struct spin_frame_info *info,
                              const struct spin_splats *splats);
spin_status spin_usd_file_close(void *self);
/* Writes the clip of an unfinished crate to the output as text. */
spin_status spin_usd_write_text(struct spin_usd_export *x);
void spin_usd_file_free(struct spin_usd_export *x);
