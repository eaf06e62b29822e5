/* Conversion of a trained clip's tracks to 4D splats: their segments, and their motion.
 * K: retrain 4d tracks */
#include "train/rows_4d.h"

#include "scene/bundle.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { FRAMES = 6, WIDTH = 3 + SPIN_RESIDUAL };
static char path[600];
static int frame_of[FRAMES] = {0, 1, 2, 3, 4, 5};
static struct spin_rows_4d rows;
static int apart = -1; /* a frame whose splat is of no track */

/* Size 0.1, red c, at x. */
static void fill(float x, float c, float *means, float *values)
{
    static const float plain[SPIN_RESIDUAL] = {-2.3025851f, -2.3025851f, -2.3025851f, 1, 0, 0,
                                               0,           0,           0,           0, 0};

    memcpy(values, plain, sizeof plain);
    values[7] = c;
    means[0] = x;
    means[1] = means[2] = 0;
}

/* A clip of n frames with one splat each, of one track or of none. */
static void write_clip(int n, uint32_t track, const float *x, const float *c)
{
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta = {.columns = SPIN_COL_MEANS, .sh_degree = -1};
    spin_json *extra = spin_json_object(), *trained = spin_json_object(),
              *tracks = spin_json_object();
    const float shared[WIDTH] = {0};
    const uint64_t all[2] = {1, WIDTH}, one[1] = {1};

    snprintf(meta.from, sizeof meta.from, "test");
    meta.n_source_frames = n;
    spin_json_set_null(trained, "field");
    spin_json_set_integer(trained, "sh_degree", 0);
    spin_json_set_integer(tracks, "n", 1);
    spin_json_set_integer(tracks, "moving", 1);
    spin_json_set_integer(tracks, "varying", 1);
    spin_json_set(trained, "tracks", tracks);
    spin_json_set(extra, "trained", trained);
    if (spin_bundle_meta_reserve(&meta, n) != SPIN_OK ||
        spin_bundle_writer_open(path, true, false, &w) != SPIN_OK)
        exit(1);
    if (spin_bundle_write_array(&w, "trained/tracks", -1, "<f4", 2, all, shared) != SPIN_OK)
        exit(1);
    for (int f = 0; f < n; f++) {
        float means[3], values[SPIN_RESIDUAL];
        struct spin_splats s = {.n = 1, .means = means};
        uint64_t place[2] = {1, 3}, residual[2] = {1, SPIN_RESIDUAL};
        uint32_t of = f == apart ? SPIN_NO_TRACK : track;

        fill(x[f], c[f], means, values);
        meta.frame[f] = (struct spin_frame_info){.n = 1, .number = f, .time = f};
        meta.source_index[f] = f;
        if (spin_bundle_write_frame(&w, f, SPIN_COL_MEANS, 0, &s) != SPIN_OK ||
            spin_bundle_write_array(&w, "trained/track", f, "<u4", 1, one, &of) != SPIN_OK ||
            spin_bundle_write_array(&w, "trained/means", f, "<f4", 2, place, means) != SPIN_OK ||
            spin_bundle_write_array(&w, "trained/residual", f, "<f4", 2, residual, values) !=
                SPIN_OK)
            exit(1);
    }
    if (!ok(spin_bundle_writer_finish(&w, &meta, extra) == SPIN_OK, "a clip: %s",
            spin_last_error()))
        exit(tap_done());
    spin_bundle_meta_free(&meta);
}

static void cut(int n, uint32_t track, const float *x, const float *c)
{
    static struct spin_retrain_report report;
    static const struct spin_retrain_options options = {.n_threads = 2};
    struct spin_plan plan = {.report = &report, .extent = 1, .o = &options};
    size_t counts[FRAMES];

    write_clip(n, track, x, c);
    spin_rows_4d_close(&rows);
    plan.clip.n_frames = n;
    plan.clip.frame = frame_of;
    plan.counts = counts;
    plan.field.time_last = n - 1;
    ok(spin_bundle_open(path, &plan.clip.bundle) == SPIN_OK &&
           spin_rows_4d_cut(&rows, &plan) == SPIN_OK,
       "its rows: %s", spin_last_error());
    spin_bundle_close(&plan.clip.bundle);
    ok(plan.n_rows == rows.n && counts[0] > 0, "the plan knows of them");
}

static double velocity(size_t row) { return (double)rows.motion[SPIN_MOTION * row] / (FRAMES - 1); }

TAP_MAIN
{
    static const float same[FRAMES] = {0}, paint[FRAMES] = {0, 0, 0, 0.31f, 0.31f, 0.31f},
                       shade[FRAMES] = {0, 0, 0, 0.14f, 0.14f, 0.14f};
    static const float still[FRAMES] = {0}, steady[FRAMES] = {0, 0.1f, 0.2f, 0.3f, 0.4f, 0.5f},
                       leap[FRAMES] = {0, 0, 0, 0.3f, 0.3f, 0.3f},
                       turn[FRAMES] = {0, 0.15f, 0.3f, 0.15f, 0, -0.15f};

    snprintf(path, sizeof path, "%s/clip.spin", check_folder());
    cut(FRAMES, 0, steady, same);
    ok(rows.n == 1 && rows.n_whole == 1 && fabs(velocity(0) - 0.1) < 1e-6 &&
           fabs((double)rows.values[0] - 0.25) < 1e-6 && rows.motion[4] == 0,
       "a track that goes straight on is one row, seen all the time");
    cut(FRAMES, 0, still, shade);
    ok(rows.n == 1, "a little change of colour is the same splat");
    cut(FRAMES, 0, still, paint);
    ok(rows.n == 2 && rows.n_whole == 0, "more than twice the tolerance of it are another one");
    ok(rows.counts[0] == 1 && rows.counts[5] == 1 && rows.of[0][0] == 0 && rows.of[5][0] == 1,
       "each is seen in its own time");
    ok(rows.values[WIDTH + 10] == 0.31f && rows.values[10] == 0, "with its own colour");
    cut(FRAMES, 0, leap, same);
    ok(rows.n == 2 && velocity(0) == 0 && velocity(1) == 0,
       "what leaps further than half its size is cut");
    cut(FRAMES, 0, turn, same);
    ok(rows.n == 2 && fabs(velocity(0) - 0.15) < 1e-6 && fabs(velocity(1) + 0.15) < 1e-6,
       "a way that turns is cut where it turns: %zu rows", rows.n);
    cut(FRAMES, SPIN_NO_TRACK, still, same);
    ok(rows.n == FRAMES, "without a track, each frame has a row of its own: %zu", rows.n);
    apart = 3;
    cut(FRAMES, 0, still, same);
    ok(rows.n == 3 && rows.n_whole == 0, "a track that misses a frame is two: %zu rows", rows.n);
    spin_rows_4d_close(&rows);
}
