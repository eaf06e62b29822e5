/* A group of a page's clip: consecutive frames of one version, of which the first is the key frame,
 * the rows that these frames share, and the blocks that encode them.
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
    /* [rows of the group's first frame] index of the same splat in this frame, UINT32_MAX: absent.
     * NULL: all rows have equal indices. */
    uint32_t *row;
    uint32_t *own; /* [n_own] rows that are not shared, sorted by position */
    size_t n_own;
};

struct spin_page_group {
    struct spin_page_space space;
    struct spin_pool *pool;
    int n_sh, most_frames;

    struct spin_page_frame frame[SPIN_PAGE_MOST_FRAMES];
    int n_frames;

    /* Set by spin_page_group_write(). */
    uint32_t *shared; /* [n_shared] rows of the first frame in file order */
    size_t n_shared, n_still;
    int32_t *key;                  /* [n_shared][columns] the key frame's numbers, in file order */
    int32_t *number;               /* [columns][n_frames][n_shared] */
    struct spin_quant_error quant; /* errors of all frames, rotations in radians */
    uint64_t n_values;             /* number of values that were compared with their bounds */
};

/* Floats per row of spin_page_frame.value. */
static inline size_t spin_page_width(const struct spin_page_group *g)
{
    return (size_t)(SPIN_PAGE_VALUE_SH + g->n_sh);
}

/* A block: what the page's JSON contains, and the bytes. */
struct spin_page_block {
    int frame; /* index in the group; 0: the key frame */
    size_t n_shared, n_still, n_own;
    const uint8_t *data; /* gzip */
    size_t n_bytes;
};
typedef spin_status (*spin_page_sink)(void *context, const struct spin_page_block *block);

/* Adds a frame: the kept rows of the splats, in the filter's axes. Sets *full and adds nothing if
 * the group has too many frames, would need too much memory, or shares too few rows with the frame;
 * the caller then writes the group and adds the frame to the next one. */
spin_status spin_page_group_add(struct spin_page_group *g, const struct spin_splat_filter *rows,
                                const struct spin_splats *splats, bool *full);
/* Encodes all frames, decodes them again, compares the errors with the bounds, passes the blocks to
 * the sink, and empties the group. SPIN_E_MALFORMED: an error exceeds its bound. */
spin_status spin_page_group_write(struct spin_page_group *g, spin_page_sink sink, void *context);
void spin_page_group_free(struct spin_page_group *g);
