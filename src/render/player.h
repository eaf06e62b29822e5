/* Splats of a clip's frames - the source's, the network's, or those of a network in training - and
 * pictures of them. Evaluation, previews, export and spin_render() go this way. */
#pragma once

#include "scene/bundle_tracks.h"
#include "scene/lens.h"
#include "model/field_eval.h"
#include "render/image_store.h"
#include "render/raster.h"

/* All attribute columns of frame `index` of the clip. */
typedef spin_status (*spin_player_read_fn)(void *context, int index, struct spin_splats *out);

/* Frame `index` of a clip in training, on the device. */
typedef struct spin_frame_batch (*spin_player_live_fn)(void *context, int index);

struct spin_player {
    struct spin_device *device;
    struct spin_bundle *bundle;  /* NULL: only spin_player_show_splats() */
    enum spin_splat_source from; /* which of the bundle's splats; SPIN_FROM_TRAINED: computed */
    struct spin_field field;
    const struct spin_field *network; /* the same, or NULL: splats have explicit values only */
    const float SPIN_DEV *table, *heads;
    bool owns_network;
    struct spin_bundle_tracks tracks; /* of the bundle's network, if it has some */
    spin_player_live_fn live;         /* where a network in training has its frames, or NULL */
    spin_player_read_fn read; /* live: where splats come from when not from a network, or NULL */
    void *context;
    struct spin_field_eval field_eval;
    struct spin_raster raster;
    float SPIN_DEV *pos, *attr; /* what is shown when it is uploaded, not live or computed */
    float SPIN_DEV
        *residual; /* [SPIN_RESIDUAL capacity], when the network's splats have residuals */
    struct spin_image_store photo; /* one, for measuring */
    double SPIN_DEV *values;       /* [SPIN_MEASURE_VALUES] */
    float SPIN_DEV *depth;         /* [2][pixels], when it was asked for */
    float *staging;                /* host [capacity][SPIN_ATTR] */
    bool weighs;                   /* pictures are drawn with room for spin_player_weigh() */
    size_t capacity, pixels, tiles;
    struct spin_splats splats;   /* host */
    struct spin_frame_batch now; /* the frame shown */
    const float SPIN_DEV *now_attr;
    struct spin_view_batch drawn; /* the view drawn last */
    size_t drawn_pixels;
    const struct spin_lenses *lenses; /* pictures have the falloff of these; NULL: none */
    float SPIN_DEV *falloff; /* [1 + lenses->n][SPIN_EXPOSURE] no exposure, then the lenses */
    int now_sh_degree, now_frame;
    bool now_antialias;
    uint8_t *looked; /* [frames of the bundle] 1: counted below */
    uint64_t n_bad;  /* splats with values that are not finite, which nothing draws */
    int n_bad_frames;
};

/* What spin_player_open() needs to know about the network of a bundle. */
bool spin_bundle_is_trained(const struct spin_bundle *bundle);
/* The same without a network, as --method tracks leaves it. */
bool spin_bundle_is_trained_by_tracks(const struct spin_bundle *bundle);
/* Its source is 4D splats that spin-retrain trained. */
bool spin_bundle_is_trained_4d(const struct spin_bundle *bundle);
/* Whether these splats were trained behind the lenses that the bundle may have. */
bool spin_bundle_has_lenses(const struct spin_bundle *bundle, enum spin_splat_source from);

/* From an open bundle; from is not SPIN_FROM_BEST. */
spin_status spin_player_open(struct spin_player *p, struct spin_device *device,
                             struct spin_bundle *bundle, enum spin_splat_source from);
/* From a training; network: it has one by now. Table and heads stay the caller's. */
void spin_player_open_live(struct spin_player *p, struct spin_device *device,
                           const struct spin_field *field, bool network,
                           const float SPIN_DEV *table, const float SPIN_DEV *heads,
                           spin_player_live_fn live, void *context);
/* From splats that are neither in a bundle nor a network's. */
void spin_player_open_reader(struct spin_player *p, struct spin_device *device,
                             spin_player_read_fn read, void *context);
/* Warns, once for a bundle, when frames that were shown had splats that nothing can draw. */
void spin_player_close(struct spin_player *p);

/* Make frame `index` of the bundle the one that is shown. Of a live network or a reader: frame
 * `index` of the clip, with n splats. */
spin_status spin_player_show(struct spin_player *p, int index);
spin_status spin_player_show_live(struct spin_player *p, int index, size_t n);
/* Show these splats (all attribute columns). */
spin_status spin_player_show_splats(struct spin_player *p, const struct spin_splats *splats);

/* Columns of a frame, in the source's order, or that of the refined splats; what is stored is a
 * view of the bundle. */
spin_status spin_player_splats(struct spin_player *p, int index, unsigned columns,
                               struct spin_splats *out);

/* From now on pictures are what a camera with one of these lenses shows; a camera that has none of
 * them has no falloff. The lenses stay the caller's; their values are taken now. */
spin_status spin_player_set_lenses(struct spin_player *p, const struct spin_lenses *lenses);

/* Draw the frame that is shown; image (host, [3][h][w]) not clamped but where a lens shows no
 * brighter than white, or NULL: it stays on the device. */
spin_status spin_player_draw(struct spin_player *p, const struct spin_camera *camera,
                             const float background[3], float *image);
/* How much each splat of the frame that is shown gives to the picture drawn last: weights [n] = the
 * sum over its pixels of the share of the splat's colour in them. It needs `weighs` since before
 * the first picture. */
spin_status spin_player_weigh(struct spin_player *p, float *weights);
/* Compare the picture drawn last with its photograph (host, [h][w][3]); mask: bits of regions that
 * are measured apart, or NULL. values: as spin_device_ops.measure has them. The picture is clamped
 * to 0..1 (docs/method.md section 9). */
spin_status spin_player_measure(struct spin_player *p, const uint8_t *rgb8, const uint8_t *mask,
                                double values[SPIN_MEASURE_VALUES]);
/* The picture drawn last; and another one in its place, for spin_player_measure(). */
spin_status spin_player_picture(struct spin_player *p, float *image);
void spin_player_set_picture(struct spin_player *p, const float *image);

/* Of it: what it hides of the background, [h][w], 0..1; depth along the camera's axis, [2][h][w],
 * expected and median, world units. Either may be NULL. */
spin_status spin_player_layers(struct spin_player *p, float *alpha, float *depth);

/* What is best in a bundle and whole: the network's splats, the refined ones, the source's; or just
 * the source's. SPIN_E_NOT_FOUND when it has positions only. */
spin_status spin_player_choose(const struct spin_bundle *bundle, bool source,
                               enum spin_splat_source *out);
