/* Code that the two forms of USD export share: a folder of text layers (exporters/usd.c), and a
 * single crate, package or text file (usd_file.c, usd_text_file.c). Both forms have the same
 * attributes, those of ParticleField3DGaussianSplat, and the same cameras. */
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
/* Without a colour space, readers assume linear light. Splats have display colours, with the
 * transfer curve and the primaries of sRGB, for which OpenUSD has only this name. */
#define SPIN_USD_COLOUR_SPACE "srgb_rec709_scene"

struct spin_usd_form {
    /* Type and name of an attribute of floats, and of the same attribute with half floats; NULL:
     * the attribute always has floats. */
    const char *type, *name, *type_half, *name_half;
};
extern const struct spin_usd_form spin_usd_forms[SPIN_USD_COLUMNS];

/* A clip in one file. */
struct spin_usd_file {
    bool packed;         /* true: the output is a package (.usdz) */
    bool text;           /* true: the output is text (.usda) */
    struct spin_out out; /* the crate; a temporary file if a package or text is made from it */
    struct spin_usdc_writer crate;
    /* [n] the words by which the crate refers to the samples of each attribute; the last array is
     * that of the extent. */
    uint64_t *value[SPIN_USD_COLUMNS + 1];
    double *time;                    /* [n] */
    uint64_t hash[SPIN_USD_COLUMNS]; /* hashes of the attributes of the previous frame */
    bool changes[SPIN_USD_COLUMNS];  /* true: the attribute is not the same in all frames */
    size_t n;
    int32_t scope, camera; /* the prim /Cameras, and the prim of the camera that is being written */
};

struct spin_usd_export {
    struct spin_frames frames;
    double codes; /* number of time codes from one frame to the next */
    bool half;
    double meters;                  /* metres per unit of the scene */
    int decimals;                   /* decimal places of positions in text layers with --half */
    enum spin_usd_column attribute; /* the attribute that is being written */

    /* The following members describe the camera of --path. */
    struct spin_camera_path path;
    bool has_path;
    /* [n_pictures] all poses; NULL before the first frame and without --path. */
    struct spin_camera *camera;

    /* The following members are for text layers. */
    unsigned still;     /* bit a is set if attribute a is the same in all frames */
    char (*halves)[10]; /* [65536] half floats as text, indexed by the bits of the half */
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
 * rounding errors to quant, and returns the number of values. *group: receives the number of values
 * of a tuple. Quaternions are w x y z. */
size_t spin_usd_row(const struct spin_usd_export *x, size_t i, float out[SPIN_USD_FLOATS],
                    size_t *group, struct spin_quant_error *quant);
/* Sets extent to the bounding box of the ellipsoids of all kept splats: the minimum, then the
 * maximum. The radii of an ellipsoid are three standard deviations. */
void spin_usd_extent(const struct spin_usd_export *x, float extent[6]);
/* Returns a hash of one attribute of all rows of the frame and of the choice of the kept rows. */
uint64_t spin_usd_hash(const struct spin_usd_export *x, enum spin_usd_column a);

/* ---- Text ------------------------------------------------------------------------------------ */

/* Makes the table `halves`. */
spin_status spin_usd_make_halves(struct spin_usd_export *x);
/* These functions print parts of a layer: its header, with the time codes `first` to `last`; the
 * attributes that never have time samples; the cameras. */
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
    double (*matrix)[4][4]; /* [n] camera (x right, y up, z back) to world; row 3: position */
    size_t n;
    bool zooms, moves; /* whether the focal length changes; whether the matrix changes */
};
typedef void (*spin_usd_camera_fn)(void *context, const struct spin_usd_camera *camera);

/* Computes the poses of --path from the first frame. */
spin_status spin_usd_begin_path(struct spin_usd_export *x);
bool spin_usd_has_cameras(const struct spin_usd_export *x);
/* Visits each camera of the data set that has a view in the exported frames, then the camera of
 * --path. */
spin_status spin_usd_each_camera(const struct spin_usd_export *x, spin_usd_camera_fn visit,
                                 void *context);

/* ---- A clip in one file ---------------------------------------------------------------------- */

/* Implementations of open, add and close of struct spin_frames_format. self: a struct
 * spin_usd_export. */
spin_status spin_usd_file_open(void *self, const struct spin_export_job *job);
spin_status spin_usd_file_add(void *self, const struct spin_frame_info *info,
                              const struct spin_splats *splats);
spin_status spin_usd_file_close(void *self);
/* Writes the clip of an unfinished crate to the output as text. */
spin_status spin_usd_write_text(struct spin_usd_export *x);
void spin_usd_file_free(struct spin_usd_export *x);
