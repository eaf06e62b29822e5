/* nerfstudio_world: the transform of nerfstudio is undone, for 4D splats as for their slices.
 * K: nerfstudio import 4d */
#include <sys/stat.h>

#include "run/nerfstudio_world.h"
#include "scene/splats_4d.h"
#include "tests/check.h"
#include "tests/tap.h"

enum { N = 20, ALL = SPIN_COL_MEANS | SPIN_COL_ATTRIBUTES };

static void fill_row(float *values, size_t n, int *seed, float low, float high)
{
    for (size_t i = 0; i < n; i++) {
        *seed = (int)((*seed * 1103515245u + 12345u) & 0x7fffffff);
        values[i] = low + (high - low) * (float)(*seed >> 8) / (float)(1 << 23);
    }
}

/* Random splats that move, rotate and change colour. */
static void fill(struct spin_splats_4d *s)
{
    int seed = 7;
    size_t n_dropped;

    memset(s, 0, sizeof *s);
    if (spin_splats_4d_reserve(s, N, 2, 3, SPIN_4D_SPINS | SPIN_4D_SH_COS) != SPIN_OK)
        exit(1);
    s->period = 8;
    fill_row(s->centres, 3 * N, &seed, -5, 5);
    fill_row(s->times, N, &seed, 4, 6);
    fill_row(s->paths, 6 * N, &seed, -1, 1);
    fill_row(s->quats, 4 * N, &seed, 0.2f, 1);
    fill_row(s->spins, 4 * N, &seed, -0.1f, 0.1f);
    fill_row(s->log_scales, 3 * N, &seed, -3, -1);
    fill_row(s->logit_opacities, N, &seed, 1, 3);
    fill_row(s->sh, 48 * N, &seed, -1, 1);
    fill_row(s->sh_cos, 96 * N, &seed, -1, 1);
    for (int i = 0; i < N; i++)
        s->sigmas[i] = SPIN_FOREVER;
    if (spin_splats_4d_finish(s, &n_dropped, NULL) != SPIN_OK || s->n != N)
        exit(1);
}

static double difference(const float *a, const float *b, size_t n)
{
    double worst = 0;

    for (size_t i = 0; i < n; i++)
        worst = larger(worst, fabs((double)a[i] - b[i]));
    return worst;
}

static void test_4d(void)
{
    const struct spin_placement p = {{0.5, -0.5, 0.1, 0.7}, 3, {1, -2, 4}};
    struct spin_placement unit = p;
    struct spin_splats_4d before, after = {0};
    struct spin_splats slice = {0}, want = {0}, got = {0};

    for (int k = 0; k < 4; k++)
        unit.q[k] /= sqrt(0.25 + 0.25 + 0.01 + 0.49);
    fill(&before);
    ok(spin_splats_4d_place(&before, &unit, &after) == SPIN_OK && after.n == N, "4D splats move");
    ok(spin_splats_4d_slice(&before, 6.5, ALL, &slice) == SPIN_OK &&
           spin_splats_4d_slice(&after, 6.5, ALL, &got) == SPIN_OK && got.n == N &&
           spin_splats_reserve(&want, N, ALL, 3) == SPIN_OK,
       "both have slices");
    spin_splats_place(&slice, ALL, &unit, 0, &want);
    ok(difference(want.means, got.means, 3 * N) < 1e-4, "positions are those of a moved slice");
    ok(difference(want.quats, got.quats, 4 * N) < 1e-5, "rotations are");
    ok(difference(want.log_scales, got.log_scales, 3 * N) < 1e-5, "scales are");
    ok(difference(want.logit_opacities, got.logit_opacities, N) == 0, "opacities are");
    ok(difference(want.sh, got.sh, 48 * N) < 1e-4, "colours are");
    spin_splats_4d_free(&before);
    spin_splats_4d_free(&after);
    spin_splats_free(&slice);
    spin_splats_free(&want);
    spin_splats_free(&got);
}

/* Writes the file beside a run, and reads it. */
static spin_status find(const char *text, struct spin_placement *p, bool *found)
{
    const char *folder = check_folder();
    char file[1100];
    char *path = NULL;
    FILE *f;
    spin_status status;

    snprintf(file, sizeof file, "%s/" SPIN_PARSER_FILE, folder);
    f = fopen(file, "w");
    if (!f || fputs(text, f) < 0 || fclose(f) != 0)
        exit(1);
    snprintf(file, sizeof file, "%s/exports", folder);
    mkdir(file, 0700);
    status = spin_parser_find(file, NULL, NULL, p, &path, found);
    free(path);
    return status;
}

static void test_file(void)
{
    struct spin_placement p;
    bool found;

    ok(find("{\"transform\": [[0,-1,0,2],[1,0,0,3],[0,0,1,4]], \"scale\": 0.5}", &p, &found) ==
               SPIN_OK &&
           found && p.scale == 2 && fabs(p.shift[0] + 3) < 1e-12 && fabs(p.shift[1] - 2) < 1e-12 &&
           fabs(p.shift[2] + 4) < 1e-12 && fabs(p.q[3] + sqrt(0.5)) < 1e-12,
       "two folders above the run, the inverse of the transform");
    ok(find("{\"transform\": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}", &p, &found) == SPIN_OK &&
           !found,
       "the identity is no transform, and a file without a scale has scale 1");
    ok(find("{\"transform\": [[1,0,0,0],[0,1,0,0],[0,0,1]], \"scale\": 1}", &p, &found) ==
               SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "no number in row 2, column 3"),
       "a short row is refused");
    ok(find("{\"transform\": [[1,0,0,0],[0,1,0,0],[0,0,-1,0]], \"scale\": 1}", &p, &found) ==
               SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "not a rotation"),
       "a reflection is refused");
    ok(find("{\"transform\": [[1,0,0,0],[0,1,0,0],[0,0,1,0]], \"scale\": 0}", &p, &found) ==
               SPIN_E_MALFORMED &&
           strstr(spin_last_error(), "'scale'"),
       "a scale of 0 is refused");
}

TAP_MAIN
{
    test_4d();
    test_file();
}
