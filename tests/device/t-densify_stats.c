/* Statistics for densification: the formula of 3DGS; splats that are not visible are unchanged; two
 * views add up; the same bits on every SIMD path and for any number of threads.
 * K: threads refine */

#include "tests/device/strict.h"
#include "tests/device/verbs.h"

enum { N = 9000, W = 61, H = 47 };

static struct spin_splat2d splat2d[N];
static struct spin_splat2d_grad d_splat2d[N];
static float want_sum[N], sum[N];
static uint32_t want_seen[N], seen[N];

static void set_gradients(bool absolute)
{
    with_absolute = absolute;
    for (int i = 0; i < N; i++) {
        volatile float x, y, xx, yy; /* volatile: one rounding per operation */
        float u = (float)(i * 7919 % 1999) / 1e7f - 1e-4f;
        float v = (float)(i * 7907 % 1993) / 1e7f - 1e-4f;

        splat2d[i].radius_px = i % 5 - 1;
        d_splat2d[i].u_px = absolute ? 7 : u;
        d_splat2d[i].v_px = absolute ? 8 : v;
        d_splat2d[i].absolute_u_px = absolute ? fabsf(u) : 9;
        d_splat2d[i].absolute_v_px = absolute ? fabsf(v) : 10;
        x = 0.5f * (float)W * u;
        y = 0.5f * (float)H * v;
        xx = x * x;
        yy = y * y;
        if (splat2d[i].radius_px > 0) {
            want_sum[i] = sqrtf(xx + yy) + sqrtf(xx + yy);
            want_seen[i] = 2;
        }
    }
}

static void check_path(const char *path, int n_threads)
{
    struct spin_camera_f32 cam = {.width = W, .height = H};
    struct spin_device *d;

    setenv("SPIN_CPU", path, 1);
    d = check_device(n_threads);
    memset(sum, 0, sizeof sum);
    memset(seen, 0, sizeof seen);
    for (int view = 0; view < 2; view++)
        on_densify_stats(d, &cam, N, splat2d, d_splat2d, sum, seen);
    ok(memcmp(sum, want_sum, sizeof sum) == 0, "%s, %d threads: sums of gradients", path,
       n_threads);
    ok(memcmp(seen, want_seen, sizeof seen) == 0, "%s, %d threads: views that saw it", path,
       n_threads);
    check_device_free(d);
}

/* Two frames and three views in one batch on the strict device: each view adds to the splats of its
 * frame. */
static void views_together(void)
{
    enum { FIRST = 4000, REST = N - FIRST };
    static const int shows[3] = {1, 0, 1};
    static struct spin_splat2d drawn[REST + FIRST + REST];
    static struct spin_splat2d_grad d_drawn[REST + FIRST + REST];
    static const struct spin_frame_of_batch frame[2] = {{.n = FIRST}, {.first = FIRST, .n = REST}};
    struct spin_device *d = strict_open(check_device(2), 2, 3);
    struct loans l = {.d = d};
    struct spin_frame_batch frames = {.n_frames = 2, .n = N, .frame = {frame[0], frame[1]}};
    struct spin_view_batch views = {.n_views = 3};
    int complaints = strict_complaints(), wrong = 0;
    size_t at = 0;

    for (int k = 0; k < 3; k++) {
        size_t first = frame[shows[k]].first, n = frame[shows[k]].n;

        views.view[k] = (struct spin_view_of_batch){
            .frame = shows[k], .first = at, .n = n, .camera = {.width = W, .height = H}};
        memcpy(drawn + at, splat2d + first, n * sizeof *drawn);
        memcpy(d_drawn + at, d_splat2d + first, n * sizeof *d_drawn);
        at += n;
    }
    memset(sum, 0, sizeof sum);
    memset(seen, 0, sizeof seen);
    for (int f = 0; f < 2; f++) {
        frames.frame[f].gradient = lend_both(&l, sum + frame[f].first, frame[f].n * sizeof *sum);
        frames.frame[f].seen = lend_both(&l, seen + frame[f].first, frame[f].n * sizeof *seen);
    }
    d->op->densify_stats(d, &views, &frames, lend(&l, drawn, sizeof drawn),
                         lend(&l, d_drawn, sizeof d_drawn));
    settle(&l);
    for (size_t i = 0; i < N; i++) {
        float times = i < FIRST ? 0.5f : 1; /* the first frame has one view, the other two */

        wrong += sum[i] != want_sum[i] * times || (float)seen[i] != (float)want_seen[i] * times;
    }
    ok(wrong == 0, "views together: %d of %d splats differ", wrong, (int)N);
    ok(strict_complaints() == complaints, "without a complaint");
    strict_close(d);
}

TAP_MAIN
{
    static const char *const paths[] = {"base", "v3", "v4"};

    for (int p = 0; p < 3; p++) {
        struct spin_device d;

        setenv("SPIN_CPU", paths[p], 1);
        if (spin_device_open("cpu", 1, &d) != SPIN_OK) {
            skip(paths[p], spin_last_error());
            continue;
        }
        spin_device_close(&d);
        for (int absolute = 0; absolute <= 1; absolute++) {
            set_gradients(absolute);
            check_path(paths[p], 1);
            check_path(paths[p], 3);
        }
    }
    unsetenv("SPIN_CPU");
    set_gradients(false);
    views_together();
}
