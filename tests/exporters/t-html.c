/* K: html export */
#include <zlib.h>

#include "base/log.h"
#include "exporters/lib/page_bytes.h"
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

/* Bytes of a block: seven bits a character, then gzip. Their number, 0 when it is neither. */
static size_t block(const char *id, unsigned char *out, size_t room)
{
    static const unsigned char special[] = {0, 10, 13, 60, 127};
    char *text = script(id);
    size_t n = text ? strlen(text) : 0, n_packed = 0;
    unsigned char *packed = malloc(n + 4);
    unsigned held = 0, bits = 0;
    z_stream z = {0};
    int result;

    for (size_t i = 0; i < n; i++) {
        unsigned seven = (unsigned char)text[i];

        if (seven == 127)
            seven = special[text[++i] - '0'];
        held = (held << 7 | seven) & 0x7fff;
        bits += 7;
        if (bits >= 8) {
            bits -= 8;
            packed[n_packed++] = (unsigned char)(held >> bits);
        }
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

/* ---- What the page makes of a block: after docs/page-format.md, not after the encoder ------------ */

enum { ROWS = 64, COLUMNS = 13 + 45 };
struct columns {
    long key[COLUMNS][ROWS], last[COLUMNS][ROWS], mean[COLUMNS][ROWS], own[COLUMNS][ROWS];
    size_t shared, still, n_own;
};

static const unsigned char *at, *end;

static long unfolded(unsigned long u) { return u & 1 ? -(long)(u >> 1) - 1 : (long)(u >> 1); }

static unsigned long listed(size_t n, size_t i, int planes)
{
    unsigned long u = 0;

    for (int p = 0; p < planes; p++)
        u |= (unsigned long)at[(size_t)p * n + i] << 8 * p;
    return u;
}

static void whole(long *x, size_t n)
{
    int head = at < end ? *at++ : 0, planes = head & 7;

    for (size_t i = 0; i < n; i++)
        x[i] = unfolded(listed(n, i, planes)) + (head & 16 && i ? x[i - 1] : 0);
    at += (size_t)planes * n;
}

static void changes(long *last, long *mean, size_t n)
{
    int head = at < end ? *at++ : 0, planes = head & 7;
    const unsigned char *mask = at;
    size_t n_listed = 0, k = 0;

    for (size_t i = 0; planes && i < n; i++)
        n_listed += mask[i / 8] >> i % 8 & 1;
    at += planes ? (n + 7) / 8 : 0;
    for (size_t i = 0; i < n; i++) {
        if (head & 16)
            last[i] = (long)floor(((double)mean[i] + 8) / 16);
        if (planes && mask[i / 8] >> i % 8 & 1)
            last[i] += unfolded(listed(n_listed, k++, planes) + 1);
        mean[i] += (long)floor((16.0 * (double)last[i] - (double)mean[i]) / 2);
    }
    at += (size_t)planes * n_listed;
}

static void keys(long (*x)[ROWS], size_t n, size_t columns)
{
    for (size_t c = 0; c < columns; c++)
        whole(x[c], n);
    for (size_t i = 0; i < n; i++) {
        x[3][i] += x[4][i];
        x[5][i] += x[4][i];
    }
}

static double number(const spin_json *object, const char *key)
{
    double x = NAN;

    spin_json_number(spin_json_get(object, key), &x);
    return x;
}

static size_t count(const spin_json *version, const char *key, int frame)
{
    double x = 0;

    spin_json_number(spin_json_at(spin_json_get(version, key), (size_t)frame), &x);
    return (size_t)x;
}

/* Frame after frame, from the key on. */
static int decode(const spin_json *version, int which, int frame, int n_sh, struct columns *c)
{
    static unsigned char bytes[1 << 16];
    size_t columns = 13 + (size_t)n_sh, n;
    char id[32];

    snprintf(id, sizeof id, "v%df%d", which, frame);
    n = block(id, bytes, sizeof bytes);
    at = bytes;
    end = bytes + n;
    c->shared = count(version, "shared", frame);
    c->still = count(version, "still", frame);
    c->n_own = count(version, "own", frame);
    if (n == 0 || c->shared > ROWS || c->n_own > ROWS)
        return 0;
    if ((int)count(version, "first", frame) == frame) {
        memset(c->last, 0, sizeof c->last);
        memset(c->mean, 0, sizeof c->mean);
        keys(c->key, c->shared, columns);
    } else
        for (size_t k = 0; k < columns; k++)
            changes(c->last[k], c->mean[k], c->shared - c->still);
    if (c->n_own)
        keys(c->own, c->n_own, columns);
    return at == end;
}

static const spin_json *clip_of(spin_json **doc)
{
    char *text = script("clip");

    *doc = NULL;
    ok(text && spin_json_parse("clip", text, strlen(text), doc) == SPIN_OK, "the clip is JSON");
    free(text);
    return *doc;
}

static double step_of(const spin_json *clip, size_t column)
{
    static const char *const name[] = {"place", "colour", "opacity", "scale", "rotation", "sh"};
    static const size_t from[] = {3, 6, 7, 10, 13, COLUMNS};
    int k = 0;

    while (column >= from[k])
        k++;
    return number(spin_json_get(clip, "steps"), name[k]);
}

static void turn(const double v[3], double q[4])
{
    double angle = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);

    q[0] = cos(angle / 2);
    for (int k = 0; k < 3; k++)
        q[k + 1] = angle > 1e-9 ? sin(angle / 2) * v[k] / angle : v[k] / 2;
}

/* A row as the page shows it: place 3, colour 3, opacity, log scale 3, q 4, sh. */
static void shown(const struct columns *c, const spin_json *clip, size_t i, int n_sh, double *v)
{
    double a[3], b[3], p[4], q[4];

    for (size_t k = 0; k < 13 + (size_t)n_sh; k++) {
        int own = i >= c->shared;
        double key = own ? (double)c->own[k][i - c->shared] : 0.5 * (double)c->key[k][i];
        double more = own || i < c->still ? 0 : (double)c->last[k][i - c->still];
        double middle = 0;

        if (k >= 10 && k < 13) {
            a[k - 10] = key * step_of(clip, k);
            b[k - 10] = more * step_of(clip, k);
            continue;
        }
        if (k < 3)
            spin_json_number(spin_json_at(spin_json_get(clip, "centre"), k), &middle);
        v[k < 10 ? k : k + 1] = (key + more) * step_of(clip, k) + middle;
    }
    v[6] = fmin(fmax(v[6], 0), 1);
    turn(a, p);
    turn(b, q);
    v[10] = p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3];
    v[11] = p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2];
    v[12] = p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1];
    v[13] = p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0];
}

/* Every splat of the frame is in the page, within the bounds: world, 0..1, log, degrees, 1. Rows may come in
 * any order: a splat is found by its place. */
static void check_rows(const struct columns *c, const struct spin_splats *s, const spin_json *clip,
                       int n_sh, const double bound[5])
{
    static const char *const name[] = {"places", "colours and opacities", "scales", "rotations",
                                       "SH"};
    size_t width = 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));
    double worst[5] = {0};

    for (size_t i = 0; i < s->n; i++) {
        struct want w = want_of(s, i);
        double best = INFINITY, v[COLUMNS + 1], found[COLUMNS + 1] = {0};

        for (size_t j = 0; j < c->shared + c->n_own; j++) {
            double apart = 0;

            shown(c, clip, j, n_sh, v);
            for (int k = 0; k < 3; k++)
                apart = fmax(apart, fabs(v[k] - w.place[k]));
            if (apart < best)
                memcpy(found, v, sizeof found);
            best = fmin(best, apart);
        }
        worst[0] = fmax(worst[0], best);
        for (size_t k = 0; k < 3; k++) {
            worst[1] = fmax(worst[1], fabs(found[3 + k] - 0.5 - 0.28209479177387814 * w.dc[k]));
            worst[2] = fmax(worst[2], fabs(found[7 + k] - w.log_scale[k]));
        }
        worst[1] = fmax(worst[1], fabs(found[6] - w.opacity));
        worst[3] = fmax(worst[3], degrees_between(found + 10, w.q));
        for (size_t k = 0; k < (size_t)n_sh; k++)
            worst[4] = fmax(worst[4], fabs(found[14 + k] - (double)s->sh[width * i + 3 + k]));
    }
    ok(c->shared + c->n_own == s->n, "all %zu splats are there", s->n);
    for (int k = 0; k < (n_sh ? 5 : 4); k++)
        ok(worst[k] <= bound[k] && worst[k] > bound[k] / 4, "%s within %g (%g)", name[k], bound[k],
           worst[k]);
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

static const double normal[5] = {0.002, 3.0 / 255, 0.0199, 1, 0.02};

static void test_clip(void)
{
    static struct columns now, before;
    struct spin_export_job job = {.output = in_folder("clip.html"),
                                  .n_frames = 3,
                                  .fps = 25,
                                  .source = "d3dgs</script>\"",
                                  .sh_degree = 2,
                                  .source_frame = source_frame,
                                  .source_sh_degree = 0};
    const char *pairs[] = {"sh", "keep", "bound-place", "0.002", NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_splats s = {0};
    double first_number = 0;
    const spin_json *clip, *versions, *after;
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
    ok(strcmp(spin_json_string(spin_json_get(clip, "name")), "clip") == 0,
       "it has its file's name");
    ok(spin_json_number(spin_json_at(spin_json_get(clip, "numbers"), 0), &first_number) &&
           first_number == 7 && spin_json_length(spin_json_get(clip, "numbers")) == 3,
       "a number for each frame");
    versions = spin_json_get(clip, "versions");
    after = spin_json_at(versions, 0);
    ok(spin_json_length(versions) == 2 && number(after, "degree") == 2 &&
           number(spin_json_at(versions, 1), "degree") == 0,
       "after with its SH, before with its own");
    make_frame(&s, 40, 2, 5);
    ok(decode(after, 0, 0, 24, &now) && now.still == 30 && now.n_own == 0,
       "thirty of forty splats stand still and are written once");
    check_rows(&now, &s, clip, 24, normal);
    for (int f = 1; f < 3; f++) {
        for (size_t i = 0; i < 30; i++)
            s.means[i] += 0.25f;
        ok(decode(after, 0, f, 24, &now), "frame %d is a difference to the one before", f);
        check_rows(&now, &s, clip, 24, normal);
    }
    ok(count(spin_json_at(versions, 1), "first", 2) == 2 && count(after, "first", 2) == 0,
       "frames with nothing in common have keys of their own");
    ok(decode(spin_json_at(versions, 1), 1, 0, 0, &before), "the frame before is there");
    make_frame(&s, 30, 0, 100);
    check_rows(&before, &s, clip, 0, normal);
    spin_splats_free(&s);
    spin_json_free(doc);
}

/* Other bounds, and keys every second frame; then the blocks in a file of their own: the same bytes. */
enum { MANY = 3000, DRAFT_COLUMNS = 13 };

/* Frames of that many splats, with --split and a key every frame; the page is loaded, the data mapped. */
static const spin_json *split_clip(const char *name, size_t n, int n_frames, struct spin_map *data,
                                   spin_json **doc)
{
    static const char *const pairs[] = {"split", "", "key-every", "1", NULL};
    struct spin_plugin_values values = {pairs};
    char path[300];
    struct spin_export_job job = {
        .output = path, .force = true, .n_frames = n_frames, .values = &values};
    struct spin_splats s = {0};
    void *self = NULL;

    snprintf(path, sizeof path, "%s", in_folder(name));
    make_frame(&s, n, 0, 5);
    if (spin_exporter_html.begin(&job, &self) != SPIN_OK)
        exit(1);
    for (int f = 0; f < n_frames; f++) {
        struct spin_frame_info info = {.number = f, .n = n};

        if (spin_exporter_html.frame(self, f, &info, &s) != SPIN_OK)
            exit(1);
    }
    spin_splats_free(&s);
    ok(spin_exporter_html.end(self) == SPIN_OK && load(path), "%s in two files", name);
    memcpy(strrchr(path, '.'), ".bin", 5);
    if (spin_map_open(path, data) != SPIN_OK)
        exit(1);
    return spin_json_at(spin_json_get(clip_of(doc), "versions"), 0);
}

static double area(const double *log_scale)
{
    double least = fmin(log_scale[0], fmin(log_scale[1], log_scale[2]));

    return exp(log_scale[0] + log_scale[1] + log_scale[2] - least);
}

/* The first picture comes before a tenth of the data is read: from a draft, splats of the first frame of which some
 * have grown, and about as much is covered. */
static void test_draft(void)
{
    static unsigned char bytes[1 << 20];
    static long x[DRAFT_COLUMNS][MANY];
    struct spin_map data = {0};
    spin_json *doc;
    const spin_json *version = split_clip("draft.html", MANY, 2, &data, &doc);
    const spin_json *draft = spin_json_get(version, "draft");
    size_t n = (size_t)number(draft, "splats"), from = (size_t)number(draft, "at");
    size_t size = (size_t)number(draft, "bytes"), strange = 0;
    double all = 0, covered = 0;
    struct spin_splats s = {0};
    z_stream z = {0};

    ok((double)size < 0.05 * (double)from && (double)size > 0.04 * (double)from && n > 60 &&
           n < MANY / 4,
       "%zu splats in %.1f %% of the blocks", n, 100 * (double)size / (double)from);
    ok(from == count(version, "at", 1) + count(version, "bytes", 1) && from + size == data.size,
       "behind all of them");
    z.next_in = (unsigned char *)(uintptr_t)data.data + from;
    z.avail_in = (uInt)size;
    z.next_out = bytes;
    z.avail_out = sizeof bytes;
    inflateInit2(&z, 31);
    ok(inflate(&z, Z_FINISH) == Z_STREAM_END, "a block");
    inflateEnd(&z);
    at = bytes;
    end = bytes + z.total_out;
    for (int c = 0; c < DRAFT_COLUMNS; c++)
        whole(x[c], n);
    ok(at == end, "of as many columns");
    make_frame(&s, MANY, 0, 5);
    for (size_t i = 0; i < n; i++) {
        double best = INFINITY, scale[3], grown = 0;
        struct want is = {0};

        for (size_t j = 0; j < MANY; j++) {
            struct want w = want_of(&s, j);
            double apart = 0;

            for (size_t k = 0; k < 3; k++) {
                double middle = 0;

                spin_json_number(spin_json_at(spin_json_get(doc, "centre"), k), &middle);
                apart = fmax(apart, fabs(0.5 * (double)x[k][i] * step_of(doc, k) + middle -
                                         (double)w.place[k]));
            }
            is = apart < best ? w : is;
            best = fmin(best, apart);
        }
        for (size_t k = 0; k < 3; k++) {
            scale[k] = 0.5 * (double)x[7 + k][i] * step_of(doc, 7);
            grown = fmax(grown, fabs(scale[k] - (double)is.log_scale[k] -
                                     (scale[0] - (double)is.log_scale[0])));
        }
        strange += best > 0.01 || grown > 0.05 || scale[0] < (double)is.log_scale[0] - 0.05 ||
                   scale[0] > (double)is.log_scale[0] + 2.2;
        covered += area(scale);
    }
    for (size_t j = 0; j < MANY; j++) {
        struct want w = want_of(&s, j);

        all += area((double[3]){w.log_scale[0], w.log_scale[1], w.log_scale[2]});
    }
    ok(strange == 0, "each is one of the frame, or that grown as a whole (%zu are not)", strange);
    ok(covered > 0.8 * all && covered < 1.25 * all, "%.2f of all is covered", covered / all);
    spin_splats_free(&s);
    spin_map_close(&data);
    spin_json_free(doc);
    version = split_clip("long.html", 300, 24, &data, &doc);
    ok(!spin_json_get(version, "draft"), "there is none where a key is as small");
    spin_map_close(&data);
    spin_json_free(doc);
}

static void test_split(void)
{
    static struct columns now;
    static const double fine[5] = {0.0005, 1.0 / 255, 0.005, 0.5, 0.01};
    static unsigned char bytes[2][1 << 16];
    struct spin_export_job job = {.output = in_folder("whole.html"), .n_frames = 4, .sh_degree = 2};
    const char *pairs[] = {"level", "fine", "key-every", "2",           "bound-rotation",
                           "0.5",   "sh",   "1",         "bound-place", "0.0005",
                           NULL,    NULL,   NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_splats s = {0};
    struct spin_map data = {0};
    const spin_json *clip, *version;
    spin_json *doc;
    size_t n, start;
    z_stream z = {0};

    job.values = &values;
    ok(run_clip(&job, 4) == SPIN_OK && load(job.output), "a fine clip of two keys");
    clip = clip_of(&doc);
    version = spin_json_at(spin_json_get(clip, "versions"), 0);
    ok(count(version, "first", 1) == 0 && count(version, "first", 2) == 2,
       "a key every second frame");
    make_frame(&s, 40, 2, 5);
    for (size_t i = 0; i < 30; i++)
        s.means[i] += 0.5f;
    ok(decode(version, 0, 2, 9, &now), "the third frame needs no other");
    check_rows(&now, &s, clip, 9, fine);
    n = block("v0f3", bytes[0], sizeof bytes[0]);
    spin_json_free(doc);
    pairs[10] = "split";
    pairs[11] = "";
    job.output = in_folder("parts.html");
    ok(run_clip(&job, 4) == SPIN_OK && load(job.output), "the same in two files");
    ok(!strstr(page, "id=\"v0f0\""), "no block in the page");
    clip = clip_of(&doc);
    version = spin_json_at(spin_json_get(clip, "versions"), 0);
    ok(strcmp(spin_json_string(spin_json_get(clip, "data")), "parts.bin") == 0,
       "it names the file");
    ok(spin_map_open(in_folder("parts.bin"), &data) == SPIN_OK, "beside it");
    start = count(version, "at", 3);
    ok(start + count(version, "bytes", 3) == data.size, "which ends with the last block");
    z.next_in = (unsigned char *)(uintptr_t)data.data + start;
    z.avail_in = (uInt)(data.size - start);
    z.next_out = bytes[1];
    z.avail_out = sizeof bytes[1];
    inflateInit2(&z, 31);
    ok(inflate(&z, Z_FINISH) == Z_STREAM_END && z.total_out == n && n > 0 &&
           memcmp(bytes[0], bytes[1], n) == 0,
       "the block there is the one in the page");
    inflateEnd(&z);
    spin_map_close(&data);
    ok(run_clip(&job, 4) == SPIN_E_IO && strstr(spin_last_error(), "--force"),
       "neither is overwritten");
    spin_splats_free(&s);
    spin_json_free(doc);
}

/* Numbers around a mean, as the page reads them. */
static void test_mean(void)
{
    static int32_t x[ROWS], held[2][ROWS];
    static long last[ROWS], mean[ROWS];
    struct spin_page_state state = {held[0], held[1]};
    struct spin_page_bytes b = {0};
    uint32_t seed = 1;
    int by_mean = 0, wrong = 0;

    for (int f = 0; f < 20; f++) {
        b.n = 0;
        for (size_t i = 0; i < ROWS; i++)
            x[i] = (int32_t)draw(&seed, -300, 300);
        wrong += spin_page_put_changes(&b, x, ROWS, &state) != SPIN_OK;
        at = b.data;
        end = b.data + b.n;
        by_mean += b.data[0] >> 4;
        changes(last, mean, ROWS);
        for (size_t i = 0; i < ROWS; i++)
            wrong += last[i] != x[i];
        wrong += at != end;
    }
    ok(wrong == 0 && by_mean > 10, "differences to the mean, %d times of 20", by_mean);
    spin_page_bytes_free(&b);
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
    ok(decode(spin_json_at(spin_json_get(clip, "versions"), 0), 0, 0, 0, &c) && c.shared == 12,
       "twelve splats without SH");
    spin_json_free(doc);
}

/* Other rows are the largest in the second frame, which has as many. */
static void test_most_visible(void)
{
    static struct columns c;
    const char *pairs[] = {"max-splats", "12", "sh", "0", NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {
        .output = in_folder("largest.html"), .n_frames = 2, .values = &values};
    struct spin_splats s = {0};
    const spin_json *clip;
    spin_json *doc;
    void *self = NULL;
    int whole, n = 0, n_other = 0;

    ok(spin_exporter_html.begin(&job, &self) == SPIN_OK, "begins");
    for (int f = 0; f < 2; f++) {
        struct spin_frame_info info = {.number = f, .time = f, .n = 40};

        make_frame(&s, 40, 0, 5);
        for (size_t k = 0; k < 120; k++)
            s.log_scales[k] = k / 36 == 2 * (size_t)f ? -1 : -6;
        memset(s.logit_opacities, 0, 40 * sizeof(float));
        ok(spin_exporter_html.frame(self, f, &info, &s) == SPIN_OK, "takes a frame");
    }
    ok(spin_exporter_html.end(self) == SPIN_OK, "the twelve largest of each frame");
    load(job.output);
    clip = clip_of(&doc);
    whole = decode(spin_json_at(spin_json_get(clip, "versions"), 0), 0, 0, 0, &c) &&
            decode(spin_json_at(spin_json_get(clip, "versions"), 0), 0, 1, 0, &c);
    for (size_t j = 0; whole && j < c.shared + c.n_own; j++) {
        double v[COLUMNS + 1];

        shown(&c, clip, j, 0, v);
        n += v[6] > 0.1 && fabs(v[7] + 1) < 0.03;
        n_other += v[6] > 0.1 && fabs(v[7] + 1) >= 0.03;
    }
    ok(n == 12 && n_other == 0, "the second frame shows its own, %d and %d others", n, n_other);
    spin_json_free(doc);
    spin_splats_free(&s);
}

static void test_bad_rows(void)
{
    static struct columns c;
    struct spin_export_job job = {.output = in_folder("bad.html"), .n_frames = 1};
    struct spin_splats s = {0};
    const spin_json *clip;
    spin_json *doc;

    make_frame(&s, 20, 0, 3);
    spoil_frame(&s);
    spin_set_verbosity(-2);
    ok(run(&spin_exporter_html, &job, &s, 0) == SPIN_OK, "a frame with bad rows");
    load(job.output);
    clip = clip_of(&doc);
    ok(decode(spin_json_at(spin_json_get(clip, "versions"), 0), 0, 0, 0, &c) && c.shared == 14,
       "those that cannot be drawn are left out");
    spin_json_free(doc);
    spin_splats_free(&s);
}

/* The last byte of a gzip is the highest of its size: 0 below 16 MiB. */
static void test_large(void)
{
    const char *pairs[] = {"sh", "keep", "bound-sh", "0.0001", NULL};
    struct spin_plugin_values values = {pairs};
    struct spin_export_job job = {
        .output = in_folder("large.html"), .n_frames = 1, .sh_degree = 3, .values = &values};
    struct spin_splats s = {0};
    unsigned char *bytes = malloc(1 << 25);

    make_frame(&s, 160000, 3, 5);
    memset(s.sh, 0, 48 * 159999 * sizeof *s.sh); /* as many bytes, but soon packed */
    ok(run(&spin_exporter_html, &job, &s, 0) == SPIN_OK && load(job.output) &&
           block("v0f0", bytes, 1 << 25) >> 24 == 1,
       "a block of more than 16 MiB");
    spin_splats_free(&s);
    free(bytes);
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
    static const char *const bad[][2] = {{"sh", "4"},
                                         {"min-opacity", "2"},
                                         {"max-splats", "0"},
                                         {"every", "x"},
                                         {"fps", "-1"},
                                         {"only", "both"},
                                         {"level", "x"},
                                         {"bound-place", "0"},
                                         {"bound-colour", "-1"},
                                         {"bound-scale", "0"},
                                         {"bound-rotation", "90"},
                                         {"bound-sh", "x"},
                                         {"key-every", "300"}};
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
    test_split();
    test_draft();
    test_mean();
    test_choice();
    test_most_visible();
    test_bad_rows();
    test_large();
    test_camera();
    test_refusals();
    free(page);
}
