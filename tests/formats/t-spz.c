/* K: spz formats export */
#include "tests/formats/spz_files.h"

static spin_status read_spz(const unsigned char *bytes, size_t n_bytes, struct spin_splats *out)
{
    return spin_spz_read(bytes, n_bytes, ALL, out);
}

/* What is packed, of n rows. */
static unsigned char *make_streams(size_t n, int degree, struct spin_gaussian *row, size_t *n_bytes)
{
    const struct spin_spz_header header = {.n = n,
                                           .sh_degree = degree,
                                           .fraction = SPIN_SPZ_FRACTION,
                                           .antialias = true,
                                           .version = 3};
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

/* Half a step of the quantisation at most lies between a value and its decoded one. */
static void test_decoded_values(void)
{
    static const float colour[3] = {0.1f, 0.5f, 0.9f}, scale[3] = {-9.3f, -4.77f, 2.21f};
    float shown[3] = {0}, worst = 0;
    unsigned char out[3];

    for (int k = 0; k <= 10; k++) {
        spin_spz_code_alpha((float)k / 10, shown);
        worst = (float)larger((double)worst, fabs((double)shown[0] - k / 10.0));
    }
    ok(worst < 0.501f / 255, "the decoded opacity");
    spin_spz_code_colour(colour, out, shown);
    for (int c = 0; c < 3; c++)
        ok(fabsf(shown[c] - colour[c]) < 0.5f * 0.2820948f / (0.15f * 255) + 1e-6f,
           "the decoded colour, channel %d", c);
    spin_spz_code_scale(scale, out, shown);
    for (int c = 0; c < 3; c++)
        ok(fabsf(shown[c] - scale[c]) <= 1.001f / 32, "the decoded log scale, axis %d", c);
}

/* Malformed headers in a valid gzip stream. */
static void test_headers(void)
{
    static const struct {
        size_t at;
        unsigned char value;
        spin_status status;
        const char *what;
    } cases[] = {{0, 0, SPIN_E_MALFORMED, "no magic"},
                 {4, 1, SPIN_E_UNSUPPORTED, "version 1"},
                 {4, 5, SPIN_E_UNSUPPORTED, "version 5"},
                 {4, 4, SPIN_E_MALFORMED, "version 4 in a gzip"},
                 {4, 2, SPIN_E_MALFORMED, "another version, whose rotations are shorter"},
                 {8, 4, SPIN_E_MALFORMED, "a splat more than there are"},
                 {11, 255, SPIN_E_MALFORMED, "billions of splats"},
                 {12, 5, SPIN_E_UNSUPPORTED, "SH of degree 5"},
                 {12, 2, SPIN_E_MALFORMED, "another degree"},
                 {14, 128, SPIN_E_UNSUPPORTED, "a flag of another writer"}};
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

/* ---- Versions 2 and 4 --------------------------------------------------------------------------
 */

/* The header of n rows and what lies behind it, every byte of it drawn. */
static unsigned char *make_raw(int version, size_t n, int degree, size_t *n_bytes)
{
    const struct spin_spz_header header = {
        .n = n, .sh_degree = degree, .fraction = SPIN_SPZ_FRACTION, .version = 3};
    size_t width = 16 + (version == 2 ? 3 : 4) + spin_n_rest(degree);
    unsigned char *bytes;
    uint32_t seed = 2;

    *n_bytes = SPIN_SPZ_HEADER + n * width;
    bytes = malloc(*n_bytes);
    spin_spz_code_header(&header, bytes);
    bytes[4] = (unsigned char)version;
    for (size_t i = SPIN_SPZ_HEADER; i < *n_bytes; i++)
        bytes[i] = (unsigned char)draw(&seed, 0, 255.99f);
    return bytes;
}

/* Rotations of version 2 by the words of the format: x y z of a unit quaternion whose w is not
 * negative. */
static void test_version_2(void)
{
    static const unsigned char rotation[4][3] = {
        {128, 127, 128}, {255, 128, 127}, {0, 255, 255}, {191, 64, 191}};
    struct spin_splats s = {0};
    size_t n_bytes, n_packed;
    unsigned char *bytes = make_raw(2, 4, 1, &n_bytes), *packed;

    memcpy(bytes + SPIN_SPZ_HEADER + 16 * 4, rotation, sizeof rotation);
    packed = pack(bytes, n_bytes, &n_packed);
    ok(read_spz(packed, n_packed, &s) == SPIN_OK && s.n == 4 && s.sh_degree == 1,
       "version 2 is read");
    for (size_t i = 0; i < s.n; i++) {
        double q[4] = {0}, square = 0, norm = 0, dot = 0;

        for (int k = 0; k < 3; k++) {
            q[1 + k] = rotation[i][k] / 127.5 - 1;
            square += q[1 + k] * q[1 + k];
        }
        q[0] = sqrt(fmax(1 - square, 0));
        for (size_t k = 0; k < 4; k++) {
            norm += q[k] * q[k];
            dot += q[k] * s.quats[4 * i + k];
        }
        near(dot / sqrt(norm), 1, 1e-6, "its rotation");
        ok(s.quats[4 * i] >= 0, "and w is not negative");
    }
    ok(s.sh[15] == ((float)bytes[n_bytes - 27] - 128) / 128,
       "SH lie behind three bytes a rotation");
    check_hostile(read_spz, packed, n_packed, 0);
    free(packed);
    free(bytes);
    spin_splats_free(&s);
}

/* Versions 2 and 3 without their gzip. */
static void test_plain(int version)
{
    static const unsigned char record[] = {3, 0, 0xbe, 0xad, 4, 0, 0, 0, 4, 0, 0, 0};
    struct spin_splats s = {0}, packed_s = {0};
    struct spin_spz_header header;
    size_t n_bytes, n_packed;
    unsigned char *bytes = make_raw(version, 7, 2, &n_bytes), *longer;
    unsigned char *packed = pack(bytes, n_bytes, &n_packed);

    ok(read_spz(bytes, n_bytes, &s) == SPIN_OK &&
           read_spz(packed, n_packed, &packed_s) == SPIN_OK && s.n == 7 && s.sh_degree == 2 &&
           !memcmp(s.means, packed_s.means, 12 * s.n) &&
           !memcmp(s.quats, packed_s.quats, 16 * s.n) && !memcmp(s.sh, packed_s.sh, 108 * s.n),
       "version %d that is not packed is what the packed one is", version);
    check_hostile(read_spz, bytes, n_bytes, 0);
    longer = calloc(n_bytes + sizeof record, 1);
    memcpy(longer, bytes, n_bytes);
    memcpy(longer + n_bytes, record, sizeof record);
    ok(read_spz(longer, n_bytes + sizeof record, &s) == SPIN_E_MALFORMED,
       "bytes behind its streams are refused");
    longer[14] |= 2;
    ok(spin_spz_peek(longer, n_bytes + sizeof record, &header) == SPIN_OK &&
           header.axes == SPIN_SPZ_RIGHT_UP_BACK,
       "but for extensions");
    free(longer);
    free(packed);
    free(bytes);
    spin_splats_free(&s);
    spin_splats_free(&packed_s);
}

static void test_version_4(int degree)
{
    struct spin_splats s = {0}, as_3 = {0};
    size_t n_bytes, n_packed, size;
    unsigned char *bytes = make_raw(3, 21, degree, &n_bytes),
                  *packed = pack(bytes, n_bytes, &n_packed);
    unsigned char *file = make_spz_4(bytes, NULL, 0, &size);
    size_t n_sh = 21 * (3 + spin_n_rest(degree < 3 ? degree : 3));

    if (degree <= 3)
        ok(read_spz(packed, n_packed, &as_3) == SPIN_OK, "degree %d in version 3", degree);
    if (!ok(read_spz(file, size, &s) == SPIN_OK && s.n == 21 &&
                s.sh_degree == (degree < 3 ? degree : 3),
            "degree %d in version 4", degree))
        printf("#   %s\n", spin_last_error());
    if (degree <= 3)
        ok(!memcmp(s.means, as_3.means, 12 * s.n) && !memcmp(s.quats, as_3.quats, 16 * s.n) &&
               !memcmp(s.log_scales, as_3.log_scales, 12 * s.n) &&
               !memcmp(s.logit_opacities, as_3.logit_opacities, 4 * s.n) &&
               !memcmp(s.sh, as_3.sh, n_sh * sizeof *s.sh),
           "is what version 3 holds");
    else /* row 1, coefficient 15 of red: behind 72 bytes of row 0 */
        ok(s.sh[48 + 45] == ((float)bytes[n_bytes - 21 * 72 + 72 + 42] - 128) / 128,
           "is cut behind the coefficients of degree 3");
    check_hostile(read_spz, file, size, 0);
    free(file);
    free(packed);
    free(bytes);
    spin_splats_free(&s);
    spin_splats_free(&as_3);
}

/* Malformed tables of contents and streams. */
static void test_streams(void)
{
    static const struct {
        size_t at;
        unsigned char value;
        const char *word, *what;
    } cases[] = {
        {4, 3, "21 splats take", "version 3 without a gzip, of another length"},
        {8, 20, "does not match 20 splats", "a splat less than there are"},
        {11, 1, "splats", "16 million splats"},
        {15, 5, "stream 5", "a stream less"},
        {15, 7, "beyond the file", "a stream more"},
        {16, 31, "table of contents", "a table inside the header"},
        {18, 1, "table of contents", "a table behind the file"},
        {32, 1, "streams", "a shorter stream"},
        {39, 255, "beyond the file", "a stream that ends behind the file"},
        {40, 7, "does not match", "a stream of other bytes"},
        {47, 255, "does not match", "a stream of very many bytes"},
        {32 + 96, 0, "stream 0: damaged zstd", "no zstd"},
    };
    struct spin_splats s = {0};
    size_t n_bytes, size;
    unsigned char *bytes = make_raw(3, 21, 1, &n_bytes);
    unsigned char *file = make_spz_4(bytes, NULL, 0, &size);

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        unsigned char before = file[cases[i].at];
        bool good;

        file[cases[i].at] = cases[i].value;
        good = read_spz(file, size, &s) == SPIN_E_MALFORMED &&
               strstr(spin_last_error(), cases[i].word);
        if (!ok(good, "%s", cases[i].what))
            printf("#   %s\n", spin_last_error());
        file[cases[i].at] = before;
    }
    free(file);
    /* A whole file, whose streams are one repeated byte each. */
    free(bytes);
    bytes = make_raw(3, 2000000, 0, &n_bytes);
    file = make_spz_4_of_runs(bytes, &size);
    ok(size < 5000 && read_spz(file, size, &s) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "cannot contain 2000000 splats"),
       "a bomb of 40 MB in %zu bytes", size);
    free(file);
    bytes[8] = bytes[9] = bytes[10] = 0;
    bytes[8] = 200;
    file = make_spz_4_of_runs(bytes, &size);
    ok(read_spz(file, size, &s) == SPIN_OK && s.n == 200, "a small one is a file");
    free(file);
    bytes[8] = 0;
    file = make_spz_4(bytes, NULL, 0, &size);
    ok(size == 32 && read_spz(file, size, &s) == SPIN_OK && s.n == 0, "no splats, no streams");
    free(file);
    free(bytes);
    spin_splats_free(&s);
}

/* Records of extensions: axes, unknown ones, malformed ones. */
static void test_extensions(void)
{
    static const unsigned char records[] = {2, 0, 0xbe, 0xad, 3, 0, 0, 0, 1, 2, 3, /* a camera's */
                                            3, 0, 0xbe, 0xad, 4, 0, 0, 0, 7, 0, 0, 0};
    struct spin_spz_header header;
    struct spin_splats s = {0};
    unsigned char spoiled[sizeof records], *file, *packed, *longer;
    size_t n_bytes, size, n_packed;
    unsigned char *bytes = make_raw(3, 5, 0, &n_bytes);
    double q[4];

    bytes[14] |= 2;
    file = make_spz_4(bytes, records, sizeof records, &size);
    ok(spin_spz_peek(file, size, &header) == SPIN_OK && header.axes == SPIN_SPZ_LEFT_UP_FORWARD &&
           read_spz(file, size, &s) == SPIN_OK,
       "version 4 says its axes");
    check_hostile(read_spz, file, size, 0);
    free(file);
    longer = malloc(n_bytes + sizeof records);
    memcpy(longer, bytes, n_bytes);
    memcpy(longer + n_bytes, records, sizeof records);
    packed = pack(longer, n_bytes + sizeof records, &n_packed);
    ok(spin_spz_peek(packed, n_packed, &header) == SPIN_OK &&
           header.axes == SPIN_SPZ_LEFT_UP_FORWARD && read_spz(packed, n_packed, &s) == SPIN_OK &&
           s.n == 5,
       "so does version 3, behind the streams");
    check_hostile(read_spz, packed, n_packed, 0);
    free(packed);
    longer[14] &= (unsigned char)~2;
    packed = pack(longer, n_bytes + sizeof records, &n_packed);
    ok(read_spz(packed, n_packed, &s) == SPIN_E_MALFORMED, "bytes too many without the flag");
    free(packed);
    free(longer);
    for (int i = 0; i < 3; i++) {
        static const struct {
            size_t at;
            unsigned char value;
            spin_status status;
        } cases[] = {
            {4, 200, SPIN_E_MALFORMED}, {19, 17, SPIN_E_UNSUPPORTED}, {15, 3, SPIN_E_UNSUPPORTED}};

        memcpy(spoiled, records, sizeof records);
        spoiled[cases[i].at] = cases[i].value;
        file = make_spz_4(bytes, spoiled, sizeof spoiled - (i == 2), &size);
        ok(spin_spz_peek(file, size, &header) == cases[i].status, "records that lie, %d", i);
        free(file);
    }
    ok(spin_spz_axes(SPIN_SPZ_RIGHT_DOWN_FORWARD, q) == SPIN_OK && q[0] == 1 &&
           spin_spz_axes(SPIN_SPZ_RIGHT_UP_BACK, q) == SPIN_OK && q[1] == 1 &&
           spin_spz_axes(1, q) == SPIN_OK && q[2] == 1 &&
           spin_spz_axes(SPIN_SPZ_LEFT_UP_FORWARD, q) == SPIN_OK && q[3] == 1,
       "half turns to right, down, forward");
    ok(spin_spz_axes(8, q) == SPIN_E_UNSUPPORTED && strstr(spin_last_error(), "RUF") &&
           spin_spz_axes(16, q) == SPIN_E_UNSUPPORTED && strstr(spin_last_error(), "RBU"),
       "axes that are mirrored or lie on their backs, by name");
    free(bytes);
    spin_splats_free(&s);
}

/* A gzip that unpacks to more than 32 times itself. */
static void test_bomb(void)
{
    const struct spin_spz_header header = {
        .n = 1000000, .fraction = SPIN_SPZ_FRACTION, .version = 3};
    size_t n = (size_t)spin_spz_bytes(header.n, 0), n_packed;
    unsigned char *bytes = calloc(n, 1), *packed;
    struct spin_splats s = {0};

    spin_spz_code_header(&header, bytes);
    packed = pack(bytes, n, &n_packed);
    ok(n_packed < 100000 && read_spz(packed, n_packed, &s) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "cannot contain 1000000 splats") && !s.means,
       "a bomb of 20 MB in %zu bytes", n_packed);
    free(packed);
    free(bytes);
}

TAP_MAIN
{
    for (int degree = 0; degree <= 3; degree++)
        test_round_trip(degree);
    test_places();
    test_decoded_values();
    test_headers();
    test_version_2();
    test_plain(2);
    test_plain(3);
    for (int degree = 0; degree <= 4; degree++)
        test_version_4(degree);
    test_streams();
    test_extensions();
    test_bomb();
}
