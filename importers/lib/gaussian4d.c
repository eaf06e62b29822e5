/* Conversion of four-dimensional Gaussians to 4D splats. */
#include "importers/lib/gaussian4d.h"

spin_status spin_gaussian4d_reserve(struct spin_model *m, struct gaussian4d *g, size_t n,
                                    int sh_degree, unsigned parts)
{
    SPIN_TRY(spin_splats_4d_reserve(&m->splats_4d, n, 1, sh_degree, parts));
    return spin_model_alloc(m, n, sizeof *g->row, (void **)&g->row);
}

/* Whether the magnitudes of all values are below 1e18, so that the result remains finite when later
 * code squares them or moves positions. */
static bool all_sane(const double *values, int n)
{
    for (int i = 0; i < n; i++) {
        if (!(fabs(values[i]) < 1e18))
            return false;
    }
    return true;
}

float *spin_gaussian4d_add(struct spin_model *m, struct gaussian4d *g, size_t row,
                           const float mean[3], double time, double logit, const double velocity[3],
                           double variance, const double log_scale[3], const double quat[4])
{
    const double place[3] = {mean[0], mean[1], mean[2]};
    struct spin_splats_4d *s = &m->splats_4d;
    size_t i = g->n;

    if (!all_sane(place, 3) || !all_sane(&time, 1) || !all_sane(&logit, 1) ||
        !all_sane(velocity, 3) || !((float)sqrt(variance) > 0) || !all_sane(log_scale, 3) ||
        !all_sane(quat, 4)) {
        g->n_dropped++;
        return NULL;
    }
    s->times[i] = (float)time;
    s->sigmas[i] = (float)fmin(sqrt(variance), (double)SPIN_FOREVER);
    s->logit_opacities[i] = (float)logit;
    for (int c = 0; c < 3; c++) {
        s->centres[3 * i + (size_t)c] = mean[c];
        s->paths[3 * i + (size_t)c] = (float)velocity[c];
        s->log_scales[3 * i + (size_t)c] = (float)log_scale[c];
    }
    for (int c = 0; c < 4; c++)
        s->quats[4 * i + (size_t)c] = (float)quat[c];
    g->row[g->n++] = row;
    return s->sh + 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1)) * i;
}

float *spin_gaussian4d_add_slice(struct spin_model *m, struct gaussian4d *g, size_t row,
                                 const float mean[3], double time, double logit,
                                 const spin_slice *slice, double extra)
{
    double log_scale[3] = {NAN, NAN, NAN}, quat[4] = {NAN, NAN, NAN, NAN};

    spin_covariance_split(slice->cov6, log_scale, quat);
    return spin_gaussian4d_add(m, g, row, mean, time, logit, slice->velocity,
                               slice->variance_t + extra, log_scale, quat);
}

spin_status spin_gaussian4d_check(const struct gaussian4d *g, size_t n, size_t n_faint,
                                  const char *why, struct spin_sequence_info *sequence)
{
    if (g->n == 0)
        return spin_malformed("none of the %zu Gaussians has finite values", n);
    if (g->n_dropped > 0 && why)
        spin_note(sequence, "%s dropped because of %s",
                  spin_text_share(g->n_dropped, n, "Gaussian", "is", "are", (char[96]){0}), why);
    if (n_faint > 0.99 * (double)n)
        spin_note(sequence,
                  "nearly all opacities are below %g: the file was saved just after training had "
                  "reset opacities; positions are not affected",
                  SPIN_FAINT);
    return SPIN_OK;
}

/* Whether the floats `from` to `width` - 1 of every row are 0. */
static bool all_zero(const float *values, size_t n, size_t from, size_t width)
{
    for (size_t i = 0; i < n; i++)
        for (size_t c = from; c < width; c++)
            if (values[width * i + c] != 0)
                return false;
    return true;
}

void spin_gaussian4d_drop_zeros(struct spin_model *m)
{
    struct spin_splats_4d *s = &m->splats_4d;
    size_t width = 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));

    if (s->sh_cos && all_zero(s->sh_cos, s->n, 0, 2 * width)) {
        free(s->sh_cos);
        s->sh_cos = NULL;
    }
    while (!s->sh_cos && s->sh_degree > 0) {
        size_t less = 3 * (size_t)(s->sh_degree * s->sh_degree);

        if (!all_zero(s->sh, s->n, less, width))
            return;
        for (size_t i = 0; i < s->n; i++)
            memmove(s->sh + less * i, s->sh + width * i, less * sizeof *s->sh);
        s->sh_degree--;
        width = less;
    }
}

spin_status spin_gaussian4d_finish(struct spin_model *m, const struct gaussian4d *g, double ratio,
                                   const struct clip_times *times)
{
    struct spin_splats_4d *s = &m->splats_4d;

    s->n = g->n;
    for (size_t i = 0; ratio != 1 && i < s->n; i++) {
        s->times[i] = (float)(s->times[i] * ratio);
        s->sigmas[i] = s->sigmas[i] < SPIN_FOREVER ? (float)(s->sigmas[i] * ratio) : SPIN_FOREVER;
        for (size_t c = 0; c < 3; c++)
            s->paths[3 * i + c] = (float)(s->paths[3 * i + c] / ratio);
    }
    s->period = times->last - times->first;
    SPIN_TRY(spin_model_finish_4d(m));
    m->sequence->time_first = times->first;
    m->sequence->time_last = times->last;
    return SPIN_OK;
}
