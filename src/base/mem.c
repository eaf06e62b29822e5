/* Memory: overflow-checked sizes, huge-page blocks, arenas.
 *
 * Hash tables of hundreds of MiB are read at random; with 4 KiB pages, address translation costs
 * more than the accesses. Large blocks are therefore aligned to 2 MiB and request huge pages; if
 * the system provides none, the blocks consist of ordinary pages. */
#include "base/mem.h"

#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

#include "base/text.h"

#if defined(__SANITIZE_ADDRESS__)
#include <sanitizer/asan_interface.h>
#define POISON(p, n) ASAN_POISON_MEMORY_REGION(p, n)
enum {
    GAP = 64
}; /* bytes between allocations of an arena, with which AddressSanitizer detects overruns */
#else
#define POISON(p, n) ((void)0)
enum { GAP = 0 };
#endif

enum { LINE = 64, FIRST_BLOCK = 1 << 16, ARENA_BLOCK = 1 << 20 };
static const size_t huge_page = (size_t)2 << 20;

bool spin_mul_size(size_t a, size_t b, size_t *out) { return !__builtin_mul_overflow(a, b, out); }

static spin_status fail_memory(size_t bytes)
{
    return spin_fail(SPIN_E_MEMORY, "not enough memory for %zu bytes", bytes);
}

static spin_status fail_size(size_t count, size_t size)
{
    return spin_fail(SPIN_E_MEMORY, "not enough memory for %zu elements of %zu bytes", count, size);
}

/* Round `bytes` up to a multiple of `unit`, a power of two; returns false on overflow. */
static bool round_up(size_t bytes, size_t unit, size_t *out)
{
    if (bytes > SIZE_MAX - (unit - 1))
        return false;
    *out = (bytes + unit - 1) & ~(unit - 1);
    return true;
}

spin_status spin_alloc(size_t count, size_t size, void **out)
{
    size_t bytes;

    *out = NULL;
    if (!spin_mul_size(count, size, &bytes))
        return fail_size(count, size);
    *out = calloc(1, bytes ? bytes : 1);
    return *out ? SPIN_OK : fail_memory(bytes);
}

spin_status spin_grow(size_t count, size_t size, void **inout)
{
    size_t bytes;
    void *block;

    if (!spin_mul_size(count, size, &bytes))
        return fail_size(count, size);
    block = realloc(*inout, bytes ? bytes : 1);
    if (!block)
        return fail_memory(bytes);
    *inout = block;
    return SPIN_OK;
}

spin_status spin_array_grow(size_t n, size_t *capacity, size_t size, void **inout)
{
    size_t larger = *capacity ? 2 * *capacity : 64;

    if (n < *capacity)
        return SPIN_OK;
    SPIN_TRY(spin_grow(larger, size, inout));
    *capacity = larger;
    return SPIN_OK;
}

void spin_freed(void *pointer) { free(*(void **)pointer); }

spin_status spin_strdup(const char *text, char **out)
{
    *out = strdup(text);
    return *out ? SPIN_OK : fail_memory(strlen(text) + 1);
}

/* The 64-byte header before each block contains the size of the block if it was mapped, and 0 if it
 * comes from aligned_alloc(). A mapped block begins at the start of a huge page; its header
 * occupies an extra page of 4 KiB before this huge page. */
enum { HEAD_PAGE = 4096 };

static size_t *head_of(void *block) { return (size_t *)(void *)((char *)block - LINE); }

static spin_status reserve_small(size_t bytes, void **out)
{
    size_t rounded = (bytes + LINE - 1) / LINE * LINE + LINE;
    char *head = aligned_alloc(LINE, rounded);

    if (!head)
        return fail_memory(bytes);
    memset(head, 0, rounded);
    *out = head + LINE;
    return SPIN_OK;
}

spin_status spin_pages_reserve(size_t bytes, void **out)
{
    size_t rounded, before;
    char *raw, *block;

    *out = NULL;
    if (bytes < huge_page)
        return reserve_small(bytes, out);
    if (!round_up(bytes, huge_page, &rounded) || rounded > SIZE_MAX - huge_page)
        return fail_memory(bytes);

    /* Map one huge page more than needed, then unmap the parts outside the aligned block and its
     * header. */
    raw =
        mmap(NULL, rounded + huge_page, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (raw == MAP_FAILED)
        return fail_memory(bytes);
    before = huge_page - ((uintptr_t)raw & (huge_page - 1));
    block = raw + before;
    if (before > HEAD_PAGE)
        munmap(raw, before - HEAD_PAGE);
    if (huge_page > before)
        munmap(block + rounded, huge_page - before);
#ifdef MADV_HUGEPAGE
    (void)madvise(block, rounded, MADV_HUGEPAGE);
#endif
    *head_of(block) = rounded;
    *out = block;
    return SPIN_OK;
}

#ifndef _WIN32
static spin_status fail_file(const char *folder, size_t bytes, int error)
{
    char size[32];

    return spin_fail(SPIN_E_IO,
                     "cannot keep %s in a temporary file in '%s': %s; give another folder with "
                     "--scratch",
                     spin_text_bytes(bytes, size), folder, strerror(error));
}

/* Opens a file of this size that has no name. */
static spin_status open_nameless(const char *folder, size_t bytes, int *fd)
{
    static const char name[] = "/.spin4d-XXXXXX";
    size_t n = strlen(folder) + sizeof name;
    SPIN_FREED char *path = NULL;
    int error;

    SPIN_TRY(spin_alloc(n, 1, (void **)&path));
    snprintf(path, n, "%s%s", folder, name);
    *fd = mkstemp(path);
    if (*fd < 0)
        return fail_file(folder, bytes, errno);
    unlink(path);
    /* Without disk blocks, a full disk would end the process by a signal when a page is written. */
    do
        error = posix_fallocate(*fd, 0, (off_t)bytes);
    while (error == EINTR);
    if (error == 0)
        return SPIN_OK;
    close(*fd);
    return fail_file(folder, bytes, error);
}

static spin_status reserve_in(const char *folder, size_t bytes, void **out)
{
    size_t rounded;
    char *raw;
    int fd;

    if (!round_up(bytes, HEAD_PAGE, &rounded) || rounded > SIZE_MAX / 2 - HEAD_PAGE)
        return fail_memory(bytes);
    SPIN_TRY(open_nameless(folder, HEAD_PAGE + rounded, &fd));
    raw = mmap(NULL, HEAD_PAGE + rounded, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    close(fd); /* the mapping keeps the file */
    if (raw == MAP_FAILED)
        return fail_file(folder, bytes, errno);
    *out = raw + HEAD_PAGE;
    *head_of(*out) = rounded;
    return SPIN_OK;
}

void spin_pages_read_ahead(void *block)
{
    if (block && *head_of(block) > 0)
        (void)madvise(block, *head_of(block), MADV_WILLNEED);
}
#else
static spin_status reserve_in(const char *folder, size_t bytes, void **out)
{
    (void)bytes, (void)out;
    return spin_misuse("cannot keep data in a temporary file in '%s' on Windows: omit --scratch",
                       folder);
}

void spin_pages_read_ahead(void *block) { (void)block; }
#endif

spin_status spin_pages_reserve_in(const char *folder, size_t bytes, void **out)
{
    *out = NULL;
    return folder ? reserve_in(folder, bytes, out) : spin_pages_reserve(bytes, out);
}

void spin_pages_release(void *block)
{
    if (!block)
        return;
    if (*head_of(block) == 0)
        SPIN_ALIGNED_FREE(head_of(block));
    else
        munmap((char *)block - HEAD_PAGE, HEAD_PAGE + *head_of(block));
}

/* The header of a block of an arena, followed by the allocations in it. The blocks form a list that
 * starts with the block in use. */
struct spin_arena_block {
    struct spin_arena_block *next;
    size_t used, bytes; /* bytes in use and size of the block, both including this header */
};

static spin_status arena_block(struct spin_arena *arena, size_t piece)
{
    size_t bytes, least = arena->first ? 2 * arena->first->bytes : FIRST_BLOCK;
    struct spin_arena_block *block;

    if (!round_up(piece, LINE, &bytes) || bytes > SIZE_MAX - LINE - GAP)
        return fail_memory(piece);
    bytes += LINE + GAP;
    if (least > ARENA_BLOCK)
        least = ARENA_BLOCK;
    if (bytes < least)
        bytes = least;
    block = aligned_alloc(LINE, bytes);
    if (!block)
        return fail_memory(bytes);
    block->used = LINE;
    block->bytes = bytes;
    block->next = arena->first;
    arena->first = block;
    POISON((char *)block + LINE, bytes - LINE);
    return SPIN_OK;
}

spin_status spin_arena_take(struct spin_arena *arena, size_t count, size_t size, void **out)
{
    size_t bytes, room;
    struct spin_arena_block *block = arena->first;

    *out = NULL;
    if (!spin_mul_size(count, size, &bytes))
        return fail_size(count, size);
    if (!round_up(bytes ? bytes : 1, LINE, &room) || room > SIZE_MAX - GAP)
        return fail_memory(bytes);
    room += GAP;
    if (!block || block->bytes - block->used < room) {
        SPIN_TRY(arena_block(arena, room - GAP));
        block = arena->first;
    }
    *out = (char *)block + block->used;
    block->used += room;
#if defined(__SANITIZE_ADDRESS__)
    ASAN_UNPOISON_MEMORY_REGION(*out, bytes ? bytes : 1);
#endif
    memset(*out, 0, bytes);
    return SPIN_OK;
}

void spin_arena_free(struct spin_arena *arena)
{
    while (arena->first) {
        struct spin_arena_block *next = arena->first->next;

        SPIN_ALIGNED_FREE(arena->first);
        arena->first = next;
    }
}

spin_status spin_scratch_need(struct spin_scratch *scratch, size_t bytes)
{
    /* Allocate an eighth more than requested, so that slowly rising sizes do not cause a new
     * allocation in every call. */
    size_t wanted = bytes <= SIZE_MAX - bytes / 8 ? bytes + bytes / 8 : bytes;

    if (scratch->block && scratch->bytes >= bytes)
        return SPIN_OK;
    spin_scratch_free(scratch);
    SPIN_TRY(spin_pages_reserve(wanted, &scratch->block));
    scratch->bytes = wanted;
    return SPIN_OK;
}

void spin_scratch_free(struct spin_scratch *scratch)
{
    spin_pages_release(scratch->block);
    scratch->block = NULL;
    scratch->bytes = 0;
}

/* Read the number after `key` in a small system file, and multiply it by `unit`. Returns false if
 * there is no such number. With the key "", the file must consist of a single number; the word
 * "max", for no limit, counts as no number. */
static bool system_number(const char *path, const char *key, uint64_t unit, uint64_t *out)
{
    char line[256];
    FILE *file = fopen(path, "re");
    bool found = false;
    size_t n = strlen(key);

    if (!file)
        return false;
    while (!found && fgets(line, sizeof line, file)) {
        unsigned long long value;

        if (strncmp(line, key, n) == 0 && sscanf(line + n, "%llu", &value) == 1) {
            *out = value * unit;
            found = true;
        }
    }
    fclose(file);
    return found;
}

enum { GROUP_PATH = 4096 };

/* Returns how many bytes the process may still allocate according to its control groups: the one in
 * `folder` and its parents. Each group allows its limit minus its usage, where inactive page cache
 * counts as free. Returns the least of these numbers; UINT64_MAX if there is no limit. The search
 * ends at the mount point, whose path is the first n_top bytes of `folder`. Groups whose files
 * cannot be read, as in a container, are skipped. */
static uint64_t groups_available(char *folder, size_t n_top, const char *const names[4])
{
    uint64_t least = UINT64_MAX;

    for (size_t n = strlen(folder);; folder[n] = '\0') {
        uint64_t limit, used, cached = 0;
        char path[3][GROUP_PATH + 64];

        for (int i = 0; i < 3; i++)
            snprintf(path[i], sizeof path[i], "%s/%s", folder, names[i]);
        if (system_number(path[0], "", 1, &limit) && system_number(path[1], "", 1, &used)) {
            (void)system_number(path[2], names[3], 1, &cached);
            used = used > cached ? used - cached : 0;
            used = limit > used ? limit - used : 0;
            least = used < least ? used : least;
        }
        if (n <= n_top)
            return least;
        while (n > n_top && folder[--n] != '/')
            ;
    }
}

/* Returns the path in a line "number:controllers:path" of /proc/self/cgroup if the line lists the
 * controller; otherwise returns NULL. Controller "" stands for version 2, whose line lists no
 * controllers. */
static const char *group_of_line(char *line, const char *controller)
{
    char *list = strchr(line, ':'), *path = list ? strchr(list + 1, ':') : NULL, *word, *rest;

    if (!path)
        return NULL;
    *path++ = '\0';
    path[strcspn(path, "\n")] = '\0';
    if (!*controller)
        return list[1] == '\0' ? path : NULL;
    for (rest = list + 1; (word = strsep(&rest, ",")) != NULL;)
        if (strcmp(word, controller) == 0)
            return path;
    return NULL;
}

uint64_t spin_memory_group_available(const char *root)
{
    static const struct {
        const char *controller, *mount, *names[4];
    } version[] = {
        {"", "sys/fs/cgroup", {"memory.max", "memory.current", "memory.stat", "inactive_file "}},
        {"memory",
         "sys/fs/cgroup/memory",
         {"memory.limit_in_bytes", "memory.usage_in_bytes", "memory.stat", "total_inactive_file "}},
    };
    uint64_t least = UINT64_MAX;

    for (size_t i = 0; i < sizeof version / sizeof version[0]; i++) {
        char line[GROUP_PATH], folder[GROUP_PATH];
        size_t n_top = (size_t)snprintf(folder, sizeof folder, "%s/%s", root, version[i].mount);
        FILE *file;
        uint64_t found;

        snprintf(line, sizeof line, "%s/proc/self/cgroup", root);
        file = fopen(line, "re");
        while (file && fgets(line, sizeof line, file)) {
            const char *group = group_of_line(line, version[i].controller);

            if (group)
                snprintf(folder + n_top, sizeof folder - n_top, "%s", group);
        }
        if (file)
            fclose(file);
        found = groups_available(folder, n_top, version[i].names);
        least = found < least ? found : least;
    }
    return least;
}

/* Returns how many bytes a limit of the process still allows; UINT64_MAX if there is no limit or it
 * is unknown. key: the line of /proc/self/status with the size that is limited. */
static uint64_t limit_available(int resource, const char *key)
{
    struct rlimit limit;
    uint64_t used;

    if (getrlimit(resource, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY ||
        !system_number("/proc/self/status", key, 1024, &used))
        return UINT64_MAX;
    return limit.rlim_cur > used ? limit.rlim_cur - used : 0;
}

size_t spin_addresses_available(void)
{
    uint64_t bytes = limit_available(RLIMIT_AS, "VmSize:");

    return bytes > SIZE_MAX ? SIZE_MAX : (size_t)bytes;
}

size_t spin_memory_available(void)
{
    uint64_t bytes, bound[3];

    if (!system_number("/proc/meminfo", "MemAvailable:", 1024, &bytes))
        bytes = (uint64_t)sysconf(_SC_AVPHYS_PAGES) * (uint64_t)sysconf(_SC_PAGESIZE);
    bound[0] = spin_memory_group_available("");
    bound[1] = limit_available(RLIMIT_AS, "VmSize:");
    bound[2] = limit_available(RLIMIT_DATA, "VmData:");
    for (int i = 0; i < 3; i++)
        bytes = bound[i] < bytes ? bound[i] : bytes;
    return bytes > SIZE_MAX ? SIZE_MAX : (size_t)bytes;
}

size_t spin_memory_peak(void)
{
    struct rusage usage;

    if (getrusage(RUSAGE_SELF, &usage) != 0)
        return 0;
    return (size_t)usage.ru_maxrss * 1024; /* Linux reports the size in KiB */
}
