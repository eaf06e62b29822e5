/* The draft of a page with --split: a coarse first frame that is shown while the rest is loading.
 * It is a sample of the splats, chosen with a probability proportional to their area in the first
 * view; small ones are enlarged, so that the covered area stays about the same. */
#pragma once

#include "exporters/lib/initial_view.h"
#include "exporters/lib/page_group.h"

struct spin_page_draft_row {
    uint32_t row;
    float area; /* covered in the first view, weighted by opacity */
    float log_scale[3];
};

struct spin_page_draft {
    struct spin_page_group
        group; /* contains the first frame only; the caller sets space and pool */
    struct spin_page_draft_row *row; /* [n] the kept rows, in Morton order */
    size_t n;
};

/* Copies the kept rows of the first frame and computes their areas in this view. order is scratch
 * memory. */
spin_status spin_page_draft_take(struct spin_page_draft *d, const struct spin_splat_filter *rows,
                                 const struct spin_splats *splats,
                                 const struct spin_initial_view *view,
                                 struct spin_sort_rows *order);
/* Passes a block with as many of these rows as fit into most_bytes to the sink. If only a few rows
 * fit, there is no draft and the sink is not called. */
spin_status spin_page_draft_write(struct spin_page_draft *d, uint64_t most_bytes,
                                  spin_page_sink sink, void *context);
void spin_page_draft_free(struct spin_page_draft *d);
