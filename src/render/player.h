/* Splats of a clip's frames (of the source, retrained, refined, or of a training in progress), and
 * images rendered from them. Evaluation, previews, export and spin_render() use this. */
#pragma once

#include "scene/bundle_tracks.h"
#include "scene/lens.h"
#include "model/field_eval.h"
#include "render/image_store.h"
#include "render/raster.h"

/* Reads all attribute columns of frame `index` of the clip. */
typedef spin_status (*spin_player_read_fn)(void *context, int index, struct spin_splats *out);

/* Returns frame `index` of a clip in training, on the device. */
typedef struct spin_frame_batch (*spin_player_live_fn)(void *context, int index);

struct spin_player {
    struct spin_device *device;
    /* NULL: frames come from `live`, `read` or spin_player_show_splats(). */
    struct spin_bundle *bundle;
    enum spin_splat_source from; /* which of the bundle's splats; SPIN_FROM_TRAINED: decoded */
    struct spin_field field;
    const struct spin_field *network; /* &field; NULL: splats have stored values instead */
    const float SPIN_DEV *table, *heads;
    bool owns_network;
    struct spin_bundle_tracks tracks; /* of the bundle; n is 0 if it has none */
    spin_player_live_fn live;         /* returns frames of a training in progress; or NULL */
    spin_player_read_fn read;         /* reads frames from anywhere else; or NULL */
    void *context;
    struct spin_field_eval field_eval;
    struct spin_raster raster;
    float SPIN_DEV *pos, *attr;    /* the current frame, if it was uploaded; not live or decoded */
    float SPIN_DEV *residual;      /* [SPIN_RESIDUAL capacity], if the splats have residuals */
    struct spin_image_store photo; /* one image, for measuring */
    double SPIN_DEV *values;       /* [SPIN_MEASURE_VALUES] */
    float SPIN_DEV *depth;         /* [2][pixels], once depth was requested */
    float *staging;                /* host [capacity][SPIN_ATTR] */
    bool weighs;                   /* renders with buffers for spin_player_weigh() */
    size_t capacity, pixels, tiles;
    struct spin_splats splats;   /* host */
    struct spin_frame_batch now; /* the current frame */
    const float SPIN_DEV *now_attr;
    struct spin_view_batch drawn; /* the view rendered last */
    size_t drawn_pixels;
    const struct spin_lenses *lenses; /* images get the falloff of these; NULL: none */
    float SPIN_DEV *falloff;          /* [1 + lenses->n][SPIN_EXPOSURE], row 0: no falloff */
    int now_sh_degree, now_frame;
    bool now_antialias;
    uint8_t *looked; /* [frames of the bundle] 1: included in the counts below */
    uint64_t n_bad;  /* splats with values that are not finite, which are not drawn */
    int n_bad_frames;
};

/* True if spin-retrain wrote the bundle's frames: SPIN_FROM_TRAINED exists. */
bool spin_bundle_is_trained(const struct spin_bundle *bundle);
/* The same, and there is no network, as after --method tracks. */
bool spin_bundle_is_trained_by_tracks(const struct spin_bundle *bundle);
/* True if its source is 4D splats that spin-retrain trained. */
bool spin_bundle_is_trained_4d(const struct spin_bundle *bundle);
/* True if these splats were trained with the lenses that the bundle may have. */
bool spin_bundle_has_lenses(const struct spin_bundle *bundle, enum spin_splat_source from);

/* Plays an open bundle; `from` must not be SPIN_FROM_BEST. */
spin_status spin_player_open(struct spin_player *p, struct spin_device *device,
                             struct spin_bundle *bundle, enum spin_splat_source from);
/* Plays a training in progress; network: it uses one. Table and heads stay the caller's. */
void spin_player_open_live(struct spin_player *p, struct spin_device *device,
                           const struct spin_field *field, bool network,
                           const float SPIN_DEV *table, const float SPIN_DEV *heads,
                           spin_player_live_fn live, void *context);
/* Plays splats that are neither in a bundle nor of a network. */
void spin_player_open_reader(struct spin_player *p, struct spin_device *device,
                             spin_player_read_fn read, void *context);
/* Warns, once per bundle, if frames that were shown have splats that cannot be drawn. */
void spin_player_close(struct spin_player *p);

/* Makes frame `index` of the bundle the current one; the second call does so for a training or a
 * reader: frame `index` of the clip, with n splats. */
spin_status spin_player_show(struct spin_player *p, int index);
spin_status spin_player_show_live(struct spin_player *p, int index, size_t n);
/* Makes these splats (all attribute columns) the current frame. */
spin_status spin_player_show_splats(struct spin_player *p, const struct spin_splats *splats);

/* Reads columns of a frame, in the order of the source or of the refined splats. Stored columns are
 * a view of the bundle (spin_bundle_view()). */
spin_status spin_player_splats(struct spin_player *p, int index, unsigned columns,
                               struct spin_splats *out);

/* Renders all further images through these lenses; a camera that matches none of them has no
 * falloff. The lenses must outlive the player; their values are uploaded now. */
spin_status spin_player_set_lenses(struct spin_player *p, const struct spin_lenses *lenses);

/* Renders the current frame. image: host memory, [3][h][w]; NULL: it stays on the device. Values
 * are not clamped, except that a lens limits them to 1. */
spin_status spin_player_draw(struct spin_player *p, const struct spin_camera *camera,
                             const float background[3], float *image);
/* Contribution of each splat of the current frame to the image rendered last: weights [n] = the sum
 * over pixels of alpha times transmittance. `weighs` must be set before the first image is
 * rendered. */
spin_status spin_player_weigh(struct spin_player *p, float *weights);
/* Compares the image rendered last, clamped to 0..1, with its ground truth (host, [h][w][3]). mask:
 * one bit per pixel, selects regions that are measured separately; or NULL. values: see
 * spin_device_ops.measure and docs/method.md section 9. */
spin_status spin_player_measure(struct spin_player *p, const uint8_t *rgb8, const uint8_t *mask,
                                double values[SPIN_MEASURE_VALUES]);
/* Downloads the image rendered last; or replaces it by another one, for spin_player_measure(). */
spin_status spin_player_picture(struct spin_player *p, float *image);
void spin_player_set_picture(struct spin_player *p, const float *image);

/* Layers of the image rendered last: opacity [h][w], 0..1; depth along the camera's axis,
 * [2][h][w], expected and median, in world units. Either may be NULL. */
spin_status spin_player_layers(struct spin_player *p, float *alpha, float *depth);

/* Chooses the best complete splats of a bundle: retrained, else refined, else the source's. source:
 * the source's only. SPIN_E_NOT_FOUND if there are only positions. */
spin_status spin_player_choose(const struct spin_bundle *bundle, bool source,
                               enum spin_splat_source *out);
