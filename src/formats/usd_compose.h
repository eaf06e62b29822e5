/* Composes the prims of a USD stage from its layers, and evaluates their attributes at a time. */
#pragma once

#include "formats/usd.h"
#include "io/zip.h"
#include "spin.h"

#define SPIN_USD_TYPE "ParticleField3DGaussianSplat"

enum spin_usd_column {
    SPIN_USD_POSITIONS,
    SPIN_USD_ORIENTATIONS,
    SPIN_USD_SCALES,
    SPIN_USD_OPACITIES,
    SPIN_USD_SH,
    SPIN_USD_COLUMNS
};

struct spin_usd_stage {
    size_t n_frames;
    double *times;  /* [n_frames] time codes, increasing */
    size_t *counts; /* [n_frames] splats */
    int sh_degree;  /* largest degree of any splats in the stage, at most 3 */
    /* Set of the columns (enum spin_column) whose values are the same in all frames. */
    unsigned still;
    double codes_per_second; /* timeCodesPerSecond; 0: not stated */
    double meters;           /* metersPerUnit; 0: not stated */
    bool z_up;               /* upAxis is Z, not Y */
    bool
        antialias; /* customLayerData of spin-export states that splats must be drawn antialiased */
    /* Facts about the stage that are reported to the user. */
    bool linear;          /* colours are in linear light */
    bool variants;        /* variants were skipped */
    bool cut;             /* SH of degree 4 and more were cut to degree 3 */
    bool no_orientations; /* some splats have no array of this attribute, so the default of the
                             schema is used */
    bool no_opacities, no_sh;
    char missing[128]; /* asset path of a reference whose file does not exist; "": none */
    char other[64];    /* type of particle fields that was found but is not supported; "": none */

    /* private */
    struct spin_arena arena;
    struct spin_zip package; /* archive of a .usdz */
    bool packed;
    struct usd_file *file; /* all open layers */
    unsigned n_opened;     /* number of layers opened so far */
    struct usd_node *splats;
    bool moves; /* transforms have samples */
    size_t n_nodes;
    struct spin_splats raw;
};

/* A layer that is open. */
struct usd_file {
    const char *path; /* in the file system or, if the stage is packed, in the package */
    unsigned number;  /* a number that no other layer of the stage has or had */
    struct spin_map map;
    struct spin_usd_layer layer;
    struct usd_file *next;
};

/* The opinion of one layer about a prim of the stage. */
struct usd_opinion {
    struct usd_file *file;
    struct spin_usd_prim *prim;
};

/* Value clips: each file contains the samples of a prim for an interval of time. */
struct usd_clips {
    const char *folder_of; /* path of the layer that names the files */
    char **asset;
    size_t n_assets;
    double *active, *times; /* [n][2] pairs: time code of the stage, and index of an asset or time
                               code of the clip */
    size_t n_active, n_times;
    struct usd_file *open; /* NULL: none */
    size_t at;             /* index in `active` of the open file */
};

/* The values of an attribute that were read last. */
struct usd_column {
    float *value;
    size_t n;
    const struct spin_usd_value *from;
    unsigned number; /* id of the layer of `from` */
};

/* A prim of the stage. */
struct usd_node {
    struct usd_node *parent;
    const char *path;
    struct usd_opinion *opinion; /* [n] opinions, the strongest first */
    size_t n, n_local;       /* the first n_local opinions are those of the stage's own layers */
    struct usd_clips *clips; /* clips of the prim itself or of an ancestor; NULL: none */
    const char *clip_path;   /* path of this prim in the files of the clips */
    struct usd_node *next;   /* the next prim that contains splats */
    struct usd_column column[SPIN_USD_COLUMNS];
};

/* Opens the root layer at `path`, or the first member of that package. */
spin_status spin_usd_open_root(struct spin_usd_stage *s, const char *path, struct usd_file **out);
void spin_usd_close_files(struct spin_usd_stage *s);
/* Visits all prims, sets s->splats to the list of those that contain splats, and notes what is
 * skipped. */
spin_status spin_usd_compose(struct spin_usd_stage *s, struct usd_file *root);
/* Returns the text of an entry of a layer's metadata; NULL if there is none. The caller frees it.
 */
char *spin_usd_metadata_text(const struct usd_file *file, const char *name);

/* Opens the clip that entry i of `active` activates, unless it is already open. */
spin_status spin_usd_open_clip(struct spin_usd_stage *s, struct usd_clips *c, size_t i);
/* Sets *out to the value of an attribute at a time; to NULL if there is none, or if a sample blocks
 * it. */
spin_status spin_usd_find_value(struct spin_usd_stage *s, const struct usd_node *node,
                                const char *name, double time, struct spin_usd_value **out);
