/* K: export rows threads */
#include "base/log.h"
#include "exporters/lib/splat_rows.h"
#include "tests/exporters/frame.h"

static struct spin_splat_rows open_rows(const char *const *pairs, int n_threads,
                                        struct spin_export_report *report)
{
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {
        .sh_degree = 1, .values = &values, .n_threads = n_threads, .report = report};
    struct spin_splat_rows rows = {0};

    ok(spin_splat_rows_begin(&rows, &job, NULL) == SPIN_OK, "takes the options");
    return rows;
}

static void test_blocks(void)
{
    struct spin_splat_rows rows = open_rows(NULL, 1, NULL);
    struct spin_splats s = {0};
    unsigned char *keep;

    make_frame(&s, 20000, 1, 3);
    keep = calloc(s.n, 1);
    ok(keep && spin_splat_rows_choose(&rows, &s) == SPIN_OK && rows.n_kept == s.n &&
           spin_splat_rows_before(&rows, 2) == 8192,
       "all rows are kept at first");
    for (size_t i = 0; i < s.n; i++)
        keep[i] = i % 4 == 0;
    spin_splat_rows_keep(&rows, keep);
    ok(rows.n_kept == 5000 && spin_splat_rows_before(&rows, 2) == 2048,
       "then a part: kept rows before a block are counted");
    make_frame(&s, 0, 0, 3);
    ok(spin_splat_rows_choose(&rows, &s) == SPIN_OK && rows.n_kept == 0, "an empty frame");
    spin_splat_rows_end(&rows);
    spin_splats_free(&s);
    free(keep);
}

/* Where each axis of the source is mapped. */
static void test_up(void)
{
    static const char *const axes[] = {"x", "y", "z", "-x", "-y", "-z"};

    for (int a = 0; a < 6; a++) {
        const char *pairs[] = {"up", axes[a], NULL};
        struct spin_splat_rows rows = open_rows(pairs, 1, NULL);
        float v[3] = {0};
        spin_vec3 up;

        v[a % 3] = a < 3 ? 1 : -1;
        up = spin_scene_rotation_place(&rows.turn, spin_v3(v[0], v[1], v[2]));
        ok(up.x == 0 && up.y == 1 && up.z == 0 && rows.up, "--up %s: it becomes y", axes[a]);
        spin_splat_rows_end(&rows);
    }
}

static void test_rotate(void)
{
    static const char *const pairs[] = {"up", "z", "rotate", "0,90,-30", NULL};
    struct spin_splat_rows rows = open_rows(pairs, 1, NULL);
    spin_vec3 p = spin_scene_rotation_place(&rows.turn, spin_v3(0, 0, 1));

    /* z becomes y; y stays in the turn about y; about z by -30 degrees it leans to x. */
    near((double)p.x, 0.5, 1e-6, "--rotate comes after --up");
    near((double)p.y, sqrt(0.75), 1e-6, "and goes about x, y, z");
    ok(!rows.up, "which way is up is not said then");
    spin_splat_rows_end(&rows);
}

static bool close_to(const float *got, const float *want, int n)
{
    for (int i = 0; i < n; i++)
        if (!(fabsf(got[i] - want[i]) < 1e-6f))
            return false;
    return true;
}

/* A quarter turn about x, y to z and z to -y, applies to positions, rotations and SH of degree
 * 1, which are -y, z and -x. */
static void test_turned(void)
{
    static const char *const pairs[] = {"rotate", "90,0,0", NULL};
    static const float place[] = {1, -3, 2}, half = 0.70710678f;
    static const float quats[2][4] = {{-0.1f, 0.7f, 0.1f, 0.7f}, {0.1f, 0.7f, 0.1f, 0.7f}};
    static const float turned[2][4] = {{0.8f, -0.6f, 0.6f, -0.8f}, {0.6f, -0.8f, 0.6f, -0.8f}};
    struct spin_splat_rows rows = open_rows(pairs, 1, NULL);
    float out[3], q[4], want[4], room[3 * SPIN_SH_MAX];
    struct spin_splats s = {0};
    const float *sh, *was;

    make_frame(&s, 2, 1, 3);
    s.means[0] = 1, s.means[1] = 2, s.means[2] = 3;
    memcpy(s.quats, quats, sizeof quats);
    ok(spin_splat_rows_choose(&rows, &s) == SPIN_OK, "a quarter turn about x");
    spin_splat_rows_place(&rows, 0, out);
    ok(close_to(out, place, 3), "places are turned");
    for (size_t i = 0; i < 2; i++) {
        for (int k = 0; k < 4; k++)
            want[k] = half * turned[i][k];
        spin_splat_rows_turned(&rows, i, q);
        ok(close_to(q, want, 4), "rotations are turned, and w stays positive");
    }
    was = s.sh + 12;
    sh = spin_splat_rows_sh(&rows, 1, room);
    for (int c = 0; c < 3; c++) {
        const float expected[] = {was[c], was[6 + c], -was[3 + c], was[9 + c]};
        const float got[] = {sh[c], sh[3 + c], sh[6 + c], sh[9 + c]};

        ok(close_to(got, expected, 4), "harmonics are turned, channel %d", c);
    }
    spin_splat_rows_end(&rows);
    spin_splats_free(&s);
}

static void test_refused(void)
{
    static const char *const bad[][2] = {{"up", "w"},         {"up", ""},
                                         {"rotate", "1,2"},   {"rotate", "1,2,3,4"},
                                         {"rotate", "a,0,0"}, {"rotate", "inf,0,0"},
                                         {"sh", "4"}};

    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        const char *pairs[] = {bad[i][0], bad[i][1], NULL};
        struct spin_plugin_values values = {pairs};
        struct spin_export_job job = {.values = &values};
        struct spin_splat_rows rows = {0};

        ok(spin_splat_rows_begin(&rows, &job, NULL) == SPIN_E_USAGE &&
               strstr(spin_last_error(), bad[i][0]),
           "refuses --%s '%s'", bad[i][0], bad[i][1]);
        spin_splat_rows_end(&rows);
    }
}

TAP_MAIN
{
    spin_log_set_level(-2);
    test_blocks();
    test_up();
    test_rotate();
    test_turned();
    test_refused();
}
