/* The files that running calls have read, identified by device and inode: no output may replace
 * them. Files that a call wrote itself are excluded, even if it reads them again. */
#include "io/file.h"

#include <pthread.h>

#include "base/base.h"

enum kind { FREE, INPUT, OWN };

static struct {
    pthread_mutex_t lock;
    int depth; /* number of running calls, nested or concurrent */
    struct known {
        uint64_t device, inode;
        enum kind kind;
        /* A hash table of `capacity` slots, a power of 2; at most half of them are used. */
    } * slot;
    size_t n, capacity;
    uint64_t bytes; /* of the inputs */
} all = {.lock = PTHREAD_MUTEX_INITIALIZER};

static struct known *find_slot(const struct stat *st)
{
    uint64_t hash = ((uint64_t)st->st_ino + 31 * (uint64_t)st->st_dev) * 0x9e3779b97f4a7c15u;
    size_t i = (size_t)(hash >> 20) & (all.capacity - 1);

    while (all.slot[i].kind != FREE && (all.slot[i].inode != (uint64_t)st->st_ino ||
                                        all.slot[i].device != (uint64_t)st->st_dev))
        i = (i + 1) & (all.capacity - 1);
    return &all.slot[i];
}

static spin_status double_capacity(void)
{
    struct known *old = all.slot;
    size_t n_old = all.capacity;

    SPIN_TRY(spin_alloc(n_old ? 2 * n_old : 256, sizeof *old, (void **)&all.slot));
    all.capacity = n_old ? 2 * n_old : 256;
    for (size_t i = 0; i < n_old; i++)
        if (old[i].kind != FREE)
            *find_slot(&(struct stat){.st_dev = old[i].device, .st_ino = old[i].inode}) = old[i];
    free(old);
    return SPIN_OK;
}

static spin_status add_file(const struct stat *st, enum kind kind)
{
    spin_status status = SPIN_OK;
    struct known *k;

    pthread_mutex_lock(&all.lock);
    if (all.depth > 0 && 2 * (all.n + 1) > all.capacity)
        status = double_capacity();
    if (all.depth > 0 && status == SPIN_OK) {
        k = find_slot(st);
        all.n += k->kind == FREE;
        all.bytes += k->kind == FREE && kind == INPUT ? (uint64_t)st->st_size : 0;
        if (k->kind == FREE || kind == OWN)
            *k = (struct known){(uint64_t)st->st_dev, (uint64_t)st->st_ino, kind};
    }
    pthread_mutex_unlock(&all.lock);
    return status;
}

int spin_inputs_begin(void)
{
    pthread_mutex_lock(&all.lock);
    all.depth++;
    pthread_mutex_unlock(&all.lock);
    return 0;
}

void spin_inputs_end(const int *begun)
{
    (void)begun;
    pthread_mutex_lock(&all.lock);
    if (--all.depth == 0) {
        free(all.slot);
        all.slot = NULL;
        all.n = all.capacity = 0;
        all.bytes = 0;
    }
    pthread_mutex_unlock(&all.lock);
}

uint64_t spin_inputs_bytes(void)
{
    uint64_t bytes;

    pthread_mutex_lock(&all.lock);
    bytes = all.bytes;
    pthread_mutex_unlock(&all.lock);
    return bytes;
}

static _Thread_local bool paused;

void spin_inputs_pause(bool pause) { paused = pause; }

spin_status spin_inputs_add(const struct stat *st)
{
    return paused ? SPIN_OK : add_file(st, INPUT);
}

spin_status spin_inputs_add_path(const char *path)
{
    struct stat st;

    return path && stat(path, &st) == 0 && S_ISREG(st.st_mode) ? add_file(&st, INPUT) : SPIN_OK;
}

void spin_inputs_own(const char *path)
{
    struct stat st;

    if (stat(path, &st) == 0)
        /* If memory runs out, the file stays an input: its next overwrite is refused. */
        (void)add_file(&st, OWN);
}

bool spin_inputs_have(const struct stat *st)
{
    bool found;

    pthread_mutex_lock(&all.lock);
    found = all.n > 0 && find_slot(st)->kind == INPUT;
    pthread_mutex_unlock(&all.lock);
    return found;
}
