/* Cache of the refined frames of an unfinished run: a folder beside the output with one small
 * bundle for each frame. Each bundle is written atomically and contains a key that identifies the
 * frame's inputs and options, so a run that was killed can continue with all the frames that it
 * finished. */
#pragma once

#include "spin.h"

/* A cached frame. */
struct spin_shelved {
    size_t n;      /* number of splats */
    char path[16]; /* SIMD path of the device that refined the frame */
};

/* Adds frame `index` to the cache, with all attribute columns of `splats`, its key and the SIMD
 * path of the device that refined it. Creates the folder if necessary. */
spin_status spin_frame_cache_put(const char *folder, int index, const char *key, const char *path,
                                 const struct spin_splats *splats);
/* Sets *found to whether frame `index` is cached and, if it is, describes it in *out. SPIN_E_USAGE
 * if the frame is cached under another key. */
spin_status spin_frame_cache_find(const char *folder, int index, const char *key, bool *found,
                                  struct spin_shelved *out);
/* Reads these columns of frame `index`. The frame must be cached under this key. */
spin_status spin_frame_cache_get(const char *folder, int index, const char *key, unsigned columns,
                                 struct spin_splats *out);
/* Removes all cached frames, and then the folder if it is empty. */
void spin_frame_cache_clear(const char *folder);
