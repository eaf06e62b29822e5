/* Writes splats as a streamed SOG of PlayCanvas, version 1: chunks at several levels of detail, and
 * an index with a tree of bounding boxes (see importers/lib/sog_levels.h). A player chooses the
 * level for each leaf of the tree, mostly by its distance from the camera. */
#pragma once

#include "exporters/lib/sog_images.h"
#include "io/output.h"

#define SPIN_SOG_INDEX "lod-meta.json"

enum { SPIN_SOG_MOST_LEVELS = 8 };

struct spin_sog_levels_out {
    /* Set by the caller. */
    struct spin_output_folder *output; /* the folders of all chunks are marked as written */
    struct spin_pool *pool;
    int n_levels; /* 1 to SPIN_SOG_MOST_LEVELS; level k has about 1/4^k of the splats */
    int effort;   /* effort of WebP, 0 to 9 */
    bool antialias, sync;

    /* Results. */
    uint64_t bytes; /* size of all chunks */
    size_t n_chunks;
    size_t counts[SPIN_SOG_MOST_LEVELS]; /* number of splats of each level */
    struct spin_quant_error quant;       /* rounding errors of level 0 */
    char *index;                         /* the text of the index, which the caller writes last */
};

/* Writes the chunks of these splats, which must have all attributes, and creates the index. The
 * index of a former export to the folder is removed, and so are those of its chunks that this one
 * does not replace. If writing a chunk fails, no chunks are left. */
spin_status spin_sog_levels_write(struct spin_sog_levels_out *x, const struct spin_splats *splats);
void spin_sog_levels_out_free(struct spin_sog_levels_out *x);
