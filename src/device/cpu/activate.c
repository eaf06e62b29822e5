/* Computes attributes from the outputs of the heads by their activation functions, and propagates
 * gradients back. Lists the rows with a nonzero gradient. */
#include "device/cpu/cpu.h"

#include <string.h>

#include "math/activate.h"

enum { CHUNK = 1024, BLOCK = 32 };

struct job {
    size_t n, width; /* `width`: number of floats in a row of attributes */
    const uint32_t *rows;
    const float *raw, *d_attr, *d_pos_w;
    float *out;
    uint32_t first_row; /* index of the frame's first row in the batch */
    /* [n] active rows; the list of a chunk begins at the index of the chunk's first row */
    uint32_t *found;
    uint32_t *count; /* [chunks] number of active rows of each chunk */
};

static inline void copy_sh(size_t width, const float *from, float *to)
{
    if (width == SPIN_ATTR)
        memcpy(to + SPIN_ATTR_SH, from + SPIN_ATTR_SH, 48 * sizeof *to);
    else
        memcpy(to + SPIN_ATTR_SH, from + SPIN_ATTR_SH, 4 * sizeof *to);
}

/* A block of rows, stored as a structure of arrays so that the compiler vectorises the loops over
 * rows. */
struct block {
    float scale[3][BLOCK], rotation[4][BLOCK], opacity[BLOCK];
};

static inline void block_load_row(struct block *b, int i, const float *row, size_t width)
{
    for (int k = 0; k < 3; k++)
        b->scale[k][i] = row[SPIN_ATTR_SCALE + k];
    for (int k = 0; k < 4; k++)
        b->rotation[k][i] = row[SPIN_ATTR_ROTATION + k];
    b->opacity[i] = row[width - 1];
}

static inline void block_store_row(const struct block *b, int i, float *row, size_t width)
{
    for (int k = 0; k < 3; k++)
        row[SPIN_ATTR_SCALE + k] = b->scale[k][i];
    for (int k = 0; k < 4; k++)
        row[SPIN_ATTR_ROTATION + k] = b->rotation[k][i];
    row[width - 1] = b->opacity[i];
}

static __attribute__((noinline)) void block_activate(const struct block *h,
                                                     struct block *SPIN_RESTRICT a)
{
    for (int i = 0; i < BLOCK; i++) {
        float r[4] = {h->rotation[0][i], h->rotation[1][i], h->rotation[2][i], h->rotation[3][i]};
        float q[4];

        spin_rotation_of(r, q);
        for (int k = 0; k < 4; k++)
            a->rotation[k][i] = q[k];
        for (int k = 0; k < 3; k++)
            a->scale[k][i] = spin_scale_of(h->scale[k][i]);
        a->opacity[i] = spin_opacity_of(h->opacity[i]);
    }
}

static void activate_task(void *context, size_t first, size_t end)
{
    const struct job *job = context;
    struct block h = {0}, a;

    for (; first < end; first += BLOCK) {
        int n = end - first < BLOCK ? (int)(end - first) : BLOCK;
        const float *raw = job->raw + first * job->width;
        float *attr = job->out + first * job->width;

        for (int i = 0; i < n; i++)
            block_load_row(&h, i, raw + (size_t)i * job->width, job->width);
        block_activate(&h, &a);
        for (int i = 0; i < n; i++) {
            block_store_row(&a, i, attr + (size_t)i * job->width, job->width);
            copy_sh(job->width, raw + (size_t)i * job->width, attr + (size_t)i * job->width);
        }
    }
}

void SPIN_CPU(activate)(struct spin_device *d, const struct spin_frame_batch *frames,
                        const float *raw, float *attr)
{
    struct job job = {.n = frames->n, .width = spin_attr_width(frames), .raw = raw, .out = attr};
    SPIN_CPU_CLOCK(d, SPIN_OP_ACTIVATE);

    spin_pool_rows(spin_cpu_pool(d), job.n, CHUNK, activate_task, &job);
}

static __attribute__((noinline)) void
block_activate_back(const struct block *h, const struct block *g, struct block *SPIN_RESTRICT d_h)
{
    for (int i = 0; i < BLOCK; i++) {
        float r[4] = {h->rotation[0][i], h->rotation[1][i], h->rotation[2][i], h->rotation[3][i]};
        float d_q[4] = {g->rotation[0][i], g->rotation[1][i], g->rotation[2][i], g->rotation[3][i]};
        float d_r[4];

        spin_rotation_adj(r, d_q, d_r);
        for (int k = 0; k < 4; k++)
            d_h->rotation[k][i] = d_r[k];
        for (int k = 0; k < 3; k++)
            d_h->scale[k][i] = spin_scale_adj(h->scale[k][i], g->scale[k][i]);
        d_h->opacity[i] = spin_opacity_adj(h->opacity[i], g->opacity[i]);
    }
}

static void activate_back_task(void *context, size_t first, size_t end)
{
    const struct job *job = context;
    struct block h = {0}, g = {0}, d_h;

    for (; first < end; first += BLOCK) {
        int n = end - first < BLOCK ? (int)(end - first) : BLOCK;
        float *d_raw = job->out + first * job->width;

        for (int i = 0; i < n; i++) {
            size_t row = job->rows[first + (size_t)i];

            block_load_row(&h, i, job->raw + row * job->width, job->width);
            block_load_row(&g, i, job->d_attr + row * job->width, job->width);
            copy_sh(job->width, job->d_attr + row * job->width, d_raw + (size_t)i * job->width);
        }
        block_activate_back(&h, &g, &d_h);
        for (int i = 0; i < n; i++)
            block_store_row(&d_h, i, d_raw + (size_t)i * job->width, job->width);
    }
}

void SPIN_CPU(activate_back)(struct spin_device *d, const struct spin_frame_batch *frames,
                             const struct spin_active *active, const float *raw,
                             const float *d_attr, float *d_raw)
{
    struct job job = {.n = *active->n,
                      .width = spin_attr_width(frames),
                      .rows = active->row,
                      .raw = raw,
                      .d_attr = d_attr,
                      .out = d_raw};
    SPIN_CPU_CLOCK(d, SPIN_OP_ACTIVATE_BACK);

    spin_pool_rows(spin_cpu_pool(d), job.n, CHUNK, activate_back_task, &job);
}

/* Returns a number that is nonzero if any value is nonzero. NaN is nonzero, -0 is zero. The bits of
 * all values, without their signs, are combined by OR. */
static uint32_t any_set(const float *x, size_t n)
{
    uint32_t bits = 0;

    for (size_t i = 0; i < n; i++)
        bits |= spin_bits_of_float(x[i]);
    return bits & 0x7fffffffu;
}

static void active_task(void *context, size_t first, size_t end)
{
    const struct job *job = context;
    uint32_t *found = job->found + first, n = 0;

    for (size_t i = first; i < end; i++)
        if (any_set(job->d_attr + i * job->width, job->width) ||
            (job->d_pos_w && any_set(job->d_pos_w + i * 3, 3)))
            found[n++] = job->first_row + (uint32_t)i;
    job->count[first / CHUNK] = n;
}

/* Lists the active rows of a frame and returns their number. Each chunk lists its own active rows;
 * these lists are then joined in order. */
static uint32_t list_active(struct spin_device *d, const struct spin_frame_of_batch *frame,
                            size_t width, const float *d_attr, uint32_t *rows)
{
    size_t chunks = (frame->n + CHUNK - 1) / CHUNK;
    uint32_t *scratch =
        spin_cpu_scratch_need(d, SPIN_SCRATCH_ACTIVE, (frame->n + chunks + 1) * sizeof *scratch);
    struct job job = {.n = frame->n,
                      .width = width,
                      .d_attr = d_attr + frame->first * width,
                      .d_pos_w = frame->d_means,
                      .first_row = (uint32_t)frame->first,
                      .found = scratch};
    uint32_t total = 0;

    if (!scratch)
        return 0;
    job.count = scratch + frame->n;
    spin_pool_rows(spin_cpu_pool(d), frame->n, CHUNK, active_task, &job);
    for (size_t c = 0; c < chunks; c++) {
        memcpy(rows + total, job.found + c * CHUNK, job.count[c] * sizeof *rows);
        total += job.count[c];
    }
    return total;
}

void SPIN_CPU(nonzero_grad)(struct spin_device *d, const struct spin_frame_batch *frames,
                            const float *d_attr, const struct spin_active *active)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_NONZERO_GRAD);
    uint32_t n = 0;

    for (int f = 0; f < frames->n_frames; f++)
        n += list_active(d, &frames->frame[f], spin_attr_width(frames), d_attr, active->row + n);
    *active->n = n;
}
