/* Clone, split and prune compared with the reference, whose random numbers are given here.
 * K: golden refine */
#include "train/densify.h"
#include "train/plan.h"
#include "tests/check.h"
#include "tests/tap.h"

struct fixture {
    struct spin_npz npz;
    struct spin_refine_cloud start;
    double *xyz_after, *scale_after, *opacity_after, *source, *pruned;
    size_t n_after, clones, splits, n_pruned;
    double prune_opacity; /* below it, and above every point that must be pruned */
    float *noise;
    size_t n_noise;
};

static size_t marked(struct fixture *f, const char *key)
{
    struct spin_array info;
    double *mask = check_load(&f->npz, key, &info);
    size_t n = 0;

    for (size_t i = 0; i < info.count; i++)
        n += mask[i] != 0;
    free(mask);
    return n;
}

/* An opacity between those of the points that the reference pruned and the others. */
static double between(const struct fixture *f)
{
    double below = 0, above = 1;

    for (size_t i = 0; i < f->n_after; i++) {
        if (f->pruned[i])
            below = larger(below, f->opacity_after[i]);
        else
            above = fmin(above, f->opacity_after[i]);
    }
    return (below + above) / 2;
}

static void load(struct fixture *f)
{
    struct spin_array info;
    double *xyz = check_load(&f->npz, "xyz", &info), *scale = check_load(&f->npz, "scale", NULL);
    double *quat = check_load(&f->npz, "quat", NULL),
           *opacity = check_load(&f->npz, "opacity", NULL);
    double *sum = check_load(&f->npz, "grad_accum", NULL),
           *seen = check_load(&f->npz, "denom", NULL);
    size_t n = (size_t)info.shape[0];

    if (spin_refine_cloud_reserve(&f->start, n) != SPIN_OK)
        exit(1);
    f->start.n = n;
    memset(f->start.point, 0, n * sizeof *f->start.point);
    for (size_t i = 0; i < n; i++) {
        struct spin_refine_point *p = &f->start.point[i];

        for (size_t c = 0; c < 3; c++) {
            p->p.pos_w[c] = (float)xyz[3 * i + c];
            p->p.log_scale[c] = (float)log(scale[3 * i + c]);
            p->p.dc[c] = (float)i; /* marks that identify a point */
            p->m.pos_w[c] = p->v.dc[c] = (float)i + 1;
        }
        for (size_t c = 0; c < 4; c++)
            p->p.rotation[c] = 3 * (float)quat[4 * i + c]; /* any length will do */
        p->p.logit_opacity = (float)log(opacity[i] / (1 - opacity[i]));
        p->gradient = (float)sum[i];
        p->seen = (uint32_t)seen[i];
    }
    f->xyz_after = check_load(&f->npz, "xyz_after", &info);
    f->n_after = (size_t)info.shape[0];
    f->scale_after = check_load(&f->npz, "scale_after", NULL);
    f->opacity_after = check_load(&f->npz, "opacity_after", NULL);
    f->source = check_load(&f->npz, "source", NULL);
    f->pruned = check_load(&f->npz, "prune_opacity", NULL);
    f->noise = check_load_f32(&f->npz, "noise", &info);
    f->n_noise = (size_t)info.shape[0];
    f->clones = marked(f, "clone");
    f->splits = marked(f, "split_after_clone");
    f->n_pruned = marked(f, "prune_opacity");
    f->prune_opacity = check_setting_or("densify.npz", "prune_opacity", between(f));
    free(xyz);
    free(scale);
    free(quat);
    free(opacity);
    free(sum);
    free(seen);
}

static void unload(struct fixture *f)
{
    spin_refine_cloud_free(&f->start);
    free(f->xyz_after);
    free(f->scale_after);
    free(f->opacity_after);
    free(f->source);
    free(f->pruned);
    free(f->noise);
    spin_npz_close(&f->npz);
}

static void given_normals(void *context, int iteration, size_t n, float *out)
{
    struct fixture *f = context;

    (void)iteration;
    if (ok(n == f->n_noise, "asks for %zu normals, two to a split", n))
        memcpy(out, f->noise, n * 3 * sizeof *out);
}

static struct spin_refine_cloud copy_of(const struct spin_refine_cloud *from)
{
    struct spin_refine_cloud c = {0};

    if (spin_refine_cloud_reserve(&c, from->n) != SPIN_OK)
        exit(1);
    memcpy(c.point, from->point, from->n * sizeof *c.point);
    c.n = from->n;
    if (spin_refine_add_sh(2, NULL, &c) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < 3 * SPIN_REFINE_SH * c.n; i++) /* moments are one more than values */
        c.sh[i] = (float)(i / (3 * SPIN_REFINE_SH) + (i / SPIN_REFINE_SH % 3 > 0));
    return c;
}

static struct spin_densify_options options_of(struct fixture *f)
{
    struct spin_densify_options o;

    spin_densify_defaults(&o);
    o.extent = check_setting("densify.npz", "extent");
    o.percent_dense = check_setting("densify.npz", "percent_dense");
    o.gradient_threshold = check_setting("densify.npz", "threshold");
    o.normals = given_normals;
    o.context = f;
    return o;
}

/* Every remaining point, in order, without the rows named in `pruned` (NULL: none), is
 * unchanged. */
static void compare(struct fixture *f, const struct spin_refine_cloud *c, const double *pruned,
                    const char *what)
{
    double abs = check_tolerance("densify.npz", "abs", 1e-6), worst = 0;
    size_t k = 0;
    int origin = 1, moments = 1, statistics = 1, sh = 1;

    for (size_t i = 0; i < f->n_after; i++) {
        const struct spin_refine_point *p = &c->point[k];
        int source = (int)f->source[i];
        int kept = i < f->start.n - f->splits; /* the originals that were not split come first */

        if (pruned && pruned[i])
            continue;
        if (k++ >= c->n)
            break;
        for (size_t j = 0; j < 3; j++) {
            worst = larger(worst, fabs(p->p.pos_w[j] - f->xyz_after[3 * i + j]));
            worst = larger(worst, fabs(exp((double)p->p.log_scale[j]) - f->scale_after[3 * i + j]));
        }
        worst =
            larger(worst, fabs(1 / (1 + exp(-(double)p->p.logit_opacity)) - f->opacity_after[i]));
        origin &= p->p.dc[2] == (float)source;
        moments &= p->m.pos_w[0] == (kept ? (float)source + 1 : 0);
        moments &= p->v.dc[0] == (kept ? (float)source + 1 : 0);
        statistics &= p->gradient == 0 && p->seen == 0;
        for (size_t j = 0; j < 3 * SPIN_REFINE_SH; j++)
            sh &= c->sh[3 * SPIN_REFINE_SH * (k - 1) + j] == (float)(j < SPIN_REFINE_SH ? source
                                                                     : kept             ? source + 1
                                                                                        : 0);
    }
    ok(k == c->n, "%s: %zu points", what, k);
    if (!ok(worst <= abs, "%s: places, scales, opacities as the reference's", what))
        printf("#   off by up to %.3g, allowed %.3g\n", worst, abs);
    ok(origin, "%s: kept, clones, first children, second children, in order", what);
    ok(moments, "%s: kept points keep their moments, new ones have none", what);
    ok(statistics, "%s: statistics start again", what);
    ok(sh, "%s: SH goes along, with its moments", what);
}

static void against_reference(struct fixture *f)
{
    struct spin_densify_options o = options_of(f);
    struct spin_densify_change change;
    struct spin_refine_cloud c = copy_of(&f->start);

    o.prune_opacity = 0;
    ok(spin_densify(&o, 1, &c, &change) == SPIN_OK, "densifies");
    ok(change.clones == f->clones && change.splits == f->splits && change.pruned == 0,
       "%zu clones, %zu splits", f->clones, f->splits);
    compare(f, &c, NULL, "without pruning");
    spin_refine_cloud_free(&c);

    c = copy_of(&f->start);
    o.prune_opacity = f->prune_opacity;
    ok(spin_densify(&o, 1, &c, &change) == SPIN_OK && change.pruned == f->n_pruned,
       "and prunes %zu", f->n_pruned);
    compare(f, &c, f->pruned, "with pruning");
    ok(spin_refine_prune(&c, f->prune_opacity) == 0, "pruning again finds nothing");
    ok(spin_refine_prune(&c, 1) == f->n_after - f->n_pruned && c.n == 0, "all are below opacity 1");
    spin_refine_cloud_free(&c);
}

/* With capacity for two more points, those with the two largest mean gradients win. */
static void capped(struct fixture *f)
{
    struct spin_densify_options o = options_of(f);
    struct spin_densify_change change;
    struct spin_refine_cloud c = copy_of(&f->start);
    double best = 0, second = 0;
    int first_place = -1, second_place = -1, found = 0;
    size_t cap = c.n + 2;

    for (size_t i = 0; i < c.n; i++) {
        double mean = c.point[i].seen ? c.point[i].gradient / c.point[i].seen : 0;

        if (mean > best) {
            second = best, second_place = first_place;
            best = mean, first_place = (int)i;
        } else if (mean > second) {
            second = mean, second_place = (int)i;
        }
    }
    o.normals = NULL;
    o.prune_opacity = 0;
    o.max_points = cap;
    ok(spin_densify(&o, 1, &c, &change) == SPIN_OK && c.n == cap, "a cap of %zu is reached", cap);
    ok(change.clones + change.splits == 2, "of two clones or splits");
    for (size_t i = c.n - 2 * change.splits - change.clones; i < c.n; i++)
        found +=
            c.point[i].p.dc[0] == (float)first_place || c.point[i].p.dc[0] == (float)second_place;
    ok(found == (int)(2 * change.splits + change.clones), "those with the largest gradients");
    ok(spin_densify(&o, 2, &c, &change) == SPIN_OK && c.n == cap && !change.clones &&
           !change.splits,
       "at the cap nothing is added");
    spin_refine_cloud_free(&c);
}

static void own_normals(struct fixture *f)
{
    struct spin_densify_options o = options_of(f);
    struct spin_densify_change change;
    struct spin_refine_cloud a = copy_of(&f->start), b = copy_of(&f->start), c = copy_of(&f->start);
    size_t bytes;

    o.normals = NULL;
    ok(spin_densify(&o, 100, &a, &change) == SPIN_OK &&
           spin_densify(&o, 100, &b, &change) == SPIN_OK,
       "draws its own normals");
    bytes = a.n * sizeof *a.point;
    check_same_bits(a.point, b.point, bytes, "the same ones from the same seed");
    o.frame = 1;
    ok(spin_densify(&o, 100, &c, &change) == SPIN_OK && c.n == a.n &&
           memcmp(a.point, c.point, bytes) != 0,
       "and others in another frame");
    spin_refine_cloud_free(&a);
    spin_refine_cloud_free(&b);
    spin_refine_cloud_free(&c);
}

static void not_finite(struct fixture *f)
{
    struct spin_densify_options o = options_of(f);
    struct spin_densify_change change;
    struct spin_refine_cloud c = copy_of(&f->start);

    o.normals = NULL;
    o.prune_opacity = 0;
    c.point[0].gradient = c.point[2].gradient = 0; /* neither cloned nor split */
    c.point[0].p.pos_w[1] = NAN;
    c.point[2].p.log_scale[0] = INFINITY;
    c.point[3].gradient = NAN;
    c.point[3].seen = 1;
    c.point[4].gradient = 0;
    c.sh[4 * 3 * SPIN_REFINE_SH + SPIN_REFINE_SH - 1] = NAN;
    ok(spin_densify(&o, 1, &c, &change) == SPIN_OK && change.pruned == 3,
       "points that are not finite go, one whose statistics are not stays");
    spin_refine_cloud_free(&c);
}

/* What a cloud of this degree stores, and passes to its copies, of splats with SH degree 1. */
static void check_sh(struct spin_refine_cloud *c, const struct spin_splats *from, int degree)
{
    size_t width = 3 * (size_t)(degree + 1) * (size_t)(degree + 1);
    struct spin_splats out = {0};
    int good = 1;

    ok(spin_refine_add_sh(degree, from, c) == SPIN_OK &&
           spin_refine_to_splats(c, &out) == SPIN_OK && out.sh_degree == degree,
       "SH of degree %d", degree);
    for (size_t i = 0; i < c->n; i++)
        for (size_t k = 0; k < width; k++)
            good &= out.sh[width * i + k] == (from || k < 3 ? k < 12 ? (float)(12 * i + k) : 0 : 0);
    ok(good, "is that of the %s", from ? "splats, and zero beyond" : "colours alone");
    free(c->sh);
    c->sh = NULL;
    spin_splats_free(&out);
}

static void from_splats(void)
{
    float means[6] = {1, 2, 3, 4, 5, 6}, quats[8] = {1, 0, 0, 0, 0, 1, 0, 0};
    float log_scales[6] = {-1, -2, -3, -4, -5, -6}, logits[2] = {0.5f, -0.5f}, sh[24];
    struct spin_splats s = {.n = 2,
                            .sh_degree = 1,
                            .means = means,
                            .quats = quats,
                            .log_scales = log_scales,
                            .logit_opacities = logits};
    struct spin_refine_cloud c = {0};

    for (int i = 0; i < 24; i++)
        sh[i] = (float)i;
    ok(spin_refine_init_from_splats(&s, &c) == SPIN_E_USAGE, "refuses splats without colour");
    s.sh = sh;
    ok(spin_refine_init_from_splats(&s, &c) == SPIN_OK && c.n == 2, "starts from finished splats");
    ok(c.point[1].p.pos_w[2] == 6 && c.point[1].p.dc[0] == 12 && c.point[1].p.dc[2] == 14 &&
           c.point[1].p.logit_opacity == -0.5f && c.point[1].p.log_scale[1] == -5 &&
           c.point[1].p.rotation[1] == 1 && c.point[1].m.dc[0] == 0,
       "with their own attributes");
    check_sh(&c, &s, 1);
    check_sh(&c, &s, 3);
    check_sh(&c, NULL, 2);
    spin_refine_cloud_free(&c);
}

/* The defaults of 3DGS (docs/method.md, section 2). */
static void defaults(void)
{
    struct spin_train_rates r = spin_rates_3dgs(2, 700);
    struct spin_retrain_options o = {.method = SPIN_METHOD_FRAMES, .densify = true};
    const struct spin_plan plan = {.o = &o};
    struct spin_densify_options d;
    struct spin_schedule s;

    ok(r.position == 3.2e-4 && r.position_end == 3.2e-6 && r.residual[SPIN_HEAD_SH] == 2.5e-3 &&
           r.sh == 2.5e-3 / 20 && r.residual[SPIN_HEAD_OPACITY] == 0.05 &&
           r.residual[SPIN_HEAD_SCALE] == 5e-3 && r.residual[SPIN_HEAD_ROTATION] == 1e-3 &&
           r.tracked == 1 && r.iterations == 700,
       "rates of 3DGS, of positions in extents");
    spin_densify_defaults(&d);
    ok(d.gradient_threshold == 2e-4 && d.percent_dense == 0.01 && d.prune_opacity == 0.005 &&
           d.max_points == 0 && d.seed == 0,
       "its densification");
    o.iterations = 40;
    s = spin_plan_schedule(&plan);
    ok(s.first == 8 && s.until == 30 && s.every == 100, "after a fifth, before three quarters");
    o.iterations = 3000;
    s = spin_plan_schedule(&plan);
    ok(s.first == 500 && s.until == 2250, "in a long run after 500 iterations");
    o.densify = false;
    ok(spin_plan_schedule(&plan).every == 0, "or never");
}

/* The two halves of a rotated point: its longest axis, the second, points from y to -x. */
static void check_long_axis(void)
{
    static const float want[2][3] = {{1.6f, 2, 3}, {0.4f, 2, 3}}; /* 0.6 of the longest scale */
    struct spin_densify_options o;
    struct spin_refine_cloud cloud = {0};
    struct spin_densify_change change;
    double off = 0;

    if (spin_refine_cloud_reserve(&cloud, 1) != SPIN_OK)
        exit(1);
    cloud.n = 1;
    memset(cloud.point, 0, sizeof *cloud.point);
    cloud.point[0].gradient = 1;
    cloud.point[0].seen = 1;
    cloud.point[0].p = (struct spin_refine_row){.pos_w = {1, 2, 3},
                                                .log_scale = {logf(0.25f), 0, logf(0.5f)},
                                                .rotation = {1, 0, 0, 1},
                                                .dc = {4, 5, 6},
                                                .logit_opacity = 0};
    spin_densify_defaults(&o);
    o.extent = 1e6; /* small in it: 3DGS would clone */
    o.long_axis = true;
    if (spin_densify(&o, 1, &cloud, &change) != SPIN_OK)
        exit(1);
    ok(cloud.n == 2 && change.splits == 1 && change.clones == 0 && change.pruned == 0,
       "along the longest axis: two halves, of a small one too");
    for (size_t i = 0; i < 2; i++) {
        const struct spin_refine_row *p = &cloud.point[i].p;

        for (int c = 0; c < 3; c++)
            off = larger(off, fabs((double)(p->pos_w[c] - want[i][c])));
        off = larger(off, fabs((double)(p->log_scale[0] - logf(0.25f * 0.85f))));
        off = larger(off, fabs((double)(p->log_scale[1] - logf(0.5f))));
        off = larger(off, fabs((double)(p->log_scale[2] - logf(0.5f * 0.85f))));
        off = larger(off, fabs((double)p->logit_opacity - log(0.3 / 0.7)));
        off = larger(off, fabs((double)(p->dc[0] - 4)));
    }
    ok(off < 1e-6, "where they stand, how large and how opaque they are, to %.2g", off);
    spin_refine_cloud_free(&cloud);
}

TAP_MAIN
{
    struct fixture f = {0};
    const char *path = check_fixture("core/densify.npz");

    defaults();
    from_splats();
    if (!path) {
        skip("densify", "no fixture core/densify.npz");
        return;
    }
    if (!ok(spin_npz_open(path, &f.npz) == SPIN_OK, "opens densify.npz"))
        return;
    load(&f);
    against_reference(&f);
    capped(&f);
    own_normals(&f);
    not_finite(&f);
    unload(&f);
    check_long_axis();
}
