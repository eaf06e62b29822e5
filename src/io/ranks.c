/* Communication between ranks through the MPI shim, which is loaded only if there are several
 * ranks. */
#include "io/ranks.h"

#include <time.h>
#include <unistd.h>

#include "base/base.h"
#include "base/shim.h"

enum { TEXT = 1000 };
/* Maximum time to wait until all other ranks have noticed a failure. */
static const double patience_s = 5;

struct notice {
    int status, heard; /* heard: 1 if the sender failed only because another rank had failed */
    char text[TEXT];
};

static const struct spin_ranks_shim *shim;
static int own_rank, n_ranks = 1;
static bool heard; /* this rank fails only because another rank failed */
/* spin_ranks_agree() reported a failure to all ranks, and each rank ends by itself. */
static bool agreed;
static bool speaker;             /* this rank prints the error message */
static struct notice last_words; /* static, since MPI may read it after notify() has returned */
static uint64_t sent_bytes;
static double waited_s;

int spin_rank(void) { return own_rank; }

int spin_n_ranks(void) { return n_ranks; }

bool spin_ranks_agreed(void) { return n_ranks == 1 || agreed; }

void spin_ranks_spent(uint64_t *bytes, double *seconds)
{
    *bytes = sent_bytes;
    *seconds = waited_s;
}

/* ---- Warnings ------------------------------------------------------------------------------- */

/* The warnings of this rank, as consecutive NUL-terminated texts without duplicates. Rank 0 prints
 * its own warnings immediately; at the end, it prints the warnings of other ranks that it has not
 * printed yet. */
static char *lines;
static size_t n_lines_bytes;

static bool is_recorded(const char *line)
{
    for (const char *at = lines; at && at < lines + n_lines_bytes; at += strlen(at) + 1)
        if (strcmp(at, line) == 0)
            return true;
    return false;
}

/* Receives each warning from the log. Returns whether the log is to print the line now. */
static bool record_warning(const char *line)
{
    enum { MOST = 1 << 16 };
    size_t n = strlen(line) + 1;
    void *grown;

    if (n_lines_bytes + n > MOST || is_recorded(line))
        return own_rank == 0;
    grown = realloc(lines, n_lines_bytes + n);
    if (!grown)
        return true;
    lines = grown;
    memcpy(lines + n_lines_bytes, line, n);
    n_lines_bytes += n;
    return own_rank == 0;
}

/* Let rank 0 print the warnings of the other ranks. */
static spin_status print_other_warnings(void)
{
    SPIN_FREED uint64_t *bytes = NULL;
    SPIN_FREED char *text = NULL;

    SPIN_TRY(spin_alloc((size_t)n_ranks, sizeof *bytes, (void **)&bytes));
    bytes[own_rank] = n_lines_bytes;
    SPIN_TRY(spin_ranks_gather(bytes, sizeof *bytes));
    for (int r = 1; r < n_ranks; r++) {
        struct spin_message m = {own_rank ? 0 : r, own_rank == 0, lines, bytes[r]};

        if ((own_rank != 0 && own_rank != r) || bytes[r] == 0)
            continue;
        if (own_rank == 0) {
            SPIN_TRY(spin_alloc(bytes[r] + 1, 1, (void **)&text));
            m.at = text;
        }
        SPIN_TRY(spin_ranks_exchange(&m, 1));
        for (size_t at = 0; text && at < bytes[r]; at += strlen(text + at) + 1)
            if (!is_recorded(text + at))
                spin_warn("%s", text + at);
        free(text);
        text = NULL;
    }
    return SPIN_OK;
}

/* ---- Joining the other ranks ---------------------------------------------------------------- */

/* Returns the value of the first of three environment variables that is set; -1 if none is. The
 * three are those that Open MPI, MPICH and Slurm, respectively, set for the processes of a job. */
static int read_environment(const char *const name[3])
{
    for (int i = 0; i < 3; i++) {
        const char *value = getenv(name[i]);

        if (value && *value)
            return atoi(value);
    }
    return -1;
}

int spin_ranks_env_rank(void)
{
    static const char *const place[3] = {"OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK"};
    static const char *const size[3] = {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_NTASKS"};

    return read_environment(size) > 1 ? read_environment(place) : -1;
}

spin_status spin_ranks_begin(void)
{
    static struct spin_shim where = {.file = "spin-mpi.so",
                                     .override = "SPIN_MPI_SHIM",
                                     .symbol = SPIN_RANKS_SHIM_SYMBOL,
                                     .abi = SPIN_RANKS_SHIM_ABI,
                                     .lacking =
                                         "cannot join the other processes: the shared object",
                                     .debian = "libopenmpi-dev"};
    char why[256] = "";

    if (spin_ranks_env_rank() < 0 || n_ranks > 1)
        return SPIN_OK;
    SPIN_TRY(spin_shim_load(&where, (const void **)&shim));
    if (!shim->start(&own_rank, &n_ranks, why, sizeof why))
        return spin_unsupported("cannot join the other processes: %s", why);
    /* Processes that are to cooperate must not continue separately: each would do all the work and
     * overwrite the files of the others. */
    if (n_ranks == 1)
        return spin_unsupported(
            "cannot join the other processes: MPI reports a single process, because "
            "spin-mpi.so was built with an MPI that differs from that of mpirun; "
            "use the same MPI for both");
    if (own_rank > 0)
        spin_log_set_level(-1);
    spin_log_set_sink(record_warning);
    return SPIN_OK;
}

/* ---- Messages ------------------------------------------------------------------------------- */

/* Wait for the notice of another rank's failure, and return its error. */
static spin_status wait_for_notice(void)
{
    struct notice notice;
    int from;

    while (!shim->receive_notice(&from, &notice, sizeof notice))
        ;
    heard = true;
    notice.text[TEXT - 1] = '\0';
    return spin_fail((spin_status)notice.status, "%s", notice.text);
}

static spin_status status_of(int end, const char *why)
{
    if (end == SPIN_RANKS_NOTICE)
        return wait_for_notice();
    return end == SPIN_RANKS_DONE
               ? SPIN_OK
               : spin_fail(SPIN_E_IO, "lost the connection to the other processes: %s", why);
}

spin_status spin_ranks_exchange(const struct spin_message *message, size_t n)
{
    char why[256] = "";
    double start = spin_now_s();
    int end;

    if (n_ranks == 1)
        return SPIN_OK;
    end = shim->exchange(message, n, why, sizeof why);
    for (size_t i = 0; i < n; i++)
        sent_bytes += message[i].receive ? 0 : message[i].bytes;
    waited_s += spin_now_s() - start;
    return status_of(end, why);
}

spin_status spin_ranks_sum(void *at, size_t n, int kind)
{
    char why[256] = "";
    double start = spin_now_s();
    int end;

    if (n_ranks == 1 || n == 0)
        return SPIN_OK;
    end = shim->sum(at, n, kind, why, sizeof why);
    sent_bytes += n * (kind == SPIN_SUM_F64 ? 8 : 4);
    waited_s += spin_now_s() - start;
    return status_of(end, why);
}

spin_status spin_ranks_gather(void *rows, size_t bytes)
{
    SPIN_FREED struct spin_message *m = NULL;
    size_t n = 0;

    if (n_ranks == 1)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(2 * (size_t)n_ranks, sizeof *m, (void **)&m));
    for (int r = 0; r < n_ranks; r++) {
        if (r == own_rank)
            continue;
        m[n++] = (struct spin_message){r, 1, (char *)rows + (size_t)r * bytes, bytes};
        m[n++] = (struct spin_message){r, 0, (char *)rows + (size_t)own_rank * bytes, bytes};
    }
    return spin_ranks_exchange(m, n);
}

spin_status spin_ranks_merge(void *rows, size_t n, size_t bytes, const int *owner)
{
    SPIN_FREED struct spin_message *m = NULL;
    size_t k = 0;

    if (n_ranks == 1 || n == 0)
        return SPIN_OK;
    SPIN_TRY(spin_alloc(n * (size_t)n_ranks, sizeof *m, (void **)&m));
    for (size_t i = 0; i < n; i++) {
        char *at = (char *)rows + i * bytes;

        if (owner[i] != own_rank)
            m[k++] = (struct spin_message){owner[i], 1, at, bytes};
        for (int r = 0; owner[i] == own_rank && r < n_ranks; r++)
            if (r != own_rank)
                m[k++] = (struct spin_message){r, 0, at, bytes};
    }
    return spin_ranks_exchange(m, k);
}

spin_status spin_ranks_broadcast(void *at, size_t bytes, int from)
{
    return spin_ranks_merge(at, bytes > 0, bytes, &from);
}

spin_status spin_ranks_agree(spin_status status)
{
    SPIN_FREED struct notice *all = NULL;
    spin_status end;

    if (n_ranks == 1 || heard)
        return status;
    SPIN_TRY(spin_alloc((size_t)n_ranks, sizeof *all, (void **)&all));
    all[own_rank].status = (int)status;
    if (status != SPIN_OK)
        snprintf(all[own_rank].text, TEXT, "%s", spin_last_error());
    end = spin_ranks_gather(all, sizeof *all);
    for (int r = 0; r < n_ranks && end == SPIN_OK; r++)
        if (all[r].status != SPIN_OK) {
            all[r].text[TEXT - 1] = '\0';
            end = spin_fail((spin_status)all[r].status, "%s", all[r].text);
            agreed = true;
        }
    return end;
}

/* ---- Ending after success or failure -------------------------------------------------------- */

/* Notify all other ranks of a failure, and wait up to patience_s seconds until each of them has
 * sent a notice too. The lowest rank that failed by itself, not because of a notice, becomes the
 * speaker. */
static void notify_failure(spin_status status)
{
    double until = spin_now_s() + patience_s;
    struct timespec nap = {.tv_nsec = 1000000};
    int n_notices = heard, lowest = heard ? n_ranks : own_rank;
    struct notice notice;
    int from;

    last_words.status = (int)status;
    last_words.heard = heard;
    snprintf(last_words.text, TEXT, "%s", spin_last_error());
    shim->notify(&last_words, sizeof last_words);
    while (n_notices < n_ranks - 1 && spin_now_s() < until) {
        if (!shim->receive_notice(&from, &notice, sizeof notice)) {
            nanosleep(&nap, NULL);
            continue;
        }
        n_notices++;
        if (!notice.heard && from < lowest)
            lowest = from;
    }
    speaker = lowest == own_rank;
}

spin_status spin_ranks_end(spin_status status, bool *speaks)
{
    *speaks = speaker = n_ranks > 1 ? own_rank == 0 : spin_ranks_env_rank() <= 0;
    if (n_ranks == 1)
        return status;
    if (status == SPIN_OK)
        status = spin_ranks_agree(SPIN_OK);
    if (status == SPIN_OK)
        status = print_other_warnings();
    if (status == SPIN_OK || agreed)
        shim->stop();
    else
        notify_failure(status);
    *speaks = speaker;
    return status;
}

void spin_ranks_exit(int code)
{
    struct timespec nap = {.tv_sec = 3};

    if (n_ranks == 1 || agreed || code == 0)
        return;
    if (speaker)
        shim->abort(code);
    nanosleep(&nap, NULL); /* give the speaker time to end all processes */
    _exit(code);
}
