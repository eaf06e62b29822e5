/* Compares several runs, that is, bundles measured on the same views: writes an HTML page with
 * curves and images, and the same curves and images as files. */
#pragma once

#include "eval/metrics.h"
#include "eval/report/report.h"
#include "io/json.h"

enum { SPIN_COMPARE_ROWS = 4 };

/* The measurements and images of all runs. Initialise to zero. */
struct spin_compare {
    /* Array of the results of spin_eval_json(), each with an additional member "name". */
    spin_json *runs;
    int n; /* number of runs added by spin_compare_draw() */
    size_t n_rows;
    struct spin_compare_row {
        struct spin_crop crop; /* part of the image that is shown enlarged */
        int width, height, frame, camera;
        uint8_t **picture; /* [1 + n] images [h][w][3]: ground truth, then the render of each run */
        int n_pictures;    /* 1 + n or, after an error, 2 + n */
    } row[SPIN_COMPARE_ROWS];
};

/* Adds the images of a run. The first run determines which views and crops are shown. If the views
 * of the run differ from those of the first run, it does nothing; the caller must report this. */
spin_status spin_compare_draw(struct spin_compare *c, const struct spin_clip *clip,
                              struct spin_image_cache *pixels, const struct spin_pair *pairs,
                              const struct spin_eval_report *report, struct spin_player *player,
                              const float background[3]);
/* Writes the comparison as an HTML page. */
spin_status spin_compare_page(const struct spin_compare *c, const char *path, bool force);
/* Writes figures into a folder: psnr.svg, ssim.svg, for each row a PNG and an SVG with labels, and
 * sequence.json, which lists the files. force: replace the figures in the folder, and remove those
 * that an earlier call wrote and this call does not replace. */
spin_status spin_compare_figures(const struct spin_compare *c, const char *folder, bool force);
void spin_compare_free(struct spin_compare *c);
