/* The interface between ranks.c and its shared object, which is linked with MPI. Plain C types
 * only. */
#pragma once

#include <stddef.h>

#define SPIN_RANKS_SHIM_ABI 2
#define SPIN_RANKS_SHIM_SYMBOL "spin_ranks_shim_table"

#define SPIN_MAX_RANKS 4096

/* Bytes to or from another rank. Messages between two ranks arrive in list order. */
struct spin_message {
    int peer;
    int receive; /* else send */
    void *at;
    size_t bytes;
};

enum { SPIN_RANKS_DONE, SPIN_RANKS_NOTICE, SPIN_RANKS_BROKEN };
/* Types that can be summed. */
enum { SPIN_SUM_F32, SPIN_SUM_U32, SPIN_SUM_F64 };

struct spin_ranks_shim {
    int abi;
    /* Returns 0 and fills why on failure. */
    int (*start)(int *rank, int *n, char *why, size_t n_why);
    /* Send and receive all messages concurrently. NOTICE: another rank has sent a notice; pending
     * messages are abandoned. BROKEN: fills why. */
    int (*exchange)(const struct spin_message *message, size_t n, char *why, size_t n_why);
    /* Replace at[n], numbers of this type, by their sums over all ranks. Results as for
     * exchange(). */
    int (*sum)(void *at, size_t n, int kind, char *why, size_t n_why);
    /* Send a notice to all other ranks, at most once, without waiting for its delivery. */
    void (*notify)(void *notice, size_t bytes);
    /* Receive a notice; *from receives the sender's rank. Returns 0 if no notice has arrived. */
    int (*heed)(int *from, void *notice, size_t bytes);
    void (*stop)(void);      /* called by all ranks */
    void (*abort)(int code); /* ends the processes of all ranks */
};

extern const struct spin_ranks_shim spin_ranks_shim_table;
