/* meta.json of a bundle: the frames of a clip and the columns that they have. */
#pragma once

#include "io/json.h"
#include "scene/bundle_pack.h"

/* The contents of meta.json, except for "trained" and "refined". */
struct spin_bundle_meta {
    char from[32]; /* importer */
    char upstream[160];
    char variant[128];
    int n_frames;
    struct spin_frame_info *frame; /* [n_frames] */
    int *source_index;             /* [n_frames] position in the whole source clip */
    int n_source_frames;           /* frames of the source clip before a range was selected */
    double fps;                    /* frames per second; 0: the source does not specify it */
    bool numbered;                 /* frame numbers come from the source */
    unsigned columns, static_columns;
    bool identity; /* row i is the same Gaussian in every frame */
    /* If four_d.n is not 0, the source is 4D splats and frames are their slices. four_d has no
     * arrays; `parts` lists the optional ones that the bundle contains. */
    struct spin_splats_4d four_d;
    unsigned parts;
    int sh_degree;       /* -1: none */
    bool antialias;      /* meant to be drawn antialiased */
    char *data_path;     /* relative to the bundle's folder, or absolute; NULL: no data set */
    char *data_absolute; /* the same as an absolute path; NULL in older bundles */
    char data_from[128]; /* the argument of spin_views_open() */
    char pair[8];        /* how frames and images are paired: the argument of spin_views_pair() */
};
spin_status spin_bundle_meta_reserve(struct spin_bundle_meta *meta, int n_frames);
void spin_bundle_meta_free(struct spin_bundle_meta *meta);

/* SPIN_E_MALFORMED if two frames have the same number. */
spin_status spin_frame_numbers_check(const struct spin_frame_info *frame, int n);

/* Fills *meta, which must be zero. SPIN_E_MALFORMED and SPIN_E_UNSUPPORTED name the key. */
spin_status spin_bundle_meta_read(struct spin_bundle_meta *meta, const spin_json *root);
/* Creates the object to be written. It is built in extra, if given, and replaces keys of the same
 * name there; the caller's reference to extra is consumed. */
spin_json *spin_bundle_meta_json(const struct spin_bundle_meta *meta, spin_json *extra);
/* "splats_4d" of meta.json and of reports: 4D splats with these optional arrays. */
spin_json *spin_bundle_4d_json(const struct spin_splats_4d *s, unsigned parts);
/* Adds "xor_rows" and "per_unit" to meta.json, and sets the version of a packed bundle. */
void spin_bundle_meta_packed(spin_json *root, const struct spin_packer *packer);
/* The names of these columns, as listed in meta.json. */
spin_json *spin_column_names(unsigned columns);

/* For readers of other parts of meta.json: the error "'key' is missing or is not <expected>"; an
 * integer within a range; the columns (means at least), SH degree and antialiasing of splats. */
spin_status spin_meta_fail(const char *key, const char *expected);
spin_status spin_meta_integer(const spin_json *object, const char *key, int64_t least, int64_t most,
                              int64_t *out);
spin_status spin_meta_columns(const spin_json *object, unsigned *columns, int *sh_degree,
                              bool *antialias);
