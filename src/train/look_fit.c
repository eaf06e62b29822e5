/* Least squares in logarithms: unknown are a number for each point, which is taken out by subtracting the point's
 * weighted mean, one for each camera, and two for each lens, a r^2 + b r^4 = log(1 + c1 r^2 + c2 r^4). Conjugate
 * gradients solve it; a few rounds weigh samples anew by how well they fit. */
#include "train/look_fit.h"

#include "base/base.h"

enum { ROUNDS = 6, STEPS = 100 };
static const double outlier = 0.05; /* a sample that is so far off, as a logarithm, counts half */

struct fit {
    const struct spin_look_sample *sample;
    size_t n, n_unknown;
    int n_cameras;
    double *y, *weight, *residual; /* [n] */
    double *x, *r, *p, *q;         /* [n_unknown] */
};

static double *lens_of(const struct fit *f, double *x, size_t i)
{
    return x + f->n_cameras + 2 * f->sample[i].lens;
}

/* What the unknowns say of a sample, without its point. */
static double value_of(const struct fit *f, double *x, size_t i)
{
    double r2 = (double)f->sample[i].r2, *lens = lens_of(f, x, i);

    return x[f->sample[i].camera] + r2 * (lens[0] + r2 * lens[1]);
}

static size_t end_of_point(const struct fit *f, size_t i)
{
    size_t end = i;

    while (end < f->n && f->sample[end].point == f->sample[i].point)
        end++;
    return end;
}

/* Each point's weighted mean is taken out of v [n]. */
static void centre(const struct fit *f, double *v)
{
    for (size_t i = 0, end; i < f->n; i = end) {
        double sum = 0, weights = 0;

        end = end_of_point(f, i);
        for (size_t k = i; k < end; k++) {
            sum += f->weight[k] * v[k];
            weights += f->weight[k];
        }
        for (size_t k = i; k < end; k++)
            v[k] -= sum / weights;
    }
}

/* out [n_unknown] = the weighted samples v [n], each added where its unknowns stand. */
static void gather(const struct fit *f, const double *v, double *out)
{
    memset(out, 0, f->n_unknown * sizeof *out);
    for (size_t i = 0; i < f->n; i++) {
        double r2 = (double)f->sample[i].r2, d = f->weight[i] * v[i], *lens = lens_of(f, out, i);

        out[f->sample[i].camera] += d;
        lens[0] += d * r2;
        lens[1] += d * r2 * r2;
    }
}

static void multiply(const struct fit *f, double *x, double *out)
{
    for (size_t i = 0; i < f->n; i++)
        f->residual[i] = value_of(f, x, i);
    centre(f, f->residual);
    gather(f, f->residual, out);
}

static double dot(const struct fit *f, const double *a, const double *b)
{
    double sum = 0;

    for (size_t i = 0; i < f->n_unknown; i++)
        sum += a[i] * b[i];
    return sum;
}

/* From x = 0, so that what no sample tells stays 0. */
static void solve(struct fit *f)
{
    double squares, before, first;

    memcpy(f->residual, f->y, f->n * sizeof *f->y);
    centre(f, f->residual);
    gather(f, f->residual, f->r);
    memset(f->x, 0, f->n_unknown * sizeof *f->x);
    memcpy(f->p, f->r, f->n_unknown * sizeof *f->p);
    squares = first = dot(f, f->r, f->r);
    for (int step = 0; step < STEPS && squares > 1e-20 * first; step++) {
        double length;

        multiply(f, f->p, f->q);
        length = squares / dot(f, f->p, f->q);
        before = squares;
        for (size_t i = 0; i < f->n_unknown; i++) {
            f->x[i] += length * f->p[i];
            f->r[i] -= length * f->q[i];
        }
        squares = dot(f, f->r, f->r);
        for (size_t i = 0; i < f->n_unknown; i++)
            f->p[i] = f->r[i] + squares / before * f->p[i];
    }
}

static void weigh(struct fit *f)
{
    for (size_t i = 0; i < f->n; i++)
        f->residual[i] = f->y[i] - value_of(f, f->x, i);
    centre(f, f->residual);
    for (size_t i = 0; i < f->n; i++) {
        double off = f->residual[i] / outlier;

        f->weight[i] = 1 / (1 + off * off);
    }
}

static void put(const struct fit *f, int n_lenses, int rgb, float *exposure)
{
    double mean = 0;

    for (int k = 0; k < f->n_cameras; k++)
        mean += f->x[k] / f->n_cameras;
    for (int k = 0; k < f->n_cameras; k++)
        exposure[6 * k + rgb] = f->x[k] != 0 ? (float)(f->x[k] - mean) : 0;
    exposure += 6 * f->n_cameras;
    for (int k = 0; k < n_lenses; k++) {
        const double *ab = f->x + f->n_cameras + 2 * k;

        exposure[6 * k + rgb] = (float)ab[0];
        exposure[6 * k + 3 + rgb] = (float)(ab[1] + ab[0] * ab[0] / 2);
    }
}

spin_status spin_look_fit(const struct spin_look_sample *sample, size_t n, int n_cameras,
                          int n_lenses, float *exposure)
{
    struct fit f = {.sample = sample,
                    .n = n,
                    .n_unknown = (size_t)(n_cameras + 2 * n_lenses),
                    .n_cameras = n_cameras};

    memset(exposure, 0, (size_t)(n_cameras + n_lenses) * 6 * sizeof *exposure);
    SPIN_TRY(spin_alloc(3 * n + 4 * f.n_unknown, sizeof(double), (void **)&f.y));
    f.weight = f.y + n;
    f.residual = f.weight + n;
    f.x = f.residual + n;
    f.r = f.x + f.n_unknown;
    f.p = f.r + f.n_unknown;
    f.q = f.p + f.n_unknown;
    for (int rgb = 0; rgb < 3; rgb++) {
        for (size_t i = 0; i < n; i++) {
            f.y[i] = log((double)sample[i].value[rgb]);
            f.weight[i] = 1;
        }
        for (int round = 0; round < ROUNDS; round++) {
            solve(&f);
            weigh(&f);
        }
        put(&f, n_lenses, rgb, exposure);
    }
    free(f.y);
    return SPIN_OK;
}
