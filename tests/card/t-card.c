/* Compares every verb of a GPU with the CPU's, on random input: `t-card [SPLATS [WIDTH HEIGHT]]`. A
 * verb gets the same arrays on both; the next verbs use the CPU's results. Prints the difference of
 * the results, and the milliseconds of the second call.
 * K: device cuda
 *
 * It needs only a C compiler and nvcc:
 *     nvcc -std=c++20 -O3 -arch=native -Isrc -I. -Xcompiler -fPIC,-fvisibility=hidden -shared \
 *         -o spin-cuda.so $(ls src/device/cuda/[!n]*.cu)
 *     gcc -O3 -march=native -std=gnu11 -D_GNU_SOURCE -DSPIN_CPU_PATH=base -fno-math-errno -Isrc \
 *         -I. -o t-card tests/card/t-card.c src/base/{err,log,mem,pool,shim,text}.c \
 *         src/device/device.c $(find src/device/cpu -name '[a-z]*.c') -pthread -ldl -lm
 *     SPIN_CUDA_SHIM=$PWD/spin-cuda.so ./t-card 450000 */

#include "base/log.h"
#include "device/device.h"
#include "tests/tap.h"

enum { FRAMES = 2, VIEWS = 2, LEVELS = 16, WIDTH_OF_Z = 4 * LEVELS, HIDDEN = 64, TRACKS = 100 };
static size_t n = 20000; /* splats per frame */
static int width = 320, height = 180;

/* ---- Arrays, on the host and on each device -------------------------------------------------- */

enum array {
    MEANS,
    D_MEANS,
    OWN,
    D_OWN,
    TRACK,
    TRACK_VALUES,
    D_TRACK_VALUES,
    TRACK_MOTION,
    TURN,
    GRADIENT,
    SEEN,
    X_U,
    D_X_U,
    TABLE,
    D_TABLE,
    Z,
    D_Z,
    HEADS,
    D_HEADS,
    RAW,
    D_RAW,
    ATTR,
    D_ATTR,
    ROWS,
    N_ROWS,
    SPLAT2D,
    D_SPLAT2D,
    LISTS,
    START,
    IMAGE,
    D_IMAGE,
    LEFT,
    LAST,
    PHOTOS,
    MASK,
    LOSS,
    MEASURED,
    EXPOSURE,
    D_EXPOSURE,
    MOMENT,
    MOMENT_2,
    NO_NUMBER,
    ARRAYS
};
enum kind { FLOATS, COUNTS, DOUBLES, BYTES, SPLATS };
static const size_t kind_bytes[] = {4, 4, 8, 1, sizeof(struct spin_splat2d)};

static struct {
    enum kind kind;
    size_t n;
    char *host, *got; /* results of the CPU and of the GPU */
} array[ARRAYS];

struct side {
    struct spin_device d;
    void SPIN_DEV *at[ARRAYS];
    struct spin_tiles tiles;
    struct spin_lazy_adam *lazy;
};
static struct side cpu, card;

static struct spin_grid grid;
static struct spin_heads heads;
static struct spin_view_batch views;
static uint64_t pairs_most;

static float uniform(float low, float high)
{
    static uint64_t state = 1;

    state = state * 6364136223846793005u + 1442695040888963407u;
    return low + (high - low) * (float)(state >> 40) * 0x1p-24f;
}

static void make(enum array a, enum kind kind, size_t count, float low, float high)
{
    array[a].kind = kind;
    array[a].n = count;
    array[a].host = calloc(count + 1, kind_bytes[kind]);
    array[a].got = calloc(count + 1, kind_bytes[kind]);
    for (size_t i = 0; kind == FLOATS && i < count; i++)
        ((float *)array[a].host)[i] = uniform(low, high);
    for (size_t i = 0; kind == BYTES && i < count; i++)
        array[a].host[i] = (char)uniform(0, 255);
}

static size_t bytes_of(enum array a) { return array[a].n * kind_bytes[array[a].kind]; }

static bool open_side(struct side *s, const char *name)
{
    if (spin_device_open(name, 4, &s->d) != SPIN_OK)
        return false;
    for (int a = 0; a < ARRAYS; a++)
        if (s->d.op->reserve(&s->d, bytes_of(a) + 64, &s->at[a]) != SPIN_OK)
            return false;
    s->tiles.intersections = s->at[LISTS];
    s->tiles.start = s->at[START];
    return true;
}

static void close_side(struct side *s)
{
    for (int a = 0; a < ARRAYS; a++)
        s->d.op->release(&s->d, s->at[a]);
    spin_device_close(&s->d);
}

/* ---- Contents of the arrays ------------------------------------------------------------------ */

static void make_grid(void)
{
    for (int l = 0; l < LEVELS; l++) {
        uint64_t product = 1, most = (uint64_t)1 << (n > 100000 ? 21 : 15);

        for (int a = 0; a < 4; a++) {
            grid.res[l][a] = (uint32_t)((a < 3 ? 16 : 8) * pow(a < 3 ? 128 : 16, l / 15.0)) + 1;
            grid.scale[l][a] = (float)grid.res[l][a] - 1;
            product *= grid.res[l][a];
        }
        grid.hashed[l] = product > most;
        grid.offset[l + 1] = grid.offset[l] + (uint32_t)(product > most ? most : product);
    }
    grid.n_levels = LEVELS;
    grid.n_features = 4;
}

static void make_heads(void)
{
    static const int n_out[SPIN_HEADS] = {3, 4, 48, 1};

    heads.n_in = WIDTH_OF_Z;
    heads.hidden = HIDDEN;
    for (int h = 0; h < SPIN_HEADS; h++) {
        heads.n_out[h] = n_out[h];
        heads.offset[h + 1] = heads.offset[h] + (size_t)HIDDEN * (WIDTH_OF_Z + 1) +
                              (size_t)HIDDEN * (HIDDEN + 1) + (size_t)n_out[h] * (HIDDEN + 1);
    }
}

static void make_views(void)
{
    views.n_views = VIEWS;
    views.absolute = true;
    views.max_pixels = (size_t)(width * height);
    for (int k = 0; k < VIEWS; k++) {
        struct spin_camera camera = {.width = width,
                                     .height = height,
                                     .fx = 0.8 * width,
                                     .fy = 0.8 * width,
                                     .cx = width / 2.0,
                                     .cy = height / 2.0,
                                     .w2c = {1, 0, 0, 0.1 * k, 0, 1, 0, 0, 0, 0, 1, 2.5}};

        views.view[k].frame = k;
        views.view[k].first = (size_t)k * n;
        views.view[k].n = n;
        views.view[k].camera = spin_camera_f32_from(&camera);
        views.view[k].weight = 1;
        views.view[k].image = (uint32_t)k;
        views.view[k].exposure = k;
        views.view[k].lens = VIEWS;
        views.view[k].value = k;
        views.background[k] = 0.1f;
    }
    views.max_tiles = (size_t)views.view[0].camera.tiles_x * (size_t)views.view[0].camera.tiles_y;
}

static void make_arrays(void)
{
    size_t all = FRAMES * n, pixels = VIEWS * views.max_pixels;
    size_t table = (size_t)grid.offset[LEVELS] * 4;
    float *attr;

    make(MEANS, FLOATS, 3 * all, -1, 1);
    make(D_MEANS, FLOATS, 3 * all, -1e-3f, 1e-3f);
    make(OWN, FLOATS, SPIN_RESIDUAL * all, -1, 1);
    make(D_OWN, FLOATS, SPIN_RESIDUAL * all, 0, 0);
    make(TRACK, COUNTS, all, 0, 0);
    make(TRACK_VALUES, FLOATS, SPIN_TRACK * TRACKS, -0.1f, 0.1f);
    make(D_TRACK_VALUES, FLOATS, SPIN_TRACK * TRACKS, 0, 0);
    make(TRACK_MOTION, FLOATS, SPIN_MOTION * TRACKS, -1, 1);
    make(TURN, FLOATS, 4 * all, 0.4f, 0.6f);
    make(GRADIENT, FLOATS, all, 0, 0);
    make(SEEN, COUNTS, all, 0, 0);
    make(X_U, FLOATS, 4 * all, 0, 1);
    make(D_X_U, FLOATS, 4 * all, 0, 0);
    make(TABLE, FLOATS, table, -0.5f, 0.5f);
    make(D_TABLE, FLOATS, table, 0, 0);
    make(Z, FLOATS, WIDTH_OF_Z * all, 0, 0);
    make(D_Z, FLOATS, WIDTH_OF_Z * all, 0, 0);
    make(HEADS, FLOATS, heads.offset[SPIN_HEADS], -0.3f, 0.3f);
    make(D_HEADS, FLOATS, heads.offset[SPIN_HEADS], 0, 0);
    make(RAW, FLOATS, SPIN_ATTR * all, 0, 0);
    make(D_RAW, FLOATS, SPIN_ATTR * all, 0, 0);
    make(ATTR, FLOATS, SPIN_ATTR * all, -0.5f, 0.5f);
    make(D_ATTR, FLOATS, SPIN_ATTR * all, 0, 0);
    make(ROWS, COUNTS, all, 0, 0);
    make(N_ROWS, COUNTS, 1, 0, 0);
    make(SPLAT2D, SPLATS, all, 0, 0);
    make(D_SPLAT2D, FLOATS, sizeof(struct spin_splat2d_grad) / 4 * all, 0, 0);
    pairs_most = 64 * all;
    make(LISTS, COUNTS, pairs_most, 0, 0);
    make(START, COUNTS, VIEWS * (views.max_tiles + 1), 0, 0);
    make(IMAGE, FLOATS, 3 * pixels, 0, 0);
    make(D_IMAGE, FLOATS, 3 * pixels, 0, 0);
    make(LEFT, FLOATS, pixels, 0, 0);
    make(LAST, COUNTS, pixels, 0, 0);
    make(PHOTOS, BYTES, 3 * pixels, 0, 0);
    make(MASK, BYTES, VIEWS * ((views.max_pixels + 7) / 8), 0, 0);
    make(LOSS, DOUBLES, VIEWS * SPIN_LOSS_VALUES, 0, 0);
    make(MEASURED, DOUBLES, VIEWS * SPIN_MEASURE_VALUES, 0, 0);
    make(EXPOSURE, FLOATS, (VIEWS + 1) * SPIN_EXPOSURE, -0.1f, 0.1f);
    make(D_EXPOSURE, FLOATS, (VIEWS + 1) * SPIN_EXPOSURE, 0, 0);
    make(MOMENT, FLOATS, table, 0, 0);
    make(MOMENT_2, FLOATS, table, 0, 0);
    make(NO_NUMBER, FLOATS, 1, NAN, NAN);
    for (size_t i = 0; i < all; i++)
        ((uint32_t *)array[TRACK].host)[i] = i % n < TRACKS ? (uint32_t)(i % n) : SPIN_NO_TRACK;
    for (int i = 0; i < SPIN_HEADS; i++) /* last biases of the scale head: splats of some pixels */
        for (size_t b = 0; i == SPIN_HEAD_SCALE && b < 3; b++)
            ((float *)array[HEADS].host)[heads.offset[1] - 1 - b] = -5 - logf((float)n / 2e4f) / 3;
    attr = (float *)array[ATTR].host;
    attr[0] = 1;
}

static struct spin_frame_batch frames_of(struct side *s, bool own)
{
    struct spin_frame_batch b = {.n_frames = FRAMES, .n = FRAMES * n};

    for (size_t f = 0; f < FRAMES; f++) {
        size_t first = f * n;

        b.frame[f] = (struct spin_frame_of_batch){
            .first = first,
            .n = n,
            .t = 0.25f + 0.5f * (float)f,
            .means = (float SPIN_DEV *)s->at[MEANS] + 3 * first,
            .d_means = (float SPIN_DEV *)s->at[D_MEANS] + 3 * first,
            .residual = own ? (float SPIN_DEV *)s->at[OWN] + SPIN_RESIDUAL * first : NULL,
            .d_residual = own ? (float SPIN_DEV *)s->at[D_OWN] + SPIN_RESIDUAL * first : NULL,
            .track = (uint32_t SPIN_DEV *)s->at[TRACK] + first,
            .own_means = (float SPIN_DEV *)s->at[MEANS] + 3 * first,
            .own_residual = (float SPIN_DEV *)s->at[OWN] + SPIN_RESIDUAL * first,
            .n_own_means = n,
            .n_own_residual = n,
            .turn = (float SPIN_DEV *)s->at[TURN] + 4 * first,
            .gradient = (float SPIN_DEV *)s->at[GRADIENT] + first,
            .seen = (uint32_t SPIN_DEV *)s->at[SEEN] + first};
    }
    return b;
}

static struct spin_active active_of(struct side *s)
{
    return (struct spin_active){s->at[ROWS], s->at[N_ROWS], FRAMES * n};
}

static struct spin_images images_of(struct side *s)
{
    return (struct spin_images){.rgb8 = s->at[PHOTOS],
                                .mask = s->at[MASK],
                                .max_pixels = views.max_pixels,
                                .mask_weight = {1, 3}};
}

/* ---- Verbs ----------------------------------------------------------------------------------- */

#define VERB(name) static spin_status do_##name(struct side *s, struct spin_device *d)
#define OP(name, ...) (d->op->name(d, __VA_ARGS__), SPIN_OK)

VERB(tracks)
{
    struct spin_frame_batch b = frames_of(s, true);
    struct spin_tracks_f32 t = {TRACKS, s->at[TRACK_VALUES], s->at[D_TRACK_VALUES], NULL};

    return OP(tracks, &b, &t, s->at[D_MEANS], s->at[D_OWN]);
}
VERB(tracks_back)
{
    struct spin_frame_batch b = frames_of(s, true);
    struct spin_tracks_f32 t = {TRACKS, s->at[TRACK_VALUES], s->at[D_TRACK_VALUES], NULL};

    return OP(tracks_back, &b, &t);
}
/* Tracks that are 4D splats, whose splats have no values of their own. */
static struct spin_frame_batch rows_of(struct side *s)
{
    struct spin_frame_batch b = frames_of(s, true);

    for (int f = 0; f < FRAMES; f++)
        b.frame[f].n_own_means = b.frame[f].n_own_residual = 0;
    return b;
}
VERB(rows)
{
    struct spin_frame_batch b = rows_of(s);
    struct spin_tracks_f32 t = {TRACKS, s->at[TRACK_VALUES], s->at[D_TRACK_VALUES],
                                s->at[TRACK_MOTION]};

    return OP(tracks, &b, &t, s->at[D_MEANS], s->at[D_OWN]);
}
VERB(rows_back)
{
    struct spin_frame_batch b = rows_of(s);
    struct spin_tracks_f32 t = {TRACKS, s->at[TRACK_VALUES], s->at[D_TRACK_VALUES],
                                s->at[TRACK_MOTION]};

    return OP(tracks_back, &b, &t);
}
VERB(zero) { return OP(zero, s->at[D_OWN], bytes_of(D_OWN)); }
VERB(copy_rows) { return OP(copy_rows, n, 7, s->at[OWN], 11, s->at[D_RAW], 13); }
VERB(contract)
{
    struct spin_scene_transform t = {.centre = {0.1f, 0, 0}, .inv_radius = 1.2f};
    struct spin_frame_batch b = frames_of(s, false);

    return OP(contract, &t, &b, s->at[X_U]);
}
VERB(grid) { return OP(grid, &grid, s->at[TABLE], FRAMES * n, s->at[X_U], s->at[Z]); }
VERB(mlp) { return OP(mlp, &heads, s->at[HEADS], FRAMES * n, s->at[Z], s->at[RAW]); }
VERB(residual)
{
    struct spin_frame_batch b = frames_of(s, true);

    return OP(residual, &b, s->at[RAW]);
}
VERB(residual_set)
{
    struct spin_frame_batch b = frames_of(s, true);

    return OP(residual_set, &b, s->at[D_RAW]);
}
VERB(activate)
{
    struct spin_frame_batch b = frames_of(s, false);

    return OP(activate, &b, s->at[RAW], s->at[ATTR]);
}
VERB(project)
{
    struct spin_frame_batch b = frames_of(s, false);

    return OP(project, &views, &b, s->at[ATTR], 3, s->at[SPLAT2D]);
}
VERB(tiles)
{
    spin_status status = d->op->tile_count(d, &views, s->at[SPLAT2D], &s->tiles);

    if (status == SPIN_OK && s->tiles.n_intersections > pairs_most) {
        printf("# too many pairs: %llu\n", (unsigned long long)s->tiles.n_intersections);
        return SPIN_E_MEMORY;
    }
    return status == SPIN_OK ? d->op->tile_fill(d, &views, s->at[SPLAT2D], &s->tiles) : status;
}
VERB(blend)
{
    return OP(blend, &views, s->at[SPLAT2D], &s->tiles, s->at[IMAGE], s->at[LEFT], s->at[LAST]);
}
VERB(exposure) { return OP(exposure, &views, s->at[EXPOSURE], s->at[IMAGE], s->at[D_IMAGE]); }
VERB(loss)
{
    struct spin_images images = images_of(s);

    return OP(loss, &views, &images, 0.2f, s->at[IMAGE], s->at[LOSS], s->at[D_IMAGE]);
}
VERB(exposure_back)
{
    return OP(exposure_back, &views, s->at[EXPOSURE], s->at[IMAGE], s->at[D_IMAGE],
              s->at[D_EXPOSURE]);
}
VERB(exposure_centre) { return OP(exposure_centre, VIEWS, s->at[EXPOSURE]); }
VERB(blend_back)
{
    return OP(blend_back, &views, s->at[SPLAT2D], &s->tiles, s->at[LEFT], s->at[LAST],
              s->at[D_IMAGE], s->at[D_SPLAT2D]);
}
VERB(densify_stats)
{
    struct spin_frame_batch b = frames_of(s, false);

    return OP(densify_stats, &views, &b, s->at[SPLAT2D], s->at[D_SPLAT2D]);
}
VERB(project_back)
{
    struct spin_frame_batch b = frames_of(s, false);

    return OP(project_back, &views, &b, s->at[ATTR], 3, s->at[SPLAT2D], s->at[D_SPLAT2D],
              s->at[D_ATTR]);
}
VERB(nonzero_grad)
{
    struct spin_frame_batch b = frames_of(s, false);
    struct spin_active active = active_of(s);

    for (int f = 0; f < FRAMES; f++)
        b.frame[f].d_means = NULL; /* all d_means are nonzero here */
    return OP(nonzero_grad, &b, s->at[D_ATTR], &active);
}
VERB(activate_back)
{
    struct spin_frame_batch b = frames_of(s, false);
    struct spin_active active = active_of(s);

    return OP(activate_back, &b, &active, s->at[RAW], s->at[D_ATTR], s->at[D_RAW]);
}
VERB(residual_back)
{
    struct spin_frame_batch b = frames_of(s, true);
    struct spin_active active = active_of(s);

    return OP(residual_back, &b, &active, s->at[D_RAW]);
}
VERB(mlp_back)
{
    struct spin_active active = active_of(s);

    return OP(mlp_back, &heads, s->at[HEADS], &active, s->at[Z], s->at[D_RAW], s->at[D_HEADS],
              s->at[D_Z]);
}
VERB(grid_back)
{
    struct spin_active active = active_of(s);

    return OP(grid_back, &grid, s->at[TABLE], &active, s->at[X_U], s->at[D_Z], s->at[D_TABLE],
              s->at[D_X_U]);
}
VERB(grid_back_fixed)
{
    spin_status status;

    d->deterministic = true;
    status = do_grid_back(s, d);
    d->deterministic = false;
    return status;
}
VERB(contract_back)
{
    struct spin_scene_transform t = {.centre = {0.1f, 0, 0}, .inv_radius = 1.2f};
    struct spin_frame_batch b = frames_of(s, false);
    struct spin_active active = active_of(s);

    return OP(contract_back, &t, &b, &active, s->at[D_X_U]);
}
static struct spin_param_group table_of(struct side *s)
{
    return (struct spin_param_group){
        s->at[TABLE], s->at[D_TABLE], s->at[MOMENT], s->at[MOMENT_2], array[TABLE].n, 1e-3, 1};
}
VERB(adam)
{
    struct spin_param_group group = table_of(s);

    return OP(adam, 1, &group);
}
VERB(not_finite)
{
    d->op->not_finite(d, array[TABLE].n, s->at[TABLE], s->at[N_ROWS]);
    d->op->not_finite(d, 1, s->at[NO_NUMBER], s->at[N_ROWS]);
    return SPIN_OK;
}
VERB(lazy_adam)
{
    struct spin_param_group group = table_of(s);
    spin_status status;

    if (!s->d.op->lazy_adam_enable)
        return SPIN_OK;
    status = d->op->lazy_adam_enable(d, &grid, &group, 4, &s->lazy);
    if (status != SPIN_OK)
        return status;
    for (int i = 0; i < 2; i++) {
        d->op->lazy_adam_grid(d, s->lazy, n, s->at[X_U], s->at[Z]);
        d->op->lazy_adam_step(d, s->lazy, 1e-3);
    }
    d->op->lazy_adam_flush(d, s->lazy, s->at[D_TABLE]);
    status = d->op->wait(d);
    d->op->lazy_adam_close(d, s->lazy);
    return status;
}
VERB(measure)
{
    struct spin_images images = images_of(s);

    return OP(measure, &views, &images, s->at[IMAGE], s->at[MEASURED]);
}

/* In an order in which each verb has its input. Tolerances are wider for results that depend on
 * thresholds (a splat contributes to a pixel or not). */
static const struct {
    const char *name;
    spin_status (*run)(struct side *s, struct spin_device *d);
    double tolerance; /* of the RMS difference, relative to the RMS of the result */
    int out[4];       /* arrays it writes; terminated by -1 */
} verbs[] = {
    {"tracks", do_tracks, 1e-6, {D_MEANS, D_OWN, -1}},
    {"tracks_back", do_tracks_back, 1e-6, {D_TRACK_VALUES, -1}},
    {"tracks, 4D splats", do_rows, 1e-5, {D_MEANS, D_OWN, -1}},
    {"tracks_back, 4D splats", do_rows_back, 1e-5, {D_TRACK_VALUES, -1}},
    {"zero", do_zero, 0, {D_OWN, -1}},
    {"copy_rows", do_copy_rows, 0, {D_RAW, -1}},
    {"contract", do_contract, 1e-6, {X_U, -1}},
    {"grid", do_grid, 1e-5, {Z, -1}},
    {"mlp", do_mlp, 1e-5, {RAW, -1}},
    {"residual_set", do_residual_set, 0, {D_RAW, -1}},
    {"activate", do_activate, 1e-5, {ATTR, -1}},
    {"project", do_project, 1e-4, {SPLAT2D, -1}},
    {"tile_count, tile_fill", do_tiles, 1e-3, {SPLAT2D, START, -1}},
    {"blend", do_blend, 1e-3, {IMAGE, LEFT, LAST, -1}},
    {"exposure", do_exposure, 1e-5, {D_IMAGE, -1}},
    {"loss", do_loss, 1e-4, {LOSS, D_IMAGE, -1}},
    {"exposure_back", do_exposure_back, 1e-4, {D_IMAGE, D_EXPOSURE, -1}},
    {"exposure_centre", do_exposure_centre, 1e-5, {EXPOSURE, -1}},
    {"blend_back", do_blend_back, 1e-3, {D_SPLAT2D, -1}},
    {"densify_stats", do_densify_stats, 1e-4, {GRADIENT, SEEN, -1}},
    {"project_back", do_project_back, 1e-4, {D_ATTR, D_MEANS, -1}},
    {"nonzero_grad", do_nonzero_grad, 0, {ROWS, N_ROWS, -1}},
    {"activate_back", do_activate_back, 1e-5, {D_RAW, -1}},
    {"residual_back", do_residual_back, 1e-6, {D_OWN, -1}},
    {"mlp_back", do_mlp_back, 1e-4, {D_HEADS, D_Z, -1}},
    {"grid_back", do_grid_back, 1e-4, {D_TABLE, D_X_U, -1}},
    {"grid_back, deterministic", do_grid_back_fixed, 1e-4, {D_TABLE, D_X_U, -1}},
    {"contract_back", do_contract_back, 1e-5, {D_MEANS, -1}},
    {"residual", do_residual, 1e-6, {RAW, -1}},
    {"adam", do_adam, 1e-4, {TABLE, D_TABLE, MOMENT, -1}},
    {"not_finite", do_not_finite, 0, {N_ROWS, -1}},
    {"lazy_adam", do_lazy_adam, 1e-4, {TABLE, D_TABLE, MOMENT, -1}},
    {"measure", do_measure, 1e-4, {MEASURED, IMAGE, -1}},
};

/* ---- Comparing ------------------------------------------------------------------------------- */

/* Value i of an array as a number: of a projected splat its position, conic and opacity, if it is
 * visible. */
static double value_of(const char *at, enum kind kind, size_t i)
{
    const struct spin_splat2d *s;
    const float *v;

    switch (kind) {
    case FLOATS:
        return (double)((const float *)at)[i];
    case COUNTS:
        return ((const uint32_t *)at)[i];
    case DOUBLES:
        return ((const double *)at)[i];
    case BYTES:
        return ((const uint8_t *)at)[i];
    default:
        s = (const struct spin_splat2d *)at + i / 6;
        v = &s->u_px;
        return s->radius_px > 0 ? (double)v[i % 6] : 0;
    }
}

/* RMS difference of an array, relative to the RMS of the CPU's; NaN counts as infinite. */
static double apart(enum array a)
{
    double square = 0, off = 0;
    size_t count = array[a].kind == SPLATS ? 6 * array[a].n : array[a].n;

    if (a == ROWS)
        count = *(const uint32_t *)array[N_ROWS].host;
    for (size_t i = 0; i < count; i++) {
        double want = value_of(array[a].host, array[a].kind, i);
        double d = value_of(array[a].got, array[a].kind, i) - want;

        square += want * want;
        off += d * d;
    }
    if (off != off)
        return INFINITY;
    return off > 0 ? sqrt(off / fmax(square, 1e-30)) : 0;
}

static bool upload_all(struct side *s)
{
    for (int a = 0; a < ARRAYS; a++)
        s->d.op->upload(&s->d, s->at[a], array[a].host, bytes_of(a));
    s->tiles.n_intersections = cpu.tiles.n_intersections;
    return s->d.op->wait(&s->d) == SPIN_OK;
}

static bool run(struct side *s, int verb, double *ms)
{
    double start;
    bool good = upload_all(s);

    start = spin_now_s();
    good = good && verbs[verb].run(s, &s->d) == SPIN_OK && s->d.op->wait(&s->d) == SPIN_OK;
    *ms = 1e3 * (spin_now_s() - start);
    return good;
}

static bool download(struct side *s, int verb, bool to_host)
{
    bool good = true;

    for (const int *a = verbs[verb].out; *a >= 0; a++)
        good = good && s->d.op->download(&s->d, to_host ? array[*a].host : array[*a].got, s->at[*a],
                                         bytes_of(*a)) == SPIN_OK;
    if (to_host && verbs[verb].run == do_tiles)
        good = good && s->d.op->download(&s->d, array[LISTS].host, s->at[LISTS], bytes_of(LISTS)) ==
                           SPIN_OK;
    return good;
}

static bool compare(int verb)
{
    double cpu_ms, ms, first_ms, worst = 0;

    if (!run(&card, verb, &first_ms) || !run(&card, verb, &ms) || !download(&card, verb, false) ||
        !run(&cpu, verb, &cpu_ms) || !download(&cpu, verb, true))
        return ok(0, "%s: %s", verbs[verb].name, spin_last_error());
    for (const int *a = verbs[verb].out; *a >= 0; a++)
        worst = larger(worst, apart(*a));
    return ok(worst <= verbs[verb].tolerance,
              "%s: %.1e apart, at most %.0e; %.3f ms, on the CPU %.1f", verbs[verb].name, worst,
              verbs[verb].tolerance, ms, cpu_ms);
}

static void clear(enum array a) { memset(array[a].host, 0, bytes_of(a)); }

int main(int argc, char **argv)
{
    bool good;

    if (argc > 1)
        n = strtoul(argv[1], NULL, 10);
    if (argc > 3) {
        width = atoi(argv[2]);
        height = atoi(argv[3]);
    }
    if (n < TRACKS || width < 16 || height < 16) {
        fprintf(stderr, "usage: t-card [SPLATS [WIDTH HEIGHT]], at least %d, 16 and 16\n", TRACKS);
        return 2;
    }
    make_grid();
    make_heads();
    make_views();
    make_arrays();
    good = open_side(&cpu, "cpu") && open_side(&card, "cuda");
    if (!good && !getenv("SPIN_TEST_DEVICE")) {
        skip("verbs of a card", spin_last_error());
        return tap_done();
    }
    ok(good, "opens: %s", good ? card.d.description : spin_last_error());
    for (int v = 0; good && v < (int)(sizeof verbs / sizeof *verbs); v++) {
        good = compare(v) || card.d.op->wait(&card.d) == SPIN_OK; /* a GPU that failed stays
                                                                   * unusable */
        if (verbs[v].run == do_copy_rows)
            clear(D_MEANS);
    }
    if (good) {
        ok(cpu.tiles.n_intersections > n / 4 && *(uint32_t *)array[N_ROWS].host > n / 4,
           "%llu pairs, %u splats with a gradient", (unsigned long long)cpu.tiles.n_intersections,
           *(uint32_t *)array[N_ROWS].host);
        close_side(&card);
        close_side(&cpu);
    }
    return tap_done();
}
