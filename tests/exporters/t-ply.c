/* K: ply export */
#include <unistd.h>

#include "base/err.h"
#include "base/log.h"
#include "io/ply.h"
#include "tests/check.h"
#include "tests/tap.h"

extern const struct spin_exporter spin_exporter_ply;

static const char *folder;

static const char *in_folder(const char *name)
{
    static char path[4][4096];
    static int next;
    char *p = path[next++ % 4];

    snprintf(p, sizeof path[0], "%s/%s", folder, name);
    return p;
}

/* n splats whose every value says where it is from. */
static void make_frame(struct spin_splats *s, size_t n, int degree)
{
    size_t n_sh = 3 * (size_t)((degree + 1) * (degree + 1));

    if (spin_splats_reserve(s, n, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, degree) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < n; i++) {
        float base = 100 * (float)i;
        /* Multiples of 1/2: of unit length without rounding; w is negative in odd rows. */
        float w = i % 2 ? -0.5f : 0.5f;

        for (int k = 0; k < 3; k++) {
            s->means[3 * i + (size_t)k] = base + (float)k;
            s->log_scales[3 * i + (size_t)k] = -base - (float)k - 1;
        }
        s->quats[4 * i] = w;
        s->quats[4 * i + 1] = 0.5f;
        s->quats[4 * i + 2] = -0.5f;
        s->quats[4 * i + 3] = 0.5f;
        s->logit_opacities[i] = (float)i - 3;
        for (size_t k = 0; k < n_sh; k++)
            s->sh[n_sh * i + k] = base + 0.5f + (float)k;
    }
}

static spin_status run(const struct spin_export_job *job, const struct spin_splats *s, int number)
{
    struct spin_frame_info info = {.number = number, .n = s->n};
    void *self = NULL;
    spin_status status;

    SPIN_TRY(spin_exporter_ply.begin(job, &self));
    status = spin_exporter_ply.frame(self, 0, &info, s);
    if (status == SPIN_OK)
        return spin_exporter_ply.end(self);
    spin_exporter_ply.abort(self);
    return status;
}

static int column_is(const struct spin_ply *ply, const char *name, float first, float step)
{
    const struct spin_ply_element *e = &ply->element[0];
    int p = spin_ply_find(e, name), good = p >= 0;
    float *value = calloc(e->count + 1, sizeof *value);

    if (good)
        spin_ply_column(ply, e, p, value, 1);
    for (uint64_t i = 0; i < e->count; i++)
        good &= value[i] == first + step * (float)i;
    free(value);
    return good;
}

/* f_rest_j of splat i: channel j / (K-1), coefficient 1 + j % (K-1); zero beyond the source's
 * degree. */
static int rest_is_right(const struct spin_ply *ply, int from, int to)
{
    int n = (to + 1) * (to + 1) - 1, n_from = (from + 1) * (from + 1), good = 1;

    for (int j = 0; j < 3 * n; j++) {
        int c = j / n, k = 1 + j % n;
        char name[32];

        snprintf(name, sizeof name, "f_rest_%d", j);
        good &= k < n_from ? column_is(ply, name, 0.5f + (float)(3 * k + c), 100)
                           : column_is(ply, name, 0, 0);
    }
    return good;
}

static int rotation_is_right(const struct spin_ply *ply)
{
    const struct spin_ply_element *e = &ply->element[0];
    float q[4 * 64] = {0};
    int good = e->count <= 64;

    for (int k = 0; k < 4; k++)
        spin_ply_column(ply, e, (int)e->n_properties - 4 + k, q + k, 4);
    for (uint64_t i = 0; i < e->count; i++) {
        float sign = i % 2 ? -1 : 1;

        good &= q[4 * i] == 0.5f && q[4 * i + 1] == sign * 0.5f && q[4 * i + 2] == sign * -0.5f &&
                q[4 * i + 3] == sign * 0.5f;
    }
    return good;
}

static void test_degree(int from, const char *sh, int to)
{
    const char *pairs[] = {"sh", sh, NULL};
    struct spin_plugin_values values = {pairs};
    char name[32];
    struct spin_splats s = {0};
    struct spin_ply ply;
    int n_properties = 17 + 3 * ((to + 1) * (to + 1) - 1);

    snprintf(name, sizeof name, "degree_%d_%s", from, sh);
    struct spin_export_job job = {.output = in_folder(name),
                                  .n_frames = 1,
                                  .sh_degree = from,
                                  .source = "d3dgs",
                                  .values = &values};
    make_frame(&s, 7, from);
    ok(run(&job, &s, 12) == SPIN_OK, "writes degree %d as %s", from, sh);
    strcat(name, "/frame_00012.ply");
    if (!ok(spin_ply_open(in_folder(name), &ply) == SPIN_OK, "opens what it wrote"))
        return;
    const struct spin_ply_element *e = &ply.element[0];
    ok(ply.n_elements == 1 && e->count == 7 && (int)e->n_properties == n_properties && !ply.ascii &&
           !ply.big_endian && ply.extra_bytes == 0,
       "one element of %d properties", n_properties);
    ok(strcmp(e->property[0].name, "x") == 0 && strcmp(e->property[3].name, "nx") == 0 &&
           strcmp(e->property[6].name, "f_dc_0") == 0 &&
           strcmp(e->property[n_properties - 8].name, "opacity") == 0 &&
           strcmp(e->property[n_properties - 7].name, "scale_0") == 0 &&
           strcmp(e->property[n_properties - 1].name, "rot_3") == 0,
       "in the reference's order");
    ok(ply.n_comments == 3 && strcmp(ply.comment[0], "Generated by spin4d " SPIN_VERSION) == 0 &&
           strcmp(ply.comment[1], "source d3dgs") == 0 &&
           strcmp(ply.comment[2], "frame 12, time 0") == 0,
       "three comments");
    ok(column_is(&ply, "x", 0, 100) && column_is(&ply, "z", 2, 100) &&
           column_is(&ply, "ny", 0, 0) && column_is(&ply, "opacity", -3, 1) &&
           column_is(&ply, "scale_0", -1, -100) && column_is(&ply, "scale_1", -2, -100) &&
           column_is(&ply, "scale_2", -3, -100) && column_is(&ply, "f_dc_0", 0.5f, 100) &&
           column_is(&ply, "f_dc_2", 2.5f, 100),
       "places, opacities, scales and colours keep their bits");
    ok(rest_is_right(&ply, from, to), "f_rest is channel-major");
    ok(rotation_is_right(&ply), "rotations have w >= 0");
    spin_ply_close(&ply);
    spin_splats_free(&s);
}

/* Infinite opacities, and rotations far from unit length. */
static void test_edges(void)
{
    struct spin_export_job job = {.output = in_folder("bad"), .n_frames = 1};
    struct spin_splats s = {0};
    struct spin_ply ply;
    float value[64];

    make_frame(&s, 14, 1);
    s.logit_opacities[1] = INFINITY;
    s.logit_opacities[2] = -INFINITY;
    s.logit_opacities[3] = -1000;
    for (int k = 0; k < 4; k++) {
        s.quats[4 * 4 + k] = 3e-30f;
        s.quats[4 * 5 + k] = -3e30f;
        s.quats[4 * 6 + k] = k ? 0 : 3;
    }
    ok(run(&job, &s, 0) == SPIN_OK, "writes extreme values");
    if (!ok(spin_ply_open(in_folder("bad/frame_00000.ply"), &ply) == SPIN_OK, "opens it"))
        return;
    spin_ply_column(&ply, &ply.element[0], spin_ply_find(&ply.element[0], "opacity"), value, 1);
    ok(value[0] == -3 && value[1] == 30 && value[2] == -30 && value[3] == -1000,
       "infinite logits become finite, finite ones stay");
    for (int k = 0; k < 4; k++)
        spin_ply_column(&ply, &ply.element[0], (int)ply.element[0].n_properties - 4 + k, value + k,
                        4);
    near(value[4 * 4 + 3], 0.5, 1e-6, "a tiny rotation gets unit length");
    near(value[4 * 5 + 1], 0.5, 1e-6, "a huge one too, with w >= 0");
    near(value[4 * 6], 1, 0, "a long one too");
    spin_ply_close(&ply);
    spin_splats_free(&s);
}

static void test_pattern(void)
{
    static const char *const pairs[] = {"pattern", "ball.%04d.ply", NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {.output = in_folder("visible"),
                                  .n_frames = 1,
                                  .values = &values,
                                  .source = "\xc3\xa4\nelement vertex 9"};
    struct spin_splats s = {0};
    struct spin_ply ply;

    make_frame(&s, 7, 0);
    ok(run(&job, &s, 3) == SPIN_OK, "writes with --pattern");
    if (!ok(spin_ply_open(in_folder("visible/ball.0003.ply"), &ply) == SPIN_OK, "under that name"))
        return;
    ok(ply.n_comments == 3 && strcmp(ply.comment[1], "source \xc3\xa4_element vertex 9") == 0,
       "a name cannot add lines, and keeps its letters");
    spin_ply_close(&ply);
    spin_splats_free(&s);
}

static void test_empty_frame(void)
{
    struct spin_export_job job = {.output = in_folder("none"), .n_frames = 1};
    struct spin_splats s = {0};
    struct spin_ply ply;

    make_frame(&s, 0, 0);
    ok(run(&job, &s, 0) == SPIN_OK &&
           spin_ply_open(in_folder("none/frame_00000.ply"), &ply) == SPIN_OK &&
           ply.element[0].count == 0 && ply.element[0].n_properties == 17,
       "writes an empty frame");
    spin_ply_close(&ply);
    spin_splats_free(&s);
}

static void test_options(void)
{
    static const char *const bad[][2] = {
        {"pattern", "frame.ply"},
        {"pattern", "%d_%d.ply"},
        {"pattern", "a/%d.ply"},
        {"pattern", "%s.ply"},
        {"pattern", "%0d.ply"},
        {"pattern", "%n"},
        {"pattern", "%05d%%.ply"},
        {"sh", "4"},
        {"sh", "11"},
        {"sh", ""},
        {"pattern", "%012d.ply"},
    };

    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        const char *pairs[] = {bad[i][0], bad[i][1], NULL};
        struct spin_plugin_values values = {pairs};
        struct spin_export_job job = {.output = in_folder("never"), .values = &values};
        void *self = NULL;

        ok(spin_exporter_ply.begin(&job, &self) == SPIN_E_USAGE && !self &&
               strstr(spin_last_error(), bad[i][0]),
           "refuses --%s '%s'", bad[i][0], bad[i][1]);
    }
    ok(!spin_path_exists(in_folder("never")), "and makes no folder");
}

static void test_existing(void)
{
    struct spin_export_job job = {.output = in_folder("twice"), .n_frames = 1};
    struct spin_splats s = {0};
    char **names = NULL;
    size_t n = 0;

    make_frame(&s, 3, 0);
    ok(spin_folder_make(job.output) == SPIN_OK && run(&job, &s, 1) == SPIN_OK,
       "takes an empty folder");
    ok(run(&job, &s, 1) == SPIN_E_IO && strstr(spin_last_error(), "--force") &&
           strstr(spin_last_error(), job.output),
       "refuses a folder with files, and names --force");
    job.force = true;
    ok(run(&job, &s, 1) == SPIN_OK, "overwrites when told to");
    ok(spin_folder_list(job.output, &names, &n) == SPIN_OK && n == 2, "leaves no other file");
    spin_folder_list_free(names);
    job.output = in_folder("twice/sequence.json");
    ok(run(&job, &s, 1) == SPIN_E_IO && strstr(spin_last_error(), "not a folder"),
       "refuses a file as folder");
    spin_splats_free(&s);
}

/* A folder has the name of a frame's file: the frame fails, nothing of it is left, other files
 * are kept. */
static void test_failure(void)
{
    struct spin_export_job job = {.output = in_folder("broken"), .force = true};
    struct spin_splats s = {0};
    char **names = NULL;
    size_t n = 0;

    make_frame(&s, 3, 0);
    ok(spin_folder_make(in_folder("broken/frame_00001.ply")) == SPIN_OK,
       "puts a folder in the way");
    ok(run(&job, &s, 1) != SPIN_OK, "fails when a file cannot be written");
    ok(spin_folder_list(job.output, &names, &n) == SPIN_OK && n == 1,
       "leaves no half-written file");
    spin_folder_list_free(names);
    spin_splats_free(&s);
}

static void test_abort(void)
{
    struct spin_export_job job = {.output = in_folder("aborted")};
    void *self = NULL;

    ok(spin_exporter_ply.begin(&job, &self) == SPIN_OK && spin_path_is_folder(job.output),
       "makes its folder");
    spin_exporter_ply.abort(self);
    ok(!spin_path_exists(job.output), "removes it when nothing came");
}

/* The figure is printed and not tested, since disks differ. */
static void test_speed(void)
{
    enum { N = 100000 };
    struct spin_export_job job = {.output = in_folder("speed"), .sh_degree = 3};
    struct spin_splats s = {0};
    double start;

    make_frame(&s, N, 3);
    start = spin_now_s();
    ok(run(&job, &s, 0) == SPIN_OK, "writes a large frame");
    printf("# %.2f GB/s to disk\n", N * 248.0 / (spin_now_s() - start) / 1e9);
    spin_splats_free(&s);
}

TAP_MAIN
{
    folder = check_folder();
    spin_log_set_level(-2);
    for (int from = 0; from <= 3; from++)
        test_degree(from, "keep", from);
    test_degree(3, "0", 0);
    test_degree(3, "2", 2);
    test_degree(0, "3", 3);
    test_degree(1, "2", 2);
    test_edges();
    test_pattern();
    test_empty_frame();
    test_options();
    test_existing();
    test_failure();
    test_abort();
    test_speed();
}
