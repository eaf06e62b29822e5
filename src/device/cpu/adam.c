/* Adam on the CPU: one pass over p, g, m and v that also clears g. */
#include "device/cpu/cpu.h"

#include "math/adam.h"

#if defined(__SSE__)
#include <xmmintrin.h>
#endif

enum { CHUNK = 1 << 15 };

struct job {
    size_t n;
    struct spin_adam_step step;
    float *p, *g, *m, *v;
};

/* Moments of entries that are no longer touched fade into denormal numbers, and stay there: 0.9
 * times the smallest one rounds back to it. Arithmetic on them is a hundred times slower, so they
 * count as zero here. On machines without the switch nothing but speed changes. */
static unsigned denormals_off(void)
{
#if defined(__SSE__)
    unsigned before = _mm_getcsr();

    _mm_setcsr(before | 0x8040u); /* flush to zero, denormals are zero */
    return before;
#else
    return 0;
#endif
}

static void denormals_back(unsigned before)
{
#if defined(__SSE__)
    _mm_setcsr(before);
#else
    (void)before;
#endif
}

static void step_range(struct spin_adam_step step, size_t n, float *restrict p, float *restrict g,
                       float *restrict m, float *restrict v)
{
    for (size_t i = 0; i < n; i++) {
        spin_adam_one(step, g[i], &p[i], &m[i], &v[i]);
        g[i] = 0.0f;
    }
}

static void adam_task(void *context, int task, int worker)
{
    const struct job *job = context;
    size_t first = (size_t)task * CHUNK;
    size_t n = job->n - first < CHUNK ? job->n - first : CHUNK;
    unsigned before = denormals_off();

    (void)worker;
    step_range(job->step, n, job->p + first, job->g + first, job->m + first, job->v + first);
    denormals_back(before);
}

void SPIN_CPU(adam)(struct spin_device *d, size_t n, float *p, float *g, float *m, float *v,
                    double lr, int64_t step)
{
    struct job job = {.n = n, .step = spin_adam_step_of(lr, step), .p = p, .g = g, .m = m, .v = v};

    spin_pool_run(spin_cpu_pool(d), (int)((n + CHUNK - 1) / CHUNK), adam_task, &job);
}
