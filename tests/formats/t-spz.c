/* K: spz formats export */
#include "formats/spz.h"
#include "io/gzip.h"
#include "tests/formats/splats.h"

static spin_status read_spz(const unsigned char *bytes, size_t n_bytes, struct spin_splats *out)
{
    return spin_spz_read(bytes, n_bytes, ALL, out);
}

/* A gzip of these bytes. */
static unsigned char *pack(const unsigned char *bytes, size_t n, size_t *n_packed)
{
    char *packed = NULL;
    struct spin_out out = {.path = "memory", .file = open_memstream(&packed, n_packed)};
    struct spin_gzip *gzip = NULL;

    if (spin_gzip_create(1, 1, &gzip) != SPIN_OK || spin_gzip_begin(gzip, &out) != SPIN_OK ||
        spin_gzip_write(gzip, bytes, n) != SPIN_OK || spin_gzip_end(gzip) != SPIN_OK)
        exit(1);
    spin_gzip_free(gzip);
    fclose(out.file);
    return (unsigned char *)packed;
}

/* What is packed, of n rows. */
static unsigned char *make_streams(size_t n, int degree, struct spin_gaussian *row, size_t *n_bytes)
{
    const struct spin_spz_header header = {n, degree, SPIN_SPZ_FRACTION, true};
    unsigned char *bytes, *at;
    uint32_t seed = 9;
    float shown[45], sh[48];

    *n_bytes = (size_t)spin_spz_bytes(n, degree);
    bytes = at = malloc(*n_bytes);
    spin_spz_code_header(&header, at);
    at += SPIN_SPZ_HEADER;
    for (size_t i = 0; i < n; i++)
        row[i] = make_row(&seed);
    for (int k = 0; k < 48; k++)
        sh[k] = (float)k / 32 - 0.75f;
    for (int stream = 0; stream < SPIN_SPZ_STREAMS; stream++) {
        for (size_t i = 0; i < n; i++, at += spin_spz_width(stream, degree)) {
            if (stream == SPIN_SPZ_PLACE)
                spin_spz_code_place(row[i].place, SPIN_SPZ_FRACTION, at, shown);
            else if (stream == SPIN_SPZ_ALPHA)
                *at = spin_spz_code_alpha(row[i].opacity, shown);
            else if (stream == SPIN_SPZ_COLOUR)
                spin_spz_code_colour(row[i].colour, at, shown);
            else if (stream == SPIN_SPZ_SCALE)
                spin_spz_code_scale(row[i].log_scale, at, shown);
            else if (stream == SPIN_SPZ_ROTATION)
                spin_spz_code_rotation(row[i].rotation, at, shown);
            else
                spin_spz_code_sh(sh, 16, degree, at, shown);
        }
    }
    return bytes;
}

static void test_round_trip(int degree)
{
    struct spin_gaussian row[50];
    struct spin_splats s = {0};
    size_t n_bytes, n_packed, n_sh = 3 + spin_n_rest(degree);
    unsigned char *bytes = make_streams(50, degree, row, &n_bytes);
    unsigned char *packed = pack(bytes, n_bytes, &n_packed);
    int good = 1, sh = 1;

    if (!ok(read_spz(packed, n_packed, &s) == SPIN_OK && s.n == 50 && s.sh_degree == degree &&
                s.antialias,
            "degree %d is read back", degree))
        return;
    for (size_t i = 0; i < 50; i++) {
        good &= is_row(&s, i, &row[i], 0.5 / 4096 * 1.001, 1 / 32.0, 0.0038);
        for (size_t k = 3; k < n_sh; k++)
            sh &= fabs(s.sh[n_sh * i + k] - ((double)k / 32 - 0.75)) <= 0.0626;
    }
    ok(good, "rows are within half a step");
    ok(sh, "coefficients are at their places");
    free(bytes);
    free(packed);
    spin_splats_free(&s);
}

static void test_places(void)
{
    static const float far[3] = {-8388606, 8388606, 0};
    float shown[3];
    unsigned char out[9];

    ok(spin_spz_fraction(2047, 12) == 12 && spin_spz_fraction(2049, 12) == 11 &&
           spin_spz_fraction(1, 10) == 10 && spin_spz_fraction(8388606, 12) == 0 &&
           spin_spz_fraction(1e7f, 12) < 0,
       "as many fractional bits as hold a place");
    spin_spz_code_place(far, 0, out, shown);
    ok(memcmp(shown, far, sizeof far) == 0, "the farthest place");
}

/* Headers that lie, in a gzip that is whole. */
static void test_headers(void)
{
    static const struct {
        size_t at;
        unsigned char value;
        spin_status status;
        const char *what;
    } cases[] = {{0, 0, SPIN_E_MALFORMED, "no magic"},
                 {4, 2, SPIN_E_UNSUPPORTED, "another version"},
                 {8, 4, SPIN_E_MALFORMED, "a splat more than there are"},
                 {11, 255, SPIN_E_MALFORMED, "billions of splats"},
                 {12, 4, SPIN_E_UNSUPPORTED, "SH of degree 4"},
                 {12, 2, SPIN_E_MALFORMED, "another degree"}};
    struct spin_gaussian row[3];
    struct spin_splats s = {0};
    size_t n_bytes, n_packed;
    unsigned char *bytes = make_streams(3, 1, row, &n_bytes), *packed;

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        unsigned char before = bytes[cases[i].at];

        bytes[cases[i].at] = cases[i].value;
        packed = pack(bytes, n_bytes, &n_packed);
        ok(read_spz(packed, n_packed, &s) == cases[i].status, "%s", cases[i].what);
        bytes[cases[i].at] = before;
        free(packed);
    }
    for (int k = 0; k < 256; k++) { /* any fraction, any rotation */
        bytes[13] = (unsigned char)k;
        memset(bytes + SPIN_SPZ_HEADER + 16 * 3, k, 12);
        packed = pack(bytes, n_bytes, &n_packed);
        if (read_spz(packed, n_packed, &s) != SPIN_OK || !all_finite(&s))
            ok(0, "byte %d", k);
        free(packed);
    }
    packed = pack(bytes, n_bytes, &n_packed);
    memset(packed + n_packed - 4, 255, 4);
    ok(read_spz(packed, n_packed, &s) != SPIN_OK, "a gzip that says it holds 4 GB");
    free(packed);
    packed = pack(bytes, n_bytes, &n_packed);
    check_hostile(read_spz, packed, n_packed, 0);
    free(packed);
    free(bytes);
    spin_splats_free(&s);
}

TAP_MAIN
{
    for (int degree = 0; degree <= 3; degree++)
        test_round_trip(degree);
    test_places();
    test_headers();
}
