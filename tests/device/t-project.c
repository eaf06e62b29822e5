/* Projection: golden splats and gradients of 3-D parameters, finite differences, the same bits for
 * any number of threads, bad values.
 * K: golden project raster threads */
#include "tests/device/raster.h"

/* Compares columns of the visible splats with the fixture. */
static void check_visible(struct spin_npz *npz, const struct view *v, const char *key, int columns,
                          double (*get)(const struct spin_splat2d *, int), double abs, double rel)
{
    char what[64];
    double *want = check_load(npz, key, NULL), *visible = check_load(npz, "visible", NULL);
    float *got = allocate((size_t)(v->n * columns), sizeof(float));

    for (int i = 0; i < v->n; i++)
        for (int c = 0; c < columns; c++) {
            int k = i * columns + c;
            if (visible[i] == 0)
                want[k] = 0;
            else
                got[k] = (float)get(v->splat2d + i, c);
        }
    snprintf(what, sizeof what, "%s: %s", v->name, key);
    check_close(got, want, (size_t)(v->n * columns), abs, rel, what);
    free(want);
    free(visible);
    free(got);
}

static double get_mean(const struct spin_splat2d *s, int c) { return c ? s->v_px : s->u_px; }
static double get_conic(const struct spin_splat2d *s, int c) { return s->conic[c]; }
static double get_radius(const struct spin_splat2d *s, int c) { return s->radius_px + 0 * c; }
static double get_depth(const struct spin_splat2d *s, int c) { return s->depth + 0.0f * (float)c; }
static double get_colour(const struct spin_splat2d *s, int c) { return s->colour[c]; }
static double get_rect(const struct spin_splat2d *s, int c)
{
    return c == 0 ? s->x0 : c == 1 ? s->y0 : c == 2 ? s->x1 : s->y1;
}

/* For the inverse of a needle's covariance, errors are relative to the largest entry of the
 * matrix. */
static void check_conic(struct spin_npz *npz, const struct view *v, const char *file)
{
    char what[64];
    double *want = check_load(npz, "conic", NULL), *visible = check_load(npz, "visible", NULL);
    double tolerance = check_tolerance(file, "conic_rel", 1e-4), worst = 0;

    for (int i = 0; i < v->n; i++) {
        double size = 0;
        if (visible[i] == 0)
            continue;
        for (int c = 0; c < 3; c++)
            size = larger(size, fabs(want[3 * i + c]));
        for (int c = 0; c < 3; c++)
            worst = larger(worst, fabs(get_conic(v->splat2d + i, c) - want[3 * i + c]) / size);
    }
    snprintf(what, sizeof what, "%s: conic", v->name);
    near(worst, 0, tolerance, what);
    free(want);
    free(visible);
}

static void check_culled(struct spin_npz *npz, const struct view *v)
{
    double *visible = check_load(npz, "visible", NULL);
    int wrong = 0;

    for (int i = 0; i < v->n; i++)
        wrong += (v->splat2d[i].radius_px > 0) != (visible[i] != 0);
    ok(wrong == 0, "%s: the same splats are culled", v->name);
    free(visible);
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

/* Gradients of the 3-D parameters from the fixture's 2-D gradients, so that only the projection is
 * tested; t-blend.c tests the whole rasteriser. */
static void golden_backward(struct spin_device *d, struct spin_npz *npz, struct view *v,
                            double tolerance)
{
    float *mean = check_load_f32(npz, "grad_means2d", NULL);
    float *conic = check_load_f32(npz, "grad_conic", NULL);
    float *colour = check_load_f32(npz, "grad_color", NULL);
    float *opacity = check_load_f32(npz, "grad_opacity", NULL);

    for (int i = 0; i < v->n; i++) {
        struct spin_splat2d_grad *g = v->d_splat2d + i;
        g->u_px = mean[2 * i];
        g->v_px = mean[2 * i + 1];
        memcpy(g->conic, conic + 3 * i, sizeof g->conic);
        memcpy(g->colour, colour + 3 * i, sizeof g->colour);
        g->opacity = opacity[i];
    }
    on_project_back(d, &v->cam, (size_t)v->n, v->pos_w, v->attr, v->degree, v->splat2d,
                    v->d_splat2d, v->d_attr, v->d_pos_w);
    check_columns(npz, v, "grad_means", v->d_pos_w, 3, 0, 3, tolerance);
    check_columns(npz, v, "grad_scales", v->d_attr, SPIN_ATTR, SPIN_ATTR_SCALE, 3, tolerance);
    check_columns(npz, v, "grad_quats", v->d_attr, SPIN_ATTR, SPIN_ATTR_ROTATION, 4, tolerance);
    check_columns(npz, v, "grad_sh", v->d_attr, SPIN_ATTR, SPIN_ATTR_SH, 48, tolerance);
    check_columns(npz, v, "grad_opacity", v->d_attr, SPIN_ATTR, SPIN_ATTR_OPACITY, 1, tolerance);
    free(mean);
    free(conic);
    free(colour);
    free(opacity);
}

static void golden(struct spin_device *d, const char *name)
{
    struct view v;
    struct spin_npz npz;
    char file[32];
    double rel;

    if (!view_load(&v, &npz, name))
        return;
    snprintf(file, sizeof file, "%s.npz", name);
    rel = check_tolerance(file, "projection_rel", 1e-5);
    on_project(d, &v.cam, (size_t)v.n, v.pos_w, v.attr, v.degree, v.splat2d);
    check_culled(&npz, &v);
    /* u, v are sums of terms as large as the image */
    check_visible(&npz, &v, "means2d", 2, get_mean, rel * v.cam.width, rel);
    check_visible(&npz, &v, "depth", 1, get_depth, 1e-6, rel);
    check_visible(&npz, &v, "radius", 1, get_radius, 0, 0);
    check_visible(&npz, &v, "rect", 4, get_rect, 0, 0);
    check_visible(&npz, &v, "color", 3, get_colour, 1e-5, 0);
    check_conic(&npz, &v, file);
    golden_backward(d, &npz, &v, check_tolerance(file, "grad_rel_to_absmax", 2e-4));
    view_free(&v);
    spin_npz_close(&npz);
}

/* A scalar function of the projected splats: fixed random weights on every value that has a
 * gradient. */
static double weighted(const struct view *v, struct spin_splat2d_grad *weights)
{
    double sum = 0;
    uint64_t state = 99;

    for (int i = 0; i < v->n; i++) {
        const struct spin_splat2d *s = v->splat2d + i;
        struct spin_splat2d_grad g = {0};
        g.u_px = random_between(&state, -1, 1);
        g.v_px = random_between(&state, -1, 1);
        for (int c = 0; c < 3; c++) {
            g.conic[c] = 20 * random_between(&state, -1, 1);
            g.colour[c] = random_between(&state, -1, 1);
            sum += (double)g.conic[c] * s->conic[c] + (double)g.colour[c] * s->colour[c];
        }
        g.opacity = random_between(&state, -1, 1);
        sum += (double)g.u_px * s->u_px + (double)g.v_px * s->v_px + (double)g.opacity * s->opacity;
        weights[i] = g;
    }
    return sum;
}

struct group {
    const char *name;
    int at, columns; /* of the attribute row; at < 0: positions */
    float step;
};

/* Moves one splat's parameters of a group along a random direction; for quaternions along the
 * tangent, because activated ones have unit length. */
static void differences_of(struct spin_device *d, struct view *v, const struct group *group)
{
    uint64_t state = 5;
    double worst = 0;

    for (int i = 0; i < v->n; i++) {
        float *p =
            group->at < 0 ? v->pos_w + 3 * i : v->attr + (size_t)SPIN_ATTR * (size_t)i + group->at;
        const float *g = group->at < 0 ? v->d_pos_w + 3 * i
                                       : v->d_attr + (size_t)SPIN_ATTR * (size_t)i + group->at;
        float old[48], dir[48];
        double along = 0, dot = 0, low, high, numeric;
        memcpy(old, p, (size_t)group->columns * sizeof *p);
        for (int k = 0; k < group->columns; k++) {
            dir[k] = random_between(&state, -1, 1);
            if (group->at == SPIN_ATTR_SCALE)
                dir[k] *= old[k];
            dot += dir[k] * old[k];
        }
        if (group->at == SPIN_ATTR_ROTATION)
            for (int k = 0; k < 4; k++)
                dir[k] -= (float)dot * old[k];
        for (int k = 0; k < group->columns; k++)
            along += (double)dir[k] * g[k];
        for (int side = -1; side <= 1; side += 2) {
            double *sum = side < 0 ? &low : &high;
            for (int k = 0; k < group->columns; k++)
                p[k] = old[k] + (float)side * group->step * dir[k];
            on_project(d, &v->cam, (size_t)v->n, v->pos_w, v->attr, v->degree, v->splat2d);
            *sum = weighted(v, v->d_splat2d);
        }
        memcpy(p, old, (size_t)group->columns * sizeof *p);
        numeric = (high - low) / (2 * group->step);
        worst = larger(worst, fabs(numeric - along) / (fabs(along) + 1));
    }
    near(worst, 0, 1e-2, group->name);
}

static void differences(struct spin_device *d, bool antialias)
{
    static const struct group groups[] = {
        {"positions by differences", -1, 3, 2e-3f},
        {"scales by differences", SPIN_ATTR_SCALE, 3, 1e-2f},
        {"rotations by differences", SPIN_ATTR_ROTATION, 4, 1e-2f},
        {"colour by differences", SPIN_ATTR_SH, 48, 1e-2f},
        {"opacity by differences", SPIN_ATTR_OPACITY, 1, 1e-2f},
    };
    struct spin_camera camera = camera_of(96, 80, 90);
    struct view v;

    printf("# %s\n", antialias ? "antialiased, about a pixel large" : "plain");
    view_random(&v, &camera, 12, antialias ? 0.7f : 5, 3);
    v.cam.antialias = antialias;
    for (int i = 0; i < v.n; i++)
        for (int c = 0; c < 3; c++)
            v.attr[SPIN_ATTR * i + SPIN_ATTR_SH + c] = 1; /* keeps all channels away from the
                                                           * clamp */
    on_project(d, &v.cam, (size_t)v.n, v.pos_w, v.attr, v.degree, v.splat2d);
    weighted(&v, v.d_splat2d);
    on_project_back(d, &v.cam, (size_t)v.n, v.pos_w, v.attr, v.degree, v.splat2d, v.d_splat2d,
                    v.d_attr, v.d_pos_w);
    for (size_t g = 0; g < sizeof groups / sizeof groups[0]; g++)
        differences_of(d, &v, groups + g);
    view_free(&v);
}

/* The anti-aliasing factor of round splats in the centre of the view is known: s^2 / (s^2 + 0.3)
 * with s in pixels; all other values are unchanged. */
static void fades(struct spin_device *d)
{
    struct spin_camera camera = camera_of(96, 80, 90);
    struct view plain, faint;
    double worst = 0;
    int same = 1;

    view_random(&plain, &camera, 30, 1, 9);
    view_random(&faint, &camera, 30, 1, 9);
    faint.cam.antialias = true;
    for (int i = 0; i < 30; i++)
        for (int k = 0; k < 3; k++) {
            float size_px = 0.02f * (float)((i + 1) * (i + 1)), z = plain.pos_w[3 * i + 2];

            plain.attr[SPIN_ATTR * i + k] = faint.attr[SPIN_ATTR * i + k] =
                size_px * z / plain.cam.fx;
            if (k < 2)
                plain.pos_w[3 * i + k] = faint.pos_w[3 * i + k] = 0;
        }
    on_project(d, &plain.cam, 30, plain.pos_w, plain.attr, 3, plain.splat2d);
    on_project(d, &faint.cam, 30, faint.pos_w, faint.attr, 3, faint.splat2d);
    for (int i = 0; i < 30; i++) {
        double s = 0.02 * (i + 1) * (i + 1), want = s * s / (s * s + 0.3);

        want = larger(want, 0.005) * (double)plain.splat2d[i].opacity;
        worst = larger(worst, fabs((double)faint.splat2d[i].opacity - want));
        faint.splat2d[i].opacity = plain.splat2d[i].opacity;
        same &= memcmp(&faint.splat2d[i], &plain.splat2d[i], sizeof *plain.splat2d) == 0;
    }
    near(worst, 0, 1e-6, "opacity fades by s^2 / (s^2 + 0.3), to 0.005 at the least");
    ok(same, "nothing else changes");
    view_free(&plain);
    view_free(&faint);
}

/* A splat is drawn if it is beyond the near plane of its camera. */
static void near_planes(struct spin_device *d)
{
    static const double z_near[3] = {0, 0.05, 2};
    static const float depth[4] = {0.04f, 0.1f, 1, 3};

    for (int k = 0; k < 3; k++) {
        struct spin_camera camera = camera_of(96, 80, 90);
        struct view v;

        camera.z_near = z_near[k];
        view_random(&v, &camera, 4, 5, 4);
        for (int i = 0; i < 4; i++) {
            v.pos_w[3 * i] = v.pos_w[3 * i + 1] = 0;
            v.pos_w[3 * i + 2] = depth[i];
        }
        on_project(d, &v.cam, 4, v.pos_w, v.attr, 3, v.splat2d);
        for (int i = 0; i < 4; i++)
            ok((v.splat2d[i].radius_px > 0) ==
                   ((double)depth[i] > (z_near[k] > 0 ? z_near[k] : SPIN_NEAR)),
               "depth %g, near plane %g", (double)depth[i], z_near[k]);
        view_free(&v);
    }
}

/* Splats are processed in blocks: each has the same result as on its own, and gradients are added
 * to the existing values. */
static void alone(struct spin_device *d)
{
    enum { N = 70 };
    struct spin_camera camera = camera_of(96, 80, 90);
    struct view all, one;
    double worst = 0;
    int same = 1;

    view_random(&all, &camera, N, 5, 4);
    view_random(&one, &camera, N, 5, 4);
    all.cam.antialias = one.cam.antialias = true;
    on_project(d, &all.cam, N, all.pos_w, all.attr, 3, all.splat2d);
    weighted(&all, all.d_splat2d);
    for (int twice = 0; twice < 2; twice++)
        on_project_back(d, &all.cam, N, all.pos_w, all.attr, 3, all.splat2d, all.d_splat2d,
                        all.d_attr, all.d_pos_w);
    for (int i = 0; i < N; i++) {
        float *attr = one.attr + SPIN_ATTR * i, *d_attr = one.d_attr + SPIN_ATTR * i;

        on_project(d, &one.cam, 1, one.pos_w + 3 * i, attr, 3, one.splat2d + i);
        on_project_back(d, &one.cam, 1, one.pos_w + 3 * i, attr, 3, one.splat2d + i,
                        all.d_splat2d + i, d_attr, one.d_pos_w + 3 * i);
        for (int k = 0; k < SPIN_ATTR; k++)
            worst = larger(worst, fabs(all.d_attr[SPIN_ATTR * i + k] - 2.0 * d_attr[k]) /
                                      (fabs(d_attr[k]) + 1));
        for (int k = 0; k < 3; k++)
            worst = larger(worst, fabs(all.d_pos_w[3 * i + k] - 2.0 * one.d_pos_w[3 * i + k]) /
                                      (fabs(one.d_pos_w[3 * i + k]) + 1));
        same &= memcmp(&one.splat2d[i], &all.splat2d[i], sizeof *one.splat2d) == 0;
    }
    ok(same, "a splat among others is what it is alone");
    near(worst, 0, 1e-5, "gradients of two views are added");
    view_free(&all);
    view_free(&one);
}

static void same_bits(const char *path)
{
    struct spin_camera camera = camera_of(200, 120, 150);
    struct view one, more;

    for (int n = 1; n <= 8; n = n < 3 ? n + 1 : n + 5) {
        struct view *v = n == 1 ? &one : &more;
        struct spin_device *d = device_of_path(path, n);
        view_random(v, &camera, 3000, 3, 21);
        on_project(d, &v->cam, (size_t)v->n, v->pos_w, v->attr, 3, v->splat2d);
        weighted(v, v->d_splat2d);
        on_project_back(d, &v->cam, (size_t)v->n, v->pos_w, v->attr, 3, v->splat2d, v->d_splat2d,
                        v->d_attr, v->d_pos_w);
        check_device_free(d);
        if (n == 1)
            continue;
        printf("# %s, %d threads\n", path, n);
        check_same_bits(more.splat2d, one.splat2d, 3000 * sizeof *one.splat2d,
                        "records: same bits");
        check_same_bits(more.d_attr, one.d_attr, 3000 * SPIN_ATTR * sizeof(float),
                        "gradients of attributes: same bits");
        check_same_bits(more.d_pos_w, one.d_pos_w, 9000 * sizeof(float),
                        "gradients of positions: same bits");
        view_free(&more);
    }
    view_free(&one);
}

/* With every value of one splat bad in turn: it is culled or harmless, its rectangle stays inside
 * the image, and a culled splat gets no gradient. */
static void bad_numbers(struct spin_device *d)
{
    const float bad[] = {NAN, INFINITY, -INFINITY, 1e30f, -1e30f, 1e-30f, 0, -1};
    struct spin_camera camera = camera_of(64, 48, 55);
    struct view v;
    int wrong = 0, spoiled = 0;

    view_random(&v, &camera, 2, 4, 8);
    for (size_t b = 0; b < sizeof bad / sizeof bad[0]; b++)
        for (int k = 0; k < 3 + SPIN_ATTR; k++) {
            float *p = k < 3 ? v.pos_w + k : v.attr + k - 3, old = *p;
            const struct spin_splat2d *s = v.splat2d;
            *p = bad[b];
            on_project(d, &v.cam, 2, v.pos_w, v.attr, 3, v.splat2d);
            wrong += s->radius_px < 0 || s->x1 > v.cam.tiles_x || s->y1 > v.cam.tiles_y ||
                     (s->radius_px > 0 && !(s->x0 < s->x1 && s->y0 < s->y1));
            wrong += s->radius_px > 0 && !isfinite(s->u_px + s->v_px + s->conic[0] + s->conic[1] +
                                                   s->conic[2] + s->colour[0]);
            weighted(&v, v.d_splat2d);
            memset(v.d_attr, 0, 2 * SPIN_ATTR * sizeof(float));
            memset(v.d_pos_w, 0, 6 * sizeof(float));
            on_project_back(d, &v.cam, 2, v.pos_w, v.attr, 3, v.splat2d, v.d_splat2d, v.d_attr,
                            v.d_pos_w);
            for (int c = 0; c < SPIN_ATTR; c++) {
                spoiled += !isfinite(v.d_attr[SPIN_ATTR + c]);
                spoiled += s->radius_px == 0 && v.d_attr[c] != 0;
            }
            *p = old;
        }
    ok(wrong == 0, "bad numbers are culled, or leave a finite record inside the picture");
    ok(spoiled == 0, "bad numbers do not spoil another splat; culled ones get no gradient");
    view_free(&v);
}

TAP_MAIN
{
    const char **names = check_files("render_");

    for (int i = 0; i < CPU_PATHS; i++) {
        struct spin_device *d = device_of_path(cpu_paths[i], 2);
        if (!d)
            continue;
        printf("# code path %s\n", cpu_paths[i]);
        for (size_t k = 0; names[k]; k++)
            golden(d, names[k]);
        differences(d, false);
        differences(d, true);
        fades(d);
        bad_numbers(d);
        near_planes(d);
        alone(d);
        check_device_free(d);
        same_bits(cpu_paths[i]);
    }
    free(names);
}
