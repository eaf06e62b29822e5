/* Blending: golden images and gradients of the whole rasteriser, the formulas of math/blend.h pixel
 * by pixel, finite differences, the same bits for any number of threads, bad values.
 * K: golden blend raster threads */
#include "math/blend.h"
#include "math/project.h"
#include "tests/device/raster.h"

/* Skips pixels that are within rounding of a threshold, as marked in the fixture. */
static void check_image(struct spin_npz *npz, const struct view *v, const char *key,
                        const float *from, int planes, double tolerance)
{
    char what[64];
    size_t pixels = view_pixels(v);
    double *want = check_load(npz, key, NULL), *fine = check_load(npz, "pixel_ok", NULL);
    float *got = allocate((size_t)planes * pixels, sizeof(float));

    memcpy(got, from, (size_t)planes * pixels * sizeof(float));
    for (size_t i = 0; i < (size_t)planes * pixels; i++)
        if (fine[i % pixels] == 0)
            got[i] = (float)(want[i] = 0);
    snprintf(what, sizeof what, "%s: %s", v->name, key);
    check_close(got, want, (size_t)planes * pixels, tolerance, 0, what);
    free(want);
    free(fine);
    free(got);
}

static void check_columns(struct spin_npz *npz, const struct view *v, const char *key,
                          const float *from, int stride, int at, int columns, double tolerance)
{
    char what[64];
    double *want = check_load(npz, key, NULL);
    float *got = columns_of(from, stride, at, v->n, columns);

    snprintf(what, sizeof what, "%s: %s", v->name, key);
    check_rel_to_absmax(got, want, (size_t)(v->n * columns), tolerance, what);
    free(want);
    free(got);
}

static void golden(struct spin_device *d, const char *name)
{
    enum { GRAD = sizeof(struct spin_splat2d_grad) / sizeof(float) };
    struct view v;
    struct spin_npz npz;
    char file[32];
    double abs, rel;
    const float *g;

    if (!view_load(&v, &npz, name))
        return;
    snprintf(file, sizeof file, "%s.npz", name);
    abs = check_tolerance(file, "image_abs", 2e-5);
    rel = check_tolerance(file, "grad_rel_to_absmax", 2e-4);
    view_forward(d, &v);
    check_image(&npz, &v, "image", v.image, 3, abs);
    check_image(&npz, &v, "final_T", v.final_transmittance, 1, abs);
    view_backward(d, &v);
    g = &v.d_splat2d->u_px;
    check_columns(&npz, &v, "grad_means2d", g, GRAD, 0, 2, rel);
    check_columns(&npz, &v, "grad_conic", g, GRAD, 2, 3, rel);
    check_columns(&npz, &v, "grad_color", g, GRAD, 6, 3, rel);
    check_columns(&npz, &v, "grad_opacity", g, GRAD, 5, 1, rel);
    check_columns(&npz, &v, "grad_means", v.d_pos_w, 3, 0, 3, rel);
    check_columns(&npz, &v, "grad_scales", v.d_attr, SPIN_ATTR, SPIN_ATTR_SCALE, 3, rel);
    check_columns(&npz, &v, "grad_quats", v.d_attr, SPIN_ATTR, SPIN_ATTR_ROTATION, 4, rel);
    check_columns(&npz, &v, "grad_sh", v.d_attr, SPIN_ATTR, SPIN_ATTR_SH, 48, rel);
    view_free(&v);
    spin_npz_close(&npz);
}

/* Reference: every pixel processes its tile's list by the scalar formulas, forward and backward. */
static void plain(const struct view *v, float *image, struct spin_blend_sums *sums)
{
    size_t pixels = view_pixels(v);

    for (size_t at = 0; at < pixels; at++) {
        int px = (int)(at % (size_t)v->cam.width), py = (int)(at / (size_t)v->cam.width);
        int tile = py / SPIN_TILE * v->cam.tiles_x + px / SPIN_TILE;
        const uint32_t *intersections = v->tiles.intersections + v->tiles.start[tile];
        int n = (int)(v->tiles.start[tile + 1] - v->tiles.start[tile]);
        char *added = allocate((size_t)n, 1);
        struct spin_blend_pixel pixel = {1, {0, 0, 0}, 0};
        struct spin_blend_pixel_adj back = {0, 0, {0, 0, 0}};
        for (int i = 0; i < n; i++) {
            const struct spin_splat2d *s = v->splat2d + intersections[i];
            struct spin_blend_splat b =
                spin_blend_prepare(s->u_px, s->v_px, s->conic, s->opacity, s->colour);
            added[i] = (char)spin_blend_step(&b, s->u_px - (float)px, s->v_px - (float)py, &pixel);
        }
        back.t = pixel.t;
        for (int c = 0; c < 3; c++) {
            size_t k = (size_t)c * pixels + at;
            bool known = with_matte.matte && with_matte.matte[at];
            float background = v->background[c] + (known ? with_matte.change[c] : 0);

            image[k] = pixel.colour[c] + pixel.t * background;
            back.g[c] = v->d_image[k];
            back.s += pixel.t * background * back.g[c];
        }
        for (int i = n - 1; i >= 0; i--) {
            const struct spin_splat2d *s = v->splat2d + intersections[i];
            struct spin_blend_splat b =
                spin_blend_prepare(s->u_px, s->v_px, s->conic, s->opacity, s->colour);
            if (added[i])
                spin_blend_step_adj(&b, s->u_px - (float)px, s->v_px - (float)py, &back,
                                    sums + intersections[i]);
        }
        free(added);
    }
}

static double most(double so_far, double got, double want)
{
    return larger(so_far, fabs(got - want));
}

/* Compares the vectorised code with the scalar formulas. A pixel within rounding of a threshold may
 * fall on either side: at most a few do, and each differs by at most the threshold (1/255). */
static void against_plain(struct spin_device *d, int n, float size_px, const char *what)
{
    struct spin_camera camera = camera_of(150, 90, 120);
    struct view v;
    size_t values, off = 0;
    float *image;
    struct spin_blend_sums *sums;
    double worst = 0, grads[5] = {0}, size[5] = {0};
    struct spin_splat2d_grad *without = allocate((size_t)n, sizeof *without);
    size_t changed = 0;

    view_random(&v, &camera, n, size_px, 4);
    values = 3 * view_pixels(&v);
    image = allocate(values, sizeof *image);
    sums = allocate((size_t)n, sizeof *sums);
    view_forward(d, &v);
    plain(&v, image, sums);
    for (size_t i = 0; i < values; i++) {
        worst = most(worst, v.image[i], image[i]);
        off += !(fabsf(v.image[i] - image[i]) <= 1e-5f);
    }
    ok(worst < 0.004 && off <= 9, "%s: as the plain loop (%.2g at most, %zu values over 1e-5)",
       what, worst, off);
    view_backward(d, &v);
    memcpy(without, v.d_splat2d, (size_t)n * sizeof *without);
    with_absolute = true;
    view_backward(d, &v);
    with_absolute = false;
    for (int i = 0; i < n; i++) {
        const struct spin_splat2d_grad *g = v.d_splat2d + i;
        float du, dv, dc[3], dop, au, av;
        const struct spin_splat2d *s = v.splat2d + i;
        spin_blend_finish_adj(s->conic, s->opacity, sums + i, &du, &dv, dc, &dop);
        spin_blend_finish_absolute(sums + i, &au, &av);
        grads[4] = most(most(grads[4], g->absolute_u_px, au), g->absolute_v_px, av);
        size[4] = most(most(size[4], au, 0), av, 0);
        changed += memcmp(g, without + i, offsetof(struct spin_splat2d_grad, absolute_u_px)) != 0;
        changed += without[i].absolute_u_px != 0 || without[i].absolute_v_px != 0;
        changed += au < fabsf(du) * 0.999f || av < fabsf(dv) * 0.999f;
        grads[0] = most(most(grads[0], g->u_px, du), g->v_px, dv);
        size[0] = most(most(size[0], du, 0), dv, 0);
        grads[1] = most(grads[1], g->opacity, dop);
        size[1] = most(size[1], dop, 0);
        for (int c = 0; c < 3; c++) {
            grads[2] = most(grads[2], g->conic[c], dc[c]);
            size[2] = most(size[2], dc[c], 0);
            grads[3] = most(grads[3], g->colour[c], sums[i].colour[c]);
            size[3] = most(size[3], sums[i].colour[c], 0);
        }
    }
    /* sums over up to all pixels of the image in a different order, and the few pixels above */
    near(grads[0] / size[0], 0, 2e-3, "  gradient of the mean");
    near(grads[1] / size[1], 0, 2e-3, "  gradient of the opacity");
    near(grads[4] / size[4], 0, 2e-3, "  absolute gradient of the mean");
    ok(changed == 0, "  which changes no other gradient, and is 0 unless asked for: %zu", changed);
    free(without);
    near(grads[2] / size[2], 0, 2e-3, "  gradient of the conic");
    near(grads[3] / size[3], 0, 2e-3, "  gradient of the colour");
    free(image);
    free(sums);
    view_free(&v);
}

/* Pixels of known alpha have another background. */
static void mattes(struct spin_device *d)
{
    enum { PIXELS = 150 * 90 };
    static uint8_t matte[PIXELS];
    struct spin_camera camera = camera_of(150, 90, 120);
    struct view v;
    float *before = allocate(3 * PIXELS, sizeof *before);
    size_t n_same = 0, n_unknown = 0;

    for (int i = 0; i < PIXELS; i++)
        matte[i] = (uint8_t)(i % 3 ? i % 255 : 0);
    view_random(&v, &camera, 100, 12, 4);
    view_forward(d, &v);
    memcpy(before, v.image, 3 * PIXELS * sizeof *before);
    with_matte.matte = matte;
    with_matte.change[0] = 0.8f;
    with_matte.change[1] = -0.3f;
    view_forward(d, &v);
    for (size_t i = 0; i < PIXELS; i++) {
        n_unknown += !matte[i];
        n_same += !matte[i] && v.image[i] == before[i];
    }
    ok(n_unknown >= PIXELS / 3 && n_same == n_unknown, "pixels of unknown alpha stay the same");
    against_plain(d, 400, 12, "a matte");
    memset(&with_matte, 0, sizeof with_matte);
    free(before);
    view_free(&v);
}

/* The median depth of a pixel, computed differently: with the alphas in double. */
static double median_at(const struct view *v, int px, int py, double *edge)
{
    int tile = py / SPIN_TILE * v->cam.tiles_x + px / SPIN_TILE;
    double t = 1;

    *edge = 1;
    for (uint32_t k = v->tiles.start[tile]; k < v->tiles.start[tile + 1]; k++) {
        const struct spin_splat2d *s = v->splat2d + v->tiles.intersections[k];
        double dx = (double)s->u_px - px, dy = (double)s->v_px - py;
        double e = 0.5 * ((double)s->conic[0] * dx * dx + (double)s->conic[2] * dy * dy) +
                   (double)s->conic[1] * dx * dy;
        double alpha = fmin(0.99, (double)s->opacity * exp(-e));

        if (e < 0 || alpha < 1 / 255.0)
            continue;
        t *= 1 - alpha;
        *edge = fmin(*edge, fabs(t - 0.5));
        if (t <= 0.5)
            return (double)s->depth;
    }
    return 0;
}

/* Expected depth is the image of splats whose colour is their depth, divided by that of white
 * splats. */
static void depths(struct spin_device *d)
{
    struct spin_camera camera = camera_of(150, 90, 120);
    float black[3] = {0}, *depth, *image;
    int n = 60, n_seen = 0, n_median = 0, n_beyond = 0;
    double worst = 0, off = 0, edge, least = 1e9, farthest = 0;
    struct spin_splat2d *as_colour;
    struct view v;
    size_t pixels;

    view_random(&v, &camera, n, 8, 4);
    pixels = view_pixels(&v);
    depth = allocate(2 * pixels, sizeof *depth);
    image = allocate(3 * pixels, sizeof *image);
    as_colour = allocate((size_t)n, sizeof *as_colour);
    view_forward(d, &v);
    memcpy(as_colour, v.splat2d, (size_t)n * sizeof *as_colour);
    for (int i = 0; i < n; i++) {
        as_colour[i].colour[0] = as_colour[i].depth;
        as_colour[i].colour[1] = 1;
        if (as_colour[i].radius_px > 0) {
            least = fmin(least, (double)as_colour[i].depth);
            farthest = larger(farthest, (double)as_colour[i].depth);
        }
    }
    on_blend(d, &v.cam, (size_t)n, as_colour, &v.tiles, black, image, v.final_transmittance,
             v.last_contributor);
    on_depth(d, &v.cam, (size_t)n, v.splat2d, &v.tiles, depth);
    for (size_t i = 0; i < pixels; i++) {
        double want = image[pixels + i] > 0 ? (double)image[i] / (double)image[pixels + i] : 0;
        double median = median_at(&v, (int)(i % 150), (int)(i / 150), &edge);

        worst = most(worst, depth[i], want);
        n_seen += want > 0;
        n_beyond +=
            want > 0 && ((double)depth[i] < least - 1e-4 || (double)depth[i] > farthest + 1e-4);
        off += edge > 1e-4 && !(fabs((double)depth[pixels + i] - median) <= 1e-6);
        n_median += median > 0;
    }
    ok(n_seen > 5000 && n_seen < (int)pixels && n_median > 500 && n_median < n_seen,
       "a picture with all kinds of pixels: %d, %d of %zu", n_seen, n_median, pixels);
    ok(worst < 2e-3, "the expected depth is the mean of the depths by their weights (%g)", worst);
    ok(n_beyond == 0, "and between the least and the largest");
    ok(off <= 3, "the median is the depth at which half of the light is held up (%g off)", off);
    free(depth);
    free(image);
    free(as_colour);
    view_free(&v);
}

static double picture_sum(struct spin_device *d, struct view *v)
{
    double sum = 0;

    view_forward(d, v);
    for (size_t i = 0; i < 3 * view_pixels(v); i++)
        sum += (double)v->d_image[i] * v->image[i];
    return sum;
}

/* The whole rasteriser, one group of parameters at a time, along a random direction. Few large,
 * faint splats with the centre of the image as upstream gradient: no relevant alpha is near 0.99 or
 * 1/255, no colour is clamped, and nothing is near the edge of a tile rectangle. */
static void differences(struct spin_device *d)
{
    static const struct {
        const char *name;
        int at, columns;
        float step;
    } groups[] = {{"positions by differences", -1, 3, 4e-3f},
                  {"scales by differences", SPIN_ATTR_SCALE, 3, 1e-2f},
                  {"rotations by differences", SPIN_ATTR_ROTATION, 4, 1e-2f},
                  {"colour by differences", SPIN_ATTR_SH, 48, 5e-2f},
                  {"opacity by differences", SPIN_ATTR_OPACITY, 1, 1e-2f}};
    struct spin_camera camera = camera_of(48, 48, 60);
    struct view v;

    view_random(&v, &camera, 6, 20, 12);
    for (int i = 0; i < v.n; i++) {
        float *a = v.attr + SPIN_ATTR * i;
        v.pos_w[3 * i] *= 0.2f;
        v.pos_w[3 * i + 1] *= 0.2f;
        a[SPIN_ATTR_OPACITY] = 0.3f + 0.05f * (float)i;
        for (int c = 0; c < 3; c++)
            a[SPIN_ATTR_SH + c] = 1 + 0.1f * (float)(c + i);
    }
    for (size_t i = 0; i < 3 * view_pixels(&v); i++) {
        int x = (int)(i % 48), y = (int)(i / 48 % 48);
        float r2 = (float)((x - 24) * (x - 24) + (y - 24) * (y - 24));
        v.d_image[i] *= expf(-r2 / 40);
        if (r2 > 200)
            v.d_image[i] = 0;
    }
    for (size_t g = 0; g < sizeof groups / sizeof groups[0]; g++) {
        int at = groups[g].at, columns = groups[g].columns, stride = at < 0 ? 3 : SPIN_ATTR;
        float *p = at < 0 ? v.pos_w : v.attr + at, *slope = at < 0 ? v.d_pos_w : v.d_attr + at;
        size_t all = (size_t)v.n * (size_t)stride - (size_t)(at < 0 ? 0 : at);
        float *old = allocate(all, sizeof(float)), *dir = allocate(all, sizeof(float));
        double along = 0, low, high;
        uint64_t state = 77;
        memcpy(old, p, all * sizeof(float));
        for (int i = 0; i < v.n; i++) {
            float dot = 0, *q = dir + i * stride;
            for (int k = 0; k < columns; k++) {
                q[k] = random_between(&state, -1, 1);
                dot += q[k] * old[i * stride + k];
            }
            for (int k = 0; k < columns && at == SPIN_ATTR_ROTATION; k++)
                q[k] -= dot * old[i * stride + k];
        }
        picture_sum(d, &v);
        view_backward(d, &v);
        for (int i = 0; i < v.n; i++)
            for (int k = 0; k < columns; k++)
                along += (double)dir[i * stride + k] * slope[i * stride + k];
        for (int i = 0; i < v.n; i++)
            for (int k = 0; k < columns; k++)
                p[i * stride + k] = old[i * stride + k] + groups[g].step * dir[i * stride + k];
        high = picture_sum(d, &v);
        for (int i = 0; i < v.n; i++)
            for (int k = 0; k < columns; k++)
                p[i * stride + k] = old[i * stride + k] - groups[g].step * dir[i * stride + k];
        low = picture_sum(d, &v);
        memcpy(p, old, all * sizeof(float));
        near(along, (high - low) / (2 * groups[g].step), 1e-2 * fabs(along) + 1e-3, groups[g].name);
        free(old);
        free(dir);
    }
    view_free(&v);
}

static void same_bits(const char *path)
{
    struct spin_camera camera = camera_of(211, 135, 170);
    struct view one, more;

    for (int n = 1; n <= (check_device_is_cpu() ? 8 : 2); n = n < 3 ? n + 1 : n + 5) {
        struct view *v = n == 1 ? &one : &more;
        struct spin_device *d = device_of_path(path, n);
        view_random(v, &camera, 3000, 5, 50);
        view_forward(d, v);
        view_backward(d, v);
        check_device_free(d);
        if (n == 1)
            continue;
        printf("# %s, %d threads\n", path, n);
        check_same_bits(more.image, one.image, 3 * view_pixels(v) * sizeof(float), "same image");
        check_same_bits(more.last_contributor, one.last_contributor,
                        view_pixels(v) * sizeof(int32_t), "same n_used");
        check_same_bits(more.d_splat2d, one.d_splat2d, 3000 * sizeof *one.d_splat2d,
                        "same gradients");
        check_same_bits(more.d_attr, one.d_attr, 3000 * SPIN_ATTR * sizeof(float),
                        "same gradients of attributes");
        view_free(&more);
    }
    view_free(&one);
}

/* One bad splat among good ones, with every value bad in turn: the image and the other splats'
 * gradients stay finite. */
static void bad_numbers(struct spin_device *d)
{
    const float bad[] = {NAN, INFINITY, -INFINITY, 1e30f, -1e30f, 1e-30f, 0};
    struct spin_camera camera = camera_of(40, 30, 40);
    struct view v;
    int spoiled = 0;

    view_random(&v, &camera, 6, 6, 9);
    for (size_t b = 0; b < sizeof bad / sizeof bad[0]; b++)
        for (int k = 0; k < 3 + SPIN_ATTR; k++) {
            float *p = k < 3 ? v.pos_w + k : v.attr + k - 3, old = *p;
            *p = bad[b];
            view_forward(d, &v);
            view_backward(d, &v);
            for (size_t i = 0; i < 3 * view_pixels(&v); i++)
                spoiled += !isfinite(v.image[i]);
            for (int i = SPIN_ATTR; i < v.n * SPIN_ATTR; i++)
                spoiled += !isfinite(v.d_attr[i]);
            *p = old;
        }
    ok(spoiled == 0, "bad numbers in one splat leave the picture and the others finite");
    memset(v.attr + SPIN_ATTR_ROTATION, 0, 4 * sizeof(float));
    view_forward(d, &v);
    view_backward(d, &v);
    for (int i = 0; i < v.n * SPIN_ATTR; i++)
        spoiled += !isfinite(v.d_attr[i]);
    ok(spoiled == 0, "a zero quaternion is harmless");
    view_free(&v);
}

/* Opaque splats: alpha is capped at 0.99, and a splat is not added if transmittance would fall
 * below 1e-4. */
static void cap_and_stop(struct spin_device *d)
{
    struct spin_camera camera = camera_of(17, 17, 20);
    struct view v;

    view_random(&v, &camera, 4, 500, 1);
    for (int i = 0; i < 4; i++) {
        v.pos_w[3 * i] = v.pos_w[3 * i + 1] = 0;
        v.pos_w[3 * i + 2] = (float)(2 + i);
        v.attr[SPIN_ATTR * i + SPIN_ATTR_OPACITY] = 1;
    }
    view_forward(d, &v);
    near(v.final_transmittance[8 * 17 + 8], 1e-2, 1e-6,
         "alpha is capped, and the splat that would end below 1e-4 is left out");
    ok(v.last_contributor[8 * 17 + 8] == 1, "n_used is one past the last that was added");
    view_free(&v);
}

TAP_MAIN
{
    const char **names = check_files("render_");

    ok(spin_blend_counts(-0.01f, -1) && !spin_blend_counts(0.01f, -1),
       "a power above 0, which is of rounding, does not count");
    for (int i = 0; i < CPU_PATHS; i++) {
        struct spin_device *d = device_of_path(cpu_paths[i], 2);
        if (!d)
            continue;
        printf("# code path %s\n", cpu_paths[i]);
        for (size_t k = 0; names[k]; k++)
            golden(d, names[k]);
        against_plain(d, 2000, 2, "small splats");
        against_plain(d, 150, 40, "large splats");
        against_plain(d, 600, 40, "more in a tile than any device takes at once");
        mattes(d);
        depths(d);
        differences(d);
        cap_and_stop(d);
        bad_numbers(d);
        check_device_free(d);
        same_bits(cpu_paths[i]);
    }
    free(names);
}
