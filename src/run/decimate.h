/* --decimate: the splats of a clip that are seen least are left out.
 *
 * What a splat counts for at one time is the sum, over the pixels of a picture, of the share that
 * its colour has in them, in that of some training cameras' which shows most of it. Without cameras
 * it is opacity times size. Frames keep their best N, each its own; but what is one splat in
 * several frames - a row of all frames, a track, a 4D splat - is kept or left out as one, by its
 * mean over their times. Of 4D splats that are written as such the best N rows are kept, by their
 * sum over the clip.
 *
 * Splats that --crop, --min-views or --floaters leave out do not count, and are left out. Those
 * that an exporter leaves out anyway (--min-opacity, --max-scale, what cannot be drawn) do not
 * count either, and are left to it. */
#pragma once

#include "render/player.h"
#include "run/scene_edit.h"

enum spin_decimate_unit {
    SPIN_DECIMATE_SPLATS,
    SPIN_DECIMATE_SHARE,
    SPIN_DECIMATE_BYTES,
    SPIN_DECIMATE_DB
};

struct spin_decimate_goal {
    enum spin_decimate_unit unit;
    double amount; /* splats a frame; of 1; bytes of the whole output; dB */
};
/* "5000", "50%", "2MB" (B, kB, MB, GB: powers of 1000) or "40dB". */
spin_status spin_decimate_parse(const char *text, struct spin_decimate_goal *out);

/* A frame's splats, or those of all frames. */
struct spin_decimate_set {
    size_t n, n_counted, n_kept;
    float *weight;       /* [n] what a row counts for; below 0: it is left to the exporter */
    unsigned char *keep; /* [n] */
};

struct spin_decimation {
    /* What the clip is; the caller's. */
    const struct spin_clip *clip;
    struct spin_player *frames;             /* its splats */
    const struct spin_splats_4d *splats_4d; /* that are written as such; or NULL */
    const struct spin_plugin_values *values;
    struct spin_scene_edit *edit; /* its filters */
    const float *background;
    bool filters; /* the exporter leaves out by itself what cannot be drawn; another one gets
                     nothing of that */

    /* Private. */
    struct spin_player drawing;
    float min_logit;
    double max_scale;
    int sharing;
    struct spin_decimate_set *set; /* [n_sets] */
    int n_sets;
    struct spin_pair *pairs; /* training views, frame after frame */
    size_t n_pairs;
    struct spin_splats splats, part;
    unsigned char *left_out; /* of a frame: why; see decimate.c */
    struct spin_splats_4d kept_4d;
};

/* Weighs all splats; the fields above are set. Close it also after a failure. */
spin_status spin_decimation_open(struct spin_decimation *d);
void spin_decimation_close(struct spin_decimation *d);
/* Keeps so many: at most N in each frame (in all of 4D splats), or this share of those that count,
 * at least one. */
spin_status spin_decimation_choose(struct spin_decimation *d, enum spin_decimate_unit unit,
                                   double amount);
/* The smallest share whose loss is at least so many dB. */
spin_status spin_decimation_choose_loss(struct spin_decimation *d, double decibels);
/* The largest share of which write() makes an output of at most so many bytes; it writes to a path
 * that is removed afterwards. The last path part is that of `output`. *n_tries: how often it was
 * written, *reached: bytes of that share. */
typedef spin_status (*spin_decimation_write_fn)(void *context, const char *output);
spin_status spin_decimation_choose_bytes(struct spin_decimation *d, double bytes,
                                         const char *output, spin_decimation_write_fn write,
                                         void *context, int *n_tries, uint64_t *reached);
spin_status spin_decimation_measure(struct spin_decimation *d, struct spin_decimated *out);

/* Splats of frame f of the clip, without what is left out. counts: what the filters leave out is
 * added up. */
spin_status spin_decimation_frame(struct spin_decimation *d, int f, const struct spin_splats *all,
                                  bool counts, struct spin_splats *out);
/* Those that the bundle imported in frame f, of a clip that is a training's: the same rows where
 * the training kept the source's rows, otherwise as many of the largest. */
spin_status spin_decimation_source(struct spin_decimation *d, int f, const struct spin_splats *all,
                                   struct spin_splats *out);
/* Of the 4D splats; until the next choice. */
spin_status spin_decimation_4d(struct spin_decimation *d, const struct spin_splats_4d **out);
/* How many of a frame, before the exporter leaves some out; there are no filters. */
size_t spin_decimation_count(const struct spin_decimation *d, int f);
