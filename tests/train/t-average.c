/* The Polyak average covers the right iterations, and the last step makes it the parameters.
 * K: retrain */
#include "tests/train/tracked.h"

#include "train/checkpoint.h"

/* The averaged iterations, and the mean of their numbers. */
static int counts(double share, int64_t until, int64_t iterations, int64_t *first, double *mean)
{
    struct spin_trainer t = {.average = spin_average_of(share, until, iterations)};
    int n = 0;

    *mean = 0;
    *first = 0;
    t.rates.iterations = iterations;
    for (int64_t i = 1; i <= iterations; i++) {
        int before = t.average.n;

        t.iteration = i;
        if (spin_average_resume(&t) != SPIN_OK)
            exit(1);
        spin_pages_release(t.average.mean);
        t.average.mean = NULL;
        if (t.average.n == before)
            continue;
        n++;
        *first = *first ? *first : i;
        *mean += (double)i;
    }
    *mean /= n;
    return n;
}

/* Sets all parameters to this number; or checks that they are. */
static bool all(struct spin_device *d, struct spin_trainer *t, float number, bool put)
{
    float SPIN_DEV *at[] = {t->tracks.p, t->frame[0].pos, t->frame[1].pos, t->frame[0].residual,
                            t->frame[1].residual};
    const size_t n[] = {14 * TRACKED, 9, 6, 44, 33};
    bool same = true;

    for (size_t k = 0; k < sizeof n / sizeof *n; k++) {
        float host[14 * TRACKED_MOST];

        for (size_t i = 0; i < n[k]; i++)
            host[i] = number;
        if (put)
            d->op->upload(d, at[k], host, n[k] * sizeof *host);
        else if (d->op->download(d, host, at[k], n[k] * sizeof *host) != SPIN_OK)
            exit(1);
        for (size_t i = 0; i < n[k]; i++)
            same &= fabsf(host[i] - number) < 1e-3f;
    }
    return same;
}

TAP_MAIN
{
    struct spin_device *d = check_device(2);
    struct spin_trainer t;
    int64_t first;
    double mean;
    bool stays = true;

    ok(counts(0.3, 0, 100, &first, &mean) == 10, "three tenths of 100 iterations, in steps of 3");
    ok(first == 73 && mean == 86.5, "from iteration %d on, %g on average", (int)first, mean);
    ok(counts(0.3, 90, 100, &first, &mean) == 10, "none while splats are split");
    ok(first == 91 && mean == 95.5, "from iteration %d on", (int)first);
    ok(counts(1, 0, 3000, &first, &mean) == 12, "at most twelve");
    ok(counts(0.3, 100, 100, &first, &mean) == 1, "at least the last one");
    ok(first == 100, "which is %d", (int)first);

    memset(&t, 0, sizeof t);
    t.rates.iterations = t.rates.track_iterations = 100;
    t.rates.end = 1e-7;
    t.rates.floor = 0.2;
    t.iteration = 100;
    ok(fabs(spin_trainer_rate(&t, 2, 100) - 0.4) < 1e-9 &&
           fabs(spin_trainer_track_rate(&t, 2) - 0.4) < 1e-9,
       "rates end at the floor");
    t.rates.track_iterations = 50;
    ok(spin_trainer_track_rate(&t, 2) == 1e-7, "but for tracks that stop before");

    tracked_open(d, tracked_size, TRACKED, 2, 3, NULL, &t);
    tracked_fill(d, &t, 0);
    t.rates.iterations = 100;
    t.average = spin_average_of(0.3, 0, 100);
    for (t.iteration = 1; t.iteration <= 100; t.iteration++) {
        all(d, &t, (float)t.iteration, true);
        if (spin_average_step(&t) != SPIN_OK)
            exit(1);
        stays &= t.iteration == 100 || all(d, &t, (float)t.iteration, false);
    }
    ok(stays, "parameters stay as they are before the last step");
    ok(all(d, &t, 86.5f, false), "after it all of them are the mean");
    spin_trainer_close(&t);
    check_device_free(d);
}
