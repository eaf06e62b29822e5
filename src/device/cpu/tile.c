/* Lists the splats of every tile, front to back: sorts the splats by depth with a stable radix
 * sort, then their (splat, tile) pairs by tile with a counting sort. Each sort is divided into
 * parts whose bounds depend only on the number of elements, so the result does not depend on the
 * number of threads. The values of a splat that the sorts need are copied to small arrays, since
 * splats in depth order are scattered over memory.
 *
 * The rectangle of tiles of each splat is trimmed: a tile in which the alpha of the splat is below
 * 1/255 everywhere gets no pair, since blending skips such pixels. */
#include <string.h>

#include "device/cpu/cpu.h"
#include "device/pairs.h"
#include "math/blend.h"
#include "math/tile.h"

enum {
    MAX_PARTS = 16,
    PART = 4096, /* number of splats per part, unless that would give more than MAX_PARTS parts */
    BATCH = 64,  /* number of splats that are trimmed at a time */
    AHEAD = 16,  /* prefetch distance, in splats */
    PASSES = 3,
    MAX_BUCKETS = 1 << 11 /* three digits of 11 bits are enough for 32-bit keys */
};

struct entry {
    uint32_t key, splat;
};

/* The tiles of a splat after trimming: columns [x0, x1) and rows [y0, y1). */
struct rect {
    uint16_t x0, y0, x1, y1;
};

/* Header of the sorted splats of one view, which are kept in SPIN_SCRATCH_TILE from tile_count() to
 * tile_fill(). The header and the arrays that follow it occupy sorted_bytes() bytes. */
struct sorted {
    size_t n;
    struct entry *entry; /* [n] sorted from front to back */
    struct rect *rect;   /* [splats] tiles of each splat, in the original order */
    uint32_t first;      /* index of the view's first pair in spin_tiles.intersections */
};

struct job {
    const struct spin_camera_f32 *cam;
    size_t n;
    int parts;
    struct spin_splat2d *splat2d;
    uint32_t *lists; /* output: the lists of splats of the tiles */
    /* Numbers of pairs and of visible splats in each part; after sum_parts(), in all parts before
     * that part. */
    uint64_t intersections[MAX_PARTS];
    size_t drawn[MAX_PARTS];
    /* Smallest and largest key of the visible splats of each part. */
    uint32_t low[MAX_PARTS], high[MAX_PARTS];
    uint32_t *key;     /* [n] */
    struct rect *rect; /* [n] */
    struct entry *from, *to;
    size_t n_sorted;
    uint32_t lowest;  /* smallest key in all parts */
    int digit, shift; /* number of bits per digit; number of bits below the current digit */
    uint32_t *count;  /* [parts][buckets or tiles] */
};

static int parts_of(size_t n)
{
    return n >= (size_t)MAX_PARTS * PART ? MAX_PARTS : (int)((n + PART - 1) / PART);
}

static size_t part_begin(const struct job *job, size_t n, int part)
{
    size_t parts = (size_t)job->parts;

    return n / parts * (size_t)part + n % parts * (size_t)part / parts;
}

/* A batch of splats whose rectangles are trimmed, stored as a structure of arrays so that the
 * compiler vectorises the loops. */
struct trims {
    float u[BATCH], v[BATCH], a[BATCH], b[BATCH], c[BATCH], opacity[BATCH];
    int32_t x0[BATCH], y0[BATCH], x1[BATCH], y1[BATCH];
};

static void trims_load(struct trims *t, const struct spin_splat2d *s, size_t n)
{
    for (size_t i = 0; i < n; i++, s++) {
        int drawn = s->radius_px > 0;

        t->u[i] = s->u_px;
        t->v[i] = s->v_px;
        t->a[i] = s->conic[0];
        t->b[i] = s->conic[1];
        t->c[i] = s->conic[2];
        t->opacity[i] = s->opacity;
        t->x0[i] = drawn ? s->x0 : 0;
        t->y0[i] = drawn ? s->y0 : 0;
        t->x1[i] = drawn ? s->x1 : 0;
        t->y1[i] = drawn ? s->y1 : 0;
    }
}

static __attribute__((noinline)) void trims_narrow(struct trims *t)
{
    for (int i = 0; i < BATCH; i++) {
        float a = t->a[i], b = t->b[i], c = t->c[i], reach_x, reach_y;
        float log2_opacity = spin_blend_scale(&a, &b, &c, t->opacity[i]);

        spin_blend_reach(a, b, c, log2_opacity, &reach_x, &reach_y);
        t->a[i] = reach_x;
        t->b[i] = reach_y;
    }
    for (int i = 0; i < BATCH; i++)
        spin_tile_narrow(t->u[i], t->a[i], &t->x0[i], &t->x1[i]);
    for (int i = 0; i < BATCH; i++)
        spin_tile_narrow(t->v[i], t->b[i], &t->y0[i], &t->y1[i]);
}

static uint8_t byte_of(int v) { return (uint8_t)(v > 255 ? 255 : v); }

/* Sets tile_cull, key, rect and first_intersection of each splat. first_intersection is counted
 * from the start of the part until list_task() completes it. */
static void trims_store(struct job *job, int part, const struct trims *t, size_t first, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        struct spin_splat2d *s = job->splat2d + first + i;
        struct spin_pair_rect r;
        uint32_t count;

        memset(s->tile_cull, 0, sizeof s->tile_cull);
        if (s->radius_px > 0) {
            s->tile_cull[0] = byte_of(t->x0[i] - s->x0);
            s->tile_cull[1] = byte_of(t->y0[i] - s->y0);
            s->tile_cull[2] = byte_of(s->x1 - t->x1[i]);
            s->tile_cull[3] = byte_of(s->y1 - t->y1[i]);
        }
        r = spin_pair_rect(s);
        count = spin_pair_count(r);
        job->rect[first + i] =
            (struct rect){(uint16_t)r.x0, (uint16_t)r.y0, (uint16_t)r.x1, (uint16_t)r.y1};
        job->key[first + i] = spin_depth_key(s->depth);
        s->first_intersection = (uint32_t)job->intersections[part];
        if (count == 0)
            continue;
        job->intersections[part] += count;
        job->drawn[part]++;
        if (job->key[first + i] < job->low[part])
            job->low[part] = job->key[first + i];
        if (job->key[first + i] > job->high[part])
            job->high[part] = job->key[first + i];
    }
}

static void trim_task(void *context, int part)
{
    struct job *job = context;
    size_t end = part_begin(job, job->n, part + 1);
    struct trims trims;

    memset(&trims, 0, sizeof trims);
    job->intersections[part] = 0;
    job->drawn[part] = 0;
    job->low[part] = UINT32_MAX;
    job->high[part] = 0;
    for (size_t i = part_begin(job, job->n, part); i < end; i += BATCH) {
        size_t n = end - i < BATCH ? end - i : BATCH;

        trims_load(&trims, job->splat2d + i, n);
        trims_narrow(&trims);
        trims_store(job, part, &trims, i, n);
    }
}

static bool is_empty(struct rect r) { return r.x0 >= r.x1 || r.y0 >= r.y1; }

/* Lists the splats of a part that have pairs, with their keys, and completes first_intersection by
 * adding the pairs of earlier parts. */
static void list_task(void *context, int part)
{
    struct job *job = context;
    struct entry *to = job->from + job->drawn[part];
    uint32_t before = (uint32_t)job->intersections[part];

    for (size_t i = part_begin(job, job->n, part); i < part_begin(job, job->n, part + 1); i++) {
        job->splat2d[i].first_intersection += before;
        if (!is_empty(job->rect[i]))
            *to++ = (struct entry){job->key[i] - job->lowest, (uint32_t)i};
    }
}

static uint32_t digit_of(const struct job *job, struct entry e)
{
    return e.key >> job->shift & ((1u << job->digit) - 1);
}

/* Counts how often each value of the current digit occurs in a part. Consecutive splats often have
 * the same digit. Splats are therefore counted in two arrays in turn, so that an increment does not
 * wait for the previous one. */
static void digit_count_task(void *context, int part)
{
    struct job *job = context;
    size_t buckets = (size_t)1 << job->digit, end = part_begin(job, job->n_sorted, part + 1);
    size_t i = part_begin(job, job->n_sorted, part);
    uint32_t *count = job->count + (size_t)part * buckets, other[MAX_BUCKETS];

    memset(count, 0, buckets * sizeof *count);
    memset(other, 0, buckets * sizeof *other);
    for (; i + 2 <= end; i += 2) {
        count[digit_of(job, job->from[i])]++;
        other[digit_of(job, job->from[i + 1])]++;
    }
    if (i < end)
        count[digit_of(job, job->from[i])]++;
    for (size_t k = 0; k < buckets; k++)
        count[k] += other[k];
}

static void digit_move_task(void *context, int part)
{
    struct job *job = context;
    uint32_t *place = job->count + ((size_t)part << job->digit);
    size_t end = part_begin(job, job->n_sorted, part + 1);

    for (size_t i = part_begin(job, job->n_sorted, part); i < end; i++)
        job->to[place[digit_of(job, job->from[i])]++] = job->from[i];
}

/* Replaces the counts of n buckets by the index at which each part writes its first element of the
 * bucket: bucket by bucket, and within a bucket part by part, from index `place` on. The counts of
 * different parts are `stride` apart. Returns the index after the last element. */
static uint32_t counts_to_places(const struct job *job, size_t n, size_t stride, uint32_t place,
                                 uint32_t *start)
{
    uint32_t *count = job->count;

    for (size_t k = 0; k < n; k++) {
        if (start)
            start[k] = place;
        for (int part = 0; part < job->parts; part++) {
            uint32_t here = count[(size_t)part * stride + k];
            count[(size_t)part * stride + k] = place;
            place += here;
        }
    }
    return place;
}

/* Sorts the entries by key, in PASSES passes that count one digit of the keys and then move the
 * entries. Digits have as few bits as the largest key allows. */
static void sort_by_depth(struct spin_device *d, struct job *job, uint32_t highest)
{
    int bits = 1;

    while (bits < 32 && highest >> bits)
        bits++;
    job->digit = (bits + PASSES - 1) / PASSES;
    for (int pass = 0; pass < PASSES; pass++) {
        struct entry *swap = job->from;
        job->shift = pass * job->digit;
        spin_pool_run(spin_cpu_pool(d), job->parts, digit_count_task, job);
        counts_to_places(job, (size_t)1 << job->digit, (size_t)1 << job->digit, 0, NULL);
        spin_pool_run(spin_cpu_pool(d), job->parts, digit_move_task, job);
        job->from = job->to;
        job->to = swap;
    }
}

/* Replaces the counts of each part by the sums over all parts before that part, and finds the
 * smallest and the largest key. Returns the total number of pairs. */
static uint64_t sum_parts(struct job *job, uint32_t *highest)
{
    uint64_t intersections = 0;

    job->lowest = UINT32_MAX;
    *highest = 0;

    for (int part = 0; part < job->parts; part++) {
        size_t drawn_here = job->drawn[part];
        uint64_t pairs_here = job->intersections[part];
        job->drawn[part] = job->n_sorted;
        job->intersections[part] = intersections;
        job->n_sorted += drawn_here;
        intersections += pairs_here;
        job->lowest = job->low[part] < job->lowest ? job->low[part] : job->lowest;
        *highest = job->high[part] > *highest ? job->high[part] : *highest;
    }
    return intersections;
}

/* bytes reserved for struct sorted, so that the arrays after it are aligned */
enum { HEADER = 64 };

static size_t sorted_bytes(size_t n)
{
    size_t bytes = n * (2 * sizeof(struct entry) + sizeof(struct rect) + sizeof(uint32_t));

    return HEADER + (bytes + 63) / 64 * 64;
}

/* Counts the pairs of a view and sorts its splats by depth. The list of the view begins at index
 * *first, which is then advanced by the number of pairs. */
static spin_status count_view(struct spin_device *d, const struct spin_view_of_batch *view,
                              struct spin_splat2d *splat2d, struct sorted *sorted, uint64_t *first)
{
    size_t n = view->n;
    struct job job = {.cam = &view->camera, .n = n, .parts = parts_of(n), .splat2d = splat2d};
    uint32_t highest;
    uint64_t intersections;

    job.count = spin_cpu_scratch_need(d, SPIN_SCRATCH_TILE_KEYS,
                                      (size_t)MAX_PARTS * MAX_BUCKETS * sizeof *job.count);
    if (!job.count)
        return d->op->wait(d);
    job.from = (struct entry *)((char *)sorted + HEADER);
    job.to = job.from + n;
    job.rect = (struct rect *)(job.to + n);
    job.key = (uint32_t *)(job.rect + n);
    spin_pool_run(spin_cpu_pool(d), job.parts, trim_task, &job);
    intersections = sum_parts(&job, &highest);
    if (intersections > SPIN_MAX_PAIRS)
        return spin_fail(
            SPIN_E_MEMORY,
            "cannot render a view: %llu pairs of splats and tiles exceed the limit of %llu: "
            "render a smaller image, or remove splats that are very large",
            (unsigned long long)intersections, (unsigned long long)SPIN_MAX_PAIRS);
    if (*first + intersections > UINT32_MAX)
        return spin_fail(
            SPIN_E_MEMORY,
            "cannot render this many views at once: %llu pairs of splats and tiles exceed "
            "2^32: render fewer views at once",
            (unsigned long long)(*first + intersections));
    spin_pool_run(spin_cpu_pool(d), job.parts, list_task, &job);
    sort_by_depth(d, &job, job.n_sorted ? highest - job.lowest : 0);
    sorted->n = job.n_sorted;
    sorted->entry = job.from;
    sorted->rect = job.rect;
    sorted->first = (uint32_t)*first;
    *first += intersections;
    return SPIN_OK;
}

spin_status SPIN_CPU(tile_count)(struct spin_device *d, const struct spin_view_batch *views,
                                 struct spin_splat2d *splat2d, struct spin_tiles *tiles)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_TILE);
    size_t bytes = 0;
    char *scratch;

    tiles->n_intersections = 0;
    for (int k = 0; k < views->n_views; k++)
        bytes += sorted_bytes(views->view[k].n);
    scratch = spin_cpu_scratch_need(d, SPIN_SCRATCH_TILE, bytes);
    if (!scratch)
        return d->op->wait(d);
    for (int k = 0; k < views->n_views; k++) {
        const struct spin_view_of_batch *view = &views->view[k];

        SPIN_TRY(count_view(d, view, splat2d + view->first, (struct sorted *)scratch,
                            &tiles->n_intersections));
        scratch += sorted_bytes(view->n);
    }
    return SPIN_OK;
}

/* Iterates over the tiles of a rectangle, row by row, in a single loop. Two nested loops would
 * mispredict two branches per splat. */
struct walk {
    /* `jump`: distance from the last tile of a row to the first tile of the next row */
    size_t tile, jump;
    uint32_t left, width, left_in_row;
};

static inline struct walk walk_begin(struct rect r, size_t tiles_x)
{
    uint32_t width = (uint32_t)r.x1 - r.x0;

    return (struct walk){(size_t)r.y0 * tiles_x + r.x0, tiles_x - width + 1,
                         width * ((uint32_t)r.y1 - r.y0), width, width};
}

static inline void walk_on(struct walk *w)
{
    bool end = --w->left_in_row == 0;

    w->tile += end ? w->jump : 1;
    w->left_in_row = end ? w->width : w->left_in_row;
    w->left--;
}

/* Returns the number of corners of tiles. In each direction there is one corner more than tiles. */
static size_t corners_of(const struct spin_camera_f32 *cam)
{
    return ((size_t)cam->tiles_x + 1) * ((size_t)cam->tiles_y + 1);
}

/* Counts the splats that cover each tile. Every rectangle adds +1 or -1 at each of its four
 * corners; the two-dimensional prefix sums of these values are the counts. The counts then
 * overwrite the values, with one entry per tile instead of one per corner. */
static void tile_count_task(void *context, int part)
{
    struct job *job = context;
    size_t tiles_x = (size_t)job->cam->tiles_x, tiles_y = (size_t)job->cam->tiles_y;
    size_t wide = tiles_x + 1, end = part_begin(job, job->n_sorted, part + 1);
    uint32_t *count = job->count + (size_t)part * corners_of(job->cam);

    memset(count, 0, corners_of(job->cam) * sizeof *count);
    for (size_t i = part_begin(job, job->n_sorted, part); i < end; i++) {
        struct rect r = job->rect[job->from[i].splat];
        uint32_t *top = count + r.y0 * wide, *bottom = count + r.y1 * wide;

        if (i + AHEAD < end)
            __builtin_prefetch(&job->rect[job->from[i + AHEAD].splat]);
        top[r.x0]++;
        top[r.x1]--;
        bottom[r.x0]--;
        bottom[r.x1]++;
    }
    for (size_t y = 0; y < tiles_y; y++) {
        uint32_t sum = 0;

        for (size_t x = 0; x < tiles_x; x++) {
            sum += count[y * wide + x];
            count[y * tiles_x + x] = sum + (y > 0 ? count[(y - 1) * tiles_x + x] : 0);
        }
    }
}

static void tile_move_task(void *context, int part)
{
    struct job *job = context;
    size_t tiles_x = (size_t)job->cam->tiles_x;
    uint32_t *place = job->count + (size_t)part * corners_of(job->cam), *intersections = job->lists;
    size_t end = part_begin(job, job->n_sorted, part + 1);

    for (size_t i = part_begin(job, job->n_sorted, part); i < end; i++) {
        uint32_t splat = job->from[i].splat;
        struct walk w = walk_begin(job->rect[splat], tiles_x);

        if (i + AHEAD < end)
            __builtin_prefetch(&job->rect[job->from[i + AHEAD].splat]);
        for (; w.left > 0; walk_on(&w))
            intersections[place[w.tile]++] = splat;
    }
}

static spin_status fill_view(struct spin_device *d, const struct spin_view_of_batch *view,
                             const struct sorted *sorted, uint32_t *lists, uint32_t *start)
{
    const struct spin_camera_f32 *cam = &view->camera;
    size_t n_tiles = (size_t)cam->tiles_x * (size_t)cam->tiles_y;
    struct job job = {.cam = cam, .n = view->n, .parts = parts_of(view->n), .lists = lists};

    job.n_sorted = sorted->n;
    job.from = sorted->entry;
    job.rect = sorted->rect;
    job.count = spin_cpu_scratch_need(d, SPIN_SCRATCH_TILE_KEYS,
                                      MAX_PARTS * corners_of(cam) * sizeof *job.count);
    if (!job.count)
        return d->op->wait(d);
    spin_pool_run(spin_cpu_pool(d), job.parts, tile_count_task, &job);
    start[n_tiles] = counts_to_places(&job, n_tiles, corners_of(cam), sorted->first, start);
    spin_pool_run(spin_cpu_pool(d), job.parts, tile_move_task, &job);
    return SPIN_OK;
}

spin_status SPIN_CPU(tile_fill)(struct spin_device *d, const struct spin_view_batch *views,
                                const struct spin_splat2d *splat2d, const struct spin_tiles *tiles)
{
    const char *scratch = spin_cpu_scratch_need(d, SPIN_SCRATCH_TILE, 0);
    SPIN_CPU_CLOCK(d, SPIN_OP_TILE);

    (void)splat2d;
    for (int k = 0; k < views->n_views; k++) {
        SPIN_TRY(fill_view(d, &views->view[k], (const struct sorted *)scratch, tiles->intersections,
                           tiles->start + (size_t)k * (views->max_tiles + 1)));
        scratch += sorted_bytes(views->view[k].n);
    }
    return SPIN_OK;
}
