/* Overflow-checked allocation, aligned and huge-page memory, arenas. */
#pragma once

#include "spin.h"

/* *out = a * b; false on overflow. */
bool spin_mul_size(size_t a, size_t b, size_t *out);

/* malloc, realloc and strdup that set the error message. count * size is checked for overflow. On
 * failure, spin_alloc sets *out to NULL, and spin_grow leaves *inout unchanged. */
spin_status spin_alloc(size_t count, size_t size, void **out);  /* zeroed */
spin_status spin_grow(size_t count, size_t size, void **inout); /* not zeroed */
/* Ensure capacity for one more than n items in an array; *capacity doubles when it is exhausted. */
spin_status spin_room(size_t n, size_t *capacity, size_t size, void **inout);
spin_status spin_strdup(const char *text, char **out);

/* Attributes of a local variable: call fn(&variable), or free(variable), when its scope is left in
 * any way. Initialise the variable in its declaration. */
#define SPIN_LEAVES(fn) __attribute__((cleanup(fn)))
#define SPIN_FREED SPIN_LEAVES(spin_freed)
void spin_freed(void *pointer);

/* Frees memory of aligned_alloc(). */
#ifdef _WIN32
#define SPIN_ALIGNED_FREE(block) _aligned_free(block)
#else
#define SPIN_ALIGNED_FREE(block) free(block)
#endif

/* Zeroed blocks for large tables. Blocks of 2 MiB or more are aligned to 2 MiB, and use huge pages
 * if the system provides them; smaller ones are aligned to 64 bytes. */
spin_status spin_pages_reserve(size_t bytes, void **out);
void spin_pages_release(void *block);

/* A bump allocator whose memory is released all at once. Initialise with zeros. Allocations are
 * zeroed and aligned to 64 bytes. */
struct spin_arena {
    struct spin_arena_block *first;
};
spin_status spin_arena_take(struct spin_arena *arena, size_t count, size_t size, void **out);
void spin_arena_free(struct spin_arena *arena);

/* A growing block of scratch memory, reused by every iteration. Initialise with zeros. */
struct spin_scratch {
    void *block;
    size_t bytes;
};
/* Ensure a capacity of at least `bytes`; contents are lost when the block grows. The block is
 * allocated with spin_pages_reserve(). */
spin_status spin_scratch_need(struct spin_scratch *scratch, size_t bytes);
void spin_scratch_free(struct spin_scratch *scratch);

/* Bytes that this process can still allocate: the least of the limits set by the machine, its
 * control groups and `ulimit -v`. */
size_t spin_memory_available(void);
/* The bytes that control groups (versions 1 and 2) allow: the least over the process's own group
 * and all its ancestors. UINT64_MAX: no limit. root: "" for the system's files; tests pass a folder
 * with their own files. */
uint64_t spin_memory_group_available(const char *root);
/* Peak resident set size of this process, in bytes. */
size_t spin_memory_peak(void);
