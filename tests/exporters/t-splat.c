/* K: splat export */
#include "base/log.h"
#include "tests/exporters/frame.h"

extern const struct spin_exporter spin_exporter_splat;

/* antimatter15's reading of one row. */
static struct want decode(const unsigned char *row)
{
    struct want w;
    float number[6];
    double norm = 0;

    memcpy(number, row, sizeof number);
    for (int k = 0; k < 3; k++) {
        w.place[k] = number[k];
        w.log_scale[k] = log(number[3 + k]);
        w.dc[k] = (row[24 + k] / 255.0 - 0.5) / 0.28209479177387814;
    }
    w.opacity = row[27] / 255.0;
    for (int k = 0; k < 4; k++) {
        w.q[k] = (row[28 + k] - 128) / 128.0;
        norm += w.q[k] * w.q[k];
    }
    for (int k = 0; k < 4; k++)
        w.q[k] /= sqrt(norm);
    return w;
}

static void test_values(int degree)
{
    struct spin_export_job job = {
        .output = in_folder(degree ? "sh" : "flat"), .n_frames = 1, .sh_degree = degree};
    struct spin_splats s = {0};
    struct spin_map map;
    int good[5] = {1, 1, 1, 1, 1};
    char name[64];

    make_frame(&s, 10000, degree, 5);
    ok(run(&spin_exporter_splat, &job, &s, 3) == SPIN_OK, "writes degree %d", degree);
    snprintf(name, sizeof name, "%s/frame_00003.splat", degree ? "sh" : "flat");
    if (!ok(spin_map_open(in_folder(name), &map) == SPIN_OK && map.size == 32 * s.n,
            "32 bytes a splat"))
        return;
    for (size_t i = 0; i < s.n; i++) {
        struct want got = decode(map.data + 32 * i), want = want_of(&s, i);

        for (int k = 0; k < 3; k++) {
            good[0] &= got.place[k] == want.place[k];
            good[1] &= fabs(got.log_scale[k] - want.log_scale[k]) < 1e-6;
            good[2] &= fabs(got.dc[k] - want.dc[k]) < 0.0071; /* half of 1/255, over C0 */
        }
        good[3] &= fabs(got.opacity - want.opacity) < 0.00197;
        good[4] &= degrees_between(got.q, want.q) < 1.0;
    }
    ok(good[0], "places keep their bits, in the source's order");
    ok(good[1], "scales are linear");
    ok(good[2], "colours are within half a step");
    ok(good[3], "opacities are within half a step");
    ok(good[4], "rotations are within a degree");
    spin_map_close(&map);
    spin_splats_free(&s);
}

static void test_order(void)
{
    static const char *const pairs[] = {"order", "size", NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {.output = in_folder("order"), .n_frames = 1, .values = &values};
    struct spin_splats s = {0};
    struct spin_map map;
    double before = INFINITY;
    int falling = 1;

    make_frame(&s, 5000, 0, 9);
    ok(run(&spin_exporter_splat, &job, &s, 0) == SPIN_OK, "writes with --order size");
    if (!ok(spin_map_open(in_folder("order/frame_00000.splat"), &map) == SPIN_OK, "opens it"))
        return;
    for (size_t i = 0; i < map.size / 32; i++) {
        struct want w = decode(map.data + 32 * i);
        double size = w.log_scale[0] + w.log_scale[1] + w.log_scale[2] + log(w.opacity);

        if (w.opacity < 0.25) /* rounded to 8 bits, its logarithm is off by more */
            continue;
        falling &= size <= before + 0.01;
        before = size;
    }
    ok(falling, "the most visible come first");
    spin_map_close(&map);
    spin_splats_free(&s);
}

static void test_edges(void)
{
    struct spin_export_job job = {.output = in_folder("bad"), .n_frames = 1};
    struct spin_splats s = {0};
    struct spin_map map;

    make_frame(&s, 14, 1, 2);
    s.logit_opacities[1] = INFINITY;
    ok(run(&spin_exporter_splat, &job, &s, 0) == SPIN_OK &&
           spin_map_open(in_folder("bad/frame_00000.splat"), &map) == SPIN_OK &&
           map.size == 32 * 14,
       "writes an infinite logit");
    near(decode(map.data + 32).opacity, 1, 0, "an infinite logit is an opacity of 1");
    spin_map_close(&map);
    make_frame(&s, 0, 0, 2);
    job.output = in_folder("none");
    ok(run(&spin_exporter_splat, &job, &s, 0) == SPIN_OK &&
           spin_path_exists(in_folder("none/frame_00000.splat")),
       "writes an empty frame");
    spin_splats_free(&s);
}

TAP_MAIN
{
    static const char *const bad[][2] = {
        {"order", "morton"}, {"order", ""}, {"pattern", "x.splat"}};

    spin_log_set_level(-2);
    test_values(0);
    test_values(2);
    test_order();
    test_edges();
    check_folder_rules(&spin_exporter_splat, "frame_00001.splat", bad, sizeof bad / sizeof bad[0]);
}
