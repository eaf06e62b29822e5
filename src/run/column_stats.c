/* Computes minimum, median and maximum of every attribute over the frames that are read. */
#include "run/column_stats.h"

#include <float.h>

#include "base/base.h"
#include "scene/columns.h"

/* The median of a series is computed from a sample of at most this many of its values. */
#define SAMPLE 65536

/* A series is a set of values of which minimum, median and maximum are reported. Positions have one
 * series per axis, since a single axis may be wrong; SH has one series for the view-independent
 * part and one for all other coefficients. Each splat contributes n values of its row in the
 * column, from value `first` on; if n is 0, all values from there on. */
static const struct {
    const char *name;
    unsigned column;
    size_t first, n;
} kinds[] = {
    {"means.x", SPIN_COL_MEANS, 0, 1},
    {"means.y", SPIN_COL_MEANS, 1, 1},
    {"means.z", SPIN_COL_MEANS, 2, 1},
    {"quats", SPIN_COL_QUATS, 0, 4},
    {"log_scales", SPIN_COL_LOG_SCALES, 0, 3},
    {"logit_opacities", SPIN_COL_LOGIT_OPACITIES, 0, 1},
    {"sh.dc", SPIN_COL_SH, 0, 3},
    {"sh.rest", SPIN_COL_SH, 3, 0},
    {"rgb", SPIN_COL_RGB, 0, 3},
};
enum { N_KINDS = sizeof kinds / sizeof *kinds };

struct spin_series {
    float min, max;
    uint64_t n, n_not_finite;
    float *sample; /* [SAMPLE] */
    size_t n_sample;
};

spin_status spin_column_stats_open(struct spin_column_stats *d, int n_frames)
{
    d->n_frames = n_frames > 0 ? n_frames : 1;
    SPIN_TRY(spin_alloc(N_KINDS, sizeof *d->series, (void **)&d->series));
    for (int k = 0; k < N_KINDS; k++) {
        SPIN_TRY(spin_alloc(SAMPLE, sizeof(float), (void **)&d->series[k].sample));
        d->series[k].min = FLT_MAX;
        d->series[k].max = -FLT_MAX;
    }
    return SPIN_OK;
}

void spin_column_stats_close(struct spin_column_stats *d)
{
    for (int k = 0; d->series && k < N_KINDS; k++)
        free(d->series[k].sample);
    free(d->series);
    memset(d, 0, sizeof *d);
}

static void add_row(struct spin_series *series, const float *row, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        if (!isfinite(row[i])) {
            series->n_not_finite++;
            continue;
        }
        series->min = row[i] < series->min ? row[i] : series->min;
        series->max = row[i] > series->max ? row[i] : series->max;
    }
    series->n += n;
}

/* Adds at most `quota` values of a frame to the sample, evenly spaced. */
static void sample_frame(struct spin_series *series, size_t quota, const float *values,
                         size_t n_rows, size_t width, size_t first, size_t n)
{
    size_t total = n_rows * n, step = total > quota ? (total + quota - 1) / quota : 1;

    /* A step that has no factor in common with n samples all n values of a row alike; the factors
     * of n are 2, 3 and 5. */
    while (step > 1 && (step % 2 == 0 || step % 3 == 0 || step % 5 == 0))
        step++;
    for (size_t i = 0; i < total && series->n_sample < SAMPLE; i += step) {
        float value = values[i / n * width + first + i % n];

        if (isfinite(value))
            series->sample[series->n_sample++] = value;
    }
}

void spin_column_stats_frame(struct spin_column_stats *d, unsigned columns,
                             const struct spin_splats *s)
{
    size_t quota = SAMPLE / (size_t)d->n_frames;
    struct spin_splats splats = *s;

    for (int k = 0; k < N_KINDS; k++) {
        size_t width = spin_column_width(kinds[k].column, s->sh_degree), n;
        const float *values = *spin_column_of(&splats, kinds[k].column);

        n = kinds[k].n ? kinds[k].n : width - kinds[k].first;
        if (!(columns & kinds[k].column) || !values || n == 0)
            continue;
        for (size_t i = 0; i < s->n; i++)
            add_row(&d->series[k], values + i * width + kinds[k].first, n);
        sample_frame(&d->series[k], quota ? quota : 1, values, s->n, width, kinds[k].first, n);
    }
}

/* These functions convert stored values, which are logarithms and logits, to scales and opacities.
 */
static double exponential(double x) { return exp(x); }
static double sigmoid(double x) { return 1 / (1 + exp(-x)); }

static spin_json *convert_three(double (*function)(double), const double v[3])
{
    return spin_json_numbers((double[]){function(v[0]), function(v[1]), function(v[2])}, 3);
}

void spin_column_stats_ranges(struct spin_column_stats *d, spin_json *report)
{
    spin_json *ranges = spin_json_object();
    bool finite = true;

    for (int k = 0; k < N_KINDS; k++) {
        struct spin_series *series = &d->series[k];
        double value[3] = {NAN, NAN, NAN}; /* minimum, median, maximum */
        spin_json *range;

        if (series->n == 0)
            continue;
        finite = finite && series->n_not_finite == 0;
        qsort(series->sample, series->n_sample, sizeof(float), spin_by_float);
        if (series->n_sample > 0) {
            value[0] = (double)series->min;
            value[1] = (double)series->sample[series->n_sample / 2];
            value[2] = (double)series->max;
        }
        range = json_pack("{s:o, s:o, s:o, s:f}", "min", spin_json_number_value(value[0]), "median",
                          spin_json_number_value(value[1]), "max", spin_json_number_value(value[2]),
                          "not_finite", (double)series->n_not_finite / (double)series->n);
        if (kinds[k].column == SPIN_COL_LOG_SCALES)
            spin_json_set(range, "scales", convert_three(exponential, value));
        if (kinds[k].column == SPIN_COL_LOGIT_OPACITIES)
            spin_json_set(range, "opacities", convert_three(sigmoid, value));
        spin_json_set(ranges, kinds[k].name, range);
    }
    spin_json_set(report, "ranges", ranges);
    spin_json_set_bool(report, "finite", finite);
}
