/* Matches between the splats of two frames, compared with a search of all pairs, and the search
 * of the k-d tree.
 * K: tracks threads */
#include "train/track_matching.h"

#include "geometry/neighbours.h"
#include "math/rng.h"
#include "tests/tap.h"

enum { N = 700, M = 650, WIDTH = 2 };
static float at[3 * N], appearance[WIDTH * N], reach[N], to_at[3 * M], to_appearance[WIDTH * M];

/* M of the N splats displaced by a step, and as many elsewhere; every ninth duplicates another. */
static void fill(void)
{
    for (size_t i = 0; i < N; i++) {
        for (size_t c = 0; c < 3; c++)
            at[3 * i + c] = 3 * spin_rng_normal(1, c, i % 9 == 8 ? i - 1 : i);
        for (size_t k = 0; k < WIDTH; k++)
            appearance[WIDTH * i + k] = spin_rng_normal(2, k, i % 9 == 8 ? i - 1 : i);
        reach[i] = i % 11 == 0 ? 0 : i % 7 == 0 ? 2.5f : 0.7f;
    }
    for (size_t i = 0; i < M; i++) {
        size_t from = i % 3 == 0 ? i : (i * 31) % N;

        for (size_t c = 0; c < 3; c++)
            to_at[3 * i + c] = at[3 * from + c] + 0.2f * spin_rng_normal(3, c, i);
        for (size_t k = 0; k < WIDTH; k++)
            to_appearance[WIDTH * i + k] =
                appearance[WIDTH * from + k] + 0.4f * spin_rng_normal(4, k, i);
    }
}

static double cost(size_t i, size_t k)
{
    double sum = 0;

    for (size_t c = 0; c < 3; c++)
        sum += pow((double)to_at[3 * k + c] - (double)at[3 * i + c], 2);
    if (sum > pow((double)reach[i], 2))
        return INFINITY;
    sum /= pow((double)reach[i], 2);
    for (size_t c = 0; c < WIDTH; c++) {
        double e = (double)to_appearance[WIDTH * k + c] - (double)appearance[WIDTH * i + c];

        if (fabs(e) > 1)
            return INFINITY;
        sum += e * e;
    }
    return sum;
}

/* Repeatedly choosing the cheapest free pair gives the same matches as rounds of mutual best
 * pairs. */
static void slow_link(uint32_t *next)
{
    static uint8_t taken[M];
    static double costs[N][M];

    for (size_t i = 0; i < N; i++)
        for (size_t k = 0; k < M; k++)
            costs[i][k] = cost(i, k);
    memset(next, 0xff, N * sizeof *next);
    for (;;) {
        double best = INFINITY;
        size_t from = 0, to = 0;

        for (size_t i = 0; i < N; i++)
            for (size_t k = 0; next[i] == SPIN_NO_LINK && k < M; k++)
                if (!taken[k] && costs[i][k] < best) {
                    best = costs[i][k];
                    from = i;
                    to = k;
                }
        if (best == INFINITY)
            return;
        next[from] = (uint32_t)to;
        taken[to] = 1;
    }
}

static void link_with(int n_threads, uint32_t *next)
{
    struct spin_pool *pool = NULL;

    ok(spin_pool_create(n_threads, &pool) == SPIN_OK &&
           spin_link(pool, &(struct spin_link_side){N, at, appearance}, reach,
                     &(struct spin_link_side){M, to_at, to_appearance}, WIDTH, next) == SPIN_OK,
       "links by %d threads", n_threads);
    spin_pool_free(pool);
}

static void test_link(void)
{
    static uint32_t want[N], got[N], three[N];
    size_t n = 0, same = 0, twice = 0;
    static uint8_t seen[M];

    fill();
    slow_link(want);
    link_with(1, got);
    link_with(3, three);
    ok(memcmp(got, three, sizeof got) == 0, "the same for any number of threads");
    for (size_t i = 0; i < N; i++) {
        n += want[i] != SPIN_NO_LINK;
        same += want[i] == got[i];
        twice += got[i] != SPIN_NO_LINK && seen[got[i]]++;
    }
    ok(n > N / 3 && n < N, "some are linked, some are not: %zu", n);
    ok(same == N && twice == 0, "the cheapest first of all pairs, and nothing twice: %zu", same);
}

/* One side is empty. */
static void test_none(void)
{
    struct spin_pool *pool = NULL;
    uint32_t next[1] = {0};
    struct spin_link_side none = {0}, one = {1, at, appearance};

    ok(spin_pool_create(1, &pool) == SPIN_OK &&
           spin_link(pool, &one, reach, &none, WIDTH, next) == SPIN_OK && next[0] == SPIN_NO_LINK &&
           spin_link(pool, &none, reach, &one, WIDTH, next) == SPIN_OK,
       "a frame without splats");
    spin_pool_free(pool);
}

static void mark(void *context, uint32_t point) { ((uint8_t *)context)[point]++; }

static void test_within(void)
{
    struct spin_kd_tree tree = {0};
    size_t missed = 0, twice = 0, visits = 0;

    ok(spin_kd_tree_open(&tree, N, at) == SPIN_OK, "a tree");
    for (size_t q = 0; q < M; q++) {
        uint8_t seen[N] = {0};

        spin_kd_tree_within(&tree, to_at + 3 * q, 0.8f, mark, seen);
        for (size_t i = 0; i < N; i++) {
            double d2 = 0;

            for (size_t c = 0; c < 3; c++)
                d2 += pow((double)to_at[3 * q + c] - (double)at[3 * i + c], 2);
            missed += d2 <= 0.64 && !seen[i];
            twice += seen[i] > 1;
            visits += seen[i];
        }
    }
    ok(missed == 0 && twice == 0, "all that are near, each once");
    ok(visits < N * M / 3, "and few others: %zu", visits);
    spin_kd_tree_close(&tree);
}

int main(void)
{
    test_link();
    test_none();
    test_within();
    return tap_done();
}
