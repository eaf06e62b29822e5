/* Queues the device operations of the forward and the backward pass of the network (docs/method.md
 * section 3). */
#include "model/field_eval.h"

#include "base/base.h"

/* A buffer in device memory with `floats` values of 4 bytes for each splat. training: true if only
 * the backward pass needs the buffer. */
struct piece {
    void SPIN_DEV **at;
    size_t floats;
    bool training;
};
enum { N_PIECES = 9 };

/* Lists all buffers, for their allocation and release. Without a network, the buffers of the
 * encoder are empty. */
static void list_pieces(struct spin_field_eval *w, const struct spin_field *field,
                        struct piece piece[N_PIECES])
{
    size_t n_in = field ? (size_t)field->heads.n_in : 0, x_u = field ? 4 : 0;
    size_t row = w->narrow ? SPIN_ATTR_NARROW : SPIN_ATTR;
    const struct piece all[N_PIECES] = {
        {(void SPIN_DEV **)&w->x_u, x_u, false},     {(void SPIN_DEV **)&w->z, n_in, false},
        {(void SPIN_DEV **)&w->raw, row, false},     {(void SPIN_DEV **)&w->attr, row, false},
        {(void SPIN_DEV **)&w->d_attr, row, true},   {(void SPIN_DEV **)&w->d_raw, row, true},
        {(void SPIN_DEV **)&w->d_z, n_in, true},     {(void SPIN_DEV **)&w->d_x_u, x_u, true},
        {(void SPIN_DEV **)&w->active.row, 1, true},
    };

    memcpy(piece, all, sizeof all);
}

spin_status spin_field_eval_open(struct spin_field_eval *w, struct spin_device *device,
                                 const struct spin_field *field, bool sh, size_t capacity,
                                 bool training)
{
    struct piece piece[N_PIECES];
    spin_status status = SPIN_OK;

    memset(w, 0, sizeof *w);
    w->device = device;
    w->capacity = capacity;
    w->training = training;
    w->narrow = !field && !sh && device->is_host;
    w->active.most = capacity;
    list_pieces(w, field, piece);
    for (int i = 0; i < N_PIECES; i++)
        if (training || !piece[i].training)
            SPIN_TRY_OUT(device->op->reserve(device, capacity * piece[i].floats * sizeof(float),
                                             piece[i].at));
    if (training)
        SPIN_TRY_OUT(
            device->op->reserve(device, sizeof *w->active.n, (void SPIN_DEV **)&w->active.n));
out:
    if (status != SPIN_OK)
        spin_field_eval_close(w, field);
    return status;
}

void spin_field_eval_close(struct spin_field_eval *w, const struct spin_field *field)
{
    struct piece piece[N_PIECES];

    if (!w->device)
        return;
    list_pieces(w, field, piece);
    for (int i = 0; i < N_PIECES; i++)
        w->device->op->release(w->device, *piece[i].at);
    w->device->op->release(w->device, w->active.n);
    memset(w, 0, sizeof *w);
}

struct spin_frame_batch spin_one_frame(size_t n, const float SPIN_DEV *means, float t,
                                       const float SPIN_DEV *residual)
{
    struct spin_frame_batch frames = {.n_frames = 1, .n = n};

    frames.frame[0].n = n;
    frames.frame[0].t = t;
    frames.frame[0].means = means;
    frames.frame[0].residual = residual;
    return frames;
}

void spin_field_encode(struct spin_field_eval *w, const struct spin_field *field,
                       const float SPIN_DEV *table, const struct spin_frame_batch *frames)
{
    struct spin_device *d = w->device;

    d->op->contract(d, &field->transform, frames, w->x_u);
    if (w->lazy)
        d->op->lazy_adam_grid(d, w->lazy, frames->n, w->x_u, w->z);
    else
        d->op->grid(d, &field->grid, table, frames->n, w->x_u, w->z);
}

void spin_field_decode(struct spin_field_eval *w, const struct spin_field *field,
                       const float SPIN_DEV *heads, const struct spin_frame_batch *frames)
{
    struct spin_device *d = w->device;
    bool residual = false;

    for (int f = 0; f < frames->n_frames; f++)
        residual |= frames->frame[f].residual != NULL;
    if (field)
        d->op->mlp(d, &field->heads, heads, frames->n, w->z, w->raw);
    if (residual && field)
        d->op->residual(d, frames, w->raw);
    else if (residual)
        d->op->residual_set(d, frames, w->raw);
    d->op->activate(d, frames, w->raw, w->attr);
}

void spin_field_forward(struct spin_field_eval *w, const struct spin_field *field,
                        const float SPIN_DEV *table, const float SPIN_DEV *heads,
                        const struct spin_frame_batch *frames)
{
    if (field)
        spin_field_encode(w, field, table, frames);
    spin_field_decode(w, field, heads, frames);
}

void spin_field_decode_back(struct spin_field_eval *w, const struct spin_field *field,
                            const float SPIN_DEV *heads, const struct spin_frame_batch *frames,
                            float SPIN_DEV *d_heads)
{
    struct spin_device *d = w->device;
    bool residual = false;

    for (int f = 0; f < frames->n_frames; f++)
        residual |= frames->frame[f].d_residual != NULL;
    d->op->nonzero_grad(d, frames, w->d_attr, &w->active);
    d->op->activate_back(d, frames, &w->active, w->raw, w->d_attr, w->d_raw);
    if (residual)
        d->op->residual_back(d, frames, &w->active, w->d_raw);
    if (field)
        d->op->mlp_back(d, &field->heads, heads, &w->active, w->z, w->d_raw, d_heads, w->d_z);
}

void spin_field_encode_back(struct spin_field_eval *w, const struct spin_field *field,
                            const float SPIN_DEV *table, const struct spin_frame_batch *frames,
                            float SPIN_DEV *d_table)
{
    struct spin_device *d = w->device;

    d->op->grid_back(d, &field->grid, table, &w->active, w->x_u, w->d_z, d_table,
                     w->still ? NULL : w->d_x_u);
    if (!w->still)
        d->op->contract_back(d, &field->transform, frames, &w->active, w->d_x_u);
}

void spin_field_backward(struct spin_field_eval *w, const struct spin_field *field,
                         const float SPIN_DEV *table, const float SPIN_DEV *heads,
                         const struct spin_frame_batch *frames, float SPIN_DEV *d_table,
                         float SPIN_DEV *d_heads)
{
    spin_field_decode_back(w, field, heads, frames, d_heads);
    if (field)
        spin_field_encode_back(w, field, table, frames, d_table);
}

/* ---- Rows and columns ------------------------------------------------------------------------ */

/* Copies log scale and logit opacity from the raw attributes: computing them from the activated
 * attributes would add the rounding errors of exp and log. */
void spin_attr_to_splats(const float *raw, const float *attr, size_t width, struct spin_splats *s)
{
    size_t k = (size_t)(s->sh_degree + 1) * (size_t)(s->sh_degree + 1) * 3;

    for (size_t i = 0; i < s->n; i++) {
        const float *r = raw + i * width, *a = attr + i * width;

        if (s->log_scales)
            for (int c = 0; c < 3; c++)
                s->log_scales[i * 3 + (size_t)c] = fminf(r[SPIN_ATTR_SCALE + c], 20.0f);
        if (s->quats)
            memcpy(s->quats + i * 4, a + SPIN_ATTR_ROTATION, 4 * sizeof(float));
        if (s->sh)
            memcpy(s->sh + i * k, a + SPIN_ATTR_SH, k * sizeof(float));
        if (s->logit_opacities)
            s->logit_opacities[i] = r[width - 1];
    }
}

void spin_attr_from_splats(const struct spin_splats *s, float *attr)
{
    size_t k = (size_t)(s->sh_degree + 1) * (size_t)(s->sh_degree + 1) * 3;

    for (size_t i = 0; i < s->n; i++) {
        float *row = attr + i * SPIN_ATTR;

        for (int c = 0; c < 3; c++)
            row[SPIN_ATTR_SCALE + c] = expf(s->log_scales[i * 3 + (size_t)c]);
        memcpy(row + SPIN_ATTR_ROTATION, s->quats + i * 4, 4 * sizeof(float));
        memset(row + SPIN_ATTR_SH, 0, 48 * sizeof(float));
        memcpy(row + SPIN_ATTR_SH, s->sh + i * k, k * sizeof(float));
        row[SPIN_ATTR_OPACITY] = 1.0f / (1.0f + expf(-s->logit_opacities[i]));
    }
}
