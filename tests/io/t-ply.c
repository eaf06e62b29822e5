/* K: ply */
#include <unistd.h>

#include "base/err.h"
#include "base/log.h"
#include "io/ply.h"
#include "tests/check.h"
#include "tests/tap.h"

/* ---- Helpers --------------------------------------------------------------------------------- */

/* Parse bytes from a block of exactly their size, so that a sanitizer sees every step outside. */
static spin_status parse_exact(const void *bytes, size_t n, struct spin_ply *ply,
                               unsigned char **block)
{
    *block = malloc(n ? n : 1);
    memcpy(*block, bytes, n);
    return spin_ply_parse("test.ply", *block, n, ply);
}

/* Must be refused, with this word in the message. */
static void refuses(const char *text, size_t n, const char *word, const char *what)
{
    struct spin_ply ply;
    unsigned char *block;
    spin_status status = parse_exact(text, n, &ply, &block);

    if (!ok(status == SPIN_E_MALFORMED && strstr(spin_last_error(), word), "rejects %s", what))
        printf("#   status %d, '%s', wanted '%s'\n", status, status ? spin_last_error() : "", word);
    if (status == SPIN_OK)
        spin_ply_close(&ply);
    free(block);
}

static void refuses_text(const char *text, const char *word, const char *what)
{
    refuses(text, strlen(text), word, what);
}

/* Columns of names in element vertex, [n][n_names]; NULL when one is missing. */
static float *read_columns(const struct spin_ply *ply, const char *const *names, size_t n_names)
{
    const struct spin_ply_element *e = spin_ply_find_element(ply, "vertex");
    float *out;

    if (!e)
        return NULL;
    out = calloc(e->count * n_names + 1, sizeof *out);
    for (size_t i = 0; i < n_names; i++) {
        int p = spin_ply_find(e, names[i]);

        if (p < 0) {
            free(out);
            return NULL;
        }
        spin_ply_column(ply, e, p, out + i, n_names);
    }
    return out;
}

static unsigned char *read_file(const char *path, size_t *n)
{
    FILE *file = fopen(path, "rb");
    unsigned char *bytes = NULL;

    *n = 0;
    if (!file)
        return NULL;
    fseek(file, 0, SEEK_END);
    *n = (size_t)ftell(file);
    rewind(file);
    bytes = malloc(*n + 1);
    if (fread(bytes, 1, *n, file) != *n)
        *n = 0;
    fclose(file);
    return bytes;
}

/* ---- Fixtures -------------------------------------------------------------------------------- */

static const char *const all_names[] = {
    "x",        "y",        "z",        "f_dc_0",   "f_dc_1",   "f_dc_2",   "f_rest_0", "f_rest_1",
    "f_rest_2", "f_rest_3", "f_rest_4", "f_rest_5", "f_rest_6", "f_rest_7", "f_rest_8", "opacity",
    "scale_0",  "scale_1",  "scale_2",  "rot_0",    "rot_1",    "rot_2",    "rot_3"};
#define N_ALL (sizeof all_names / sizeof all_names[0])

/* All columns of a file of 23 known properties; NULL when it cannot be read. */
static float *load_all(const char *name, size_t *n)
{
    const char *path = check_fixture(name);
    struct spin_ply ply;
    float *out;

    if (!path || spin_ply_open(path, &ply) != SPIN_OK)
        return NULL;
    out = read_columns(&ply, all_names, N_ALL);
    *n = out ? spin_ply_find_element(&ply, "vertex")->count * N_ALL : 0;
    spin_ply_close(&ply);
    return out;
}

static void test_values(const float *base, size_t n)
{
    const char *path = check_fixture("ply/variants/expected.npz");
    struct spin_npz npz;
    struct spin_array a;
    double *means, *rest;
    float *x = calloc(n, sizeof *x), *y = calloc(n, sizeof *y);

    if (!path || !ok(spin_npz_open(path, &npz) == SPIN_OK, "opens the expected values"))
        return;
    means = check_load(&npz, "0000_means", &a);
    rest = check_load(&npz, "0000_sh_rest", &a);
    for (size_t i = 0; i < n / N_ALL; i++) {
        memcpy(x + 3 * i, base + N_ALL * i, 3 * sizeof *x);
        for (size_t k = 0; k < 3; k++) {
            for (size_t c = 0; c < 3; c++)
                y[9 * i + 3 * k + c] = base[N_ALL * i + 6 + 3 * c + k];
        }
    }
    if (means)
        check_close(x, means, n / N_ALL * 3, 2e-6, 2e-5, "positions as the method's own reader");
    if (rest)
        check_close(y, rest, n / N_ALL * 9, 2e-6, 2e-5, "f_rest as the method's own reader");
    free(means);
    free(rest);
    free(x);
    free(y);
    spin_npz_close(&npz);
}

static void test_variants(void)
{
    size_t n = 0, m = 0;
    float *base = load_all("ply/variants/base.ply", &n);
    float *other = load_all("ply/variants/big_endian.ply", &m);
    float worst = 0;

    if (!base) {
        skip("variants", "no fixture ply/variants");
        return;
    }
    test_values(base, n);
    ok(other && n == m && memcmp(base, other, n * sizeof *base) == 0, "big endian is the same");
    free(other);
    other = load_all("ply/variants/ascii.ply", &m);
    ok(other && n == m, "reads ascii");
    for (size_t i = 0; other && i < n; i++)
        worst = larger(worst, fabsf(other[i] - base[i]));
    near(worst, 0, 1e-5, "ascii is the same");
    free(other);
    free(base);
    ok(load_all("ply/variants/missing_opacity.ply", &m) == NULL,
       "opacity is not found when missing");
}

static void test_truncated_fixture(void)
{
    const char *path = check_fixture("ply/variants/truncated.ply");
    struct spin_ply ply;

    if (!path) {
        skip("truncated fixture", "no fixture ply/variants");
        return;
    }
    ok(spin_ply_open(path, &ply) == SPIN_E_MALFORMED && strstr(spin_last_error(), path) &&
           strstr(spin_last_error(), "cut short"),
       "names the truncated file");
}

/* Every step-th shorter length: an error, never a step outside. */
static void test_every_length(const char *name, size_t step, bool must_fail)
{
    const char *path = check_fixture(name);
    size_t n, n_accepted = 0;
    unsigned char *bytes = path ? read_file(path, &n) : NULL;

    if (!bytes) {
        skip(name, "no fixture");
        return;
    }
    for (size_t i = 0; i < n; i += step) {
        struct spin_ply ply;
        unsigned char *block;

        if (parse_exact(bytes, i, &ply, &block) == SPIN_OK) {
            n_accepted++;
            spin_ply_close(&ply);
        }
        free(block);
    }
    /* Text may lose its last line end, and digits of its last number. */
    ok(n_accepted <= (must_fail ? 0 : 2), "%s: refuses shorter lengths", name);
    if (must_fail) {
        const char *cut = check_truncated(path, n - 1);
        struct spin_ply ply;

        ok(spin_ply_open(cut, &ply) == SPIN_E_MALFORMED, "a file one byte short is refused");
    }
    free(bytes);
}

static void test_other_writers(void)
{
    static const struct {
        const char *path;
        size_t n, n_properties;
    } files[] = {{"ply/brush_sh1/00001.ply", 120, 23}, {"ply/gsplat_sh2/00001.ply", 130, 38}};

    for (size_t i = 0; i < 2; i++) {
        const char *path = check_fixture(files[i].path);
        const struct spin_ply_element *e;
        struct spin_ply ply;

        if (!path) {
            skip(files[i].path, "no fixture");
            continue;
        }
        if (!ok(spin_ply_open(path, &ply) == SPIN_OK, "opens %s", files[i].path))
            continue;
        e = spin_ply_find_element(&ply, "vertex");
        ok(e && e->count > 0 && e->n_properties == files[i].n_properties && ply.extra_bytes == 0,
           "%s: records and properties", files[i].path);
        if (i == 0)
            is_text(ply.n_comments ? ply.comment[0] : NULL, "Exported from Brush",
                    "keeps comments");
        spin_ply_close(&ply);
    }
}

static void test_compressed(void)
{
    const char *path = check_fixture("ply/supersplat_compressed/cloud.compressed.ply");
    struct spin_ply ply;

    if (!path || !ok(spin_ply_open(path, &ply) == SPIN_OK, "opens a compressed PLY")) {
        skip("compressed", "no fixture");
        return;
    }
    ok(spin_ply_find_element(&ply, "chunk") && spin_ply_find_element(&ply, "sh") &&
           !spin_ply_find_element(&ply, "face"),
       "finds its elements");
    spin_ply_close(&ply);
}

/* ---- Made files ------------------------------------------------------------------------------ */

#define HEAD "ply\nformat binary_little_endian 1.0\n"

static void test_header_words(void)
{
    static const char text[] =
        "ply\r\nformat ascii 1.0\r\ncomment end_header\r\ncomment   element vertex 9  \r\n"
        "obj_info property float q\r\nelement  vertex   2   \r\nproperty float32 x\r\n"
        "property uchar red\r\nend_header\r\n1.5 255\r\n\r\nnan 7\r\nmore\r\n";
    struct spin_ply ply;
    unsigned char *block;
    float *values;
    static const char *const names[] = {"x", "red"};

    if (!ok(parse_exact(text, sizeof text - 1, &ply, &block) == SPIN_OK, "reads CRLF text"))
        return;
    values = read_columns(&ply, names, 2);
    ok(values && values[0] == 1.5f && values[1] == 255 && isnan(values[2]) && values[3] == 7,
       "values of CRLF text");
    ok(ply.n_comments == 2, "two comments");
    is_text(ply.comment[0], "end_header", "a comment may say end_header");
    ok(ply.extra_bytes == 6, "counts what follows");
    free(values);
    spin_ply_close(&ply);
    free(block);
}

/* vertex after an element with lists, and itself with a list between its scalars; all types. */
static void test_lists(void)
{
    static const char head[] = HEAD
        "element face 2\nproperty list uchar int vertex_indices\nproperty short tag\n"
        "element vertex 2\nproperty double x\nproperty list uint8 float extra\nproperty short y\n"
        "element tail 1\nproperty uint u\nend_header\n";
    static const unsigned char body[] = {
        2,    1,    0,    0,    0, 2, 0,    0,    0, 0xff, 0xff, /* two indices, tag */
        0,    5,    0,                                           /* none, tag */
        0,    0,    0,    0,    0, 0, 0xf8, 0x3f, 1, 0,    0,
        0x80, 0x3f, 0xfe, 0xff,                               /* 1.5 [1] -2 */
        0,    0,    0,    0,    0, 0, 0,    0xc0, 0, 3,    0, /* -2 [] 3 */
        0xff, 0xff, 0xff, 0xff,                               /* 2^32 - 1 */
        9,    9,    9};
    unsigned char file[sizeof head + sizeof body];
    static const char *const names[] = {"x", "y"};
    size_t n = sizeof head - 1 + sizeof body, n_refused = 0;
    struct spin_ply ply;
    unsigned char *block;
    float *values, u = 0;

    memcpy(file, head, sizeof head - 1);
    memcpy(file + sizeof head - 1, body, sizeof body);
    if (!ok(parse_exact(file, n, &ply, &block) == SPIN_OK, "skips lists"))
        return;
    values = read_columns(&ply, names, 2);
    ok(values && values[0] == 1.5f && values[1] == -2 && values[2] == -2 && values[3] == 3,
       "reads around lists");
    spin_ply_column(&ply, spin_ply_find_element(&ply, "tail"), 0, &u, 1);
    ok(u == 4294967296.0f, "reads an element after lists");
    ok(spin_ply_find(spin_ply_find_element(&ply, "vertex"), "extra") == -1, "a list is no column");
    ok(ply.extra_bytes == 3, "counts bytes after the last record");
    free(values);
    spin_ply_close(&ply);
    free(block);
    for (size_t i = 0; i < n - 3; i++) {
        n_refused += parse_exact(file, i, &ply, &block) == SPIN_E_MALFORMED;
        free(block);
    }
    ok(n_refused == n - 3, "refuses every shorter length of a file with lists");
}

static void test_types(void)
{
    static const char text[] =
        "ply\nformat binary_big_endian 1.0\nelement vertex 1\n"
        "property char a\nproperty ushort b\nproperty int c\n"
        "property float64 d\nproperty uint16 e\nproperty int8 f\nend_header\n"
        "\xff\x01\x00\xff\xff\xff\xfe\x3f\xe0\0\0\0\0\0\0\xff\xff\x7f";
    static const char *const names[] = {"a", "b", "c", "d", "e", "f"};
    static const float want[] = {-1, 256, -2, 0.5f, 65535, 127};
    struct spin_ply ply;
    unsigned char *block;
    float *values;

    if (!ok(parse_exact(text, sizeof text - 1, &ply, &block) == SPIN_OK, "reads every type"))
        return;
    values = read_columns(&ply, names, 6);
    check_same_bits(values, want, sizeof want, "values of every type");
    free(values);
    spin_ply_close(&ply);
    free(block);
}

static void test_empty(void)
{
    static const char text[] = HEAD "element vertex 0\nproperty float x\nend_header\n";
    struct spin_ply ply;
    unsigned char *block;

    ok(parse_exact(text, sizeof text - 1, &ply, &block) == SPIN_OK &&
           spin_ply_find_element(&ply, "vertex")->count == 0,
       "an element may be empty");
    spin_ply_close(&ply);
    free(block);
}

static void test_hostile(void)
{
    static char endless[200 * 1024];

    refuses_text("", "ply", "an empty file");
    refuses_text("plx\nformat ascii 1.0\nend_header\n", "'ply'", "another magic");
    refuses_text("ply\nend_header\n", "format", "no format");
    refuses_text("ply\nformat ascii 1.0\n", "end_header", "no end_header");
    refuses_text("ply\nformat ascii 2.0\nend_header\n", "version", "another version");
    refuses_text("ply\nformat binary_middle_endian 1.0\nend_header\n", "format",
                 "an unknown format");
    refuses_text("ply\nformat ascii 1.0\nformat ascii 1.0\nend_header\n", "second", "two formats");
    refuses_text("ply\nformat ascii 1.0\n\xff\x01 x\nend_header\n", "keyword", "a strange keyword");
    refuses_text(HEAD "property float x\nend_header\n", "before", "a property of nothing");
    refuses_text(HEAD "element vertex -1\nend_header\n", "count", "a negative count");
    refuses_text(HEAD "element vertex 1e3\nend_header\n", "count", "a count that is no integer");
    refuses_text(HEAD "element vertex\nend_header\n", "count", "no count");
    refuses_text(HEAD "element vertex 99999999999999999999\nend_header\n", "count",
                 "a count beyond 64 bits");
    refuses_text(HEAD "element vertex 18446744073709551615\nproperty float x\nend_header\nabcd",
                 "cut short", "a count beyond the file");
    refuses_text(HEAD "element vertex 4611686018427387905\nproperty float x\nend_header\nabcd",
                 "cut short", "a count whose bytes overflow");
    refuses_text(HEAD "element vertex 9000000000000000000\nend_header\n", "no properties",
                 "records of nothing");
    refuses_text(HEAD "element v 1\nelement v 1\nend_header\n", "second", "an element twice");
    refuses_text(HEAD "element v 1\nproperty float x\nproperty int x\nend_header\n", "twice",
                 "a property twice");
    refuses_text(HEAD "element v 1\nproperty quad x\nend_header\n", "type", "an unknown type");
    refuses_text(HEAD "element v 1\nproperty float\nend_header\n", "name", "a nameless property");
    refuses_text(HEAD "element v 1\nproperty list float int x\nend_header\n", "cannot have type",
                 "a list counted in floats");
    refuses_text(HEAD "element v 1\nproperty list char int x\nend_header\n\xff", "wrong count",
                 "a negative list");
    refuses_text(HEAD "element v 1\nproperty list uint double x\nend_header\n\xff\xff\xff\xff",
                 "wrong count", "a huge list");
    refuses_text(HEAD "element v 9000000000000000000\nproperty list uchar int x\nend_header\n\x0",
                 "cut short", "many lists that are not there");
    refuses_text("ply\nformat ascii 1.0\nelement v 2\nproperty float x\nend_header\n1\n",
                 "record 1", "a missing line");
    refuses_text("ply\nformat ascii 1.0\nelement v 1\nproperty float x\nend_header\n1 2\n",
                 "record 0", "a line with too much");
    refuses_text("ply\nformat ascii 1.0\nelement v 1\nproperty float x\nend_header\n1.2.3\n",
                 "record 0", "a word that is no number");
    refuses_text("ply\nformat ascii 1.0\nelement v 9000000000000000000\nproperty float x\n"
                 "end_header\n1\n",
                 "cut short", "a count beyond the text");
    refuses_text("ply\nformat ascii 1.0\nelement v 1\nproperty list uchar float x\nend_header\n"
                 "1e300 1 2\n",
                 "record 0", "an endless list");
    memset(endless, 'c', sizeof endless);
    memcpy(endless, HEAD "comment ", sizeof HEAD "comment ");
    refuses(endless, sizeof endless, "end_header", "a header without end");
}

/* A frame of 100,000 splats, all 62 columns: the figure is printed, not judged. */
static void test_speed(void)
{
    enum { N = 100000, WIDTH = 62 };
    size_t n_body = (size_t)N * WIDTH * 4;
    char *file = calloc(1, n_body + 4096);
    int n = sprintf(file, HEAD "element vertex %d\n", N);
    struct spin_ply_target target[WIDTH];
    struct spin_ply ply;
    float *out = calloc((size_t)N * WIDTH, sizeof *out);
    double start, best_s = 1e9;

    for (int i = 0; i < WIDTH; i++) {
        n += sprintf(file + n, "property float p%d\n", i);
        target[i] = (struct spin_ply_target){i, out + i, WIDTH};
    }
    n += sprintf(file + n, "end_header\n");
    for (size_t i = 0; i < n_body / 4; i++) {
        float value = (float)i;

        memcpy(file + n + 4 * i, &value, 4);
    }
    if (!ok(spin_ply_parse("big", (unsigned char *)file, (size_t)n + n_body, &ply) == SPIN_OK,
            "opens a large file"))
        return;
    start = spin_now_s();
    for (int i = 0; i < 4; i++) {
        start = spin_now_s();
        spin_ply_columns(&ply, &ply.element[0], target, WIDTH);
        best_s = fmin(best_s, spin_now_s() - start);
    }
    printf("# columns: %.2f GB/s\n", (double)n_body / best_s / 1e9);
    ok(memcmp(out, file + n, n_body) == 0, "all columns at once");
    spin_ply_close(&ply);
    free(out);
    free(file);
}

static void check_antialiased(void)
{
    static const char *const yes[] = {"antialiased 1", "SplatRenderMode: mip",
                                      "splatrendermode: MIP"},
                             *const no[] = {"antialiased 0", "antialiased 10", "antialiased",
                                            "SplatRenderMode: default"};
    int wrong = 0;

    for (int i = 0; i < 7; i++) {
        char *comments[] = {"first", (char *)(uintptr_t)(i < 3 ? yes[i] : no[i - 3])};
        const struct spin_ply ply = {.comment = comments, .n_comments = 2};

        wrong += spin_ply_is_antialiased(&ply) != (i < 3);
    }
    ok(wrong == 0, "comments that say how splats were trained");
}

TAP_MAIN
{
    check_antialiased();
    test_variants();
    test_truncated_fixture();
    test_every_length("ply/variants/base.ply", 1, true);
    test_every_length("ply/variants/ascii.ply", 17, false);
    test_other_writers();
    test_compressed();
    test_header_words();
    test_lists();
    test_types();
    test_empty();
    test_hostile();
    test_speed();
}
