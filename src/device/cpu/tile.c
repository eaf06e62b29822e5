/* The list of splats of every tile, front to back: one stable radix sort of the splats by depth,
 * then a counting sort of their (splat, tile) pairs into tiles in that order. Both are cut into
 * PARTS whose bounds depend only on the sizes, so the result does not depend on the threads.
 *
 * Tiles of a splat's rectangle in which its alpha is below 1/255 everywhere get no pair (trim):
 * the pixels would skip it anyway. */
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "device/cpu/cpu.h"
#include "device/cpu/pairs.h"
#include "math/blend.h"
#include "math/tile.h"

enum { PARTS = 16, DIGIT = 11, BUCKETS = 1 << DIGIT, PASSES = 3, AHEAD = 12 };

struct entry {
    uint32_t key, splat;
};

/* Kept in SPIN_SCRATCH_TILE from tile_count to tile_fill. */
struct sorted {
    size_t n;
    struct entry *entry;
};

struct job {
    const struct spin_cam *cam;
    size_t n;
    struct spin_splat2d *splat2d;
    const struct spin_splat2d *splat2d_in;
    struct spin_tiles *tiles;
    uint64_t pairs[PARTS + 1]; /* of a part of the splats; then before it */
    size_t drawn[PARTS + 1];   /* likewise */
    struct entry *from, *to;
    size_t n_sorted;
    int shift;
    uint32_t *count; /* [PARTS][buckets or tiles] */
};

static size_t part_begin(size_t n, int part)
{
    return n / PARTS * (size_t)part + n % PARTS * (size_t)part / PARTS;
}

static uint8_t byte_of(int v) { return (uint8_t)(v > 255 ? 255 : v); }

/* Set trim and return the number of pairs. */
static uint32_t trim_one(struct spin_splat2d *s)
{
    struct spin_blend_splat b;
    int x0 = s->x0, x1 = s->x1, y0 = s->y0, y1 = s->y1;
    float reach_x, reach_y;

    memset(s->trim, 0, sizeof s->trim);
    if (s->radius_px <= 0)
        return 0;
    b = spin_blend_prepare(s->u_px, s->v_px, s->conic, s->opacity, s->colour);
    spin_blend_reach(b.a, b.b, b.c, b.log2_opacity, &reach_x, &reach_y);
    spin_tile_narrow(s->u_px, reach_x, &x0, &x1);
    spin_tile_narrow(s->v_px, reach_y, &y0, &y1);
    s->trim[0] = byte_of(x0 - s->x0);
    s->trim[1] = byte_of(y0 - s->y0);
    s->trim[2] = byte_of(s->x1 - x1);
    s->trim[3] = byte_of(s->y1 - y1);
    return spin_pair_count(spin_pair_rect(s));
}

static void trim_task(void *context, int part, int worker)
{
    struct job *job = context;
    uint64_t pairs = 0;
    size_t drawn = 0;

    (void)worker;
    for (size_t i = part_begin(job->n, part); i < part_begin(job->n, part + 1); i++) {
        uint32_t count = trim_one(job->splat2d + i);
        job->splat2d[i].first_slot = (uint32_t)pairs; /* in its part, for now */
        pairs += count;
        drawn += count > 0;
    }
    job->pairs[part] = pairs;
    job->drawn[part] = drawn;
}

static void list_task(void *context, int part, int worker)
{
    struct job *job = context;
    struct entry *to = job->from + job->drawn[part];

    (void)worker;
    for (size_t i = part_begin(job->n, part); i < part_begin(job->n, part + 1); i++) {
        struct spin_splat2d *s = job->splat2d + i;
        s->first_slot += (uint32_t)job->pairs[part];
        if (spin_pair_count(spin_pair_rect(s)) > 0)
            *to++ = (struct entry){spin_depth_key(s->depth), (uint32_t)i};
    }
}

static uint32_t digit_of(const struct job *job, struct entry e)
{
    return e.key >> job->shift & (BUCKETS - 1);
}

static void digit_count_task(void *context, int part, int worker)
{
    struct job *job = context;
    uint32_t *count = job->count + (size_t)part * BUCKETS;

    (void)worker;
    memset(count, 0, BUCKETS * sizeof *count);
    for (size_t i = part_begin(job->n_sorted, part); i < part_begin(job->n_sorted, part + 1); i++)
        count[digit_of(job, job->from[i])]++;
}

static void digit_move_task(void *context, int part, int worker)
{
    struct job *job = context;
    uint32_t *place = job->count + (size_t)part * BUCKETS;

    (void)worker;
    for (size_t i = part_begin(job->n_sorted, part); i < part_begin(job->n_sorted, part + 1); i++)
        job->to[place[digit_of(job, job->from[i])]++] = job->from[i];
}

/* Counts [PARTS][n] to first places: bucket by bucket, within a bucket part by part. */
static uint32_t counts_to_places(uint32_t *count, size_t n, uint32_t *start)
{
    uint32_t place = 0;

    for (size_t k = 0; k < n; k++) {
        if (start)
            start[k] = place;
        for (int part = 0; part < PARTS; part++) {
            uint32_t here = count[(size_t)part * n + k];
            count[(size_t)part * n + k] = place;
            place += here;
        }
    }
    return place;
}

static void sort_by_depth(struct spin_device *d, struct job *job)
{
    for (int pass = 0; pass < PASSES; pass++) {
        struct entry *swap = job->from;
        job->shift = pass * DIGIT;
        spin_pool_run(spin_cpu_pool(d), PARTS, digit_count_task, job);
        counts_to_places(job->count, BUCKETS, NULL);
        spin_pool_run(spin_cpu_pool(d), PARTS, digit_move_task, job);
        job->from = job->to;
        job->to = swap;
    }
}

void SPIN_CPU(tile_count)(struct spin_device *d, const struct spin_cam *cam, size_t n,
                          struct spin_splat2d *splat2d, struct spin_tiles *tiles)
{
    struct job job = {.cam = cam, .n = n, .splat2d = splat2d};
    size_t drawn = 0;
    uint64_t pairs = 0;
    struct sorted *sorted;

    spin_pool_run(spin_cpu_pool(d), PARTS, trim_task, &job);
    for (int part = 0; part < PARTS; part++) {
        size_t drawn_here = job.drawn[part];
        uint64_t pairs_here = job.pairs[part];
        job.drawn[part] = drawn;
        job.pairs[part] = pairs;
        drawn += drawn_here;
        pairs += pairs_here;
    }
    if (pairs > UINT32_MAX) {
        fprintf(stderr,
                "spin4d: cannot draw a view: %llu pairs of splats and tiles are more than 2^32\n",
                (unsigned long long)pairs);
        exit(1);
    }
    sorted =
        spin_cpu_scratch_need(d, SPIN_SCRATCH_TILE, 64 + 2 * (drawn + 1) * sizeof(struct entry));
    job.count = spin_cpu_scratch_need(d, SPIN_SCRATCH_TILE_KEYS,
                                      (size_t)PARTS * BUCKETS * sizeof *job.count);
    job.from = (struct entry *)((char *)sorted + 64);
    job.to = job.from + drawn;
    job.n_sorted = drawn;
    spin_pool_run(spin_cpu_pool(d), PARTS, list_task, &job);
    sort_by_depth(d, &job);
    sorted->n = drawn;
    sorted->entry = job.from;
    tiles->n_pairs = (uint32_t)pairs;
}

/* The rectangle of the i-th splat of a part that ends at `end`. In depth order the splats lie all
 * over memory: ask for the one a few places on. */
static struct spin_pair_rect rect_at(const struct job *job, size_t i, size_t end)
{
    if (i + AHEAD < end)
        __builtin_prefetch(&job->splat2d_in[job->from[i + AHEAD].splat].radius_px);
    return spin_pair_rect(job->splat2d_in + job->from[i].splat);
}

static void tile_count_task(void *context, int part, int worker)
{
    struct job *job = context;
    size_t n_tiles = (size_t)job->cam->tiles_x * (size_t)job->cam->tiles_y;
    uint32_t *count = job->count + (size_t)part * n_tiles;
    size_t end = part_begin(job->n_sorted, part + 1);

    (void)worker;
    memset(count, 0, n_tiles * sizeof *count);
    for (size_t i = part_begin(job->n_sorted, part); i < end; i++) {
        struct spin_pair_rect r = rect_at(job, i, end);
        for (int y = r.y0; y < r.y1; y++)
            for (int x = r.x0; x < r.x1; x++)
                count[(size_t)y * (size_t)job->cam->tiles_x + (size_t)x]++;
    }
}

static void tile_move_task(void *context, int part, int worker)
{
    struct job *job = context;
    size_t n_tiles = (size_t)job->cam->tiles_x * (size_t)job->cam->tiles_y;
    uint32_t *place = job->count + (size_t)part * n_tiles;
    size_t end = part_begin(job->n_sorted, part + 1);

    (void)worker;
    for (size_t i = part_begin(job->n_sorted, part); i < end; i++) {
        uint32_t splat = job->from[i].splat;
        struct spin_pair_rect r = rect_at(job, i, end);
        for (int y = r.y0; y < r.y1; y++)
            for (int x = r.x0; x < r.x1; x++)
                job->tiles->pairs[place[(size_t)y * (size_t)job->cam->tiles_x + (size_t)x]++] =
                    splat;
    }
}

void SPIN_CPU(tile_fill)(struct spin_device *d, const struct spin_cam *cam, size_t n,
                         const struct spin_splat2d *splat2d, struct spin_tiles *tiles)
{
    const struct sorted *sorted = spin_cpu_scratch_need(d, SPIN_SCRATCH_TILE, sizeof *sorted);
    size_t n_tiles = (size_t)cam->tiles_x * (size_t)cam->tiles_y;
    struct job job = {.cam = cam, .n = n, .splat2d_in = splat2d, .tiles = tiles};

    job.n_sorted = sorted->n;
    job.from = sorted->entry;
    job.count =
        spin_cpu_scratch_need(d, SPIN_SCRATCH_TILE_KEYS, PARTS * n_tiles * sizeof *job.count);
    spin_pool_run(spin_cpu_pool(d), PARTS, tile_count_task, &job);
    tiles->start[n_tiles] = counts_to_places(job.count, n_tiles, tiles->start);
    spin_pool_run(spin_cpu_pool(d), PARTS, tile_move_task, &job);
}
