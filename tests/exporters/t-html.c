/* K: html export */
#include <zlib.h>

#include "base/log.h"
#include "exporters/lib/page_bytes.h"
#include "math/sh.h"
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

/* ---- What the page makes of a block: after exporters/html/format.md, not after the encoder
 * ------------ */

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

static size_t referred_in(const spin_json *version, int frame)
{
    char key[16];
    double x = 0;

    snprintf(key, sizeof key, "%d", frame);
    spin_json_number(spin_json_get(spin_json_get(version, "referred"), key), &x);
    return (size_t)x;
}

/* The keys of a group, of which the first are rows of the base. */
static void group_keys(const spin_json *version, int frame, struct columns *c, size_t columns)
{
    static long base[COLUMNS][ROWS];
    static size_t n_base;
    size_t referred = referred_in(version, frame), n = 0;
    long(*key)[ROWS] = c->key;

    for (size_t i = 0; referred > 0 && i < n_base; i++)
        if (at[i / 8] >> i % 8 & 1) {
            for (size_t k = 0; k < columns; k++)
                key[k][n] = base[k][i];
            n++;
        }
    at += referred > 0 ? (n_base + 7) / 8 : 0;
    ok(n == referred, "%zu rows of an earlier key frame", referred);
    for (size_t k = 0; k < columns; k++)
        whole(key[k] + n, c->shared - n);
    for (size_t i = n; i < c->shared; i++) {
        key[3][i] += key[4][i];
        key[5][i] += key[4][i];
    }
    if (referred > 0)
        return;
    memcpy(base, key, sizeof base);
    n_base = c->still;
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
        group_keys(version, frame, c, columns);
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

/* A row as the page decodes it: position 3, colour 3, opacity, log scale 3, q 4, sh. */
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

/* Every splat of the frame is in the page, within these bounds: world, 0..1, log, degrees, 1.
 * Rows may come in any order: a splat is identified by its position. */
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
                apart = larger(apart, fabs(v[k] - w.place[k]));
            if (apart < best)
                memcpy(found, v, sizeof found);
            best = fmin(best, apart);
        }
        worst[0] = larger(worst[0], best);
        for (size_t k = 0; k < 3; k++) {
            worst[1] = larger(worst[1], fabs(found[3 + k] - 0.5 - 0.28209479177387814 * w.dc[k]));
            worst[2] = larger(worst[2], fabs(found[7 + k] - w.log_scale[k]));
        }
        worst[1] = larger(worst[1], fabs(found[6] - w.opacity));
        worst[3] = larger(worst[3], degrees_between(found + 10, w.q));
        for (size_t k = 0; k < (size_t)n_sh; k++)
            worst[4] = larger(worst[4], fabs(found[14 + k] - (double)s->sh[width * i + 3 + k]));
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

/* Frames 7, 9, 11, ... of a clip of 40 splats, equal except for the positions of the first ten. */
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
    const char *pairs[] = {"sh", "keep", "bound-place", "0.002", "fps", "25", NULL};
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

/* Other bounds, and a key every second frame; then the blocks in a file of their own: the same
 * bytes. */
enum { MANY = 3000, DRAFT_COLUMNS = 13 };

/* Frames with that many splats, others in each, with --split and a key every frame; loads the page
 * and maps the data. */
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
    if (spin_exporter_html.begin(&job, &self) != SPIN_OK)
        exit(1);
    for (int f = 0; f < n_frames; f++) {
        struct spin_frame_info info = {.number = f, .n = n};

        make_frame(&s, n, 0, 5 + (uint32_t)f);
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

/* The first image needs less than a tenth of the data: it is drawn from a draft, splats of the
 * first frame of which some are enlarged to cover about the same area. */
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
                apart = larger(apart, fabs(0.5 * (double)x[k][i] * step_of(doc, k) + middle -
                                           (double)w.place[k]));
            }
            is = apart < best ? w : is;
            best = fmin(best, apart);
        }
        for (size_t k = 0; k < 3; k++) {
            scale[k] = 0.5 * (double)x[7 + k][i] * step_of(doc, 7);
            grown = larger(grown, fabs(scale[k] - (double)is.log_scale[k] -
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
    version = split_clip("wide.html", 100000, 12, &data, &doc);
    draft = spin_json_get(version, "draft");
    ok(0.05 * number(draft, "at") > 620000 && number(draft, "bytes") <= 600000 &&
           number(draft, "bytes") > 500000,
       "of a large clip, it has %.0f bytes", number(draft, "bytes"));
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
    ok(decode(version, 0, 0, 9, &now) && decode(version, 0, 2, 9, &now),
       "the third frame needs no frame but the first");
    ok(referred_in(version, 0) == 0 && referred_in(version, 1) == 0 &&
           referred_in(version, 2) == 30 && now.still == 30 &&
           3 * count(version, "bytes", 2) < 2 * count(version, "bytes", 0),
       "whose static splats it does not store again: %zu and %zu bytes", count(version, "bytes", 0),
       count(version, "bytes", 2));
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
        wrong += spin_page_encode_changes(&b, x, ROWS, &state) != SPIN_OK;
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
    ok(number(clip, "fps") == 1.25, "five frames in two seconds, each standing for two");
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

/* ---- 4D splats
 * -------------------------------------------------------------------------------------- */

enum { SPLATS = 50, PIECES = 2000, FRAMES = 5, ROW_COLUMNS = COLUMNS + 60 };
static const double even[FRAMES] = {10, 10.5, 11, 11.5, 12};
static const int rows_of_numbers[FRAMES] = {3, 5, 7, 9, 11};

/* Rows of a clip of half seconds: windows of half a frame to many, plateaus, cuts, gates,
 * rotations. */
static void make_4d(struct spin_splats_4d *s, int degree, int sh_degree, unsigned parts)
{
    struct spin_splats like = {0};
    size_t n_sh = 3 * (size_t)((sh_degree + 1) * (sh_degree + 1)), n_dropped;
    uint32_t seed = 77;

    make_frame(&like, SPLATS, sh_degree, 5);
    if (spin_splats_4d_reserve(s, SPLATS, degree, sh_degree, parts) != SPIN_OK)
        exit(1);
    memcpy(s->centres, like.means, sizeof(float[SPLATS][3]));
    memcpy(s->quats, like.quats, sizeof(float[SPLATS][4]));
    memcpy(s->log_scales, like.log_scales, sizeof(float[SPLATS][3]));
    memcpy(s->logit_opacities, like.logit_opacities, sizeof(float[SPLATS]));
    memcpy(s->sh, like.sh, SPLATS * n_sh * sizeof(float));
    s->least_weight = 0.05;
    s->period = 1.7;
    for (size_t i = 0; i < SPLATS; i++) {
        s->times[i] = draw(&seed, 9.5f, 12.5f);
        s->sigmas[i] = i % 5 == 0 ? SPIN_FOREVER : draw(&seed, 0.02f, 2);
        for (size_t k = 0; k < 3 * (size_t)degree; k++)
            s->paths[3 * (size_t)degree * i + k] = i % 7 == 1 ? 0 : draw(&seed, -2, 2);
        for (size_t k = 0; k < 4 && s->spins; k++)
            s->spins[4 * i + k] = i % 3 == 0 ? 0 : draw(&seed, -1, 1);
        if (s->plateaus) {
            s->plateaus[3 * i] = s->times[i] - draw(&seed, 0, 0.4f);
            s->plateaus[3 * i + 1] = s->times[i] + draw(&seed, 0, 0.4f);
            s->plateaus[3 * i + 2] = draw(&seed, 0.05f, 1);
        }
        if (s->cuts) {
            s->cuts[2 * i] = i % 4 == 0 ? 10.5f : draw(&seed, 9, 11);
            s->cuts[2 * i + 1] = i % 4 == 1 ? 11.5f : draw(&seed, 11, 13);
        }
        if (s->gates)
            s->gates[i] = i % 2 ? 0 : draw(&seed, 0, 1);
        for (size_t k = 0; k < 2 * n_sh && s->sh_cos; k++)
            s->sh_cos[2 * n_sh * i + k] = draw(&seed, -0.4f, 0.4f);
    }
    if (spin_splats_4d_finish(s, &n_dropped, NULL) != SPIN_OK || n_dropped > 0)
        exit(1);
    spin_splats_free(&like);
}

static spin_status again(void *context, int frame, const struct spin_splats **out)
{
    static struct spin_splats s;
    const struct spin_export_job *job = context;

    *out = &s;
    return spin_splats_4d_slice(job->splats_4d, job->times[frame],
                                SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, &s);
}

static spin_status run_4d(struct spin_export_job *job, const struct spin_splats_4d *s)
{
    void *self = NULL;

    job->force = true;
    job->sh_degree = s->sh_degree;
    job->splats_4d = s;
    job->times = job->times ? job->times : even;
    job->numbers = rows_of_numbers;
    job->n_frames = job->n_frames ? job->n_frames : FRAMES;
    job->again = again;
    job->context = job;
    SPIN_TRY(spin_exporter_html.begin(job, &self));
    return spin_exporter_html.end(self);
}

struct rows {
    long x[ROW_COLUMNS][PIECES];
    size_t n, columns;
};

/* All blocks of the page's first version, after exporters/html/format.md. */
static int decode_rows(const spin_json *version, size_t columns, struct rows *r)
{
    static unsigned char bytes[1 << 20];
    size_t n_blocks = spin_json_length(spin_json_get(version, "splats"));

    r->n = 0;
    r->columns = columns;
    for (size_t b = 0; b < n_blocks; b++) {
        size_t n = count(version, "splats", (int)b), size;
        char id[32];

        snprintf(id, sizeof id, "v0f%zu", b);
        size = block(id, bytes, sizeof bytes);
        if (size == 0 || r->n + n > PIECES)
            return 0;
        at = bytes;
        end = bytes + size;
        for (size_t c = 0; c < columns; c++) {
            int head = at < end ? *at : 0;

            whole(r->x[c] + r->n, n);
            for (size_t i = r->n; head & 32 && i < r->n + n; i++)
                r->x[c][i] += r->x[c - 1][i];
        }
        r->n += n;
        if (at != end)
            return 0;
    }
    return 1;
}

/* exp(-s^2/2), where s is the distance in sigmas of the time beyond the plateau. */
static double side(const spin_json *rows, double from, double length, long sigma, long middle,
                   double frame, int sign)
{
    double half = length / 32, power = (double)(sigma > 0 ? sigma - 1 : sigma), z;

    power /= number(rows, "octave");
    if (sigma == 0)
        return 1;
    z = frame - (from / 16 + half) -
        (double)middle * number(rows, "middle") * half * exp2(floor(power));
    z = fmax(0, sign * z) / (half * exp2(power));
    return exp(-0.5 * z * z);
}

/* Row i as the page shows it at a tick; 0: invisible. */
static int shown_4d(const struct rows *r, const spin_json *clip, size_t i, int n_sh, int tick,
                    double *v)
{
    const spin_json *version = spin_json_at(spin_json_get(clip, "versions"), 0);
    const spin_json *rows = spin_json_get(version, "rows");
    int degree = (int)number(rows, "degree"), gated = !isnan(number(rows, "gate"));
    int turns = !isnan(number(rows, "ratio")), waves = !isnan(number(rows, "period"));
    const spin_json *plateaus = spin_json_get(rows, "plateaus");
    size_t c = 13 + (size_t)n_sh;
    double from = (double)r->x[c][i], length = (double)r->x[c + 1][i], frame = tick / 16.0, s,
           share;
    long sigma = r->x[c + 2][i], middle = r->x[c + 3][i], sigma2 = sigma, middle2 = middle;
    double gate = 0, weight, a[3], p[4];

    if (tick < from || tick >= from + length)
        return 0;
    share = (tick - from) / length;
    s = share * degree;
    for (size_t k = 0; k < 13 + (size_t)n_sh; k++)
        v[k < 13 ? k : k + 1] = (double)r->x[k][i] * step_of(clip, k);
    for (int k = 0; k < 3; k++)
        a[k] = v[10 + k];
    turn(a, p);
    memcpy(v + 10, p, sizeof p);
    c += 4;
    if (json_is_true(plateaus)) {
        middle2 = r->x[c][i];
        sigma2 = r->x[c + 1][i];
        c += 2;
    }
    for (int d = 1; d <= degree; d++, c += 3) {
        double share_d = s;

        for (int k = 1; k < d; k++)
            share_d *= (s - k) / (k + 1);
        for (size_t k = 0; k < 3; k++)
            v[k] += share_d * (double)r->x[c + k][i] * step_of(clip, 0);
    }
    for (size_t k = 0; k < 3; k++) {
        double centre = 0;

        spin_json_number(spin_json_at(spin_json_get(clip, "centre"), k), &centre);
        v[k] += centre;
    }
    if (gated)
        gate = (double)r->x[c++][i] * number(rows, "gate");
    weight = side(rows, from, length, sigma, middle, frame, -1) *
             side(rows, from, length, sigma2, middle2, frame, 1);
    v[6] = fmin(fmax(v[6], 0), 1) * (gate + (1 - gate) * weight);
    if (turns) {
        double q[4], b[4], more = share * exp((double)r->x[c + 3][i] * number(rows, "ratio"));
        double norm = 0;

        for (size_t k = 0; k < 3; k++)
            a[k] = (double)r->x[c + k][i] * step_of(clip, 10);
        turn(a, b);
        q[0] = p[0] * b[0] - p[1] * b[1] - p[2] * b[2] - p[3] * b[3];
        q[1] = p[0] * b[1] + p[1] * b[0] + p[2] * b[3] - p[3] * b[2];
        q[2] = p[0] * b[2] - p[1] * b[3] + p[2] * b[0] + p[3] * b[1];
        q[3] = p[0] * b[3] + p[1] * b[2] - p[2] * b[1] + p[3] * b[0];
        for (int k = 0; k < 4; k++) {
            q[k] = (1 - share) * p[k] + more * q[k];
            norm += q[k] * q[k];
        }
        for (int k = 0; k < 4; k++)
            v[10 + k] = q[k] / sqrt(norm);
        c += 4;
    }
    for (size_t k = 0; k < 3 + (size_t)n_sh && waves; k++) {
        double angle = 2 * 3.14159265358979 * frame / number(rows, "period") -
                       (double)r->x[c][i] * number(rows, "phase");

        v[k < 3 ? 3 + k : 11 + k] += number(rows, k < 3 ? "cosine" : "cosine_sh") *
                                     (cos(angle) * (double)r->x[c + 1 + k][i] +
                                      cos(2 * angle) * (double)r->x[c + 4 + k + (size_t)n_sh][i]);
    }
    return 1;
}

/* Every splat of a slice that is more than barely visible is in the page, within the bounds, and
 * no other. */
static void check_slice(const struct rows *r, const spin_json *clip, const struct spin_splats_4d *s,
                        int n_sh, int tick, double worst[5], size_t counts[3])
{
    double time = 10 + tick / 32.0;
    struct spin_splats slice = {0};
    size_t width = 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1));

    if (spin_splats_4d_slice(s, time, SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES, &slice) != SPIN_OK)
        exit(1);
    for (size_t i = 0; i < slice.n; i++) {
        struct want w = want_of(&slice, i);
        double best = INFINITY, v[COLUMNS + 1], found[COLUMNS + 1] = {0};

        counts[0] += w.opacity >= 1 / 255.0;
        for (size_t j = 0; j < r->n; j++) {
            double apart = 0;

            if (!shown_4d(r, clip, j, n_sh, tick, v))
                continue;
            for (int k = 0; k < 3; k++)
                apart = larger(apart, fabs(v[k] - w.place[k]));
            if (apart < best)
                memcpy(found, v, sizeof found);
            best = fmin(best, apart);
        }
        if (best > 0.01 && w.opacity < 0.51 / 255)
            continue;
        counts[1] += w.opacity >= 1 / 255.0;
        worst[0] = larger(worst[0], best);
        for (size_t k = 0; k < 3; k++) {
            worst[1] = larger(worst[1], fabs(found[3 + k] - 0.5 - 0.28209479177387814 * w.dc[k]));
            worst[2] = larger(worst[2], fabs(found[7 + k] - w.log_scale[k]));
        }
        worst[1] = larger(worst[1], fabs(found[6] - w.opacity));
        worst[3] = larger(worst[3], degrees_between(found + 10, w.q));
        for (size_t k = 0; k < (size_t)n_sh; k++)
            worst[4] = larger(worst[4], fabs(found[14 + k] - (double)slice.sh[width * i + 3 + k]));
    }
    for (size_t j = 0; j < r->n; j++) {
        double v[COLUMNS + 1];

        counts[2] += (size_t)shown_4d(r, clip, j, n_sh, tick, v);
    }
    counts[2] -= slice.n;
    spin_splats_free(&slice);
}

static void test_4d(void)
{
    static const struct {
        const char *what;
        int degree, sh_degree;
        unsigned parts;
        size_t columns;
    } kinds[] = {{"still ones", 0, 0, 0, 17},
                 {"lines", 1, 1, 0, 13 + 9 + 7},
                 {"parabolas with a beginning and an end", 2, 0, SPIN_4D_CUTS, 13 + 10},
                 {"all there is", 3, 2,
                  SPIN_4D_SPINS | SPIN_4D_PLATEAUS | SPIN_4D_CUTS | SPIN_4D_GATES | SPIN_4D_SH_COS,
                  13 + 24 + 4 + 2 + 9 + 1 + 4 + 1 + 2 * 27}};
    static struct rows rows;
    const char *pairs[] = {"sh", "keep", "bound-place", "0.002", "key-every", "1", NULL};
    struct spin_plugin_values values = {pairs};

    for (size_t kind = 0; kind < 4; kind++) {
        struct spin_export_report report = {0};
        struct spin_export_job job = {
            .output = in_folder("rows.html"), .values = &values, .report = &report, .check = true};
        struct spin_splats_4d s = {0};
        double worst[5] = {0};
        size_t counts[3] = {0};
        const spin_json *clip, *version;
        int n_sh = 3 * (spin_sh_count(kinds[kind].sh_degree) - 1);
        spin_json *doc;

        make_4d(&s, kinds[kind].degree, kinds[kind].sh_degree, kinds[kind].parts);
        ok(run_4d(&job, &s) == SPIN_OK && load(job.output), "4D splats, %s: %s", kinds[kind].what,
           spin_last_error());
        clip = clip_of(&doc);
        ok(number(clip, "keep") > 0.2 && number(clip, "keep") < 0.3, "what narrow windows show");
        version = spin_json_at(spin_json_get(clip, "versions"), 0);
        ok(spin_json_length(spin_json_get(clip, "numbers")) == FRAMES &&
               decode_rows(version, kinds[kind].columns, &rows) && rows.n >= 25,
           "%zu rows with %zu columns", rows.n, kinds[kind].columns);
        for (int tick = 0; tick <= 64; tick += 2)
            check_slice(&rows, clip, &s, n_sh, tick, worst, counts);
        ok(counts[0] > 250 && counts[1] == counts[0] && (ptrdiff_t)counts[2] <= 0,
           "at each of 33 times all of them that are more than faint, and no others");
        for (int k = 0; k < (n_sh ? 5 : 4); k++)
            ok(worst[k] <= normal[k] && worst[k] > normal[k] / 4, "within %g (%g)", normal[k],
               worst[k]);
        near(report.check.largest[0], worst[0], 2e-4, "the same in the report");
        near(report.check.largest[2], worst[3], 0.2, "of rotations in degrees");
        ok(report.check.frames == FRAMES && report.frames == FRAMES && report.splats_mean > 20 &&
               report.check.rms[0] > 0.1 * report.check.largest[0] &&
               report.check.rms[0] < 0.8 * report.check.largest[0],
           "of all frames");
        spin_json_free(doc);
        spin_splats_4d_free(&s);
    }
}

/* Clips shorter than two seconds take two, unless the options set another duration. */
static void test_short(void)
{
    static const struct {
        int n_frames;
        double fps, want;
        const char *own;
    } cases[] = {{3, 25, 1.5, NULL},
                 {3, 0, 1.5, NULL},
                 {3, 25, 50, "50"},
                 {3, 1, 1, NULL},
                 {1, 25, 25, NULL}};

    for (size_t k = 0; k < sizeof cases / sizeof cases[0]; k++) {
        const char *pairs[] = {"title", "1 < 2", cases[k].own ? "fps" : NULL, cases[k].own, NULL};
        struct spin_plugin_values values = {pairs};
        struct spin_export_job job = {.output = in_folder("short.html"),
                                      .force = true,
                                      .n_frames = cases[k].n_frames,
                                      .fps = cases[k].fps,
                                      .sh_degree = 2,
                                      .values = &values};
        spin_json *doc;

        ok(run_clip(&job, cases[k].n_frames) == SPIN_OK && load(job.output), "%d frames at %g",
           cases[k].n_frames, cases[k].fps);
        near(number(clip_of(&doc), "fps"), cases[k].want, 1e-9, "are shown so fast");
        ok(strcmp(spin_json_string(spin_json_get(doc, "title")), "1 < 2") == 0 &&
               strstr(page, "<title>1 &lt; 2</title>"),
           "under their title");
        spin_json_free(doc);
    }
}

/* Clips that rows cannot represent are written as frames. */
static void test_4d_as_frames(void)
{
    static const double uneven[FRAMES] = {10, 10.5, 11, 11.6, 12};
    const char *some[] = {"max-splats", "9", NULL}, *every[] = {"every", "2", NULL};
    struct spin_plugin_values values = {some};
    struct spin_splats_4d s = {0};
    static struct rows rows;

    make_4d(&s, 1, 0, 0);
    for (int k = 0; k < 4; k++) {
        struct spin_export_job job = {.output = in_folder("rows.html")};
        const spin_json *clip, *version;
        spin_json *doc;

        values.pairs = k == 0 ? some : every;
        job.values = k == 0 || k == 3 ? &values : NULL;
        job.times = k == 1 ? uneven : NULL;
        job.n_frames = k == 2 ? 1 : 0;
        ok(run_4d(&job, &s) == SPIN_OK && load(job.output), "written: %s", spin_last_error());
        clip = clip_of(&doc);
        version = spin_json_at(spin_json_get(clip, "versions"), 0);
        if (k == 3) {
            double last = 0;

            spin_json_number(spin_json_at(spin_json_get(clip, "numbers"), 2), &last);
            ok(last == 11 && decode_rows(version, 20, &rows) && count(version, "end", 0) == 33,
               "every second frame: as rows, of three frames");
        } else
            ok(!spin_json_get(version, "rows") &&
                   spin_json_length(spin_json_get(version, "first")) == (k == 2 ? 1 : FRAMES),
               "as frames: %s",
               k == 0   ? "some splats of each"
               : k == 1 ? "uneven times"
                        : "one");
        spin_json_free(doc);
    }
    spin_splats_4d_free(&s);
    make_4d(&s, 0, 0, 0);
    for (size_t i = 0; i < s.n; i++)
        s.spans[2 * i] = s.spans[2 * i + 1] = 99;
    {
        struct spin_export_job job = {.output = in_folder("none.html")};

        ok(run_4d(&job, &s) == SPIN_E_UNSUPPORTED &&
               strstr(spin_last_error(), "no splat is visible") && !spin_path_exists(job.output),
           "none that is seen: refused, and nothing is left");
    }
    spin_splats_4d_free(&s);
}

static void test_refusals(void)
{
    static const char *const bad[][2] = {{"sh", "4"},          {"max-splats", "0"},
                                         {"every", "x"},       {"fps", "-1"},
                                         {"only", "both"},     {"level", "x"},
                                         {"bound-place", "0"}, {"bound-colour", "-1"},
                                         {"bound-scale", "0"}, {"bound-rotation", "90"},
                                         {"bound-sh", "x"},    {"key-every", "300"}};
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
    test_large();
    test_camera();
    test_short();
    test_4d();
    test_4d_as_frames();
    test_refusals();
    free(page);
}
