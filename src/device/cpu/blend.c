/* Blends the splats of a tile front to back, and computes the gradients of the splats back to
 * front. The formulas are those of math/blend.h, rewritten to process a vector of pixels of a row
 * at a time; tests/device/t-blend.c compares both implementations.
 *
 * The (splat, tile) pairs of a tile are prepared in batches. A splat is blended only in rows where
 * its alpha is large enough to contribute. SIMD paths with short vectors also skip the columns
 * where alpha is too small. In the backward pass, each pair writes its sums to its own slot, and
 * the slots of a splat are added in order. This needs no atomics and gives the same bits for any
 * number of threads. */
#include <string.h>

#include "device/cpu/cpu.h"
#include "device/cpu/lanes.h"
#include "device/pairs.h"
#include "math/blend.h"

enum {
    BATCH = 32,
    SIDE = SPIN_TILE,
    LANES = SPIN_LANES,
    VECS = SIDE / LANES, /* number of vectors in a row of the tile */
    REDUCE_CHUNK = 512
};

struct job {
    const struct spin_camera_f32 *cam;
    size_t n;
    const struct spin_splat2d *splat2d;
    /* lists of the view's tiles and the start of each list, see struct spin_tiles */
    const uint32_t *lists, *start;
    const float *background;
    const uint8_t *matte; /* NULL: none; see struct spin_view_of_batch */
    const float *change;  /* is added to the background of pixels of known alpha */
    float *image, *final_transmittance;
    int32_t *last_contributor;
    const float *final_t_in, *d_image;
    const int32_t *n_used_in;
    struct spin_splat2d_grad *d_splat2d;
    struct spin_blend_sums *slots;
    bool absolute;
};

/* Position and size of a tile in the image. */
struct place {
    int x0, y0, width, height;
    size_t tile_x, tile_y;
};

static struct place place_of(const struct spin_camera_f32 *cam, int tile)
{
    struct place p;

    p.tile_x = (size_t)(tile % cam->tiles_x);
    p.tile_y = (size_t)(tile / cam->tiles_x);
    p.x0 = (int)p.tile_x * SIDE;
    p.y0 = (int)p.tile_y * SIDE;
    p.width = cam->width - p.x0 < SIDE ? cam->width - p.x0 : SIDE;
    p.height = cam->height - p.y0 < SIDE ? cam->height - p.y0 : SIDE;
    return p;
}

/* A batch of the tile's pairs, prepared for blending: the offset of each splat from the tile's
 * first pixel, the coefficients of its exponent, the range of vectors in a row to which it may
 * contribute, and the values from which rows_set() finds the rows. It is a structure of arrays so
 * that the compiler vectorises the loop that fills it. */
struct ready {
    float u[BATCH], v[BATCH], a[BATCH], b[BATCH], c[BATCH], opacity[BATCH], colour[3][BATCH];
    float peak[BATCH]; /* dx / dy at the point of a row where the exponent is largest */
    /* minimum of the exponent, without the opacity, in pixels that the splat contributes to */
    float least[BATCH];
    int32_t vec0[BATCH], vec1[BATCH];
};

/* Returns v truncated to an integer and clamped to 0..n. */
SPIN_FN int32_t clamp_to(float v, float n) { return (int32_t)spin_minf(spin_maxf(v, 0), n); }

/* Computes vec0, vec1, peak and least, and converts a, b, c and the opacity to base 2 for the
 * exponent. Adding 0.999 is enough to round u - reach_x up to a whole pixel, since
 * spin_blend_reach() has already added 0.01 to the reach. `least` has a margin for the rounding
 * errors of the exponent's terms anywhere in the tile; if the coefficients are degenerate, `least`
 * is so low that no pixel is skipped. */
static void compute_reach(struct ready *r)
{
    for (int i = 0; i < BATCH; i++) {
        float reach_x, reach_y, a, b, c, x, y, terms;
        int usable;

        r->opacity[i] = spin_blend_scale(&r->a[i], &r->b[i], &r->c[i], r->opacity[i]);
        a = r->a[i], b = r->b[i], c = r->c[i];
        spin_blend_reach(a, b, c, r->opacity[i], &reach_x, &reach_y);
        r->vec0[i] = clamp_to(r->u[i] - reach_x + 0.999f, SIDE) / LANES;
        r->vec1[i] = (clamp_to(r->u[i] + reach_x + 1, SIDE) + LANES - 1) / LANES;
        x = spin_maxf(fabsf(r->u[i]), fabsf(r->u[i] - SIDE));
        y = spin_maxf(fabsf(r->v[i]), fabsf(r->v[i] - SIDE));
        terms = fabsf(a) * x * x + fabsf(b) * x * y + fabsf(c) * y * y;
        usable = a < -1e-20f && fabsf(b) < 1e10f;
        r->peak[i] = usable ? -0.5f * b / a : 0;
        r->least[i] = usable ? SPIN_ALPHA_MIN_LOG2 - r->opacity[i] - 1e-4f - 2e-6f * terms : -1e30f;
    }
}

/* Prepares a batch of n pairs, and prefetches the splats of the following batch, which are next[0]
 * to next[n_next - 1]. */
static void prepare_batch(const struct spin_splat2d *splat2d, const struct place *p,
                          const uint32_t *intersections, uint32_t n, const uint32_t *next,
                          uint32_t n_next, struct ready *r)
{
    for (uint32_t i = 0; i < n_next; i++)
        __builtin_prefetch(splat2d + next[i]);
    for (uint32_t i = 0; i < BATCH; i++) {
        const struct spin_splat2d *s = splat2d + intersections[i < n ? i : 0];
        r->u[i] = s->u_px - (float)p->x0;
        r->v[i] = s->v_px - (float)p->y0;
        r->a[i] = s->conic[0];
        r->b[i] = s->conic[1];
        r->c[i] = s->conic[2];
        r->opacity[i] = s->opacity;
        for (int c = 0; c < 3; c++)
            r->colour[c][i] = s->colour[c];
    }
    compute_reach(r);
}

static struct spin_blend_splat splat_of(const struct ready *r, uint32_t i)
{
    struct spin_blend_splat s = {r->u[i],
                                 r->v[i],
                                 r->a[i],
                                 r->b[i],
                                 r->c[i],
                                 r->opacity[i],
                                 {r->colour[0][i], r->colour[1][i], r->colour[2][i]}};
    return s;
}

/* Terms of the exponent for every row of the tile: dy, the vertical distance to the splat, and c,
 * the term that does not depend on dx. The terms are kept in memory, since a load that broadcasts
 * one float costs no more than a plain load. */
struct rows {
    float dy[SIDE], c[SIDE];
    int begin, end; /* rows [begin, end) contain all pixels to which the splat may contribute */
};

/* Computes the terms and the range of rows of splat i. Since an ellipse covers consecutive rows,
 * one range is enough. */
SPIN_FN void rows_set(struct rows *rows, const struct ready *r, uint32_t i, int height)
{
    spin_lanes lowest = spin_lanes_all(r->u[i] - (SIDE - 1)), highest = spin_lanes_all(r->u[i]);
    uint32_t bits = 0;

    for (int k = 0; k < VECS; k++) {
        spin_lanes dy = r->v[i] - (spin_lanes_count() + (float)(k * LANES)), c = r->c[i] * dy;
        spin_lanes dx = spin_lanes_min(spin_lanes_max(r->peak[i] * dy, lowest), highest);

        spin_lanes_store(rows->dy + k * LANES, dy);
        c *= dy;
        spin_lanes_store(rows->c + k * LANES, c);
        c += (r->a[i] * dx + r->b[i] * dy) * dx;
        bits |= spin_mask_bits(spin_lanes_ge(c, spin_lanes_all(r->least[i]))) << (k * LANES);
    }
    bits &= (1u << height) - 1;
    rows->begin = bits ? __builtin_ctz(bits) : 0;
    rows->end = bits ? 32 - __builtin_clz(bits) : 0;
}

/* ---- Forward --------------------------------------------------------------------------------- */

/* The pixels of a tile: transmittance, colour and last contributor (`used`). A pixel is live until
 * it is opaque, since no further splat contributes to an opaque pixel. */
struct front {
    __attribute__((aligned(64))) float t[SIDE * SIDE], colour[3][SIDE * SIDE];
    int32_t used[SIDE * SIDE];
    spin_mask live[SIDE * VECS];
    int n_live; /* number of vectors that have at least one live pixel */
};

/* Prefetches the tile's part of the output arrays, which is written when the tile is complete. */
static void fetch_pixels(const struct job *job, const struct place *p)
{
    size_t plane = (size_t)job->cam->width * (size_t)job->cam->height;

    for (int y = 0; y < p->height; y++) {
        size_t at = (size_t)(p->y0 + y) * (size_t)job->cam->width + (size_t)p->x0;

        for (size_t c = 0; c < 3; c++)
            __builtin_prefetch(job->image + c * plane + at, 1);
        __builtin_prefetch(job->final_transmittance + at, 1);
        __builtin_prefetch(job->last_contributor + at, 1);
    }
}

static void front_begin(struct front *f, const struct place *p)
{
    f->n_live = 0;
    for (int i = 0; i < SIDE * VECS; i++) {
        spin_lanes_store(f->t + i * LANES, spin_lanes_all(1));
        for (int c = 0; c < 3; c++)
            spin_lanes_store(f->colour[c] + i * LANES, spin_lanes_all(0));
        spin_lanes_store_i(f->used + i * LANES, (spin_lanes_i){0});
    }
    for (int i = 0; i < SIDE * VECS; i++) {
        int pixels = i / VECS < p->height ? p->width - i % VECS * LANES : 0;
        pixels = pixels < 0 ? 0 : pixels > LANES ? LANES : pixels;
        f->live[i] = spin_mask_first(pixels);
        f->n_live += pixels > 0;
    }
}

/* Blends one splat onto one vector of pixels, like spin_blend_step(). `power` is the exponent
 * without the opacity. */
SPIN_FN void front_step(struct front *f, spin_lanes log2_opacity, const spin_lanes *colour, int vec,
                        spin_lanes power, int32_t place)
{
    spin_lanes exponent = power + log2_opacity;
    spin_mask counts = spin_mask_and(
        f->live[vec], spin_mask_and(spin_lanes_ge(spin_lanes_all(0), power),
                                    spin_lanes_ge(exponent, spin_lanes_all(SPIN_ALPHA_MIN_LOG2))));
    spin_lanes alpha, t, after, weight;
    spin_mask on;
    int at = vec * LANES;

    if (!spin_mask_any(counts))
        return;
    alpha = spin_lanes_min(spin_lanes_exp2(exponent), spin_lanes_all(SPIN_ALPHA_MAX));
    t = spin_lanes_load(f->t + at);
    weight = alpha * t;
    after = t - weight;
    on = spin_mask_and(counts, spin_lanes_ge(after, spin_lanes_all(SPIN_T_MIN)));
    weight = spin_lanes_keep(on, weight);
    for (int c = 0; c < 3; c++)
        spin_lanes_store(f->colour[c] + at,
                         spin_lanes_load(f->colour[c] + at) + weight * colour[c]);
    spin_lanes_store(f->t + at, spin_lanes_pick(on, after, t));
    spin_lanes_put_i(f->used + at, on, place + 1 - (spin_lanes_i){0});
    counts = spin_mask_without(counts, on);
    if (spin_mask_any(counts)) {
        f->live[vec] = spin_mask_without(f->live[vec], counts);
        f->n_live -= !spin_mask_any(f->live[vec]);
    }
}

static void front_splat(struct front *f, const struct ready *r, uint32_t i, int height,
                        int32_t place)
{
    spin_lanes colour[3], log2_opacity = spin_lanes_all(r->opacity[i]);
    struct rows rows;

    rows_set(&rows, r, i, height);
    for (int c = 0; c < 3; c++)
        colour[c] = spin_lanes_all(r->colour[c][i]);
    for (int k = r->vec0[i]; k < r->vec1[i]; k++) {
        spin_lanes dx = r->u[i] - (float)(k * LANES) - spin_lanes_count();
        spin_lanes a = r->a[i] * dx * dx, b = r->b[i] * dx;
        for (int row = rows.begin; row < rows.end; row++)
            front_step(f, log2_opacity, colour, row * VECS + k, a + b * rows.dy[row] + rows.c[row],
                       place);
    }
}

/* Changes the background of the pixels of a row whose alpha is known. */
SPIN_FN void change_row_out(const struct job *job, const float *restrict t, size_t plane, int width,
                            size_t at)
{
    for (size_t c = 0; c < 3; c++) {
        float *restrict image = job->image + c * plane + at, change = job->change[c];

        for (int x = 0; x < width; x++)
            image[x] += job->matte[at + (size_t)x] ? t[x] * change : 0;
    }
}

/* Writes one row of the tile to the output arrays. */
SPIN_FN void row_out(const struct job *job, const struct front *f, size_t plane, int width, int i,
                     size_t at)
{
    const float *restrict t = f->t + i;
    const int32_t *restrict used = f->used + i;
    float *restrict final_transmittance = job->final_transmittance + at;
    int32_t *restrict last_contributor = job->last_contributor + at;

    for (size_t c = 0; c < 3; c++) {
        const float *restrict colour = f->colour[c] + i;
        float *restrict image = job->image + c * plane + at, background = job->background[c];

        for (int x = 0; x < width; x++)
            image[x] = colour[x] + t[x] * background;
    }
    if (job->matte)
        change_row_out(job, t, plane, width, at);
    for (int x = 0; x < width; x++) {
        final_transmittance[x] = t[x];
        last_contributor[x] = used[x];
    }
}

static void front_end(const struct job *job, const struct front *f, const struct place *p)
{
    size_t plane = (size_t)job->cam->width * (size_t)job->cam->height;

    for (int y = 0; y < p->height; y++) {
        size_t at = (size_t)(p->y0 + y) * (size_t)job->cam->width + (size_t)p->x0;

        if (p->width == SIDE) /* a constant width lets the compiler unroll the loops */
            row_out(job, f, plane, SIDE, y * SIDE, at);
        else
            row_out(job, f, plane, p->width, y * SIDE, at);
    }
}

static void blend_task(void *context, int tile)
{
    const struct job *job = context;
    struct place p = place_of(job->cam, tile);
    const uint32_t *intersections = job->lists + job->start[tile];
    uint32_t n = job->start[tile + 1] - job->start[tile];
    struct ready ready;
    struct front f;

    fetch_pixels(job, &p);
    front_begin(&f, &p);
    for (uint32_t first = 0; first < n && f.n_live; first += BATCH) {
        uint32_t count = n - first < BATCH ? n - first : BATCH, left = n - first - count;
        prepare_batch(job->splat2d, &p, intersections + first, count, intersections + first + count,
                      left < BATCH ? left : BATCH, &ready);
        for (uint32_t i = 0; i < count && f.n_live; i++)
            front_splat(&f, &ready, i, p.height, (int32_t)(first + i));
    }
    front_end(job, &f, &p);
}

void SPIN_CPU(blend)(struct spin_device *d, const struct spin_view_batch *views,
                     const struct spin_splat2d *splat2d, const struct spin_tiles *tiles,
                     float *image, float *final_transmittance, int32_t *last_contributor)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_BLEND);

    for (int k = 0; k < views->n_views; k++) {
        const struct spin_view_of_batch *view = &views->view[k];
        struct job job = {.cam = &view->camera,
                          .splat2d = splat2d + view->first,
                          .lists = tiles->intersections,
                          .start = tiles->start + (size_t)k * (views->max_tiles + 1),
                          .background = views->background,
                          .matte = view->matte,
                          .change = view->background_change,
                          .image = spin_cpu_picture(views, k, image),
                          .final_transmittance =
                              final_transmittance + (size_t)k * views->max_pixels,
                          .last_contributor = last_contributor + (size_t)k * views->max_pixels};

        spin_pool_run(spin_cpu_pool(d), view->camera.tiles_x * view->camera.tiles_y, blend_task,
                      &job);
    }
}

/* ---- Depth ----------------------------------------------------------------------------------- */

/* Renders depth with scalar code, since depth is only rendered for output and never in training. */
static void depth_task(void *context, int tile)
{
    const struct job *job = context;
    struct place p = place_of(job->cam, tile);
    size_t plane = (size_t)job->cam->width * (size_t)job->cam->height;
    struct spin_blend_pixel pixel[SIDE * SIDE] = {0};

    for (int i = 0; i < SIDE * SIDE; i++)
        pixel[i].t = 1;
    for (uint32_t k = job->start[tile]; k < job->start[tile + 1]; k++) {
        const struct spin_splat2d *of = job->splat2d + job->lists[k];
        const float colour[3] = {of->depth, 1, 0};
        struct spin_blend_splat s = spin_blend_prepare(
            of->u_px - (float)p.x0, of->v_px - (float)p.y0, of->conic, of->opacity, colour);
        float reach_x, reach_y;
        int x1, y1;

        spin_blend_reach(s.a, s.b, s.c, s.log2_opacity, &reach_x, &reach_y);
        x1 = clamp_to(s.u_px + reach_x + 1, (float)p.width);
        y1 = clamp_to(s.v_px + reach_y + 1, (float)p.height);
        for (int y = clamp_to(s.v_px - reach_y, SIDE); y < y1; y++)
            for (int x = clamp_to(s.u_px - reach_x, SIDE); x < x1; x++)
                spin_blend_depth(&s, s.u_px - (float)x, s.v_px - (float)y, &pixel[y * SIDE + x]);
    }
    for (int y = 0; y < p.height; y++)
        for (int x = 0; x < p.width; x++) {
            float *to =
                job->image + (size_t)(p.y0 + y) * (size_t)job->cam->width + (size_t)(p.x0 + x);

            to[0] = spin_blend_expected(&pixel[y * SIDE + x]);
            to[plane] = pixel[y * SIDE + x].colour[2];
        }
}

void SPIN_CPU(depth)(struct spin_device *d, const struct spin_view_batch *views,
                     const struct spin_splat2d *splat2d, const struct spin_tiles *tiles,
                     float *depth)
{
    for (int k = 0; k < views->n_views; k++) {
        const struct spin_view_of_batch *view = &views->view[k];
        struct job job = {.cam = &view->camera,
                          .splat2d = splat2d + view->first,
                          .lists = tiles->intersections,
                          .start = tiles->start + (size_t)k * (views->max_tiles + 1),
                          .image = depth + 2 * (size_t)k * views->max_pixels};

        spin_pool_run(spin_cpu_pool(d), view->camera.tiles_x * view->camera.tiles_y, depth_task,
                      &job);
    }
}

/* ---- Backward -------------------------------------------------------------------------------- */

/* The pixels of a tile while its splats are visited from back to front. */
struct back {
    /* transmittance behind the current splat; after its backward step, that in front of it */
    float t[SIDE * SIDE];
    /* sum of weight * (colour . g) over the background and all splats behind the current one */
    float s[SIDE * SIDE];
    float g[3][SIDE * SIDE];       /* gradient of the image */
    float used[SIDE * SIDE];       /* last contributor as a float, which is exact below 2^24 */
    int32_t vec_used[SIDE * VECS]; /* largest `used` of each vector */
    int32_t most;                  /* largest `used` of the tile */
};

/* Adds the change of the background to the product of gradient and background, for the pixels of a
 * row whose alpha is known. */
SPIN_FN void change_row_in(const struct job *job, const struct back *b, int width, int i, size_t at,
                           float *restrict through)
{
    for (int c = 0; c < 3; c++) {
        const float *restrict g = b->g[c] + i;
        float change = job->change[c];

        for (int x = 0; x < width; x++)
            through[x] += job->matte[at + (size_t)x] ? g[x] * change : 0;
    }
}

/* Reads one row of the tile from the input arrays. */
SPIN_FN void row_in(const struct job *job, struct back *b, size_t plane, int width, int i,
                    size_t at)
{
    const float *restrict final_transmittance = job->final_t_in + at;
    const int32_t *restrict last_contributor = job->n_used_in + at;
    float through[SIDE] = {0}, *restrict t = b->t + i, *restrict s = b->s + i;
    float *restrict used = b->used + i;

    for (size_t c = 0; c < 3; c++) {
        const float *restrict d_image = job->d_image + c * plane + at;
        float *restrict g = b->g[c] + i, background = job->background[c];

        for (int x = 0; x < width; x++) {
            g[x] = d_image[x];
            through[x] += g[x] * background;
        }
    }
    if (job->matte)
        change_row_in(job, b, width, i, at, through);
    for (int x = 0; x < width; x++) {
        t[x] = final_transmittance[x];
        s[x] = t[x] * through[x];
        used[x] = (float)last_contributor[x];
    }
    for (int x = 0; x < width; x++)
        if (last_contributor[x] > b->vec_used[(i + x) / LANES])
            b->vec_used[(i + x) / LANES] = last_contributor[x];
}

static void back_begin(const struct job *job, struct back *b, const struct place *p)
{
    size_t plane = (size_t)job->cam->width * (size_t)job->cam->height;

    memset(b, 0, sizeof *b);
    for (int y = 0; y < p->height; y++) {
        size_t at = (size_t)(p->y0 + y) * (size_t)job->cam->width + (size_t)p->x0;

        if (p->width == SIDE)
            row_in(job, b, plane, SIDE, y * SIDE, at);
        else
            row_in(job, b, plane, p->width, y * SIDE, at);
    }
    for (int k = 0; k < SIDE * VECS; k++)
        b->most = b->vec_used[k] > b->most ? b->vec_used[k] : b->most;
}

/* Gradient sums of one splat over pixel rows, with one pixel column in each lane. No sums
 * with a factor dx are kept: dx is constant in a column, so it is multiplied in afterwards. */
struct sums {
    spin_lanes colour[3], e, ey, eyy, absolute_u, absolute_v;
};

SPIN_FN spin_lanes lanes_abs(spin_lanes v) { return spin_lanes_max(v, -v); }

/* Adds the gradient of one splat at one vector of pixels to the sums, like spin_blend_step_adj();
 * if `absolute`, also the absolute values. */
SPIN_FN void back_step(struct back *b, const struct spin_blend_splat *s, int vec, spin_lanes power,
                       spin_lanes dx, float dy, float place, bool absolute, struct sums *sums)
{
    spin_lanes exponent = power + s->log2_opacity;
    int at = vec * LANES;
    spin_mask on =
        spin_mask_and(spin_lanes_ge(spin_lanes_load(b->used + at), spin_lanes_all(place + 1)),
                      spin_mask_and(spin_lanes_ge(spin_lanes_all(0), power),
                                    spin_lanes_ge(exponent, spin_lanes_all(SPIN_ALPHA_MIN_LOG2))));
    spin_lanes raw, alpha, inverse, t, behind, weight, cg, de;
    spin_lanes g0, g1, g2;

    if (!spin_mask_any(on))
        return;
    raw = spin_lanes_exp2(exponent);
    alpha = spin_lanes_min(raw, spin_lanes_all(SPIN_ALPHA_MAX));
    inverse = spin_lanes_inverse(1.0f - alpha);
    t = spin_lanes_load(b->t + at);
    behind = spin_lanes_load(b->s + at);
    spin_lanes_store(b->t + at, spin_lanes_pick(on, t * inverse, t));
    t = t * inverse;
    weight = spin_lanes_keep(on, alpha * t);
    g0 = spin_lanes_load(b->g[0] + at);
    g1 = spin_lanes_load(b->g[1] + at);
    g2 = spin_lanes_load(b->g[2] + at);
    cg = s->colour[0] * g0 + s->colour[1] * g1 + s->colour[2] * g2;
    de = spin_lanes_keep(on, raw * (t * cg - behind * inverse));
    spin_lanes_store(b->s + at, behind + weight * cg);
    sums->colour[0] += weight * g0;
    sums->colour[1] += weight * g1;
    sums->colour[2] += weight * g2;
    sums->e += de;
    if (absolute) {
        sums->absolute_u += lanes_abs(de * (2 * s->a * dx + s->b * dy));
        sums->absolute_v += lanes_abs(de * (2 * s->c * dy + s->b * dx));
    }
    de *= dy;
    sums->ey += de;
    sums->eyy += de * dy;
}

SPIN_FN void add_sums(const struct sums *sums, spin_lanes dx, bool absolute,
                      struct spin_blend_sums *out)
{
    spin_lanes edx = sums->e * dx,
               part[8] = {sums->colour[0], sums->colour[1], sums->colour[2], sums->e, edx,
                          sums->ey,        edx * dx,        sums->ey * dx};
    float sum[8];

    spin_lanes_sum8(part, sum);
    for (int c = 0; c < 3; c++)
        out->colour[c] += sum[c];
    out->e += sum[3];
    out->ex += sum[4];
    out->ey += sum[5];
    out->exx += sum[6];
    out->exy += sum[7];
    out->eyy += spin_lanes_sum(sums->eyy);
    if (absolute) {
        out->absolute_u += spin_lanes_sum(sums->absolute_u);
        out->absolute_v += spin_lanes_sum(sums->absolute_v);
    }
}

SPIN_FN struct spin_blend_sums back_splat(struct back *b, const struct ready *r, uint32_t i,
                                          int height, int32_t place, bool absolute)
{
    struct spin_blend_splat s = splat_of(r, i);
    struct spin_blend_sums out = {0};
    const spin_lanes none = {0};
    struct rows rows;

    rows_set(&rows, r, i, height);
    for (int k = r->vec0[i]; k < r->vec1[i]; k++) {
        spin_lanes dx = s.u_px - (float)(k * LANES) - spin_lanes_count();
        spin_lanes a = s.a * dx * dx, slope = s.b * dx;
        /* a local variable, so that it stays in registers */
        struct sums sums = {{none, none, none}, none, none, none, none, none};

        for (int row = rows.begin; row < rows.end; row++)
            if (b->vec_used[row * VECS + k] > place)
                back_step(b, &s, row * VECS + k, a + slope * rows.dy[row] + rows.c[row], dx,
                          rows.dy[row], (float)place, absolute, &sums);
        add_sums(&sums, dx, absolute, &out);
    }
    return out;
}

/* Two functions, so that the compiler omits the absolute values from the first. */
static struct spin_blend_sums back_signed(struct back *b, const struct ready *r, uint32_t i,
                                          int height, int32_t place)
{
    return back_splat(b, r, i, height, place, false);
}

static struct spin_blend_sums back_absolute(struct back *b, const struct ready *r, uint32_t i,
                                            int height, int32_t place)
{
    return back_splat(b, r, i, height, place, true);
}

static struct spin_blend_sums *slot_of(const struct job *job, const struct place *p, uint32_t splat)
{
    const struct spin_splat2d *s = job->splat2d + splat;
    struct spin_pair_rect r = spin_pair_rect(s);
    size_t row = p->tile_y - (size_t)r.y0, width = (size_t)(r.x1 - r.x0);

    return job->slots + s->first_intersection + row * width + (p->tile_x - (size_t)r.x0);
}

static void back_task(void *context, int tile)
{
    const struct job *job = context;
    struct place p = place_of(job->cam, tile);
    const uint32_t *intersections = job->lists + job->start[tile];
    uint32_t n = job->start[tile + 1] - job->start[tile], end;
    struct ready ready;
    struct back b;

    back_begin(job, &b, &p);
    end = (uint32_t)b.most < n ? (uint32_t)b.most : n;
    for (uint32_t i = end; i < n; i++)
        memset(slot_of(job, &p, intersections[i]), 0, sizeof *job->slots);
    while (end > 0) {
        uint32_t first = (end - 1) / BATCH * BATCH, n_batch = end - first;
        struct spin_blend_sums *slot[BATCH];
        prepare_batch(job->splat2d, &p, intersections + first, n_batch,
                      intersections + first - (first ? BATCH : 0), first ? BATCH : 0, &ready);
        for (uint32_t i = 0; i < n_batch; i++) {
            slot[i] = slot_of(job, &p, intersections[first + i]);
            __builtin_prefetch(slot[i], 1);
        }
        for (uint32_t i = n_batch; i-- > 0;)
            *slot[i] = job->absolute ? back_absolute(&b, &ready, i, p.height, (int32_t)(first + i))
                                     : back_signed(&b, &ready, i, p.height, (int32_t)(first + i));
        end = first;
    }
}

/* Adds up the slots of each splat, and computes the gradient of the splat from these sums. */
static void reduce_task(void *context, size_t first, size_t last)
{
    const struct job *job = context;

    for (size_t i = first; i < last; i++) {
        const struct spin_splat2d *s = job->splat2d + i;
        struct spin_splat2d_grad *d = job->d_splat2d + i;
        uint32_t n = spin_pair_count(spin_pair_rect(s));
        struct spin_blend_sums sum;

        memset(d, 0, sizeof *d);
        if (n == 0)
            continue;
        sum = job->slots[s->first_intersection];
        for (uint32_t k = 1; k < n; k++) {
            const struct spin_blend_sums *more = job->slots + s->first_intersection + k;
            for (int c = 0; c < 3; c++)
                sum.colour[c] += more->colour[c];
            sum.e += more->e;
            sum.ex += more->ex;
            sum.ey += more->ey;
            sum.exx += more->exx;
            sum.exy += more->exy;
            sum.eyy += more->eyy;
            sum.absolute_u += more->absolute_u;
            sum.absolute_v += more->absolute_v;
        }
        spin_blend_finish_adj(s->conic, s->opacity, &sum, &d->u_px, &d->v_px, d->conic,
                              &d->opacity);
        spin_blend_finish_absolute(&sum, &d->absolute_u_px, &d->absolute_v_px);
        memcpy(d->colour, sum.colour, sizeof d->colour);
    }
}

static void blend_view_back(struct spin_device *d, const struct spin_view_of_batch *view,
                            struct job *job)
{
    int n_tiles = view->camera.tiles_x * view->camera.tiles_y;
    size_t slots = (size_t)(job->start[n_tiles] - job->start[0]) + 1;

    job->slots = spin_cpu_scratch_need(d, SPIN_SCRATCH_BLEND, slots * sizeof *job->slots);
    if (!job->slots)
        return;
    spin_pool_run(spin_cpu_pool(d), n_tiles, back_task, job);
    spin_pool_rows(spin_cpu_pool(d), job->n, REDUCE_CHUNK, reduce_task, job);
}

void SPIN_CPU(blend_back)(struct spin_device *d, const struct spin_view_batch *views,
                          const struct spin_splat2d *splat2d, const struct spin_tiles *tiles,
                          const float *final_transmittance, const int32_t *last_contributor,
                          const float *d_image, struct spin_splat2d_grad *d_splat2d)
{
    SPIN_CPU_CLOCK(d, SPIN_OP_BLEND_BACK);

    for (int k = 0; k < views->n_views; k++) {
        const struct spin_view_of_batch *view = &views->view[k];
        struct job job = {.cam = &view->camera,
                          .n = view->n,
                          .splat2d = splat2d + view->first,
                          .lists = tiles->intersections,
                          .start = tiles->start + (size_t)k * (views->max_tiles + 1),
                          .background = views->background,
                          .matte = view->matte,
                          .change = view->background_change,
                          .final_t_in = final_transmittance + (size_t)k * views->max_pixels,
                          .n_used_in = last_contributor + (size_t)k * views->max_pixels,
                          .absolute = views->absolute,
                          .d_image = d_image + (size_t)k * 3 * views->max_pixels,
                          .d_splat2d = d_splat2d + view->first};

        blend_view_back(d, view, &job);
    }
}
