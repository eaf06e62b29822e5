/* An evaluation as a document, and as one page of HTML that needs nothing beside it: curves,
 * tables, pictures. */
#pragma once

#include "eval/metrics.h"
#include "io/json.h"

struct spin_report {
    const char *path, *log; /* the page; what spin-retrain --log wrote, or NULL */
    double trained_psnr;    /* of the test views after the training; NaN: not known */
    bool force;
    const char *input; /* the bundle, as it was given */
    enum spin_split split;
    const float *background; /* [3] */
    const struct spin_clip *clip;
    struct spin_image_cache *pixels;
    const struct spin_pair *pairs; /* [n_views] of what was measured */
    struct spin_player *player;
    const struct spin_eval_report *after;
    struct spin_player *source;            /* what it is compared with; NULL: nothing */
    const struct spin_eval_report *before; /* of source */
};

/* What --json prints, see spin-eval(1). */
spin_json *spin_eval_json(const struct spin_eval_report *report, enum spin_split split);

spin_status spin_report_write(const struct spin_report *report);
