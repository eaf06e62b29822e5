/* The strict device. Its memory is one range of addresses from which blocks are allocated
 * consecutively and never reused, so one mprotect() opens or closes all of it, and a released block
 * stays inaccessible. A GPU's memory is inaccessible to the host anyway: with a GPU inside, the
 * blocks are the GPU's own, and are kept until the device is closed. */
#include "tests/device/strict.h"

#include <sys/mman.h>

#include "base/err.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { MOST_BLOCKS = 1 << 16, PAGE = 4096 };
static const size_t range_bytes = (size_t)1 << 34; /* address space, not memory */

struct entry {
    void (*run)(struct spin_device *inner, void *args);
    void *args;
};

struct strict {
    struct spin_device_ops ops;
    struct spin_device *inner;
    char *range; /* NULL: blocks belong to the inner device */
    size_t used;
    struct block {
        char *at;
        size_t bytes;
        bool released;
    } block[MOST_BLOCKS];
    size_t n_blocks;
    struct entry *queue;
    size_t n, room;
};

static int n_complaints;
static bool expected;
static char last[200];

int strict_complaints(void) { return n_complaints; }
const char *strict_last(void) { return last; }
void strict_expect(bool complaints) { expected = complaints; }

static struct strict *of(const struct spin_device *d) { return d->state; }
size_t strict_queued(const struct spin_device *d) { return of(d)->n; }

/* Checks that a pointer is NULL or points into an unreleased block. */
static void check(struct spin_device *d, const char *verb, const void *at)
{
    struct strict *s = of(d);

    if (!at)
        return;
    for (size_t i = 0; i < s->n_blocks; i++)
        if (!s->block[i].released &&
            (size_t)((const char *)at - s->block[i].at) < s->block[i].bytes)
            return;
    n_complaints++;
    snprintf(last, sizeof last, "%s: %p is not device memory", verb, at);
    if (!expected)
        ok(0, "strict device: %s", last);
}

static void push(struct spin_device *d, void (*run)(struct spin_device *, void *), const void *args,
                 size_t bytes)
{
    struct strict *s = of(d);

    if (s->n == s->room) {
        s->room = 2 * s->room + 64;
        s->queue = realloc(s->queue, s->room * sizeof *s->queue);
    }
    s->queue[s->n].run = run;
    s->queue[s->n].args = malloc(bytes);
    memcpy(s->queue[s->n++].args, args, bytes);
}

static void open_memory(struct strict *s, bool open)
{
    if (s->range && s->used)
        mprotect(s->range, s->used, open ? PROT_READ | PROT_WRITE : PROT_NONE);
}

/* Runs all queued verbs, and leaves the memory accessible. */
static void catch_up(struct spin_device *d)
{
    struct strict *s = of(d);

    open_memory(s, true);
    for (size_t i = 0; i < s->n; i++) {
        s->queue[i].run(s->inner, s->queue[i].args);
        free(s->queue[i].args);
    }
    s->n = 0;
}

/* ---- Memory ---------------------------------------------------------------------------------- */

static spin_status reserve(struct spin_device *d, size_t bytes, void SPIN_DEV **out)
{
    struct strict *s = of(d);

    if (s->n_blocks == MOST_BLOCKS || s->used + bytes + PAGE > range_bytes)
        return spin_fail(SPIN_E_MEMORY, "the strict device is full");
    if (s->range)
        *out = s->range + s->used;
    else
        SPIN_TRY(s->inner->op->reserve(s->inner, bytes, out));
    s->block[s->n_blocks++] = (struct block){(char *)*out, bytes, false};
    s->used += (bytes + 2 * PAGE - 1) / PAGE * PAGE; /* plus an unused guard page */
    return SPIN_OK;
}

static void release(struct spin_device *d, void SPIN_DEV *at)
{
    struct strict *s = of(d);

    if (!at)
        return;
    catch_up(d);
    open_memory(s, false);
    for (size_t i = 0; i < s->n_blocks; i++)
        if (s->block[i].at == (char *)at && !s->block[i].released) {
            if (s->range)
                madvise((void *)at, s->block[i].bytes, MADV_DONTNEED);
            s->block[i].released = true;
            return;
        }
    ok(0, "strict device: release of what was not reserved");
}

struct upload {
    void SPIN_DEV *to;
    void *copy;
    size_t bytes;
};

static void late_upload(struct spin_device *inner, void *args)
{
    struct upload *u = args;

    inner->op->upload(inner, u->to, u->copy, u->bytes);
    free(u->copy);
}

static void upload(struct spin_device *d, void SPIN_DEV *to, const void *host, size_t bytes)
{
    struct upload u = {to, malloc(bytes + 1), bytes};

    if (bytes)
        check(d, "upload", (const void *)to);
    memcpy(u.copy, host, bytes);
    push(d, late_upload, &u, sizeof u);
}

static spin_status download(struct spin_device *d, void *host, const void SPIN_DEV *from,
                            size_t bytes)
{
    spin_status status;

    if (bytes)
        check(d, "download", (const void *)from);
    catch_up(d);
    status = of(d)->inner->op->download(of(d)->inner, host, from, bytes);
    open_memory(of(d), false);
    return status;
}

static spin_status wait(struct spin_device *d)
{
    spin_status status;

    catch_up(d);
    status = of(d)->inner->op->wait(of(d)->inner);
    open_memory(of(d), false);
    return status;
}

static spin_status host_reserve(struct spin_device *d, size_t bytes, struct spin_host_memory *out)
{
    return of(d)->inner->op->host_reserve(of(d)->inner, bytes, out);
}

static void host_release(struct spin_device *d, struct spin_host_memory *memory)
{
    of(d)->inner->op->host_release(of(d)->inner, memory);
}

static void *host_view(struct spin_device *d, void SPIN_DEV *at)
{
    (void)d;
    (void)at;
    return NULL;
}

static size_t memory_available(struct spin_device *d)
{
    return of(d)->inner->op->memory_available(of(d)->inner);
}

static double clock_of(struct spin_device *d, int op)
{
    return of(d)->inner->op->clock(of(d)->inner, op);
}

/* ---- Verbs: queued with their arguments ------------------------------------------------------ */

/* Kinds of arguments: S a struct, copied; P device memory; V any other value. */
#define FIELD_S(T) struct T
#define FIELD_P(T) T SPIN_DEV *
#define FIELD_V(T) T
#define PARAM_S(T) const struct T *
#define PARAM_P(T) T SPIN_DEV *
#define PARAM_V(T) T
#define KEEP_S(x) *x
#define KEEP_P(x) x
#define KEEP_V(x) x
#define PASS_S(x) &x
#define PASS_P(x) x
#define PASS_V(x) x
#define CHECK_S(T, x) check_##T(d, __func__, x)
#define CHECK_P(T, x) check(d, __func__, (const void *)x)
#define CHECK_V(T, x) (void)x

#define check_spin_scene_transform(d, verb, x) (void)x
#define check_spin_grid(d, verb, x) (void)x
#define check_spin_heads(d, verb, x) (void)x
#define check_spin_view_batch(d, verb, x) (void)x

static void check_spin_frame_batch(struct spin_device *d, const char *verb,
                                   const struct spin_frame_batch *frames)
{
    for (int f = 0; f < frames->n_frames; f++) {
        check(d, verb, (const void *)frames->frame[f].means);
        check(d, verb, (const void *)frames->frame[f].d_means);
        check(d, verb, (const void *)frames->frame[f].residual);
        check(d, verb, (const void *)frames->frame[f].d_residual);
        check(d, verb, (const void *)frames->frame[f].sh);
        check(d, verb, (const void *)frames->frame[f].d_sh);
        check(d, verb, (const void *)frames->frame[f].track);
        check(d, verb, (const void *)frames->frame[f].own_means);
        check(d, verb, (const void *)frames->frame[f].own_residual);
        check(d, verb, (const void *)frames->frame[f].turn);
        check(d, verb, (const void *)frames->frame[f].gradient);
        check(d, verb, (const void *)frames->frame[f].seen);
    }
}

static void check_spin_tracks_f32(struct spin_device *d, const char *verb,
                                  const struct spin_tracks_f32 *tracks)
{
    check(d, verb, (const void *)tracks->values);
    check(d, verb, (const void *)tracks->d_values);
    check(d, verb, (const void *)tracks->motion);
}

static void check_spin_active(struct spin_device *d, const char *verb,
                              const struct spin_active *active)
{
    check(d, verb, (const void *)active->row);
    check(d, verb, (const void *)active->n);
}

static void check_spin_tiles(struct spin_device *d, const char *verb,
                             const struct spin_tiles *tiles)
{
    check(d, verb, (const void *)tiles->intersections);
    check(d, verb, (const void *)tiles->start);
}

static void check_spin_images(struct spin_device *d, const char *verb,
                              const struct spin_images *images)
{
    check(d, verb, (const void *)images->rgb8);
    check(d, verb, (const void *)images->f32);
    check(d, verb, (const void *)images->mask);
}

/* Defines one verb. FIELDS, PARAMS, KEPT, PASSED and CHECKS are lists made by the macros below. */
#define QUEUED(name, FIELDS, PARAMS, KEPT, PASSED, CHECKS)                                         \
    struct args_##name {                                                                           \
        FIELDS                                                                                     \
    };                                                                                             \
    static void late_##name(struct spin_device *inner, void *args)                                 \
    {                                                                                              \
        struct args_##name *q = args;                                                              \
        inner->op->name PASSED;                                                                    \
    }                                                                                              \
    static void name PARAMS                                                                        \
    {                                                                                              \
        struct args_##name q = {KEPT};                                                             \
        CHECKS;                                                                                    \
        push(d, late_##name, &q, sizeof q);                                                        \
    }
#define LIST(...) __VA_ARGS__
#define D struct spin_device *d
#define QUEUED2(n, ka, ta, kb, tb)                                                                 \
    QUEUED(n, FIELD_##ka(ta) a; FIELD_##kb(tb) b;                                                  \
           , (D, PARAM_##ka(ta) a, PARAM_##kb(tb) b), LIST(KEEP_##ka(a), KEEP_##kb(b)),            \
           (inner, PASS_##ka(q->a), PASS_##kb(q->b)), CHECK_##ka(ta, a);                           \
           CHECK_##kb(tb, b))
#define QUEUED3(n, ka, ta, kb, tb, kc, tc)                                                         \
    QUEUED(n, FIELD_##ka(ta) a; FIELD_##kb(tb) b; FIELD_##kc(tc) c;                                \
           , (D, PARAM_##ka(ta) a, PARAM_##kb(tb) b, PARAM_##kc(tc) c),                            \
           LIST(KEEP_##ka(a), KEEP_##kb(b), KEEP_##kc(c)),                                         \
           (inner, PASS_##ka(q->a), PASS_##kb(q->b), PASS_##kc(q->c)), CHECK_##ka(ta, a);          \
           CHECK_##kb(tb, b); CHECK_##kc(tc, c))
#define QUEUED4(n, ka, ta, kb, tb, kc, tc, kd, td)                                                 \
    QUEUED(n, FIELD_##ka(ta) a; FIELD_##kb(tb) b; FIELD_##kc(tc) c; FIELD_##kd(td) e;              \
           , (D, PARAM_##ka(ta) a, PARAM_##kb(tb) b, PARAM_##kc(tc) c, PARAM_##kd(td) e),          \
           LIST(KEEP_##ka(a), KEEP_##kb(b), KEEP_##kc(c), KEEP_##kd(e)),                           \
           (inner, PASS_##ka(q->a), PASS_##kb(q->b), PASS_##kc(q->c), PASS_##kd(q->e)),            \
           CHECK_##ka(ta, a);                                                                      \
           CHECK_##kb(tb, b); CHECK_##kc(tc, c); CHECK_##kd(td, e))
#define QUEUED5(n, ka, ta, kb, tb, kc, tc, kd, td, ke, te)                                         \
    QUEUED(n, FIELD_##ka(ta) a; FIELD_##kb(tb) b; FIELD_##kc(tc) c; FIELD_##kd(td) e;              \
           FIELD_##ke(te) f;                                                                       \
           ,                                                                                       \
           (D, PARAM_##ka(ta) a, PARAM_##kb(tb) b, PARAM_##kc(tc) c, PARAM_##kd(td) e,             \
            PARAM_##ke(te) f),                                                                     \
           LIST(KEEP_##ka(a), KEEP_##kb(b), KEEP_##kc(c), KEEP_##kd(e), KEEP_##ke(f)),             \
           (inner, PASS_##ka(q->a), PASS_##kb(q->b), PASS_##kc(q->c), PASS_##kd(q->e),             \
            PASS_##ke(q->f)),                                                                      \
           CHECK_##ka(ta, a);                                                                      \
           CHECK_##kb(tb, b); CHECK_##kc(tc, c); CHECK_##kd(td, e); CHECK_##ke(te, f))
#define QUEUED6(n, ka, ta, kb, tb, kc, tc, kd, td, ke, te, kf, tf)                                 \
    QUEUED(                                                                                        \
        n, FIELD_##ka(ta) a; FIELD_##kb(tb) b; FIELD_##kc(tc) c; FIELD_##kd(td) e;                 \
        FIELD_##ke(te) f; FIELD_##kf(tf) g;                                                        \
        ,                                                                                          \
        (D, PARAM_##ka(ta) a, PARAM_##kb(tb) b, PARAM_##kc(tc) c, PARAM_##kd(td) e,                \
         PARAM_##ke(te) f, PARAM_##kf(tf) g),                                                      \
        LIST(KEEP_##ka(a), KEEP_##kb(b), KEEP_##kc(c), KEEP_##kd(e), KEEP_##ke(f), KEEP_##kf(g)),  \
        (inner, PASS_##ka(q->a), PASS_##kb(q->b), PASS_##kc(q->c), PASS_##kd(q->e),                \
         PASS_##ke(q->f), PASS_##kf(q->g)),                                                        \
        CHECK_##ka(ta, a);                                                                         \
        CHECK_##kb(tb, b); CHECK_##kc(tc, c); CHECK_##kd(td, e); CHECK_##ke(te, f);                \
        CHECK_##kf(tf, g))
#define QUEUED7(n, ka, ta, kb, tb, kc, tc, kd, td, ke, te, kf, tf, kg, tg)                         \
    QUEUED(n, FIELD_##ka(ta) a; FIELD_##kb(tb) b; FIELD_##kc(tc) c; FIELD_##kd(td) e;              \
           FIELD_##ke(te) f; FIELD_##kf(tf) g; FIELD_##kg(tg) h;                                   \
           ,                                                                                       \
           (D, PARAM_##ka(ta) a, PARAM_##kb(tb) b, PARAM_##kc(tc) c, PARAM_##kd(td) e,             \
            PARAM_##ke(te) f, PARAM_##kf(tf) g, PARAM_##kg(tg) h),                                 \
           LIST(KEEP_##ka(a), KEEP_##kb(b), KEEP_##kc(c), KEEP_##kd(e), KEEP_##ke(f),              \
                KEEP_##kf(g), KEEP_##kg(h)),                                                       \
           (inner, PASS_##ka(q->a), PASS_##kb(q->b), PASS_##kc(q->c), PASS_##kd(q->e),             \
            PASS_##ke(q->f), PASS_##kf(q->g), PASS_##kg(q->h)),                                    \
           CHECK_##ka(ta, a);                                                                      \
           CHECK_##kb(tb, b); CHECK_##kc(tc, c); CHECK_##kd(td, e); CHECK_##ke(te, f);             \
           CHECK_##kf(tf, g); CHECK_##kg(tg, h))

typedef const float floats;
/* clang-format off */
QUEUED2(zero, P, void, V, size_t)
QUEUED6(copy_rows, V, size_t, V, size_t, P, floats, V, size_t, P, float, V, size_t)
QUEUED3(contract, S, spin_scene_transform, S, spin_frame_batch, P, float)
QUEUED4(contract_back, S, spin_scene_transform, S, spin_frame_batch, S, spin_active, P, floats)
QUEUED5(grid, S, spin_grid, P, floats, V, size_t, P, floats, P, float)
QUEUED7(grid_back, S, spin_grid, P, floats, S, spin_active, P, floats, P, floats, P, float, P, float)
QUEUED5(mlp, S, spin_heads, P, floats, V, size_t, P, floats, P, float)
QUEUED7(mlp_back, S, spin_heads, P, floats, S, spin_active, P, floats, P, floats, P, float, P, float)
QUEUED2(residual, S, spin_frame_batch, P, float)
QUEUED2(residual_set, S, spin_frame_batch, P, float)
QUEUED3(residual_back, S, spin_frame_batch, S, spin_active, P, floats)
QUEUED3(activate, S, spin_frame_batch, P, floats, P, float)
QUEUED5(activate_back, S, spin_frame_batch, S, spin_active, P, floats, P, floats, P, float)
QUEUED3(nonzero_grad, S, spin_frame_batch, P, floats, S, spin_active)
QUEUED5(project, S, spin_view_batch, S, spin_frame_batch, P, floats, V, int, P, struct spin_splat2d)
QUEUED7(project_back, S, spin_view_batch, S, spin_frame_batch, P, floats, V, int,
        P, const struct spin_splat2d, P, const struct spin_splat2d_grad, P, float)
QUEUED4(densify_stats, S, spin_view_batch, S, spin_frame_batch, P, const struct spin_splat2d,
        P, const struct spin_splat2d_grad)
QUEUED4(tracks, S, spin_frame_batch, S, spin_tracks_f32, P, float, P, float)
QUEUED2(tracks_back, S, spin_frame_batch, S, spin_tracks_f32)
QUEUED6(blend, S, spin_view_batch, P, const struct spin_splat2d, S, spin_tiles, P, float, P, float,
        P, int32_t)
QUEUED4(depth, S, spin_view_batch, P, const struct spin_splat2d, S, spin_tiles, P, float)
QUEUED7(blend_back, S, spin_view_batch, P, const struct spin_splat2d, S, spin_tiles, P, floats,
        P, const int32_t, P, floats, P, struct spin_splat2d_grad)
QUEUED6(loss, S, spin_view_batch, S, spin_images, V, float, P, floats, P, double, P, float)
QUEUED4(measure, S, spin_view_batch, S, spin_images, P, float, P, double)
QUEUED4(exposure, S, spin_view_batch, P, floats, P, floats, P, float)
QUEUED5(exposure_back, S, spin_view_batch, P, floats, P, floats, P, float, P, float)
QUEUED2(exposure_centre, V, size_t, P, float)
QUEUED3(not_finite, V, size_t, P, floats, P, uint32_t)
/* clang-format on */

struct args_adam {
    int n;
    struct spin_param_group group[64];
};

static void late_adam(struct spin_device *inner, void *args)
{
    struct args_adam *q = args;

    inner->op->adam(inner, q->n, q->group);
}

static void adam(struct spin_device *d, int n, const struct spin_param_group *group)
{
    struct args_adam q = {.n = n};

    for (int i = 0; i < n; i++) {
        q.group[i] = group[i];
        if (group[i].n == 0)
            continue;
        check(d, __func__, (const void *)group[i].p);
        check(d, __func__, (const void *)group[i].g);
        check(d, __func__, (const void *)group[i].m);
        check(d, __func__, (const void *)group[i].v);
    }
    push(d, late_adam, &q, sizeof q);
}

static spin_status tile_count(struct spin_device *d, const struct spin_view_batch *views,
                              struct spin_splat2d SPIN_DEV *splat2d, struct spin_tiles *tiles)
{
    spin_status status;

    check(d, __func__, (const void *)splat2d);
    catch_up(d);
    status = of(d)->inner->op->tile_count(of(d)->inner, views, splat2d, tiles);
    open_memory(of(d), false);
    return status;
}

struct args_tile_fill {
    struct spin_view_batch views;
    const struct spin_splat2d SPIN_DEV *splat2d;
    struct spin_tiles tiles;
};

static void late_tile_fill(struct spin_device *inner, void *args)
{
    struct args_tile_fill *q = args;

    if (inner->op->tile_fill(inner, &q->views, q->splat2d, &q->tiles) == SPIN_OK)
        return;
    printf("Bail out! the lists of the tiles: %s\n", spin_last_error());
    exit(1);
}

/* Queued, like on a device that runs out of memory only later. */
static spin_status tile_fill(struct spin_device *d, const struct spin_view_batch *views,
                             const struct spin_splat2d SPIN_DEV *splat2d,
                             const struct spin_tiles *tiles)
{
    struct args_tile_fill q = {*views, splat2d, *tiles};

    check(d, __func__, (const void *)splat2d);
    check_spin_tiles(d, __func__, tiles);
    push(d, late_tile_fill, &q, sizeof q);
    return SPIN_OK;
}

static void close_strict(struct spin_device *d)
{
    struct strict *s = of(d);

    catch_up(d);
    for (size_t i = 0; i < s->n_blocks && !s->range; i++)
        s->inner->op->release(s->inner, (void SPIN_DEV *)s->block[i].at);
    spin_device_close(s->inner);
    if (s->range)
        munmap(s->range, range_bytes);
    free(s->inner);
    free(s->queue);
    free(s);
}

struct spin_device *strict_open(struct spin_device *inner, int frames_at_once, int views_at_once)
{
    struct spin_device *d = calloc(1, sizeof *d);
    struct strict *s = calloc(1, sizeof *s);

    s->inner = inner;
    if (!check_device_is_card(inner))
        s->range =
            mmap(NULL, range_bytes, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (s->range == MAP_FAILED) {
        printf("Bail out! no addresses for the strict device\n");
        exit(1);
    }
    s->ops = (struct spin_device_ops){
        .name = "strict",
        .close = close_strict,
        .reserve = reserve,
        .release = release,
        .zero = zero,
        .upload = upload,
        .download = download,
        .wait = wait,
        .host_reserve = host_reserve,
        .host_release = host_release,
        .host_view = host_view,
        .copy_rows = copy_rows,
        .memory_available = memory_available,
        .clock = clock_of,
        .contract = contract,
        .contract_back = contract_back,
        .grid = grid,
        .grid_back = grid_back,
        .mlp = mlp,
        .mlp_back = mlp_back,
        .residual = residual,
        .residual_set = residual_set,
        .residual_back = residual_back,
        .densify_stats = densify_stats,
        .tracks = tracks,
        .tracks_back = tracks_back,
        .activate = activate,
        .activate_back = activate_back,
        .nonzero_grad = nonzero_grad,
        .project = project,
        .project_back = project_back,
        .tile_count = tile_count,
        .tile_fill = tile_fill,
        .blend = blend,
        .depth = depth,
        .blend_back = blend_back,
        .loss = loss,
        .measure = measure,
        .exposure = exposure,
        .exposure_back = exposure_back,
        .exposure_centre = exposure_centre,
        .adam = adam,
        .not_finite = not_finite,
    };
    d->op = &s->ops;
    d->path = inner->path;
    d->state = s;
    d->frames_at_once = frames_at_once;
    d->views_at_once = views_at_once;
    return d;
}

void strict_close(struct spin_device *d)
{
    if (d)
        spin_device_close(d);
    free(d);
}
