/* Shared by the tests of methods that are defined at any time: opening with options, and
 * comparing the Gaussians visible at a time with the rows of expected.npz that should be. */
#ifndef SPIN_TESTS_IMPORTERS_SLICES_H
#define SPIN_TESTS_IMPORTERS_SLICES_H

#include "math/covariance.h"
#include "tests/importers/runs.h"

/* As run_open(), with options: key, value, ..., NULL. */
static inline spin_status open_with(const char *from, const char *path, const char *const *pairs,
                                    struct run *run)
{
    struct spin_plugin_values values = {pairs};
    spin_status status;

    memset(run, 0, sizeof *run);
    status = spin_importer_find(path, from, false, &run->importer);
    if (status == SPIN_OK)
        status = run->importer->open(path, &values, &run->self, &run->sequence);
    if (status != SPIN_OK)
        run_close(run);
    return status;
}

/* Opening with these options fails with a message that contains the word and the file's name. */
static inline void fails_with(const char *from, const char *path, const char *const *pairs,
                              const char *word, const char *what)
{
    struct run run;
    spin_status status = open_with(from, path, pairs, &run);
    bool good = status != SPIN_OK && strstr(spin_last_error(), word);

    ok(good, "%s", what);
    if (!good)
        printf("#   status %d, '%s'\n", status, status == SPIN_OK ? "" : spin_last_error());
    run_close(&run);
}

/* An array of n_rows rows; NULL after a failed test if it is missing. */
struct table {
    double *value;
    size_t n_blocks, n_rows, width; /* [n_blocks][n_rows][width] */
};

static inline struct table table_load(struct spin_npz *npz, const char *key, int lead)
{
    struct spin_array info;
    struct table t = {.value = check_load(npz, key, &info), .n_blocks = 1, .width = 1};

    if (!t.value)
        return t;
    for (int d = 0; d < info.n_dims; d++) {
        if (d < lead)
            t.n_blocks *= info.shape[d];
        else if (d == lead)
            t.n_rows = info.shape[d];
        else
            t.width *= info.shape[d];
    }
    return t;
}

/* The rows of block `b` that are compared, one after the other (malloc'd). */
static inline double *table_rows(const struct table *t, size_t b, const size_t *row, size_t n)
{
    double *out = malloc(n * t->width * sizeof *out + 1);

    for (size_t i = 0; i < n; i++)
        memcpy(out + i * t->width, t->value + (b * t->n_rows + row[i]) * t->width,
               t->width * sizeof *out);
    return out;
}

/* Compares floats [row][step] with rows of a table, which may be narrower. */
static inline void compare_rows(const struct table *t, size_t block, const size_t *row, size_t n,
                                const float *got, size_t step, double abs, double rel,
                                const char *what)
{
    double *want = table_rows(t, block, row, n);
    float *packed = malloc(n * t->width * sizeof *packed + 1);

    for (size_t i = 0; i < n; i++) {
        for (size_t c = 0; c < t->width; c++)
            packed[i * t->width + c] = c < step ? got[i * step + c] : 0;
    }
    check_close(packed, want, n * t->width, abs, rel, what);
    free(packed);
    free(want);
}

/* The size and part of each Gaussian's motion, as the manifests define it. */
static inline void compare_covariances(const struct table *t, size_t block, const size_t *row,
                                       const struct spin_splats *s, const char *what)
{
    double *want = table_rows(t, block, row, s->n), worst = 0;
    struct bound b = bound_or("cov6", (struct bound){1e-7, 1e-4});

    for (size_t i = 0; i < s->n; i++) {
        const double *w = want + 6 * i, trace = w[0] + w[3] + w[5];
        double scale[3], quat[4], got[6];

        for (size_t c = 0; c < 3; c++)
            scale[c] = exp(s->log_scales[3 * i + c]);
        for (size_t c = 0; c < 4; c++)
            quat[c] = s->quats[4 * i + c];
        spin_covariance_of(scale, quat, got);
        for (int c = 0; c < 6; c++) {
            double error = fabs(got[c] - w[c]) / (b.abs + b.rel * trace);

            worst = error <= worst ? worst : error; /* NaN stays */
        }
    }
    near(worst, 0, 1, what);
    free(want);
}

static inline void compare_opacities(const struct table *t, size_t block, const size_t *row,
                                     const struct spin_splats *s, double abs, const char *what)
{
    float *got = map_values(s->logit_opacities, s->n, sigmoid);

    compare_rows(t, block, row, s->n, got, 1, abs, 0, what);
    free(got);
}

/* Unit quaternions, and only finite values. */
static inline void check_sane(const struct spin_splats *s, unsigned columns, const char *what)
{
    size_t width = 3 * (size_t)((s->sh_degree + 1) * (s->sh_degree + 1)), bad = 0;

    for (size_t i = 0; i < s->n; i++) {
        const float *q = s->quats + 4 * i;

        if (columns & SPIN_COL_QUATS)
            bad +=
                !(fabs((double)q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3] - 1) <= 1e-5);
        for (size_t c = 0; c < 3; c++)
            bad += !isfinite(s->means[3 * i + c]) ||
                   ((columns & SPIN_COL_LOG_SCALES) && !isfinite(s->log_scales[3 * i + c]));
        bad += (columns & SPIN_COL_LOGIT_OPACITIES) && !isfinite(s->logit_opacities[i]);
        for (size_t c = 0; c < width && (columns & SPIN_COL_SH); c++)
            bad += !isfinite(s->sh[width * i + c]);
    }
    near((double)bad, 0, 0, what);
}

/* Flips single bytes of a copy, a few hundred of them spread over the file: reading must not
 * crash. */
static inline void survive_flips(const char *from, const char *path)
{
    const char *copy = path_in(new_folder(), spin_path_name(path));
    struct spin_map map;
    size_t n = 0;

    if (spin_map_open(path, &map) != SPIN_OK) {
        ok(0, "maps '%s'", path);
        return;
    }
    for (size_t i = 0; i < 400; i++) {
        /* Half of them inside the pickle, which is at the front. */
        size_t at = i % 2 ? i * 17 % map.size : i * (map.size / 400);
        FILE *file = fopen(copy, "wb");

        if (!file)
            break;
        fwrite(map.data, 1, at, file);
        fputc(map.data[at] ^ (1 << i % 8), file);
        fwrite(map.data + at + 1, 1, map.size - at - 1, file);
        fclose(file);
        read_all(from, copy);
        n++;
    }
    ok(n == 400, "%s: 400 damaged copies are survived", spin_path_name(path));
    spin_map_close(&map);
}

#endif
