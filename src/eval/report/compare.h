/* Compares several bundles that were measured on the same views: writes an HTML page with curves
 * and images, and the same curves and images as files. */
#pragma once

#include "eval/metrics.h"
#include "eval/report/motion_crops.h"
#include "io/json.h"

enum { SPIN_COMPARE_ROWS = 4 };

/* The measurements and images of all runs. Initialise to zero. */
struct spin_compare {
    spin_json *runs; /* list of spin_eval_json(), each with the additional key "name" */
    int n;           /* number of runs whose images were added */
    size_t n_rows;
    struct spin_compare_row {
        struct spin_crop crop; /* the part that is shown enlarged */
        int width, height, frame, camera;
        uint8_t **picture; /* [1 + n] images [h][w][3]: ground truth, then one per run */
    } row[SPIN_COMPARE_ROWS];
};

/* Adds the images of an open run. The first run determines which views and crops are shown. The
 * caller must check that all runs were measured on the same views. */
spin_status spin_compare_draw(struct spin_compare *c, const struct spin_clip *clip,
                              struct spin_image_cache *pixels, const struct spin_pair *pairs,
                              const struct spin_eval_report *report, struct spin_player *player,
                              const float background[3]);
/* Writes the page. */
spin_status spin_compare_page(const struct spin_compare *c, const char *path, bool force);
/* Writes figures into a folder: psnr.svg, ssim.svg, and for each row a PNG, and an SVG that labels
 * its images; and sequence.json, which lists these images. With force, removes the files that a
 * former call has written there and this call does not overwrite. */
spin_status spin_compare_figures(const struct spin_compare *c, const char *folder, bool force);
void spin_compare_free(struct spin_compare *c);
