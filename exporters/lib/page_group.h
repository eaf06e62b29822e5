/* Frames of one version of a page's clip, from a key on: which rows they share, and the blocks they
 * become.
 *
 * A group begins with a key. Rows that all of its frames have are shared: those that change nowhere
 * come first, then the others, the quiet before the restless, each by place. What a frame has
 * beside them is its own. */
#pragma once

#include "exporters/lib/page_bytes.h"
#include "exporters/lib/page_values.h"
#include "exporters/lib/sort_rows.h"

enum { SPIN_PAGE_MOST_FRAMES = 256 };

struct spin_page_frame {
    size_t n;         /* rows of the source */
    float *value;     /* [n][width] */
    uint8_t *present; /* [n] */
    uint32_t *row;    /* [n of the first] of this frame, UINT32_MAX: it has none; NULL: the same */
    uint32_t *own;    /* [n_own] rows that are not shared, by place */
    size_t n_own;
};

struct spin_page_group {
    struct spin_page_space space;
    struct spin_pool *pool;
    int n_sh, most_frames;

    struct spin_page_frame frame[SPIN_PAGE_MOST_FRAMES];
    int n_frames;

    /* While it is written. */
    uint32_t *shared; /* [n_shared] rows of the first frame, in the order of the file */
    size_t n_shared, n_still;
    int32_t *key;                  /* [n_shared][columns], in the order of shared */
    int32_t *number;               /* [columns][n_frames][n_shared] */
    struct spin_quant_error quant; /* over the clip, rotations in radians */
    uint64_t n_values;             /* that were held to the bounds */
};

/* Floats of a row in value. */
static inline size_t spin_page_width(const struct spin_page_group *g)
{
    return (size_t)(SPIN_PAGE_VALUE_SH + g->n_sh);
}

/* What a block is, for the page and for whoever keeps its bytes. */
struct spin_page_block {
    int frame; /* 0: the key */
    size_t n_shared, n_still, n_own;
    const uint8_t *data; /* a gzip */
    size_t n_bytes;
};
typedef spin_status (*spin_page_sink)(void *context, const struct spin_page_block *block);

/* Add a frame: the rows that are kept of splats, in the filter's axes. *full: it does not belong to
 * this group (too many frames, too much memory, too few rows in common), which must be written
 * first. */
spin_status spin_page_group_add(struct spin_page_group *g, const struct spin_splat_filter *rows,
                                const struct spin_splats *splats, bool *full);
/* Blocks of all frames to the sink, each read back and held to the bounds before; the group is
 * empty then. An error says which value is not within them. */
spin_status spin_page_group_write(struct spin_page_group *g, spin_page_sink sink, void *context);
void spin_page_group_free(struct spin_page_group *g);
