/* K: compressed-ply ply formats import export */
#include "formats/compressed_ply.h"
#include "tests/formats/splats.h"

static spin_status read_ply(const unsigned char *bytes, size_t n_bytes, struct spin_splats *out)
{
    struct spin_compressed_ply file;
    struct spin_ply ply;
    spin_status status;

    SPIN_TRY(spin_ply_parse("test", bytes, n_bytes, &ply));
    SPIN_TRY_OUT(spin_compressed_find(&ply, &file));
    SPIN_TRY_OUT(spin_splats_reserve(out, (size_t)file.vertex->count, ALL, file.sh_degree));
    status = spin_compressed_read(&file, ALL, out);
out:
    spin_ply_close(&ply);
    return status;
}

/* Rows as they are packed, and the file. */
static unsigned char *make_file(size_t n, int degree, struct spin_gaussian *row, size_t *n_bytes)
{
    char header[SPIN_GS_PLY_MAX_HEADER];
    size_t at = spin_compressed_header(degree, n, "", header), n_rest = spin_n_rest(degree);
    unsigned char *bytes = calloc(at + spin_compressed_body(degree, n) + 1, 1);
    unsigned char *range = bytes + at, *vertex = range + 72 * spin_compressed_chunks(n);
    unsigned char *rest = vertex + 16 * n;
    uint32_t seed = 5;

    memcpy(bytes, header, at);
    for (size_t i = 0; i < n; i++)
        row[i] = make_row(&seed);
    for (size_t i = 0; i < n; i += SPIN_COMPRESSED_CHUNK) {
        size_t m = n - i < SPIN_COMPRESSED_CHUNK ? n - i : SPIN_COMPRESSED_CHUNK;
        uint32_t word[SPIN_COMPRESSED_CHUNK][4];
        float ranges[SPIN_COMPRESSED_RANGES];

        spin_compressed_pack(row + i, m, ranges, word);
        spin_little_endian(ranges, SPIN_COMPRESSED_RANGES);
        spin_little_endian(word, 4 * m);
        memcpy(range + i / SPIN_COMPRESSED_CHUNK * sizeof ranges, ranges, sizeof ranges);
        memcpy(vertex + 16 * i, word, 16 * m);
    }
    for (size_t i = 0; i < n; i++) {
        float sh[48], lost[45];

        for (int k = 0; k < 48; k++)
            sh[k] = (float)k / 16 - 1;
        spin_compressed_pack_sh(sh, 16, degree, rest + n_rest * i, lost);
    }
    *n_bytes = at + (size_t)spin_compressed_body(degree, n);
    return bytes;
}

static void test_round_trip(size_t n, int degree)
{
    struct spin_gaussian *row = calloc(n, sizeof *row);
    struct spin_splats s = {0};
    size_t n_bytes, n_sh = 3 + spin_n_rest(degree);
    unsigned char *bytes = make_file(n, degree, row, &n_bytes);
    int good = 1, sh = 1;

    if (!ok(read_ply(bytes, n_bytes, &s) == SPIN_OK && s.n == n && s.sh_degree == degree,
            "%zu splats of degree %d are read back", n, degree))
        return;
    for (size_t i = 0; i < n; i++) {
        good &= is_row(&s, i, &row[i], 8 / 1023.0 * 0.501, 7 / 1023.0 * 0.501, 0.00197);
        for (size_t k = 3; k < n_sh; k++)
            sh &= fabs(s.sh[n_sh * i + k] - ((double)k / 16 - 1)) <= 1 / 64.0;
    }
    ok(good, "rows are within half a step");
    ok(sh, "coefficients are at their places");
    free(row);
    free(bytes);
    spin_splats_free(&s);
}

static void test_edges(void)
{
    struct spin_gaussian row = make_row(&(uint32_t){1}), shown;
    float range[SPIN_COMPRESSED_RANGES], sh[12] = {0}, lost[9];
    unsigned char out[9];
    uint32_t word[1][4];

    row.log_scale[0] = -60;
    row.log_scale[1] = 44;
    spin_compressed_pack(&row, 1, range, word);
    spin_compressed_unpack(word[0], range, &shown);
    ok(row.log_scale[0] == -20 && row.log_scale[1] == 20 && shown.log_scale[1] == 20,
       "log scales are cut to 20");
    ok(shown.place[0] == row.place[0], "a chunk of one row has its place exactly");
    sh[3] = 100;
    sh[4] = -100;
    spin_compressed_pack_sh(sh, 4, 1, out, lost);
    ok(out[0] == 255 && lost[0] == 96 && out[3] == 0 && lost[3] == -96,
       "coefficients end at 4; what is lost is told");
}

/* The file once more in the other byte order: every word of chunks and vertices turned round. */
static unsigned char *make_big_endian(const unsigned char *bytes, size_t n_bytes, size_t n,
                                      size_t *n_out)
{
    static const char end[] = "end_header\n", little[] = "binary_little_endian",
                      big[] = "binary_big_endian";
    const char *text = (const char *)bytes, *at = strstr(text, little);
    const char *body = strstr(text, end) + sizeof end - 1;
    size_t words = 18 * spin_compressed_chunks(n) + 4 * n, before = (size_t)(at - text);
    unsigned char *out = malloc(n_bytes), *to = out;

    memcpy(to, bytes, before);
    memcpy(to + before, big, sizeof big - 1);
    to += before + sizeof big - 1;
    at += sizeof little - 1;
    memcpy(to, at, n_bytes - (size_t)(at - text));
    to += body - at;
    for (size_t i = 0; i < words; i++, to += 4)
        for (int b = 0; b < 4; b++)
            to[b] = (unsigned char)body[4 * i + 3 - (size_t)b];
    *n_out = n_bytes - (sizeof little - sizeof big);
    return out;
}

static void test_big_endian(size_t n, int degree)
{
    struct spin_gaussian *row = calloc(n, sizeof *row);
    struct spin_splats s = {0}, big_s = {0};
    size_t n_bytes, n_big;
    unsigned char *bytes = make_file(n, degree, row, &n_bytes);
    unsigned char *big = make_big_endian(bytes, n_bytes, n, &n_big);

    if (!ok(read_ply(bytes, n_bytes, &s) == SPIN_OK && read_ply(big, n_big, &big_s) == SPIN_OK &&
                big_s.n == n && big_s.sh_degree == degree,
            "%zu splats of big endian are read", n))
        printf("#   %s\n", spin_last_error());
    else
        ok(!memcmp(s.means, big_s.means, 12 * n) && !memcmp(s.quats, big_s.quats, 16 * n) &&
               !memcmp(s.log_scales, big_s.log_scales, 12 * n) &&
               !memcmp(s.logit_opacities, big_s.logit_opacities, 4 * n) &&
               !memcmp(s.sh, big_s.sh, 4 * n * (3 + spin_n_rest(degree))),
           "to the bits of little endian");
    check_hostile(read_ply, big, n_big, 0);
    free(row);
    free(bytes);
    free(big);
    spin_splats_free(&s);
    spin_splats_free(&big_s);
}

/* Chunks with these columns, all floats; of column k the value k / 8 where it is a minimum, 2 + k /
 * 8 where it is none; one vertex of this colour. */
static spin_status read_old(const char *columns, uint32_t colour, struct spin_splats *out)
{
    static const char *const packed[] = {"position", "rotation", "scale", "color"};
    const uint32_t word[4] = {0, 0x1ff7fdffu, 0xffffffffu, colour};
    char text[2000], copy[600];
    size_t at = (size_t)snprintf(text, sizeof text,
                                 "ply\nformat binary_little_endian 1.0\nelement chunk 1\n");
    float range[24];
    int n = 0;

    snprintf(copy, sizeof copy, "%s", columns);
    for (char *name = strtok(copy, " "); name; name = strtok(NULL, " "), n++) {
        at += (size_t)snprintf(text + at, sizeof text - at, "property float %s\n", name);
        range[n] = (float)n / 8 + (strncmp(name, "min", 3) == 0 ? 0 : 2);
    }
    at += (size_t)snprintf(text + at, sizeof text - at, "element vertex 1\n");
    for (int i = 0; i < 4; i++)
        at += (size_t)snprintf(text + at, sizeof text - at, "property uint packed_%s\n", packed[i]);
    at += (size_t)snprintf(text + at, sizeof text - at, "end_header\n");
    memcpy(text + at, range, (size_t)n * sizeof *range);
    memcpy(text + at + (size_t)n * sizeof *range, word, sizeof word);
    spin_little_endian(text + at, (size_t)n + 4);
    return read_ply((unsigned char *)text, at + (size_t)n * sizeof *range + sizeof word, out);
}

/* Files of before there were ranges of colour, and columns in another order. */
static void test_old(void)
{
    static const char places[] =
        "min_x min_y min_z max_x max_y max_z "
        "min_scale_x min_scale_y min_scale_z max_scale_x max_scale_y max_scale_z";
    static const char turned[] =
        "other max_scale_z max_scale_y max_scale_x min_scale_z min_scale_y min_scale_x "
        "max_z max_y max_x min_z min_y min_x max_b max_g max_r min_b min_g min_r";
    char part[600];
    struct spin_splats s = {0};

    ok(read_old(places, 0x00ff33ffu, &s) == SPIN_OK && s.n == 1 && s.sh_degree == 0,
       "chunks without ranges of colour");
    near(s.sh[0] * 0.28209479, -0.5, 1e-6, "a byte of 0 is 0");
    near(s.sh[1] * 0.28209479, 0.5, 1e-6, "one of 255 is 1");
    near(s.sh[2] * 0.28209479, 0.2 - 0.5, 1e-6, "one of 51 is 0.2");
    near(s.means[1], 1.0 / 8, 1e-6, "places are those of their chunk");
    near(s.log_scales[0], 2 + 9.0 / 8, 1e-6, "so are scales");
    snprintf(part, sizeof part, "%s min_r max_r", places);
    ok(read_old(part, 0x00ff33ffu, &s) == SPIN_OK && fabs(s.sh[0] * 0.28209479 + 0.5) < 1e-6,
       "a range of red alone is none");
    ok(read_old(turned, 0x00ff33ffu, &s) == SPIN_OK, "columns in another order, and one more");
    near(s.means[0], 12.0 / 8, 1e-6, "are found by name: the least x");
    near(s.log_scales[2], 2 + 1.0 / 8, 1e-6, "the largest scale");
    near(s.sh[0] * 0.28209479, 18.0 / 8 - 0.5, 1e-6, "the least red");
    near(s.sh[1] * 0.28209479, 2 + 14.0 / 8 - 0.5, 1e-6, "the largest green");
    ok(read_old(places + 6, 0, &s) == SPIN_E_MALFORMED && strstr(spin_last_error(), "'min_x'"),
       "a range that is needed is named");
    spin_splats_free(&s);
}

/* A file of a lower SH degree into columns that hold a higher one. */
static void test_lower_degree(void)
{
    struct spin_gaussian row[20];
    struct spin_compressed_ply file;
    struct spin_splats s = {0};
    struct spin_ply ply;
    size_t n_bytes, n_bad = 0;

    for (int degree = 3; degree >= 0; degree--) {
        unsigned char *bytes = make_file(20, degree, row, &n_bytes);

        if (spin_ply_parse("test", bytes, n_bytes, &ply) != SPIN_OK ||
            spin_compressed_find(&ply, &file) != SPIN_OK ||
            spin_splats_reserve(&s, 20, ALL, 3) != SPIN_OK ||
            spin_compressed_read(&file, ALL, &s) != SPIN_OK)
            exit(1);
        for (size_t i = 0; i < 20; i++)
            for (size_t k = 3 + spin_n_rest(degree); k < 48; k++)
                n_bad += s.sh[48 * i + k] != 0;
        for (size_t k = 3; k < 3 + spin_n_rest(degree); k++)
            n_bad += !(fabs(s.sh[48 + k] - ((double)k / 16 - 1)) <= 1 / 64.0);
        spin_ply_close(&ply);
        free(bytes);
    }
    ok(n_bad == 0, "what a file of a lower SH degree lacks is 0, not what a higher one left");
    spin_splats_free(&s);
}

TAP_MAIN
{
    struct spin_gaussian row[3];
    size_t n_bytes;
    unsigned char *bytes = make_file(3, 1, row, &n_bytes);

    test_round_trip(1, 0);
    test_round_trip(256, 1);
    test_round_trip(257, 3);
    test_edges();
    test_big_endian(3, 1);
    test_big_endian(257, 3);
    test_old();
    test_lower_degree();
    check_hostile(read_ply, bytes, n_bytes, 0);
    free(bytes);
}
