/* --decimate: drops the splats of a clip that contribute least.
 *
 * The weight of a splat in one frame is its contribution to an image (the sum over pixels of alpha
 * times transmittance); the maximum over some training views of the frame is used. Without cameras,
 * the weight is opacity times size. Each frame keeps the N splats of largest weight, where N
 * follows from the goal. Splats that several frames share (the same row of all frames, a track, a
 * 4D splat) are kept in all of these frames or in none, according to their mean weight over these
 * frames. If 4D splats are exported as such, the N rows with the largest sum of weights over all
 * frames are kept.
 *
 * If all frames have the same rows, only half of the excess is dropped that way. The rest
 * disappears by merging similar neighbours (geometry/merge_splats.h): the same pairs in all frames,
 * chosen from some of the frames.
 *
 * Splats that the row filter drops for other reasons are not among the N splats. */
#pragma once

#include "geometry/merge_splats.h"
#include "geometry/viewpoints.h"
#include "render/player.h"
#include "run/row_filter.h"

enum spin_decimate_unit {
    SPIN_DECIMATE_SPLATS,
    SPIN_DECIMATE_SHARE,
    SPIN_DECIMATE_BYTES,
    SPIN_DECIMATE_DB
};

struct spin_decimate_goal {
    enum spin_decimate_unit unit;
    /* In this unit: a number of splats per frame, a share from 0 to 1, the size of the whole output
     * in bytes, or the PSNR in dB between images with all splats and images with the kept splats
     * only. */
    double amount;
};
/* Parses "5000", "50%", "2MB" (B, kB, MB, GB: powers of 1000) or "40dB". */
spin_status spin_decimate_parse(const char *text, struct spin_decimate_goal *out);

/* The splats of one frame, or of all frames if frames share their rows. */
struct spin_decimate_set {
    /* number of rows; of rows that take part in the decimation, whose weight is at least 0; of rows
     * that the decimation keeps */
    size_t n, n_counted, n_kept;
    /* [n] the weight of each row; negative if the row filter drops the row */
    float *weight;
    unsigned char *keep;           /* [n], 1 if the decimation keeps the row, else 0 */
};

struct spin_decimation {
    /* Inputs, set and owned by the caller. */
    const struct spin_clip *clip;
    struct spin_player *frames;             /* reads the splats of the clip */
    const struct spin_splats_4d *splats_4d; /* 4D splats to export; NULL: frames are exported */
    struct spin_row_filter *filter;         /* drops rows before the decimation */
    const float *background;

    /* Private. */
    struct spin_player drawing;
    int sharing;
    struct spin_decimate_set *set; /* [n_sets] */
    int n_sets;
    /* [n_pairs] training views, or all views if there are no training views; sorted by frame */
    struct spin_pair *pairs;
    size_t n_pairs;
    struct spin_viewpoints placed; /* cameras for measuring the loss, if the clip has none */
    struct spin_merge_plan merges; /* of rows, tracks or 4D splats, as frames share them */
    struct spin_splats splats, merged, part;
};

/* Computes all weights. The inputs in *d must be set. The caller closes *d even if the call
 * fails. */
spin_status spin_decimation_open(struct spin_decimation *d);
void spin_decimation_close(struct spin_decimation *d);
/* Chooses the splats to keep: with SPIN_DECIMATE_SPLATS at most `amount` in each frame, or in the
 * clip if 4D splats are exported; with SPIN_DECIMATE_SHARE the share `amount` of the splats that
 * the row filter keeps, but at least one splat. */
spin_status spin_decimation_choose(struct spin_decimation *d, enum spin_decimate_unit unit,
                                   double amount);
/* Chooses the smallest share of splats whose images, compared with those of all splats, have a PSNR
 * of at least `decibels`. */
spin_status spin_decimation_choose_loss(struct spin_decimation *d, double decibels);
/* Chooses the largest share of splats for which write() makes an output of at most `bytes` bytes.
 * write() is called with a temporary path whose last component is that of `output`; its files are
 * removed afterwards. Sets *n_tries to the number of calls of write(), and *reached to the size in
 * bytes of the output with the chosen share. Fails with SPIN_E_UNSUPPORTED if the output is too
 * large even with one splat per frame. */
typedef spin_status (*spin_decimation_write_fn)(void *context, const char *output);
spin_status spin_decimation_choose_bytes(struct spin_decimation *d, double bytes,
                                         const char *output, spin_decimation_write_fn write,
                                         void *context, int *n_tries, uint64_t *reached);
spin_status spin_decimation_measure(struct spin_decimation *d, struct spin_decimated *out);

/* Makes d->filter drop the rows that are not kept, for the reason SPIN_ROW_DECIMATE.
 *
 * The filter also drops imported splats, which some exporters write beside the retrained ones. If
 * the training preserved the rows, the same rows are kept in the imported and in the retrained
 * frame. Otherwise the largest imported splats are kept, as many as in the retrained frame. 4D
 * splats that exist only before the first or after the last frame are always dropped, also for the
 * reason SPIN_ROW_DECIMATE. */
void spin_decimation_attach(struct spin_decimation *d);
/* Returns the number of kept splats of frame f. If frames share their rows, the number is valid
 * only if the row filter drops the same rows in every frame. */
size_t spin_decimation_count(const struct spin_decimation *d, int f);
