/* The 4-D hash grid: golden values of two sources, a reference in double, finite differences, the
 * same bits for any number of threads and on every SIMD path, points outside, level sizes.
 * K: golden encode hash4d grid network threads */
#include "math/grid.h"
#include "tests/device/net.h"

/* ---- golden ---------------------------------------------------------------------------------- */

/* The grid of a fixture, with the given names of scale, resolution and first rows. */
static struct spin_grid grid_of(struct spin_npz *npz, const char *scale_key, const char *res_key,
                                const char *offset_key, int n_features)
{
    struct spin_grid grid;
    struct spin_array info;
    float *scale = check_load_f32(npz, scale_key, &info);
    double *res = check_load(npz, res_key, NULL), *offset = check_load(npz, offset_key, NULL);

    memset(&grid, 0, sizeof grid);
    grid.n_levels = (int)info.shape[0];
    grid.n_features = n_features;
    for (int l = 0; l < grid.n_levels; l++) {
        for (int d = 0; d < 4; d++) {
            grid.scale[l][d] = scale[l * 4 + d];
            grid.res[l][d] = (uint32_t)res[l * 4 + d];
        }
        grid.offset[l + 1] = (uint32_t)offset[l + 1];
        grid.hashed[l] =
            (uint8_t)spin_grid_is_hashed(grid.res[l], grid.offset[l + 1] - grid.offset[l]);
    }
    free(scale), free(res), free(offset);
    return grid;
}

/* Compares the first three of four columns. */
static void check_space(const float *got, const double *want, size_t n, double tolerance,
                        int relative, const char *what)
{
    float *g = net_floats(n * 3);
    double *w = net_alloc(n * 3, sizeof *w);

    for (size_t i = 0; i < n * 3; i++) {
        g[i] = got[i / 3 * 4 + i % 3];
        w[i] = want[i / 3 * 4 + i % 3];
    }
    if (relative)
        check_rel_to_absmax(g, w, n * 3, tolerance, what);
    else
        check_close(g, w, n * 3, tolerance, 0, what);
    free(g), free(w);
}

static void golden_core(const char *name, const char *path)
{
    struct spin_npz npz;
    struct spin_array info;
    struct spin_grid grid;
    struct spin_device *d;
    float *x, *table, *v, *z, *d_table, *d_x;
    double *y, *grad_x, *grad_table, tol, tol_x;
    char file[64], what[96];
    size_t n, width, n_table;

    snprintf(file, sizeof file, "core/%s.npz", name);
    if (!net_open(file, &npz))
        return;
    tol = check_tolerance(file + 5, "rel_to_absmax", 1e-5);
    tol_x = check_tolerance(file + 5, "grad_x_rel_to_absmax", 3e-5);
    x = check_load_f32(&npz, "x", &info);
    n = (size_t)info.shape[0];
    table = check_load_f32(&npz, "table", &info);
    n_table = (size_t)info.count;
    grid = grid_of(&npz, "scale", "res", "offset", (int)info.shape[1]);
    width = (size_t)grid.n_levels * (size_t)grid.n_features;
    v = check_load_f32(&npz, "v", NULL);
    y = check_load(&npz, "y", NULL);
    grad_x = check_load(&npz, "grad_x", NULL);
    grad_table = check_load(&npz, "grad_table", NULL);
    z = net_floats(n * width);
    d_table = net_floats(n_table);
    d_x = net_random(n * 4, 1, 1, 2); /* must be overwritten */
    d = check_device(2);
    on_grid(d, &grid, table, n, x, z);
    on_grid_back(d, &grid, table, n, NULL, x, v, d_table, d_x);
    snprintf(what, sizeof what, "golden %s y (%s)", name, path);
    check_rel_to_absmax(z, y, n * width, tol, what);
    snprintf(what, sizeof what, "golden %s grad_table (%s)", name, path);
    check_rel_to_absmax(d_table, grad_table, n_table, tol, what);
    snprintf(what, sizeof what, "golden %s grad_x (%s)", name, path);
    check_space(d_x, grad_x, n, tol_x, 1, what);
    free(x), free(table), free(v), free(z), free(d_table), free(d_x);
    free(y), free(grad_x), free(grad_table);
    spin_npz_close(&npz);
    check_device_free(d);
}

/* A tolerance from the manifest of a case: a number, or a string "abs NUMBER". */
static double hash4d_tolerance(const char *name, const char *key)
{
    char file[96];
    const char *path;
    spin_json *manifest = NULL;
    const spin_json *entry;
    double value = NAN;

    snprintf(file, sizeof file, "hash4d/%s/manifest.json", name);
    path = check_fixture(file);
    if (path && spin_json_load(path, &manifest) == SPIN_OK) {
        entry = spin_json_get(spin_json_get(manifest, "tolerance"), key);
        if (!spin_json_number(entry, &value) && spin_json_string(entry))
            sscanf(spin_json_string(entry), "abs %lf", &value);
    }
    spin_json_free(manifest);
    ok(!isnan(value), "%s: its manifest has a tolerance of %s", name, key);
    return value;
}

/* Rows of all corners of the first points, as listed in the fixture. */
static void check_corner_rows(struct spin_npz *npz, const struct spin_grid *grid, const float *x,
                              const char *name)
{
    struct spin_array info;
    double *want = check_load(npz, "corner_index", &info);
    size_t n_points = (size_t)info.shape[1], wrong = 0;

    for (size_t i = 0; i < info.count; i++) {
        size_t level = i / 16 / n_points, point = i / 16 % n_points;
        uint32_t q[4], rows = grid->offset[level + 1] - grid->offset[level];

        for (int d = 0; d < 4; d++)
            q[d] = (uint32_t)(x[point * 4 + (size_t)d] * grid->scale[level][d]) + (i >> d & 1);
        wrong += spin_grid_row(q, grid->res[level], rows, grid->hashed[level]) != want[i];
    }
    ok(wrong == 0, "%s: rows of all corners, %zu wrong", name, wrong);
    free(want);
}

static void golden_hash4d(const char *name, const char *path)
{
    struct spin_npz npz;
    struct spin_array info;
    struct spin_grid grid;
    struct spin_device *d;
    float *x, *table, *g, *z, *d_table, *d_x;
    double *y, *grad_x, *grad_table, *hashed, largest = 0;
    char file[96], what[96];
    size_t n, width, n_table;
    int same = 1;

    snprintf(file, sizeof file, "hash4d/%s/vectors.npz", name);
    if (!net_open(file, &npz))
        return;
    x = check_load_f32(&npz, "inputs", &info);
    n = (size_t)info.shape[0];
    table = check_load_f32(&npz, "table", &info);
    n_table = (size_t)info.count;
    grid = grid_of(&npz, "level_scale", "level_resolution", "offsets", (int)info.shape[1]);
    hashed = check_load(&npz, "level_hashed", NULL);
    for (int l = 0; l < grid.n_levels; l++)
        same &= grid.hashed[l] == hashed[l];
    ok(same, "%s: the same levels are hashed", name);
    width = (size_t)grid.n_levels * (size_t)grid.n_features;
    g = check_load_f32(&npz, "grad_outputs", NULL);
    y = check_load(&npz, "outputs", NULL);
    grad_x = check_load(&npz, "grad_inputs", NULL);
    grad_table = check_load(&npz, "grad_table", NULL);
    z = net_floats(n * width);
    d_table = net_floats(n_table);
    d_x = net_floats(n * 4);
    d = check_device(2);
    on_grid(d, &grid, table, n, x, z);
    on_grid_back(d, &grid, table, n, NULL, x, g, d_table, d_x);
    check_corner_rows(&npz, &grid, x, name);
    for (size_t i = 0; i < n * 4; i++)
        largest = larger(largest, fabs(grad_x[i]));
    snprintf(what, sizeof what, "golden %s outputs (%s)", name, path);
    check_close(z, y, n * width, hash4d_tolerance(name, "outputs"), 0, what);
    snprintf(what, sizeof what, "golden %s grad_table (%s)", name, path);
    check_close(d_table, grad_table, n_table, hash4d_tolerance(name, "grad_table"), 0, what);
    snprintf(what, sizeof what, "golden %s grad_inputs (%s)", name, path);
    check_space(d_x, grad_x, n, hash4d_tolerance(name, "grad_inputs") * largest, 0, what);
    free(x), free(table), free(g), free(z), free(d_table), free(d_x);
    free(y), free(grad_x), free(grad_table), free(hashed);
    spin_npz_close(&npz);
    check_device_free(d);
}

static void golden_hash(void)
{
    struct spin_npz npz;
    struct spin_array info;
    double *coords, *want;
    size_t wrong = 0, tried = 0;

    if (!net_open("hash4d/hash_index/vectors.npz", &npz))
        return;
    coords = check_load(&npz, "coords", &info);
    for (size_t k = 0; k < npz.zip.n; k++) { /* mod_2e19: tables of 2^19 rows; mod_1000003: of
                                              * 1000003 rows */
        unsigned power, rows;
        char key[64];

        snprintf(key, sizeof key, "%.*s", (int)strlen(npz.zip.member[k].name) - 4,
                 npz.zip.member[k].name);
        if (sscanf(key, "mod_2e%u", &power) == 1)
            rows = 1u << power;
        else if (sscanf(key, "mod_%u", &rows) != 1)
            continue;
        tried++;
        want = check_load(&npz, key, NULL);
        for (size_t i = 0; i < info.shape[0]; i++) {
            uint32_t q[4];

            for (int d = 0; d < 4; d++)
                q[d] = (uint32_t)coords[i * 4 + (size_t)d];
            wrong += spin_grid_row(q, q, rows, 1) != want[i];
        }
        free(want);
    }
    ok(wrong == 0 && tried > 0, "golden hash_index, %zu tables, %zu wrong", tried, wrong);
    free(coords);
    spin_npz_close(&npz);
}

/* ---- reference ------------------------------------------------------------------------------- */

/* Grid of n_levels from base to finest; odd_rows gives hashed levels a size that is not a power of
 * two. */
static struct spin_grid make_grid(int n_levels, int n_features, int log2_rows, int odd_rows)
{
    static const int base[4] = {4, 3, 5, 2}, finest[4] = {40, 37, 50, 9};
    struct spin_grid grid;

    memset(&grid, 0, sizeof grid);
    grid.n_levels = n_levels;
    grid.n_features = n_features;
    for (int l = 0; l < n_levels; l++) {
        int hashed;
        uint64_t rows = spin_grid_level(l, n_levels, base, finest, log2_rows, grid.scale[l],
                                        grid.res[l], &hashed);

        if (hashed && odd_rows)
            rows -= 3;
        grid.hashed[l] = (uint8_t)hashed;
        grid.offset[l + 1] = grid.offset[l] + (uint32_t)rows;
    }
    return grid;
}

/* One point, in double. */
static void plain(const struct spin_grid *grid, const float *table, const double x[4], double *z)
{
    int width = grid->n_features;

    memset(z, 0, (size_t)(grid->n_levels * width) * sizeof *z);
    for (int l = 0; l < grid->n_levels; l++)
        for (int k = 0; k < 16; k++) {
            uint32_t q[4], rows = grid->offset[l + 1] - grid->offset[l];
            double weight = 1;
            size_t row;

            for (int d = 0; d < 4; d++) {
                double pos = x[d] * grid->scale[l][d], r = pos - floor(pos),
                       w = r * r * (3 - 2 * r);

                q[d] = (uint32_t)pos + (uint32_t)(k >> d & 1);
                weight *= k >> d & 1 ? w : 1 - w;
            }
            row = grid->offset[l] + spin_grid_row(q, grid->res[l], rows, grid->hashed[l]);
            for (int f = 0; f < width; f++)
                z[l * width + f] += weight * table[row * (size_t)width + (size_t)f];
        }
}

static double plain_dot(const struct spin_grid *grid, const float *table, const double x[4],
                        const float *g)
{
    double z[SPIN_MAX_LEVELS * 8], sum = 0;

    plain(grid, table, x, z);
    for (int i = 0; i < grid->n_levels * grid->n_features; i++)
        sum += z[i] * g[i];
    return sum;
}

static void against_plain(int n_features, int odd_rows)
{
    struct spin_grid grid = make_grid(5, n_features, 9, odd_rows);
    struct spin_device *d = check_device(2);
    size_t n = 133, width = 5 * (size_t)n_features, n_table = grid.offset[5] * (size_t)n_features;
    float *table = net_random(n_table, 11, -1, 1), *x = net_random(n * 4, 12, 0.01f, 0.99f);
    float *g = net_random(n * width, 13, -1, 1), *z = net_floats(n * width),
          *d_x = net_floats(n * 4);
    float *d_table = net_floats(n_table), *direction = net_random(n_table, 14, -1, 1);
    double *want = net_alloc(n * width, sizeof *want), worst = 0;
    char what[96];

    on_grid(d, &grid, table, n, x, z);
    on_grid_back(d, &grid, table, n, NULL, x, g, d_table, d_x);
    for (size_t i = 0; i < n; i++) {
        double at[4] = {x[i * 4], x[i * 4 + 1], x[i * 4 + 2], x[i * 4 + 3]};

        plain(&grid, table, at, want + i * width);
        for (int k = 0; k < 3; k++) {
            double keep = at[k], up, down, h = 1e-6;

            at[k] = keep + h;
            up = plain_dot(&grid, table, at, g + i * width);
            at[k] = keep - h;
            down = plain_dot(&grid, table, at, g + i * width);
            at[k] = keep;
            worst = larger(worst, fabs((up - down) / (2 * h) - d_x[i * 4 + (size_t)k]));
        }
    }
    snprintf(what, sizeof what, "%d features, %s: equals a plain version", n_features,
             odd_rows ? "any number of rows" : "2^k rows");
    check_close(z, want, n * width, 3e-5, 0, what);
    near(worst, 0, 3e-3, "position slopes (up to 200) are central differences");
    ok(d_x[3] == 0.0f, "no gradient to time");
    /* The output is linear in the table: g . grid(direction) = d_table . direction. */
    on_grid(d, &grid, direction, n, x, z);
    near(net_dot(d_table, direction, n_table), net_dot(g, z, n * width), 2e-4,
         "table slopes are those of a linear map");
    free(table), free(x), free(g), free(z), free(d_x), free(d_table), free(direction), free(want);
    check_device_free(d);
}

/* ---- same results ---------------------------------------------------------------------------- */

struct run {
    float *z, *d_table, *d_x, *d_table_only;
};

static void threads_and_paths(void)
{
    struct spin_grid grid = make_grid(8, 4, 10, 0);
    size_t n = 1501, width = 32, n_table = grid.offset[8] * 4u, n_rows;
    uint32_t *rows;
    float *table = net_random(n_table, 21, -1, 1), *x = net_random(n * 4, 22, -0.02f, 1.02f);
    float *g = net_random(n * width, 23, -1, 1);
    struct run first = {0}, run;
    char what[96];

    n_rows = net_rows(n, &rows);
    for (int p = 0; p < N_NET_PATHS; p++) {
        if (!net_path(net_paths[p]))
            continue;
        for (int k = 0; k < check_n_threads(); k++) {
            struct spin_device *d = check_device(check_thread_counts[k]);

            run.z = net_floats(n * width);
            run.d_table = net_floats(n_table);
            run.d_table_only = net_floats(n_table);
            run.d_x = net_floats(n * 4);
            on_grid(d, &grid, table, n, x, run.z);
            on_grid_back(d, &grid, table, n_rows, rows, x, g, run.d_table, run.d_x);
            on_grid_back(d, &grid, table, n_rows, rows, x, g, run.d_table_only, NULL);
            snprintf(what, sizeof what, "without the position gradient: same table (%s, %d)",
                     net_paths[p], check_thread_counts[k]);
            check_same_sums(run.d_table_only, run.d_table, n_table, what);
            free(run.d_table_only);
            if (!first.z) {
                first = run;
            } else {
                snprintf(what, sizeof what, "same bits: %s, %d threads", net_paths[p],
                         check_thread_counts[k]);
                check_same_bits(run.z, first.z, n * width * 4, what);
                check_same_sums(run.d_table, first.d_table, n_table, what);
                check_same_bits(run.d_x, first.d_x, n * 16, what);
                free(run.z), free(run.d_table), free(run.d_x);
            }
            check_device_free(d);
        }
    }
    unsetenv("SPIN_CPU");
    free(first.z), free(first.d_table), free(first.d_x);
    free(table), free(x), free(g), free(rows);
}

/* Listed rows select rows of x_u, and their gradients are compact. */
static void rows_are_compact(void)
{
    struct spin_grid grid = make_grid(6, 4, 10, 0);
    struct spin_device *d = check_device(2);
    size_t n = 300, width = 24, n_table = grid.offset[6] * 4u, n_rows;
    uint32_t *rows;
    float *table = net_random(n_table, 31, -1, 1), *x = net_random(n * 4, 32, 0, 1);
    float *g = net_random(n * width, 33, -1, 1), *listed_x = net_floats(n * 4);
    float *t1 = net_floats(n_table), *t2 = net_floats(n_table);
    float *d1 = net_floats(n * 4), *d2 = net_floats(n * 4);

    n_rows = net_rows(n, &rows);
    for (size_t i = 0; i < n_rows; i++)
        memcpy(listed_x + i * 4, x + rows[i] * 4, 16);
    on_grid_back(d, &grid, table, n_rows, rows, x, g, t1, d1);
    on_grid_back(d, &grid, table, n_rows, NULL, listed_x, g, t2, d2);
    check_same_sums(t1, t2, n_table, "listed rows: same table gradient as the rows alone");
    check_same_bits(d1, d2, n * 16, "listed rows: same position gradient");
    on_grid_back(d, &grid, table, 0, rows, x, g, t1, d1);
    check_same_sums(t1, t2, n_table, "no rows: nothing happens");
    free(table), free(x), free(g), free(listed_x), free(t1), free(t2), free(d1), free(d2),
        free(rows);
    check_device_free(d);
}

/* Groups of every size of points that share a cell, with points outside in between. */
static void crowds(int n_features)
{
    struct spin_grid grid = make_grid(5, n_features, 9, 0);
    struct spin_device *d = check_device(2);
    size_t n = 288, width = 5 * (size_t)n_features, n_table = grid.offset[5] * (size_t)n_features;
    float *table = net_random(n_table, 61, -1, 1), *x = net_random(n * 4, 62, 0, 1);
    float *g = net_random(n * width, 63, -1, 1);
    float *d_table = net_floats(n_table), *one = net_floats(n_table);
    double *want = net_alloc(n_table, sizeof *want);
    char what[64];

    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < 4; k++) {
            size_t first = i < 96 ? 0 : i - i % (i / 32); /* first point of its group */

            x[i * 4 + k] =
                i % 37 == 5 ? 1.5f : x[first * 4 + k] * 0.97f + 0.0001f * (float)(i - first);
        }
    on_grid_back(d, &grid, table, n, NULL, x, g, d_table, NULL);
    for (size_t i = 0; i < n; i++) {
        memset(one, 0, n_table * sizeof *one);
        on_grid_back(d, &grid, table, 1, NULL, x + i * 4, g + i * width, one, NULL);
        for (size_t k = 0; k < n_table; k++)
            want[k] += one[k];
    }
    snprintf(what, sizeof what, "crowds, %d features: the sum of the points alone", n_features);
    check_rel_to_absmax(d_table, want, n_table, 2e-6, what);
    free(table), free(x), free(g), free(d_table), free(one), free(want);
    check_device_free(d);
}

/* ---- deterministic --------------------------------------------------------------------------- */

/* With gradients of any magnitude: the same bits every time, equal to float sums within rounding.
 * Nonfinite gradients stay nonfinite in their rows. */
static void sums_repeat(float size)
{
    struct spin_grid grid = make_grid(5, 4, 8, 0);
    struct spin_device *d = check_device(2);
    size_t n = 700, width = 20, n_table = grid.offset[5] * 4u, lost = 0, wanted = 0;
    float *table = net_random(n_table, 51, -1, 1), *x = net_random(n * 4, 52, 0, 1);
    float *g = net_random(n * width, 53, -size, size), *plain = net_floats(n_table);
    float *first = net_random(n_table, 54, -size, size), *start = net_copy(first, n_table);
    char what[64];

    for (size_t i = 0; i < n_table; i++)
        plain[i] = start[i];
    on_grid_back(d, &grid, table, n, NULL, x, g, plain, NULL);
    d->deterministic = true;
    on_grid_back(d, &grid, table, n, NULL, x, g, first, NULL);
    snprintf(what, sizeof what, "gradients to %g: sums of whole numbers", (double)size);
    check_same_sums(first, plain, n_table, what);
    for (int k = 0; k < 3; k++) {
        float *again = net_copy(start, n_table);

        on_grid_back(d, &grid, table, n, NULL, x, g, again, NULL);
        check_same_bits(again, first, n_table * 4, "deterministic: the same bits again");
        free(again);
    }
    for (size_t i = 0; i < n; i += 100)
        g[i * width] = i % 200 ? NAN : -INFINITY;
    memcpy(first, start, n_table * sizeof *first);
    memcpy(plain, start, n_table * sizeof *plain);
    on_grid_back(d, &grid, table, n, NULL, x, g, first, NULL);
    d->deterministic = false;
    on_grid_back(d, &grid, table, n, NULL, x, g, plain, NULL);
    for (size_t i = 0; i < n_table; i++) {
        wanted += !isfinite(plain[i]);
        lost += isfinite(plain[i]) != isfinite(first[i]);
    }
    ok(wanted > 0 && lost == 0, "what is not finite is not lost, %zu", wanted);
    free(table), free(x), free(g), free(plain), free(first), free(start);
    check_device_free(d);
}

/* ---- extreme values -------------------------------------------------------------------------- */

static void sane(void)
{
    struct spin_grid grid = make_grid(4, 4, 8, 0);
    struct spin_device *d = check_device(1);
    float x[] = {1, 1, 1, 1, 0,      0, 0,        0, NAN, 0.5f, 0.5f, 0,    0.5f, 1.0001f,
                 0, 0, 0, 0, -1e30f, 0, INFINITY, 0, 0,   0,    0.5f, 0.5f, 0.5f, NAN};
    size_t n_table = grid.offset[4] * 4u;
    float *table = net_random(n_table, 41, -1, 1), z[7 * 16], g[7 * 16], d_x[28];
    float *d_table = net_floats(n_table), *before;
    int zero = 1;

    for (int i = 0; i < 7 * 16; i++)
        g[i] = 1.0f;
    on_grid(d, &grid, table, 7, x, z);
    for (int i = 32; i < 112; i++)
        zero &= z[i] == 0.0f;
    ok(zero, "outside or NaN gives zeros");
    ok(z[0] == table[(grid.offset[1] - 1) * 4], "x = 1 is the last vertex of a dense level");
    ok(z[16] == table[0], "x = 0 is the first vertex");
    on_grid_back(d, &grid, table, 2, NULL, x, g, d_table, d_x);
    before = net_copy(d_table, n_table);
    for (int i = 0; i < 28; i++)
        d_x[i] = 5.0f;
    on_grid_back(d, &grid, table, 5, NULL, x + 8, g, d_table, d_x);
    check_same_bits(d_table, before, n_table * 4, "and no gradient to the table");
    zero = 1;
    for (int i = 0; i < 20; i++)
        zero &= d_x[i] == 0.0f;
    ok(zero, "and none to the position");
    on_grid(d, &grid, table, 0, x, z);
    free(table), free(d_table), free(before);
    check_device_free(d);
}

/* The total number of rows, from the formula of docs/method.md 3.3. */
static uint64_t rows_of(int base_space, int base_time, int finest_time, int log2_rows)
{
    int base[4] = {base_space, base_space, base_space, base_time};
    int finest[4] = {2048, 2048, 2048, finest_time}, hashed;
    uint64_t sum = 0;
    float scale[4];
    uint32_t res[4];

    for (int l = 0; l < 16; l++)
        sum += spin_grid_level(l, 16, base, finest, log2_rows, scale, res, &hashed);
    ok(res[0] == 2048 && res[3] == (uint32_t)finest_time && scale[0] == 2047.0f && hashed,
       "the last level is exactly the finest: 2048, %d", finest_time);
    return sum;
}

static void level_sizes(void)
{
    int base[4] = {8, 8, 8, 8}, finest[4] = {64, 64, 64, 16},
        huge[4] = {65536, 65536, 65536, 65536};
    int hashed;
    float scale[4];
    uint32_t res[4];

    ok(rows_of(8, 8, 25, 21) == 23317201, "rows of 8 to 2048, time 25, 2^21");
    ok(rows_of(8, 8, 150, 21) == 24223187, "rows of 8 to 2048, time 150, 2^21");
    ok(rows_of(16, 16, 2048, 21) == 28531874, "rows of 16 to 2048 on all axes, 2^21");
    ok(spin_grid_level(0, 1, base, finest, 19, scale, res, &hashed) == 4096 && !hashed &&
           res[3] == 8 && scale[3] == 7.0f,
       "one level alone is the base");
    ok(spin_grid_level(0, 2, base, finest, 12, scale, res, &hashed) == 4096 && !hashed,
       "a level that fills its table exactly is dense");
    ok(spin_grid_level(1, 2, base, huge, 23, scale, res, &hashed) == 1u << 23 && hashed,
       "a product that wraps to 0 in 32 bits is still hashed");
}

TAP_MAIN
{
    const char **encoders = check_files("encode_"), **cases = check_cases("hash4d", "vectors.npz");

    for (int i = 0; i < N_NET_PATHS; i++) {
        if (!net_path(net_paths[i]))
            continue;
        for (size_t k = 0; encoders[k]; k++)
            golden_core(encoders[k], net_paths[i]);
        for (size_t k = 0; cases[k]; k++)
            if (strcmp(cases[k], "hash_index") != 0)
                golden_hash4d(cases[k], net_paths[i]);
    }
    free(encoders);
    free(cases);
    unsetenv("SPIN_CPU");
    golden_hash();
    for (int odd = 0; odd < 2; odd++)
        for (int f = 1; f <= 8; f *= 2)
            against_plain(f, odd);
    threads_and_paths();
    rows_are_compact();
    crowds(1);
    crowds(4);
    sums_repeat(1);
    sums_repeat(1e-18f);
    sums_repeat(1e12f);
    sane();
    level_sizes();
}
