/* Refined frames of an unfinished run: one small bundle each, in a folder beside the output. A
 * frame is written atomically, under a key that identifies its inputs and options, so a run that is
 * killed keeps all the frames that it finished. */
#pragma once

#include "spin.h"

/* A cached frame. */
struct spin_shelved {
    size_t n;      /* splats */
    char path[16]; /* SIMD path of the device that made it */
};

/* Writes all attribute columns of frame `index`. Creates the folder. */
spin_status spin_frame_cache_put(const char *folder, int index, const char *key, const char *path,
                                 const struct spin_splats *splats);
/* *found: frame `index` is cached. SPIN_E_USAGE if it is cached under another key. */
spin_status spin_frame_cache_find(const char *folder, int index, const char *key, bool *found,
                                  struct spin_shelved *out);
/* Reads columns of frame `index`, which must be cached under this key. */
spin_status spin_frame_cache_get(const char *folder, int index, const char *key, unsigned columns,
                                 struct spin_splats *out);
/* Removes all cached frames, and the folder if nothing else is in it. */
void spin_frame_cache_clear(const char *folder);
