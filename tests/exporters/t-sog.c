/* K: sog export threads */
#include <sys/wait.h>
#include <unistd.h>

#include "base/log.h"
#include "io/webp.h"
#include "formats/sog.h"
#include "tests/exporters/frame.h"

extern const struct spin_exporter spin_exporter_sog;

/* Reads a file by its specification, independently of src/formats/sog.c. */
struct sog {
    struct spin_zip zip;
    spin_json *meta;
    uint8_t *pixels[7];
    int width[7], height[7];
    size_t n;
    int bands;
};

static const char *const names[7] = {"means_l.webp",   "means_u.webp", "quats.webp",
                                     "scales.webp",    "sh0.webp",     "shN_centroids.webp",
                                     "shN_labels.webp"};

static int load(const char *path, struct sog *out)
{
    const unsigned char *data;
    const struct spin_zip_member *member;
    void *owned;
    int64_t number;

    memset(out, 0, sizeof *out);
    if (spin_zip_open(path, &out->zip) != SPIN_OK)
        return 0;
    member = spin_zip_find(&out->zip, "meta.json");
    if (!member || member->method != 0 ||
        spin_zip_read(&out->zip, member, true, 1 << 20, &data, &owned) != SPIN_OK ||
        spin_json_parse("meta", (const char *)data, member->size, &out->meta) != SPIN_OK ||
        !spin_json_integer(spin_json_get(out->meta, "version"), &number) || number != 2 ||
        !spin_json_integer(spin_json_get(out->meta, "count"), &number))
        return 0;
    out->n = (size_t)number;
    if (spin_json_integer(spin_json_get(spin_json_get(out->meta, "shN"), "bands"), &number))
        out->bands = (int)number;
    for (int p = 0; p < (out->bands ? 7 : 5); p++) {
        member = spin_zip_find(&out->zip, names[p]);
        if (!member || member->method != 0 ||
            spin_zip_read(&out->zip, member, true, 1 << 24, &data, &owned) != SPIN_OK ||
            spin_webp_size(data, member->size, &out->width[p], &out->height[p]) != SPIN_OK)
            return 0;
        out->pixels[p] = malloc((size_t)out->width[p] * (size_t)out->height[p] * 4);
        if (spin_webp_read(data, member->size, out->width[p], out->height[p], out->pixels[p]) !=
            SPIN_OK)
            return 0;
    }
    return 1;
}

static void unload(struct sog *f)
{
    for (int p = 0; p < 7; p++)
        free(f->pixels[p]);
    spin_json_free(f->meta);
    spin_zip_close(&f->zip);
}

static double number_in(const struct sog *f, const char *object, const char *list, size_t i)
{
    double value = NAN;

    spin_json_number(spin_json_at(spin_json_get(spin_json_get(f->meta, object), list), i), &value);
    return value;
}

static struct want decode(const struct sog *f, size_t i)
{
    struct want w;
    const uint8_t *low = f->pixels[0] + 4 * i, *high = f->pixels[1] + 4 * i;
    const uint8_t *q = f->pixels[2] + 4 * i;
    int largest = q[3] - 252, from = 0;
    double rest = 1;

    for (size_t c = 0; c < 3; c++) {
        double min = number_in(f, "means", "mins", c), max = number_in(f, "means", "maxs", c);
        double v = min + (max - min) * (low[c] + 256 * high[c]) / 65535;

        w.place[c] = (v < 0 ? -1 : 1) * (exp(fabs(v)) - 1);
        w.log_scale[c] = number_in(f, "scales", "codebook", f->pixels[3][4 * i + c]);
        w.dc[c] = number_in(f, "sh0", "codebook", f->pixels[4][4 * i + c]);
    }
    w.opacity = f->pixels[4][4 * i + 3] / 255.0;
    for (int k = 0; k < 4; k++) {
        if (k == largest)
            continue;
        w.q[k] = (q[from++] / 255.0 * 2 - 1) / sqrt(2);
        rest -= w.q[k] * w.q[k];
    }
    w.q[largest] = sqrt(fmax(rest, 0));
    return w;
}

/* In a sorted file: the row of the source with the nearest position. */
static size_t find(const struct spin_splats *s, const double place[3])
{
    size_t best = 0;
    double least = INFINITY;

    for (size_t i = 0; i < s->n; i++) {
        double d = 0;

        for (size_t c = 0; c < 3; c++)
            d += pow((double)s->means[3 * i + c] - place[c], 2);
        if (d < least) {
            least = d;
            best = i;
        }
    }
    return best;
}

/* The root mean square error of SH. */
static double sh_error(const struct sog *f, const struct spin_splats *s)
{
    size_t n_vec = (size_t)((f->bands + 1) * (f->bands + 1) - 1),
           n_from = (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));
    double sum = 0;

    for (size_t i = 0; i < f->n; i++) {
        struct want w = decode(f, i);
        size_t row = find(s, w.place);
        size_t label = f->pixels[6][4 * i] + 256u * f->pixels[6][4 * i + 1];
        size_t x = label % 64 * n_vec, y = label / 64;

        for (size_t k = 0; k < n_vec; k++)
            for (size_t c = 0; c < 3; c++) {
                size_t pixel = y * (size_t)f->width[5] + x + k;
                double want = k + 1 < n_from ? (double)s->sh[(n_from * row + k + 1) * 3 + c] : 0;

                sum += pow(want - number_in(f, "shN", "codebook", f->pixels[5][4 * pixel + c]), 2);
            }
    }
    return sqrt(sum / (double)(f->n * n_vec * 3));
}

/* Our reader decodes a file as the specification says, which decode() implements. */
static void check_read(const struct sog *f, const char *path)
{
    struct spin_splats back = {0};
    double worst = 0, turned = 0;
    struct spin_map map;

    if (!ok(spin_map_open(path, &map) == SPIN_OK &&
                spin_sog_read(map.data, map.size, NULL, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
                              &back) == SPIN_OK &&
                back.n == f->n && back.sh_degree == f->bands && back.antialias,
            "is read back"))
        return;
    for (size_t i = 0; i < f->n; i++) {
        struct want is = want_of(&back, i), want = decode(f, i);

        for (int c = 0; c < 3; c++) {
            worst = larger(worst, fabs(is.place[c] - want.place[c]));
            worst = larger(worst, fabs(is.log_scale[c] - want.log_scale[c]));
            worst = larger(worst, fabs(is.dc[c] - want.dc[c]));
        }
        worst = larger(worst, fabs(is.opacity - want.opacity));
        turned = larger(turned, degrees_between(is.q, want.q));
    }
    ok(worst < 2e-6 && turned < 0.01, "as its specification reads (%.2g, %.2g degrees)", worst,
       turned);
    spin_map_close(&map);
    spin_splats_free(&back);
}

static void test_values(int degree, const char *sh, int bands, size_t n)
{
    const char *pairs[] = {"sh", sh, NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {.output = in_folder("v"),
                                  .n_frames = 1,
                                  .force = true,
                                  .sh_degree = degree,
                                  .antialias = true,
                                  .values = &values};
    struct spin_splats s = {0};
    double worst[5] = {0}, error;
    struct sog f;

    make_frame(&s, n, degree, 31);
    s.logit_opacities[3] = -20; /* nothing shows, and its colour stays */
    if (!ok(run(&spin_exporter_sog, &job, &s, 5) == SPIN_OK &&
                load(in_folder("v/frame_00005.sog"), &f) && f.n == n && f.bands == bands,
            "writes degree %d as %s: %s", degree, sh, spin_last_error()))
        return;
    ok(strcmp(spin_json_string(spin_json_get(f.meta, "model")), "antialiased") == 0,
       "says that it is antialiased");
    for (size_t i = 0; i < n; i++) {
        struct want got = decode(&f, i), want = want_of(&s, find(&s, got.place));

        for (int c = 0; c < 3; c++) {
            worst[0] = larger(worst[0], fabs(got.place[c] - want.place[c]));
            worst[1] = larger(worst[1], fabs(got.log_scale[c] - want.log_scale[c]));
            worst[2] = larger(worst[2], fabs(got.dc[c] - want.dc[c]));
        }
        worst[3] = larger(worst[3], fabs(got.opacity - want.opacity));
        worst[4] = larger(worst[4], degrees_between(got.q, want.q));
    }
    /* 65535 steps over 2 ln 5, times the slope 1 + |v| of the logarithm, half a step */
    ok(worst[0] < 0.51 * 2 * log(5) / 65535 * 5, "places are within half a step (%.2g)", worst[0]);
    ok(worst[1] < 0.05, "log scales are near (%.2g)", worst[1]);
    ok(worst[2] < 0.03, "colours are near (%.2g)", worst[2]);
    ok(worst[3] < 0.00197, "opacities are within half a step");
    ok(worst[4] < 1, "rotations are within a degree (%.2g)", worst[4]);
    if (bands > 0) {
        error = sh_error(&f, &s);
        /* with as many centroids as rows only the codebook quantises; random vectors are the
         * worst case */
        ok(error < (n <= 1024 ? 0.003 : 0.4), "sh is off by %.4f", error);
    }
    check_read(&f, in_folder("v/frame_00005.sog"));
    unload(&f);
    spin_splats_free(&s);
}

/* Static attributes keep their bits while bounding box and codebooks remain valid. */
static void test_still(void)
{
    struct spin_export_job job = {.output = in_folder("still"), .n_frames = 3};
    struct spin_frame_info info = {0};
    struct spin_splats s = {0};
    struct sog a, b;
    void *self = NULL;
    int same = 1;

    make_frame(&s, 2000, 0, 8);
    ok(spin_exporter_sog.begin(&job, &self) == SPIN_OK &&
           spin_exporter_sog.frame(self, 0, &info, &s) == SPIN_OK,
       "writes a frame");
    for (size_t i = 0; i < s.n; i++) /* the outermost splats move inside the bounding box */
        for (size_t k = 0; k < 3; k++)
            s.means[3 * i + k] = fmaxf(fminf(s.means[3 * i + k], 3.5f), -3.5f);
    info.number = 1;
    ok(spin_exporter_sog.frame(self, 1, &info, &s) == SPIN_OK, "and one where some moved");
    s.means[0] = 1e20f;
    s.log_scales[0] = 3;
    info.number = 2;
    ok(spin_exporter_sog.frame(self, 2, &info, &s) == SPIN_OK, "and one where one is far away");
    ok(spin_exporter_sog.end(self) == SPIN_OK, "ends");
    if (!ok(load(in_folder("still/frame_00000.sog"), &a) &&
                load(in_folder("still/frame_00001.sog"), &b),
            "both are there"))
        return;
    for (size_t c = 0; c < 3; c++)
        same &= number_in(&a, "means", "mins", c) == number_in(&b, "means", "mins", c) &&
                number_in(&a, "means", "maxs", c) == number_in(&b, "means", "maxs", c);
    for (size_t k = 0; k < 256; k++)
        same &= number_in(&a, "scales", "codebook", k) == number_in(&b, "scales", "codebook", k) &&
                number_in(&a, "sh0", "codebook", k) == number_in(&b, "sh0", "codebook", k);
    ok(same, "box and books are the same");
    unload(&a);
    unload(&b);
    ok(load(in_folder("still/frame_00002.sog"), &b) &&
           exp(number_in(&b, "means", "maxs", 0)) - 1 > 0.99e20,
       "the box grows when it must");
    unload(&b);
    spin_splats_free(&s);
}

static void test_edges(void)
{
    struct spin_export_job job = {
        .output = in_folder("edges"), .n_frames = 1, .force = true, .sh_degree = 3};
    struct spin_splats s = {0};
    struct sog f;

    make_frame(&s, 14, 3, 2);
    s.logit_opacities[1] = INFINITY;
    ok(run(&spin_exporter_sog, &job, &s, 0) == SPIN_OK &&
           load(in_folder("edges/frame_00000.sog"), &f) && f.n == 14,
       "an infinite logit");
    unload(&f);
    make_frame(&s, 0, 3, 2);
    ok(run(&spin_exporter_sog, &job, &s, 0) == SPIN_OK &&
           load(in_folder("edges/frame_00000.sog"), &f) && f.n == 0,
       "writes an empty frame");
    unload(&f);
    make_frame(&s, 1, 3, 2);
    ok(run(&spin_exporter_sog, &job, &s, 0) == SPIN_OK &&
           load(in_folder("edges/frame_00000.sog"), &f) && f.n == 1,
       "and one splat");
    unload(&f);
    spin_splats_free(&s);
}

/* The archive with another word in meta.json, or (from NULL) with the image of colours in place
 * of that of rotations. */
static void rewrite(const struct spin_zip *zip, const char *path, const char *from, const char *to)
{
    struct spin_zip_writer w;

    if (spin_zip_writer_open(path, true, &w) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < zip->n; i++) {
        const struct spin_zip_member *member = &zip->member[i];
        const unsigned char *data;
        char *text = NULL, *at;
        void *owned;

        if (!from && strcmp(member->name, "quats.webp") == 0)
            member = spin_zip_find(zip, "sh0.webp");
        if (spin_zip_read(zip, member, true, 1 << 24, &data, &owned) != SPIN_OK)
            exit(1);
        text = calloc(1, member->size + 100);
        memcpy(text, data, member->size);
        at = i == 0 && from ? strstr(text, from) : NULL;
        if (at) {
            char rest[32768];

            snprintf(rest, sizeof rest, "%s", at + strlen(from));
            sprintf(at, "%s%s", to, rest);
        }
        spin_zip_member_whole(&w, zip->member[i].name, text, at ? strlen(text) : member->size, NULL,
                              0);
        free(text);
    }
    if (spin_zip_writer_commit(&w) != SPIN_OK)
        exit(1);
}

static void test_hostile(void)
{
    static const char *const bad[][3] = {
        {"\"version\":2", "\"version\":1", "SOG version 1: 'quats.encoding'"},
        {"\"version\":2", "\"version\":4", "version 4, expected 1 or 2 (4 is TSOG"},
        {"\"count\":900", "\"count\":-1", "'count'"},
        {"\"count\":900", "\"count\":9e9", "'count'"},
        {"\"count\":900", "\"count\":200000000", "pixels"},
        {"\"count\":900", "\"count\":12000", "pixels"},
        {"\"mins\":[", "\"mins\":[1,", "'mins'"},
        {"\"maxs\":[", "\"maxs\":[1e300,", "'maxs'"},
        {"\"scales\":{\"codebook\":[", "\"scales\":{\"codebook\":[1,", "'scales.codebook'"},
        {"\"sh0\":{\"codebook\":[", "\"sh0\":{\"codebook\":[null,", "'sh0.codebook'"},
        {"\"quats.webp\"", "\"other.webp\"", "quats.webp"},
        {"\"bands\":3", "\"bands\":4", "'bands'"},
        {"\"bands\":3", "\"bands\":2", "centroids"},
        {"\"shN\":{\"count\":900", "\"shN\":{\"count\":0", "'count'"},
        {"\"shN\":{\"count\":900", "\"shN\":{\"count\":850", "the palette has only 850"},
        {"{\"version\"", "[\"version\"", "meta.json"},
    };
    const char *path = in_folder("hostile.sog");
    struct spin_splats s = {0}, back = {0};
    struct spin_export_job job = {
        .output = in_folder("h"), .n_frames = 1, .sh_degree = 3, .force = true};
    struct spin_map map;
    struct spin_zip zip;
    int n_good = 0;

    make_frame(&s, 900, 3, 31);
    if (!ok(run(&spin_exporter_sog, &job, &s, 0) == SPIN_OK &&
                spin_map_open(in_folder("h/frame_00000.sog"), &map) == SPIN_OK &&
                spin_zip_open(in_folder("h/frame_00000.sog"), &zip) == SPIN_OK &&
                spin_sog_read(map.data, map.size, NULL, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES,
                              &back) == SPIN_OK,
            "a file is read: %s", spin_last_error()))
        return;
    for (size_t n = 0; n < map.size; n += 1 + n / 20)
        n_good += spin_sog_read(map.data, n, NULL, SPIN_COL_MEANS, &back) == SPIN_OK;
    ok(n_good == 0, "no truncation is");
    spin_map_close(&map);
    for (size_t i = 0; i <= sizeof bad / sizeof *bad; i++) {
        const char *from = i ? bad[i - 1][0] : NULL,
                   *want = i ? bad[i - 1][2] : "has the invalid mode byte";

        rewrite(&zip, path, from, i ? bad[i - 1][1] : NULL);
        if (spin_map_open(path, &map) != SPIN_OK)
            exit(1);
        ok(spin_sog_read(map.data, map.size, NULL, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, &back) !=
                   SPIN_OK &&
               strstr(spin_last_error(), want),
           "refused: %s", spin_last_error());
        spin_map_close(&map);
    }
    spin_zip_close(&zip);
    spin_splats_free(&s);
    spin_splats_free(&back);
}

/* In a process of its own, since the library is searched only once. */
static void test_without_webp(void)
{
    struct spin_export_job job = {.output = in_folder("nowebp"), .n_frames = 1};
    int status = 0;
    pid_t child = fork();

    if (child == 0) {
        void *self = NULL;

        setenv("SPIN_WEBP", "/no/such.so", 1);
        _exit(spin_exporter_sog.begin(&job, &self) == SPIN_E_UNSUPPORTED &&
                      strstr(spin_last_error(), "libwebp")
                  ? 0
                  : 1);
    }
    ok(child > 0 && waitpid(child, &status, 0) == child && status == 0 &&
           !spin_path_exists(in_folder("nowebp")),
       "without the library: refused, and no folder made");
}

TAP_MAIN
{
    static const char *const bad[][2] = {{"level", "-1"}, {"level", "10"}, {"sh", "4"}};

    spin_log_set_level(-2);
    test_without_webp();
    if (spin_webp_need() != SPIN_OK) {
        skip("sog", spin_last_error());
        return;
    }
    test_values(0, "keep", 0, 2000);
    test_values(3, "keep", 3, 900);
    test_values(1, "2", 2, 700);
    test_values(3, "1", 1, 2500);
    test_still();
    test_edges();
    test_hostile();
    check_folder_rules(&spin_exporter_sog, "frame_00001.sog", bad, sizeof bad / sizeof bad[0]);
}
