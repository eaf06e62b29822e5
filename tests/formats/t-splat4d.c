/* .splat4d files written by the words of the format, apart from its reader.
 * K: splat4d formats import */
#include "formats/splat4d.h"
#include "io/compress.h"
#include "tests/formats/splats.h"

enum { N = 37, FRAMES = 7, GROUP = 3, JSON = 1400 };
enum { POS, ROT, RGB, ALPHA, SCALE };

static const int widths[5] = {3, 4, 3, 1, 3}, symbols[5] = {4, 1, 2, 1, 2};
static const double steps[5] = {0.25, 3, 9, 5, 0.125}, base_steps[5] = {0.0625, 1, 1, 1, 0.0625};

static bool moves(int a, int row) { return a != ALPHA && (row + a) % 3 == 0; }

/* The steps of a value: of rows that stand still the same in all frames. */
static int step_of(int a, int row, int frame, int c)
{
    int f = moves(a, row) ? frame : 0;

    if (a == POS)
        return 1000 * (row % 5) - 70 * c - 300 * f * (row % 4 - 1);
    if (a == ROT)
        return moves(a, row) ? (9 * row + 17 * c + 5 * f) % 80 - 40
                             : (31 * row + 50 * c) % 250 - 125;
    if (a == SCALE)
        return -20 - row % 9 - c - (f % 2) * (row % 3);
    return moves(a, row) ? 27 - row + 2 * f - c : (11 * row + 3 * c) % 256;
}

struct bytes {
    unsigned char at[1 << 15];
    size_t n;
};

static void append(struct bytes *b, const void *data, size_t n)
{
    memcpy(b->at + b->n, data, n);
    b->n += n;
}

static void put_number(struct bytes *b, uint64_t v, int n)
{
    for (int k = 0; k < n; k++)
        b->at[b->n++] = (unsigned char)(v >> 8 * k);
}

static uint32_t zigzag(int v) { return v < 0 ? (uint32_t)(-2 * v - 1) : (uint32_t)(2 * v); }

static void put_stream(struct bytes *heads, struct bytes *packed, int a, int kind, int symbol,
                       const uint32_t *values, size_t n)
{
    unsigned char planes[1 << 15], *out = NULL;
    size_t n_room = 0, n_out = 0;

    for (int b = 0; b < symbol; b++)
        for (size_t i = 0; i < n; i++)
            planes[(size_t)b * n + i] = (unsigned char)(values[i] >> 8 * b);
    if (spin_zstd_write(planes, n * (size_t)symbol, 1, &out, &n_room, &n_out) != SPIN_OK)
        exit(1);
    put_number(heads, (uint64_t)a, 1);
    put_number(heads, (uint64_t)kind, 1);
    put_number(heads, (uint64_t)symbol, 1);
    put_number(heads, n, 4);
    put_number(heads, n_out, 4);
    append(packed, out, n_out);
    free(out);
}

static void put_static(struct bytes *b)
{
    static const int bases[5] = {POS, SCALE, RGB, ALPHA, ROT};
    uint32_t values[4 * N];

    for (int a = 0; a < 5; a++) {
        memset(values, 0, sizeof values);
        for (int i = 0; i < N; i++)
            if (!moves(a, i))
                values[i / 8] |= 128u >> i % 8;
        put_stream(b, b, a, 2, 1, values, (N + 7) / 8);
    }
    for (int k = 0; k < 5; k++) {
        int a = bases[k], w = widths[a];

        for (int i = 0; i < w * N; i++) {
            int v = step_of(a, i / w, 0, i % w),
                before = i < w ? 0 : step_of(a, i / w - 1, 0, i % w);

            values[i] = a == POS || a == SCALE ? zigzag(v - before)
                        : a == ROT             ? (uint32_t)(v + 128)
                                               : (uint32_t)(v & 255);
        }
        put_stream(b, b, a, 2, a == POS ? 4 : a == SCALE ? 2 : 1, values, (size_t)(w * N));
    }
}

/* One of the streams of a group, and bytes that the first group has besides. */
static int left_out = -1, surplus;

static void put_group(struct bytes *b, int first, int last)
{
    static struct bytes packed;
    uint32_t values[4 * N * GROUP];
    size_t count = b->n;

    packed.n = 0;
    put_number(b, 0, 2);
    for (int kind = 0; kind < 2; kind++)
        for (int a = 0; a < 5; a++) {
            size_t n = 0;

            for (int f = kind ? first + 1 : first; f <= (kind ? last : first); f++)
                for (int i = 0; i < N; i++)
                    for (int c = 0; c < widths[a] && moves(a, i); c++)
                        values[n++] =
                            zigzag(step_of(a, i, f, c) - (kind ? step_of(a, i, f - 1, c) : 0));
            if (n == 0 || 5 * kind + a == left_out)
                continue;
            put_stream(b, &packed, a, kind, symbols[a], values, n);
            b->at[count]++;
        }
    append(b, packed.at, packed.n);
}

static size_t static_at, group_at[3];

/* `find` in the JSON becomes `by`; NULL: it stays. */
static struct bytes *make(const char *find, const char *by)
{
    static struct bytes b;
    static char text[2 * JSON];
    size_t n_static;
    int n;
    char *at;

    b.n = 0;
    append(&b, "SP4D\1\0\1\0", 8);
    put_number(&b, JSON, 4);
    static_at = b.n += JSON;
    put_static(&b);
    n_static = b.n - static_at;
    n = snprintf(
        text, sizeof text,
        "{\"n\": %d, \"t\": %d, \"fps\": 12.5, \"steps\": {\"pos\": %g, \"base_pos\": %g, "
        "\"scale_log\": %g, \"base_scale_log\": %g, \"rgb\": 9, \"alpha\": 5, \"rot\": 3}, "
        "\"static_section\": {\"offset\": %zu, \"len\": %zu}, \"gops\": [",
        N, FRAMES, steps[POS], base_steps[POS], steps[SCALE], base_steps[SCALE], static_at,
        n_static);
    for (int f = 0; f < FRAMES; f += GROUP) {
        int last = f + GROUP < FRAMES ? f + GROUP - 1 : FRAMES - 1;

        group_at[f / GROUP] = b.n;
        put_group(&b, f, last);
        put_number(&b, 0, f ? 0 : surplus);
        n += snprintf(text + n, sizeof text - (size_t)n,
                      "%s{\"offset\": %zu, \"len\": %zu, \"f0\": %d, \"f1\": %d}", f ? ", " : "",
                      group_at[f / GROUP], b.n - group_at[f / GROUP], f, last);
    }
    n += snprintf(text + n, sizeof text - (size_t)n, "]}");
    if (find) {
        at = strstr(text, find);
        memmove(at + strlen(by), at + strlen(find), strlen(at + strlen(find)) + 1);
        memcpy(at, by, strlen(by));
        n = (int)strlen(text);
    }
    memset(b.at + 12, ' ', JSON);
    memcpy(b.at + 12, text, (size_t)n);
    return &b;
}

/* All frames. */
static spin_status read_all(const unsigned char *bytes, size_t n, struct spin_splats *out)
{
    struct spin_splat4d clip;
    spin_status status = spin_splat4d_open(bytes, n, &clip);

    for (int f = 0; status == SPIN_OK && f < clip.n_frames; f++)
        status = spin_splat4d_read(&clip, f, ALL, out);
    spin_splat4d_close(&clip);
    return status;
}

/* The largest differences: places and log scales, rotations, colours and opacities. */
static void compare(const struct spin_splats *s, int frame, double worst[3])
{
    for (int i = 0; i < N; i++) {
        double value[5][4], norm = 0;

        for (int a = 0; a < 5; a++)
            for (int c = 0; c < widths[a]; c++) {
                double v = step_of(a, i, frame, c) * (moves(a, i) ? steps : base_steps)[a];

                value[a][c] = a == RGB || a == ALPHA ? fmin(fmax(v, 0), 255) / 255 : v;
                norm += a == ROT ? v * v : 0;
            }
        for (int c = 0; c < 3; c++) {
            worst[0] = larger(worst[0], fabs(s->means[3 * i + c] - value[POS][c]));
            worst[0] = larger(worst[0], fabs(s->log_scales[3 * i + c] - value[SCALE][c]));
            worst[2] = larger(worst[2],
                              fabs(0.5 + 0.28209479177387814 * s->sh[3 * i + c] - value[RGB][c]));
        }
        for (int c = 0; c < 4; c++)
            worst[1] = larger(worst[1], fabs(s->quats[4 * i + c] - value[ROT][c] / sqrt(norm)));
        worst[2] =
            larger(worst[2], fabs(1 / (1 + exp(-(double)s->logit_opacities[i])) - value[ALPHA][0]));
    }
}

static void test_order(void)
{
    static const int order[] = {0, 1, 2, 3, 4, 5, 6, 6, 5, 1, 0, 4, 3, 3, 5, 2};
    struct bytes *b = make(NULL, NULL);
    struct spin_splat4d clip;
    struct spin_splats s = {0};
    double worst[3] = {0};
    int n = 0;

    ok(spin_splat4d_open(b->at, b->n, &clip) == SPIN_OK && clip.n == N && clip.n_frames == FRAMES &&
           clip.fps == 12.5 && clip.smoothed &&
           clip.moving == (ALL & ~(unsigned)SPIN_COL_LOGIT_OPACITIES),
       "a clip, and what of it moves");
    for (size_t i = 0; i < sizeof order / sizeof *order; i++) {
        if (spin_splat4d_read(&clip, order[i], ALL, &s) != SPIN_OK) {
            printf("#   frame %d: %s\n", order[i], spin_last_error());
            break;
        }
        compare(&s, order[i], worst);
        n++;
    }
    ok(n == sizeof order / sizeof *order, "frames are read in any order");
    near(worst[0], 0, 0, "places and log scales");
    near(worst[1], 0, 1e-7, "rotations");
    near(worst[2], 0, 1e-6, "colours and opacities");
    ok(spin_splat4d_read(&clip, FRAMES, ALL, &s) == SPIN_E_NOT_FOUND &&
           spin_splat4d_read(&clip, -1, ALL, &s) == SPIN_E_NOT_FOUND,
       "there are no other frames");
    spin_splat4d_close(&clip);
    spin_splats_free(&s);
}

static void refused(struct bytes *b, const char *word, const char *what)
{
    struct spin_splats s = {0};

    if (!ok(read_copy(read_all, b->at, b->n, &s) != SPIN_OK && strstr(spin_last_error(), word),
            "%s", what))
        printf("#   %s\n", spin_last_error());
    spin_splats_free(&s);
}

/* The second group claims the bytes of the first. */
static void test_shared_bytes(void)
{
    char find[80], by[80];

    make(NULL, NULL);
    snprintf(find, sizeof find, "{\"offset\": %zu, \"len\": %zu", group_at[1],
             group_at[2] - group_at[1]);
    snprintf(by, sizeof by, "{\"offset\": %zu, \"len\": %zu", group_at[0],
             group_at[1] - group_at[0]);
    refused(make(find, by), "group 1 overlaps with group 0", "two groups of the same bytes");
}

static void test_header(void)
{
    static const struct {
        const char *find, *by, *word;
    } lies[] = {
        {"\"n\": 37", "\"n\": 0", "'n'"},
        {"\"n\": 37", "\"n\": 3000000", "cannot contain 3000000 splats"},
        {"\"n\": 37", "\"n\": 30", "has 5 values, expected 4"},
        {"\"n\": 37", "\"n\": 40", "has 111 values, expected 120"},
        {"\"t\": 7", "\"t\": 8", "'gops' contain 7 frames, but 't' declares 8"},
        {"\"t\": 7", "\"t\": 6", "'f1'"},
        {"\"t\": 7", "\"t\": 2000000", "'t'"},
        {"\"fps\": 12.5", "\"fps\": 0", "'fps'"},
        {"\"pos\": 0.25", "\"pos\": -1", "'pos'"},
        {"\"base_pos\": 0.0625", "\"base_pos\": 1e300", "'pos' are not finite"},
        {"\"rot\": 3", "\"rot\": null", "'rot'"},
        {"\"scale_log\": 0.125", "\"scale_log\": 1e300", "'scale' are not finite"},
        {"\"f0\": 3", "\"f0\": 4", "'f0'"},
        {"\"f1\": 2", "\"f1\": 1", "'f0'"},
        {"\"offset\": 1412", "\"offset\": 1413", "the static section"},
        {"\"offset\": 1412", "\"offset\": 99999999", "'offset'"},
        {"\"offset\": 1412", "\"offset\": -4", "'offset'"},
        {"\"gops\"", "\"gaps\"", "'gops' contain 0 frames, but 't' declares 7"},
        {"{\"n\"", "[\"n\"", "'header'"},
    };

    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        char what[100];

        snprintf(what, sizeof what, "header: %s", lies[i].by);
        refused(make(lies[i].find, lies[i].by), lies[i].word, what);
    }
}

static void test_streams(void)
{
    enum { HEAD, STATIC, ONE }; /* where a byte is counted from */
    static const struct {
        int of;
        size_t at;
        uint64_t value;
        int n;
        const char *word, *what;
    } lies[] = {
        {HEAD, 4, 2, 2, "version 2", "another version"},
        {HEAD, 0, 'X', 1, "gsplat-unity", "no magic: perhaps the format that has none"},
        {HEAD, 8, 0xffffffff, 4, "truncated within the header",
         "a header that ends behind the file"},
        {STATIC, 0, 1, 1, "another stream instead of 'pos'", "masks in another order"},
        {STATIC, 1, 0, 1, "another stream instead of 'pos'", "a stream of another kind"},
        {STATIC, 2, 2, 1, "zstd data expand to 5 bytes, expected 10",
         "bits in symbols of two bytes"},
        {STATIC, 7, 0xffffff, 4, "extends beyond its section",
         "a stream that ends behind its section"},
        {ONE, 0, 0xffff, 2, "truncated within the headers", "more heads than bytes"},
        {ONE, 2 + 11, 0, 1, "occurs twice", "two streams of one attribute"},
        {ONE, 2, 5, 1, "is invalid or", "another attribute"},
        {ONE, 3, 2, 1, "is invalid or", "another kind"},
        {ONE, 4, 3, 1, "symbols of 3 bytes", "symbols of 3 bytes"},
        {ONE, 5, 0x7fffffff, 4, "2147483647 values, expected", "billions of values"},
        {ONE, 9, 1, 4, "damaged zstd", "a stream cut short"},
    };
    struct bytes *b;

    for (size_t i = 0; i < sizeof lies / sizeof *lies; i++) {
        struct bytes to = {.n = 0};

        b = make(NULL, NULL);
        put_number(&to, lies[i].value, lies[i].n);
        memcpy(b->at + lies[i].at +
                   (lies[i].of == STATIC ? static_at
                    : lies[i].of == ONE  ? group_at[1]
                                         : 0),
               to.at, to.n);
        refused(b, lies[i].word, lies[i].what);
    }
    left_out = 1;
    refused(make(NULL, NULL), "group 0: stream 'rot' of kind 'key' is missing",
            "a group without a key");
    left_out = 5;
    refused(make(NULL, NULL), "group 0: stream 'pos' of kind 'change' is missing",
            "or without changes");
    left_out = -1;
    refused(make("\"f1\": 6", "\"f1\": 6, \"len\": 2"), "group 2: truncated within the headers",
            "a group cut short");
    surplus = 1;
    refused(make(NULL, NULL), "group 0: extra bytes after the streams", "and one with more bytes");
    surplus = 0;
    b = make(NULL, NULL);
    memcpy(b->at, "SPL4DV02", 8);
    refused(b, "gsplat-unity (version 2)", "the format of the Unity package, by name");
}

TAP_MAIN
{
    struct bytes *b;

    if (spin_zstd_need() != SPIN_OK) {
        skip("splat4d", spin_last_error());
        return;
    }
    test_order();
    test_header();
    test_shared_bytes();
    test_streams();
    b = make(NULL, NULL);
    check_hostile(read_all, b->at, b->n, 0);
}
