/* A thread pool with parallel-for.
 *
 * A job is one call of spin_pool_run(). One 64-bit word contains the number of the job (high half)
 * and the number of its tasks that no thread has taken yet (low half). A thread takes a task by
 * decrementing the word with compare-and-swap. Since a job does not end before all tasks that were
 * taken are finished, a thread that has taken a task can read the job's fields without
 * synchronisation. Since the word includes the job's number, a thread that was delayed before its
 * compare-and-swap cannot take a task of a later job by mistake. A job ends when `pending`, the
 * number of unfinished tasks, is zero: sleeping threads do not delay its end.
 *
 * Between jobs, workers poll the word for some microseconds before they sleep, because the
 * operations of a training iteration follow each other closely. If there are more threads than
 * cores, workers sleep immediately. */
#include "base/pool.h"

#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "base/log.h"
#include "base/mem.h"

static const double spin_s = 40e-6;
enum { MAX_THREADS = 1024 };

struct worker {
    struct spin_pool *pool;
    pthread_t thread;
    int number;
};

struct spin_pool {
    /* Number of threads including the caller; number of workers started. */
    int n_threads, n_started;
    bool patient; /* workers poll for a while before they sleep */

    /* The current job. The caller of spin_pool_run() writes these members while no task is
     * taken. */
    spin_task_fn fn;
    void *context;
    int n_tasks;

    /* (number of the job) << 32 | (number of its tasks that no thread has taken yet) */
    _Alignas(64) atomic_uint_least64_t word;
    _Alignas(64) atomic_int pending;  /* number of unfinished tasks of the job */
    _Alignas(64) atomic_int sleepers; /* number of workers that wait on `work` */
    atomic_int caller_sleeps;         /* 1: the caller of spin_pool_run() waits on `done` */
    atomic_int stop;

    pthread_mutex_t lock;
    pthread_cond_t work, done;
    struct worker *worker; /* [n_threads - 1] the threads other than the caller */
};

static void relax_cpu(void)
{
#if defined(__x86_64__) || defined(__i386__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    __asm__ volatile("yield");
#endif
}

static uint32_t tasks_left(struct spin_pool *pool) { return (uint32_t)atomic_load(&pool->word); }

static _Thread_local int worker_number; /* the result of spin_pool_worker() in this thread */

int spin_pool_worker(void) { return worker_number; }

/* Take and run tasks until none is left. worker_number is restored afterwards, since the caller may
 * itself run as a task of another pool. */
static void run_tasks(struct spin_pool *pool, int number)
{
    int before = worker_number;
    uint64_t word;

    worker_number = number;
    while ((uint32_t)(word = atomic_load(&pool->word)) > 0) {
        uint32_t left = (uint32_t)word;

        if (!atomic_compare_exchange_weak(&pool->word, &word, word - 1))
            continue;
        pool->fn(pool->context, pool->n_tasks - (int)left);
        if (atomic_fetch_sub(&pool->pending, 1) == 1 && atomic_load(&pool->caller_sleeps)) {
            pthread_mutex_lock(&pool->lock);
            pthread_cond_signal(&pool->done);
            pthread_mutex_unlock(&pool->lock);
        }
    }
    worker_number = before;
}

/* Wait until there may be work; returns false if the pool is being freed. */
static bool wait_for_work(struct spin_pool *pool)
{
    if (pool->patient) {
        double until = spin_now_s() + spin_s;

        do {
            for (int i = 0; i < 32; i++) {
                if (tasks_left(pool) > 0)
                    return true;
                relax_cpu();
            }
        } while (spin_now_s() < until);
    }
    pthread_mutex_lock(&pool->lock);
    /* Increment `sleepers` before reading the word: the caller writes the word before it reads
     * `sleepers`, so that either this thread sees the new job or the caller wakes it. */
    atomic_fetch_add(&pool->sleepers, 1);
    while (tasks_left(pool) == 0 && !atomic_load(&pool->stop))
        pthread_cond_wait(&pool->work, &pool->lock);
    atomic_fetch_sub(&pool->sleepers, 1);
    pthread_mutex_unlock(&pool->lock);
    return !atomic_load(&pool->stop);
}

static void *worker_main(void *argument)
{
    struct worker *worker = argument;

    while (wait_for_work(worker->pool))
        run_tasks(worker->pool, worker->number);
    return NULL;
}

#ifdef __EMSCRIPTEN__
/* Web pages have no threads: the caller runs all tasks, whatever n_threads is. */
enum { ALONE = 1 };

static int count_cores(void) { return 1; }
#else
enum { ALONE = 0 };

static int count_cores(void)
{
    cpu_set_t set;
    long online;

    if (sched_getaffinity(0, sizeof set, &set) == 0 && CPU_COUNT(&set) > 0)
        return CPU_COUNT(&set);
    online = sysconf(_SC_NPROCESSORS_ONLN);
    return online > 0 ? (int)online : 1;
}
#endif

/* Start the workers. They block signals, so that the thread that runs the command handles
 * interrupts. */
static spin_status start_workers(struct spin_pool *pool)
{
    sigset_t all, old;
    int error = 0;

    sigfillset(&all);
    /* Do not block SIGBUS, since any thread may read a mapped file that was truncated; see
     * io/watch.c. */
    sigdelset(&all, SIGBUS);
    pthread_sigmask(SIG_BLOCK, &all, &old);
    for (int i = 0; i < pool->n_threads - 1 && error == 0; i++) {
        pool->worker[i].pool = pool;
        pool->worker[i].number = i + 1;
        error = pthread_create(&pool->worker[i].thread, NULL, worker_main, &pool->worker[i]);
        if (error == 0)
            pool->n_started++;
    }
    pthread_sigmask(SIG_SETMASK, &old, NULL);
    if (error != 0)
        return spin_fail(SPIN_E_MEMORY, "cannot start %d threads: %s", pool->n_threads,
                         strerror(error));
    return SPIN_OK;
}

spin_status spin_pool_create(int n_threads, struct spin_pool **out)
{
    struct spin_pool *pool;
    spin_status status;

    *out = NULL;
    if (n_threads < 0 || n_threads > MAX_THREADS)
        return spin_misuse("cannot use %d threads: expected 0 to %d", n_threads, MAX_THREADS);
    if (n_threads == 0 || ALONE) {
        n_threads = count_cores();
        if (n_threads > MAX_THREADS)
            n_threads = MAX_THREADS;
    }
    pool = aligned_alloc(_Alignof(struct spin_pool), sizeof *pool);
    if (!pool)
        return spin_fail(SPIN_E_MEMORY, "not enough memory for %zu bytes", sizeof *pool);
    memset(pool, 0, sizeof *pool);
    pool->n_threads = n_threads;
    pool->patient = n_threads <= count_cores();
    pthread_mutex_init(&pool->lock, NULL);
    pthread_cond_init(&pool->work, NULL);
    pthread_cond_init(&pool->done, NULL);
    status = spin_alloc((size_t)n_threads, sizeof *pool->worker, (void **)&pool->worker);
    if (status == SPIN_OK)
        status = start_workers(pool);
    if (status != SPIN_OK) {
        spin_pool_free(pool);
        return status;
    }
    *out = pool;
    return SPIN_OK;
}

void spin_pool_free(struct spin_pool *pool)
{
    if (!pool)
        return;
    pthread_mutex_lock(&pool->lock);
    atomic_store(&pool->stop, 1);
    pthread_cond_broadcast(&pool->work);
    pthread_mutex_unlock(&pool->lock);
    for (int i = 0; i < pool->n_started; i++)
        pthread_join(pool->worker[i].thread, NULL);
    pthread_cond_destroy(&pool->done);
    pthread_cond_destroy(&pool->work);
    pthread_mutex_destroy(&pool->lock);
    free(pool->worker);
    SPIN_ALIGNED_FREE(pool);
}

int spin_pool_n_threads(const struct spin_pool *pool) { return pool ? pool->n_threads : 1; }

static void wait_for_end(struct spin_pool *pool)
{
    if (pool->patient) {
        double until = spin_now_s() + spin_s;

        do {
            for (int i = 0; i < 32; i++) {
                if (atomic_load(&pool->pending) == 0)
                    return;
                relax_cpu();
            }
        } while (spin_now_s() < until);
    }
    pthread_mutex_lock(&pool->lock);
    atomic_store(&pool->caller_sleeps, 1);
    while (atomic_load(&pool->pending) > 0)
        pthread_cond_wait(&pool->done, &pool->lock);
    atomic_store(&pool->caller_sleeps, 0);
    pthread_mutex_unlock(&pool->lock);
}

void spin_pool_run(struct spin_pool *pool, int n_tasks, spin_task_fn fn, void *context)
{
    uint64_t job;
    int before = worker_number;
    /* True if a task of this pool called this function; the nested job then runs on this thread. */
    bool busy = pool && atomic_load(&pool->pending) > 0;

    if (!pool || pool->n_threads == 1 || n_tasks <= 1 || busy) {
        worker_number = busy ? before : 0;
        for (int task = 0; task < n_tasks; task++)
            fn(context, task);
        worker_number = before;
        return;
    }
    pool->fn = fn;
    pool->context = context;
    pool->n_tasks = n_tasks;
    atomic_store(&pool->pending, n_tasks);
    job = (atomic_load(&pool->word) >> 32) + 1;
    atomic_store(&pool->word, job << 32 | (uint32_t)n_tasks);
    if (atomic_load(&pool->sleepers) > 0) {
        pthread_mutex_lock(&pool->lock);
        pthread_cond_broadcast(&pool->work);
        pthread_mutex_unlock(&pool->lock);
    }
    run_tasks(pool, 0);
    wait_for_end(pool);
}

struct pieces {
    size_t n, piece;
    spin_rows_fn fn;
    void *context;
};

static void run_piece(void *context, int task)
{
    const struct pieces *p = context;
    size_t first = (size_t)task * p->piece;

    p->fn(p->context, first, p->n - first < p->piece ? p->n : first + p->piece);
}

void spin_pool_rows(struct spin_pool *pool, size_t n, size_t piece, spin_rows_fn fn, void *context)
{
    struct pieces p = {n, piece, fn, context};

    spin_pool_run(pool, (int)((n + piece - 1) / piece), run_piece, &p);
}
