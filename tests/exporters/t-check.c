/* --check of every exporter whose files can be read back: few bits cause a small loss, and a
 * damaged file is an error.
 * K: export check ply gltf splat compressed-ply spz sog */
#include "base/log.h"
#include "exporters/lib/splat_rows.h"
#include "formats/tsog.h"
#include "tests/exporters/frame.h"

enum { FRAMES = 3 };
extern const struct spin_exporter spin_exporter_tsog;

static size_t rows[FRAMES] = {600, 0, 600};
static bool shares;        /* every third row is the same in all frames */
static const char *damage; /* this file, once all are written */
static float aside;        /* offset of all splats */
static bool written;
static size_t n_lost;    /* splats that each frame lacks when it is read again */
static const char *with; /* by another; NULL: bits of it are turned over */

static void make(int f, struct spin_splats *s)
{
    struct spin_splats all = {0};

    make_frame(s, rows[f], 2, 11 + (uint32_t)f);
    make_frame(&all, rows[f], 2, 99);
    for (size_t i = 0; i < rows[f] && shares; i += 3) {
        memcpy(s->means + 3 * i, all.means + 3 * i, 3 * sizeof(float));
        memcpy(s->quats + 4 * i, all.quats + 4 * i, 4 * sizeof(float));
        memcpy(s->log_scales + 3 * i, all.log_scales + 3 * i, 3 * sizeof(float));
        memcpy(s->sh + 27 * i, all.sh + 27 * i, 27 * sizeof(float));
        s->logit_opacities[i] = all.logit_opacities[i];
    }
    for (size_t i = 0; i < 3 * rows[f]; i++)
        s->means[i] += aside;
    spin_splats_free(&all);
}

static void copy_over(const char *from, const char *to)
{
    struct spin_map map;
    FILE *file;

    if (spin_map_open(from, &map) != SPIN_OK || !(file = fopen(to, "wb")) ||
        fwrite(map.data, 1, map.size, file) != map.size || fclose(file) != 0)
        exit(1);
    spin_map_close(&map);
}

/* The exponent of a float in the middle of the positions. */
static void turn_bits(const char *path)
{
    FILE *file = fopen(path, "r+b");
    long at = 1;
    int c;

    if (!file || fseek(file, 0, SEEK_END) != 0)
        exit(1);
    at = ftell(file) / 2 / 4 * 4 + 3;
    fseek(file, at, SEEK_SET);
    c = getc(file);
    fseek(file, at, SEEK_SET);
    putc(c ^ 0x43, file);
    fclose(file);
}

static spin_status again(void *context, int frame, const struct spin_splats **out)
{
    static struct spin_splats s;

    (void)context;
    if (written && damage && with)
        copy_over(with, damage);
    else if (written && damage)
        turn_bits(damage);
    written = false;
    make(frame, &s);
    s.n -= s.n < n_lost ? 0 : n_lost;
    *out = &s;
    return SPIN_OK;
}

static spin_status export_clip(const struct spin_exporter *exporter, const char *output,
                               const char *const *pairs, struct spin_export_check *check)
{
    struct spin_plugin_values values = {pairs};
    struct spin_export_report report = {0};
    struct spin_export_job job = {.output = output,
                                  .force = true,
                                  .n_frames = FRAMES,
                                  .sh_degree = 2,
                                  .values = &values,
                                  .counts = rows,
                                  .report = &report,
                                  .check = true,
                                  .again = again};
    struct spin_splats s = {0};
    void *self = NULL;
    spin_status status;

    written = false;
    status = exporter->begin(&job, &self);
    for (int f = 0; f < FRAMES && status == SPIN_OK; f++) {
        struct spin_frame_info info = {.number = f, .time = f, .n = rows[f]};

        make(f, &s);
        status = exporter->frame(self, f, &info, &s);
        if (status != SPIN_OK)
            exporter->abort(self);
    }
    written = true;
    if (status == SPIN_OK)
        status = exporter->end(self);
    *check = report.check;
    spin_splats_free(&s);
    return status;
}

/* most: upper limits for positions, log scales, rotations (degrees), opacities, colours and SH;
 * 0: lossless. */
static void test_format(const char *name, const char *file, const char *ending,
                        const char *const *pairs, const double most[6])
{
    const struct spin_exporter *exporter = NULL;
    struct spin_export_check check;
    char output[500], first[600], last[600];
    bool good;

    for (int i = 0; spin_exporters[i]; i++)
        if (strcmp(spin_exporters[i]->name, name) == 0)
            exporter = spin_exporters[i];
    snprintf(output, sizeof output, "%s", in_folder(file));
    snprintf(first, sizeof first, "%s/frame_00000.%s", output, ending);
    snprintf(last, sizeof last, "%s/frame_00002.%s", output, ending);
    damage = NULL;
    good = exporter && export_clip(exporter, output, pairs, &check) == SPIN_OK;
    if (!good && strstr(spin_last_error(), "libwebp")) {
        printf("# no libwebp: %s is not tried\n", name);
        return;
    }
    if (!ok(good, "%s: what was written is there: %s", name, spin_last_error()))
        return;
    ok(check.frames == FRAMES && check.splats == 1200 + rows[1],
       "%s: all frames, the empty one too", name);
    for (int p = 0; p < 6; p++)
        ok(most[p] > 0 ? check.largest[p] > most[p] / 20 && check.largest[p] <= most[p] &&
                             check.rms[p] > 0 && check.rms[p] < check.largest[p]
                       : check.largest[p] <= 2e-5,
           "%s: error %d is %g", name, p, check.largest[p]);
    with = *ending ? first : NULL;
    damage = *ending ? last : output;
    ok(export_clip(exporter, output, pairs, &check) == SPIN_E_IO &&
           strstr(spin_last_error(), "check: ") && strstr(spin_last_error(), output),
       "%s: a damaged file is an error: %s", name, spin_last_error());
    ok(!*ending || (check.largest[0] > 1 && check.largest[2] > 10 && check.largest[4] > 0.1),
       "%s: and its errors are high", name);
}

/* Returns the share of splats of a TSOG that do not follow the one before along the Morton curve in
 * the bounding box of all splats; 1 on failure. */
static double descents(const char *path)
{
    float box[6] = SPIN_SORT_ROWS_NO_BOX;
    struct spin_splats_4d s = {0};
    struct spin_tsog tsog;
    struct spin_map map;
    size_t n = 0, n_all;

    if (spin_map_open(path, &map) != SPIN_OK)
        return 1;
    if (spin_tsog_read(map.data, map.size, &tsog, &s) != SPIN_OK)
        s.n = 0;
    n_all = s.n;
    for (size_t i = 0; i < s.n; i++)
        spin_sort_rows_widen(box, s.centres + 3 * i);
    for (size_t i = 1; i < s.n; i++)
        n += spin_sort_rows_place_key(box, s.centres + 3 * i) <
             spin_sort_rows_place_key(box, s.centres + 3 * (i - 1));
    spin_map_close(&map);
    spin_splats_4d_free(&s);
    return n_all > 1 ? (double)n / (double)n_all : 1;
}

/* A TSOG contains the splats of all frames in one list. */
static void test_tsog(void)
{
    static const size_t counts[2][FRAMES] = {{0, 600, 600}, {600, 0, 600}};
    static const char *const plain[] = {NULL};
    static const double most[6] = {0.0005, 0.04, 1, 0.002, 0.01, 1}; /* few SH vectors */
    struct spin_export_check check;
    char output[500];
    double share;

    snprintf(output, sizeof output, "%s", in_folder("clip.tsog"));
    damage = NULL;
    for (int k = 0; k < 2; k++) {
        spin_status status;

        memcpy(rows, counts[k], sizeof rows);
        status = export_clip(&spin_exporter_tsog, output, plain, &check);
        if (status != SPIN_OK && strstr(spin_last_error(), "libwebp")) {
            printf("# no libwebp: tsog is not tried\n");
            return;
        }
        ok(status == SPIN_OK && check.frames == FRAMES && check.splats == 1200,
           "tsog: frame %d is empty: %s", k, status == SPIN_OK ? "" : spin_last_error());
        for (int p = 0; p < 6; p++)
            ok(check.largest[p] > most[p] / 50 && check.largest[p] <= most[p],
               "tsog: error %d is %g", p, check.largest[p]);
    }
    aside = 50;
    share =
        export_clip(&spin_exporter_tsog, output, plain, &check) == SPIN_OK ? descents(output) : 1;
    ok(share < 0.02, "tsog: in Morton order, also far from the origin (%g)", share);
    aside = 0;
    n_lost = 1;
    ok(export_clip(&spin_exporter_tsog, output, plain, &check) == SPIN_E_IO &&
           strstr(spin_last_error(), "frame 0 of the export has changed"),
       "tsog: a frame loses a splat before the second pass: %s", spin_last_error());
    n_lost = 0;
}

TAP_MAIN
{
    static const double none[6] = {0};
    static const char *const version_3[] = {"spz-version", "3", NULL};
    static const char *const apart[] = {"still-apart", "", NULL};
    static const char *const plain[] = {NULL};

    spin_log_set_level(-2);
    test_format("ply", "ply", "ply", plain, none);
    test_format("gltf", "gltf", "glb", plain, none);
    test_format("gltf", "clip.glb", "", plain, none);
    test_format("gltf", "apart.glb", "", apart, none);
    shares = true;
    rows[1] = 600;
    test_format("gltf", "mixed.glb", "", apart, none);
    shares = false;
    rows[1] = 0;
    test_format("splat", "splat", "splat", plain, (double[6]){0, 0, 1, 0.002, 0.002, 0});
    test_format("compressed-ply", "compressed", "compressed.ply", plain,
                (double[6]){0.005, 0.004, 0.25, 0.002, 0.002, 0.016});
    test_format("spz", "spz", "spz", plain, (double[6]){0.00022, 0.032, 0.25, 0.002, 0.004, 0.063});
    test_format("spz", "spz3", "spz", version_3,
                (double[6]){0.00022, 0.032, 0.25, 0.002, 0.004, 0.063});
    test_format("sog", "sog", "sog", plain, (double[6]){0.0002, 0.04, 1, 0.002, 0.006, 0.006});
    test_tsog();
}
