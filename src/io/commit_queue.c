/* A queue of files and a few threads that commit them: what they do is mostly to wait for the disk. */
#include "io/commit_queue.h"

#include <pthread.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>

#include "base/err.h"
#include "base/mem.h"

enum { THREADS = 2, ROOM = 4 };

struct spin_commit_queue {
    pthread_mutex_t lock;
    pthread_cond_t changed;
    pthread_t thread[THREADS];
    int n_threads;
    bool stop;
    struct spin_out waiting[ROOM];
    int n_waiting, n_running;
    spin_status status; /* the first failure */
    char reason[1024];
};

static void run_one(struct spin_commit_queue *c)
{
    struct spin_out out = c->waiting[0];
    bool wanted = c->status == SPIN_OK;
    spin_status status = SPIN_OK;

    memmove(c->waiting, c->waiting + 1, (size_t)--c->n_waiting * sizeof out);
    c->n_running++;
    pthread_mutex_unlock(&c->lock);
    if (wanted)
        status = spin_out_commit(&out);
    else
        spin_out_abandon(&out);
    pthread_mutex_lock(&c->lock);
    c->n_running--;
    if (status != SPIN_OK && c->status == SPIN_OK) {
        c->status = status;
        snprintf(c->reason, sizeof c->reason, "%s", spin_last_error());
    }
    pthread_cond_broadcast(&c->changed);
}

static void *work(void *context)
{
    struct spin_commit_queue *c = context;

    pthread_mutex_lock(&c->lock);
    for (;;) {
        if (c->n_waiting > 0)
            run_one(c);
        else if (c->stop)
            break;
        else
            pthread_cond_wait(&c->changed, &c->lock);
    }
    pthread_mutex_unlock(&c->lock);
    return NULL;
}

/* Signals are the caller's: its threads take none. */
static void start_threads(struct spin_commit_queue *c)
{
    sigset_t all, before;

    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    while (c->n_threads < THREADS && pthread_create(&c->thread[c->n_threads], NULL, work, c) == 0)
        c->n_threads++;
    pthread_sigmask(SIG_SETMASK, &before, NULL);
}

spin_status spin_commit_queue_create(struct spin_commit_queue **out)
{
    struct spin_commit_queue *c = NULL;

    SPIN_TRY(spin_alloc(1, sizeof *c, (void **)&c));
    pthread_mutex_init(&c->lock, NULL);
    pthread_cond_init(&c->changed, NULL);
    start_threads(c);
    *out = c;
    return SPIN_OK;
}

static spin_status status_of(const struct spin_commit_queue *c)
{
    return c->status == SPIN_OK ? SPIN_OK : spin_fail(c->status, "%s", c->reason);
}

spin_status spin_commit_queue_add(struct spin_commit_queue *c, struct spin_out *out)
{
    spin_status status;

    if (c->n_threads == 0)
        return spin_out_commit(out);
    pthread_mutex_lock(&c->lock);
    while (c->n_waiting == ROOM)
        pthread_cond_wait(&c->changed, &c->lock);
    status = status_of(c);
    if (status == SPIN_OK) {
        c->waiting[c->n_waiting++] = *out;
        memset(out, 0, sizeof *out);
        pthread_cond_broadcast(&c->changed);
    }
    pthread_mutex_unlock(&c->lock);
    if (status != SPIN_OK)
        spin_out_abandon(out);
    return status;
}

spin_status spin_commit_queue_wait(struct spin_commit_queue *c)
{
    spin_status status;

    pthread_mutex_lock(&c->lock);
    while (c->n_waiting + c->n_running > 0)
        pthread_cond_wait(&c->changed, &c->lock);
    status = status_of(c);
    pthread_mutex_unlock(&c->lock);
    return status;
}

void spin_commit_queue_free(struct spin_commit_queue *c)
{
    if (!c)
        return;
    pthread_mutex_lock(&c->lock);
    c->stop = true;
    pthread_cond_broadcast(&c->changed);
    pthread_mutex_unlock(&c->lock);
    for (int i = 0; i < c->n_threads; i++)
        pthread_join(c->thread[i], NULL);
    pthread_cond_destroy(&c->changed);
    pthread_mutex_destroy(&c->lock);
    free(c);
}
