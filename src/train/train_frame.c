/* Manages the memory of a frame's parameters, transfers them to and from the host, and prepares
 * their Adam steps. */
#include "train/train_frame.h"

#include "base/base.h"
#include "geometry/neighbours.h"
#include "math/activate.h"
#include "math/sh.h"
#include "model/field.h"
#include "scene/bundle.h"

/* An array of a frame: where its pointer is stored, and its size. */
struct part {
    float SPIN_DEV **at;
    size_t floats;
};
enum { PARTS = 11, ALIGNMENT = 64 };

static size_t part_bytes(const struct part *part)
{
    return (part->floats * sizeof(float) + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT;
}

/* Lists the arrays that all iterations use. track and turn are absent without tracks; turn is also
 * absent if no splat with a track owns both a position and residual values. */
static void list_parts(struct spin_train_frame *f, bool tracked, struct part part[PARTS])
{
    const struct spin_frame_size *n = &f->size;
    bool turns = tracked && n->n_pos != n->n_free && n->n_pos <= n->n_residual;
    const struct part all[PARTS] = {
        {&f->pos, 3 * n->n_pos},
        {&f->m, 3 * n->n_pos},
        {&f->v, 3 * n->n_pos},
        {&f->residual, SPIN_RESIDUAL * n->n_residual},
        {&f->residual_m, SPIN_RESIDUAL * n->n_residual},
        {&f->residual_v, SPIN_RESIDUAL * n->n_residual},
        {&f->sh, f->sh_width * n->n},
        {&f->sh_m, f->sh_width * n->n},
        {&f->sh_v, f->sh_width * n->n},
        {(float SPIN_DEV **)&f->track, tracked ? n->n : 0},
        {&f->turn, turns ? 4 * n->n_pos : 0},
    };

    memcpy(part, all, sizeof all);
}

static size_t parts_bytes(const struct part *part, size_t n)
{
    size_t bytes = 0;

    for (size_t i = 0; i < n; i++)
        bytes += part_bytes(&part[i]);
    return bytes;
}

/* Allocates one block for n arrays, and sets their pointers; an empty array stays NULL. */
static spin_status reserve_parts(struct spin_device *d, const char *folder, const struct part *part,
                                 size_t n, void SPIN_DEV **block)
{
    size_t bytes = parts_bytes(part, n);

    if (bytes == 0)
        return SPIN_OK;
    SPIN_TRY(folder ? spin_pages_reserve_in(folder, bytes, (void **)block)
                    : d->op->reserve(d, bytes, block));
    bytes = 0;
    for (size_t i = 0; i < n; i++) {
        if (part[i].floats > 0)
            *part[i].at = (float SPIN_DEV *)(void SPIN_DEV *)((char SPIN_DEV *)*block + bytes);
        bytes += part_bytes(&part[i]);
    }
    return SPIN_OK;
}

static spin_status set_identity_turns(struct spin_train_frame *f, struct spin_device *d)
{
    size_t n = f->turn ? f->size.n_pos : 0;
    SPIN_FREED float *identity = NULL;

    SPIN_TRY(spin_alloc(4 * n + 1, sizeof *identity, (void **)&identity));
    for (size_t i = 0; i < n; i++)
        identity[4 * i] = 1;
    if (n > 0)
        d->op->upload(d, f->turn, identity, 4 * n * sizeof *identity);
    return SPIN_OK;
}

size_t spin_train_frame_bytes(struct spin_frame_size size, size_t sh_width, bool tracked,
                              size_t *statistics)
{
    struct spin_train_frame f = {.size = size, .sh_width = sh_width};
    const struct part part = {&f.gradient, tracked ? size.n : 0};
    struct part parts[PARTS];

    list_parts(&f, tracked, parts);
    *statistics = 2 * part_bytes(&part);
    return parts_bytes(parts, PARTS) + *statistics;
}

spin_status spin_train_frame_open(struct spin_train_frame *f, struct spin_device *d,
                                  const char *folder, struct spin_frame_size size, size_t sh_width,
                                  bool tracked)
{
    struct part part[PARTS];

    memset(f, 0, sizeof *f);
    f->size = size;
    f->sh_width = sh_width;
    f->checked = -1;
    list_parts(f, tracked, part);
    SPIN_TRY(reserve_parts(d, folder, part, PARTS, &f->block));
    if (tracked) {
        const struct part statistics[] = {{&f->gradient, size.n},
                                          {(float SPIN_DEV **)&f->seen, size.n}};

        SPIN_TRY(reserve_parts(d, folder, statistics, 2, &f->statistics));
    }
    return set_identity_turns(f, d);
}

void spin_train_frame_read_ahead(const struct spin_train_frame *f)
{
    spin_pages_read_ahead((void *)f->block);
    spin_pages_read_ahead((void *)f->statistics);
}

void spin_train_frame_drop_statistics(struct spin_train_frame *f, struct spin_device *d)
{
    d->op->release(d, f->statistics);
    f->statistics = NULL;
    f->gradient = NULL;
    f->seen = NULL;
}

void spin_train_frame_close(struct spin_train_frame *f, struct spin_device *d)
{
    spin_train_frame_drop_statistics(f, d);
    d->op->release(d, f->block);
    memset(f, 0, sizeof *f);
}

struct arrays {
    float SPIN_DEV *pos, *residual, *sh;
};

static struct arrays arrays_of(const struct spin_train_frame *f, enum spin_train_array which)
{
    return which == SPIN_TRAIN_VALUES     ? (struct arrays){f->pos, f->residual, f->sh}
           : which == SPIN_TRAIN_MOMENT_1 ? (struct arrays){f->m, f->residual_m, f->sh_m}
                                          : (struct arrays){f->v, f->residual_v, f->sh_v};
}

static spin_status reserve_host(const struct spin_train_frame *f, float **host)
{
    size_t width = f->sh_width > SPIN_RESIDUAL ? f->sh_width : SPIN_RESIDUAL;

    return spin_alloc(width * f->size.n + 1, sizeof **host, (void **)host);
}

static void upload_rows(struct spin_device *d, struct spin_rows rows, size_t n, size_t width,
                        const uint32_t *row_of, float *host, float SPIN_DEV *to)
{
    for (size_t i = 0; rows.at && i < n; i++)
        memcpy(host + width * i, rows.at + (row_of ? row_of[i] : i) * rows.stride,
               width * sizeof *host);
    if (rows.at)
        d->op->upload(d, to, host, width * n * sizeof *host);
}

spin_status spin_train_frame_upload(struct spin_train_frame *frame, struct spin_device *d,
                                    enum spin_train_array which, struct spin_frame_rows rows,
                                    const uint32_t *row_of)
{
    size_t n = frame->size.n_residual;
    struct arrays to = arrays_of(frame, which);
    SPIN_FREED float *host = NULL;

    SPIN_TRY(reserve_host(frame, &host));
    upload_rows(d, rows.pos, frame->size.n_pos, 3, row_of, host, to.pos);
    if (rows.residual.at) {
        spin_residual_from_rows(n, rows.residual.at, rows.residual.stride, row_of, host);
        d->op->upload(d, to.residual, host, SPIN_RESIDUAL * n * sizeof *host);
    }
    if (frame->sh)
        upload_rows(d, rows.sh, frame->size.n, frame->sh_width, row_of, host, to.sh);
    return SPIN_OK;
}

static spin_status download_rows(struct spin_device *d, const float SPIN_DEV *from, size_t n,
                                 size_t width, const uint32_t *row_of, float *host,
                                 struct spin_rows rows)
{
    if (!rows.at || n == 0)
        return SPIN_OK;
    SPIN_TRY(d->op->download(d, host, from, width * n * sizeof *host));
    for (size_t i = 0; i < n; i++)
        memcpy(rows.at + (row_of ? row_of[i] : i) * rows.stride, host + width * i,
               width * sizeof *host);
    return SPIN_OK;
}

spin_status spin_train_frame_download(const struct spin_train_frame *frame, struct spin_device *d,
                                      enum spin_train_array which, struct spin_frame_rows rows,
                                      const uint32_t *row_of)
{
    size_t n = frame->size.n_residual;
    struct arrays from = arrays_of(frame, which);
    SPIN_FREED float *host = NULL;

    SPIN_TRY(reserve_host(frame, &host));
    SPIN_TRY(download_rows(d, from.pos, frame->size.n_pos, 3, row_of, host, rows.pos));
    if (rows.residual.at && n > 0) {
        SPIN_TRY(d->op->download(d, host, from.residual, SPIN_RESIDUAL * n * sizeof *host));
        spin_residual_to_rows(n, host, row_of, rows.residual.at, rows.residual.stride);
    }
    if (frame->sh)
        return download_rows(d, from.sh, frame->size.n, frame->sh_width, row_of, host, rows.sh);
    return SPIN_OK;
}

/* Divides `all`, the values of n splats with `width` values each, into up to two groups, and
 * returns the number of groups. The learning rate is all.lr for the first n_free splats, and
 * `tracked` times all.lr for the other splats, which have a track. */
static int split_group(struct spin_param_group all, size_t width, size_t n, size_t n_free,
                       double tracked, struct spin_param_group *group)
{
    int n_groups = 0;

    for (int part = 0; part < 2; part++) {
        size_t first = part == 0 ? 0 : n_free, end = part == 0 ? n_free : n;
        double lr = part == 0 ? all.lr : tracked * all.lr;

        if (end == first)
            continue;
        group[n_groups] = all;
        group[n_groups].p += width * first;
        group[n_groups].g += width * first;
        group[n_groups].m += width * first;
        group[n_groups].v += width * first;
        group[n_groups].n = width * (end - first);
        group[n_groups++].lr = lr;
    }
    return n_groups;
}

int spin_train_frame_step(struct spin_train_frame *frame, const struct spin_frame_rates *rates,
                          const struct spin_frame_of_batch *of,
                          struct spin_param_group group[SPIN_TRAIN_FRAME_GROUPS])
{
    const struct spin_frame_size *size = &frame->size;
    int n_groups = 0;

    frame->steps++;
    for (size_t k = 0, sum = 0; of->d_residual && k < SPIN_HEADS; sum += spin_residual_width[k++]) {
        size_t at = sum * size->n_residual;
        struct spin_param_group all = {.p = frame->residual + at,
                                       .g = of->d_residual + sum * size->n,
                                       .m = frame->residual_m + at,
                                       .v = frame->residual_v + at,
                                       .lr = rates->residual[k],
                                       .step = frame->steps};

        n_groups += split_group(all, spin_residual_width[k], size->n_residual, size->n_free,
                                rates->tracked, group + n_groups);
    }
    if (of->d_sh)
        group[n_groups++] = (struct spin_param_group){.p = frame->sh,
                                                      .g = of->d_sh,
                                                      .m = frame->sh_m,
                                                      .v = frame->sh_v,
                                                      .n = frame->sh_width * size->n,
                                                      .lr = rates->sh,
                                                      .step = frame->steps};
    if (rates->pos > 0) {
        struct spin_param_group all = {.p = frame->pos,
                                       .g = of->d_means,
                                       .m = frame->m,
                                       .v = frame->v,
                                       .lr = rates->pos,
                                       .step = frame->steps};

        n_groups +=
            split_group(all, 3, size->n_pos, size->n_free, rates->tracked, group + n_groups);
    }
    return n_groups;
}

/* ---- Points of a frame in host memory -------------------------------------------------------- */

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

/* Returns the rows of the points' values, or of one of their moments. */
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
        return spin_misuse("cannot start from the source's attributes: one of the columns means, "
                           "quats, log_scales, logit_opacities and sh is missing");
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

/* ---- Sample of the points of a clip ---------------------------------------------------------- */

/* Largest numbers of points sampled in a frame, and in a clip. */
enum { SAMPLE = 20000, SAMPLE_OF_CLIP = 200 * SAMPLE };

spin_status spin_point_sample_open(struct spin_point_sample *sample, int n_frames)
{
    size_t most = n_frames > 0 ? SAMPLE_OF_CLIP / (size_t)n_frames : SAMPLE;

    sample->most = most > SAMPLE ? SAMPLE : most > 0 ? most : 1;
    SPIN_TRY(
        spin_alloc(sample->most * (size_t)n_frames * 4, sizeof(float), (void **)&sample->point));
    sample->n = 0;
    return SPIN_OK;
}

void spin_point_sample_close(struct spin_point_sample *sample) { free(sample->point); }

void spin_point_sample_add(struct spin_point_sample *sample, const struct spin_splats *s)
{
    size_t step = s->n / sample->most + 1;

    for (size_t i = 0; i < s->n; i += step)
        memcpy(sample->point + 3 * sample->n++, s->means + 3 * i, 3 * sizeof(float));
}

double spin_point_square_to(const float *point, const float centre[3])
{
    double d2 = 0;

    for (int c = 0; c < 3; c++)
        d2 += pow((double)(point[c] - centre[c]), 2);
    return d2;
}

float spin_point_sample_enclose(struct spin_point_sample *sample, float centre[3])
{
    size_t n = sample->n;
    float *value = sample->point + 3 * n;

    for (int c = 0; c < 3; c++) {
        for (size_t i = 0; i < n; i++)
            value[i] = sample->point[3 * i + (size_t)c];
        qsort(value, n, sizeof *value, spin_by_float);
        centre[c] = value[n / 2];
    }
    for (size_t i = 0; i < n; i++)
        value[i] = (float)sqrt(spin_point_square_to(sample->point + 3 * i, centre));
    qsort(value, n, sizeof *value, spin_by_float);
    return value[(size_t)(0.9 * (double)(n - 1))];
}
