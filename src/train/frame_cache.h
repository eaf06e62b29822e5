/* Finished frames of a run that is not finished: one small bundle each, in a folder beside the
 * output. A frame is written whole or not at all, under a key that says what it was made from.
 * After a kill the folder holds every frame that was done and nothing else. */
#pragma once

#include "spin.h"

/* A frame that is there. */
struct spin_shelved {
    size_t n;      /* splats */
    char path[16]; /* the device's code path that made it */
};

/* Write frame `index`: all attribute columns. Makes the folder. */
spin_status spin_frame_cache_put(const char *folder, int index, const char *key, const char *path,
                                 const struct spin_splats *splats);
/* Whether there is frame `index`, made from what `key` says. One made from something else is an
 * error: SPIN_E_USAGE. */
spin_status spin_frame_cache_find(const char *folder, int index, const char *key, bool *found,
                                  struct spin_shelved *out);
/* Columns of frame `index`, which must still be the one that `key` names. */
spin_status spin_frame_cache_get(const char *folder, int index, const char *key, unsigned columns,
                                 struct spin_splats *out);
/* Remove its frames, and the folder when nothing else is in it. */
void spin_frame_cache_clear(const char *folder);
