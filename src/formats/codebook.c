#include "formats/codebook.h"

#include "base/base.h"

#define BINS 4096     /* bins of the histogram from which the initial entries are chosen */
#define MOST_STEPS 60 /* at most this number of iterations of Lloyd's algorithm */
#define CUT_STEPS 6   /* at most this number of iterations of 2-means */

/* ---- Numbers --------------------------------------------------------------------------------- */

/* Radix sort of n floats in ascending order, 11 bits per pass. room: scratch memory for n
 * floats. */
static void sort_floats(float *values, float *room, size_t n)
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

/* Returns the number of values below v, by binary search. */
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

static double density_root(const float *sorted, size_t n, double low, double width)
{
    return cbrt((double)(count_below(sorted, n, low + width) - count_below(sorted, n, low)));
}

/* Chooses the initial entries of the codebook, ascending: their density is proportional to the cube
 * root of the density of the values, which is optimal for the mean squared error if there are many
 * entries (Panter and Dite, 1951). */
static void choose_initial(const float *sorted, size_t n, double place[SPIN_CODEBOOK])
{
    double low = sorted[0], width = ((double)sorted[n - 1] - low) / BINS, sum = 0, share = 0;
    int k = 0;

    for (int b = 0; b < BINS; b++)
        sum += density_root(sorted, n, low + b * width, width);
    for (int b = 0; b < BINS; b++) {
        share += density_root(sorted, n, low + b * width, width);
        while (k < SPIN_CODEBOOK && share >= sum * (k + 0.5) / SPIN_CODEBOOK)
            place[k++] = low + (b + 0.5) * width;
    }
    while (k < SPIN_CODEBOOK)
        place[k++] = sorted[n - 1];
}

/* One iteration of Lloyd's algorithm: replaces each entry place[k] of the codebook by the mean of
 * the values that are nearest to it. An entry that is nearest to no value keeps its value.
 * before[i]: sum of the first i values. Returns false if no entry changed. */
static bool move_to_means(const float *sorted, const double *before, size_t n,
                          double place[SPIN_CODEBOOK])
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
    double place[SPIN_CODEBOOK] = {0};
    SPIN_FREED double *before = NULL;
    SPIN_FREED float *sorted = NULL;
    char text[32];

    SPIN_TRY(spin_alloc(n + 1, sizeof *sorted, (void **)&sorted));
    SPIN_TRY(spin_alloc(n + 1, sizeof *before, (void **)&before));
    if (n > 0) {
        memcpy(sorted, values, n * sizeof *sorted);
        sort_floats(sorted, (float *)before, n);
        before[0] = 0;
        for (size_t i = 0; i < n; i++)
            before[i + 1] = before[i] + (double)sorted[i];
        choose_initial(sorted, n, place);
        for (int i = 0; i < MOST_STEPS && move_to_means(sorted, before, n, place); i++)
            ;
    }
    for (int k = 0; k < SPIN_CODEBOOK; k++) {
        snprintf(text, sizeof text, "%.6g", place[k]);
        book[k] = strtof(text, NULL);
    }
    return SPIN_OK;
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

/* A cluster of rows that share a palette vector: the rows order[first] to order[first + n - 1]. If
 * a division was found, the first n_front of them form the first half and the others the second
 * half. */
struct cluster {
    size_t first, n, n_front; /* n_front: 0 if the cluster cannot be divided */
    double error;             /* sum of squared distances of the rows to their mean */
    double side_error[2];     /* error of each half */
    bool divided;             /* true: a division was tried; n_front and side_error are set */
};

struct clustering {
    const float *rows;
    size_t width;
    uint32_t *order;
    struct cluster *cluster; /* [n_clusters] a heap with the largest error at the top */
    size_t n_clusters;
    struct cluster *batch; /* [BATCH] clusters removed from the heap to be divided */
    double *sums;          /* [workers][SUMS][width] scratch memory of the workers */
    uint32_t *label;
    float *palette;
};

enum { BATCH = 256 }; /* at most this number of clusters are divided in parallel */
/* Offsets, in vectors, in a worker's scratch memory: the mean, the sum of squared deviations of
 * each coordinate, and the two cluster centres of 2-means. */
enum { MEAN, SPREAD, CENTRES, SUMS = CENTRES + 2 };

/* Computes the mean of the rows order[first] to order[first + n - 1] into sum[0..width), and the
 * sums of squared deviations of the coordinates into the next `width` elements. Returns the total
 * of these sums. *widest receives the index of the coordinate with the largest sum. */
static double measure_cluster(const struct clustering *c, size_t first, size_t n, double *sum,
                              size_t *widest)
{
    double *mean = sum, *squares = sum + SPREAD * c->width, error = 0;

    memset(sum, 0, 2 * c->width * sizeof *sum);
    for (size_t i = first; i < first + n; i++) {
        const float *row = c->rows + c->order[i] * c->width;

        for (size_t k = 0; k < c->width; k++) {
            mean[k] += (double)row[k];
            squares[k] += (double)row[k] * (double)row[k];
        }
    }
    *widest = 0;
    for (size_t k = 0; k < c->width; k++) {
        mean[k] /= (double)n;
        squares[k] = fmax(squares[k] - mean[k] * mean[k] * (double)n, 0);
        error += squares[k];
        *widest = squares[k] > squares[*widest] ? k : *widest;
    }
    return error;
}

/* Returns the dot product of two vectors. Four independent partial sums let the processor overlap
 * the additions. */
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

/* One iteration of 2-means. Moves those rows of a cluster to the front that are nearer to the first
 * of two centres, centre [2][width], and returns their number. If both halves have rows, replaces
 * each centre by the mean of its half. mean: mean of the cluster; across: scratch memory, [width].
 */
static size_t divide_by_centres(const struct clustering *c, const struct cluster *p,
                                const double *mean, double *across, double *centre)
{
    size_t front = p->first, width = c->width, n;
    double middle = 0; /* rows with across . row > middle are nearer to the first centre */

    for (size_t k = 0; k < width; k++) {
        double one = centre[k], two = centre[width + k];

        across[k] = 2 * (one - two);
        middle += one * one - two * two;
    }
    memset(centre, 0, width * sizeof *centre);
    for (size_t i = p->first; i < p->first + p->n; i++) {
        const float *row = c->rows + c->order[i] * width;

        if (dot(row, across, width) > middle) {
            uint32_t keep = c->order[front];

            c->order[front++] = c->order[i];
            c->order[i] = keep;
            for (size_t k = 0; k < width; k++)
                centre[k] += (double)row[k];
        }
    }
    n = front - p->first;
    if (n == 0 || n == p->n)
        return n;
    for (size_t k = 0; k < width; k++) {
        centre[width + k] = (mean[k] * (double)p->n - centre[k]) / (double)(p->n - n);
        centre[k] /= (double)n;
    }
    return n;
}

/* Divides a cluster by 2-means. The initial centres are the mean plus and minus one standard
 * deviation along the widest coordinate. Returns the number of rows in the first half, or 0 if the
 * cluster cannot be divided. */
static size_t divide_cluster(const struct clustering *c, const struct cluster *p, double *sum)
{
    double *mean = sum + MEAN * c->width, *spread = sum + SPREAD * c->width;
    double *centre = sum + CENTRES * c->width, apart;
    size_t widest, n = 0;

    if (!(measure_cluster(c, p->first, p->n, sum, &widest) > 0))
        return 0;
    apart = sqrt(spread[widest] / (double)p->n);
    memcpy(centre, mean, c->width * sizeof *centre);
    memcpy(centre + c->width, mean, c->width * sizeof *centre);
    centre[widest] -= apart;
    centre[c->width + widest] += apart;
    for (int i = 0; i < CUT_STEPS; i++) {
        size_t before = n;

        n = divide_by_centres(c, p, mean, spread, centre);
        if (n == 0 || n == p->n)
            return 0;
        if (n == before)
            break;
    }
    return n;
}

/* Divides one cluster of the batch. The function reorders only the rows of this cluster, so tasks
 * can run in parallel. */
static void divide_task(void *context, int task)
{
    struct clustering *c = context;
    struct cluster *p = &c->batch[task];
    double *sum = c->sums + SUMS * c->width * (size_t)spin_pool_worker();
    size_t widest;

    if (p->divided)
        return;
    p->divided = true;
    p->n_front = divide_cluster(c, p, sum);
    if (p->n_front == 0)
        return;
    p->side_error[0] = measure_cluster(c, p->first, p->n_front, sum, &widest);
    p->side_error[1] = measure_cluster(c, p->first + p->n_front, p->n - p->n_front, sum, &widest);
}

static void push_cluster(struct clustering *c, struct cluster p)
{
    size_t i = c->n_clusters++;

    for (; i > 0 && c->cluster[(i - 1) / 2].error < p.error; i = (i - 1) / 2)
        c->cluster[i] = c->cluster[(i - 1) / 2];
    c->cluster[i] = p;
}

/* Removes and returns the cluster with the largest error. */
static struct cluster pop_cluster(struct clustering *c)
{
    struct cluster top = c->cluster[0], last = c->cluster[--c->n_clusters];
    size_t i = 0;

    for (;;) {
        size_t child = 2 * i + 1;

        if (child + 1 < c->n_clusters && c->cluster[child + 1].error > c->cluster[child].error)
            child++;
        if (child >= c->n_clusters || c->cluster[child].error <= last.error)
            break;
        c->cluster[i] = c->cluster[child];
        i = child;
    }
    c->cluster[i] = last;
    return top;
}

/* Divides the clusters with the largest errors in parallel, at most n_left clusters. The batch
 * size, and therefore the result, does not depend on the number of threads. */
static void divide_largest(struct clustering *c, size_t n_left, struct spin_pool *pool)
{
    int n = 0;

    while (n < BATCH && (size_t)n < n_left && c->n_clusters > 0)
        c->batch[n++] = pop_cluster(c);
    spin_pool_run(pool, n, divide_task, c);
    for (int k = 0; k < n; k++)
        push_cluster(c, c->batch[k]);
}

static void divide_all(struct clustering *c, size_t n_colours, struct spin_pool *pool)
{
    while (c->n_clusters < n_colours && c->cluster[0].error > 0) {
        struct cluster p;

        if (!c->cluster[0].divided) {
            divide_largest(c, n_colours - c->n_clusters, pool);
            continue;
        }
        p = pop_cluster(c);
        if (p.n_front == 0) {
            /* With an error of 0 the cluster moves to the end of the heap, so that no further
             * attempt is made to divide it. */
            p.error = 0;
            push_cluster(c, p);
            continue;
        }
        push_cluster(c,
                     (struct cluster){.first = p.first, .n = p.n_front, .error = p.side_error[0]});
        push_cluster(c, (struct cluster){.first = p.first + p.n_front,
                                         .n = p.n - p.n_front,
                                         .error = p.side_error[1]});
    }
}

/* Computes the palette vectors of clusters i to end - 1, and sets the labels of their rows. */
static void finish_task(void *context, size_t i, size_t end)
{
    struct clustering *c = context;
    double *sum = c->sums + SUMS * c->width * (size_t)spin_pool_worker();
    size_t widest;

    for (; i < end; i++) {
        const struct cluster *p = &c->cluster[i];

        measure_cluster(c, p->first, p->n, sum, &widest);
        for (size_t k = 0; k < c->width; k++)
            c->palette[i * c->width + k] = (float)sum[k];
        for (size_t j = p->first; j < p->first + p->n; j++)
            c->label[c->order[j]] = (uint32_t)i;
    }
}

spin_status spin_palette_make(const float *rows, size_t n, size_t width, size_t n_colours,
                              struct spin_pool *pool, uint32_t *label, float *palette,
                              size_t *n_used)
{
    struct clustering c = {.rows = rows, .width = width, .label = label, .palette = palette};
    size_t n_workers = pool ? (size_t)spin_pool_n_threads(pool) : 1, widest;
    spin_status status;

    *n_used = 0;
    if (n == 0 || n_colours == 0)
        return SPIN_OK;
    SPIN_TRY_OUT(spin_alloc(n, sizeof *c.order, (void **)&c.order));
    SPIN_TRY_OUT(spin_alloc(n_colours + 1, sizeof *c.cluster, (void **)&c.cluster));
    SPIN_TRY_OUT(spin_alloc(BATCH, sizeof *c.batch, (void **)&c.batch));
    SPIN_TRY_OUT(spin_alloc(n_workers, (SUMS * width + 1) * sizeof *c.sums, (void **)&c.sums));
    for (size_t i = 0; i < n; i++)
        c.order[i] = (uint32_t)i;
    push_cluster(&c, (struct cluster){.n = n, .error = measure_cluster(&c, 0, n, c.sums, &widest)});
    divide_all(&c, n_colours, pool);
    spin_pool_rows(pool, c.n_clusters, BATCH, finish_task, &c);
    *n_used = c.n_clusters;
    status = SPIN_OK;
out:
    free(c.order);
    free(c.cluster);
    free(c.batch);
    free(c.sums);
    return status;
}
