/* Decodes the splats of frames and renders images of them. */
#include "render/player.h"

#include "base/base.h"
#include "math/drawable.h"
#include "model/field.h"

bool spin_bundle_is_trained(const struct spin_bundle *bundle)
{
    return spin_json_get(bundle->json, "trained") != NULL;
}

bool spin_bundle_is_trained_by_tracks(const struct spin_bundle *bundle)
{
    return spin_bundle_is_trained(bundle) &&
           spin_json_is_null(spin_json_get(spin_json_get(bundle->json, "trained"), "field"));
}

bool spin_bundle_is_trained_4d(const struct spin_bundle *bundle)
{
    return spin_json_get(bundle->json, "trained_4d") != NULL;
}

bool spin_bundle_has_lenses(const struct spin_bundle *bundle, enum spin_splat_source from)
{
    return from != SPIN_FROM_SOURCE || spin_bundle_is_trained_4d(bundle);
}

spin_status spin_player_choose(const struct spin_bundle *bundle, bool source,
                               enum spin_splat_source *out)
{
    if (!source && spin_bundle_is_trained(bundle))
        *out = SPIN_FROM_TRAINED;
    else if (!source && !(SPIN_COL_ATTRIBUTES & ~bundle->refined.columns))
        *out = SPIN_FROM_REFINED;
    else if (!(SPIN_COL_ATTRIBUTES & ~bundle->meta.columns))
        *out = SPIN_FROM_SOURCE;
    else if (source)
        return spin_not_found("the source in '%s' contains positions only: omit --source",
                              bundle->path);
    else
        return spin_not_found("'%s' contains positions only: run spin-retrain first", bundle->path);
    return SPIN_OK;
}

/* ---- Values that are not finite -------------------------------------------------------------- */

/* True if a splat can be drawn, that is, if its values are finite. Two infinite values are allowed:
 * an infinite logit, which means an opacity of 0 or 1, and a log scale of minus infinity, which
 * means a scale of 0. */
static bool is_drawable(const struct spin_splats *s, size_t i, size_t n_sh)
{
    const float *scale = s->log_scales + 3 * i;

    return spin_zeros(s->means + 3 * i, 3) + spin_zeros(s->quats + 4 * i, 4) +
                   spin_zeros(s->sh + n_sh * i, n_sh) ==
               0.0f &&
           scale[0] < INFINITY && scale[1] < INFINITY && scale[2] < INFINITY &&
           !isnan(s->logit_opacities[i]);
}

static void add_bad_splats(struct spin_player *p, int index, size_t n_bad)
{
    p->looked[index] = 1;
    p->n_bad += n_bad;
    p->n_bad_frames += n_bad > 0;
}

static void count_stored(struct spin_player *p, int index, const struct spin_splats *s)
{
    size_t n_sh = 3 * (size_t)(s->sh_degree + 1) * (size_t)(s->sh_degree + 1), n_bad = 0;

    if (!p->looked || p->looked[index])
        return;
    for (size_t i = 0; i < s->n; i++)
        n_bad += !is_drawable(s, i, n_sh);
    add_bad_splats(p, index, n_bad);
}

/* Counts splats whose positions or residuals are not finite; residual may be NULL. All other values
 * are computed by the network, whose parameters were checked when it was loaded. */
static void count_network(struct spin_player *p, int index, size_t n, const float *means,
                          const float *residual)
{
    size_t n_bad = 0;

    if (!p->looked || p->looked[index])
        return;
    for (size_t i = 0; i < n; i++)
        n_bad += spin_zeros(means + 3 * i, 3) +
                     (residual ? spin_zeros(residual + SPIN_RESIDUAL * i, SPIN_RESIDUAL) : 0) !=
                 0.0f;
    add_bad_splats(p, index, n_bad);
}

static void warn_bad(const struct spin_player *p)
{
    char count[48];

    if (p->n_bad == 0 || p->bundle->nonfinite_reported)
        return;
    p->bundle->nonfinite_reported = true;
    spin_warn("'%s': %s in %d of its frames %s values that are not finite, and %s not drawn",
              p->bundle->path, spin_text_count((long long)p->n_bad, "splat", count),
              p->n_bad_frames, p->n_bad == 1 ? "has" : "have", p->n_bad == 1 ? "is" : "are");
}

static spin_status check_weights(const char *name, const float *values, size_t n)
{
    size_t n_bad = 0;

    for (size_t i = 0; i < n; i++)
        n_bad += !isfinite(values[i]);
    if (n_bad > 0)
        return spin_malformed("array '%s' has %zu values that are not finite", name, n_bad);
    return SPIN_OK;
}

/* ---- Opening --------------------------------------------------------------------------------- */

enum { PORTION = 1 << 20 }; /* number of values of a compressed array that are decoded at a time */

static spin_status upload_values(struct spin_player *p, const char *name,
                                 const struct spin_bundle_values *v, float SPIN_DEV *to)
{
    struct spin_device *d = p->device;
    SPIN_FREED void *block = NULL;
    spin_status status = SPIN_OK;

    if (v->floats) {
        SPIN_TRY(check_weights(name, v->floats, (size_t)v->count));
        d->op->upload(d, to, v->floats, (size_t)v->count * sizeof(float));
        return SPIN_OK;
    }
    SPIN_TRY(spin_alloc(PORTION, sizeof(float), &block));
    for (uint64_t first = 0; first < v->count && status == SPIN_OK; first += PORTION) {
        size_t n = v->count - first < PORTION ? (size_t)(v->count - first) : PORTION;

        spin_bundle_values_get(v, first, n, block);
        status = check_weights(name, block, n);
        d->op->upload(d, to + first, block, n * sizeof(float));
    }
    return status;
}

static spin_status load_array(struct spin_player *p, const char *name, int n_dims, size_t n,
                              const float SPIN_DEV **out)
{
    const int64_t any[2] = {-1, -1};
    SPIN_LEAVES(spin_bundle_values_close) struct spin_bundle_values v = {0};
    float SPIN_DEV *to;

    SPIN_TRY(spin_bundle_values_open(p->bundle, name, -1, 'f', n_dims, any, &v));
    if (v.count != n)
        return spin_malformed("array '%s' has %llu values, but meta.json requires %zu", name,
                              (unsigned long long)v.count, n);
    SPIN_TRY(p->device->op->reserve(p->device, n * sizeof(float), (void SPIN_DEV **)&to));
    *out = to;
    return upload_values(p, name, &v, to);
}

spin_status spin_player_open(struct spin_player *p, struct spin_device *device,
                             struct spin_bundle *bundle, enum spin_splat_source from)
{
    bool there;
    spin_status status;

    memset(p, 0, sizeof *p);
    p->device = device;
    p->bundle = bundle;
    p->from = from;
    p->now_frame = -1;
    if (bundle)
        SPIN_TRY(spin_alloc((size_t)bundle->meta.n_frames, 1, (void **)&p->looked));
    if (from != SPIN_FROM_TRAINED)
        return SPIN_OK;
    p->owns_network = true;
    SPIN_TRY_OUT(spin_field_from_json(spin_json_get(bundle->json, "trained"), &p->field, &there));
    p->network = there ? &p->field : NULL;
    SPIN_TRY_OUT(spin_bundle_tracks_open(bundle, &p->tracks));
    if (p->network) {
        SPIN_TRY_OUT(load_array(p, "trained/table", 2, p->field.n_table, &p->table));
        SPIN_TRY_OUT(load_array(p, "trained/heads", 1, p->field.n_heads, &p->heads));
    }
    return SPIN_OK;
out:
    spin_player_close(p);
    return spin_fail_context(status, "cannot read '%s'", bundle->path);
}

void spin_player_open_live(struct spin_player *p, struct spin_device *device,
                           const struct spin_field *field, bool network,
                           const float SPIN_DEV *table, const float SPIN_DEV *heads,
                           spin_player_live_fn live, void *context)
{
    memset(p, 0, sizeof *p);
    p->device = device;
    p->from = SPIN_FROM_TRAINED;
    p->field = *field;
    p->network = network ? &p->field : NULL;
    p->table = table;
    p->heads = heads;
    p->live = live;
    p->context = context;
    p->now_frame = -1;
}

void spin_player_open_reader(struct spin_player *p, struct spin_device *device,
                             spin_player_read_fn read, void *context)
{
    memset(p, 0, sizeof *p);
    p->device = device;
    p->from = SPIN_FROM_REFINED;
    p->read = read;
    p->context = context;
    p->now_frame = -1;
}

static void release_frame(struct spin_player *p)
{
    struct spin_device *d = p->device;

    spin_field_eval_close(&p->field_eval, p->network);
    d->op->release(d, p->pos);
    d->op->release(d, p->attr);
    d->op->release(d, p->residual);
    p->pos = p->attr = p->residual = NULL;
    free(p->staging);
    p->staging = NULL;
    spin_raster_close(&p->raster);
    p->capacity = 0;
}

static void release_images(struct spin_player *p)
{
    struct spin_device *d = p->device;

    spin_raster_close(&p->raster);
    spin_image_store_close(&p->photo);
    d->op->release(d, p->values);
    d->op->release(d, p->depth);
    p->values = NULL;
    p->depth = NULL;
    p->pixels = p->tiles = 0;
}

void spin_player_close(struct spin_player *p)
{
    if (!p->device)
        return;
    warn_bad(p);
    free(p->looked);
    release_frame(p);
    release_images(p);
    if (p->lenses)
        p->device->op->release(p->device, p->falloff);
    spin_bundle_tracks_close(&p->tracks);
    if (p->owns_network) {
        p->device->op->release(p->device, (void SPIN_DEV *)p->table);
        p->device->op->release(p->device, (void SPIN_DEV *)p->heads);
    }
    spin_splats_free(&p->splats);
    memset(p, 0, sizeof *p);
}

/* Ensures capacity for n splats. If the buffers have to grow, the current frame is discarded. */
static spin_status reserve_frame(struct spin_player *p, size_t n)
{
    struct spin_device *d = p->device;
    size_t capacity = n + n / 8 + 64;
    spin_status status;

    if (n <= p->capacity)
        return SPIN_OK;
    release_frame(p);
    p->now_frame = -1;
    SPIN_TRY_OUT(d->op->reserve(d, capacity * 3 * sizeof(float), (void SPIN_DEV **)&p->pos));
    SPIN_TRY_OUT(spin_alloc(capacity * SPIN_ATTR, 2 * sizeof(float), (void **)&p->staging));
    SPIN_TRY_OUT(
        p->from == SPIN_FROM_TRAINED
            ? spin_field_eval_open(&p->field_eval, d, p->network, false, capacity, false)
            : d->op->reserve(d, capacity * SPIN_ATTR * sizeof(float), (void SPIN_DEV **)&p->attr));
    p->capacity = capacity;
    return SPIN_OK;
out:
    release_frame(p);
    return status;
}

static void decode_frame(struct spin_player *p, const struct spin_frame_batch *frame)
{
    p->now = *frame;
    p->now.narrow = p->field_eval.narrow;
    spin_field_forward(&p->field_eval, p->network, p->table, p->heads, &p->now);
    p->now_attr = p->field_eval.attr;
    p->now_sh_degree = p->network ? p->field.sh_degree : 0;
    p->now_antialias = p->field.antialias;
}

/* Reads the array [n][width] of frame `index` from a series, that is, a group of arrays of the
 * bundle with one array per frame. */
static spin_status read_rows(struct spin_player *p, const char *series, int index, size_t n,
                             int64_t width, float *to)
{
    const int64_t shape[2] = {(int64_t)n, width};
    struct spin_bundle_values v;

    SPIN_TRY(spin_bundle_values_open(p->bundle, series, index, 'f', 2, shape, &v));
    spin_bundle_values_get(&v, 0, (size_t)v.count, to);
    spin_bundle_values_close(&v);
    return SPIN_OK;
}

/* Uploads the residuals of a frame from rows [n][SPIN_RESIDUAL] in the staging buffer. */
static spin_status upload_residual(struct spin_player *p, size_t n, const float SPIN_DEV **residual)
{
    struct spin_device *d = p->device;
    float *rows = p->staging, *groups = p->staging + p->capacity * SPIN_ATTR;

    if (!p->residual)
        SPIN_TRY(d->op->reserve(d, p->capacity * SPIN_RESIDUAL * sizeof(float),
                                (void SPIN_DEV **)&p->residual));
    spin_residual_from_rows(n, rows, SPIN_RESIDUAL, NULL, groups);
    d->op->upload(d, p->residual, groups, n * SPIN_RESIDUAL * sizeof(float));
    *residual = p->residual;
    return SPIN_OK;
}

/* Reads and uploads the residuals of a frame; *residual is NULL if the frame has none. */
static spin_status read_residual(struct spin_player *p, int index, size_t n,
                                 const float SPIN_DEV **residual)
{
    char name[64];

    *residual = NULL;
    snprintf(name, sizeof name, "trained/residual/%05d", index);
    if (!spin_npz_has(&p->bundle->npz, name))
        return SPIN_OK;
    SPIN_TRY(read_rows(p, "trained/residual", index, n, SPIN_RESIDUAL, p->staging));
    return upload_residual(p, n, residual);
}

/* Reads positions and residuals of a retrained frame. */
static spin_status read_network_frame(struct spin_player *p, int index, size_t n,
                                      const float SPIN_DEV **residual)
{
    SPIN_TRY(spin_splats_reserve(&p->splats, n, SPIN_COL_MEANS, 0));
    if (!p->tracks.values) {
        SPIN_TRY(read_rows(p, "trained/means", index, n, 3, p->splats.means));
        return read_residual(p, index, n, residual);
    }
    SPIN_TRY(spin_bundle_tracks_frame(&p->tracks, index, n, p->splats.means, p->staging));
    return upload_residual(p, n, residual);
}

/* Reads columns of splats that need no network and no tracks. */
static spin_status read_stored(struct spin_player *p, int index, unsigned columns,
                               struct spin_splats *out)
{
    return spin_bundle_view(p->bundle, index, p->from, columns, out);
}

spin_status spin_player_show(struct spin_player *p, int index)
{
    size_t n = spin_bundle_count(p->bundle, index, p->from);
    const float SPIN_DEV *residual;
    struct spin_frame_batch frame;

    if (p->now_frame == index)
        return SPIN_OK;
    if (p->from != SPIN_FROM_TRAINED) {
        SPIN_TRY(read_stored(p, index, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, &p->splats));
        count_stored(p, index, &p->splats);
        SPIN_TRY(spin_player_show_splats(p, &p->splats));
        spin_bundle_release(&p->splats);
    } else {
        SPIN_TRY(reserve_frame(p, n));
        SPIN_TRY(read_network_frame(p, index, n, &residual));
        p->device->op->upload(p->device, p->pos, p->splats.means, n * 3 * sizeof(float));
        count_network(p, index, n, p->splats.means, residual ? p->staging : NULL);
        frame = spin_one_frame(
            n, p->pos, spin_field_time(&p->field, p->bundle->meta.frame[index].time), residual);
        decode_frame(p, &frame);
    }
    p->now_frame = index;
    return SPIN_OK;
}

spin_status spin_player_show_live(struct spin_player *p, int index, size_t n)
{
    struct spin_frame_batch frame;

    if (p->read) {
        SPIN_TRY(p->read(p->context, index, &p->splats));
        return spin_player_show_splats(p, &p->splats);
    }
    SPIN_TRY(reserve_frame(p, n));
    frame = p->live(p->context, index);
    decode_frame(p, &frame);
    p->now_frame = index;
    return SPIN_OK;
}

spin_status spin_player_show_splats(struct spin_player *p, const struct spin_splats *s)
{
    SPIN_TRY(reserve_frame(p, s->n));
    spin_attr_from_splats(s, p->staging);
    p->device->op->upload(p->device, p->pos, s->means, s->n * 3 * sizeof(float));
    p->device->op->upload(p->device, p->attr, p->staging, s->n * SPIN_ATTR * sizeof(float));
    p->now = spin_one_frame(s->n, p->pos, 0, NULL);
    p->now_attr = p->attr;
    p->now_sh_degree = s->sh_degree;
    p->now_antialias = s->antialias;
    p->now_frame = -1;
    return SPIN_OK;
}

spin_status spin_player_splats(struct spin_player *p, int index, unsigned columns,
                               struct spin_splats *out)
{
    size_t bytes;
    float *raw, *attr;

    if (p->from != SPIN_FROM_TRAINED)
        return read_stored(p, index, columns, out);
    SPIN_TRY(spin_player_show(p, index));
    SPIN_TRY(spin_splats_reserve(out, p->now.n, columns, p->now_sh_degree));
    out->antialias = p->field.antialias;
    if (columns & SPIN_COL_MEANS)
        SPIN_TRY(p->device->op->download(p->device, out->means, p->now.frame[0].means,
                                         p->now.n * 3 * sizeof(float)));
    raw = p->staging;
    attr = p->staging + p->capacity * SPIN_ATTR;
    bytes = p->now.n * spin_attr_width(&p->now) * sizeof(float);
    SPIN_TRY(p->device->op->download(p->device, raw, p->field_eval.raw, bytes));
    SPIN_TRY(p->device->op->download(p->device, attr, p->field_eval.attr, bytes));
    spin_attr_to_splats(raw, attr, spin_attr_width(&p->now), out);
    return SPIN_OK;
}

/* Ensures that the raster is open and has capacity for an image of this size. */
static spin_status reserve_images(struct spin_player *p, size_t pixels, size_t tiles)
{
    if (pixels > p->pixels || tiles > p->tiles) {
        release_images(p);
        p->pixels = pixels;
        p->tiles = tiles;
    }
    if (!p->raster.device)
        return spin_raster_open(&p->raster, p->device, p->capacity, p->pixels, p->tiles, 1,
                                p->keeps_contributions);
    return SPIN_OK;
}

spin_status spin_player_set_lenses(struct spin_player *p, const struct spin_lenses *lenses)
{
    struct spin_device *d = p->device;
    float none[SPIN_EXPOSURE] = {0};

    if (lenses->n == 0)
        return SPIN_OK;
    SPIN_TRY(d->op->reserve(d, (size_t)(1 + lenses->n) * SPIN_EXPOSURE * sizeof(float),
                            (void SPIN_DEV **)&p->falloff));
    p->lenses = lenses;
    d->op->upload(d, p->falloff, none, sizeof none);
    for (int i = 0; i < lenses->n; i++)
        d->op->upload(d, p->falloff + (size_t)(1 + i) * SPIN_EXPOSURE, lenses->lens[i].falloff,
                      sizeof lenses->lens[i].falloff);
    return SPIN_OK;
}

/* Applies the falloff of the camera's lens to the image rendered last. */
static void apply_lens(struct spin_player *p, const struct spin_camera *camera)
{
    int lens = p->lenses ? spin_lenses_find(p->lenses, camera) : -1;

    if (lens < 0)
        return;
    p->drawn.view[0].exposure = 0;
    p->drawn.view[0].lens = 1 + lens;
    p->device->op->exposure(p->device, &p->drawn, p->falloff, p->raster.image, p->raster.image);
}

spin_status spin_player_draw(struct spin_player *p, const struct spin_camera *camera,
                             const float background[3], float *image)
{
    struct spin_camera_f32 cam = spin_camera_f32_from(camera);

    p->drawn_pixels = (size_t)cam.width * (size_t)cam.height;
    SPIN_TRY(reserve_images(p, p->drawn_pixels, (size_t)cam.tiles_x * (size_t)cam.tiles_y));
    p->drawn = spin_raster_batch(&p->raster, background);
    spin_raster_add_view(&p->raster, &p->drawn, 0, p->now.n, camera, p->now_antialias);
    SPIN_TRY(spin_raster_forward(&p->raster, &p->drawn, &p->now, p->now_attr, p->now_sh_degree));
    apply_lens(p, camera);
    return image ? spin_player_image(p, image) : SPIN_OK;
}

spin_status spin_player_image(struct spin_player *p, float *image)
{
    return p->device->op->download(p->device, image, p->raster.image,
                                   3 * p->drawn_pixels * sizeof(float));
}

/* The contribution of a splat is the derivative of the sum of all pixels with respect to the
 * splat's colour, so this runs the backward pass of blending with a gradient of 1 in every pixel.
 */
spin_status spin_player_contributions(struct spin_player *p, float *weights)
{
    struct spin_device *d = p->device;
    struct spin_raster *r = &p->raster;
    size_t n = p->now.n, n_values = 3 * p->drawn_pixels;
    SPIN_FREED struct spin_splat2d_grad *slope = NULL;
    SPIN_FREED float *ones = NULL;

    SPIN_TRY(spin_alloc(n_values, sizeof *ones, (void **)&ones));
    SPIN_TRY(spin_alloc(n + 1, sizeof *slope, (void **)&slope));
    for (size_t i = 0; i < n_values; i++)
        ones[i] = 1;
    d->op->upload(d, r->d_image, ones, n_values * sizeof *ones);
    d->op->blend_back(d, &p->drawn, r->splat2d, &r->tiles, r->final_transmittance,
                      r->last_contributor, r->d_image, r->d_splat2d);
    SPIN_TRY(d->op->download(d, slope, r->d_splat2d, n * sizeof *slope));
    for (size_t i = 0; i < n; i++)
        weights[i] = slope[i].colour[0];
    return SPIN_OK;
}

spin_status spin_player_layers(struct spin_player *p, float *alpha, float *depth)
{
    struct spin_device *d = p->device;
    size_t n = p->drawn_pixels;

    if (alpha) {
        SPIN_TRY(d->op->download(d, alpha, p->raster.final_transmittance, n * sizeof(float)));
        for (size_t i = 0; i < n; i++)
            alpha[i] = 1 - alpha[i];
    }
    if (!depth)
        return SPIN_OK;
    if (!p->depth)
        SPIN_TRY(d->op->reserve(d, 2 * p->pixels * sizeof(float), (void SPIN_DEV **)&p->depth));
    d->op->depth(d, &p->drawn, p->raster.splat2d, &p->raster.tiles, p->depth);
    return d->op->download(d, depth, p->depth, 2 * n * sizeof(float));
}

void spin_player_set_image(struct spin_player *p, const float *image)
{
    p->device->op->upload(p->device, p->raster.image, image, 3 * p->drawn_pixels * sizeof(float));
}

spin_status spin_player_measure(struct spin_player *p, const uint8_t *rgb8, const uint8_t *mask,
                                double values[SPIN_MEASURE_VALUES])
{
    struct spin_device *d = p->device;
    struct spin_images images;

    if (!p->values)
        SPIN_TRY(d->op->reserve(d, SPIN_MEASURE_VALUES * sizeof *p->values,
                                (void SPIN_DEV **)&p->values));
    if (!p->photo.device)
        SPIN_TRY(spin_image_store_open(&p->photo, d, 1, p->pixels, SPIN_IMAGE_RGB8, true));
    spin_image_store_put(&p->photo, 0, p->drawn_pixels, rgb8, mask);
    images = p->photo.images;
    if (!mask)
        images.mask = NULL;
    d->op->measure(d, &p->drawn, &images, p->raster.image, p->values);
    return d->op->download(d, values, p->values, SPIN_MEASURE_VALUES * sizeof *values);
}
