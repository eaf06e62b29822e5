/* meta.json of a bundle: what the frames of a clip are and which columns they have. */
#pragma once

#include "io/json.h"
#include "scene/bundle_pack.h"

/* What meta.json says, less the network's own part. */
struct spin_bundle_meta {
    char from[32]; /* importer */
    char upstream[160];
    char variant[128];
    int n_frames;
    struct spin_frame_info *frame; /* [n_frames] */
    int *source_index;             /* [n_frames] place in the whole source clip */
    int n_source_frames;           /* frames of the source clip before any range */
    double fps;                    /* frames a second, where the source says; 0 */
    bool numbered;                 /* frame numbers are the source's own */
    unsigned columns, static_columns;
    bool identity; /* row i is the same Gaussian in every frame */
    /* The source is 4D splats, of which frames are slices, when n is not 0: without the arrays,
     * whose optional ones are named in parts. */
    struct spin_splats_4d four_d;
    unsigned parts;
    int sh_degree;       /* -1: none */
    bool antialias;      /* meant to be drawn antialiased */
    char *data_path;     /* as stored: relative to the bundle's folder, or absolute; NULL */
    char *data_absolute; /* the same, absolute; NULL: of an older bundle */
    char data_from[128]; /* as spin_views_open() takes it */
    char pair[8];        /* of frames and a data set, as spin_views_pair() takes it */
};
spin_status spin_bundle_meta_reserve(struct spin_bundle_meta *meta, int n_frames);
void spin_bundle_meta_free(struct spin_bundle_meta *meta);

/* No two frames of a clip have one number. */
spin_status spin_frame_numbers_check(const struct spin_frame_info *frame, int n);

/* Fills *meta, which is zero before. SPIN_E_MALFORMED and SPIN_E_UNSUPPORTED name the key. */
spin_status spin_bundle_meta_read(struct spin_bundle_meta *meta, const spin_json *root);
/* The object to be written: our keys go into extra, if any, so a caller's key of the same name does
 * not survive. extra is taken. */
spin_json *spin_bundle_meta_json(const struct spin_bundle_meta *meta, spin_json *extra);
/* 4D splats with these parts as meta.json and reports tell of them. */
spin_json *spin_bundle_4d_json(const struct spin_splats_4d *s, unsigned parts);
/* What makes it that of a packed bundle. */
void spin_bundle_meta_packed(spin_json *root, const struct spin_packer *packer);
/* The names of these columns, as meta.json lists them. */
spin_json *spin_column_names(unsigned columns);

/* For other parts of meta.json: "'key' is missing or is not <expected>"; a whole number in a range;
 * the columns that splats have, means at least, the degree of their colours, how to draw them. */
spin_status spin_meta_fail(const char *key, const char *expected);
spin_status spin_meta_integer(const spin_json *object, const char *key, int64_t least, int64_t most,
                              int64_t *out);
spin_status spin_meta_columns(const spin_json *object, unsigned *columns, int *sh_degree,
                              bool *antialias);
