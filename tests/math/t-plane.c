/* plane: lookups in planes and voxels compared with sums written out, at samples, between and
 * outside.
 * K: math */
#include "math/plane.h"
#include "tests/tap.h"

enum { WIDTH = 4, HEIGHT = 3, N = 2 };

static float plane[HEIGHT * WIDTH * N];

/* Linear in column and row, so that bilinear lookup is exact: c + 10 r, and its negative. */
static void fill(void)
{
    for (int r = 0; r < HEIGHT; r++) {
        for (int c = 0; c < WIDTH; c++) {
            plane[(r * WIDTH + c) * N] = (float)(c + 10 * r);
            plane[(r * WIDTH + c) * N + 1] = -(float)(c + 10 * r);
        }
    }
}

static void check_lookup(float u, float v, double column, double row, const char *what)
{
    float out[N] = {0, 0}, twice[N] = {2, 3};
    struct spin_plane_axis x = spin_plane_axis(u, WIDTH), y = spin_plane_axis(v, HEIGHT);

    spin_plane_lookup(plane, WIDTH, N, x, y, 0, out);
    spin_plane_lookup(plane, WIDTH, N, x, y, 1, twice);
    near(out[0], column + 10 * row, 1e-5, what);
    ok(fabs(out[1] + out[0]) < 1e-5 && fabs(twice[0] - 2 * out[0]) < 1e-5 &&
           fabs(twice[1] - 3 * out[1]) < 1e-5,
       "%s: all channels, set and multiplied", what);
}

static void test_voxels(void)
{
    float grid[8] = {0, 1, 2, 3, 4, 5, 6, 7}; /* [x][y][z]: 4 x + 2 y + z */
    const float middle[3] = {0.5f, 0.25f, 1.0f}, outside[3] = {-0.5f, 0, 1};
    const float far[3] = {0, 0, 2.5f}, nan[3] = {NAN, 0, 0};

    near(spin_voxel_lookup(grid, 2, middle), 4 * 0.5 + 2 * 0.25 + 1, 1e-6, "x is the slowest axis");
    near(spin_voxel_lookup(grid, 2, outside), 0.5, 1e-6, "half a sample outside counts half");
    near(spin_voxel_lookup(grid, 2, far), 0, 0, "far outside is 0");
    near(spin_voxel_lookup(grid, 2, nan), 0, 0, "and so is NaN");
}

TAP_MAIN
{
    fill();
    check_lookup(-1, -1, 0, 0, "the first sample is at -1");
    check_lookup(1, 1, 3, 2, "the last at 1");
    check_lookup(0, 0, 1.5, 1, "the middle at 0");
    check_lookup(-0.2f, 0.5f, 1.2, 1.5, "between samples");
    check_lookup(-3, 7, 0, 2, "outside the border repeats");
    check_lookup(spin_plane_axis(0.9f, 1).r, -1, 1.5, 0, "an axis of one sample has no fraction");
    test_voxels();
}
