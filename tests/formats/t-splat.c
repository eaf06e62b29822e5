/* K: splat formats export */
#include "formats/splat.h"
#include "tests/formats/splats.h"

static spin_status read_splat(const unsigned char *bytes, size_t n_bytes, struct spin_splats *out)
{
    return spin_splat_read(bytes, n_bytes, ALL, out);
}

TAP_MAIN
{
    unsigned char bytes[20 * SPIN_SPLAT_ROW];
    struct spin_gaussian row[20];
    struct spin_splats s = {0};
    const float bad = NAN, none = 0, below = -1;
    uint32_t seed = 4;
    int good = 1;

    for (size_t i = 0; i < 20; i++) {
        row[i] = make_row(&seed);
        spin_splat_code(&row[i], bytes + SPIN_SPLAT_ROW * i);
    }
    ok(read_splat(bytes, sizeof bytes, &s) == SPIN_OK && s.n == 20 && s.sh_degree == 0, "20 rows");
    for (size_t i = 0; i < s.n; i++)
        good &= is_row(&s, i, &row[i], 0, 1e-6, 0.0021);
    ok(good, "places keep their bits, the rest is within half a step");
    ok(read_splat(bytes, 0, &s) == SPIN_OK && s.n == 0, "an empty file");
    check_hostile(read_splat, bytes, sizeof bytes, SPIN_SPLAT_ROW);

    memset(bytes + 28, 128, 4);
    memcpy(bytes + 12, &none, sizeof none);
    memcpy(bytes + 16, &below, sizeof below);
    ok(read_splat(bytes, sizeof bytes, &s) == SPIN_OK && s.quats[0] == 1 && s.quats[1] == 0 &&
           s.log_scales[0] < -80 && s.log_scales[1] < -80,
       "a rotation of length zero is none, a scale of 0 or below the least");
    memcpy(bytes + 2 * SPIN_SPLAT_ROW + 16, &bad, sizeof bad);
    ok(read_splat(bytes, sizeof bytes, &s) == SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "scale") && strstr(spin_last_error(), "row 2"),
       "NaN in a scale, with its row");
    spin_splats_free(&s);
}
