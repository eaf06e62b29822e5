/* Streamed SOG of PlayCanvas, version 1 and its predecessor without a version: lod-meta.json, and
 * folders with unpacked SOG files, the chunks. A tree of bounding boxes has, for each leaf and
 * level of detail, a run of splats of a chunk. Level 0 is the finest. The sky, called the
 * environment, is a SOG outside the levels, which viewers always draw. */
#pragma once

#include "importers/lib/model.h"

#define SPIN_SOG_LEVELS_FILE "lod-meta.json"

/* A chunk, or the sky. */
struct sog_chunk {
    const char *path;   /* meta.json or, for a packed SOG, the zip */
    const char *folder; /* folder of meta.json; NULL: the SOG is packed */
    size_t n;           /* splats of the chosen level */
    size_t n_rows;      /* splats in the file */
    bool exists;
};

struct sog_run {
    int level, chunk;
    size_t first, n;
};

/* To be zero-initialised; the memory is freed with the model. */
struct sog_levels {
    struct sog_chunk *chunk; /* [n_chunks], and the sky behind them */
    struct sog_run *run;
    size_t n_chunks, n_runs;
    int n_levels, level; /* the number of levels, and the chosen one */
    bool has_sky;
    size_t n; /* splats of the chosen level and the sky */
    int sh_degree;
    bool antialias;
};

/* Reads lod-meta.json, a text of n bytes in the folder, and the headers of the chunks of one level:
 * that of option `lod` or, without it, the finest whose files exist. */
spin_status spin_sog_levels_open(struct spin_model *m, const char *folder, const void *text,
                                 size_t n, struct sog_levels *out);
/* Describes the choice of the level in *level, and the sky in *sky, which is NULL if there is none.
 */
spin_status spin_sog_levels_note(struct spin_model *m, const struct sog_levels *l,
                                 const char **level, const char **sky);
/* Reads the splats of the chosen level, and those of the sky behind them. */
spin_status spin_sog_levels_read(const struct sog_levels *l, unsigned columns,
                                 struct spin_splats *out);
