/* The draft of a page with --split: a coarse version of the first frame, which is shown while the
 * blocks are loading. The draft is a sample of the splats of the frame, in which the probability of
 * a splat is proportional to its area in the first view, up to 1. Splats of the sample with a lower
 * probability are enlarged, so that the covered area stays about the same. */
#pragma once

#include "exporters/lib/initial_view.h"
#include "exporters/lib/page_group.h"

struct spin_page_draft_row {
    uint32_t row;
    float area; /* area covered in the first view, weighted by opacity */
    float log_scale[3];
};

struct spin_page_draft {
    /* Contains the first frame only. The caller sets group.space, group.pool and group.n_sh. */
    struct spin_page_group group;
    struct spin_page_draft_row *row; /* [n] the kept rows, in Morton order */
    size_t n;
};

/* Copies the kept rows of the first frame, and computes their areas in this view. order: scratch
 * memory. */
spin_status spin_page_draft_add_rows(struct spin_page_draft *d, const struct spin_splat_rows *rows,
                                     const struct spin_splats *splats,
                                     const struct spin_initial_view *view,
                                     struct spin_sort_rows *order);
/* Passes a block of at most most_bytes bytes to the sink, with about as many of the copied rows as
 * fit. If only a few rows fit, there is no draft, and the sink is not called. */
spin_status spin_page_draft_write(struct spin_page_draft *d, uint64_t most_bytes,
                                  spin_page_sink sink, void *context);
void spin_page_draft_free(struct spin_page_draft *d);
