/* Computes the initial values of the points of a frame, from coloured points as in 3DGS or from
 * splats, and transfers points to and from the device. */
#include "train/cloud.h"

#include "base/base.h"
#include "math/activate.h"
#include "math/sh.h"
#include "scene/bundle.h"
#include "geometry/knn.h"

static const float start_logit = -2.1972246f; /* opacity 0.1 */

_Static_assert(sizeof(struct spin_refine_row) == SPIN_REFINE_WIDTH * sizeof(float),
               "a row is nothing but its floats");

spin_status spin_refine_cloud_reserve(struct spin_refine_cloud *cloud, size_t n)
{
    size_t capacity = n + n / 2;

    if (n > INT32_MAX) /* the rasteriser uses 32-bit indices */
        return spin_fail(SPIN_E_MEMORY, "a frame with %zu points exceeds the limit of %d points", n,
                         INT32_MAX);
    if (n <= cloud->capacity)
        return SPIN_OK;
    SPIN_TRY(spin_grow(capacity, sizeof *cloud->point, (void **)&cloud->point));
    if (cloud->sh) {
        SPIN_TRY(spin_grow(capacity, 3 * SPIN_REFINE_SH * sizeof(float), (void **)&cloud->sh));
    }
    cloud->capacity = capacity;
    return SPIN_OK;
}

void spin_refine_cloud_free(struct spin_refine_cloud *cloud)
{
    free(cloud->point);
    free(cloud->sh);
    memset(cloud, 0, sizeof *cloud);
}

/* Describes the rows of the points' values, or of one of their moments. */
static struct spin_frame_rows rows_of(const struct spin_refine_cloud *cloud,
                                      enum spin_train_array which)
{
    struct spin_refine_point *first = cloud->point;
    struct spin_refine_row *row = which == SPIN_TRAIN_VALUES     ? &first->p
                                  : which == SPIN_TRAIN_MOMENT_1 ? &first->m
                                                                 : &first->v;
    size_t stride = sizeof *first / sizeof(float);

    return (struct spin_frame_rows){
        .pos = {row->pos_w, stride},
        .residual = {row->log_scale, stride},
        .sh = {cloud->sh ? cloud->sh + SPIN_REFINE_SH * which : NULL, 3 * SPIN_REFINE_SH}};
}

spin_status spin_refine_cloud_send(const struct spin_refine_cloud *cloud, struct spin_device *d,
                                   struct spin_train_frame *frame)
{
    for (int which = SPIN_TRAIN_VALUES; cloud->n > 0 && which <= SPIN_TRAIN_MOMENT_2; which++)
        SPIN_TRY(spin_train_frame_upload(frame, d, which, rows_of(cloud, which), NULL));
    return SPIN_OK;
}

spin_status spin_refine_cloud_fetch(struct spin_refine_cloud *cloud, struct spin_device *d,
                                    const struct spin_train_frame *frame)
{
    if (cloud->sh)
        memset(cloud->sh, 0, 3 * SPIN_REFINE_SH * cloud->n * sizeof *cloud->sh);
    for (int which = SPIN_TRAIN_VALUES; cloud->n > 0 && which <= SPIN_TRAIN_MOMENT_2; which++)
        SPIN_TRY(spin_train_frame_download(frame, d, which, rows_of(cloud, which), NULL));
    return SPIN_OK;
}

static spin_status reset_cloud(struct spin_refine_cloud *out, size_t n)
{
    SPIN_TRY(spin_refine_cloud_reserve(out, n));
    if (n > 0)
        memset(out->point, 0, n * sizeof *out->point);
    out->n = n;
    return SPIN_OK;
}

static void start_point(struct spin_refine_row *p, const float *pos_w, const float *rgb,
                        double dist2)
{
    float log_scale = (float)(0.5 * log(dist2 > 1e-7 ? dist2 : 1e-7));

    for (int c = 0; c < 3; c++) {
        p->pos_w[c] = pos_w[c];
        p->dc[c] = rgb ? (float)((rgb[c] - 0.5) / SPIN_SH_C0) : 0;
        p->log_scale[c] = log_scale;
    }
    p->rotation[0] = 1;
    p->logit_opacity = start_logit;
}

spin_status spin_refine_init_from_points(struct spin_pool *pool, size_t n, const float *pos_w,
                                         const float *rgb, struct spin_refine_cloud *out)
{
    SPIN_FREED float *dist2 = NULL;

    for (size_t i = 0; i < n * 3; i++)
        if (!isfinite(pos_w[i]))
            return spin_malformed("point %zu has a coordinate that is not finite", i / 3);
    SPIN_TRY(reset_cloud(out, n));
    SPIN_TRY(spin_alloc(n + 1, sizeof *dist2, (void **)&dist2));
    SPIN_TRY(spin_knn_mean_dist2(pool, n, pos_w, dist2));
    for (size_t i = 0; i < n; i++)
        start_point(&out->point[i].p, pos_w + 3 * i, rgb ? rgb + 3 * i : NULL, dist2[i]);
    return SPIN_OK;
}

spin_status spin_refine_init_from_colours(const struct spin_splats *s,
                                          struct spin_refine_cloud *out)
{
    size_t width = spin_column_width(SPIN_COL_SH, s->sh_degree);
    SPIN_FREED float *rgb = NULL;

    if (s->rgb || !s->sh)
        return spin_refine_init_from_points(NULL, s->n, s->means, s->rgb, out);
    SPIN_TRY(spin_alloc(3 * s->n + 1, sizeof(float), (void **)&rgb));
    for (size_t i = 0; i < 3 * s->n; i++)
        rgb[i] = (float)(SPIN_SH_C0 * (double)s->sh[i / 3 * width + i % 3] + 0.5);
    return spin_refine_init_from_points(NULL, s->n, s->means, rgb, out);
}

spin_status spin_refine_init_from_splats(const struct spin_splats *s, struct spin_refine_cloud *out)
{
    size_t sh_row = 3 * (size_t)(s->sh_degree + 1) * (size_t)(s->sh_degree + 1);

    if (s->n > 0 && !(s->means && s->quats && s->log_scales && s->logit_opacities && s->sh))
        return spin_misuse("refinement from the source's attributes needs all of these columns: "
                           "means, quats, log_scales, logit_opacities, sh");
    SPIN_TRY(reset_cloud(out, s->n));
    for (size_t i = 0; i < s->n; i++) {
        struct spin_refine_row *p = &out->point[i].p;

        memcpy(p->pos_w, s->means + 3 * i, sizeof p->pos_w);
        memcpy(p->dc, s->sh + sh_row * i, sizeof p->dc);
        memcpy(p->log_scale, s->log_scales + 3 * i, sizeof p->log_scale);
        memcpy(p->rotation, s->quats + 4 * i, sizeof p->rotation);
        p->logit_opacity = s->logit_opacities[i];
    }
    return SPIN_OK;
}

spin_status spin_refine_add_sh(int sh_degree, const struct spin_splats *s,
                               struct spin_refine_cloud *cloud)
{
    size_t width = spin_column_width(SPIN_COL_SH, sh_degree);
    size_t from = s ? spin_column_width(SPIN_COL_SH, s->sh_degree) : 3;
    size_t kept = (from < width ? from : width) - 3;

    SPIN_TRY(
        spin_alloc(cloud->capacity + 1, 3 * SPIN_REFINE_SH * sizeof(float), (void **)&cloud->sh));
    cloud->sh_degree = sh_degree;
    for (size_t i = 0; i < cloud->n && kept > 0; i++)
        memcpy(cloud->sh + 3 * SPIN_REFINE_SH * i, s->sh + from * i + 3, kept * sizeof(float));
    return SPIN_OK;
}

spin_status spin_refine_to_splats(const struct spin_refine_cloud *cloud, struct spin_splats *out)
{
    size_t width = spin_column_width(SPIN_COL_SH, cloud->sh_degree);

    SPIN_TRY(
        spin_splats_reserve(out, cloud->n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, cloud->sh_degree));
    for (size_t i = 0; i < cloud->n; i++) {
        const struct spin_refine_row *p = &cloud->point[i].p;

        memcpy(out->means + 3 * i, p->pos_w, sizeof p->pos_w);
        memcpy(out->sh + width * i, p->dc, sizeof p->dc);
        if (cloud->sh)
            memcpy(out->sh + width * i + 3, cloud->sh + 3 * SPIN_REFINE_SH * i,
                   (width - 3) * sizeof(float));
        memcpy(out->log_scales + 3 * i, p->log_scale, sizeof p->log_scale);
        out->logit_opacities[i] = p->logit_opacity;
        spin_rotation_of(p->rotation, out->quats + 4 * i);
    }
    return SPIN_OK;
}
