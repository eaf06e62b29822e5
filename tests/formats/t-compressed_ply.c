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

TAP_MAIN
{
    struct spin_gaussian row[3];
    size_t n_bytes;
    unsigned char *bytes = make_file(3, 1, row, &n_bytes);

    test_round_trip(1, 0);
    test_round_trip(256, 1);
    test_round_trip(257, 3);
    test_edges();
    check_hostile(read_ply, bytes, n_bytes, 0);
    free(bytes);
}
