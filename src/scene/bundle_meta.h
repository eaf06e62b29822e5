/* meta.json of a bundle: describes the frames of the clip, their columns and the data set. */
#pragma once

#include "io/json.h"
#include "scene/bundle_pack.h"

/* The contents of meta.json, except for "trained" and "refined". */
struct spin_bundle_meta {
    char from[32];      /* name of the importer */
    char upstream[160]; /* project and commit whose files the importer was written for */
    char variant[128];  /* variant of the source's format */
    int n_frames;
    struct spin_frame_info *frame; /* [n_frames] */
    int *source_index;             /* [n_frames] position of the frame in the whole source clip */
    int n_source_frames;           /* frames of the source clip before a range was selected */
    double fps;                    /* frames per second; 0: the source does not specify it */
    bool numbered;                 /* frame numbers come from the source */
    unsigned columns, static_columns;
    bool identity; /* row i is the same Gaussian in every frame */
    /* four_d.n > 0: the source consists of 4D splats, and frames are slices of them. The arrays of
     * four_d are NULL here; `parts` is the set of optional arrays in the bundle. */
    struct spin_splats_4d four_d;
    unsigned parts;
    int sh_degree;       /* -1: no column sh */
    bool antialias;      /* splats must be drawn antialiased */
    char *data_path;     /* data set, relative to the bundle's folder or absolute; NULL: none */
    char *data_absolute; /* absolute path of the data set; NULL in older bundles */
    char data_from[128]; /* importer of the data set: argument `from` of spin_views_open() */
    char pair[8];        /* how frames and images are paired: argument of spin_views_pair() */
};
spin_status spin_bundle_meta_reserve(struct spin_bundle_meta *meta, int n_frames);
void spin_bundle_meta_free(struct spin_bundle_meta *meta);

/* SPIN_E_MALFORMED if two frames have the same number. */
spin_status spin_frame_numbers_check(const struct spin_frame_info *frame, int n);

/* Fills *meta, which must be zero. Messages of SPIN_E_MALFORMED and SPIN_E_UNSUPPORTED contain the
 * key. */
spin_status spin_bundle_meta_read(struct spin_bundle_meta *meta, const spin_json *root);
/* Creates the JSON of meta.json. If extra is not NULL, the keys are added to extra, where they
 * replace keys of the same name, and extra is returned. */
spin_json *spin_bundle_meta_json(const struct spin_bundle_meta *meta, spin_json *extra);
/* Creates "splats_4d" of meta.json and of reports. parts: set of optional arrays. */
spin_json *spin_bundle_4d_json(const struct spin_splats_4d *s, unsigned parts);
/* Adds "xor_rows" and "per_unit" to meta.json, and sets the version of a packed bundle. */
void spin_bundle_meta_packed(spin_json *root, const struct spin_packer *packer);
/* A JSON list of the names of these columns. */
spin_json *spin_column_names(unsigned columns);

/* Helpers to read other parts of meta.json. spin_meta_fail() sets the error "'key' is missing or is
 * not <expected>" and returns SPIN_E_MALFORMED. */
spin_status spin_meta_fail(const char *key, const char *expected);
/* Reads an integer in [least, most]. */
spin_status spin_meta_integer(const spin_json *object, const char *key, int64_t least, int64_t most,
                              int64_t *out);
/* Reads "columns", which must contain means, "sh_degree" and "antialias". */
spin_status spin_meta_columns(const spin_json *object, unsigned *columns, int *sh_degree,
                              bool *antialias);
