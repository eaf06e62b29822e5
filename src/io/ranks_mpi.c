/* The implementation of ranks_shim.h with MPI. All calls come from the same thread. */
#include "io/ranks_shim.h"

#include <mpi.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

/* Maximum number of bytes in one MPI message. Longer messages are split, since MPI counts are of
 * type int. */
static const size_t piece_bytes = (size_t)1 << 30;
enum { TAG_BYTES, TAG_NOTICE, EAGER = 2000 };

static int n_ranks, own_rank;
static MPI_Request notice_request[SPIN_MAX_RANKS];

static int start(int *rank, int *n, char *why, size_t n_why)
{
    int given;

    if (MPI_Init_thread(NULL, NULL, MPI_THREAD_FUNNELED, &given) != MPI_SUCCESS) {
        snprintf(why, n_why, "MPI cannot be initialised");
        return 0;
    }
    if (given < MPI_THREAD_FUNNELED) {
        snprintf(why, n_why, "this MPI does not support threads");
        return 0;
    }
    MPI_Comm_set_errhandler(MPI_COMM_WORLD, MPI_ERRORS_RETURN);
    MPI_Comm_rank(MPI_COMM_WORLD, &own_rank);
    MPI_Comm_size(MPI_COMM_WORLD, &n_ranks);
    if (n_ranks > SPIN_MAX_RANKS) {
        snprintf(why, n_why, "%d processes, but at most %d are supported", n_ranks, SPIN_MAX_RANKS);
        return 0;
    }
    *rank = own_rank;
    *n = n_ranks;
    return 1;
}

static int fail_mpi(int code, char *why, size_t n_why)
{
    char text[MPI_MAX_ERROR_STRING];
    int length;

    MPI_Error_string(code, text, &length);
    snprintf(why, n_why, "%s", text);
    return SPIN_RANKS_BROKEN;
}

static size_t pieces_of(size_t bytes) { return (bytes + piece_bytes - 1) / piece_bytes; }

static int post_message(const struct spin_message *m, MPI_Request *request, size_t *n)
{
    for (size_t first = 0; first < m->bytes; first += piece_bytes) {
        size_t left = m->bytes - first;
        int count = (int)(left < piece_bytes ? left : piece_bytes), code;
        char *at = (char *)m->at + first;

        code =
            m->receive
                ? MPI_Irecv(at, count, MPI_BYTE, m->peer, TAG_BYTES, MPI_COMM_WORLD, &request[*n])
                : MPI_Isend(at, count, MPI_BYTE, m->peer, TAG_BYTES, MPI_COMM_WORLD, &request[*n]);
        if (code != MPI_SUCCESS)
            return code;
        ++*n;
    }
    return MPI_SUCCESS;
}

static int has_notice(void)
{
    int there = 0;

    return MPI_Iprobe(MPI_ANY_SOURCE, TAG_NOTICE, MPI_COMM_WORLD, &there, MPI_STATUS_IGNORE) ==
               MPI_SUCCESS &&
           there;
}

/* Wait between two polls. turn: number of polls so far. After EAGER / 10 polls, yield the
 * processor, since several ranks may share it; after EAGER polls, sleep for 0.05 ms, growing to 1
 * ms. */
static void wait_between_polls(int turn)
{
    int late = turn - EAGER;
    struct timespec nap = {.tv_nsec = late < 380 ? 50000 + 2500 * late : 1000000};

    if (late > 0)
        nanosleep(&nap, NULL);
    else if (turn > EAGER / 10)
        sched_yield();
}

static int wait_for(MPI_Request *request, size_t n, char *why, size_t n_why)
{
    for (int turn = 0;; turn += turn <= EAGER + 380) {
        int done = 0, code = MPI_Testall((int)n, request, &done, MPI_STATUSES_IGNORE);

        if (code != MPI_SUCCESS)
            return fail_mpi(code, why, n_why);
        if (done)
            return SPIN_RANKS_DONE;
        if (turn > EAGER / 10 && has_notice())
            return SPIN_RANKS_NOTICE;
        wait_between_polls(turn);
    }
}

static int exchange(const struct spin_message *message, size_t n, char *why, size_t n_why)
{
    MPI_Request *request;
    size_t most = 0, posted = 0;
    int code = MPI_SUCCESS, end;

    for (size_t i = 0; i < n; i++)
        most += pieces_of(message[i].bytes);
    request = malloc((most + 1) * sizeof *request);
    if (!request) {
        snprintf(why, n_why, "out of memory");
        return SPIN_RANKS_BROKEN;
    }
    for (int receive = 1; receive >= 0; receive--)
        for (size_t i = 0; i < n && code == MPI_SUCCESS; i++)
            if (!message[i].receive == !receive)
                code = post_message(&message[i], request, &posted);
    end = code == MPI_SUCCESS ? wait_for(request, posted, why, n_why) : fail_mpi(code, why, n_why);
    for (size_t i = 0; i < posted && end != SPIN_RANKS_DONE; i++)
        if (request[i] != MPI_REQUEST_NULL) {
            MPI_Cancel(&request[i]);
            MPI_Request_free(&request[i]);
        }
    free(request);
    return end;
}

/* MPI may still access `at` after a failed sum, so the caller must not free it; the process ends
 * soon after. */
static int sum(void *at, size_t n, int kind, char *why, size_t n_why)
{
    MPI_Datatype type = kind == SPIN_SUM_F32   ? MPI_FLOAT
                        : kind == SPIN_SUM_U32 ? MPI_UINT32_T
                                               : MPI_DOUBLE;
    size_t size = kind == SPIN_SUM_F64 ? 8 : 4, most = piece_bytes / size;

    for (size_t first = 0; first < n; first += most) {
        int count = (int)(n - first < most ? n - first : most), end;
        MPI_Request request;
        int code = MPI_Iallreduce(MPI_IN_PLACE, (char *)at + first * size, count, type, MPI_SUM,
                                  MPI_COMM_WORLD, &request);

        end = code == MPI_SUCCESS ? wait_for(&request, 1, why, n_why) : fail_mpi(code, why, n_why);
        if (end != SPIN_RANKS_DONE)
            return end;
    }
    return SPIN_RANKS_DONE;
}

static void notify(void *notice, size_t bytes)
{
    for (int i = 0; i < n_ranks; i++)
        if (i != own_rank)
            MPI_Isend(notice, (int)bytes, MPI_BYTE, i, TAG_NOTICE, MPI_COMM_WORLD,
                      &notice_request[i]);
}

static int receive_notice(int *from, void *notice, size_t bytes)
{
    MPI_Status status;
    int there = 0;

    if (MPI_Iprobe(MPI_ANY_SOURCE, TAG_NOTICE, MPI_COMM_WORLD, &there, &status) != MPI_SUCCESS ||
        !there)
        return 0;
    *from = status.MPI_SOURCE;
    return MPI_Recv(notice, (int)bytes, MPI_BYTE, *from, TAG_NOTICE, MPI_COMM_WORLD,
                    MPI_STATUS_IGNORE) == MPI_SUCCESS;
}

static void stop(void) { MPI_Finalize(); }

static void end_all(int code) { MPI_Abort(MPI_COMM_WORLD, code); }

const struct spin_ranks_shim spin_ranks_shim_table = {
    .abi = SPIN_RANKS_SHIM_ABI,
    .start = start,
    .exchange = exchange,
    .sum = sum,
    .notify = notify,
    .receive_notice = receive_notice,
    .stop = stop,
    .abort = end_all,
};
