/* Checked sizes, aligned and huge-page memory, arenas. */
#pragma once

#include "spin.h"

/* *out = a * b, false on overflow. */
bool spin_mul_size(size_t a, size_t b, size_t *out);

/* malloc / realloc / strdup that leave a trail. count * size is checked. *out is NULL on failure of
 * spin_alloc and untouched on failure of spin_grow. */
spin_status spin_alloc(size_t count, size_t size, void **out);  /* zeroed */
spin_status spin_grow(size_t count, size_t size, void **inout); /* not zeroed */
/* Room for one more behind n items of an array of *capacity, which doubles when it must. */
spin_status spin_room(size_t n, size_t *capacity, size_t size, void **inout);
spin_status spin_strdup(const char *text, char **out);

/* Of a local: fn(&it), or free(it), when its block is left, however that is. Give it a value where
 * it is declared. */
#define SPIN_LEAVES(fn) __attribute__((cleanup(fn)))
#define SPIN_FREED SPIN_LEAVES(spin_freed)
void spin_freed(void *pointer);

/* Frees what aligned_alloc() gave. */
#ifdef _WIN32
#define SPIN_ALIGNED_FREE(block) _aligned_free(block)
#else
#define SPIN_ALIGNED_FREE(block) free(block)
#endif

/* Big zeroed blocks: 2 MiB-aligned, huge pages where the system gives them. Any size. */
spin_status spin_pages_reserve(size_t bytes, void **out);
void spin_pages_release(void *block);

/* A bump allocator; everything is released at once. Zero it to begin. 64-byte aligned pieces. */
struct spin_arena {
    struct spin_arena_block *first;
};
spin_status spin_arena_take(struct spin_arena *arena, size_t count, size_t size, void **out);
void spin_arena_free(struct spin_arena *arena);

/* A block that only ever grows: for scratch that is reused every step. Zero it to begin. */
struct spin_scratch {
    void *block;
    size_t bytes;
};
/* Make it hold at least bytes (contents are lost when it grows). 64-byte aligned, huge pages. */
spin_status spin_scratch_need(struct spin_scratch *scratch, size_t bytes);
void spin_scratch_free(struct spin_scratch *scratch);

/* Bytes of memory that the machine, a control group and `ulimit -v` would still give us. */
size_t spin_memory_available(void);
/* The control groups' part of it: of the process's own group and of all above it, version 2 and 1.
 * UINT64_MAX: no limit. root "" is the machine's; tests name a folder with files of their own. */
uint64_t spin_memory_group_available(const char *root);
/* Peak resident bytes of this process. */
size_t spin_memory_peak(void);
