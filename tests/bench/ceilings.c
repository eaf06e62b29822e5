/* What this machine can do at best: multiply-add, stream, look up at random. Each is the best of a
 * few runs; processor time with one thread, the clock on the wall with more. */
#include <string.h>
#include <time.h>

#include "base/err.h"
#include "base/log.h"
#include "base/mem.h"
#include "base/pool.h"
#include "tests/bench/bench.h"

#if defined(__x86_64__)
#include <immintrin.h>
#define FOR_V4 __attribute__((target("avx512f")))
#define FOR_V3 __attribute__((target("avx2,fma")))
#endif

enum { RUNS = 5 };
static const size_t stream_bytes = (size_t)192 << 20;

struct job {
    void (*work)(const struct job *job, size_t first, size_t n);
    size_t n, each; /* items, and of a task */
    float *a;
    const float *b, *c;
    size_t mask; /* of a table's rows */
};

static volatile float sink; /* keeps the compiler from dropping the work */

double bench_cpu_s(void)
{
    struct timespec t;

    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void run_task(void *context, int task)
{
    const struct job *job = context;

    job->work(job, (size_t)task * job->each, job->each);
}

/* Items a second. */
static double best(struct spin_pool *pool, struct job *job)
{
    double (*now)(void) = spin_pool_n_threads(pool) == 1 ? bench_cpu_s : spin_now_s;
    int n_tasks = (int)(job->n / job->each);
    double least = 1e30;

    for (int i = 0; i < RUNS; i++) {
        double start = now(), s;

        spin_pool_run(pool, n_tasks, run_task, job);
        s = now() - start;
        least = s < least ? s : least;
    }
    return (double)n_tasks * (double)job->each / least;
}

/* ---- multiply-add ---------------------------------------------------------------------------- */

/* An item is one multiply-add of one float. Ten sums, each with a name so that it has a register:
 * two units of four cycles need eight. */
#define FMA_BODY(vec, lanes, fma)                                                                  \
    vec a = {0}, b = {0}, s0 = a, s1 = a, s2 = a, s3 = a, s4 = a, s5 = a, s6 = a, s7 = a, s8 = a,  \
        s9 = a;                                                                                    \
    float all[lanes];                                                                              \
    a += 0.999f;                                                                                   \
    b += 1e-3f;                                                                                    \
    s1 += 1, s2 += 2, s3 += 3, s4 += 4, s5 += 5, s6 += 6, s7 += 7, s8 += 8, s9 += 9;               \
    for (size_t k = 0; k < n / (10 * lanes); k++) {                                                \
        s0 = fma(s0), s1 = fma(s1), s2 = fma(s2), s3 = fma(s3), s4 = fma(s4);                      \
        s5 = fma(s5), s6 = fma(s6), s7 = fma(s7), s8 = fma(s8), s9 = fma(s9);                      \
    }                                                                                              \
    s0 += s1 + s2 + s3 + s4 + s5 + s6 + s7 + s8 + s9;                                              \
    memcpy(all, &s0, sizeof all);                                                                  \
    sink = all[0];                                                                                 \
    (void)job;                                                                                     \
    (void)first

typedef float vec4 __attribute__((vector_size(16)));
#if defined(__x86_64__)
typedef float vec8 __attribute__((vector_size(32)));
typedef float vec16 __attribute__((vector_size(64)));

FOR_V4 static void fma_v4(const struct job *job, size_t first, size_t n)
{
#define V4(s) (vec16) _mm512_fmadd_ps((__m512)s, (__m512)a, (__m512)b)
    FMA_BODY(vec16, 16, V4);
}

FOR_V3 static void fma_v3(const struct job *job, size_t first, size_t n)
{
#define V3(s) (vec8) _mm256_fmadd_ps((__m256)s, (__m256)a, (__m256)b)
    FMA_BODY(vec8, 8, V3);
}
#endif

static void fma_base(const struct job *job, size_t first, size_t n)
{
#define BASE(s) (s) * a + b
    FMA_BODY(vec4, 4, BASE);
}

static void measure_fma(struct spin_pool *pool, struct bench_ceilings *out)
{
    struct job job = {.work = fma_base, .n = (size_t)1 << 32, .each = (size_t)1 << 28};

#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx512f"))
        job.work = fma_v4;
    else if (__builtin_cpu_supports("fma"))
        job.work = fma_v3;
#endif
    out->fma = 2 * best(pool, &job);
}

/* ---- streams --------------------------------------------------------------------------------- */

static void read_all(const struct job *job, size_t first, size_t n)
{
    vec4 sum[8] = {{0}};
    const float *b = job->b + first;

    for (size_t i = 0; i < n; i += 32)
        for (size_t k = 0; k < 8; k++) {
            vec4 v;

            memcpy(&v, b + i + 4 * k, sizeof v);
            sum[k] += v;
        }
    for (int k = 1; k < 8; k++)
        sum[0] += sum[k];
    sink = sum[0][0] + sum[0][1] + sum[0][2] + sum[0][3];
}

/* Four arrays at once, read and written in place, as Adam does it. */
static void update_all(const struct job *job, size_t first, size_t n)
{
    size_t quarter = stream_bytes / sizeof(float) / 4;
    float *restrict p = job->a + first / 4, *restrict q = p + quarter + 272;
    float *restrict r = q + quarter + 272, *restrict s = r + quarter + 272;

    for (size_t i = 0; i < n / 4; i++) {
        p[i] *= 0.5f;
        q[i] *= 0.5f;
        r[i] *= 0.5f;
        s[i] *= 0.5f;
    }
}

static void triad_all(const struct job *job, size_t first, size_t n)
{
    float *restrict a = job->a + first;
    const float *restrict b = job->b + first, *restrict c = job->c + first;

    for (size_t i = 0; i < n; i++)
        a[i] = b[i] + 0.5f * c[i];
}

static void measure_streams(struct spin_pool *pool, float *block, struct bench_ceilings *out)
{
    size_t n = stream_bytes / sizeof(float);
    struct job job = {.n = n, .each = n / 64, .a = block};

    /* Not at the same place of a page: loads would wait for stores they only seem to overlap. */
    job.b = block + n + 272;
    job.c = block + 2 * n + 544;

    job.work = read_all;
    out->read = 4 * best(pool, &job);
    job.work = update_all;
    out->update = 8 * best(pool, &job);
    job.work = triad_all;
    out->triad = 12 * best(pool, &job);
}

/* ---- lookups --------------------------------------------------------------------------------- */

static void look_up(const struct job *job, size_t first, size_t n)
{
    uint64_t state = first * 2862933555777941757u + 3037000493u;
    vec4 sum = {0};

    for (size_t i = 0; i < n; i++) {
        vec4 v;

        state = state * 6364136223846793005u + 1442695040888963407u;
        memcpy(&v, job->b + (state >> 32 & job->mask) * 4, sizeof v);
        sum += v;
    }
    sink = sum[0] + sum[1] + sum[2] + sum[3];
}

static void measure_lookups(struct spin_pool *pool, float *block, struct bench_ceilings *out)
{
    static const size_t mib[BENCH_TABLES] = {2, 32, 128, 512};

    for (int i = 0; i < BENCH_TABLES; i++) {
        struct job job = {.work = look_up, .n = 8 << 20, .each = 1 << 17, .b = block};

        out->table_bytes[i] = mib[i] << 20;
        job.mask = out->table_bytes[i] / 16 - 1;
        out->table_lookups[i] = best(pool, &job);
    }
}

double bench_lookups(const struct bench_ceilings *c, size_t bytes)
{
    int at = 0;

    while (at + 1 < BENCH_TABLES && c->table_bytes[at] < bytes)
        at++;
    return c->table_lookups[at];
}

spin_status bench_ceilings(int n_threads, struct bench_ceilings *out)
{
    struct spin_pool *pool = NULL;
    size_t bytes = 3 * stream_bytes + 4096;
    void *block = NULL;
    spin_status status;

    memset(out, 0, sizeof *out);
    SPIN_TRY(spin_pool_create(n_threads, &pool));
    SPIN_TRY_OUT(spin_pages_reserve(bytes, &block));
    memset(block, 0, bytes);
    measure_fma(pool, out);
    measure_streams(pool, block, out);
    measure_lookups(pool, block, out);
out:
    spin_pages_release(block);
    spin_pool_free(pool);
    return status;
}
