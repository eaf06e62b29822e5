/* Folder of --watch: a page that refreshes itself during the training, and its data. */
#pragma once

#include "train/output.h"

struct spin_watch {
    char *page, *now, *log, *pictures, *state, *clip; /* paths below the folder */
};

spin_status spin_watch_open(struct spin_watch *w, const char *folder);
void spin_watch_close(struct spin_watch *w);
/* Writes the page before the first iteration. */
spin_status spin_watch_begin(const struct spin_watch *w);
/* Writes the clip so far as state.spin, a page to play it as clip.html, and curves and the newest
 * previews as now.js. log: path of the training log; done: the training is complete. */
spin_status spin_watch_update(const struct spin_watch *w, const struct spin_output *output,
                              const char *log, bool done);
