/* A thread pool with parallel-for over numbered tasks.
 *
 * Results do not depend on the number of threads: callers split the work into a number of tasks
 * that depends on the problem only, and every task writes to its own output. To sum over tasks, the
 * caller adds their results in task order. Tasks are started in the order of their numbers. */
#pragma once

#include "spin.h"

struct spin_pool;

/* Create a pool of n_threads threads, including the calling thread; if n_threads is 0, one thread
 * per core that this process may use. */
spin_status spin_pool_create(int n_threads, struct spin_pool **out);
void spin_pool_free(struct spin_pool *pool);
int spin_pool_n_threads(const struct spin_pool *pool);

/* Run fn(context, task) for task 0..n_tasks-1 and wait for all of them. If pool is NULL, or if fn
 * itself calls this function with the same pool, the tasks run one by one in the calling thread.
 * Two threads must not use a pool at the same time. */
typedef void (*spin_task_fn)(void *context, int task);
void spin_pool_run(struct spin_pool *pool, int n_tasks, spin_task_fn fn, void *context);
/* Do the same for rows 0..n-1, in tasks of `piece` rows (the last may have fewer): fn(context,
 * first, end) processes rows first..end-1. */
typedef void (*spin_rows_fn)(void *context, size_t first, size_t end);
void spin_pool_rows(struct spin_pool *pool, size_t n, size_t piece, spin_rows_fn fn, void *context);
/* Returns the index of the calling thread in the pool, 0..n_threads-1. Call this only within a
 * task. */
int spin_pool_worker(void);
