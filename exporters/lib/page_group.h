/* A group of a page's clip: consecutive frames of one version that begin with a key, the rows that
 * they share, and the blocks that encode them.
 *
 * Rows present in all frames are shared. The static ones come first, then the dynamic ones by
 * rising activity, each sorted by position. All other rows of a frame are its own. */
#pragma once

#include "exporters/lib/page_bytes.h"
#include "exporters/lib/page_values.h"
#include "exporters/lib/sort_rows.h"

enum { SPIN_PAGE_MOST_FRAMES = 256 };

struct spin_page_frame {
    size_t n;         /* rows of the source */
    float *value;     /* [n][width] */
    uint8_t *present; /* [n] */
    uint32_t *row; /* [n of the first] row in this frame; UINT32_MAX: absent; NULL: the same row */
    uint32_t *own; /* [n_own] rows that are not shared, by position */
    size_t n_own;
};

struct spin_page_group {
    struct spin_page_space space;
    struct spin_pool *pool;
    int n_sh, most_frames;

    struct spin_page_frame frame[SPIN_PAGE_MOST_FRAMES];
    int n_frames;

    /* Valid while the group is written. */
    uint32_t *shared; /* [n_shared] rows of the first frame, in the order of the file */
    size_t n_shared, n_still;
    int32_t *key;                  /* [n_shared][columns], in the order of shared */
    int32_t *number;               /* [columns][n_frames][n_shared] */
    struct spin_quant_error quant; /* of all frames, rotations in radians */
    uint64_t n_values;             /* checked against the bounds */
};

/* Floats per row of spin_page_frame.value. */
static inline size_t spin_page_width(const struct spin_page_group *g)
{
    return (size_t)(SPIN_PAGE_VALUE_SH + g->n_sh);
}

/* A block, for the page and for the sink that stores its bytes. */
struct spin_page_block {
    int frame; /* 0: the key */
    size_t n_shared, n_still, n_own;
    const uint8_t *data; /* gzip */
    size_t n_bytes;
};
typedef spin_status (*spin_page_sink)(void *context, const struct spin_page_block *block);

/* Adds a frame: the kept rows of splats, in the filter's axes. Sets *full, and adds nothing, if the
 * frame does not fit into this group (too many frames, too much memory, too few rows in common):
 * write the group first. */
spin_status spin_page_group_add(struct spin_page_group *g, const struct spin_splat_filter *rows,
                                const struct spin_splats *splats, bool *full);
/* Passes the blocks of all frames to the sink, each decoded and compared with the bounds before,
 * and empties the group. The error names the value that exceeds its bound. */
spin_status spin_page_group_write(struct spin_page_group *g, spin_page_sink sink, void *context);
void spin_page_group_free(struct spin_page_group *g);
