#include "train/average.h"

#include "base/base.h"
#include "train/state_arrays.h"

enum {
    MOMENTS = 12,     /* largest number of averaged iterations */
    PORTION = 1 << 20 /* floats downloaded at a time */
};

struct spin_average spin_average_of(double share, int64_t until, int64_t iterations)
{
    int64_t first = iterations - (int64_t)(share * (double)iterations);

    first = first > until ? first : until;
    first = first < iterations ? first : iterations - 1;
    return (struct spin_average){.first = first,
                                 .every = (iterations - first + MOMENTS - 1) / MOMENTS};
}

/* Returns how many of the iterations up to `iteration` are averaged. These are counted backwards
 * from the last iteration of the training, which is always averaged. */
static int count_by(const struct spin_average *a, int64_t iterations, int64_t iteration)
{
    int64_t left = iterations - iteration;

    if (a->every == 0 || iteration <= a->first)
        return 0;
    return (int)((iterations - a->first - 1) / a->every + 1 - (left + a->every - 1) / a->every);
}

spin_status spin_average_values(struct spin_trainer *t, size_t *n)
{
    SPIN_FREED struct spin_state_array *array = NULL;
    size_t n_arrays;

    *n = 0;
    SPIN_TRY(spin_state_arrays(t, NULL, &array, &n_arrays));
    for (size_t i = 0; i < n_arrays; i++)
        if (spin_state_is_parameter(&array[i]))
            *n += array[i].n;
    return SPIN_OK;
}

static spin_status reserve_mean(struct spin_trainer *t)
{
    struct spin_average *a = &t->average;

    SPIN_TRY(spin_average_values(t, &a->n_values));
    return spin_grow(a->n_values + 1, sizeof *a->mean, (void **)&a->mean);
}

spin_status spin_average_resume(struct spin_trainer *t)
{
    t->average.n = count_by(&t->average, t->rates.iterations, t->iteration);
    return t->average.n > 0 ? reserve_mean(t) : SPIN_OK;
}

/* Adds sample n to the mean of the first n - 1 samples. */
static void add_sample(float *mean, const float *values, size_t n_values, int n)
{
    float share = 1 / (float)n;

    for (size_t i = 0; i < n_values; i++)
        mean[i] = n == 1 ? values[i] : mean[i] + share * (values[i] - mean[i]);
}

spin_status spin_average_step(struct spin_trainer *t)
{
    struct spin_average *a = &t->average;
    struct spin_device *d = t->device;
    SPIN_FREED struct spin_state_array *array = NULL;
    SPIN_FREED float *portion = NULL;
    size_t n_arrays;
    float *mean;

    if (count_by(a, t->rates.iterations, t->iteration) == a->n)
        return SPIN_OK;
    SPIN_TRY(a->n == 0 ? reserve_mean(t) : SPIN_OK);
    SPIN_TRY(spin_alloc(PORTION, sizeof *portion, (void **)&portion));
    SPIN_TRY(spin_state_arrays(t, NULL, &array, &n_arrays));
    a->n++;
    mean = a->mean;
    for (size_t i = 0; i < n_arrays; i++)
        for (size_t first = 0; spin_state_is_parameter(&array[i]) && first < array[i].n;
             first += PORTION) {
            size_t n = array[i].n - first < PORTION ? array[i].n - first : PORTION;

            SPIN_TRY(d->op->download(d, portion, array[i].at + first, n * sizeof *portion));
            add_sample(mean, portion, n, a->n);
            if (t->iteration == t->rates.iterations)
                d->op->upload(d, array[i].at + first, mean, n * sizeof *mean);
            mean += n;
        }
    return SPIN_OK;
}
