/* K: ksplat formats import */
#include "tests/formats/ksplat_files.h"

static spin_status read_ksplat(const unsigned char *bytes, size_t n_bytes, struct spin_splats *out)
{
    return spin_ksplat_read(bytes, n_bytes, ALL, out);
}

/* Two sections, of which the second has a lower SH degree. */
static unsigned char *make_file(int level, int sh_degree, uint32_t steps, struct spin_gaussian *row,
                                size_t *n_bytes)
{
    struct ksplat_section s[2] = {{23, 5, sh_degree, row},
                                  {7, 7, sh_degree ? sh_degree - 1 : 0, row + 23}};
    uint32_t seed = 12;

    for (int i = 0; i < 30; i++)
        row[i] = make_row(&seed);
    return make_ksplat(level, s, 2, steps, n_bytes);
}

static void test_level(int level, int sh_degree, uint32_t steps)
{
    /* half a step of 9 / 2 / steps; scales to 11 bits, the 0.0009 of the least */
    const double place = level ? 4.5 / (steps ? steps : 32767) * 0.51 : 0;
    const double sh_bound = level == 0 ? 0 : level == 1 ? 1 / 4096.0 : 1.001 / 255;
    struct spin_gaussian row[30];
    struct spin_splats s = {0};
    struct spin_ksplat header;
    size_t n_bytes, n_sh = 3 + spin_n_rest(sh_degree);
    unsigned char *file = make_file(level, sh_degree, steps, row, &n_bytes);
    int good = 1, sh = 1;

    if (!ok(spin_ksplat_peek(file, n_bytes, &header) == SPIN_OK && header.n == 30 &&
                read_ksplat(file, n_bytes, &s) == SPIN_OK && s.n == 30 && s.sh_degree == sh_degree,
            "level %d, SH degree %d is read", level, sh_degree)) {
        printf("#   %s\n", spin_last_error());
        return;
    }
    for (size_t i = 0; i < 30; i++) {
        int degree = i < 23 ? sh_degree : sh_degree - 1;

        good &= is_row(&s, i, &row[i], place + 1e-6, level ? 0.001 : 1e-6, 0.00197);
        for (int k = 1; k < (sh_degree + 1) * (sh_degree + 1); k++)
            for (int c = 0; c < 3; c++) {
                double want = k < (degree + 1) * (degree + 1) ? (double)ksplat_sh(k, c) : 0;

                sh &= fabs((double)s.sh[n_sh * i + 3 * (size_t)k + (size_t)c] - want) <= sh_bound;
            }
    }
    ok(good, "places by the centres of their buckets, and the rest, are within half a step");
    ok(sh, "coefficients are at their places");
    check_hostile(read_ksplat, file, n_bytes, 0);
    free(file);
    spin_splats_free(&s);
}

static void test_lies(void)
{
    enum { H = SPIN_KSPLAT_HEADER };
    static const struct {
        size_t at;
        uint64_t value;
        int n;
        const char *word, *what;
    } cases[] = {
        {0, 1, 1, "version 1.1", "another version"},
        {20, 3, 2, "level 3", "level 3"},
        {4, 1000, 4, "1000 sections", "more sections than there are bytes for"},
        {4, 1, 4, "30 splats, the sections contain 23", "a section less"},
        {16, 29, 4, "29 splats, the sections contain", "another number of splats"},
        {H, 24, 4, "section 0 extends", "more splats than there is room for"},
        {H + 4, 0xffffffff, 4, "section 0 extends", "room that ends behind the file"},
        {H + 8, 4, 4, "but its buckets have", "smaller buckets"},
        {H + 12, 0xffffffff, 4, "section 0 extends", "billions of buckets"},
        {H + 20, 16, 2, "invalid buckets", "buckets of other bytes"},
        {H + 32, 5, 4, "invalid buckets", "more full buckets than there are"},
        {H + 40, 4, 2, "SH degree 4", "SH degree 4"},
        {H + 16, 0x7fc00000, 4, "'position'", "NaN as a width"},
        {H + 2048 + 4 + 60 + 12, 0x7e00, 2, "'rotation'", "NaN in a rotation"},
        {H + 2048 + 4 + 60 + 6, 0x7c00, 2, "'scale'", "an infinite scale"},
        {H + 2048 + 4, 0x7f800000, 4, "'position'", "an infinite centre"},
    };
    struct spin_gaussian row[30];
    struct spin_splats s = {0};
    size_t n_bytes;
    unsigned char *file = make_file(1, 1, 0, row, &n_bytes);

    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        uint64_t before = 0;
        bool good;

        memcpy(&before, file + cases[i].at, (size_t)cases[i].n);
        put_bytes(file + cases[i].at, cases[i].value, cases[i].n);
        good =
            read_ksplat(file, n_bytes, &s) != SPIN_OK && strstr(spin_last_error(), cases[i].word);
        if (!ok(good, "%s", cases[i].what))
            printf("#   %s\n", spin_last_error());
        memcpy(file + cases[i].at, &before, (size_t)cases[i].n);
    }
    put_f32(file + 36, 0);
    put_f32(file + 40, 0);
    ok(read_ksplat(file, n_bytes, &s) == SPIN_OK, "what it was is read");
    free(file);
    file = make_file(2, 1, 0, row, &n_bytes);
    put_f32(file + 36, 0);
    put_f32(file + 40, 0);
    ok(read_ksplat(file, n_bytes, &s) == SPIN_OK &&
           fabs((double)s.sh[3] - 1.5 * (double)ksplat_sh(1, 0)) < 0.01,
       "without a range of SH it is -1.5 to 1.5");
    free(file);
    spin_splats_free(&s);
}

TAP_MAIN
{
    for (int level = 0; level <= 2; level++)
        for (int degree = 0; degree <= 3; degree += level == 1 ? 1 : 2)
            test_level(level, degree, 0);
    test_level(1, 3, 1000);
    test_level(2, 3, 0);
    test_lies();
}
