/* Streamed SOG of PlayCanvas, version 1 and its predecessor without a version number. It consists
 * of lod-meta.json and of the chunks, each of which is a SOG, usually unpacked in a folder.
 * lod-meta.json contains a tree of bounding boxes, whose leaves list, for each level of detail, a
 * run of consecutive splats of one chunk. Level 0 is the finest. The sky, called "environment" in
 * the file, is a SOG that belongs to no level and that viewers always draw. */
#pragma once

#include "importers/lib/model.h"

#define SPIN_SOG_LEVELS_FILE "lod-meta.json"

/* A chunk, or the sky. */
struct sog_chunk {
    const char *path;   /* meta.json or, for a packed SOG, the zip */
    const char *folder; /* folder of meta.json; NULL: the SOG is packed */
    size_t n;           /* number of splats in the chunk that belong to the chosen level */
    size_t n_rows;      /* number of splats in the file */
    bool exists;
};

struct sog_run {
    int level, chunk;
    size_t first, n;
};

/* The caller zero-initialises the struct; the memory is freed with the model. */
struct sog_levels {
    struct sog_chunk *chunk; /* [n_chunks + 1], the last one is the sky */
    struct sog_run *run;
    size_t n_chunks, n_runs;
    int n_levels, level; /* number of levels; the chosen level */
    bool has_sky;
    size_t n; /* number of splats of the chosen level and of the sky */
    int sh_degree;
    bool antialias;
};

/* Parses `text` [n], the content of lod-meta.json in `folder`, and reads the headers of the chunks
 * of one level: that of option `lod` or, without the option, the finest level whose files exist. */
spin_status spin_sog_levels_open(struct spin_model *m, const char *folder, const void *text,
                                 size_t n, struct sog_levels *out);
/* Sets *level to a note that states the chosen level and why it was chosen, and *sky to a note
 * about the sky, or to NULL if there is no sky. */
spin_status spin_sog_levels_note(struct spin_model *m, const struct sog_levels *l,
                                 const char **level, const char **sky);
/* Reads the splats of the chosen level, followed by those of the sky. */
spin_status spin_sog_levels_read(const struct sog_levels *l, unsigned columns,
                                 struct spin_splats *out);
