/* Parallel-for.  K: base threads */
#include <sched.h>
#include <signal.h>
#include <stdatomic.h>
#include <time.h>

#include "base/pool.h"
#include "tests/tap.h"

enum { MOST_TASKS = 5000, MOST_WORKERS = 64 };

struct tally {
    int n_workers, uneven;
    int plain[MOST_TASKS]; /* written by one task each, without atomics */
    atomic_int runs[MOST_TASKS];
    atomic_int busy[MOST_WORKERS]; /* tasks under way for a worker number: 0 or 1 */
    atomic_int last, wrong;        /* last: highest task handed out, loosely */
};

static void task(void *context, int number)
{
    struct tally *t = context;
    volatile double x = number;
    int worker = spin_pool_worker();

    if (worker < 0 || worker >= t->n_workers || atomic_fetch_add(&t->busy[worker], 1) != 0)
        atomic_fetch_add(&t->wrong, 1);
    for (int i = 0; i < (t->uneven && number % 7 == 0 ? 20000 : 10); i++)
        x = x * 1.000001;
    t->plain[number] += number + 1;
    atomic_fetch_add(&t->runs[number], 1);
    atomic_fetch_sub(&t->busy[worker], 1);
}

static struct tally tally;

static int run(struct spin_pool *pool, int n_tasks, int uneven)
{
    int good;

    memset(&tally, 0, sizeof tally);
    tally.n_workers = spin_pool_n_threads(pool);
    tally.uneven = uneven;
    spin_pool_run(pool, n_tasks, task, &tally);
    good = atomic_load(&tally.wrong) == 0;
    for (int i = 0; i < n_tasks; i++)
        good = good && atomic_load(&tally.runs[i]) == 1 && tally.plain[i] == i + 1;
    return good;
}

static void in_order(void *context, int number)
{
    int *next = context;

    if (*next == number)
        ++*next;
}

static void many(int n_threads)
{
    struct spin_pool *pool;
    int good = 1;

    if (!ok(spin_pool_create(n_threads, &pool) == SPIN_OK, "creates a pool of %d", n_threads))
        return;
    ok(spin_pool_n_threads(pool) == n_threads, "it has %d threads", n_threads);
    for (int i = 0; i < 40; i++)
        good = good && run(pool, i * 61 % MOST_TASKS, i % 2);
    ok(good, "%d threads: every task runs once, worker numbers are distinct", n_threads);
    ok(run(pool, MOST_TASKS, 1), "%d threads: many uneven tasks", n_threads);
    ok(run(pool, 1, 0) && run(pool, 0, 0), "%d threads: one task, and none", n_threads);
    spin_pool_free(pool);
}

static void tiny(void *context, int number) { ((int *)context)[number]++; }

/* Thousands of jobs of a few tasks, some after a pause long enough for workers to fall asleep. */
static void bursts(int n_threads)
{
    enum { JOBS = 4000, TASKS = 5 };
    int count[TASKS] = {0}, good = 1;
    struct spin_pool *pool;

    if (spin_pool_create(n_threads, &pool) != SPIN_OK) {
        ok(0, "creates a pool");
        return;
    }
    for (int i = 0; i < JOBS; i++) {
        spin_pool_run(pool, TASKS, tiny, count);
        for (int k = 0; k < TASKS; k++)
            good = good && count[k] == i + 1;
        if (i % 400 == 0) {
            struct timespec pause = {0, 1000000};

            nanosleep(&pause, NULL);
        }
    }
    ok(good, "%d threads: %d small jobs, each complete when run returns", n_threads, JOBS);
    spin_pool_free(pool);
}

struct masks {
    atomic_int at_once;
    sigset_t of[2];
};

static void look_at_mask(void *context, int number)
{
    struct masks *m = context;

    (void)number;
    pthread_sigmask(SIG_BLOCK, NULL, &m->of[spin_pool_worker()]);
    atomic_fetch_add(&m->at_once, 1);
    while (atomic_load(&m->at_once) < 2) /* so each thread takes one */
        sched_yield();
}

/* An interrupt is for the thread that runs the command; a read of a file that was cut is a signal
 * in the reading one. */
static void signals(void)
{
    static struct masks m;
    struct spin_pool *pool;

    if (spin_pool_create(2, &pool) != SPIN_OK)
        exit(1);
    spin_pool_run(pool, 2, look_at_mask, &m);
    ok(!sigismember(&m.of[0], SIGINT) && sigismember(&m.of[1], SIGINT) &&
           sigismember(&m.of[1], SIGTERM),
       "a worker takes no interrupt");
    ok(!sigismember(&m.of[0], SIGBUS) && !sigismember(&m.of[1], SIGBUS),
       "what it reads from a file that is cut reaches it");
    spin_pool_free(pool);
}

struct nest {
    struct spin_pool *pool;
    atomic_int n, wrong;
};

static void inner(void *context, int number)
{
    (void)number;
    atomic_fetch_add(&((struct nest *)context)->n, 1);
}

static void outer(void *context, int number)
{
    struct nest *nest = context;
    int worker = spin_pool_worker();

    spin_pool_run(nest->pool, 1 + number % 7, inner, nest);
    if (spin_pool_worker() != worker)
        atomic_fetch_add(&nest->wrong, 1);
}

static void nested(void)
{
    static struct nest nest;

    spin_pool_create(3, &nest.pool);
    spin_pool_run(nest.pool, 700, outer, &nest);
    ok(nest.n == 100 * 28 && nest.wrong == 0, "a task runs tasks of its own on the same pool");
    spin_pool_free(nest.pool);
}

TAP_MAIN
{
    struct spin_pool *pool;
    cpu_set_t set;
    int next = 0;

    signals();
    many(1);
    many(2);
    many(3);
    many(16);
    bursts(2);
    bursts(8);
    nested();
    ok(run(NULL, 100, 0), "without a pool the caller does it all");
    spin_pool_run(NULL, 100, in_order, &next);
    ok(next == 100, "in order");
    next = 0;
    spin_pool_create(1, &pool);
    spin_pool_run(pool, 100, in_order, &next);
    ok(next == 100, "in order with one thread");
    spin_pool_free(pool);

    sched_getaffinity(0, sizeof set, &set);
    ok(spin_pool_create(0, &pool) == SPIN_OK && spin_pool_n_threads(pool) == CPU_COUNT(&set),
       "0 threads: as many as cores");
    spin_pool_free(pool);
    ok(spin_pool_create(-1, &pool) == SPIN_E_USAGE && !pool, "refuses a negative number");
    ok(spin_pool_create(1000000, &pool) == SPIN_E_USAGE && !pool, "refuses an absurd number");
    spin_pool_free(NULL);
}
