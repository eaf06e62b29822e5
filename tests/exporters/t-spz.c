/* K: spz export threads */
#include <zlib.h>

#include <sys/wait.h>
#include <unistd.h>

#include "base/log.h"
#include "io/compress.h"
#include "tests/exporters/frame.h"

extern const struct spin_exporter spin_exporter_spz;

struct spz {
    unsigned char *bytes;
    size_t n_bytes, n;
    int degree, fraction;
};

static uint32_t u32_at(const unsigned char *at)
{
    return at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static int load(const char *path, struct spz *out)
{
    gzFile file = gzopen(path, "rb");
    size_t room = 8 << 20;
    int got;

    *out = (struct spz){.bytes = malloc(room)};
    if (!file)
        return 0;
    got = gzread(file, out->bytes, (unsigned)room);
    out->n_bytes = got > 0 ? (size_t)got : 0;
    got = gzclose(file);
    if (got != Z_OK || out->n_bytes < 16 || u32_at(out->bytes) != 0x5053474e ||
        u32_at(out->bytes + 4) != 3 || out->bytes[14] != 0 || out->bytes[15] != 0)
        return 0;
    out->n = u32_at(out->bytes + 8);
    out->degree = out->bytes[12];
    out->fraction = out->bytes[13];
    return out->n_bytes ==
           16 + out->n * (size_t)(20 + 3 * ((out->degree + 1) * (out->degree + 1) - 1));
}

/* Row i as Niantic's library decodes it. */
static struct want decode(const struct spz *f, size_t i)
{
    const unsigned char *place = f->bytes + 16 + 9 * i, *alpha = f->bytes + 16 + 9 * f->n + i;
    const unsigned char *colour = f->bytes + 16 + 10 * f->n + 3 * i;
    const unsigned char *scale = f->bytes + 16 + 13 * f->n + 3 * i;
    uint32_t word = u32_at(f->bytes + 16 + 16 * f->n + 4 * i);
    int largest = (int)(word >> 30), field = 0;
    double xyzw[4], rest = 1;
    struct want w;

    for (int k = 0; k < 3; k++) {
        int32_t fixed = place[3 * k] | place[3 * k + 1] << 8 | place[3 * k + 2] << 16;

        fixed -= fixed & 0x800000 ? 0x1000000 : 0;
        w.place[k] = ldexp(fixed, -f->fraction);
        w.dc[k] = (colour[k] / 255.0 - 0.5) / 0.15;
        w.log_scale[k] = scale[k] / 16.0 - 10;
    }
    w.opacity = *alpha / 255.0;
    for (int k = 0; k < 4; k++) {
        uint32_t ten;

        if (k == largest)
            continue;
        ten = word >> (20 - 10 * field++) & 1023;
        xyzw[k] = (ten & 512 ? -1 : 1) * (double)(ten & 511) / 511 * sqrt(0.5);
        rest -= xyzw[k] * xyzw[k];
    }
    xyzw[largest] = sqrt(fmax(rest, 0));
    for (int k = 0; k < 4; k++)
        w.q[k] = xyzw[(k + 3) % 4];
    return w;
}

static int sh_is_right(const struct spz *f, size_t i, const struct spin_splats *s, int turned)
{
    static const char signs[] = "+--+-++-+-+--+-+";
    int n = (f->degree + 1) * (f->degree + 1), n_from = (s->sh_degree + 1) * (s->sh_degree + 1);
    const unsigned char *byte = f->bytes + 16 + 20 * f->n + i * (size_t)(3 * n - 3);
    int good = 1;

    for (int k = 1; k < n; k++) {
        for (int c = 0; c < 3; c++) {
            double got = (*byte - 128) / 128.0, want = 0, step = k < 4 ? 8 : 16;

            if (k < n_from)
                want = s->sh[(i * (size_t)n_from + (size_t)k) * 3 + (size_t)c];
            if (turned && signs[k] == '-')
                want = -want;
            good &= fabs(got - want) < step / 128 * 0.501;
            good &= *byte == 255 || *byte % (int)step == 0;
            byte++;
        }
    }
    return good;
}

static void test_values(int from, const char *sh, int to, const char *axes)
{
    const char *pairs[] = {"sh", sh, "axes", axes, "spz-version", "3", NULL};
    struct spin_plugin_values values = {pairs};
    int turned = strcmp(axes, "rub") == 0, good[6] = {1, 1, 1, 1, 1, 1};
    char name[64];
    struct spin_splats s = {0};
    struct spz f;

    snprintf(name, sizeof name, "d%d%s%s", from, sh, axes);
    struct spin_export_job job = {
        .output = in_folder(name), .n_frames = 1, .sh_degree = from, .values = &values};
    make_frame(&s, 10000, from, 21);
    ok(run(&spin_exporter_spz, &job, &s, 12) == SPIN_OK, "writes degree %d as %s, axes %s", from,
       sh, axes);
    strcat(name, "/frame_00012.spz");
    if (!ok(load(in_folder(name), &f) && f.n == s.n && f.degree == to && f.fraction == 12,
            "a whole gzip of version 3"))
        return;
    for (size_t i = 0; i < s.n; i++) {
        struct want got = decode(&f, i), want = want_of(&s, i);

        if (turned) { /* half a turn about x: (0, 1, 0, 0) times q */
            double q[4] = {-want.q[1], want.q[0], -want.q[3], want.q[2]};

            memcpy(want.q, q, sizeof q);
            want.place[1] = -want.place[1];
            want.place[2] = -want.place[2];
        }
        for (int k = 0; k < 3; k++) {
            good[0] &= fabs(got.place[k] - want.place[k]) < 0.501 / 4096;
            good[1] &= fabs(got.log_scale[k] - want.log_scale[k]) < 0.501 / 16;
            good[2] &= fabs(got.dc[k] - want.dc[k]) < 0.501 / 255 / 0.15;
        }
        good[3] &= fabs(got.opacity - want.opacity) < 0.00197;
        good[4] &= turned || degrees_between(got.q, want.q) < 0.3;
        good[5] &= sh_is_right(&f, i, &s, turned);
    }
    ok(good[0], "places are within half a step, in the source's order");
    ok(good[1], "log scales are within half a step");
    ok(good[2], "colours are within half a step");
    ok(good[3], "opacities are within half a step");
    ok(good[4], "rotations are within 0.3 degrees");
    ok(good[5], "sh is in steps of 8 and 16");
    free(f.bytes);
    spin_splats_free(&s);
}

static void rotate(const double q[4], const double v[3], double out[3])
{
    double t[3] = {2 * (q[2] * v[2] - q[3] * v[1]), 2 * (q[3] * v[0] - q[1] * v[2]),
                   2 * (q[1] * v[1] - q[2] * v[0])};

    out[0] = v[0] + q[0] * t[0] + q[2] * t[2] - q[3] * t[1];
    out[1] = v[1] + q[0] * t[1] + q[3] * t[0] - q[1] * t[2];
    out[2] = v[2] + q[0] * t[2] + q[1] * t[1] - q[2] * t[0];
}

static const char *const pairs_3[] = {"spz-version", "3", NULL};
static const struct spin_plugin_values version_3 = {pairs_3};

/* The axes of each ellipsoid, rotated about x, equal those of the file up to sign. */
static void test_turned_rotation(void)
{
    static const char *const pairs[] = {"axes", "rub", "spz-version", "3", NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {.output = in_folder("rub"), .n_frames = 1, .values = &values};
    struct spin_splats s = {0};
    struct spz f;
    double worst = 1;

    make_frame(&s, 500, 0, 4);
    if (!ok(run(&spin_exporter_spz, &job, &s, 0) == SPIN_OK &&
                load(in_folder("rub/frame_00000.spz"), &f),
            "writes turned axes"))
        return;
    for (size_t i = 0; i < s.n; i++) {
        struct want got = decode(&f, i), want = want_of(&s, i);

        for (int axis = 0; axis < 3; axis++) {
            double e[3] = {axis == 0, axis == 1, axis == 2}, a[3], b[3];

            rotate(want.q, e, a);
            rotate(got.q, e, b);
            worst = fmin(worst, fabs(a[0] * b[0] - a[1] * b[1] - a[2] * b[2]));
        }
    }
    ok(worst > 0.99999, "ellipsoids are turned with their places (%.7f)", worst);
    free(f.bytes);
    spin_splats_free(&s);
}

static void test_far(void)
{
    struct spin_export_job job = {.output = in_folder("far"), .n_frames = 3, .values = &version_3};
    struct spin_frame_info info = {0};
    struct spin_splats s = {0};
    struct spz f;
    void *self = NULL;

    make_frame(&s, 20, 0, 4);
    ok(spin_exporter_spz.begin(&job, &self) == SPIN_OK &&
           spin_exporter_spz.frame(self, 0, &info, &s) == SPIN_OK,
       "writes a near frame");
    s.means[4] = -5000;
    info.number = 1;
    ok(spin_exporter_spz.frame(self, 1, &info, &s) == SPIN_OK, "and a far one");
    s.means[4] = 0;
    info.number = 2;
    ok(spin_exporter_spz.frame(self, 2, &info, &s) == SPIN_OK, "and a near one");
    s.means[4] = 1e9f;
    info.number = 3;
    ok(spin_exporter_spz.frame(self, 2, &info, &s) == SPIN_E_UNSUPPORTED &&
           strstr(spin_last_error(), "8388606"),
       "what no step can hold is an error");
    spin_exporter_spz.abort(self);
    ok(load(in_folder("far/frame_00001.spz"), &f) && f.fraction == 10,
       "the far frame has fewer bits behind the point");
    near(decode(&f, 1).place[1], -5000, 0.0005, "the far place is right");
    free(f.bytes);
    ok(load(in_folder("far/frame_00002.spz"), &f) && f.fraction == 10,
       "frames after it keep that step");
    free(f.bytes);
    ok(!spin_path_exists(in_folder("far/frame_00003.spz")), "the frame that failed is not there");
    spin_splats_free(&s);
}

static void test_edges(void)
{
    struct spin_export_job job = {
        .output = in_folder("edges"), .n_frames = 1, .force = true, .values = &version_3};
    struct spin_splats s = {0};
    struct spz f;

    make_frame(&s, 14, 3, 2);
    job.sh_degree = 3;
    s.logit_opacities[1] = INFINITY;
    ok(run(&spin_exporter_spz, &job, &s, 0) == SPIN_OK &&
           load(in_folder("edges/frame_00000.spz"), &f) && f.n == 14,
       "writes an infinite logit");
    near(decode(&f, 1).opacity, 1, 0, "an infinite logit is an opacity of 1");
    free(f.bytes);
    make_frame(&s, 0, 3, 2);
    ok(run(&spin_exporter_spz, &job, &s, 0) == SPIN_OK &&
           load(in_folder("edges/frame_00000.spz"), &f) && f.n == 0,
       "writes an empty frame");
    free(f.bytes);
    spin_splats_free(&s);
}

/* A whole file; free it. */
static unsigned char *slurp(const char *path, size_t *n)
{
    FILE *file = fopen(path, "rb");
    unsigned char *bytes = malloc(4 << 20);

    *n = file ? fread(bytes, 1, 4 << 20, file) : 0;
    if (file)
        fclose(file);
    return bytes;
}

static uint64_t u64_at(const unsigned char *at)
{
    return u32_at(at) | (uint64_t)u32_at(at + 4) << 32;
}

/* The streams of version 4 equal those of version 3, each as a zstd frame behind the table of
 * contents. */
static void test_version_4(int degree, size_t n_rows)
{
    struct spin_export_job job = {.output = in_folder("v4"),
                                  .n_frames = 1,
                                  .sh_degree = degree,
                                  .antialias = true,
                                  .force = true};
    int n_streams = n_rows == 0 ? 0 : degree == 0 ? 5 : 6;
    size_t n = 0, at = 32 + 16 * (size_t)n_streams, at_3 = 16;
    struct spin_splats s = {0};
    unsigned char *bytes, *stream = malloc(1 << 20);
    struct spz three;
    int same = 1;

    make_frame(&s, n_rows, degree, 6);
    if (!ok(run(&spin_exporter_spz, &job, &s, 0) == SPIN_OK, "writes version 4 of degree %d: %s",
            degree, spin_last_error()))
        return;
    job.output = in_folder("v3");
    job.values = &version_3;
    job.antialias = false; /* load() knows no flags */
    ok(run(&spin_exporter_spz, &job, &s, 0) == SPIN_OK &&
           load(in_folder("v3/frame_00000.spz"), &three),
       "and version 3 by itself");
    bytes = slurp(in_folder("v4/frame_00000.spz"), &n);
    ok(n >= 32 && u32_at(bytes) == 0x5053474e && u32_at(bytes + 4) == 4 &&
           u32_at(bytes + 8) == n_rows && bytes[12] == degree && bytes[13] == 12 &&
           bytes[14] == 1 && bytes[15] == n_streams && u32_at(bytes + 16) == 32 &&
           u64_at(bytes + 20) == 0 && u32_at(bytes + 28) == 0,
       "the header in the clear");
    for (int i = 0; i < n_streams && same; i++) {
        size_t packed = (size_t)u64_at(bytes + 32 + 16 * i),
               length = (size_t)u64_at(bytes + 40 + 16 * i);

        same = length <= three.n_bytes - at_3 && packed <= n - at &&
               spin_zstd_read(bytes + at, packed, stream, length) == SPIN_OK &&
               !memcmp(stream, three.bytes + at_3, length);
        at += packed;
        at_3 += length;
    }
    ok(same && at == n && at_3 == three.n_bytes, "the same streams, to the end of the file");
    free(bytes);
    free(stream);
    free(three.bytes);
    spin_splats_free(&s);
}

/* In a process of its own, since the library is searched only once. */
static void test_without_zstd(void)
{
    struct spin_export_job job = {.output = in_folder("nozstd"), .n_frames = 1};
    int status = 0;
    pid_t child = fork();

    if (child == 0) {
        void *self = NULL;

        setenv("SPIN_ZSTD", "/no/such.so", 1);
        _exit(spin_exporter_spz.begin(&job, &self) == SPIN_E_UNSUPPORTED &&
                      strstr(spin_last_error(), "libzstd") &&
                      strstr(spin_last_error(), "--spz-version 3")
                  ? 0
                  : 1);
    }
    ok(child > 0 && waitpid(child, &status, 0) == child && status == 0 &&
           !spin_path_exists(in_folder("nozstd")),
       "without the library version 4 is refused, and no folder made");
}

TAP_MAIN
{
    static const char *const bad[][2] = {
        {"axes", "gltf"}, {"level", "0"}, {"level", "10"}, {"spz-version", "2"}, {"sh", "-1"}};

    spin_log_set_level(-2);
    test_without_zstd();
    test_version_4(0, 500);
    test_version_4(3, 9000);
    test_version_4(2, 0);
    test_values(0, "keep", 0, "source");
    test_values(3, "keep", 3, "source");
    test_values(1, "3", 3, "rub");
    test_values(3, "2", 2, "rub");
    test_turned_rotation();
    test_far();
    test_edges();
    check_folder_rules(&spin_exporter_spz, "frame_00001.spz", bad, sizeof bad / sizeof bad[0]);
}
