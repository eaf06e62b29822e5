#include "formats/codebook.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/mem.h"

#define BINS 4096     /* of the histogram that the first places come from */
#define MOST_STEPS 60 /* of Lloyd's algorithm */
#define CUT_STEPS 6   /* of 2-means */

/* ---- Numbers --------------------------------------------------------------------------------- */

/* Rising, by the bits of floats, eleven at a time from the low end; with room for as many. */
static void sort(float *values, float *room, size_t n)
{
    enum { BITS = 11, N = 1 << BITS };

    for (int shift = 0; shift < 33; shift += BITS) {
        size_t start[N + 1] = {0};

        for (int pass = 0; pass < 2; pass++) {
            for (size_t i = 0; i < n; i++) {
                uint32_t bits, key;

                memcpy(&bits, &values[i], sizeof bits);
                key = (bits & 0x80000000u ? ~bits : bits | 0x80000000u) >> shift & (N - 1);
                if (pass == 0)
                    start[key + 1]++;
                else
                    room[start[key]++] = values[i];
            }
            for (int b = 0; b < N && pass == 0; b++)
                start[b + 1] += start[b];
        }
        memcpy(values, room, n * sizeof *values);
    }
}

/* How many of n rising values are below v. */
static size_t count_below(const float *sorted, size_t n, double v)
{
    size_t low = 0, high = n;

    while (low < high) {
        size_t middle = low + (high - low) / 2;

        if ((double)sorted[middle] < v)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

static double root_in(const float *sorted, size_t n, double low, double width)
{
    return cbrt((double)(count_below(sorted, n, low + width) - count_below(sorted, n, low)));
}

/* Where the third root of the density, summed up, reaches equal shares. */
static void first_places(const float *sorted, size_t n, double place[SPIN_CODEBOOK])
{
    double low = sorted[0], width = ((double)sorted[n - 1] - low) / BINS, sum = 0, share = 0;
    int k = 0;

    for (int b = 0; b < BINS; b++)
        sum += root_in(sorted, n, low + b * width, width);
    for (int b = 0; b < BINS; b++) {
        share += root_in(sorted, n, low + b * width, width);
        while (k < SPIN_CODEBOOK && share >= sum * (k + 0.5) / SPIN_CODEBOOK)
            place[k++] = low + (b + 0.5) * width;
    }
    while (k < SPIN_CODEBOOK)
        place[k++] = sorted[n - 1];
}

/* Each place becomes the mean of the values that are nearest to it; whether any moved. */
static bool step(const float *sorted, const double *before, size_t n, double place[SPIN_CODEBOOK])
{
    size_t from = 0;
    bool moved = false;

    for (int k = 0; k < SPIN_CODEBOOK; k++) {
        size_t to =
            k + 1 < SPIN_CODEBOOK ? count_below(sorted, n, (place[k] + place[k + 1]) / 2) : n;

        if (to > from) {
            double mean = (before[to] - before[from]) / (double)(to - from);

            moved |= mean != place[k];
            place[k] = mean;
        }
        from = to > from ? to : from;
    }
    return moved;
}

spin_status spin_codebook_make(const float *values, size_t n, float book[SPIN_CODEBOOK])
{
    double place[SPIN_CODEBOOK] = {0}, *before = NULL;
    float *sorted = NULL;
    char text[32];
    spin_status status;

    SPIN_TRY_OUT(spin_alloc(n + 1, sizeof *sorted, (void **)&sorted));
    SPIN_TRY_OUT(spin_alloc(n + 1, sizeof *before, (void **)&before));
    if (n > 0) {
        memcpy(sorted, values, n * sizeof *sorted);
        sort(sorted, (float *)before, n);
        before[0] = 0;
        for (size_t i = 0; i < n; i++)
            before[i + 1] = before[i] + (double)sorted[i];
        first_places(sorted, n, place);
        for (int i = 0; i < MOST_STEPS && step(sorted, before, n, place); i++)
            ;
    }
    for (int k = 0; k < SPIN_CODEBOOK; k++) {
        snprintf(text, sizeof text, "%.6g", place[k]);
        book[k] = strtof(text, NULL);
    }
    status = SPIN_OK;
out:
    free(sorted);
    free(before);
    return status;
}

unsigned char spin_codebook_nearest(const float book[SPIN_CODEBOOK], float value)
{
    int low = 0, high = SPIN_CODEBOOK - 1;

    while (low < high) {
        int middle = (low + high) / 2;

        if (value > (book[middle] + book[middle + 1]) / 2)
            low = middle + 1;
        else
            high = middle;
    }
    return (unsigned char)low;
}

/* ---- Vectors --------------------------------------------------------------------------------- */

/* Rows that share a vector: order[first] and on. */
struct part {
    size_t first, n;
    double error; /* sum of squares */
};

struct cutting {
    const float *rows;
    size_t width;
    uint32_t *order;
    struct part *part; /* a heap: the largest error first */
    size_t n_parts;
    double *sum; /* [3][width] */
};

/* Mean into c->sum[0..width), and the sum of squared distances to it; `widest` is the coordinate with most. */
static double measure(struct cutting *c, const struct part *p, size_t *widest)
{
    double *mean = c->sum, *squares = c->sum + c->width, error = 0;

    memset(c->sum, 0, 2 * c->width * sizeof *c->sum);
    for (size_t i = p->first; i < p->first + p->n; i++) {
        const float *row = c->rows + c->order[i] * c->width;

        for (size_t k = 0; k < c->width; k++) {
            mean[k] += (double)row[k];
            squares[k] += (double)row[k] * (double)row[k];
        }
    }
    *widest = 0;
    for (size_t k = 0; k < c->width; k++) {
        mean[k] /= (double)p->n;
        squares[k] = fmax(squares[k] - mean[k] * mean[k] * (double)p->n, 0);
        error += squares[k];
        *widest = squares[k] > squares[*widest] ? k : *widest;
    }
    return error;
}

/* In four sums, which a processor does side by side. */
static double dot(const float *row, const double *w, size_t n)
{
    double sum[4] = {0};
    size_t k = 0;

    for (; k + 4 <= n; k += 4)
        for (size_t j = 0; j < 4; j++)
            sum[j] += (double)row[k + j] * w[k + j];
    for (; k < n; k++)
        sum[0] += (double)row[k] * w[k];
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* Rows nearer to the first of two centres come to the front; how many. centre: [2][width], behind c->sum[0..width),
 * which is overwritten. */
static size_t divide(struct cutting *c, const struct part *p, const double *centre)
{
    size_t front = p->first;
    double *across = c->sum, middle = 0; /* of the plane between them */

    for (size_t k = 0; k < c->width; k++) {
        double one = centre[k], two = centre[c->width + k];

        across[k] = 2 * (one - two);
        middle += one * one - two * two;
    }
    for (size_t i = p->first; i < p->first + p->n; i++) {
        if (dot(c->rows + c->order[i] * c->width, across, c->width) > middle) {
            uint32_t keep = c->order[front];

            c->order[front++] = c->order[i];
            c->order[i] = keep;
        }
    }
    return front - p->first;
}

static void centre_of(const struct cutting *c, size_t first, size_t n, double *centre)
{
    memset(centre, 0, c->width * sizeof *centre);
    for (size_t i = first; i < first + n; i++)
        for (size_t k = 0; k < c->width; k++)
            centre[k] += (double)c->rows[c->order[i] * c->width + k] / (double)n;
}

/* 2-means, begun on both sides of the mean of the widest coordinate; how many rows the first part has, 0 when
 * they cannot be told apart. */
static size_t cut(struct cutting *c, const struct part *p)
{
    double *centre = c->sum + c->width;
    size_t widest, n = 0;
    double error = measure(c, p, &widest), apart;

    if (!(error > 0))
        return 0;
    apart = sqrt(c->sum[c->width + widest] / (double)p->n);
    memcpy(centre, c->sum, c->width * sizeof *centre);
    memcpy(centre + c->width, c->sum, c->width * sizeof *centre);
    centre[widest] -= apart;
    centre[c->width + widest] += apart;
    for (int i = 0; i < CUT_STEPS; i++) {
        size_t before = n;

        n = divide(c, p, centre);
        if (n == 0 || n == p->n)
            return 0;
        if (n == before)
            break;
        centre_of(c, p->first, n, centre);
        centre_of(c, p->first + n, p->n - n, centre + c->width);
    }
    return n;
}

static void sink(struct cutting *c, size_t i)
{
    for (;;) {
        size_t largest = i;
        struct part keep = c->part[i];

        for (size_t child = 2 * i + 1; child <= 2 * i + 2 && child < c->n_parts; child++)
            if (c->part[child].error > c->part[largest].error)
                largest = child;
        if (largest == i)
            return;
        c->part[i] = c->part[largest];
        c->part[largest] = keep;
        i = largest;
    }
}

static void add_part(struct cutting *c, struct part p)
{
    size_t i = c->n_parts++, widest;

    p.error = measure(c, &p, &widest);
    for (; i > 0 && c->part[(i - 1) / 2].error < p.error; i = (i - 1) / 2)
        c->part[i] = c->part[(i - 1) / 2];
    c->part[i] = p;
}

spin_status spin_palette_make(const float *rows, size_t n, size_t width, size_t n_colours,
                              uint32_t *label, float *palette, size_t *n_used)
{
    struct cutting c = {.rows = rows, .width = width};
    spin_status status;

    *n_used = 0;
    if (n == 0 || n_colours == 0)
        return SPIN_OK;
    SPIN_TRY_OUT(spin_alloc(n, sizeof *c.order, (void **)&c.order));
    SPIN_TRY_OUT(spin_alloc(n_colours, sizeof *c.part, (void **)&c.part));
    SPIN_TRY_OUT(spin_alloc(3 * width + 1, sizeof *c.sum, (void **)&c.sum));
    for (size_t i = 0; i < n; i++)
        c.order[i] = (uint32_t)i;
    add_part(&c, (struct part){.n = n});
    while (c.n_parts < n_colours && c.part[0].error > 0) {
        struct part p = c.part[0];
        size_t n_first = cut(&c, &p);

        c.part[0].error = 0; /* of a part that cannot be cut it stays so */
        if (n_first > 0) {
            c.part[0] = c.part[--c.n_parts];
            sink(&c, 0);
            add_part(&c, (struct part){p.first, n_first, 0});
            add_part(&c, (struct part){p.first + n_first, p.n - n_first, 0});
        } else {
            sink(&c, 0);
        }
    }
    for (size_t i = 0; i < c.n_parts; i++) {
        size_t widest;

        measure(&c, &c.part[i], &widest);
        for (size_t k = 0; k < width; k++)
            palette[i * width + k] = (float)c.sum[k];
        for (size_t j = c.part[i].first; j < c.part[i].first + c.part[i].n; j++)
            label[c.order[j]] = (uint32_t)i;
    }
    *n_used = c.n_parts;
    status = SPIN_OK;
out:
    free(c.order);
    free(c.part);
    free(c.sum);
    return status;
}
