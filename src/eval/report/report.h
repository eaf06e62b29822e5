/* Writes an evaluation as a JSON document, or as a self-contained HTML page with curves, tables and
 * images. */
#pragma once

#include "spin.h"
#include "eval/flicker.h"
#include "eval/metrics.h"
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

/* ---- The log of a training ------------------------------------------------------------------- */

/* A log of spin-retrain --log has one JSON object per line. */

struct spin_train_log {
    size_t n_steps, n_tests;
    /* [n_steps] last iteration of each averaging interval, and mean loss in the interval */
    double *step, *loss;
    double total_seconds; /* duration of the training, including runs before a resume */
    /* [n_tests] evaluations of the test views: iteration, seconds since the start, PSNR, SSIM */
    double *test, *seconds, *psnr, *ssim;
    size_t room_steps, room_tests; /* capacities of the arrays */
};

/* Reads a log, and averages the loss over intervals so that at most `most` points remain. An
 * incomplete last line is ignored; any other malformed line is an error that contains the line
 * number. */
spin_status spin_train_log_read(const char *path, size_t most, struct spin_train_log *out);
void spin_train_log_free(struct spin_train_log *history);

/* ---- Images of a report ---------------------------------------------------------------------- */

/* A report shows crops with the fastest motion, and the views with the lowest PSNR. */

struct spin_crop {
    size_t pair;              /* index in the list of pairs */
    int x, y, side_x, side_y; /* top left corner and size, in pixels */
    double score;
};

/* Finds at most `most` crops with the fastest motion, fastest first, and sets *n to their number,
 * which may be 0. Motion is fast if an object covers pixels in one frame, but neither in the
 * previous nor in the next frame; a clip of two frames therefore has no such crops. Crops of the
 * same camera are at least two frames apart. */
spin_status spin_motion_crops_fast(const struct spin_clip *clip, struct spin_image_cache *pixels,
                                   const struct spin_pair *pairs, size_t n_pairs, size_t most,
                                   struct spin_crop *out, size_t *n);

/* Finds at most `most` views with the lowest PSNR, except views without one, sets out [most] to
 * their indices and returns their number: first the worst view of each camera, then further views
 * of any camera. */
size_t spin_motion_crops_worst(const struct spin_eval_view *view, size_t n_views, size_t most,
                               size_t *out);
