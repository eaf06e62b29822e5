#include "exporters/lib/page_draft.h"

#include "base/base.h"

#define FEWEST 32     /* a draft with fewer splats would not show a recognisable scene */
#define TRIES 8       /* at most this number of attempts to find how many splats fit */
#define BYTES_EACH 14 /* approximate size in bytes of a splat in a key frame */
#define MOST_GROWTH 8 /* largest factor by which a splat is enlarged */

/* Returns a measure of the area that a splat covers in the view, multiplied by its opacity. The
 * result is nearly 0 for splats behind the camera. */
static float area_of(const float *value, const struct spin_initial_view *view)
{
    const float *scale = value + SPIN_PAGE_SCALE;
    float least = fminf(scale[0], fminf(scale[1], scale[2]));
    double away = 0, ahead = 0;

    for (int c = 0; c < 3; c++) {
        double d = (double)value[SPIN_PAGE_PLACE + c] - view->eye[c];

        away += d * d;
        ahead += d * (view->target[c] - view->eye[c]);
    }
    return (float)((double)value[SPIN_PAGE_OPACITY] *
                   exp((double)(scale[0] + scale[1] + scale[2] - least)) / fmax(away, 1e-12) *
                   (ahead > 0 ? 1 : 1e-9));
}

spin_status spin_page_draft_add_rows(struct spin_page_draft *d, const struct spin_splat_rows *rows,
                                     const struct spin_splats *splats,
                                     const struct spin_initial_view *view,
                                     struct spin_sort_rows *order)
{
    bool full;

    d->group.most_frames = 1;
    SPIN_TRY(spin_page_group_add(&d->group, rows, splats, &full));
    SPIN_TRY(spin_sort_rows_fill(order, rows));
    spin_sort_rows_by_place(order, splats);
    SPIN_TRY(spin_grow(order->n + 1, sizeof *d->row, (void **)&d->row));
    d->n = order->n;
    for (size_t i = 0; i < d->n; i++) {
        struct spin_page_draft_row *r = &d->row[i];
        const float *value;

        r->row = order->item[i].row;
        value = d->group.frame[0].value + r->row * spin_page_width(&d->group);
        r->area = area_of(value, view);
        memcpy(r->log_scale, value + SPIN_PAGE_SCALE, sizeof r->log_scale);
    }
    return SPIN_OK;
}

/* Returns the probability with which a row is chosen: 1 if its area is `sure` or larger, otherwise
 * area / sure. */
static double choice_probability(const struct spin_page_draft_row *r, double sure)
{
    return (double)r->area < sure ? (double)r->area / sure : 1;
}

static double expected_count(const struct spin_page_draft *d, double sure)
{
    double n = 0;

    for (size_t i = 0; i < d->n; i++)
        n += choice_probability(&d->row[i], sure);
    return n;
}

/* Finds, by bisection, the value of `sure` for which the expected number of chosen rows is n. */
static double sure_area(const struct spin_page_draft *d, size_t n)
{
    double low = -80, high = 80; /* logarithms */

    for (int i = 0; i < 50; i++) {
        double middle = 0.5 * (low + high);

        if (expected_count(d, exp(middle)) > (double)n)
            low = middle;
        else
            high = middle;
    }
    return exp(high);
}

/* Chooses about n rows by systematic sampling along the Morton curve. Each chosen splat also
 * represents skipped splats, so it is enlarged, by at most a factor of MOST_GROWTH, to cover their
 * area. */
static void choose_rows(struct spin_page_draft *d, size_t n)
{
    struct spin_page_frame *frame = &d->group.frame[0];
    double sure = sure_area(d, n), sum = 0;

    memset(frame->present, 0, frame->n);
    for (size_t i = 0; i < d->n; i++) {
        const struct spin_page_draft_row *r = &d->row[i];
        float *scale = frame->value + r->row * spin_page_width(&d->group) + SPIN_PAGE_SCALE;
        double p = choice_probability(r, sure), before = floor(sum),
               growth = fmin(1 / sqrt(p), MOST_GROWTH);

        sum += p;
        frame->present[r->row] = floor(sum) > before;
        for (int c = 0; c < 3; c++)
            scale[c] = r->log_scale[c] + (float)log(growth);
    }
}

/* A copy of a block, which is passed to the sink only if it is small enough. */
struct kept {
    struct spin_page_block block;
    uint8_t *data;
};

static spin_status keep_block(void *context, const struct spin_page_block *block)
{
    struct kept *k = context;

    SPIN_TRY(spin_grow(block->n_bytes, 1, (void **)&k->data));
    memcpy(k->data, block->data, block->n_bytes);
    k->block = *block;
    k->block.data = k->data;
    return SPIN_OK;
}

spin_status spin_page_draft_write(struct spin_page_draft *d, uint64_t most_bytes,
                                  spin_page_sink sink, void *context)
{
    struct kept kept = {0};
    size_t n = most_bytes / BYTES_EACH < d->n ? (size_t)(most_bytes / BYTES_EACH) : d->n;
    spin_status status = SPIN_OK;

    for (int i = 0; i < TRIES && n >= FEWEST; i++) {
        double room;

        choose_rows(d, n);
        d->group.n_frames = 1;
        SPIN_TRY_OUT(spin_page_group_write(&d->group, keep_block, &kept));
        room = (double)most_bytes / (double)kept.block.n_bytes;
        if (room >= 1 && (room < 1.1 || n == d->n || i == TRIES - 1)) {
            status = sink(context, &kept.block);
            break;
        }
        n = (size_t)fmin(0.97 * room * (double)n, (double)d->n);
    }
out:
    free(kept.data);
    return status;
}

void spin_page_draft_free(struct spin_page_draft *d)
{
    spin_page_group_free(&d->group);
    free(d->row);
    *d = (struct spin_page_draft){0};
}
