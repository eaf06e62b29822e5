/* Several bundles measured on the same views: one page that holds them against each other, and
 * figures of it. */
#pragma once

#include "eval/metrics.h"
#include "eval/report/motion_crops.h"
#include "io/json.h"

enum { SPIN_COMPARE_ROWS = 4 };

/* Zero it to begin. */
struct spin_compare {
    spin_json *runs; /* array of spin_eval_json(), each with a "name" */
    int n;           /* runs whose pictures are here */
    size_t n_rows;
    struct spin_compare_row {
        struct spin_crop crop; /* of the inset */
        int width, height, frame, camera;
        uint8_t **picture; /* [1 + n] [h][w][3]: ground truth, then those of the runs */
    } row[SPIN_COMPARE_ROWS];
};

/* The pictures of a run, which is open; the first one decides where to look. That the others were
 * measured on the same views the caller sees. */
spin_status spin_compare_draw(struct spin_compare *c, const struct spin_clip *clip,
                              struct spin_image_cache *pixels, const struct spin_pair *pairs,
                              const struct spin_eval_report *report, struct spin_player *player,
                              const float background[3]);
/* The page; and into a folder psnr.svg, and of each row a PNG and an SVG with the names. */
spin_status spin_compare_page(const struct spin_compare *c, const char *path, bool force);
spin_status spin_compare_figures(const struct spin_compare *c, const char *folder);
void spin_compare_free(struct spin_compare *c);
