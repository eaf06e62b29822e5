/* A group consists of consecutive frames of one version of a page's clip; the first of these frames
 * is the key frame. This module finds the rows that the frames of a group share and encodes each
 * frame as a block.
 *
 * A row is shared if all frames of the group have its splat. Where rows correspond by index, this
 * includes frames that do not keep the splat: its opacity is 0 there. A block contains the static
 * shared rows first, then the dynamic shared rows by rising activity; rows of equal activity are
 * sorted by position. All other kept rows of a frame are called its own rows.
 *
 * Static rows often last for many groups. A key frame refers to those that the base has, too: the
 * last key frame of an earlier group that refers to none. */
#pragma once

#include "exporters/lib/page_bytes.h"
#include "exporters/lib/page_values.h"
#include "exporters/lib/splat_rows.h"

enum { SPIN_PAGE_MOST_FRAMES = 256 };

struct spin_page_frame {
    size_t n;         /* number of source rows */
    float *value;     /* [n][width] */
    uint8_t *present; /* [n] 1: the row was kept, 0: it is absent */
    /* [rows of the group's first frame] index of the same splat in this frame; UINT32_MAX: the
     * splat is not in this frame. NULL: row i is the same splat in both frames. */
    uint32_t *row;
    uint32_t *own; /* [n_own] rows that are not shared, sorted by position */
    size_t n_own;
};

struct spin_page_group {
    struct spin_page_space space;
    struct spin_pool *pool;
    int n_sh, most_frames;
    bool refers; /* true: key frames refer to the static rows of an earlier one */

    struct spin_page_frame frame[SPIN_PAGE_MOST_FRAMES];
    int n_frames;

    /* spin_page_group_write() sets the following members. */
    /* [n_shared] the shared rows, as ascending indices of rows of the first frame. */
    uint32_t *shared;
    size_t n_shared, n_still;
    int32_t *key;    /* [n_shared][columns] the keys of the rows, in the order of `shared` */
    int32_t *number; /* [columns][n_frames][n_shared] differences from the keys */
    struct spin_quant_error quant; /* errors of all frames; those of rotations are in radians */
    uint64_t n_values;             /* number of values that were compared with their bounds */

    /* The static rows of the base, in the order of its block. */
    int32_t *base_key;    /* [n_base][columns] */
    uint64_t *base_place; /* [n_base] position along the Morton curve */
    size_t n_base;
    /* [n_base / 8, rounded up] one bit for each of them, the lowest first; 1: it is also a row of
     * this group. There are n_referred such rows, the first static rows of the group. */
    uint8_t *referred;
    size_t n_referred; /* 0: this group is the base of the next ones */
};

/* Returns the number of floats per row of spin_page_frame.value. */
static inline size_t spin_page_width(const struct spin_page_group *g)
{
    return (size_t)(SPIN_PAGE_VALUE_SH + g->n_sh);
}

/* A block: its description for the page's JSON, and its bytes. */
struct spin_page_block {
    int frame; /* index in the group; 0: the key frame */
    size_t n_shared, n_still, n_own;
    size_t n_referred;   /* in key frames: number of static rows of the base */
    const uint8_t *data; /* compressed with gzip */
    size_t n_bytes;
};
typedef spin_status (*spin_page_sink)(void *context, const struct spin_page_block *block);

/* Adds a frame: the kept rows of `splats`, in the axes of the file. Sets *full to true and adds
 * nothing if the group has too many frames, would need too much memory, or shares too few rows with
 * the frame. The caller then writes the group and adds the frame to the next group. */
spin_status spin_page_group_add(struct spin_page_group *g, const struct spin_splat_rows *rows,
                                const struct spin_splats *splats, bool *full);
/* Encodes all frames, decodes them again, compares the errors with the bounds, passes the blocks to
 * the sink, and empties the group. SPIN_E_MALFORMED: an error exceeds its bound. */
spin_status spin_page_group_write(struct spin_page_group *g, spin_page_sink sink, void *context);
void spin_page_group_free(struct spin_page_group *g);
