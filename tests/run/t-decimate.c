/* --decimate: what a splat counts for, which are kept, and how much that loses. Bundles of which it
 * is known. K: export decimate */
#include <glob.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <unistd.h>

#include "io/ply.h"
#include "run/decimate.h"
#include "run/run.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { FRAMES = 3, SPLATS = 200 };
static char bundle[600], folder[700];
static int n_crop; /* of `crop` that exports get */
static double crop[6];
static const unsigned columns = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES;

/* ---- The goal -------------------------------------------------------------------------------- */

static void check_goals(void)
{
    static const struct {
        const char *text;
        enum spin_decimate_unit unit;
        double amount;
    } good[] = {{"5000", SPIN_DECIMATE_SPLATS, 5000}, {"12.5%", SPIN_DECIMATE_SHARE, 0.125},
                {"100%", SPIN_DECIMATE_SHARE, 1},     {"2MB", SPIN_DECIMATE_BYTES, 2e6},
                {"1.5kB", SPIN_DECIMATE_BYTES, 1500}, {"40dB", SPIN_DECIMATE_DB, 40}};
    static const char *const bad[] = {"",    "0",     "-5",    "2.5",  "101%", "%",
                                      "nan", "infMB", "5000x", "2 MB", "1e10", "0%"};
    struct spin_decimate_goal goal;

    for (size_t i = 0; i < sizeof good / sizeof *good; i++)
        ok(spin_decimate_parse(good[i].text, &goal) == SPIN_OK && goal.unit == good[i].unit &&
               fabs(goal.amount - good[i].amount) < 1e-9,
           "'%s' is understood", good[i].text);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        ok(spin_decimate_parse(bad[i], &goal) == SPIN_E_USAGE, "'%s' is not", bad[i]);
}

/* ---- What a splat counts for ----------------------------------------------------------------- */

static void fill(struct spin_splats *s, size_t i, float x, float y, float z, float log_scale,
                 float logit, float sh)
{
    const float place[3] = {x, y, z};

    for (size_t c = 0; c < 3; c++) {
        s->means[3 * i + c] = place[c];
        s->log_scales[3 * i + c] = log_scale;
        s->sh[3 * i + c] = sh;
    }
    for (size_t c = 0; c < 4; c++)
        s->quats[4 * i + c] = c == 0;
    s->logit_opacities[i] = logit;
}

/* White splats on black, so that the image is the sum of their contributions. Two more splats are
 * invisible: one behind nearly opaque splats, and one behind the camera. */
static void check_weights(void)
{
    enum { N = 6, SIDE = 64 };
    static const float black[3] = {0};
    static float image[3 * SIDE * SIDE];
    const struct spin_camera camera = {.width = SIDE,
                                       .height = SIDE,
                                       .fx = 60,
                                       .fy = 60,
                                       .cx = 32,
                                       .cy = 32,
                                       .w2c = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}};
    struct spin_splats s = {0};
    struct spin_device device;
    struct spin_player player;
    float weight[N];
    double drawn = 0, sum = 0;

    if (!ok(spin_device_open("cpu", 1, &device) == SPIN_OK &&
                spin_player_open(&player, &device, NULL, SPIN_FROM_SOURCE) == SPIN_OK &&
                spin_splats_reserve(&s, N, columns, 0) == SPIN_OK,
            "a player"))
        return;
    player.keeps_contributions = true;
    for (size_t i = 0; i < 3; i++)
        fill(&s, i, 0, 0, 3 + 0.1f * (float)i, -1, 8, 1.7724539f);
    fill(&s, 3, 0, 0, 5, -3, 2, 1.7724539f);
    fill(&s, 4, 0, 0, -3, -1, 8, 1.7724539f);
    fill(&s, 5, 1, 0.7f, 4, -2, 0, 1.7724539f);
    ok(spin_player_show_splats(&player, &s) == SPIN_OK &&
           spin_player_draw(&player, &camera, black, image) == SPIN_OK &&
           spin_player_contributions(&player, weight) == SPIN_OK,
       "a picture is weighed");
    for (size_t i = 0; i < SIDE * SIDE; i++)
        drawn += (double)image[i];
    for (size_t i = 0; i < N; i++)
        sum += (double)weight[i];
    near(sum / drawn, 1, 1e-4, "shares add up to the picture");
    ok(weight[0] > 100 && weight[1] > weight[2] && weight[5] > 10, "those that are seen count");
    ok(weight[3] < 1e-3f && weight[4] == 0, "what is hidden, or behind, does not");
    spin_splats_free(&s);
    spin_player_close(&player);
    spin_device_close(&device);
}

/* ---- Which are kept -------------------------------------------------------------------------- */

/* Where row i comes in frame f, by size: the same places in frames 0 and 2, others in frame 1,
 * where row 0 is the smallest. */
static size_t place_of(int f, size_t i) { return f == 1 ? (SPLATS - i) % SPLATS : i * 37 % SPLATS; }

static const char *work;  /* a temporary folder */
static float spacing = 1; /* distance of neighbours in the bundle, in world units */

/* Row i of frame f has the colour i, or a gradual one if neighbours overlap. Frame 0: row 5 is NaN,
 * row 6 as large as the scene, row 7 faint. */
static void write_bundle(const char *name, bool identity, bool odd)
{
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta = {0};
    struct spin_splats s = {0};

    snprintf(bundle, sizeof bundle, "%s/%s.spin", work, name);
    if (spin_bundle_meta_reserve(&meta, FRAMES) != SPIN_OK ||
        spin_bundle_writer_open(bundle, false, false, &w) != SPIN_OK)
        exit(1);
    snprintf(meta.from, sizeof meta.from, "d3dgs");
    meta.columns = columns;
    meta.identity = identity;
    meta.n_source_frames = FRAMES;
    for (int f = 0; f < FRAMES; f++) {
        if (spin_splats_reserve(&s, SPLATS, columns, 0) != SPIN_OK)
            exit(1);
        for (size_t i = 0; i < SPLATS; i++)
            fill(&s, i, spacing * (float)(i % 20), spacing * (float)(i / 20), 0,
                 -2 - 0.01f * (float)place_of(f, i), 3,
                 spacing < 1 ? (float)(i % 20) / 10 - 1 : (float)i);
        if (odd && f == 0) {
            s.means[15] = NAN;
            s.log_scales[18] = 5;
            s.logit_opacities[7] = -5;
        }
        meta.frame[f] = (struct spin_frame_info){.number = f, .time = f, .n = SPLATS};
        meta.source_index[f] = f;
        if (spin_bundle_write_frame(&w, f, columns, 0, &s) != SPIN_OK)
            exit(1);
    }
    if (spin_bundle_writer_finish(&w, &meta, NULL) != SPIN_OK)
        exit(1);
    spin_bundle_meta_free(&meta);
    spin_splats_free(&s);
}

static spin_status decimate(const char *how, double min_opacity, const char *to,
                            struct spin_export_report *r)
{
    static int n;
    struct spin_export_options o = {.input = bundle,
                                    .output = folder,
                                    .to = to,
                                    .device = "cpu",
                                    .n_threads = 1,
                                    .min_opacity = min_opacity,
                                    .decimate = how};

    snprintf(folder, sizeof folder, "%s-%d", bundle, n++);
    o.n_crop = n_crop;
    memcpy(o.crop, crop, sizeof crop);
    return spin_export_clip(&o, r);
}

/* Rows of the bundle that frame f's PLY has: kept[i] is 1. Returns how many. */
static size_t rows_in(int f, unsigned char kept[SPLATS])
{
    float value[SPLATS];
    char path[800];
    struct spin_ply ply;
    size_t n = 0;

    memset(kept, 0, SPLATS);
    snprintf(path, sizeof path, "%s/frame_%05d.ply", folder, f);
    if (spin_ply_open(path, &ply) != SPIN_OK)
        return 0;
    n = (size_t)ply.element[0].count;
    if (n <= SPLATS)
        spin_ply_column(&ply, &ply.element[0], spin_ply_find(&ply.element[0], "f_dc_0"), value, 1);
    for (size_t k = 0; k < n && n <= SPLATS; k++)
        kept[(int)value[k]] = 1;
    spin_ply_close(&ply);
    return n;
}

static void check_frames(void)
{
    struct spin_export_report r;
    unsigned char kept[SPLATS];

    write_bundle("own", false, false);
    ok(decimate("50", 0, "ply", &r) == SPIN_OK && r.splats_mean == 50 &&
           r.decimated.before == SPLATS && r.decimated.after == 50 && !r.decimated.by_views,
       "50 of 200, by opacity and size");
    for (int f = 0; f < FRAMES; f++) {
        bool best = rows_in(f, kept) == 50;

        for (size_t i = 0; i < SPLATS; i++)
            best = best && kept[i] == (place_of(f, i) < 50);
        ok(best, "frame %d keeps its own 50 largest", f);
    }
    near(r.decimated.psnr, 17.3, 1, "what it loses in eight pictures, as it was measured");
    ok(r.decimated.n_pictures == 8, "from all around");
    ok(decimate("100%", 0, "ply", &r) == SPIN_OK && r.splats_mean == SPLATS &&
           r.decimated.psnr == HUGE_VAL,
       "all of them lose nothing");
    ok(decimate("1e-6%", 0, "ply", &r) == SPIN_OK && r.splats_mean == 1, "one is the least");
}

/* The colours of the rows of frame f's PLY; returns how many. */
static size_t colours_in(int f, float value[SPLATS])
{
    char path[800];
    struct spin_ply ply;
    size_t n = 0;

    snprintf(path, sizeof path, "%s/frame_%05d.ply", folder, f);
    if (spin_ply_open(path, &ply) != SPIN_OK)
        return 0;
    n = (size_t)ply.element[0].count;
    if (n <= SPLATS)
        spin_ply_column(&ply, &ply.element[0], spin_ply_find(&ply.element[0], "f_dc_0"), value, 1);
    spin_ply_close(&ply);
    return n;
}

/* Of 200 rows that overlap, 50 are left in each frame, some of which are several. */
static void check_identity(void)
{
    struct spin_export_report r;
    float colour[FRAMES][SPLATS];
    bool alike = true, merged = false;
    spin_status status;
    double psnr;

    spacing = 0.1f;
    write_bundle("same", true, false);
    status = decimate("25%", 0, "ply", &r);
    ok(status == SPIN_OK && r.decimated.after == 50, "rows that are one splat in all frames");
    psnr = r.decimated.psnr;
    for (int f = 0; f < FRAMES; f++)
        ok(colours_in(f, colour[f]) == 50, "frame %d keeps 50", f);
    for (int k = 0; k < 50; k++) {
        double tenth = 10 * ((double)colour[0][k] + 1);

        alike = alike && fabsf(colour[1][k] - colour[0][k]) < 0.2f && colour[2][k] == colour[0][k];
        merged = merged || fabs(tenth - round(tenth)) > 1e-3;
    }
    ok(alike, "the same rows of all frames");
    ok(merged, "some of which are several");
    write_bundle("unlike", false, false);
    status = decimate("25%", 0, "ply", &r);
    ok(status == SPIN_OK && r.decimated.psnr < psnr - 3,
       "without merging, as many lose more: %g and %g dB", r.decimated.psnr, psnr);
    spacing = 1;
}

static void check_left_out(void)
{
    struct spin_export_report r;
    unsigned char kept[SPLATS];

    write_bundle("odd", false, true);
    ok(decimate("50%", 0.1, "ply", &r) == SPIN_OK && r.left_out == 2,
       "what no viewer draws is left out as ever");
    ok(rows_in(0, kept) == 98 && !kept[5] && !kept[6] && !kept[7],
       "half of the others is kept in frame 0");
    ok(rows_in(1, kept) == 100, "and half of all in frame 1");
    ok(decimate("50%", 0, "splat", &r) == SPIN_OK && r.left_out == 2, "so it is in any format");
    ok(decimate("50%", 0, "images", &r) == SPIN_OK && fabs(r.splats_mean - 299 / 3.0) < 1e-9,
       "and in pictures, which leave out nothing by themselves");
}

static double bytes_in(const char *path)
{
    char pattern[800];
    struct stat st;
    double bytes = 0;
    glob_t g;

    snprintf(pattern, sizeof pattern, "%s/*", path);
    if (glob(pattern, 0, NULL, &g) != 0)
        return 0;
    for (size_t i = 0; i < g.gl_pathc; i++)
        bytes += stat(g.gl_pathv[i], &st) == 0 ? (double)st.st_size : 0;
    globfree(&g);
    return bytes;
}

static void set_crop(double x0, double x1)
{
    const double box[6] = {x0, -99, -99, x1, 99, 99};

    n_crop = 6;
    memcpy(crop, box, sizeof crop);
}

/* --crop leaves the left half of the grid. */
static void check_filters(void)
{
    struct spin_export_report r;
    unsigned char kept[SPLATS];

    write_bundle("cropped", false, true);
    set_crop(-1, 9.5);
    ok(decimate("25%", 0, "ply", &r) == SPIN_OK && r.filtered == 300 && r.left_out == 2,
       "a quarter of what --crop leaves");
    near(r.decimated.before, 298 / 3.0, 1e-9, "only what is drawn of that counts");
    for (int f = 0; f < FRAMES; f++) {
        size_t wanted = f == 0 ? 24 : 25, n = rows_in(f, kept);
        size_t largest_lost = SPLATS, smallest_kept = 0;

        for (size_t i = 0; i < SPLATS; i++) {
            bool in = i % 20 < 10 && !(f == 0 && (i == 5 || i == 6));

            if (kept[i] && (!in || place_of(f, i) > smallest_kept))
                smallest_kept = in ? place_of(f, i) : SPLATS;
            if (!kept[i] && in && place_of(f, i) < largest_lost)
                largest_lost = place_of(f, i);
        }
        ok(n == wanted && smallest_kept < largest_lost, "frame %d keeps the %zu largest of it", f,
           wanted);
    }
    write_bundle("cropped-same", true, false);
    ok(decimate("12kB", 0, "ply", &r) == SPIN_OK && r.decimated.n_tries > 1 && r.filtered == 300 &&
           bytes_in(folder) <= 12000 && bytes_in(folder) > 11000,
       "a size, where rows are one splat");
    near(r.splats_mean, (double)rows_in(1, kept), 0, "as many are said as are written");
    set_crop(50, 60);
    ok(decimate("50%", 0, "ply", &r) == SPIN_OK && r.filtered == 600 && r.splats_mean == 0,
       "nothing is left");
    ok(decimate("20dB", 0, "ply", &r) == SPIN_E_UNSUPPORTED, "and nothing loses 20 dB");
    n_crop = 0;
}

/* 4D splats of which row 3 is as large as the scene, to an exporter that leaves nothing out by
 * itself. */
static void check_4d(void)
{
    enum { ROWS = 20 };
    struct spin_splats_4d s = {0};
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta = {.from = "test", .n_source_frames = 2, .fps = 24};
    struct spin_export_report r;
    struct spin_ply ply;
    float scale[ROWS] = {0};
    size_t n = 0, n_dropped, n_large = 0;

    snprintf(bundle, sizeof bundle, "%s/4d.spin", work);
    if (spin_splats_4d_reserve(&s, ROWS, 1, 0, 0) != SPIN_OK ||
        spin_bundle_meta_reserve(&meta, 2) != SPIN_OK ||
        spin_bundle_writer_open(bundle, false, false, &w) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < ROWS; i++) {
        s.centres[3 * i] = (float)i;
        s.quats[4 * i] = 1;
        for (size_t c = 0; c < 3; c++)
            s.log_scales[3 * i + c] = i == 3 ? 6 : -1 - 0.1f * (float)i;
        s.logit_opacities[i] = 2;
        s.sigmas[i] = SPIN_FOREVER;
    }
    spin_splats_4d_finish(&s, &n_dropped, NULL);
    for (int f = 0; f < 2; f++) {
        meta.frame[f] = (struct spin_frame_info){.number = f, .time = f, .n = ROWS};
        meta.source_index[f] = f;
    }
    if (spin_bundle_write_4d(&w, &s, SPIN_ROUND_NOTHING, &meta) != SPIN_OK ||
        spin_bundle_writer_finish(&w, &meta, NULL) != SPIN_OK)
        exit(1);
    ok(decimate("5", 0, "ftgs", &r) == SPIN_OK && r.decimated.in_all &&
           r.decimated.before == ROWS - 1 && r.decimated.after == 5,
       "5 of the 19 4D splats that are not too large");
    if (spin_ply_open(folder, &ply) == SPIN_OK) {
        n = (size_t)ply.element[0].count;
        if (n <= ROWS)
            spin_ply_column(&ply, &ply.element[0], spin_ply_find(&ply.element[0], "scale_0"), scale,
                            1);
        spin_ply_close(&ply);
    }
    for (size_t i = 0; i < n && i < ROWS; i++)
        n_large += scale[i] > -0.9f || scale[i] < -1.55f;
    ok(n == 5 && n_large == 0, "the five largest of these are in the file");
    set_crop(9.5, 99);
    ok(decimate("5", 0, "ftgs", &r) == SPIN_OK && r.filtered == 10 && r.decimated.before == 10 &&
           r.splats_mean == 5,
       "5 of the 10 that --crop leaves");
    ok(decimate("100%", 0, "ftgs", &r) == SPIN_OK && r.filtered == 10 && r.splats_mean == 10,
       "or all of them");
    n_crop = 0;
    spin_bundle_meta_free(&meta);
    spin_splats_4d_free(&s);
}

/* A file of 100 bytes for each splat that is kept. */
static spin_status write_hundreds(void *context, const char *output)
{
    const struct spin_decimation *d = context;
    FILE *f = fopen(output, "w");

    if (!f || fprintf(f, "%0*d", (int)(100 * d->set[0].n_kept), 0) < 0 || fclose(f) != 0)
        exit(1);
    return SPIN_OK;
}

/* The refined frames have the source's rows backwards: in an equal number these are other splats.
 */
static void check_source(void)
{
    char out[700];
    uint64_t reached;
    int n_tries, wrong = 0;
    struct spin_export_options o = {.device = "cpu", .n_threads = 1};
    struct spin_clip_options c = {.range = o.range};
    static struct spin_clip clip;
    struct spin_bundle_writer w;
    struct spin_bundle_meta meta = {.from = "test", .columns = columns, .n_source_frames = 1};
    struct spin_splats s = {0}, part = {0};
    struct spin_device device;
    struct spin_player player;
    struct spin_row_filter filter = {0};
    struct spin_decimation d = {
        .clip = &clip, .frames = &player, .filter = &filter, .background = (const float[3]){0}};
    spin_json *extra =
        json_pack("{s:{s:[s,s,s,s,s],s:i,s:[{s:i}]}}", "refined", "columns", "means", "quats",
                  "log_scales", "logit_opacities", "sh", "sh_degree", 0, "frames", "n", 4);
    bool largest = true;

    snprintf(bundle, sizeof bundle, "%s/source.spin", check_folder());
    c.input = bundle;
    if (spin_bundle_meta_reserve(&meta, 1) != SPIN_OK ||
        spin_bundle_writer_open(bundle, false, false, &w) != SPIN_OK ||
        spin_splats_reserve(&s, 4, columns, 0) != SPIN_OK)
        exit(1);
    meta.frame[0].n = 4;
    for (int backwards = 0; backwards < 2; backwards++) {
        for (size_t i = 0; i < 4; i++) {
            size_t k = backwards ? 3 - i : i;

            fill(&s, i, (float)k, 0, 0, -1 - 0.1f * (float)k, 3, (float)k);
        }
        if ((backwards ? spin_bundle_write_refined(&w, 0, columns, &s)
                       : spin_bundle_write_frame(&w, 0, columns, 0, &s)) != SPIN_OK)
            exit(1);
    }
    if (!ok(spin_bundle_writer_finish(&w, &meta, extra) == SPIN_OK &&
                spin_clip_open(&c, &clip) == SPIN_OK &&
                spin_row_filter_open(&filter, &o, &clip, false) == SPIN_OK &&
                spin_device_open("cpu", 1, &device) == SPIN_OK &&
                spin_player_open(&player, &device, &clip.bundle, SPIN_FROM_REFINED) == SPIN_OK &&
                spin_decimation_open(&d) == SPIN_OK &&
                spin_decimation_choose(&d, SPIN_DECIMATE_SPLATS, 2) == SPIN_OK &&
                spin_bundle_frame(&clip.bundle, 0, columns, &s) == SPIN_OK &&
                (spin_decimation_attach(&d), true) &&
                spin_row_filter_source(&filter, 0, &s, &part) == SPIN_OK,
            "the source of refined frames, decimated with them: %s", spin_last_error()))
        return;
    for (size_t i = 0; i < part.n; i++)
        largest = largest && part.means[3 * i] < 1.5f;
    ok(part.n == 2 && largest, "keeps its own largest splats, not the rows of others");
    snprintf(out, sizeof out, "%s.out", bundle);
    for (int most = 100; most <= 410; most += 10)
        wrong += spin_decimation_choose_bytes(&d, most, out, write_hundreds, &d, &n_tries,
                                              &reached) != SPIN_OK ||
                 reached != 100 * d.set[0].n_kept || d.set[0].n_kept > (size_t)most / 100 ||
                 ((most % 100 >= 50 || most == 400) && d.set[0].n_kept < (size_t)most / 100);
    ok(wrong == 0 && n_tries == 1, "as many splats as fit, where each has 100 bytes");
    ok(spin_decimation_choose_bytes(&d, 99, out, write_hundreds, &d, &n_tries, &reached) ==
           SPIN_E_UNSUPPORTED,
       "none within 99: %s", spin_last_error());
    spin_decimation_close(&d);
    spin_player_close(&player);
    spin_device_close(&device);
    spin_row_filter_close(&filter);
    spin_clip_close(&clip);
    spin_splats_free(&s);
    spin_splats_free(&part);
    spin_bundle_meta_free(&meta);
}

/* ---- A size, a loss -------------------------------------------------------------------------- */

static void check_size(void)
{
    struct spin_export_report r;
    const struct timeval old[2] = {{1000, 0}, {1000, 0}};
    char left[800];
    glob_t g;
    spin_status status;

    write_bundle("size", true, false);
    snprintf(left, sizeof left, "%s.tmp.999999999", folder);
    mkdir(left, 0777);
    utimes(left, old);
    status = decimate("20kB", 0, "ply", &r);
    ok(status == SPIN_OK && r.decimated.n_tries > 1 && r.decimated.n_tries < 10,
       "a size: written %d times", r.decimated.n_tries);
    ok(bytes_in(folder) <= 20000 && bytes_in(folder) > 19000 &&
           bytes_in(folder) == (double)r.decimated.reached && r.decimated.reached == r.bytes,
       "the whole output has %.0f bytes", bytes_in(folder));
    ok(decimate("1GB", 0, "ply", &r) == SPIN_OK && r.splats_mean == SPLATS &&
           r.decimated.n_tries == 1,
       "where all fit all are written");
    ok(decimate("500B", 0, "ply", &r) == SPIN_E_UNSUPPORTED &&
           strstr(spin_last_error(), "smallest possible output has"),
       "a size that nothing has is refused");
    ok(access(folder, F_OK) != 0, "and nothing is written");
    snprintf(left, sizeof left, "%s*.tmp.*", bundle);
    ok(glob(left, 0, NULL, &g) == GLOB_NOMATCH, "no try is left, nor one of a killed export");
    status = decimate("25dB", 0, "ply", &r);
    ok(status == SPIN_OK && r.decimated.psnr >= 25 && r.decimated.psnr < 27 &&
           r.splats_mean < SPLATS && r.splats_mean > 1,
       "a loss: %.2f dB with %g splats", r.decimated.psnr, r.splats_mean);
}

TAP_MAIN
{
    spin_set_verbosity(-2);
    work = check_folder();
    check_goals();
    check_weights();
    check_frames();
    check_identity();
    check_left_out();
    check_4d();
    check_filters();
    check_source();
    check_size();
}
