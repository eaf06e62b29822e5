/* --decimate: drops the splats of a clip that contribute least.
 *
 * A splat's weight at one time is its total blending contribution (sum of alpha times transmittance
 * over the pixels) in one training view; the maximum over some of the frame's training views is
 * used. Without cameras it is opacity times size. Each frame keeps its own best N splats, but
 * splats shared by several frames (the same row of all frames, a track, a 4D splat) are kept or
 * dropped as one, by their mean weight over those frames. If 4D splats are exported as such, the
 * best N rows are kept, by the sum of their weights over the clip.
 *
 * Splats that the row filter drops for another reason do not count. */
#pragma once

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
    double amount; /* splats per frame; a share, 0..1; bytes of the whole output; dB */
};
/* Parses "5000", "50%", "2MB" (B, kB, MB, GB: powers of 1000) or "40dB". */
spin_status spin_decimate_parse(const char *text, struct spin_decimate_goal *out);

/* The splats of one frame, or of all frames if frames share their rows. */
struct spin_decimate_set {
    size_t n, n_counted, n_kept;
    float *weight;       /* [n] weight of a row; negative: does not count */
    unsigned char *keep; /* [n] */
};

struct spin_decimation {
    /* Inputs, set and owned by the caller. */
    const struct spin_clip *clip;
    struct spin_player *frames;             /* reads the splats of the clip */
    const struct spin_splats_4d *splats_4d; /* 4D splats to export as such, or NULL */
    struct spin_row_filter *filter;         /* judges the rows before decimation */
    const float *background;

    /* Private. */
    struct spin_player drawing;
    int sharing;
    struct spin_decimate_set *set; /* [n_sets] */
    int n_sets;
    struct spin_pair *pairs; /* training views, sorted by frame */
    size_t n_pairs;
    struct spin_splats splats, part;
};

/* Computes all weights; the inputs above must be set. Close d also after a failure. */
spin_status spin_decimation_open(struct spin_decimation *d);
void spin_decimation_close(struct spin_decimation *d);
/* Chooses the splats to keep: at most `amount` in each frame (in total for 4D splats), or this
 * share of those that count, at least one. */
spin_status spin_decimation_choose(struct spin_decimation *d, enum spin_decimate_unit unit,
                                   double amount);
/* Chooses the smallest share whose PSNR against all splats is at least `decibels`. */
spin_status spin_decimation_choose_loss(struct spin_decimation *d, double decibels);
/* Chooses the largest share for which write() makes an output of at most `bytes` bytes. write()
 * gets a temporary path, removed afterwards, whose last component is that of `output`. *n_tries:
 * number of writes; *reached: bytes of the chosen share. SPIN_E_UNSUPPORTED if even one splat per
 * frame is too large. */
typedef spin_status (*spin_decimation_write_fn)(void *context, const char *output);
spin_status spin_decimation_choose_bytes(struct spin_decimation *d, double bytes,
                                         const char *output, spin_decimation_write_fn write,
                                         void *context, int *n_tries, uint64_t *reached);
spin_status spin_decimation_measure(struct spin_decimation *d, struct spin_decimated *out);

/* Sets the reason of the rows of frame f that are not kept to SPIN_ROW_DECIMATE, if it is
 * SPIN_ROW_KEPT before. source: *all are the imported splats of a retrained clip: their kept rows
 * are those of the retrained frame if the training preserved the source's rows, otherwise as many
 * of the largest. */
spin_status spin_decimation_drop(struct spin_decimation *d, int f, const struct spin_splats *all,
                                 bool source, unsigned char *reason);
/* The same for 4D splats; rows that exist outside the clip only are dropped too. */
void spin_decimation_drop_4d(const struct spin_decimation *d, unsigned char *reason);
/* Number of kept splats of frame f; without filters that vary between frames. */
size_t spin_decimation_count(const struct spin_decimation *d, int f);
