/* 4-D Gaussians sliced at a time. */
#include "importers/lib/gaussian4d.h"

#include "math/quat.h"

spin_status spin_gaussian4d_reserve(struct spin_model *m, struct gaussian4d *s, size_t n)
{
    SPIN_TRY(spin_model_alloc(m, n, 3 * sizeof *s->mean, (void **)&s->mean));
    SPIN_TRY(spin_model_alloc(m, n, sizeof *s->time, (void **)&s->time));
    SPIN_TRY(spin_model_alloc(m, n, 3 * sizeof *s->velocity, (void **)&s->velocity));
    SPIN_TRY(spin_model_alloc(m, n, sizeof *s->variance, (void **)&s->variance));
    SPIN_TRY(spin_model_alloc(m, n, 3 * sizeof *s->log_scales, (void **)&s->log_scales));
    SPIN_TRY(spin_model_alloc(m, n, 4 * sizeof *s->quats, (void **)&s->quats));
    SPIN_TRY(spin_model_alloc(m, n, sizeof *s->opacity, (void **)&s->opacity));
    SPIN_TRY(spin_model_alloc(m, n, sizeof *s->row, (void **)&s->row));
    return spin_model_alloc(m, n, sizeof *s->kept, (void **)&s->kept);
}

/* Far below the largest float: places move, and others square them. */
static bool all_sane(const double *values, int n)
{
    for (int i = 0; i < n; i++) {
        if (!(fabs(values[i]) < 1e18))
            return false;
    }
    return true;
}

void spin_gaussian4d_add(struct gaussian4d *s, size_t row, const float mean[3], double time,
                         double opacity, const double velocity[3], double variance,
                         const double log_scale[3], const double quat[4])
{
    const double place[3] = {mean[0], mean[1], mean[2]};
    size_t i = s->n;

    if (!all_sane(place, 3) || !isfinite(time) || !isfinite(opacity) || !all_sane(velocity, 3) ||
        !(variance > 0) || !isfinite(variance) || !all_sane(log_scale, 3) || !all_sane(quat, 4)) {
        s->n_dropped++;
        return;
    }
    s->time[i] = time;
    s->variance[i] = variance;
    s->opacity[i] = (float)opacity;
    s->row[i] = row;
    for (int c = 0; c < 3; c++) {
        s->mean[3 * i + (size_t)c] = mean[c];
        s->velocity[3 * i + (size_t)c] = velocity[c];
        s->log_scales[3 * i + (size_t)c] = (float)log_scale[c];
    }
    for (int c = 0; c < 4; c++)
        s->quats[4 * i + (size_t)c] = (float)quat[c];
    s->n++;
}

void spin_gaussian4d_add_slice(struct gaussian4d *s, size_t row, const float mean[3], double time,
                               double opacity, const spin_slice *slice, double extra)
{
    double log_scale[3] = {NAN, NAN, NAN}, quat[4] = {NAN, NAN, NAN, NAN};

    spin_covariance_split(slice->cov6, log_scale, quat);
    spin_gaussian4d_add(s, row, mean, time, opacity, slice->velocity, slice->variance_t + extra,
                        log_scale, quat);
}

spin_status spin_gaussian4d_check(const struct gaussian4d *s, size_t n, size_t n_faint,
                                  const char *why, struct spin_sequence_info *sequence)
{
    if (s->n == 0)
        return spin_fail(SPIN_E_MALFORMED, "none of the %zu Gaussians has finite values", n);
    if (s->n_dropped > 0 && why)
        spin_note(sequence, "%zu of %zu Gaussians are dropped: %s", s->n_dropped, n, why);
    if (n_faint > 0.99 * (double)n)
        spin_note(sequence,
                  "nearly all opacities are below %g: training saved this just after it had reset "
                  "them; positions are fine",
                  SPIN_FAINT);
    return SPIN_OK;
}

double spin_sigmoid_of(double logit) { return 1 / (1 + exp(-logit)); }

double spin_gaussian4d_weight(const struct gaussian4d *s, size_t i, double time)
{
    return spin_time_weight(time - s->time[i], s->variance[i]);
}

/* Chooses those seen at `time`. */
static void choose(struct gaussian4d *s, double time)
{
    s->n_kept = 0;
    for (size_t i = 0; i < s->n; i++) {
        double weight = spin_gaussian4d_weight(s, i, time);

        if (weight > s->least_weight && weight * s->opacity[i] >= s->least_opacity)
            s->kept[s->n_kept++] = i;
    }
}

float spin_logit_of(double opacity)
{
    double o = opacity < 1e-6 ? 1e-6 : opacity > 1 - 1e-6 ? 1 - 1e-6 : opacity;

    return (float)log(o / (1 - o));
}

/* Everything but colours of those chosen. */
static void fill(const struct gaussian4d *s, double time, unsigned columns, struct spin_splats *out)
{
    for (size_t k = 0; k < s->n_kept; k++) {
        size_t i = s->kept[k];

        for (size_t c = 0; c < 3 && (columns & SPIN_COL_MEANS); c++)
            out->means[3 * k + c] =
                (float)(s->mean[3 * i + c] + s->velocity[3 * i + c] * (time - s->time[i]));
        for (size_t c = 0; c < 3 && (columns & SPIN_COL_LOG_SCALES); c++)
            out->log_scales[3 * k + c] = s->log_scales[3 * i + c];
        for (size_t c = 0; c < 4 && (columns & SPIN_COL_QUATS); c++)
            out->quats[4 * k + c] = s->quats[4 * i + c];
        if (columns & SPIN_COL_LOGIT_OPACITIES)
            out->logit_opacities[k] =
                spin_logit_of(spin_gaussian4d_weight(s, i, time) * s->opacity[i]);
    }
}

void spin_gaussian4d_describe(const struct spin_model *m, const struct gaussian4d *s,
                              const struct clip_times *times)
{
    spin_model_describe(m, NULL, s->sh_degree, ~0u);
    m->sequence->identity = false;
    m->sequence->time_first = times->first;
    m->sequence->time_last = times->last;
}

spin_status spin_gaussian4d_frame(const struct spin_model *m, struct gaussian4d *s, int frame,
                                  double time, unsigned columns, gaussian4d_sh_fn sh,
                                  struct spin_splats *out)
{
    size_t width = 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));

    if (frame < 0)
        return spin_fail(SPIN_E_NOT_FOUND, "'%s' has no frame %d", m->path, frame);
    columns &= SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    choose(s, time);
    SPIN_TRY(spin_splats_reserve(out, s->n_kept, columns, s->sh_degree));
    fill(s, time, columns, out);
    for (size_t k = 0; sh && k < s->n_kept && (columns & SPIN_COL_SH); k++)
        sh(m, s->kept[k], time - s->time[s->kept[k]], out->sh + width * k);
    return SPIN_OK;
}
