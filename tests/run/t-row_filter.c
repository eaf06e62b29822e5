/* Which rows an export drops, and for which reason. K: export rows threads filters */
#include "base/log.h"
#include "run/row_filter.h"
#include "tests/check.h"
#include "tests/exporters/frame.h"

/* A clip of one frame, number 4, without views. */
static struct spin_clip *one_frame(void)
{
    static struct spin_frame_info info = {.number = 4};
    static int index[1] = {0}, none[1] = {-1};
    static struct spin_clip clip;

    clip.n_frames = 1;
    clip.frame = index;
    clip.dataset_frame = none;
    clip.bundle.meta.frame = &info;
    return &clip;
}

static struct spin_row_filter open_filter(const struct spin_export_options *o, bool renders)
{
    struct spin_row_filter f = {0};

    ok(spin_row_filter_open(&f, o, one_frame(), renders) == SPIN_OK, "opens the filter");
    return f;
}

/* Six rows that cannot be drawn and one with a saturated opacity, of at least eight. */
static void spoil_frame(struct spin_splats *s)
{
    s->means[3 * 1] = NAN;
    s->log_scales[3 * 2 + 1] = INFINITY;
    s->log_scales[3 * 3 + 2] = 60;
    memset(s->quats + 4 * 4, 0, 4 * sizeof(float));
    s->logit_opacities[5] = NAN;
    s->sh[3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1)) * 6 + 1] = -INFINITY;
    s->logit_opacities[7] = INFINITY;
}

static size_t n_left(struct spin_row_filter *f, const struct spin_splats *s)
{
    const struct spin_splats *left = s;

    return spin_row_filter_frame(f, 0, &left) == SPIN_OK ? left->n : SIZE_MAX;
}

static char warned[300];

static bool keep_warning(const char *line)
{
    snprintf(warned, sizeof warned, "%s", line);
    return true;
}

static void test_reasons(void)
{
    struct spin_export_options o = {.n_threads = 1};
    struct spin_row_filter f = open_filter(&o, false);
    struct spin_splats s = {0};
    const struct spin_splats *left = &s;

    make_frame(&s, 20000, 1, 3);
    ok(spin_row_filter_frame(&f, 0, &left) == SPIN_OK && left == &s,
       "a frame of which all rows remain is not copied");
    spin_row_filter_restart(&f);
    spoil_frame(&s);
    s.log_scales[3 * 9000 + 2] = 2.7f; /* exp(2.7) is 14.9, the diagonal 13.8 */
    s.log_scales[3 * 9001 + 2] = 2.5f;
    s.logit_opacities[9002] = NAN;
    spin_log_set_sink(keep_warning);
    spin_log_set_level(-1);
    ok(spin_row_filter_frame(&f, 0, &left) == SPIN_OK && left != &s && left->n == s.n - 8,
       "drops eight rows");
    ok(strstr(warned, "frame 4: 8 of 20000 splats left out: 5 with NaN or infinity, 1 with a "
                      "rotation of length zero, 2 larger than the scene") != NULL,
       "warns with the number of the frame: %s", warned);
    spin_log_set_level(-2);
    spin_log_set_sink(NULL);
    ok(f.n_by[SPIN_ROW_NOT_FINITE] == 5 && f.n_by[SPIN_ROW_NO_ROTATION] == 1 &&
           f.n_by[SPIN_ROW_TOO_LARGE] == 2 && f.n_by[SPIN_ROW_KEPT] == s.n - 8,
       "counts each under its reason");
    ok(spin_row_filter_n_undrawable(&f) == 8 && spin_row_filter_n_filtered(&f) == 0,
       "none of them by an option");
    ok(!f.reason[0] && f.reason[1] && !f.reason[7] && f.reason[9000] && !f.reason[9001],
       "keeps an infinite logit, and a large splat within the scene");
    ok(memcmp(left->means + 3, s.means + 3 * 7, 3 * sizeof(float)) == 0,
       "the remaining rows stay in order");
    spin_row_filter_close(&f);
    spin_splats_free(&s);
}

static void test_limits(void)
{
    struct spin_export_options o = {.n_threads = 1, .max_scale = INFINITY};
    struct spin_row_filter f = open_filter(&o, false);
    struct spin_splats s = {0};

    make_frame(&s, 100, 0, 3);
    s.log_scales[3] = 40;
    ok(n_left(&f, &s) == 100, "--max-scale 0: no limit");
    s.log_scales[3] = 45;
    ok(n_left(&f, &s) == 99, "but that of float");
    spin_row_filter_close(&f);
    o.max_scale = 0.5;
    f = open_filter(&o, true);
    s.log_scales[3] = 2.1f;
    ok(n_left(&f, &s) == 99, "--max-scale 0.5, rendered or not");
    spin_row_filter_close(&f);
    o.max_scale = 0;
    f = open_filter(&o, true);
    s.log_scales[3] = 5;
    ok(n_left(&f, &s) == 100, "renderers have no limit by default");
    spin_row_filter_close(&f);
    f = open_filter(&o, false);
    make_frame(&s, 7, 0, 3);
    s.log_scales[3] = 5;
    ok(n_left(&f, &s) == 7, "seven positions do not measure the scene");
    make_frame(&s, 50, 0, 3);
    for (size_t i = 0; i < 150; i++)
        s.means[i] = 2;
    s.log_scales[3] = 5;
    ok(n_left(&f, &s) == 50, "nor does one position");
    s.means[0] = 3e38f;
    s.means[3] = -3e38f;
    ok(n_left(&f, &s) == 50, "positions near the limits of float do not overflow");
    make_frame(&s, 0, 0, 3);
    ok(n_left(&f, &s) == 0, "an empty frame");
    spin_row_filter_close(&f);
    spin_splats_free(&s);
}

/* The first reason of the enum counts: outside the crop, NaN, faint. */
static void test_order(void)
{
    struct spin_export_options o = {
        .n_threads = 1, .n_crop = 6, .crop = {-9, -9, -9, 0, 9, 9}, .min_opacity = 0.5};
    struct spin_row_filter f = open_filter(&o, false);
    struct spin_splats s = {0};
    uint64_t n_out = 0, n_faint = 0;

    make_frame(&s, 1000, 0, 5);
    for (size_t i = 0; i < s.n; i++) {
        bool out = s.means[3 * i] > 0;

        if (i % 10 == 0)
            s.logit_opacities[i] = NAN;
        n_out += out;
        n_faint += !out && i % 10 != 0 && s.logit_opacities[i] < 0;
    }
    s.means[3] = NAN; /* not outside of anything */
    ok(n_left(&f, &s) < 500, "a crop, NaN and --min-opacity at once");
    ok(f.n_by[SPIN_ROW_CROP] <= n_out && f.n_by[SPIN_ROW_CROP] + 1 >= n_out &&
           f.reason[1] == SPIN_ROW_NOT_FINITE,
       "--crop judges finite positions, before all else");
    ok(f.n_by[SPIN_ROW_MIN_OPACITY] <= n_faint && f.n_by[SPIN_ROW_MIN_OPACITY] + 1 >= n_faint,
       "--min-opacity comes last");
    ok(spin_row_filter_n_filtered(&f) == f.n_by[SPIN_ROW_CROP] + f.n_by[SPIN_ROW_MIN_OPACITY],
       "both are options");
    spin_row_filter_close(&f);
    spin_splats_free(&s);
}

/* A frame of positions between -1 and 1, judged with these options; returns the filter. */
static struct spin_row_filter filter_frame(const struct spin_export_options *o,
                                           struct spin_splats *s)
{
    struct spin_row_filter f = open_filter(o, true);

    make_frame(s, 2000, 0, 11);
    for (size_t i = 0; i < 3 * s->n; i++)
        s->means[i] /= 4;
    ok(n_left(&f, s) < s->n, "drops some rows");
    return f;
}

static void test_sphere(double radius)
{
    struct spin_export_options o = {.n_threads = 1, .n_crop = 4, .crop = {0.5, -0.5, 0.25, radius}};
    struct spin_splats s = {0};
    struct spin_row_filter f = filter_frame(&o, &s);
    size_t n = 0;

    for (size_t i = 0; i < s.n; i++) {
        double x = s.means[3 * i] - 0.5, y = s.means[3 * i + 1] + 0.5,
               z = s.means[3 * i + 2] - 0.25;

        n += f.reason[i] == (sqrt(x * x + y * y + z * z) > radius ? SPIN_ROW_CROP : SPIN_ROW_KEPT);
    }
    ok(n == s.n, "--crop: a sphere of radius %g", radius);
    spin_row_filter_close(&f);
    spin_splats_free(&s);
}

/* RMS distance of a row to its three nearest neighbours. */
static double spacing(const struct spin_splats *s, size_t i)
{
    double least[3] = {INFINITY, INFINITY, INFINITY};

    for (size_t k = 0; k < s->n; k++) {
        double square = 0;

        for (size_t c = 0; c < 3; c++)
            square += pow((double)s->means[3 * i + c] - (double)s->means[3 * k + c], 2);
        for (int m = 0; m < 3 && k != i; m++)
            if (square < least[m]) {
                double other = least[m];

                least[m] = square;
                square = other;
            }
    }
    return sqrt((least[0] + least[1] + least[2]) / 3);
}

static int by_double(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

static void test_floaters(double factor)
{
    static double of[2000], sorted[2000];
    struct spin_export_options o = {.n_threads = 1, .floaters = factor};
    struct spin_splats s = {0};
    struct spin_row_filter f = filter_frame(&o, &s);
    size_t n = 0;

    for (size_t i = 0; i < s.n; i++)
        sorted[i] = of[i] = spacing(&s, i);
    qsort(sorted, s.n, sizeof *sorted, by_double);
    for (size_t i = 0; i < s.n; i++) {
        const float *scale = s.log_scales + 3 * i;
        double reach = 3 * exp(fmax(fmax(scale[0], scale[1]), scale[2]));

        n += f.reason[i] ==
             (of[i] > factor * sorted[1000] && of[i] > reach ? SPIN_ROW_FLOATERS : SPIN_ROW_KEPT);
    }
    ok(n == s.n, "--floaters %g: %zu of %zu rows", factor, n, s.n);
    spin_row_filter_close(&f);
    spin_splats_free(&s);
}

static void test_threads(void)
{
    struct spin_export_options o = {.n_threads = 1, .min_opacity = 0.3}, many = o;
    struct spin_row_filter one = open_filter(&o, false), four;
    struct spin_splats s = {0};

    many.n_threads = 4;
    four = open_filter(&many, false);
    make_frame(&s, 50001, 1, 8);
    ok(n_left(&one, &s) == n_left(&four, &s) && one.n_by[SPIN_ROW_MIN_OPACITY] > 0 &&
           memcmp(one.reason, four.reason, s.n) == 0,
       "four threads judge like one");
    spin_row_filter_close(&one);
    spin_row_filter_close(&four);
    spin_splats_free(&s);
}

/* Writes a clip of one frame whose rows have tracks 0 to 3 or none; the last two are the backdrop.
 */
static const char *write_tracks(const uint32_t *track, size_t n)
{
    static char path[500];
    static float values[4][SPIN_TRACK_WIDTH];
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta = {
        .columns = SPIN_COL_MEANS, .sh_degree = -1, .n_source_frames = 1};
    struct spin_splats s = {0};
    spin_json *extra = spin_json_object(), *trained = spin_json_object(), *t = spin_json_object();
    uint64_t of_tracks[2] = {4, SPIN_TRACK_WIDTH}, of_track[1] = {n};

    snprintf(path, sizeof path, "%s/tracks.spin", check_folder());
    snprintf(meta.from, sizeof meta.from, "test");
    make_frame(&s, n, 0, 3);
    if (spin_bundle_meta_reserve(&meta, 1) != SPIN_OK)
        exit(1);
    meta.frame[0].n = n;
    spin_json_set_integer(t, "n", 4);
    spin_json_set_integer(t, "moving", 0);
    spin_json_set_integer(t, "varying", 0);
    spin_json_set_integer(t, "backdrop", 2);
    spin_json_set_bool(t, "same_rows", true);
    spin_json_set(trained, "tracks", t);
    spin_json_set_null(trained, "field");
    spin_json_set(extra, "trained", trained);
    if (spin_bundle_writer_open(path, true, false, &w) != SPIN_OK ||
        spin_bundle_write_frame(&w, 0, SPIN_COL_MEANS, 0, &s) != SPIN_OK ||
        spin_npz_write(&w.zip, "trained/tracks", "<f4", 2, of_tracks, values) != SPIN_OK ||
        spin_npz_write(&w.zip, "trained/track/00000", "<u4", 1, of_track, track) != SPIN_OK ||
        spin_bundle_writer_finish(&w, &meta, extra) != SPIN_OK)
        exit(1);
    spin_bundle_meta_free(&meta);
    spin_splats_free(&s);
    return path;
}

static void test_backdrop(void)
{
    static const uint32_t track[8] = {2, SPIN_NOT_TRACKED, 0, 3, 1, 2, 3, 0};
    static const double crop[4] = {0, 0, 0, 1e9};
    struct spin_export_options o = {.n_threads = 1, .backdrop = SPIN_EXPORT_BACKDROP_OFF};
    struct spin_clip *clip = one_frame();
    struct spin_row_filter f = {0};
    struct spin_splats s = {0};

    make_frame(&s, 8, 0, 3);
    if (!ok(spin_bundle_open(write_tracks(track, 8), &clip->bundle) == SPIN_OK, "tracks: %s",
            spin_last_error()))
        return;
    ok(spin_row_filter_open(&f, &o, clip, false) == SPIN_OK && f.varies, "opens the filter");
    ok(n_left(&f, &s) == 4 && f.n_by[SPIN_ROW_BACKDROP] == 4, "drops rows of the backdrop");
    for (int i = 0; i < 8; i++)
        ok(f.reason[i] == (track[i] == 2 || track[i] == 3 ? SPIN_ROW_BACKDROP : SPIN_ROW_KEPT),
           "row %d", i);
    spin_row_filter_close(&f);
    memcpy(o.crop, crop, sizeof crop);
    o.n_crop = 4;
    s.means[0] = 2e9f;
    ok(spin_row_filter_open(&f, &o, clip, false) == SPIN_OK && n_left(&f, &s) == 4 &&
           f.n_by[SPIN_ROW_CROP] == 1 && f.n_by[SPIN_ROW_BACKDROP] == 3,
       "--crop is the first of two reasons");
    spin_row_filter_close(&f);
    spin_bundle_close(&clip->bundle);
    clip->bundle = (struct spin_bundle){0};
    spin_splats_free(&s);
}

TAP_MAIN
{
    spin_log_set_level(-2);
    test_reasons();
    test_limits();
    test_order();
    test_sphere(0.5);
    test_sphere(0.75);
    test_floaters(1.25);
    test_floaters(1.5);
    test_threads();
    test_backdrop();
}
