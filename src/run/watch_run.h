/* Writes the folder of --watch: a page that refreshes itself during the training, and the data of
 * this page. */
#pragma once

#include "train/trained_output.h"

struct spin_watch {
    /* paths of files and folders inside the folder of --watch */
    char *page, *now, *log, *pictures, *state, *clip;
};

spin_status spin_watch_open(struct spin_watch *w, const char *folder);
void spin_watch_close(struct spin_watch *w);
/* Writes the page, which has no data yet. Called before the first iteration. */
spin_status spin_watch_begin(const struct spin_watch *w);
/* Writes three files: state.spin, the current state of the clip; clip.html, a page that plays this
 * clip; now.js, the curves and the names of the newest previews. `log` is the path of the training
 * log; `done` states whether the training is complete. */
spin_status spin_watch_update(const struct spin_watch *w, const struct spin_output *output,
                              const char *log, bool done);
