/* The player decodes the splats of a clip's frames (source, retrained, refined, or those of a
 * training in progress) and renders images of them. It serves evaluation, previews, export and
 * spin_render(). */
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
    /* Which splats of the bundle to play; SPIN_FROM_TRAINED also for a training in progress.
     * Attributes of SPIN_FROM_TRAINED are computed on the device; attributes of other splats are
     * uploaded. */
    enum spin_splat_source from;
    struct spin_field field;
    const struct spin_field *network; /* &field; NULL: there is no network */
    const float SPIN_DEV *table, *heads;
    bool owns_network;                /* true: spin_player_close() releases table and heads */
    struct spin_bundle_tracks tracks; /* tracks of the bundle; n is 0 if there are none */
    spin_player_live_fn live;         /* returns frames of a training in progress; or NULL */
    spin_player_read_fn read;         /* reads frames from any other source; or NULL */
    void *context;                    /* argument of `live` and `read` */
    struct spin_field_eval field_eval;
    struct spin_raster raster;
    float SPIN_DEV *pos, *attr;     /* uploaded means and attributes of the current frame */
    float SPIN_DEV *residual;       /* [SPIN_RESIDUAL capacity]; NULL: none so far */
    struct spin_image_store photo;  /* ground truth of spin_player_measure(), one slot */
    double SPIN_DEV *values;        /* [SPIN_MEASURE_VALUES] */
    float SPIN_DEV *depth;          /* [2][pixels]; NULL until depth is requested */
    float *staging;                 /* host [2][capacity][SPIN_ATTR] */
    bool keeps_contributions;       /* true: reserve the buffers of spin_player_contributions() */
    size_t capacity, pixels, tiles; /* capacities: splats; pixels and tiles of an image */
    /* Host copy of the columns of the current frame that were read. */
    struct spin_splats splats;
    struct spin_frame_batch now; /* the current frame */
    const float SPIN_DEV *now_attr;
    struct spin_view_batch drawn; /* the view rendered last */
    size_t drawn_pixels;
    /* Lenses whose falloff is applied to images; NULL: no falloff. */
    const struct spin_lenses *lenses;
    /* [1 + lenses->n][SPIN_EXPOSURE] in the layout of exposure() (device.h): row 0 is a neutral
     * exposure, which all cameras use, and row 1 + k is the falloff of lens k. */
    float SPIN_DEV *falloff;
    /* now_frame: index of the current frame; -1: none, or splats that are not a frame. */
    int now_sh_degree, now_frame;
    bool now_antialias;
    uint8_t *looked;  /* [frames of the bundle] 1: the frame is counted in n_bad and n_bad_frames */
    uint64_t n_bad;   /* number of splats that are not drawn because they have non-finite values */
    int n_bad_frames; /* number of frames that contain such splats */
};

/* True if the bundle contains retrained frames, that is, SPIN_FROM_TRAINED. */
bool spin_bundle_is_trained(const struct spin_bundle *bundle);
/* True if the bundle contains frames that were retrained without a network, as with --method
 * tracks. */
bool spin_bundle_is_trained_by_tracks(const struct spin_bundle *bundle);
/* True if the source of the bundle consists of 4D splats that `spin-retrain --method 4d` trained.
 */
bool spin_bundle_is_trained_4d(const struct spin_bundle *bundle);
/* True if the splats `from` were trained by spin-retrain. If the bundle has lenses, images of these
 * splats then need the falloff of the lenses. */
bool spin_bundle_has_lenses(const struct spin_bundle *bundle, enum spin_splat_source from);

/* Opens a player for a bundle, which must stay open. `from` must not be SPIN_FROM_BEST. */
spin_status spin_player_open(struct spin_player *p, struct spin_device *device,
                             struct spin_bundle *bundle, enum spin_splat_source from);
/* Opens a player for a training in progress. network: true if the training has a network. The
 * caller keeps ownership of table and heads, which may be NULL without a network. */
void spin_player_open_live(struct spin_player *p, struct spin_device *device,
                           const struct spin_field *field, bool network,
                           const float SPIN_DEV *table, const float SPIN_DEV *heads,
                           spin_player_live_fn live, void *context);
/* Opens a player for splats that read() provides. */
void spin_player_open_reader(struct spin_player *p, struct spin_device *device,
                             spin_player_read_fn read, void *context);
/* Closes the player. Warns, once per bundle, if any frame that was shown contains splats with
 * non-finite values. */
void spin_player_close(struct spin_player *p);

/* Makes frame `index` of the bundle the current frame. */
spin_status spin_player_show(struct spin_player *p, int index);
/* Makes frame `index` of the training or of the reader, with n splats, the current frame. */
spin_status spin_player_show_live(struct spin_player *p, int index, size_t n);
/* Makes these splats (all attribute columns) the current frame. */
spin_status spin_player_show_splats(struct spin_player *p, const struct spin_splats *splats);

/* Reads columns of a frame of the bundle, with splats in the order of the bundle. If all columns
 * can be used in place, *out points into the bundle, see spin_bundle_view(). */
spin_status spin_player_splats(struct spin_player *p, int index, unsigned columns,
                               struct spin_splats *out);

/* Renders all further images with the falloff of these lenses; cameras without a matching lens have
 * no falloff. *lenses must outlive the player; its falloff values are uploaded now. */
spin_status spin_player_set_lenses(struct spin_player *p, const struct spin_lenses *lenses);

/* Renders the current frame. image: host memory [3][h][w]; NULL: the image is not downloaded.
 * Values are not clamped, except that a lens limits them to 1. */
spin_status spin_player_draw(struct spin_player *p, const struct spin_camera *camera,
                             const float background[3], float *image);
/* Computes the contribution of each splat of the current frame to the image rendered last: weights
 * [n] receives the sum of alpha times transmittance over all pixels. The member
 * `keeps_contributions` must have been set before the first image was rendered. */
spin_status spin_player_contributions(struct spin_player *p, float *weights);
/* Compares the image rendered last, clamped to 0..1, with its ground truth rgb8 (host, [h][w][3]).
 * mask: one bit per pixel, 1 in the regions that are also measured separately; or NULL. values: see
 * spin_device_ops.measure and docs/method.md section 9. */
spin_status spin_player_measure(struct spin_player *p, const uint8_t *rgb8, const uint8_t *mask,
                                double values[SPIN_MEASURE_VALUES]);
/* Downloads the image rendered last. */
spin_status spin_player_image(struct spin_player *p, float *image);
/* Replaces the image rendered last by an image [3][h][w] in host memory, for spin_player_measure().
 */
void spin_player_set_image(struct spin_player *p, const float *image);

/* Downloads layers of the image rendered last; alpha and depth may be NULL. alpha [h][w] is 1 minus
 * the transmittance of all splats. depth [2][h][w] contains the expected and the median depth, in
 * world units along the optical axis of the camera. */
spin_status spin_player_layers(struct spin_player *p, float *alpha, float *depth);

/* Chooses the splats of a bundle to play, among those that have all attributes: the retrained
 * splats if there are any, otherwise the refined splats, otherwise the source. source: true to
 * choose the source in any case. SPIN_E_NOT_FOUND if all splats to choose from have positions
 * only. */
spin_status spin_player_choose(const struct spin_bundle *bundle, bool source,
                               enum spin_splat_source *out);
