/* Composes the prims of a USD stage from its layers, and evaluates attributes of prims at a given
 * time. */
#pragma once

#include "formats/usd_layer.h"
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
    size_t *counts; /* [n_frames] number of splats */
    int sh_degree;  /* largest SH degree of all prims, at most 3 */
    /* Set of the columns (enum spin_column) whose values are the same in all frames. */
    unsigned still;
    double codes_per_second; /* timeCodesPerSecond; 0: missing */
    double meters;           /* metersPerUnit; 0: missing */
    bool z_up;               /* true: upAxis is Z; false: Y */
    /* True: splats must be drawn antialiased. spin-export writes this to customLayerData. */
    bool antialias;

    /* The following members are reported to the user. */
    bool linear;   /* true: colours are in linear light */
    bool variants; /* true: variants were skipped */
    bool cut;      /* true: SH above degree 3 were skipped */
    /* True: some prims of splats lack an attribute, so the default of the schema is used. */
    bool no_orientations;
    bool no_opacities, no_sh;
    char missing[128]; /* asset path of a reference whose file does not exist; "": none */
    char other[64];    /* unsupported type of particle field that was found; "": none */

    /* The following members are private. */
    struct spin_arena arena;
    struct spin_zip package; /* the zip, if the stage is a .usdz; see packed */
    bool packed;
    struct usd_file *file; /* all open layers */
    unsigned n_opened;     /* number of layers opened so far */
    struct usd_node *splats;
    bool moves; /* true: a transform has samples */
    size_t n_nodes;
    struct spin_splats raw;
};

/* A layer that is open. */
struct usd_file {
    const char *path; /* in the file system or, if the stage is packed, in the package */
    unsigned number;  /* unique among all layers that the stage has opened */
    struct spin_map map;
    struct spin_usd_layer layer;
    struct usd_file *next;
};

/* An opinion (USD's term): what one layer specifies about a prim of the stage. */
struct usd_opinion {
    struct usd_file *file;
    struct spin_usd_prim *prim;
};

/* Value clips: each file contains the samples of a prim for an interval of time. */
struct usd_clips {
    const char *folder_of; /* path of the layer that defines the clips; `asset` is relative to it */
    char **asset;
    size_t n_assets;
    /* active [n_active][2]: a time code of the stage, and the index in `asset` of the file that is
     * used from this time on. times [n_times][2]: a time code of the stage, and the corresponding
     * time code of the clips. */
    double *active, *times;
    size_t n_active, n_times;
    struct usd_file *open; /* NULL: none */
    size_t at;             /* index in `active` of the open file */
};

/* Cache of an attribute of a prim: the values that were read last. */
struct usd_column {
    float *value;
    size_t n;
    const struct spin_usd_value *from;
    unsigned number; /* number of the layer that contains `from` */
};

/* A prim of the stage. */
struct usd_node {
    struct usd_node *parent;
    const char *path;
    struct usd_opinion *opinion; /* [n] the strongest first */
    size_t n, n_local;       /* the first n_local opinions are those of the stage's own layers */
    struct usd_clips *clips; /* clips of the prim itself or of an ancestor; NULL: none */
    const char *clip_path;   /* path of this prim in the files of the clips */
    struct usd_node *next;   /* the next prim that contains splats */
    struct usd_column column[SPIN_USD_COLUMNS];
};

/* Opens the root layer: the file at `path` or, if it is a package, its first member. */
spin_status spin_usd_open_root(struct spin_usd_stage *s, const char *path, struct usd_file **out);
void spin_usd_close_files(struct spin_usd_stage *s);
/* Visits all prims, sets s->splats to the list of prims that contain splats, and sets the members
 * of *s that report what was skipped. */
spin_status spin_usd_compose(struct spin_usd_stage *s, struct usd_file *root);
/* Returns the text of an entry of a layer's metadata; NULL if there is none. The caller frees it.
 */
char *spin_usd_metadata_text(const struct usd_file *file, const char *name);

/* Opens the clip that entry i of `active` activates, unless it is already open. */
spin_status spin_usd_open_clip(struct spin_usd_stage *s, struct usd_clips *c, size_t i);
/* Sets *out to the value of an attribute at a time, or to NULL if the attribute has no value or its
 * value is blocked (None). */
spin_status spin_usd_find_value(struct spin_usd_stage *s, const struct usd_node *node,
                                const char *name, double time, struct spin_usd_value **out);
