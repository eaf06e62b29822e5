/* A folder to look into while a training runs (--watch): a page that refreshes itself, and what it
 * shows. */
#pragma once

#include "train/output.h"

struct spin_watch {
    char *page, *now, *log, *pictures, *state, *clip; /* paths in the folder */
};

spin_status spin_watch_open(struct spin_watch *w, const char *folder);
void spin_watch_close(struct spin_watch *w);
/* The page, before the first step. */
spin_status spin_watch_begin(const struct spin_watch *w);
/* The state by now: state.spin, clip.html made of it, and now.js with curves and the newest
 * pictures. log is what was written so far; done: nothing more comes. */
spin_status spin_watch_update(const struct spin_watch *w, const struct spin_output *output,
                              const char *log, bool done);
