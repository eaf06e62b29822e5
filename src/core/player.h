/* Plays a clip: the splats of a frame - the source's, the network's, or those of a network that is
 * being trained - and pictures of them. Evaluation, previews, export and spin_render() go this way. */
#ifndef SPIN_CORE_PLAYER_H
#define SPIN_CORE_PLAYER_H

#include "core/clip.h"
#include "core/model.h"
#include "core/raster.h"

/* All attribute columns of frame `index` of the clip. */
typedef spin_status (*spin_player_read_fn)(void *context, int index, struct spin_splats *out);

struct spin_player {
    struct spin_device *device;
    struct spin_bundle *bundle; /* NULL: only spin_player_show_splats() */
    enum spin_from from;        /* which of the bundle's splats; SPIN_FROM_NETWORK: decode */
    struct spin_model model;
    float *table, *heads; /* device */
    bool owns_network;
    float *const *live_pos;   /* [frames of the clip] positions on the device, or NULL */
    float *const *live_own;   /* [frames of the clip] own values on the device, or NULL */
    spin_player_read_fn read; /* live: where splats come from when not from a network, or NULL */
    void *context;
    struct spin_decode decode;
    struct spin_raster raster;
    float *pos, *attr; /* device: what is shown when not live or not decoded */
    float *own; /* device [SPIN_OWN capacity], when the network's splats have values of theirs */
    float *shown, *truth; /* device [3][h][w], for measuring */
    float *staging;       /* host [capacity][SPIN_ATTR] */
    size_t capacity, pixels, tiles;
    struct spin_splats splats;       /* host */
    const float *now_pos, *now_attr; /* of the frame shown */
    size_t now_n;
    int now_sh_degree, now_frame;
    bool now_antialias;
    uint8_t *looked; /* [frames of the bundle] 1: counted below */
    uint64_t n_bad;  /* splats with values that are not finite, which nothing draws */
    int n_bad_frames;
};

/* What spin_player_open() needs to know about the network of a bundle. */
bool spin_bundle_has_network(const struct spin_bundle *bundle);

/* From an open bundle; from is not SPIN_FROM_BEST. */
spin_status spin_player_open(struct spin_player *p, struct spin_device *device,
                             struct spin_bundle *bundle, enum spin_from from);
/* From a network in training; table, heads, live_pos and live_own (NULL: none) stay the caller's. */
spin_status spin_player_open_live(struct spin_player *p, struct spin_device *device,
                                  const struct spin_model *model, float *table, float *heads,
                                  float *const *live_pos, float *const *live_own);
/* From splats that are neither in a bundle nor a network's. */
void spin_player_open_reader(struct spin_player *p, struct spin_device *device,
                             spin_player_read_fn read, void *context);
/* Warns, once for a bundle, when frames that were shown had splats that nothing can draw. */
void spin_player_close(struct spin_player *p);

/* Make frame `index` of the bundle the one that is shown. In a live player or a reader: frame `index`
 * of the clip, with n splats and this time. */
spin_status spin_player_show(struct spin_player *p, int index);
spin_status spin_player_show_live(struct spin_player *p, int index, size_t n, double time);
/* Show these splats (all attribute columns). */
spin_status spin_player_show_splats(struct spin_player *p, const struct spin_splats *splats);

/* Columns of a frame, in the source's order, or that of the refined splats; what is stored is a view of
 * the bundle. */
spin_status spin_player_splats(struct spin_player *p, int index, unsigned columns,
                               struct spin_splats *out);

/* Draw the frame that is shown; image (host, [3][h][w]) not clamped. */
spin_status spin_player_draw(struct spin_player *p, const struct spin_camera *camera,
                             const float background[3], float *image);

/* What is best in a bundle and whole: the network's splats, the refined ones, the source's; or just the
 * source's. SPIN_E_NOT_FOUND when it has positions only. */
spin_status spin_player_choose(const struct spin_bundle *bundle, bool source, enum spin_from *out);

/* PSNR and SSIM: image is clamped to 0..1 in place (method.md section 8). */
spin_status spin_player_compare(struct spin_player *p, int width, int height, float *image,
                                const float *truth, struct spin_quality *out);

#endif
