/* The interface between ranks.c and its shared object, which is linked with MPI. Plain C types
 * only. */
#pragma once

#include <stddef.h>

#define SPIN_RANKS_SHIM_ABI 2
#define SPIN_RANKS_SHIM_SYMBOL "spin_ranks_shim_table"

#define SPIN_MAX_RANKS 4096

/* A message: bytes to send to another rank, or to receive from it. Messages from one rank to
 * another arrive in the order of the sender's list. */
struct spin_message {
    int peer;
    int receive; /* 1: receive; 0: send */
    void *at;
    size_t bytes;
};

enum { SPIN_RANKS_DONE, SPIN_RANKS_NOTICE, SPIN_RANKS_BROKEN };
/* Types that can be summed. */
enum { SPIN_SUM_F32, SPIN_SUM_U32, SPIN_SUM_F64 };

struct spin_ranks_shim {
    int abi;
    /* Join the other processes; *rank and *n receive the rank of this process and the number of
     * ranks. Returns 1; on failure 0, with the reason in `why`. */
    int (*start)(int *rank, int *n, char *why, size_t n_why);
    /* Send and receive all messages concurrently. Returns SPIN_RANKS_DONE if that succeeded;
     * SPIN_RANKS_NOTICE if another rank has sent a notice, in which case pending messages are
     * abandoned; SPIN_RANKS_BROKEN if MPI failed, with the reason in `why`. */
    int (*exchange)(const struct spin_message *message, size_t n, char *why, size_t n_why);
    /* Replace each of the n numbers at `at`, of type `kind`, by the sum of the ranks' numbers.
     * Returns the same codes as exchange(). */
    int (*sum)(void *at, size_t n, int kind, char *why, size_t n_why);
    /* Send a notice to all other ranks, at most once, without waiting for its delivery. */
    void (*notify)(void *notice, size_t bytes);
    /* Receive a notice; *from receives the sender's rank. Returns 0 if no notice has arrived. */
    int (*receive_notice)(int *from, void *notice, size_t bytes);
    void (*stop)(void);      /* ends the use of MPI; all ranks must call this */
    void (*abort)(int code); /* ends the processes of all ranks */
};

extern const struct spin_ranks_shim spin_ranks_shim_table;
