/* K: ply formats import export */
#include "formats/gs_ply.h"
#include "tests/formats/splats.h"

static spin_status read_ply(const unsigned char *bytes, size_t n_bytes, struct spin_splats *out)
{
    struct spin_gs_ply file;
    struct spin_ply ply;
    spin_status status;

    SPIN_TRY(spin_ply_parse("test", bytes, n_bytes, &ply));
    SPIN_TRY_OUT(spin_gs_ply_find(&ply, &file));
    SPIN_TRY_OUT(spin_splats_reserve(out, (size_t)file.vertex->count, ALL, file.sh_degree));
    status = spin_gs_ply_read(&file, ALL, 0, out);
out:
    spin_ply_close(&ply);
    return status;
}

/* A file of n rows; the coefficients [k][3] of row i are 100 i + 3 k + c. */
static unsigned char *make_file(size_t n, int from, int to, struct spin_gaussian *row,
                                size_t *n_bytes)
{
    char header[SPIN_GS_PLY_MAX_HEADER];
    size_t at = spin_gs_ply_header(to, n, "comment a test\n", header), width = spin_gs_ply_row(to);
    unsigned char *bytes = malloc(at + n * width), *one = malloc(width);
    float sh[48];
    uint32_t seed = 3;

    memcpy(bytes, header, at);
    for (size_t i = 0; i < n; i++, at += width) {
        struct spin_gs_ply_row r = {.logit = (float)i, .sh = sh, .n_sh = (from + 1) * (from + 1)};

        row[i] = make_row(&seed);
        for (int k = 0; k < 48; k++)
            sh[k] = (float)(100 * i) + (float)k;
        memcpy(r.place, row[i].place, sizeof r.place);
        memcpy(r.rotation, row[i].rotation, sizeof r.rotation);
        r.log_scale = row[i].log_scale;
        spin_gs_ply_code(&r, to, one);
        memcpy(bytes + at, one, width);
    }
    free(one);
    *n_bytes = at;
    return bytes;
}

static void test_round_trip(int from, int to)
{
    struct spin_gaussian row[5];
    struct spin_splats s = {0};
    size_t n_bytes, n_sh = (size_t)((to + 1) * (to + 1)),
                    n_there = (size_t)((from + 1) * (from + 1));
    unsigned char *bytes = make_file(5, from, to, row, &n_bytes);
    int good = 1, sh = 1;

    if (!ok(read_ply(bytes, n_bytes, &s) == SPIN_OK && s.n == 5 && s.sh_degree == to,
            "degree %d as %d is read back", from, to))
        return;
    for (size_t i = 0; i < 5; i++) {
        good &= memcmp(s.means + 3 * i, row[i].place, 12) == 0 &&
                s.logit_opacities[i] == (float)i &&
                memcmp(s.quats + 4 * i, row[i].rotation, 16) == 0 &&
                memcmp(s.log_scales + 3 * i, row[i].log_scale, 12) == 0;
        for (size_t k = 0; k < 3 * n_sh; k++)
            sh &= s.sh[3 * n_sh * i + k] == (k < 3 * n_there ? (float)(100 * i + k) : 0);
    }
    ok(good, "rows keep their bits");
    ok(sh, "coefficients are at their places, those that were not there are 0");
    free(bytes);
    spin_splats_free(&s);
}

/* Bytes of a text file of one row. */
static spin_status read_text(const char *names, const char *values, struct spin_splats *out)
{
    char text[4096], *copy = strdup(names), *save = NULL;
    size_t at = (size_t)snprintf(text, sizeof text, "ply\nformat ascii 1.0\nelement vertex 1\n");

    for (char *name = strtok_r(copy, " ", &save); name; name = strtok_r(NULL, " ", &save))
        at += (size_t)snprintf(text + at, sizeof text - at, "property float %s\n", name);
    at += (size_t)snprintf(text + at, sizeof text - at, "end_header\n%s\n", values);
    free(copy);
    return read_ply((const unsigned char *)text, at, out);
}

static void test_strict(void)
{
    static const struct {
        const char *names, *word;
    } missing[] = {
        {"x y f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3", "'z'"},
        {"x y z f_dc_0 f_dc_1 f_dc_2 scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3", "'opacity'"},
        {"x y z f_dc_0 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3", "'f_dc_1'"},
    };
    static const char names[] =
        "rot_3 rot_2 rot_1 rot_0 z y x f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2";
    struct spin_splats s = {0};

    for (size_t i = 0; i < sizeof missing / sizeof *missing; i++)
        ok(read_text(missing[i].names, "0 0 0 0 0 0 0 0 0 0 0 0 0", &s) != SPIN_OK &&
               strstr(spin_last_error(), missing[i].word) && strstr(spin_last_error(), "'test'"),
           "names %s and the file", missing[i].word);
    ok(read_text(names, "0 0 0 2 3 2 1 7 8 9 inf -1 -2 -3", &s) == SPIN_OK && s.means[0] == 1 &&
           s.means[2] == 3 && s.quats[0] == 2 && s.logit_opacities[0] == 30 && s.sh[2] == 9,
       "any order; an infinite opacity becomes finite, a rotation keeps its length");
    ok(read_text(names, "0 0 0 1 3 2 nan 7 8 9 0 -1 -2 -3", &s) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "x, y, z") && strstr(spin_last_error(), "row 0"),
       "NaN in a place, with its row");
    ok(read_text(names, "0 0 0 1 3 2 1 7 8 9 nan -1 -2 -3", &s) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "opacity"),
       "NaN in an opacity");
    ok(read_text("x y z red green blue opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3",
                 "1 2 3 255 0 51 0 -1 -1 -1 1 0 0 0", &s) == SPIN_OK &&
           fabs(s.sh[0] - 0.5 / 0.28209479177387814) < 1e-6 &&
           fabs(s.sh[2] + 0.3 / 0.28209479177387814) < 1e-6,
       "red, green and blue in place of f_dc");
    spin_splats_free(&s);
}

TAP_MAIN
{
    struct spin_gaussian row[3];
    size_t n_bytes;
    unsigned char *bytes = make_file(3, 1, 1, row, &n_bytes);

    for (int to = 0; to <= 3; to++) {
        test_round_trip(3, to);
        test_round_trip(1, to);
    }
    test_strict();
    check_hostile(read_ply, bytes, n_bytes, 0);
    free(bytes);
}
