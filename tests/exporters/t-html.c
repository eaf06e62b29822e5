/* K: html export */
#include <zlib.h>

#include "base/log.h"
#include "io/json.h"
#include "tests/exporters/frame.h"

extern const struct spin_exporter spin_exporter_html;

static char *page; /* text of the file read last */

static char *load(const char *path)
{
    struct spin_map map;

    free(page);
    page = NULL;
    if (spin_map_open(path, &map) != SPIN_OK)
        return NULL;
    page = strndup((const char *)map.data, map.size);
    spin_map_close(&map);
    return page;
}

/* The text of the script of this id, allocated. */
static char *script(const char *id)
{
    char head[64];
    const char *at, *end;

    snprintf(head, sizeof head, "id=\"%s\">", id);
    at = strstr(page, head);
    end = at ? strstr(at, "</script>") : NULL;
    return end ? strndup(at + strlen(head), (size_t)(end - at) - strlen(head)) : NULL;
}

static int digit(char c)
{
    static const char all[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    const char *at = strchr(all, c);

    return at && c ? (int)(at - all) : -1;
}

/* Bytes of a block: base64, then gzip. Their number, 0 when it is neither. */
static size_t block(const char *id, unsigned char *out, size_t room)
{
    char *text = script(id);
    size_t n = text ? strlen(text) : 0, n_packed = 0;
    unsigned char *packed = malloc(n + 4);
    z_stream z = {0};
    int result;

    for (size_t i = 0; i + 3 < n; i += 4) {
        int d[4];

        for (size_t k = 0; k < 4; k++)
            d[k] = text[i + k] == '=' ? 0 : digit(text[i + k]);
        packed[n_packed++] = (unsigned char)(d[0] << 2 | d[1] >> 4);
        if (text[i + 2] != '=')
            packed[n_packed++] = (unsigned char)(d[1] << 4 | d[2] >> 2);
        if (text[i + 3] != '=')
            packed[n_packed++] = (unsigned char)(d[2] << 6 | d[3]);
    }
    free(text);
    z.next_in = packed;
    z.avail_in = (uInt)n_packed;
    z.next_out = out;
    z.avail_out = (uInt)room;
    inflateInit2(&z, 31);
    result = inflate(&z, Z_FINISH);
    inflateEnd(&z);
    free(packed);
    return result == Z_STREAM_END ? room - z.avail_out : 0;
}

/* What the page makes of a block. */
struct columns {
    size_t n;
    unsigned wide[9][64], narrow[64][64]; /* [column][row] */
    unsigned n_different;                 /* columns that hold differences */
};

static int decode(const char *id, size_t n, int n_sh, const struct columns *key, struct columns *c)
{
    static unsigned char bytes[1 << 16];
    size_t narrows = 5 + (size_t)n_sh, want = 9 + narrows + n * (18 + narrows);
    const unsigned char *at = bytes + 9 + narrows;

    memset(c, 0, sizeof *c);
    c->n = n;
    if (block(id, bytes, sizeof bytes) != want)
        return 0;
    for (size_t k = 0; k < 9 + narrows; k++)
        c->n_different += bytes[k];
    for (size_t k = 0; k < 9; k++, at += 2 * n)
        for (size_t i = 0; i < n; i++)
            c->wide[k][i] =
                ((at[i] | (unsigned)at[n + i] << 8) + (bytes[k] ? key->wide[k][i] : 0)) & 0xffff;
    for (size_t k = 0; k < narrows; k++, at += n)
        for (size_t i = 0; i < n; i++)
            c->narrow[k][i] = (at[i] + (bytes[9 + k] ? key->narrow[k][i] : 0)) & 0xff;
    return 1;
}

static double unsquash(double u) { return u / (1 - fabs(u)); }

static const spin_json *clip_of(spin_json **doc)
{
    char *text = script("clip");

    *doc = NULL;
    ok(text && spin_json_parse("clip", text, strlen(text), doc) == SPIN_OK, "the clip is JSON");
    free(text);
    return *doc;
}

static double number(const spin_json *object, const char *key)
{
    double x = NAN;

    spin_json_number(spin_json_get(object, key), &x);
    return x;
}

static void check_rows(const struct columns *c, const struct spin_splats *s, const spin_json *clip,
                       int n_sh)
{
    double size = number(clip, "size"), centre[3], worst[6] = {0};
    size_t width = 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));

    for (size_t k = 0; k < 3; k++)
        spin_json_number(spin_json_at(spin_json_get(clip, "centre"), k), &centre[k]);
    for (size_t i = 0; i < c->n; i++) {
        struct want w = want_of(s, i);
        double q[4], rest = 1;

        for (size_t k = 0; k < 3; k++) {
            double x = unsquash((c->wide[k][i] - 32768.0) / 32767) * size + centre[k];
            double scale = c->narrow[k][i] * 14 / 255.0 - 12 + log(size);
            double dc = (c->wide[3 + k][i] * 2 / 1023.0 - 1) / 0.28209479177387814;

            worst[0] = fmax(worst[0], fabs(x - w.place[k]) / size);
            worst[1] = fmax(worst[1], fabs(scale - w.log_scale[k]));
            worst[2] = fmax(worst[2], fabs(dc - w.dc[k]));
        }
        for (unsigned k = 0, field = 6; k < 4; k++) {
            if (k == c->narrow[4][i])
                continue;
            q[k] = (c->wide[field++][i] - 2048.0) / 2047 * sqrt(0.5);
            rest -= q[k] * q[k];
        }
        q[c->narrow[4][i]] = sqrt(fmax(rest, 0));
        worst[3] = fmax(worst[3], degrees_between(q, w.q));
        worst[4] = fmax(worst[4], fabs(c->narrow[3][i] / 255.0 - w.opacity));
        for (size_t k = 0; k < (size_t)n_sh; k++)
            worst[5] = fmax(worst[5], fabs(unsquash((c->narrow[5 + k][i] - 128.0) / 127) -
                                           (double)s->sh[width * i + 3 + k]));
    }
    ok(worst[0] < 3e-3, "places within 0.003 of the scene's size (%.2g)", worst[0]);
    ok(worst[1] < 0.0276, "scales within half a step (%.3g)", worst[1]);
    ok(worst[2] < 0.0036, "colours within half a step (%.3g)", worst[2]);
    ok(worst[3] < 0.1, "rotations within a tenth of a degree (%.3g)", worst[3]);
    ok(worst[4] < 0.00197, "opacities within half a step (%.3g)", worst[4]);
    ok(worst[5] < 0.016, "sh within half a step (%.3g)", worst[5]);
}

/* ---- A clip ---------------------------------------------------------------------------------- */

static spin_status source_frame(void *of, int frame, struct spin_splats *out)
{
    (void)of;
    make_frame(out, 30, 0, 100 + (uint32_t)frame);
    return SPIN_OK;
}

/* Frames 7, 9, 11, ... of a clip of 40 splats, the same but for the places of the first ten. */
static spin_status run_clip(const struct spin_export_job *job, int n_frames)
{
    struct spin_splats s = {0};
    void *self = NULL;
    spin_status status = spin_exporter_html.begin(job, &self);

    for (int f = 0; f < n_frames && status == SPIN_OK; f++) {
        struct spin_frame_info info = {.number = 7 + 2 * f, .time = f, .n = 40};

        make_frame(&s, 40, 2, 5);
        for (size_t i = 0; i < 30; i++)
            s.means[i] += 0.25f * (float)f;
        status = spin_exporter_html.frame(self, f, &info, &s);
        if (status != SPIN_OK)
            spin_exporter_html.abort(self);
    }
    spin_splats_free(&s);
    return status == SPIN_OK ? spin_exporter_html.end(self) : status;
}

static void test_clip(void)
{
    static struct columns first, second, before;
    struct spin_export_job job = {.output = in_folder("clip.html"),
                                  .n_frames = 3,
                                  .fps = 25,
                                  .source = "d3dgs</script>\"",
                                  .sh_degree = 2,
                                  .source_frame = source_frame,
                                  .source_sh_degree = 0};
    const char *pairs[] = {"sh", "keep", NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_splats s = {0};
    double first_number = 0;
    const spin_json *clip, *versions;
    spin_json *doc;

    job.values = &values;
    ok(run_clip(&job, 3) == SPIN_OK, "writes a clip: %s", spin_last_error());
    if (!ok(load(job.output) != NULL, "into one file"))
        return;
    ok(strncmp(page, "<!doctype html>", 15) == 0 && strstr(page, "</html>\n"), "a whole page");
    ok(!strstr(page, "http:") && !strstr(page, "https:") && !strstr(page, "//cdn"),
       "that names no server");
    clip = clip_of(&doc);
    ok(number(clip, "fps") == 25, "frames a second");
    ok(strcmp(spin_json_string(spin_json_get(clip, "source")), "d3dgs__script__") == 0,
       "marks in a method's name do no harm");
    ok(spin_json_number(spin_json_at(spin_json_get(clip, "numbers"), 0), &first_number) &&
           first_number == 7 && spin_json_length(spin_json_get(clip, "numbers")) == 3,
       "a number for each frame");
    versions = spin_json_get(clip, "versions");
    ok(spin_json_length(versions) == 2 && number(spin_json_at(versions, 0), "degree") == 2 &&
           number(spin_json_at(versions, 1), "degree") == 0,
       "after with its SH, before with its own");
    ok(decode("v0f0", 40, 24, NULL, &first) && first.n_different == 0, "the first frame is whole");
    ok(decode("v0f1", 40, 24, &first, &second) && second.n_different == 38,
       "the second holds differences to it");
    ok(decode("v1f0", 30, 0, NULL, &before), "the frame before is there");
    make_frame(&s, 40, 2, 5);
    check_rows(&first, &s, clip, 24);
    for (size_t i = 0; i < 30; i++)
        s.means[i] += 0.25f;
    check_rows(&second, &s, clip, 24);
    make_frame(&s, 30, 0, 100);
    check_rows(&before, &s, clip, 0);
    spin_splats_free(&s);
    spin_json_free(doc);
}

static void test_choice(void)
{
    static struct columns c;
    struct spin_export_job job = {.output = in_folder("some.html"),
                                  .n_frames = 5,
                                  .sh_degree = 2,
                                  .source_frame = source_frame};
    const char *pairs[] = {"max-splats", "12", "every", "2", "only", "after", "sh", "0", NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_report report = {.frames = 5, .splats_mean = 40};
    const spin_json *clip;
    spin_json *doc;

    job.values = &values;
    job.report = &report;
    ok(run_clip(&job, 5) == SPIN_OK, "every second frame, twelve splats, one version");
    load(job.output);
    ok(report.frames == 3 && report.splats_mean == 12 && report.bytes == strlen(page),
       "the report is of what the page holds");
    clip = clip_of(&doc);
    ok(number(clip, "fps") == 15, "thirty frames a second, each standing for two");
    ok(spin_json_length(spin_json_get(clip, "numbers")) == 3, "three frames of five");
    ok(spin_json_length(spin_json_get(clip, "versions")) == 1, "the other version is left out");
    ok(decode("v0f0", 12, 0, NULL, &c), "twelve splats without SH");
    spin_json_free(doc);
}

static void test_bad_rows(void)
{
    static struct columns c;
    struct spin_export_job job = {.output = in_folder("bad.html"), .n_frames = 1};
    struct spin_splats s = {0};

    make_frame(&s, 20, 0, 3);
    spoil_frame(&s);
    spin_set_verbosity(-2);
    ok(run(&spin_exporter_html, &job, &s, 0) == SPIN_OK, "a frame with bad rows");
    load(job.output);
    ok(decode("v0f0", 14, 0, NULL, &c), "those that cannot be drawn are left out");
    spin_splats_free(&s);
}

static void test_camera(void)
{
    struct spin_view view = {.camera = {.width = 320,
                                        .height = 180,
                                        .fx = 240,
                                        .fy = 240,
                                        .w2c = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 9}},
                             .path = (char *)"none"};
    struct spin_views views = {0};
    struct spin_export_job job = {.output = in_folder("seen.html"), .n_frames = 1, .views = &views};
    struct spin_splats s = {0};
    const spin_json *clip;
    spin_json *doc;
    double eye;

    spin_views_add(&views, &view);
    make_frame(&s, 50, 0, 3);
    ok(run(&spin_exporter_html, &job, &s, 0) == SPIN_OK, "with a data set's camera");
    load(job.output);
    clip = clip_of(&doc);
    spin_json_number(spin_json_at(spin_json_get(clip, "eye"), 2), &eye);
    near(eye, -9, 1e-6, "the first view is its view");
    near(number(clip, "fovy"), 2 * atan(90.0 / 240) * 57.29577951308232, 1e-6, "with its angle");
    near(number(clip, "aspect"), 320.0 / 180, 1e-6, "and its shape");
    spin_json_free(doc);
    spin_views_free(&views);
    spin_splats_free(&s);
}

static void test_refusals(void)
{
    static const char *const bad[][2] = {{"sh", "4"},    {"min-opacity", "2"}, {"max-splats", "0"},
                                         {"every", "x"}, {"fps", "-1"},        {"only", "both"}};
    struct spin_export_job job = {.output = in_folder("clip.html"), .n_frames = 1};
    struct spin_splats s = {0};
    void *self = NULL;

    make_frame(&s, 9, 0, 1);
    ok(run(&spin_exporter_html, &job, &s, 1) == SPIN_E_IO && strstr(spin_last_error(), "--force"),
       "does not overwrite, and names --force");
    job.force = true;
    ok(run(&spin_exporter_html, &job, &s, 1) == SPIN_OK, "overwrites when told to");
    job.output = in_folder("never.html");
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        const char *pairs[] = {bad[i][0], bad[i][1], NULL};
        struct spin_plugin_values values = {pairs};

        job.values = &values;
        ok(spin_exporter_html.begin(&job, &self) == SPIN_E_USAGE && !self &&
               strstr(spin_last_error(), bad[i][0]),
           "refuses --%s '%s'", bad[i][0], bad[i][1]);
    }
    job.values = NULL;
    ok(spin_exporter_html.begin(&job, &self) == SPIN_OK, "begins");
    spin_exporter_html.abort(self);
    ok(!spin_path_exists(job.output), "an export that is given up leaves nothing");
    spin_splats_free(&s);
}

TAP_MAIN
{
    test_clip();
    test_choice();
    test_bad_rows();
    test_camera();
    test_refusals();
    free(page);
}
