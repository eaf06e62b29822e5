/* Distances to the nearest neighbours compared with a brute-force search, and the start of a
 * refinement from coloured points.
 * K: golden threads refine */
#include "base/pool.h"
#include "geometry/neighbours.h"
#include "train/densify.h"
#include "math/rng.h"
#include "tests/check.h"
#include "tests/tap.h"

/* The mean of the three smallest distances, by brute force. */
static double slow_mean_dist2(const float *p, size_t n, size_t self)
{
    double best[3] = {INFINITY, INFINITY, INFINITY}, sum = 0;
    int found = 0;

    for (size_t j = 0; j < n; j++) {
        double d2 = 0;

        for (int c = 0; c < 3; c++)
            d2 += pow((double)p[3 * self + (size_t)c] - p[3 * j + (size_t)c], 2);
        if (j == self)
            continue;
        for (int k = 0; k < 3; k++)
            if (d2 < best[k]) {
                double keep = best[k];

                best[k] = d2;
                d2 = keep;
            }
    }
    for (; found < 3 && best[found] < INFINITY; found++)
        sum += best[found];
    return found ? sum / found : 0;
}

/* Clusters, a line, exact duplicates: hard cases for a k-d tree. */
static void fill(float *p, size_t n)
{
    for (size_t i = 0; i < n; i++)
        for (size_t c = 0; c < 3; c++) {
            float x = spin_rng_normal(7, c, i);

            p[3 * i + c] = i % 5 == 0   ? 0.01f * x + 2
                           : i % 5 == 1 ? (c == 0 ? x : 0.5f)
                           : i % 5 == 2 ? (float)(i % 7)
                                        : x;
        }
}

static void compare_with_all(size_t n)
{
    float *p = malloc((3 * n + 1) * sizeof *p), *got = malloc((n + 1) * sizeof *got);
    double *want = malloc((n + 1) * sizeof *want);
    char what[64];

    fill(p, n);
    for (size_t i = 0; i < n; i++)
        want[i] = slow_mean_dist2(p, n, i);
    snprintf(what, sizeof what, "%zu points: the three nearest of all", n);
    if (ok(spin_knn_mean_dist2(NULL, n, p, got) == SPIN_OK, "%zu points: measures", n))
        check_close(got, want, n, 1e-9, 1e-5, what);
    free(p);
    free(got);
    free(want);
}

static void compare_threads(void)
{
    enum { N = 5000 };
    float *p = malloc(3 * N * sizeof *p), *one = malloc(N * sizeof *one);
    float *many = malloc(N * sizeof *many);
    struct spin_pool *pool = NULL;

    fill(p, N);
    ok(spin_pool_create(3, &pool) == SPIN_OK, "three threads");
    ok(spin_knn_mean_dist2(NULL, N, p, one) == SPIN_OK, "measures with one thread");
    ok(spin_knn_mean_dist2(pool, N, p, many) == SPIN_OK, "measures with three");
    check_same_bits(many, one, N * sizeof *one, "the same bits for any number of threads");
    spin_pool_free(pool);
    free(p);
    free(one);
    free(many);
}

static void compare_start(const char *path)
{
    struct spin_npz npz;
    struct spin_array info;
    struct spin_refine_cloud cloud = {0};
    double abs = check_tolerance("knn_init.npz", "abs", 1e-5);
    double *dist2, *log_scale, *sh_dc;
    float *points, *colour, *got_dist2, *got_scale, *got_dc;
    int isotropic = 1, rest = 1;
    size_t n;

    if (!ok(spin_npz_open(path, &npz) == SPIN_OK, "opens knn_init.npz"))
        return;
    points = check_load_f32(&npz, "points", &info);
    colour = check_load_f32(&npz, "color_u8", NULL);
    dist2 = check_load(&npz, "mean_dist2", NULL);
    log_scale = check_load(&npz, "log_scale", NULL);
    sh_dc = check_load(&npz, "sh_dc", NULL);
    n = (size_t)info.shape[0];
    got_dist2 = malloc(n * sizeof *got_dist2);
    got_scale = malloc(n * sizeof *got_scale);
    got_dc = malloc(3 * n * sizeof *got_dc);
    for (size_t i = 0; i < 3 * n; i++)
        colour[i] /= 255;
    if (ok(n > 0 && spin_refine_init_from_points(NULL, n, points, colour, &cloud) == SPIN_OK &&
               spin_knn_mean_dist2(NULL, n, points, got_dist2) == SPIN_OK,
           "starts from %zu coloured points", n)) {
        for (size_t i = 0; i < n; i++) {
            const struct spin_refine_row *p = &cloud.point[i].p;

            got_scale[i] = p->log_scale[0];
            memcpy(got_dc + 3 * i, p->dc, sizeof p->dc);
            isotropic &= p->log_scale[1] == got_scale[i] && p->log_scale[2] == got_scale[i];
            rest &= memcmp(p->pos_w, points + 3 * i, sizeof p->pos_w) == 0 && p->rotation[0] == 1 &&
                    p->rotation[1] == 0 && p->rotation[2] == 0 && p->rotation[3] == 0 &&
                    fabs(1 / (1 + exp(-(double)p->logit_opacity)) - 0.1) < 1e-7;
        }
        check_close(got_dist2, dist2, n, abs, 0, "mean squared distances as the reference's");
        check_close(got_scale, log_scale, n, abs, 0, "scales as the reference's");
        check_close(got_dc, sh_dc, 3 * n, abs, 0, "colour coefficients as the reference's");
        ok(isotropic, "the three axes are alike");
        ok(rest, "places kept, no rotation, opacity 0.1");
    }
    spin_refine_cloud_free(&cloud);
    free(got_dist2);
    free(got_scale);
    free(got_dc);
    free(points);
    free(colour);
    free(dist2);
    free(log_scale);
    free(sh_dc);
    spin_npz_close(&npz);
}

static void odd_points(void)
{
    struct spin_refine_cloud cloud = {0};
    float same[6] = {1, 2, 3, 1, 2, 3}, bad[3] = {0, NAN, 0};

    ok(spin_refine_init_from_points(NULL, 0, same, NULL, &cloud) == SPIN_OK && cloud.n == 0,
       "no point: an empty cloud");
    ok(spin_refine_init_from_points(NULL, 2, same, NULL, &cloud) == SPIN_OK, "two alike points");
    near(cloud.point[1].p.log_scale[2], 0.5 * log(1e-7), 1e-5,
         "their scale is the smallest there is");
    ok(cloud.point[0].p.dc[0] == 0, "without colours, mid grey");
    ok(spin_refine_init_from_points(NULL, 1, bad, NULL, &cloud) == SPIN_E_MALFORMED,
       "refuses a coordinate that is not finite");
    is_text(spin_last_error(), "point 0 has a coordinate that is not finite", "and says which");
    spin_refine_cloud_free(&cloud);
}

TAP_MAIN
{
    const size_t sizes[] = {0, 1, 2, 3, 4, 8, 9, 17, 100, 1500};
    const char *path = check_fixture("core/knn_init.npz");

    for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; i++)
        compare_with_all(sizes[i]);
    compare_threads();
    odd_points();
    if (path)
        compare_start(path);
    else
        skip("start from points", "no fixture core/knn_init.npz");
}
