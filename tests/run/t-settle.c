/* Static splats of frames that share no rows are found and stored once: a ball moves in front of a
 * wall, cameras look from the front and from behind, and the wall has a hole in one frame.
 * K: renders settle static */
#include "run/settle.h"

#include "base/err.h"
#include "base/log.h"
#include "render/draw_renders.h"
#include "tests/check.h"
#include "tests/tap.h"

enum {
    FRAMES = 12,
    WIDE = 24, /* splats of a row of the wall */
    HIGH = 12,
    WALL = WIDE * HIGH,
    HOLE = WIDE * 2 + 5, /* the splat of the wall that is absent in the middle frame */
    BALL = 20,
    MIDDLE = FRAMES / 2,
    STATIC = WALL + 1,
    CAMERAS = 10, /* the last four are behind the wall */
    FLASH = 5,    /* splats around one that flashes */
    MOST = WALL + BALL + 4 + FLASH
};
#define DYNAMIC (BALL + 3.0 / FRAMES)
static const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;
static char source[500], folder[400];
static int n_frames = FRAMES; /* a multiple: the frames repeat */
static double n_before;       /* rows of the source, mean of all frames */
static float flicker;         /* of the wall, which covers most of the images */
static float brightness = 1;  /* of the ball */
static bool flashes;          /* one splat changes its colour; the splats around it do not */
static const char *renders = "renders:test=0,size=96x64";

static void put_splat(struct spin_splats *s, float x, float y, float z, float grey, float size)
{
    size_t i = s->n++;
    const float at[3] = {x, y, z};

    for (size_t c = 0; c < 3; c++) {
        s->means[3 * i + c] = at[c];
        s->log_scales[3 * i + c] = logf(size) + 0.01f * (float)c;
        s->sh[3 * i + c] = (grey - 0.5f) / 0.2821f + 0.01f * (float)c;
        s->quats[4 * i + c] = 0.01f * (float)c;
    }
    s->quats[4 * i] = 1;
    s->quats[4 * i + 3] = 0;
    s->logit_opacities[i] = 4;
}

/* The wall is at z = 2 and the ball at z = 1. Frames store the wall in different orders. Three
 * frames, a quarter of them, have one more splat beside those of the wall. The first two frames
 * have two others, which float, and the first has one that is nearly transparent. The middle frame
 * has three splats where the ball is in frame 0, 10 and 11 only. */
static void fill_frame(struct spin_splats *s, int f)
{
    /* The median over time is 0, and the difference from it is the same in ten of twelve frames. */
    float level = (f %= FRAMES) == 3 || f == 8 ? 0 : f % 2 ? 1 : -1;

    if (spin_splats_reserve(s, MOST, columns, 0) != SPIN_OK)
        exit(1);
    s->n = 0;
    if (f == 0) {
        put_splat(s, -1.6f, -1, 2, 0.5f, 0.1f);
        s->logit_opacities[0] = -6;
    }
    if (f == 0 || f == 2 || f == FRAMES - 1)
        put_splat(s, -1.6f, 1, 2, 0.55f, 0.004f);
    for (int i = 0; i < 2 && f < 2; i++)
        put_splat(s, 1.6f, 1 + 0.001f * (float)i, 2, 0.55f, 0.004f);
    if (f == MIDDLE) {
        put_splat(s, -1.25f, 0.05f, 1, 0.55f, 0.004f);
        put_splat(s, 1.05f, 0.05f, 1, 0.55f, 0.004f);
        if (n_frames == FRAMES) /* of more frames, no sample shows the ball there */
            put_splat(s, 1.1f, -0.42f, 1, 0.55f, 0.004f);
    }
    for (int i = 0; i < WALL; i++) {
        int k = f % 2 ? WALL - 1 - i : i;

        if (f != MIDDLE || k != HOLE)
            put_splat(s, 0.2f * (float)(k % WIDE) - 2.3f, 0.2f * (float)(k / WIDE) - 1.1f, 2,
                      k == HOLE ? 0.03f : 0.5f + 0.1f * (float)(k % 2) + flicker * level,
                      k == HOLE ? 0.004f : 0.1f);
    }
    for (int i = 0; i < FLASH && flashes; i++)
        put_splat(s,
                  0.5f + (i == 1   ? 0.04f
                          : i == 2 ? -0.04f
                                   : 0),
                  0.7f + (i == 3   ? 0.04f
                          : i == 4 ? -0.04f
                                   : 0),
                  1.5f, i > 0 ? 0.5f : (float)(f % 2), 0.012f);
    for (int i = 0; i < BALL; i++)
        put_splat(s, 0.2f * (float)(f - MIDDLE) + 0.05f * (float)(i % 5),
                  0.05f * (float)(i / 5) - (f == FRAMES - 1 ? 0.5f : 0), 1, brightness, 0.06f);
}

/* Six cameras in front of the wall, and four behind it, which do not see the ball. */
static struct spin_camera camera_of(int k)
{
    double x = 0.5 * (k % 6) - 1.25;
    struct spin_camera front = {96, 64, 80, 80, 48, 32, {1, 0, 0, -x, 0, 1, 0, 0, 0, 0, 1, 1}, 0},
                       behind = {96, 64, 80, 80, 48, 32, {-1, 0, 0, x, 0, 1, 0, 0, 0, 0, -1, 5}, 0};

    front.w2c[7] = 0.3 * (k % 3 - 1);
    return k < 6 ? front : behind;
}

static void write_source(void)
{
    static int n_sources;
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta = {0};
    struct spin_splats s = {0};

    n_before = 0;
    snprintf(source, sizeof source, "%s/source%d.spin", folder, n_sources++);
    if (spin_bundle_meta_reserve(&meta, n_frames) != SPIN_OK)
        exit(1);
    snprintf(meta.from, sizeof meta.from, "ply");
    for (int f = 0; f < n_frames; f++) {
        meta.frame[f].number = f;
        fill_frame(&s, f);
        meta.frame[f].n = s.n;
        n_before += (double)s.n / n_frames;
        meta.source_index[f] = f;
    }
    meta.n_source_frames = n_frames;
    meta.numbered = true;
    meta.columns = columns;
    for (int k = 0; k < CAMERAS; k++)
        if (spin_views_add(&meta.cameras,
                           &(struct spin_view){.camera = camera_of(k), .camera_id = k}) != SPIN_OK)
            exit(1);
    if (spin_bundle_writer_open(source, false, false, &w) != SPIN_OK)
        exit(1);
    for (int f = 0; f < n_frames; f++) {
        fill_frame(&s, f);
        if (spin_bundle_write_frame(&w, f, columns, 0, &s) != SPIN_OK)
            exit(1);
    }
    ok(spin_bundle_writer_finish(&w, &meta, NULL) == SPIN_OK, "writes a clip");
    spin_bundle_meta_free(&meta);
    spin_splats_free(&s);
}

/* Returns whether the rows i of a and k of b are identical, except that all scales of b are larger
 * by the same factor. */
static bool same_row(const struct spin_splats *a, size_t i, const struct spin_splats *b, size_t k,
                     float larger_by)
{
    bool same = memcmp(a->means + 3 * i, b->means + 3 * k, 3 * sizeof(float)) == 0 &&
                memcmp(a->quats + 4 * i, b->quats + 4 * k, 4 * sizeof(float)) == 0 &&
                memcmp(a->sh + 3 * i, b->sh + 3 * k, 3 * sizeof(float)) == 0 &&
                a->logit_opacities[i] == b->logit_opacities[k];

    for (size_t c = 0; c < 3; c++)
        same =
            same && fabsf(a->log_scales[3 * i + c] + larger_by - b->log_scales[3 * k + c]) < 1e-6f;
    return same;
}

/* Returns whether row k of b is a row of frame f of the source. */
static bool is_of_source(const struct spin_splats *b, size_t k, int f, float larger_by)
{
    static struct spin_splats s;
    static int filled = -1;
    static float flickered;

    if (filled != f || flickered != flicker)
        fill_frame(&s, f);
    filled = f;
    flickered = flicker;
    for (size_t i = 0; i < s.n; i++)
        if (same_row(&s, i, b, k, larger_by))
            return true;
    return false;
}

/* Checks the frames of the output: n_static rows that are identical in all frames, and rows of the
 * ball, of which frames have n_dynamic on average. */
static void check_output(const char *path, const struct spin_settled *got, const float larger_by[2])
{
    struct spin_splats first = {0}, s = {0};
    struct spin_bundle b;
    size_t n_static = (size_t)got->n_static;
    double n = 0;
    bool same = true, wall = true, ball = true;

    if (!ok(spin_bundle_open(path, &b) == SPIN_OK &&
                spin_bundle_frame(&b, 0, columns, &first) == SPIN_OK && b.meta.n_frames == n_frames,
            "the new clip: %s", spin_last_error()))
        return;
    for (int f = 0; f < n_frames; f++) {
        same = same && spin_bundle_frame(&b, f, columns, &s) == SPIN_OK && s.n >= n_static &&
               b.meta.frame[f].n == s.n && b.meta.frame[f].number == f;
        for (size_t i = 0; i < n_static && i < s.n; i++) {
            same = same && same_row(&first, i, &s, i, 0);
            wall = wall && s.means[3 * i + 2] > 1 &&
                   (is_of_source(&s, i, MIDDLE, larger_by[0]) ||
                    is_of_source(&s, i, MIDDLE - 1, larger_by[0]) ||
                    is_of_source(&s, i, 2, larger_by[0]));
        }
        for (size_t i = n_static; i < s.n; i++)
            ball = ball && s.means[3 * i + 2] == 1 && is_of_source(&s, i, f, larger_by[1]);
        n += (double)(s.n - n_static) / n_frames;
    }
    ok(same && wall, "the static rows are those of the wall, in every frame");
    ok(ball, "the others are the ball's, of their own frame");
    near(got->n_dynamic, n, 1e-9, "as many as are reported");
    is_text(b.meta.data_from, renders, "the data set is rendered");
    ok(b.meta.data_path && strstr(b.meta.data_path, "source") && !*b.meta.pair &&
           b.meta.static_columns == 0,
       "from the source");
    spin_bundle_close(&b);
    spin_splats_free(&first);
    spin_splats_free(&s);
}

/* Settles the clip with these shares, and checks the output. */
static struct spin_settled settle(double keep_static, double keep_dynamic, double most,
                                  const float larger_by[2])
{
    char path[600];
    struct spin_settle_options o = {.input = source,
                                    .data = "renders",
                                    .output = path,
                                    .data_from = renders,
                                    .force = true,
                                    .n_threads = 2,
                                    .keep_static = keep_static,
                                    .keep_dynamic = keep_dynamic,
                                    .most = most};
    struct spin_settled got;

    snprintf(path, sizeof path, "%s/settled.spin", folder);
    ok(spin_settle(&o, &got) == SPIN_OK, "settles: %s", spin_last_error());
    near(got.n_before, n_before, 1e-9, "the rows before");
    check_output(path, &got, larger_by);
    return got;
}

TAP_MAIN
{
    struct spin_settled got;
    int drawing;

    ok(spin_settle_step(31, 1) == 1 && spin_settle_step(32, 1) == 2 &&
           spin_settle_step(100, 25e6) == 5 && spin_settle_step(100, 1e9) == 13,
       "up to 31 frames are sampled, or 1.5 GB, but 8 at least");
    spin_log_set_level(-2);
    snprintf(folder, sizeof folder, "%s", check_folder());
    write_source();
    drawing = spin_renders_begin(2);
    got = settle(1, 1, 0, (const float[2]){0, 0});
    ok(got.n_static == STATIC && fabs(got.n_dynamic - DYNAMIC) < 1e-9,
       "the wall is static, and so are splats that the middle frame lacks and a quarter has: %g; "
       "the ball moves: %g",
       got.n_static, got.n_dynamic);
    got = settle(0.5, 0.25, 0, (const float[2]){logf(2) / 3, logf(4) / 3});
    ok(fabs(got.n_static - 0.5 * STATIC) < 25 && fabs(got.n_dynamic - 0.25 * DYNAMIC) < 2.5,
       "a half and a quarter: %g, %g", got.n_static, got.n_dynamic);
    got = settle(1, 1, 0.5 * (STATIC + DYNAMIC), (const float[2]){logf(2) / 3, logf(2) / 3});
    ok(fabs(got.n_static + got.n_dynamic - 0.5 * (STATIC + DYNAMIC)) < 25,
       "at most half of the rows: %g, %g", got.n_static, got.n_dynamic);
    brightness = 0;
    write_source();
    got = settle(0.5, 0.25, 2 * MOST, (const float[2]){0, 0});
    ok(got.n_static == STATIC && fabs(got.n_dynamic - DYNAMIC) < 1e-9,
       "there are fewer rows than allowed: %g, %g", got.n_static, got.n_dynamic);
    n_frames = 3 * FRAMES;
    write_source();
    got = settle(1, 1, 0, (const float[2]){0, 0});
    ok(got.n_static == STATIC && fabs(got.n_dynamic - DYNAMIC + 1.0 / FRAMES) < 1e-9,
       "the same in 36 frames, half of which are no samples: %g, %g", got.n_static, got.n_dynamic);
    n_frames = FRAMES;
    flicker = 0.08f;
    write_source();
    got = settle(1, 1, 0, (const float[2]){0, 0});
    ok(got.n_static == STATIC && fabs(got.n_dynamic - DYNAMIC) < 1e-9,
       "flicker does not count: %g, %g", got.n_static, got.n_dynamic);
    flicker = 0;
    flashes = true;
    renders = "renders:test=0,size=384x256";
    write_source();
    got = settle(1, 1, 0, (const float[2]){0, 0});
    ok(got.n_static == STATIC + FLASH && fabs(got.n_dynamic - DYNAMIC) < 1e-9,
       "nor does a single splat that flashes among others: %g, %g", got.n_static, got.n_dynamic);
    spin_renders_end(&drawing);
}
