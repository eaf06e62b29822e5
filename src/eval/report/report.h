/* An evaluation as a JSON document, and as a self-contained HTML page with curves, tables and
 * images. */
#pragma once

#include "eval/metrics.h"
#include "io/json.h"

struct spin_report {
    const char *path, *log; /* output page; the log of spin-retrain --log, or NULL */
    double trained_psnr;    /* of the test views at the end of training; NaN: unknown */
    bool force;
    const char *input; /* the bundle, as given by the user */
    enum spin_split split;
    const float *background; /* [3] */
    const struct spin_clip *clip;
    struct spin_image_cache *pixels;
    const struct spin_pair *pairs; /* [n_views] measured pairs */
    struct spin_player *player;
    const struct spin_eval_report *after;
    struct spin_player *source;            /* what the result is compared with, or NULL */
    const struct spin_eval_report *before; /* result of source */
};

/* The document that --json prints, see spin-eval(1). */
spin_json *spin_eval_json(const struct spin_eval_report *report, enum spin_split split);

spin_status spin_report_write(const struct spin_report *report);
