/* The draft of a served page: a coarse first frame, small enough to be shown while the rest is
 * read. It has some of the splats, the larger the likelier, and the small ones among them grow, so
 * that about as much is covered. */
#pragma once

#include "exporters/lib/initial_view.h"
#include "exporters/lib/page_group.h"

struct spin_page_draft_row {
    uint32_t row;
    float area; /* what it covers in the first view, by its size and opacity */
    float log_scale[3];
};

struct spin_page_draft {
    struct spin_page_group group; /* of the first frame alone; what it needs is set by the caller */
    struct spin_page_draft_row *row; /* [n] the kept ones, along a Morton curve */
    size_t n;
};

/* Take the kept rows of the first frame, which is seen by this view first. order: scratch. */
spin_status spin_page_draft_take(struct spin_page_draft *d, const struct spin_splat_filter *rows,
                                 const struct spin_splats *splats,
                                 const struct spin_initial_view *view,
                                 struct spin_sort_rows *order);
/* A block of as many of them as fit into most_bytes, to the sink; none where only a few would fit.
 */
spin_status spin_page_draft_write(struct spin_page_draft *d, uint64_t most_bytes,
                                  spin_page_sink sink, void *context);
void spin_page_draft_free(struct spin_page_draft *d);
