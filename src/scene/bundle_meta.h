/* Reads and writes meta.json of a bundle, which describes the frames of the clip, their columns and
 * the data set. */
#pragma once

#include "io/json.h"
#include "scene/bundle_pack.h"

/* The contents of meta.json, except for "trained" and "refined". */
struct spin_bundle_meta {
    char from[32];      /* name of the importer */
    char upstream[160]; /* project and commit that the importer was written for */
    char variant[128];  /* variant of the source's format */
    int n_frames;
    struct spin_frame_info *frame; /* [n_frames] */
    int *source_index;             /* [n_frames] position of the frame in the whole source clip */
    /* number of frames of the source clip, before --range selected some of them */
    int n_source_frames;
    double shift[3]; /* coordinates to add to all positions; see struct spin_sequence_info */
    double up[3];    /* unit vector that points up; 0 0 0: unknown */
    double fps;      /* frames per second; 0: the source does not specify it */
    /* true: frame numbers come from the source; false: the importer counted the frames */
    bool numbered;
    unsigned columns, static_columns;
    bool identity; /* true: row i is the same splat in every frame */
    /* If four_d.n is above 0, the source consists of 4D splats, and its frames are slices of the 4D
     * splats. The arrays of four_d are NULL here; `parts` is the set of optional arrays in the
     * bundle. */
    struct spin_splats_4d four_d;
    unsigned parts;
    int sh_degree;  /* degree of column sh; -1: there is no such column */
    bool antialias; /* true: splats were trained with antialiasing and must be drawn with it */
    /* path of the data set, relative to the bundle's folder or absolute; NULL: no data set */
    char *data_path;
    char *data_absolute; /* absolute path of the data set; NULL in older bundles */
    char data_from[128]; /* importer of the data set, as in argument `from` of spin_views_open() */
    /* how frames are paired with images, as in argument `pair` of spin_views_pair() */
    char pair[8];
    /* The sound track. sound.start is relative to the first frame of the whole source clip.
     * spin_bundle_meta_free() does not free sound.data. */
    struct spin_sound sound;
    struct spin_views cameras; /* see scene/kept_cameras.h; empty if there are none */
};
spin_status spin_bundle_meta_reserve(struct spin_bundle_meta *meta, int n_frames);
void spin_bundle_meta_free(struct spin_bundle_meta *meta);

/* Fails with SPIN_E_MALFORMED if two frames have the same number. */
spin_status spin_frame_numbers_check(const struct spin_frame_info *frame, int n);

/* Fills *meta, which the caller has zeroed, from the JSON of meta.json. The messages of
 * SPIN_E_MALFORMED and SPIN_E_UNSUPPORTED name the key that is wrong. */
spin_status spin_bundle_meta_read(struct spin_bundle_meta *meta, const spin_json *root);
/* Creates the JSON of meta.json. If `extra` is not NULL, the keys of `meta` are added to this
 * object, replacing keys of the same name, and the object itself is returned. */
spin_json *spin_bundle_meta_json(const struct spin_bundle_meta *meta, spin_json *extra);
/* Creates the value of "splats_4d" for meta.json or for a report. `parts` is the set of optional
 * arrays that "arrays" lists. */
spin_json *spin_bundle_4d_json(const struct spin_splats_4d *s, unsigned parts);
/* Adds the keys "xor_rows" and "per_unit" of a packed bundle to the JSON of meta.json, and sets the
 * version for packed bundles. */
void spin_bundle_meta_packed(spin_json *root, const struct spin_packer *packer);
/* Creates the value of "sound" for meta.json or for a report: null if there is no sound. */
spin_json *spin_sound_json(const struct spin_sound *sound);
/* Returns a JSON list with the names of these columns. */
spin_json *spin_column_names(unsigned columns);

/* Helpers to read other parts of meta.json. spin_meta_fail() sets the error "'key' is missing or is
 * not <expected>" and returns SPIN_E_MALFORMED. */
spin_status spin_meta_fail(const char *key, const char *expected);
/* Reads an integer in [least, most]. */
spin_status spin_meta_integer(const spin_json *object, const char *key, int64_t least, int64_t most,
                              int64_t *out);
/* Reads "columns", "sh_degree" and "antialias"; "columns" must contain "means". */
spin_status spin_meta_columns(const spin_json *object, unsigned *columns, int *sh_degree,
                              bool *antialias);

/* Returns a copy of "options" in "trained" of meta.json, for reports. If no network was trained,
 * the options of the network are omitted. Returns NULL if there are no options. */
spin_json *spin_trained_options(const spin_json *trained);
