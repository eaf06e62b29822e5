/* grid: levels of imported networks from their stored growth and base, compared with the test
 * vectors of the hash encoder, whose scales are correctly rounded.
 * K: math golden */
#include "io/file.h"
#include "math/grid.h"
#include "tests/check.h"
#include "tests/tap.h"

static void test_case(const char *path, const char *name)
{
    struct spin_array growth_info, base_info, scale_info, info;
    struct spin_npz npz;
    int n_scale = 0, n_res = 0, n_hashed = 0, n_levels;

    if (!ok(spin_npz_open(path, &npz) == SPIN_OK, "%s: opens", name))
        return;
    float *growth = check_load_f32(&npz, "per_level_scale", &growth_info);
    float *base = check_load_f32(&npz, "base_resolution", &base_info);
    float *scales = check_load_f32(&npz, "level_scale", &scale_info);
    double *res = check_load(&npz, "level_resolution", &info);
    double *hashed = check_load(&npz, "level_hashed", &info);
    double *offsets = check_load(&npz, "offsets", &info);

    n_levels = (int)scale_info.shape[0];
    for (int l = 0; l < n_levels; l++) {
        uint32_t got[4];
        float scale[4];

        if (!spin_grid_stored_level(l, 4, growth, base, scale, got))
            continue;
        for (int d = 0; d < 4; d++) {
            n_scale += scale[d] == scales[4 * l + d];
            n_res += got[d] == (uint32_t)res[4 * l + d];
        }
        n_hashed +=
            spin_grid_is_hashed(got, (uint64_t)(offsets[l + 1] - offsets[l])) == (hashed[l] != 0);
    }
    near(n_scale, 4 * n_levels, 0, "scales to the last bit");
    near(n_res, 4 * n_levels, 0, "resolutions");
    near(n_hashed, n_levels, 0, "which levels are hashed");
    free(growth);
    free(base);
    free(scales);
    free(res);
    free(hashed);
    free(offsets);
    spin_npz_close(&npz);
}

static void test_refusals(void)
{
    const float good[4] = {1.5f, 1.5f, 1.5f, 1}, bad[4] = {1.5f, NAN, 1.5f, 1};
    const float base[4] = {8, 8, 8, 8}, zero[4] = {8, 0, 8, 8}, fast[4] = {1e6f, 1, 1, 1};
    uint32_t res[4], q3[4] = {3, 5, 7, 0};
    float scale[4];

    ok(spin_grid_stored_level(2, 3, good, base, scale, res) && res[3] == 1 && scale[3] == 0,
       "a missing axis has one vertex");
    ok(spin_grid_row(q3, res, 1u << 30, 0) == 3 + res[0] * (5 + res[1] * 7) &&
           spin_grid_hash(q3) == (3u ^ 5u * SPIN_GRID_PRIME_Y ^ 7u * SPIN_GRID_PRIME_Z),
       "which leaves row and hash of the others alone");
    ok(!spin_grid_stored_level(1, 4, bad, base, scale, res), "growth that is no number");
    ok(!spin_grid_stored_level(1, 4, good, zero, scale, res), "a resolution of 0");
    ok(!spin_grid_stored_level(9, 4, fast, base, scale, res), "levels beyond all bounds");
}

TAP_MAIN
{
    const char **names = check_cases("hash4d", "vectors.npz");

    test_refusals();
    for (size_t i = 0; names[i]; i++) {
        char name[96];

        snprintf(name, sizeof name, "hash4d/%s/vectors.npz", names[i]);
        if (strcmp(names[i], "hash_index") != 0) /* hashes alone; see device/t-grid.c */
            test_case(check_fixture(name), names[i]);
    }
    free(names);
}
