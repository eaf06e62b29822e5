/* Threads: one pool, parallel-for over numbered tasks.
 *
 * Results never depend on the number of threads: the caller cuts the work into tasks whose number
 * depends only on the problem, every task writes its own place, and sums over tasks are taken in
 * task order. Tasks are handed out by a counter, in order. */
#pragma once

#include "spin.h"

struct spin_pool;

/* n_threads 0: one per core this process may use. The calling thread counts as one of them. */
spin_status spin_pool_create(int n_threads, struct spin_pool **out);
void spin_pool_free(struct spin_pool *pool);
int spin_pool_n_threads(const struct spin_pool *pool);

/* Run fn(context, task) for task 0..n_tasks-1. Returns when all are done. pool NULL, or fn calls it
 * on the same pool: run here, one by one. Other threads may not call it meanwhile. */
typedef void (*spin_task_fn)(void *context, int task);
void spin_pool_run(struct spin_pool *pool, int n_tasks, spin_task_fn fn, void *context);
/* The same of rows 0..n-1 in pieces: fn(context, first, end). Every piece but the last has so many.
 */
typedef void (*spin_rows_fn)(void *context, size_t first, size_t end);
void spin_pool_rows(struct spin_pool *pool, size_t n, size_t piece, spin_rows_fn fn, void *context);
/* For fn: which thread of the pool runs it, 0..n_threads-1. */
int spin_pool_worker(void);
