/* Frames refined by spin-retrain have the same bits as the training loop called directly with
 * the frame's splats, its training views and the same options, so no option is lost or changed
 * on the way.
 * K: long refine explicit retrain options */
#include "spin_run.h"
#include "run/run.h"
#include "tests/train/one_frame.h"

#include "base/log.h"
#include "base/number.h"

enum { FRAMES = 2, MOST_VIEWS = 8 };
static const char clip_path[] = "fixtures/court-mini";
static const int held_out[] = {7, 23};
static char in[600], out[600];

static struct spin_retrain_options explicit_options(int iterations)
{
    struct spin_retrain_options o;

    spin_retrain_preset("paper", &o);
    o.precision = SPIN_PRECISION_FULL;
    o.input = in;
    o.output = out;
    o.method = SPIN_METHOD_FRAMES;
    o.refine = iterations;
    o.image_scale = 0.25;
    o.range = (struct spin_range){true, 2, 5, 2};
    o.test_cameras = held_out;
    o.n_test_cameras = 2;
    o.device = "cpu";
    o.n_threads = 2;
    o.force = true;
    return o;
}

static struct one_frame same_options(const struct spin_retrain_options *from, double extent)
{
    struct one_frame o;

    one_frame_defaults(&o, from->refine, extent);
    o.lambda_dssim = from->lambda_dssim;
    o.antialias = from->antialias;
    memcpy(o.background, from->background, sizeof o.background);
    o.learns_exposure = from->learn_exposure == SPIN_EXPOSURE_ON;
    o.rates.exposure = from->lr_exposure;
    o.densify.max_points = (size_t)from->max_points;
    o.densify.seed = from->seed;
    if (from->sh_increase_every > 0)
        o.sh_increase_every = from->sh_increase_every;
    if (!from->densify)
        o.schedule.every = 0;
    return o;
}

/* The training views of a frame, in the order of their cameras, with their images. */
static int take_views(const struct spin_retrain_options *from, struct spin_clip *clip, int frame,
                      struct spin_camera *view, struct spin_image_store *photos)
{
    struct spin_image_cache pixels;
    struct spin_dynamic_mask dynamic = {0};
    struct spin_pair *pairs = NULL;
    size_t n_pairs = 0;
    int n = 0;

    if (spin_image_cache_open(&clip->views, 1 << 24, from->background, &pixels) != SPIN_OK ||
        spin_clip_pairs(clip, SPIN_SPLIT_TRAIN, &pairs, &n_pairs) != SPIN_OK ||
        spin_dynamic_mask_open(&clip->views, &pixels, SPIN_DYNAMIC_AUTO, pairs, n_pairs,
                               &dynamic) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < clip->views.n; i++) {
        const struct spin_view *v = &clip->views.view[i];
        size_t plane = (size_t)v->camera.width * (size_t)v->camera.height, n_dynamic;
        float *photo;
        uint8_t *mask;

        if (v->dataset_frame != clip->dataset_frame[frame] || v->camera_id == held_out[0] ||
            v->camera_id == held_out[1])
            continue;
        photo = malloc(3 * plane * sizeof *photo);
        mask = calloc(plane / 8 + 1, 1);
        if (!photo || !mask || plane > photos->images.max_pixels || n == MOST_VIEWS ||
            spin_image_cache_get(&pixels, i, photo) != SPIN_OK ||
            spin_dynamic_mask_find(&dynamic, i, photo, &n_dynamic) != SPIN_OK)
            exit(1);
        for (size_t k = 0; k < plane; k++)
            mask[k / 8] |= (uint8_t)((dynamic.mask[k] != 0) << k % 8);
        spin_image_store_put(photos, (uint32_t)n, plane, photo, photos->masks ? mask : NULL);
        view[n++] = v->camera;
        free(photo);
        free(mask);
    }
    spin_dynamic_mask_close(&dynamic);
    spin_image_cache_close(&pixels);
    free(pairs);
    return n;
}

static void open_photos(const struct spin_retrain_options *from, const struct spin_clip *clip,
                        struct spin_device *d, struct spin_image_store *photos)
{
    size_t most = 0;

    for (size_t i = 0; i < clip->views.n; i++) {
        const struct spin_camera *c = &clip->views.view[i].camera;
        size_t plane = (size_t)c->width * (size_t)c->height;

        most = plane > most ? plane : most;
    }
    if (spin_image_store_open(photos, d, MOST_VIEWS, most, SPIN_IMAGE_F32,
                              from->dynamic_weight != 1) != SPIN_OK)
        exit(1);
    photos->images.mask_weight[1] = (float)from->dynamic_weight;
}

/* The lens falloff of the run, from the bundle that it wrote. */
static void take_falloff(float falloff[SPIN_EXPOSURE])
{
    struct spin_bundle bundle;
    struct spin_lenses lenses;

    if (spin_bundle_open(out, &bundle) != SPIN_OK ||
        spin_lenses_from_json(spin_json_get(bundle.json, "lenses"), 1, &lenses) != SPIN_OK)
        exit(1);
    if (lenses.n > 0)
        memcpy(falloff, lenses.lens[0].falloff, sizeof lenses.lens[0].falloff);
    spin_lenses_free(&lenses);
    spin_bundle_close(&bundle);
}

/* Splats that no view sees keep the source's values. */
static void take_unseen(const struct spin_splats *s, const struct spin_camera *view, int n,
                        struct spin_refine_cloud *cloud)
{
    struct spin_refine_cloud source = {0};
    size_t unseen = 0;

    if (spin_refine_init_from_splats(s, &source) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < s->n; i++) {
        bool seen = false;
        double at[3];

        for (int k = 0; k < n; k++)
            seen |= spin_camera_project_visible(&view[k], s->means + 3 * i, at);
        if (!seen)
            cloud->point[i].p = source.point[i].p;
        unseen += !seen;
    }
    ok(unseen > 0 && unseen < s->n, "%zu splats are in no training picture", unseen);
    spin_refine_cloud_free(&source);
}

/* Frame `frame` of the clip, refined here. */
static void refine_here(const struct spin_retrain_options *from, struct spin_clip *clip, int frame,
                        struct spin_splats *result)
{
    struct one_frame o = same_options(from, spin_views_extent(&clip->views));
    struct spin_camera view[MOST_VIEWS];
    struct spin_refine_cloud cloud = {0};
    struct spin_splats s = {0};
    struct spin_device *d = check_device(1);
    struct spin_image_store photos;
    float falloff[SPIN_EXPOSURE] = {0};
    int n;

    take_falloff(falloff);
    o.falloff = falloff;
    memset(view, 0, sizeof view);
    open_photos(from, clip, d, &photos);
    n = take_views(from, clip, frame, view, &photos);
    o.densify.frame = clip->bundle.meta.frame[clip->frame[frame]].number;
    if (spin_bundle_frame(&clip->bundle, clip->frame[frame], SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
                          &s) != SPIN_OK)
        exit(1);
    if ((from->refine_start == SPIN_REFINE_FROM_SOURCE
             ? spin_refine_init_from_splats(&s, &cloud)
             : spin_refine_init_from_colours(&s, &cloud)) != SPIN_OK)
        exit(1);
    if (from->refine_start == SPIN_REFINE_FROM_POINTS)
        take_unseen(&s, view, n, &cloud);
    if (spin_sh_degree_reached(from->sh_degree, o.sh_increase_every, o.iterations) > 0 &&
        spin_refine_add_sh(
            spin_sh_degree_reached(from->sh_degree, o.sh_increase_every, o.iterations), NULL,
            &cloud) != SPIN_OK)
        exit(1);
    if (one_frame_run(d, &o, &photos.images, view, n, NULL, &cloud, NULL) != SPIN_OK ||
        spin_refine_to_splats(&cloud, result) != SPIN_OK)
        exit(1);
    ok(n == 6 &&
           (from->max_points == 0 || (result->n > s.n && result->n <= (size_t)from->max_points)),
       "refined here from six views: %zu splats became %zu", s.n, result->n);
    spin_image_store_close(&photos);
    spin_refine_cloud_free(&cloud);
    spin_splats_free(&s);
    check_device_free(d);
}

static bool open_clip(const struct spin_retrain_options *o, struct spin_clip *clip)
{
    struct spin_clip_options c = {.input = o->input,
                                  .range = o->range,
                                  .test_cameras = o->test_cameras,
                                  .n_test_cameras = o->n_test_cameras,
                                  .image_scale = o->image_scale,
                                  .needs_views = true};

    return ok(spin_clip_open(&c, clip) == SPIN_OK && clip->n_frames == FRAMES, "opens the clip");
}

static void compare(const struct spin_retrain_options *o, const char *what)
{
    const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
    struct spin_retrain_report r;
    struct spin_clip clip;
    struct spin_bundle bundle;

    if (!ok(spin_train(o, &r) == SPIN_OK, "%s: refines two frames", what) ||
        spin_bundle_open(out, &bundle) != SPIN_OK) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    if (open_clip(o, &clip))
        for (int f = 0; f < FRAMES; f++) {
            struct spin_splats got = {0}, want = {0};

            refine_here(o, &clip, f, &want);
            if (ok(spin_bundle_refined_frame(&bundle, f, columns, &got) == SPIN_OK &&
                       got.n == want.n,
                   "%s: frame %d has as many splats", what, f)) {
                size_t n = got.n * sizeof(float), side = (size_t)want.sh_degree + 1;

                check_same_bits(got.means, want.means, 3 * n, "places");
                ok(got.sh_degree == want.sh_degree, "SH degree %d", want.sh_degree);
                check_same_bits(got.sh, want.sh, 3 * side * side * n, "colours");
                check_same_bits(got.logit_opacities, want.logit_opacities, n, "opacities");
                check_same_bits(got.log_scales, want.log_scales, 3 * n, "scales");
                check_same_bits(got.quats, want.quats, 4 * n, "rotations");
            }
            spin_splats_free(&got);
            spin_splats_free(&want);
        }
    spin_clip_close(&clip);
    spin_bundle_close(&bundle);
}

/* For a network the colour of a refined frame is clamped to 0 and 1. */
static void compare_colours(void)
{
    struct spin_retrain_options o = explicit_options(5);
    struct spin_retrain_report r;
    struct spin_bundle bundle;
    struct spin_clip clip;
    double worst = 0;

    o.method = SPIN_METHOD_NETWORK;
    o.iterations = 1;
    o.hash_log2 = 10;
    o.residual = SPIN_RESIDUAL_POINTS;
    if (!ok(spin_train(&o, &r) == SPIN_OK && spin_bundle_open(out, &bundle) == SPIN_OK,
            "refines, then a network"))
        return;
    if (open_clip(&o, &clip)) {
        struct spin_splats got = {0}, want = {0};

        refine_here(&o, &clip, 1, &want);
        if (ok(spin_bundle_refined_frame(&bundle, 1, SPIN_COL_MEANS | SPIN_COL_RGB, &got) ==
                       SPIN_OK &&
                   got.n == want.n,
               "as many splats"))
            for (size_t i = 0; i < 3 * got.n; i++) {
                double c = 0.5 + 0.28209479177387814 * (double)want.sh[i];

                worst = larger(worst, fabs(fmin(fmax(c, 0), 1) - (double)got.rgb[i]));
            }
        ok(worst < 1e-6, "the colours of the refined frame (off by %.2g)", worst);
        spin_splats_free(&got);
        spin_splats_free(&want);
    }
    spin_clip_close(&clip);
    spin_bundle_close(&bundle);
}

/* ---- Cache keys */

enum { MOST_KEYS = 32 };
static char keys[MOST_KEYS][40];
static int n_keys;

/* The cache key of the first frame refined with these options; it differs from those of all
 * previous runs. */
static void another_key(struct spin_retrain_options o, const char *what)
{
    struct spin_retrain_report r;
    struct spin_bundle bundle;
    const spin_json *frames;
    const char *key;
    bool new = true;

    if (!ok(spin_train(&o, &r) == SPIN_OK && spin_bundle_open(out, &bundle) == SPIN_OK,
            "refines with another %s", what))
        exit(tap_done());
    frames = spin_json_get(spin_json_get(bundle.json, "refined"), "frames");
    key = spin_json_string(spin_json_get(spin_json_at(frames, 0), "key"));
    for (int i = 0; key && i < n_keys; i++)
        new = new &&strcmp(keys[i], key) != 0;
    if (ok(key && new, "another %s: another key", what))
        snprintf(keys[n_keys++], sizeof keys[0], "%s", key);
    spin_bundle_close(&bundle);
}

/* The key contains everything that affects a refined frame; otherwise outdated frames would be
 * reused. */
static void compare_keys(void)
{
    static const int others[] = {3, 23};
    struct spin_retrain_options base = explicit_options(1), o;
    struct spin_import_options i = {
        .input = clip_path, .from = "d3dgs", .data = clip_path, .positions_only = true};
    char bare[620];

    base.image_scale = 0.1;
    another_key(base, "run");
    o = base, o.refine = 2, another_key(o, "number of iterations");
    o = base, o.seed = 1, another_key(o, "seed");
    o = base, o.background[1] = 0.5f, another_key(o, "background");
    o = base, o.lambda_dssim = 0.3, another_key(o, "weight of SSIM");
    o = base, o.dynamic_weight = 2, another_key(o, "weight of what moves");
    o = base, o.max_points = 9999, another_key(o, "limit of points");
    o = base, o.densify = false, another_key(o, "densification");
    o = base, o.refine_start = SPIN_REFINE_FROM_SOURCE, another_key(o, "start");
    o = base, o.antialias = true, another_key(o, "way to draw");
    o = base, o.learn_exposure = SPIN_EXPOSURE_ON, another_key(o, "colour of the cameras");
    o = base, o.learn_exposure = SPIN_EXPOSURE_ON, o.lr_exposure = 0.1,
    another_key(o, "rate of these colours");
    o = base, o.image_scale = 0.2, another_key(o, "size of the images");
    o = base, o.refine = 3, o.sh_increase_every = 1, another_key(o, "SH degree");
    o = base, o.refine = 3, o.sh_increase_every = 1, o.sh_degree = 1, another_key(o, "limit of it");
    o = base, o.refine = 3, o.sh_increase_every = 2, another_key(o, "pace of SH");
    o = base, o.test_cameras = others, another_key(o, "list of held-out cameras");
    o = base, o.range.first = 1, another_key(o, "frame");
    snprintf(bare, sizeof bare, "%s.bare", in);
    i.output = bare;
    if (!ok(spin_import(&i, NULL) == SPIN_OK, "imports positions alone"))
        return;
    o = base, o.input = bare, another_key(o, "input");
}

TAP_MAIN
{
    struct spin_import_options i = {.input = clip_path, .from = "d3dgs", .data = clip_path};
    struct spin_retrain_options o = explicit_options(136);

    spin_log_set_level(-2);
    snprintf(in, sizeof in, "%s/in.spin", check_folder());
    snprintf(out, sizeof out, "%s/out.spin", check_folder());
    i.output = in;
    if (!ok(spin_import(&i, NULL) == SPIN_OK, "imports the clip"))
        return;
    o.seed = 5;
    o.max_points = 2950;
    o.background[0] = 0.2f;
    o.background[2] = 0.7f;
    o.lambda_dssim = 0.5;
    o.sh_increase_every = 60;
    compare(&o, "from points, with a cap, SH up to degree 2");
    o.refine = 12;
    o.sh_increase_every = 5;
    o.sh_degree = 1;
    o.max_points = 0;
    compare(&o, "SH of degree 1");
    o = explicit_options(136);
    o.densify = false;
    o.refine_start = SPIN_REFINE_FROM_SOURCE;
    o.learn_exposure = SPIN_EXPOSURE_ON;
    o.lr_exposure = 0.03;
    o.antialias = true;
    o.dynamic_weight = 4;
    compare(&o, "from the source, all that goes beyond 3DGS");
    compare_colours();
    compare_keys();
}
