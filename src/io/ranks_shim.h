/* What ranks.c and the shared object behind it, which is linked with MPI, agree on. Plain C types
 * only. */
#pragma once

#include <stddef.h>

#define SPIN_RANKS_SHIM_ABI 2
#define SPIN_RANKS_SHIM_SYMBOL "spin_ranks_shim_table"

#define SPIN_MAX_RANKS 4096

/* Bytes to or from another rank. Messages between two ranks arrive in the order in which they are
 * listed. */
struct spin_message {
    int peer;
    int receive; /* else: send */
    void *at;
    size_t bytes;
};

enum { SPIN_RANKS_DONE, SPIN_RANKS_NOTICE, SPIN_RANKS_BROKEN };
/* Numbers that can be summed. */
enum { SPIN_SUM_F32, SPIN_SUM_U32, SPIN_SUM_F64 };

struct spin_ranks_shim {
    int abi;
    /* 0 with why. */
    int (*start)(int *rank, int *n, char *why, size_t n_why);
    /* All messages, at once. NOTICE: another rank has sent a notice, and what is under way is given
     * up. BROKEN with why. */
    int (*exchange)(const struct spin_message *message, size_t n, char *why, size_t n_why);
    /* at [n], numbers of a kind: their sums over all ranks take their place. Ends as exchange()
     * does. */
    int (*sum)(void *at, size_t n, int kind, char *why, size_t n_why);
    /* A notice to all other ranks, at most once: it is not waited for. */
    void (*notify)(void *notice, size_t bytes);
    /* A notice that has arrived, and from whom; 0: none. */
    int (*heed)(int *from, void *notice, size_t bytes);
    void (*stop)(void);      /* all ranks do */
    void (*abort)(int code); /* ends the processes of all ranks */
};

extern const struct spin_ranks_shim spin_ranks_shim_table;
