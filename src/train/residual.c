/* --residual: every splat has raw values of its own, and the network adds to them. They begin as 3DGS
 * would begin from the points, or as the source (or the refined frame) has them. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"
#include "train/densify.h"
#include "train/run.h"

static const size_t width[SPIN_HEADS] = {3, 4, 3, 1}; /* of the groups on the device */

bool spin_run_has_residual(const struct spin_run *r) { return r->o->residual != SPIN_RESIDUAL_OFF; }

void spin_run_residual_rates(const struct spin_run *r, double rate[SPIN_HEADS])
{
    static const double of_3dgs[SPIN_HEADS] = {5e-3, 1e-3, 2.5e-3, 0.05};

    for (int k = 0; k < SPIN_HEADS; k++)
        rate[k] = of_3dgs[k] * r->o->lr_residual;
}

/* A frame's splats as they begin, in the source's order. */
static spin_status read_start(struct spin_run *r, int frame, struct spin_refine_cloud *cloud)
{
    bool whole = r->o->residual == SPIN_RESIDUAL_SOURCE;
    unsigned there = r->clip.bundle.meta.columns, columns = SPIN_COL_MEANS;

    if (whole)
        columns |= SPIN_COL_ATTRIBUTES;
    else if (r->is_refined)
        columns |= SPIN_COL_RGB;
    else
        columns |= there & SPIN_COL_RGB ? SPIN_COL_RGB : there & SPIN_COL_SH;
    if (r->is_refined)
        SPIN_TRY(spin_run_refined(r, frame, columns, &r->splats));
    else
        SPIN_TRY(spin_bundle_frame(&r->clip.bundle, spin_run_index(r, frame), columns, &r->splats));
    if (whole)
        return spin_refine_init_from_splats(&r->splats, cloud);
    return spin_refine_init_from_colours(&r->splats, cloud);
}

static bool is_finite(const struct spin_refine_row *p)
{
    float sum = p->logit_opacity;

    for (int k = 0; k < 3; k++)
        sum += p->log_scale[k] + p->dc[k];
    for (int k = 0; k < 4; k++)
        sum += p->rotation[k];
    return isfinite(sum);
}

/* What stands for a splat whose values are not all finite: small, grey and faint. */
static void make_finite(struct spin_refine_row *p)
{
    static const struct spin_refine_row none = {
        .logit_opacity = -2.1972246f, .log_scale = {-5, -5, -5}, .rotation = {1, 0, 0, 0}};

    if (!is_finite(p))
        *p = none;
}

spin_status spin_run_residual_begin(struct spin_run *r, int frame)
{
    struct spin_refine_cloud cloud = {0};
    size_t n = r->counts[frame];
    void *block = NULL;
    float *to;
    spin_status status;

    SPIN_TRY_OUT(read_start(r, frame, &cloud));
    SPIN_TRY_OUT(spin_alloc(SPIN_RESIDUAL * n + 1, sizeof(float), &block));
    to = block;
    for (size_t k = 0; k < SPIN_HEADS; k++)
        for (size_t i = 0; i < n; i++, to += width[k]) {
            struct spin_refine_row *p = &cloud.point[r->permutation[frame][i]].p;
            const float *from[SPIN_HEADS] = {p->log_scale, p->rotation, p->dc, &p->logit_opacity};

            make_finite(p);
            memcpy(to, from[k], width[k] * sizeof(float));
        }
    r->device.op->upload(&r->device, r->trainer.frame[frame].residual, block,
                         SPIN_RESIDUAL * n * sizeof(float));
out:
    free(block);
    spin_refine_cloud_free(&cloud);
    return status;
}

/* Rows of a splat each, in the source's order. */
spin_status spin_run_write_residual(struct spin_run *r, struct spin_bundle_writer *w, int frame)
{
    size_t n = r->counts[frame];
    uint64_t shape[2] = {n, SPIN_RESIDUAL};
    char name[64];
    void *block = NULL;
    const float *from;
    float *rows;
    spin_status status;

    SPIN_TRY(spin_alloc(2 * SPIN_RESIDUAL * n + 1, sizeof(float), &block));
    from = block;
    rows = (float *)block + SPIN_RESIDUAL * n;
    r->device.op->download(&r->device, block, r->trainer.frame[frame].residual,
                           SPIN_RESIDUAL * n * sizeof(float));
    for (size_t k = 0, first = 0; k < SPIN_HEADS; first += width[k++])
        for (size_t i = 0; i < n; i++, from += width[k])
            memcpy(rows + (size_t)r->permutation[frame][i] * SPIN_RESIDUAL + first, from,
                   width[k] * sizeof(float));
    snprintf(name, sizeof name, "network/residual/%05d", frame);
    status = spin_npz_write(&w->zip, name, "<f4", 2, shape, rows);
    free(block);
    return status;
}
