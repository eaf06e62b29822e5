/* Writes an evaluation as a JSON document, or as a self-contained HTML page with curves, tables and
 * images. */
#pragma once

#include "eval/flicker.h"
#include "io/json.h"

struct spin_report {
    const char *path, *log; /* path of the page; log file of spin-retrain --log, or NULL */
    double trained_psnr;    /* test PSNR recorded in the bundle by spin-retrain; NaN: unknown */
    bool force;             /* replace an existing page */
    const char *input;      /* path of the bundle, as given by the user */
    enum spin_split split;
    const float *background; /* [3] */
    const struct spin_clip *clip;
    struct spin_image_cache *pixels;
    const struct spin_pair *pairs; /* [after->n_views] measured pairs */
    struct spin_player *player;
    const struct spin_eval_report *after;   /* results with the splats of `player` */
    struct spin_player *source;             /* player of the source; NULL: no comparison */
    const struct spin_eval_report *before;  /* results with the splats of `source` */
    const struct spin_flicker_strip *strip; /* shown unless it is empty */
};

/* Returns the JSON document of spin-eval --json, see spin-eval(1). The caller frees it. */
spin_json *spin_eval_json(const struct spin_eval_report *report, enum spin_split split);

spin_status spin_report_write(const struct spin_report *report);
