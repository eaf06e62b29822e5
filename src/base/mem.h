/* Overflow-checked allocation, aligned and huge-page memory, arenas. */
#pragma once

#include "spin.h"

/* Set *out to a * b; returns false on overflow. */
bool spin_mul_size(size_t a, size_t b, size_t *out);

/* Variants of malloc, realloc and strdup that set the error message. They check count * size for
 * overflow. On failure, spin_alloc() sets *out to NULL, and spin_grow() leaves *inout unchanged. */
spin_status spin_alloc(size_t count, size_t size, void **out);  /* the memory is zeroed */
spin_status spin_grow(size_t count, size_t size, void **inout); /* added memory is not zeroed */
/* Ensure that an array of n items has capacity for one more: double *capacity if necessary. size:
 * size of an item in bytes. */
spin_status spin_array_grow(size_t n, size_t *capacity, size_t size, void **inout);
spin_status spin_strdup(const char *text, char **out);

/* Attributes of a local variable. When the scope of the variable is left in any way,
 * SPIN_LEAVES(fn) calls fn(&variable), and SPIN_FREED calls free(variable). Initialise the variable
 * in its declaration. */
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
/* The same, but the block is kept in a temporary file in `folder`: when memory is short, the system
 * writes its pages to the disk and reads them again when they are used. The disk space is allocated
 * at once. The file has no name, and is deleted when the block is released or the process ends.
 * folder NULL: the block is kept in memory, as by spin_pages_reserve(). Not available on Windows.
 */
#if defined _WIN32 || defined __EMSCRIPTEN__ /* in WebAssembly, files are in memory, too */
enum { SPIN_PAGES_IN_FILES = 0 };
#else
enum { SPIN_PAGES_IN_FILES = 1 };
#endif
spin_status spin_pages_reserve_in(const char *folder, size_t bytes, void **out);
/* Lets the system read the pages of such a block from the disk in the background. */
void spin_pages_read_ahead(void *block);

/* A bump allocator, whose allocations are released all at once by spin_arena_free(). Initialise the
 * struct with zeros. Allocations are zeroed and aligned to 64 bytes. */
struct spin_arena {
    struct spin_arena_block *first;
};
spin_status spin_arena_take(struct spin_arena *arena, size_t count, size_t size, void **out);
void spin_arena_free(struct spin_arena *arena);

/* A growing block of scratch memory, which callers reuse in every iteration. Initialise the struct
 * with zeros. */
struct spin_scratch {
    void *block;
    size_t bytes;
};
/* Ensure that the block has at least `bytes` bytes. If the block grows, its contents are lost. The
 * block is allocated with spin_pages_reserve(). */
spin_status spin_scratch_need(struct spin_scratch *scratch, size_t bytes);
void spin_scratch_free(struct spin_scratch *scratch);

/* Returns how many bytes this process can still allocate: the minimum of the machine's available
 * memory and of the amounts that the process's control groups, `ulimit -v` and `ulimit -d` still
 * allow. */
size_t spin_memory_available(void);
/* Returns the remaining address space, which also limits mapped files; SIZE_MAX if `ulimit -v` does
 * not limit it. */
size_t spin_addresses_available(void);
/* Returns how many more bytes the control groups (versions 1 and 2) of this process allow: the
 * minimum for its own group and all ancestors of that group; UINT64_MAX if there is no limit. root:
 * a prefix of the paths of system files, normally ""; tests pass a folder with files of their
 * own. */
uint64_t spin_memory_group_available(const char *root);
/* Returns the peak resident set size of this process, in bytes. */
size_t spin_memory_peak(void);
