/* The player decodes the splats of a clip's frames (source, retrained, refined, or those of a
 * training in progress) and renders images of them. Evaluation, previews, export and spin_render()
 * use it. */
#pragma once

#include "scene/bundle_tracks.h"
#include "scene/lens.h"
#include "model/field_eval.h"
#include "render/image_store.h"
#include "render/raster.h"

/* Reads all attribute columns of frame `index` of the clip. */
typedef spin_status (*spin_player_read_fn)(void *context, int index, struct spin_splats *out);

/* Returns frame `index` of a training in progress, in device memory. */
typedef struct spin_frame_batch (*spin_player_live_fn)(void *context, int index);

struct spin_player {
    struct spin_device *device;
    /* The bundle to play. NULL: frames come from `live`, `read` or spin_player_show_splats(). */
    struct spin_bundle *bundle;
    /* Which splats of the bundle to play; SPIN_FROM_TRAINED also for a training in progress. The
     * device computes the attributes of SPIN_FROM_TRAINED; those of other splats are uploaded. */
    enum spin_splat_source from;
    struct spin_field field;
    const struct spin_field *network; /* &field; NULL: the attributes need no network */
    const float SPIN_DEV *table, *heads;
    bool owns_network;                /* table and heads belong to the player */
    struct spin_bundle_tracks tracks; /* tracks of the bundle; n is 0 if there are none */
    spin_player_live_fn live;         /* returns frames of a training in progress; or NULL */
    spin_player_read_fn read;         /* reads frames from any other source; or NULL */
    void *context;                    /* argument of `live` and `read` */
    struct spin_field_eval field_eval;
    struct spin_raster raster;
    float SPIN_DEV *pos, *attr;    /* means and attributes of the current frame, if uploaded */
    float SPIN_DEV *residual;      /* [SPIN_RESIDUAL capacity], if the splats have residuals */
    struct spin_image_store photo; /* one image, for spin_player_measure() */
    double SPIN_DEV *values;       /* [SPIN_MEASURE_VALUES] */
    float SPIN_DEV *depth;         /* [2][pixels]; NULL until depth is requested */
    float *staging;                /* host [2][capacity][SPIN_ATTR] */
    bool keeps_contributions; /* true: the buffers of spin_player_contributions() are reserved */
    size_t capacity, pixels, tiles; /* capacities: splats; pixels and tiles of an image */
    struct spin_splats splats;      /* host copy of the current frame, as far as it was read */
    struct spin_frame_batch now;    /* the current frame */
    const float SPIN_DEV *now_attr;
    struct spin_view_batch drawn; /* the view rendered last */
    size_t drawn_pixels;
    const struct spin_lenses *lenses; /* images get the falloff of these lenses; NULL: no falloff */
    float SPIN_DEV *falloff;          /* [1 + lenses->n][SPIN_EXPOSURE], row 0: no falloff */
    int now_sh_degree, now_frame;     /* now_frame: index of the current frame; -1: other splats */
    bool now_antialias;
    uint8_t *looked;  /* [frames of the bundle] 1: n_bad and n_bad_frames include this frame */
    uint64_t n_bad;   /* splats that are not drawn, since their values are not finite */
    int n_bad_frames; /* number of frames that contain any of them */
};

/* True if spin-retrain wrote the bundle's frames: SPIN_FROM_TRAINED exists. */
bool spin_bundle_is_trained(const struct spin_bundle *bundle);
/* True if spin-retrain wrote the bundle's frames without a network, as --method tracks does. */
bool spin_bundle_is_trained_by_tracks(const struct spin_bundle *bundle);
/* True if the bundle's source consists of 4D splats that spin-retrain trained. */
bool spin_bundle_is_trained_4d(const struct spin_bundle *bundle);
/* True if the splats `from` were trained by spin-retrain, with the bundle's lenses if there are
 * any. */
bool spin_bundle_has_lenses(const struct spin_bundle *bundle, enum spin_splat_source from);

/* Opens a player for a bundle, which must stay open. `from` must not be SPIN_FROM_BEST. */
spin_status spin_player_open(struct spin_player *p, struct spin_device *device,
                             struct spin_bundle *bundle, enum spin_splat_source from);
/* Opens a player for a training in progress. network: whether the training uses the field's
 * network. table and heads still belong to the caller, and may be NULL without a network. */
void spin_player_open_live(struct spin_player *p, struct spin_device *device,
                           const struct spin_field *field, bool network,
                           const float SPIN_DEV *table, const float SPIN_DEV *heads,
                           spin_player_live_fn live, void *context);
/* Opens a player for splats that read() provides. */
void spin_player_open_reader(struct spin_player *p, struct spin_device *device,
                             spin_player_read_fn read, void *context);
/* Closes the player. Warns, once per bundle, if frames that were rendered contain splats that
 * cannot be drawn. */
void spin_player_close(struct spin_player *p);

/* Makes frame `index` of the bundle the current frame. */
spin_status spin_player_show(struct spin_player *p, int index);
/* Makes frame `index` of the training or of the reader, with n splats, the current frame. */
spin_status spin_player_show_live(struct spin_player *p, int index, size_t n);
/* Makes these splats (all attribute columns) the current frame. */
spin_status spin_player_show_splats(struct spin_player *p, const struct spin_splats *splats);

/* Reads columns of a frame of the bundle, in the order in which its splats are stored. Columns that
 * are stored as they are point into the bundle, see spin_bundle_view(). */
spin_status spin_player_splats(struct spin_player *p, int index, unsigned columns,
                               struct spin_splats *out);

/* Renders all further images with the falloff of these lenses. A camera that matches none of them
 * has no falloff. Uploads the values of the lenses; the struct itself must outlive the player. */
spin_status spin_player_set_lenses(struct spin_player *p, const struct spin_lenses *lenses);

/* Renders the current frame. image: host memory, [3][h][w]; NULL: the image is not downloaded.
 * Values are not clamped, except that a lens limits them to 1. */
spin_status spin_player_draw(struct spin_player *p, const struct spin_camera *camera,
                             const float background[3], float *image);
/* Computes the contribution of each splat of the current frame to the image rendered last: weights
 * [n] = the sum over pixels of alpha times transmittance. The member `keeps_contributions` must
 * have been set before the first image was rendered. */
spin_status spin_player_contributions(struct spin_player *p, float *weights);
/* Compares the image rendered last, clamped to 0..1, with its ground truth rgb8 (host, [h][w][3]).
 * mask: one bit per pixel, selects the regions that are also measured separately; or NULL. values:
 * see spin_device_ops.measure and docs/method.md section 9. */
spin_status spin_player_measure(struct spin_player *p, const uint8_t *rgb8, const uint8_t *mask,
                                double values[SPIN_MEASURE_VALUES]);
/* Downloads the image rendered last. */
spin_status spin_player_image(struct spin_player *p, float *image);
/* Replaces the image rendered last, for spin_player_measure(). */
void spin_player_set_image(struct spin_player *p, const float *image);

/* Downloads layers of the image rendered last; alpha and depth may be NULL. alpha: [h][w], 1 minus
 * the transmittance of all splats. depth: [2][h][w], along the camera's axis in world units,
 * expected and median. */
spin_status spin_player_layers(struct spin_player *p, float *alpha, float *depth);

/* Chooses the best splats of a bundle that have all attributes: retrained, else refined, else the
 * source. source: choose the source in any case. SPIN_E_NOT_FOUND if only positions exist. */
spin_status spin_player_choose(const struct spin_bundle *bundle, bool source,
                               enum spin_splat_source *out);
